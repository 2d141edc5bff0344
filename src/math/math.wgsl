// Twin of `math`: frames, colours, rounding bounds.

const PI: f32 = 3.14159265358979;
const TAU: f32 = 6.28318530717959;
const FRAC_1_PI: f32 = 0.318309886183791;
const FRAC_PI_4: f32 = 0.785398163397448;
// 2^-23, as in Rust.
const EPSILON: f32 = 1.1920929e-7;
const MIN_POSITIVE: f32 = 1.17549435e-38;
// Where Rust has an infinite ray.
const FAR: f32 = 3.0e38;

struct Frame {
    tangent: vec3f,
    bitangent: vec3f,
    normal: vec3f,
}

fn luminance(rgb: vec3f) -> f32 {
    return rgb.x * 0.2126 + rgb.y * 0.7152 + rgb.z * 0.0722;
}

fn gamma(n: f32) -> f32 {
    let nu = n * (0.5 * EPSILON);
    return nu / (1.0 - nu);
}

// By its bits: the language lets a compiler assume that no value is infinite or NaN.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn is_finite3(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

fn copysign(magnitude: f32, side: f32) -> f32 {
    return bitcast<f32>((bitcast<u32>(magnitude) & 0x7fffffffu) | (bitcast<u32>(side) & 0x80000000u));
}

fn signum3(v: vec3f) -> vec3f {
    return vec3f(copysign(1.0, v.x), copysign(1.0, v.y), copysign(1.0, v.z));
}

fn max3(v: vec3f) -> f32 {
    return max(v.x, max(v.y, v.z));
}

fn dot3(a: vec3f, b: vec3f) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

fn length_squared(v: vec3f) -> f32 {
    return dot3(v, v);
}

// `v / |v|` as glam has it: the built-in one may take a faster root.
fn unit(v: vec3f) -> vec3f {
    return v * (1.0 / sqrt(dot3(v, v)));
}

fn all_zero(v: vec3f) -> bool {
    return v.x == 0.0 && v.y == 0.0 && v.z == 0.0;
}

fn frame_from_normal(n: vec3f) -> Frame {
    let side = copysign(1.0, n.z);
    let a = -1.0 / (side + n.z);
    let b = n.x * n.y * a;
    return Frame(
        vec3f(1.0 + side * n.x * n.x * a, side * b, -side * n.x),
        vec3f(b, side + n.y * n.y * a, -n.y),
        n,
    );
}

fn frame_from_normal_and_tangent(normal: vec3f, tangent: vec3f) -> Frame {
    let t = tangent - normal * dot3(normal, tangent);
    let inverse = 1.0 / sqrt(dot3(t, t));
    if !(is_finite(inverse) && inverse > 0.0) {
        return frame_from_normal(normal);
    }
    let along = t * inverse;
    return Frame(along, cross(normal, along), normal);
}

fn to_local(f: Frame, v: vec3f) -> vec3f {
    return vec3f(dot3(v, f.tangent), dot3(v, f.bitangent), dot3(v, f.normal));
}

fn to_world(f: Frame, v: vec3f) -> vec3f {
    return f.tangent * v.x + f.bitangent * v.y + f.normal * v.z;
}

fn offset_origin(p: vec3f, n: vec3f, error: vec3f) -> vec3f {
    let moved = p + n * dot3(abs(n), error);
    return moved + signum3(n) * (abs(moved) * EPSILON);
}

fn octahedral_wrap(p: vec2f) -> vec2f {
    return vec2f(copysign(1.0 - abs(p.y), p.x), copysign(1.0 - abs(p.x), p.y));
}

fn octahedral_encode(d: vec3f) -> vec2f {
    let p = d.xy / (abs(d.x) + abs(d.y) + abs(d.z));
    if d.z >= 0.0 {
        return p;
    }
    return octahedral_wrap(p);
}

fn octahedral_decode(p: vec2f) -> vec3f {
    let z = 1.0 - abs(p.x) - abs(p.y);
    var q = p;
    if z < 0.0 {
        q = octahedral_wrap(p);
    }
    return unit(vec3f(q, z));
}
