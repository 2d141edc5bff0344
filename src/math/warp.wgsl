// Twin of `math::warp`.

const HALF_STEP: f32 = 0.5 / 16777216.0;
const CENTRED_ONE: f32 = 1.0 - 2.0 * HALF_STEP;

// (sine, cosine) of x in [-pi/4, pi/4].
fn sin_cos_octant(x: f32) -> vec2f {
    let y = x * x;
    let s = x + x * y * (-1.0 / 6.0 + y * (1.0 / 120.0 + y * (-1.0 / 5040.0 + y * (1.0 / 362880.0))));
    let c = 1.0 + y * (-0.5 + y * (1.0 / 24.0 + y * (-1.0 / 720.0 + y * (1.0 / 40320.0))));
    return vec2f(s, c);
}

// (sine, cosine) of 2 pi turn.
fn sin_cos_turn(turn: f32) -> vec2f {
    let quarter = u32(4.0 * turn + 0.5);
    var sc = sin_cos_octant((turn - 0.25 * f32(quarter)) * TAU);
    if (quarter & 1u) != 0u {
        sc = vec2f(sc.y, -sc.x);
    }
    if (quarter & 2u) != 0u {
        sc = -sc;
    }
    return sc;
}

fn turn_of(x: f32, y: f32) -> f32 {
    if x == 0.0 && y == 0.0 {
        return 0.0;
    }
    var turn = atan2(y, x) * (1.0 / TAU);
    if turn < 0.0 {
        turn += 1.0;
    }
    return select(0.0, turn, turn < 1.0);
}

fn one_minus_z(d: vec3f) -> f32 {
    if d.z > 0.0 {
        return (d.x * d.x + d.y * d.y) / (1.0 + d.z);
    }
    return 1.0 - d.z;
}

fn direction_of(turn: f32, below: f32) -> vec3f {
    let sc = sin_cos_turn(turn);
    let sin_theta = sqrt(max(below * (2.0 - below), 0.0));
    return vec3f(sin_theta * sc.y, sin_theta * sc.x, 1.0 - below);
}

// The point and its signed radius.
fn concentric(u: vec2f) -> vec3f {
    let a = 2.0 * u.x - CENTRED_ONE;
    let b = 2.0 * u.y - CENTRED_ONE;
    let wide = abs(a) > abs(b);
    let r = select(b, a, wide);
    let other = select(a, b, wide);
    var ratio = 0.0;
    if r != 0.0 {
        ratio = other / r;
    }
    let sc = sin_cos_octant(FRAC_PI_4 * ratio);
    if wide {
        return vec3f(r * sc.y, r * sc.x, r);
    }
    return vec3f(r * sc.x, r * sc.y, r);
}

fn sample_disk(u: vec2f) -> vec2f {
    return concentric(u).xy;
}

fn centred_to_unit(a: f32) -> f32 {
    return clamp(0.5 * (a + CENTRED_ONE), 0.0, CENTRED_ONE);
}

fn invert_disk(p: vec2f) -> vec2f {
    let radius = sqrt(p.x * p.x + p.y * p.y);
    var ab = vec2f(0.0);
    if abs(p.x) > abs(p.y) {
        let r = copysign(radius, p.x);
        ab = vec2f(r, r * atan(p.y / p.x) * (1.0 / FRAC_PI_4));
    } else if p.y != 0.0 {
        let r = copysign(radius, p.y);
        ab = vec2f(r * atan(p.x / p.y) * (1.0 / FRAC_PI_4), r);
    }
    return vec2f(centred_to_unit(ab.x), centred_to_unit(ab.y));
}

fn sample_cosine_hemisphere(u: vec2f) -> vec3f {
    let p = concentric(u);
    return vec3f(p.xy, sqrt((1.0 - p.z) * (1.0 + p.z)));
}

fn sample_uniform_sphere(u: vec2f) -> vec3f {
    return direction_of(u.y, 2.0 * u.x);
}

fn invert_uniform_sphere(d: vec3f) -> vec2f {
    return vec2f(min(0.5 * one_minus_z(d), CENTRED_ONE), turn_of(d.x, d.y));
}

fn sample_uniform_cone(one_minus_cos_max: f32, u: vec2f) -> vec3f {
    return direction_of(u.y, u.x * one_minus_cos_max);
}

fn uniform_cone_pdf(one_minus_cos_max: f32) -> f32 {
    return 1.0 / (TAU * one_minus_cos_max);
}

fn sample_uniform_triangle(u: vec2f) -> vec3f {
    var b0: f32;
    var b1: f32;
    if u.y > u.x {
        b0 = 0.5 * u.x;
        b1 = u.y - b0;
    } else {
        b1 = 0.5 * u.y;
        b0 = u.x - b1;
    }
    return vec3f(b0, b1, 1.0 - b0 - b1);
}

fn invert_uniform_triangle(b: vec3f) -> vec2f {
    if b.y > b.x {
        return vec2f(2.0 * b.x, b.x + b.y);
    }
    return vec2f(b.x + b.y, 2.0 * b.y);
}
