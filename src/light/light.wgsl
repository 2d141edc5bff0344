// Twin of `light`: the table of emitters, points on them, the environment.

const NO_LIGHT: u32 = 0xffffffffu;

const TRIANGLE: u32 = 0u;
const SPHERE: u32 = 1u;
const DISK: u32 = 2u;
const POINT: u32 = 3u;
const SPOT: u32 = 4u;
const DISTANT: u32 = 5u;
const ENVIRONMENT: u32 = 6u;

// Words of a light: kind, flags, colour, scale, coverage, area, four vectors, three numbers,
// texture coordinates.
const LIGHT: u32 = 32u;
const LIGHT_TWO_SIDED: u32 = 1u;
const LIGHT_HOLLOW: u32 = 2u;
const LIGHT_COVERAGE: u32 = 4u;
const LIGHT_TEXTURED: u32 = 8u;
const LIGHT_UNMET: u32 = 16u;

// Kinds of emitter points.
const ONE_SIDED: u32 = 0u;
const TWO_SIDED: u32 = 1u;
const HOLLOW: u32 = 2u;
const POINT_LIKE: u32 = 3u;
const SPOT_LIKE: u32 = 4u;
const INFINITE: u32 = 5u;
const UNMET: u32 = 6u;

fn has_surface(kind: u32) -> bool {
    return kind <= HOLLOW || (COVERAGE && kind == UNMET);
}

// Whether no ray meets its surface; without coverage anywhere every surface is met.
fn light_unmet(at: u32) -> bool {
    return COVERAGE && (words[at + 1u] & LIGHT_UNMET) != 0u;
}

struct LightPoint {
    light: u32,
    uv: vec2f,
}

struct EmitterPoint {
    position: vec3f,
    normal: vec3f,
    radiance: vec3f,
    kind: u32,
    light: u32,
    valid: bool,
}

struct Arrival {
    direction: vec3f,
    radiance: vec3f,
    geometry: f32,
    valid: bool,
}

struct Incident {
    direction: vec3f,
    radiance: vec3f,
    pdf: f32,
    delta: bool,
    valid: bool,
    emitter: EmitterPoint,
}

fn light_at(w: u32, light: u32) -> u32 {
    return inputs.worlds[w].lights + light * LIGHT;
}

fn choose_light(w: u32, index_word: u32, fraction_word: u32) -> u32 {
    let n = inputs.worlds[w].alias_count;
    // The product of 64 bits with n: its upper word is the slot, its middle one the fraction.
    let low = wide_product(fraction_word, n);
    let high = wide_product(index_word, n);
    let middle = high.y + low.x;
    let index = high.x + select(0u, 1u, middle < low.x);
    let slot = inputs.worlds[w].alias_slots + index * 3u;
    return select(words[slot + 2u], words[slot + 1u], middle < words[slot]);
}

fn choice_probability(w: u32, light: u32) -> f32 {
    if inputs.worlds[w].alias_count == 0u {
        return 0.0;
    }
    return float_word(inputs.worlds[w].probabilities + light);
}

fn light_of_surface(w: u32, shape: u32, element: u32) -> u32 {
    let first = words[inputs.worlds[w].first_of_shape + shape];
    return select(first + element, NO_LIGHT, first == NO_LIGHT);
}

fn light_emitted(w: u32, light: u32, uv: vec2f, cos_theta: f32) -> vec3f {
    let at = light_at(w, light);
    if cos_theta > 0.0 || ((words[at + 1u] & LIGHT_TWO_SIDED) != 0u && cos_theta < 0.0) {
        return color_at(at + 2u, uv) * float_word(at + 6u);
    }
    return vec3f(0.0);
}

// What a point of the surface sends, on average over coverage's coin.
fn light_sent(at: u32, uv: vec2f) -> vec3f {
    let radiance = color_at(at + 2u, uv) * float_word(at + 6u);
    if COVERAGE && (words[at + 1u] & LIGHT_COVERAGE) != 0u {
        return radiance * clamp(scalar_at(at + 7u, uv), 0.0, 1.0);
    }
    return radiance;
}

// Centre and radius of a sphere that is drawn by the cap it shows; a radius of -1 where points are
// drawn by area.
fn light_cap(at: u32, place: vec3f) -> vec4f {
    //#if QUADRICS
    if QUADRICS && words[at] == SPHERE {
        let center = vector_word(at + 10u);
        let radius = float_word(at + 22u);
        let flags = words[at + 1u];
        let outside = length_squared(place - center) > radius * radius * (1.0 + 16.0 * EPSILON);
        if outside && !light_unmet(at) && (flags & (LIGHT_HOLLOW | LIGHT_COVERAGE)) != (LIGHT_HOLLOW | LIGHT_COVERAGE) {
            return vec4f(center, radius);
        }
    }
    //#endif
    return vec4f(0.0, 0.0, 0.0, -1.0);
}

fn one_minus_cos_cone(place: vec3f, center: vec3f, radius: f32) -> f32 {
    let sin2 = radius * radius / length_squared(center - place);
    return sin2 / (1.0 + sqrt(max(1.0 - sin2, 0.0)));
}

fn sample_sphere_cone(place: vec3f, center: vec3f, radius: f32, u: vec2f) -> vec3f {
    let to_center = center - place;
    let squared = length_squared(to_center);
    let f = frame_from_normal(to_center / sqrt(squared));
    let local = sample_uniform_cone(one_minus_cos_cone(place, center, radius), u);
    let sin2_theta = local.x * local.x + local.y * local.y;
    let sin_max = radius / sqrt(squared);
    let ratio2 = sin2_theta / (sin_max * sin_max);
    let cos_alpha = sin2_theta / sin_max + local.z * sqrt(max(1.0 - ratio2, 0.0));
    let sin_alpha = sqrt(max(1.0 - cos_alpha * cos_alpha, 0.0));
    let across = 1.0 / sqrt(sin2_theta);
    var azimuth = vec2f(1.0, 0.0);
    if is_finite(across) && across > 0.0 {
        azimuth = local.xy * across;
    }
    let normal = to_world(f, vec3f(azimuth * sin_alpha, -cos_alpha));
    return center + normal * radius;
}

fn light_uv_on_sphere(at: u32, normal: vec3f) -> vec2f {
    if TEXTURES && (words[at + 1u] & LIGHT_TEXTURED) != 0u {
        return uv_on_sphere(normal);
    }
    return vec2f(0.0);
}

fn emitter_new(light: u32, position: vec3f, normal: vec3f, radiance: vec3f, kind: u32) -> EmitterPoint {
    return EmitterPoint(position, normal, radiance, kind, light, !all_zero(radiance));
}

fn sphere_kind(at: u32) -> u32 {
    let hollow = select(ONE_SIDED, HOLLOW, (words[at + 1u] & LIGHT_HOLLOW) != 0u);
    return select(hollow, UNMET, light_unmet(at));
}

//#if QUADRICS
fn emitter_on_sphere(at: u32, light: u32, position: vec3f, normal: vec3f) -> EmitterPoint {
    let radiance = light_sent(at, light_uv_on_sphere(at, normal));
    return emitter_new(light, position, normal * float_word(at + 23u), radiance, sphere_kind(at));
}
//#endif

fn light_side(at: u32) -> u32 {
    let side = select(ONE_SIDED, TWO_SIDED, (words[at + 1u] & LIGHT_TWO_SIDED) != 0u);
    return select(side, UNMET, light_unmet(at));
}

// The light's side of a light point; not valid where it emits nothing.
fn light_emitter(w: u32, point: LightPoint) -> EmitterPoint {
    let at = light_at(w, point.light);
    var position = vector_word(at + 10u);
    var normal = vec3f(0.0);
    var uv = vec2f(0.0);
    var kind = light_side(at);
    switch words[at] {
        case TRIANGLE: {
            let b = sample_uniform_triangle(point.uv);
            position += vector_word(at + 13u) * b.y + vector_word(at + 16u) * b.z;
            normal = vector_word(at + 19u);
            uv = vec2f(float_word(at + 25u), float_word(at + 26u)) * b.x
                + vec2f(float_word(at + 27u), float_word(at + 28u)) * b.y
                + vec2f(float_word(at + 29u), float_word(at + 30u)) * b.z;
        }
        //#if QUADRICS
        case SPHERE: {
            let outward = sample_uniform_sphere(point.uv);
            position += outward * float_word(at + 22u);
            normal = outward * float_word(at + 23u);
            uv = light_uv_on_sphere(at, outward);
            kind = sphere_kind(at);
        }
        case DISK: {
            let d = sample_disk(point.uv);
            position += (vector_word(at + 16u) * d.x + vector_word(at + 19u) * d.y) * float_word(at + 22u);
            normal = vector_word(at + 13u);
            uv = 0.5 * (d + vec2f(1.0));
        }
        //#endif
        //#if ENVIRONMENTS
        case ENVIRONMENT: {
            let environment = words[at + 24u];
            let direction = environment_sample(environment, point.uv);
            return emitter_new(
                point.light,
                direction,
                vec3f(0.0),
                environment_radiance(environment, direction),
                INFINITE,
            );
        }
        //#endif
        case POINT: { kind = POINT_LIKE; }
        case SPOT: { kind = SPOT_LIKE; }
        default: { kind = INFINITE; }
    }
    return emitter_new(point.light, position, normal, light_sent(at, uv), kind);
}

fn hollow_is_dark(at: u32, place: vec3f, cosine: f32) -> bool {
    let two_sided = (words[at + 1u] & LIGHT_TWO_SIDED) != 0u;
    if light_cap(at, place).w >= 0.0 {
        return !two_sided || cosine * float_word(at + 23u) <= 0.0;
    }
    return select(cosine <= 0.0, cosine == 0.0, two_sided);
}

struct Facing {
    direction: vec3f,
    squared: f32,
    cosine: f32,
    valid: bool,
}

// A receiver as a point that is not at infinity sees it.
fn emitter_facing(w: u32, emitter: EmitterPoint, place: vec3f) -> Facing {
    let to_light = emitter.position - place;
    let squared = length_squared(to_light);
    if squared == 0.0 {
        return Facing(vec3f(0.0), 0.0, 0.0, false);
    }
    let direction = to_light / sqrt(squared);
    let cosine = -dot3(direction, emitter.normal);
    var dark = false;
    switch emitter.kind {
        case ONE_SIDED: { dark = cosine <= 0.0; }
        case TWO_SIDED: { dark = cosine == 0.0; }
        //#if COVERAGE
        case UNMET: {
            let flags = words[light_at(w, emitter.light) + 1u];
            dark = select(cosine <= 0.0, cosine == 0.0, (flags & LIGHT_TWO_SIDED) != 0u);
        }
        //#endif
        //#if QUADRICS
        case HOLLOW: {
            dark = hollow_is_dark(light_at(w, emitter.light), place, cosine);
        }
        //#endif
        default: {}
    }
    return Facing(direction, squared, cosine, !dark);
}

fn spot_falloff(at: u32, direction: vec3f) -> f32 {
    let cos_theta = -dot3(direction, vector_word(at + 13u));
    let inner = float_word(at + 22u);
    let outer = float_word(at + 23u);
    if cos_theta <= outer {
        return 0.0;
    }
    if cos_theta >= inner {
        return 1.0;
    }
    let s = (cos_theta - outer) / (inner - outer);
    return select(s * s, s * s * (3.0 - 2.0 * s), words[at + 24u] == 0u);
}

// What arrives; not valid where nothing does.
fn emitter_towards(w: u32, emitter: EmitterPoint, place: vec3f) -> Arrival {
    if emitter.kind == INFINITE {
        let is_environment = words[light_at(w, emitter.light)] == ENVIRONMENT;
        return Arrival(emitter.position, emitter.radiance, select(0.0, 1.0, is_environment), true);
    }
    let facing = emitter_facing(w, emitter, place);
    if !facing.valid {
        return Arrival(vec3f(0.0), vec3f(0.0), 0.0, false);
    }
    if has_surface(emitter.kind) {
        let geometry_term = abs(facing.cosine) / facing.squared;
        let radiance = emitter.radiance * geometry_term;
        let met = select(geometry_term, 0.0, emitter.kind == UNMET);
        return Arrival(facing.direction, radiance, met, !all_zero(radiance) && is_finite(geometry_term));
    }
    var share = 1.0;
    if emitter.kind == SPOT_LIKE {
        share = spot_falloff(light_at(w, emitter.light), facing.direction);
    }
    let radiance = emitter.radiance * (share / facing.squared);
    return Arrival(facing.direction, radiance, 0.0, !all_zero(radiance) && is_finite3(radiance));
}

// What a unit of uv is worth in the light's measure.
fn light_measure(w: u32, point: LightPoint) -> f32 {
    let at = light_at(w, point.light);
    //#if ENVIRONMENTS
    if ENVIRONMENTS && words[at] == ENVIRONMENT {
        let environment = words[at + 24u];
        return 1.0 / environment_pdf(environment, environment_sample(environment, point.uv));
    }
    //#endif
    return float_word(at + 9u);
}

fn uniform_density(w: u32, point: LightPoint) -> f32 {
    return choice_probability(w, point.light) / light_measure(w, point);
}

fn light_point_with(w: u32, light: u32, uv: vec2f) -> LightPoint {
    let kind = words[light_at(w, light)];
    let is_delta = kind == POINT || kind == SPOT || kind == DISTANT;
    return LightPoint(light, select(uv, vec2f(0.0), is_delta));
}

fn light_point_towards(w: u32, light: u32, place: vec3f, u: vec2f) -> LightPoint {
    //#if QUADRICS
    let cap = light_cap(light_at(w, light), place);
    if cap.w >= 0.0 {
        let normal = (sample_sphere_cone(place, cap.xyz, cap.w, u) - cap.xyz) / cap.w;
        return LightPoint(light, invert_uniform_sphere(select(vec3f(0.0, 0.0, 1.0), normal, vec3<bool>(is_finite3(normal)))));
    }
    //#endif
    return light_point_with(w, light, u);
}

fn light_emitter_towards(w: u32, light: u32, place: vec3f, u: vec2f) -> EmitterPoint {
    let at = light_at(w, light);
    //#if QUADRICS
    let cap = light_cap(at, place);
    if cap.w >= 0.0 {
        let position = sample_sphere_cone(place, cap.xyz, cap.w, u);
        var emitter = emitter_on_sphere(at, light, position, (position - cap.xyz) / cap.w);
        emitter.valid = emitter.valid && is_finite3(position);
        return emitter;
    }
    //#endif
    return light_emitter(w, light_point_with(w, light, u));
}

fn light_density_from(w: u32, light: u32, place: vec3f, squared: f32, cos_theta: f32) -> f32 {
    let at = light_at(w, light);
    //#if QUADRICS
    let cap = light_cap(at, place);
    if cap.w >= 0.0 {
        return uniform_cone_pdf(one_minus_cos_cone(place, cap.xyz, cap.w));
    }
    //#endif
    return squared / (float_word(at + 9u) * abs(cos_theta));
}

// Per unit solid angle at `place`, the choice of the light left out.
fn light_pdf_towards(w: u32, light: u32, place: vec3f, at: vec3f, cos_theta: f32) -> f32 {
    return light_density_from(w, light, place, length_squared(at - place), cos_theta);
}

fn light_density_towards(w: u32, point: LightPoint, place: vec3f, geometry_term: f32) -> f32 {
    //#if QUADRICS
    let cap = light_cap(light_at(w, point.light), place);
    if cap.w >= 0.0 {
        return choice_probability(w, point.light)
            * uniform_cone_pdf(one_minus_cos_cone(place, cap.xyz, cap.w)) * geometry_term;
    }
    //#endif
    return uniform_density(w, point);
}

// A point of `light` as path tracing wants it: per solid angle.
fn light_sample_towards(w: u32, light: u32, place: vec3f, u: vec2f) -> Incident {
    var incident: Incident;
    incident.valid = false;
    incident.emitter = light_emitter_towards(w, light, place, u);
    if !incident.emitter.valid {
        return incident;
    }
    if has_surface(incident.emitter.kind) {
        let facing = emitter_facing(w, incident.emitter, place);
        if !facing.valid {
            return incident;
        }
        incident.direction = facing.direction;
        incident.radiance = incident.emitter.radiance;
        incident.pdf = light_density_from(w, light, place, facing.squared, facing.cosine);
        incident.delta = incident.emitter.kind == UNMET;
        incident.valid = incident.pdf > 0.0 && is_finite(incident.pdf);
        return incident;
    }
    let arrival = emitter_towards(w, incident.emitter, place);
    incident.direction = arrival.direction;
    incident.radiance = arrival.radiance;
    incident.pdf = 1.0;
    incident.delta = true;
    incident.valid = arrival.valid;
    let at = light_at(w, light);
    //#if ENVIRONMENTS
    if ENVIRONMENTS && words[at] == ENVIRONMENT {
        incident.pdf = environment_pdf(words[at + 24u], arrival.direction);
        incident.delta = false;
        incident.valid = incident.pdf > 0.0;
    }
    //#endif
    return incident;
}

// The end of a shadow ray, off the light's surface; w is 0 at infinity.
fn shadow_end(w: u32, emitter: EmitterPoint, place: vec3f) -> vec4f {
    if emitter.kind == INFINITE {
        return vec4f(0.0);
    }
    if !has_surface(emitter.kind) {
        return vec4f(emitter.position, 1.0);
    }
    let side = copysign(1.0, dot3(place - emitter.position, emitter.normal));
    let at = light_at(w, emitter.light);
    var extent = abs(vector_word(at + 10u));
    if words[at] == TRIANGLE {
        extent += abs(vector_word(at + 13u)) + abs(vector_word(at + 16u));
    } else {
        extent += vec3f(float_word(at + 22u));
    }
    let error = gamma(8.0) * (abs(emitter.position) + extent);
    return vec4f(offset_origin(emitter.position, emitter.normal * side, error), 1.0);
}

// The light point at a hit of a surface light.
fn light_point_at(w: u32, light: u32, hit: Hit, position: vec3f) -> LightPoint {
    let at = light_at(w, light);
    //#if QUADRICS
    if QUADRICS && words[at] != TRIANGLE {
        let d = (position - vector_word(at + 10u)) / float_word(at + 22u);
        if words[at] == SPHERE {
            return LightPoint(light, invert_uniform_sphere(unit(d)));
        }
        return LightPoint(light, invert_disk(vec2f(dot3(d, vector_word(at + 16u)), dot3(d, vector_word(at + 19u)))));
    }
    //#endif
    let b1 = max(hit.u, 0.0);
    let b2 = max(hit.v, 0.0);
    return LightPoint(light, invert_uniform_triangle(vec3f(max(1.0 - b1 - b2, 0.0), b1, b2)));
}

fn same_kind(w: u32, light: u32, other_w: u32, other: u32) -> bool {
    return words[light_at(w, light)] == words[light_at(other_w, other)];
}

// --- The environment. Words: radiance, image or NONE, mapping, two matrices by column, cumulative
// rows and columns, cells, width, height, light.

const LATITUDE_LONGITUDE: u32 = 0u;

fn environment_number(w: u32, i: u32) -> u32 {
    return words[inputs.worlds[w].environments + i];
}

fn environment_light(environment: u32) -> u32 {
    return words[environment + 28u];
}

fn turned(at: u32, v: vec3f) -> vec3f {
    return vector_word(at) * v.x + vector_word(at + 3u) * v.y + vector_word(at + 6u) * v.z;
}

fn sphere_to_octahedral(d: vec3f) -> vec2f {
    let x = abs(d.x);
    let y = abs(d.y);
    let across = x * x + y * y;
    let r = sqrt(across / (1.0 + abs(d.z)));
    var phi = 0.0;
    if across != 0.0 {
        phi = atan2(y, x) * (2.0 / PI);
    }
    let v = phi * r;
    var uv = vec2f(r - v, v);
    if d.z < 0.0 {
        uv = vec2f(1.0 - v, 1.0 - (r - v));
    }
    return 0.5 * (vec2f(copysign(uv.x, d.x), copysign(uv.y, d.y)) + vec2f(1.0));
}

fn octahedral_to_sphere(p: vec2f) -> vec3f {
    let u = 2.0 * p.x - 1.0;
    let v = 2.0 * p.y - 1.0;
    let au = abs(u);
    let av = abs(v);
    let signed = 1.0 - (au + av);
    let r = 1.0 - abs(signed);
    var phi = 0.0;
    if r != 0.0 {
        phi = ((av - au) / r + 1.0) * (PI / 4.0);
    }
    let z = copysign(1.0 - r * r, signed);
    let sc = sin_cos_turn(phi / TAU);
    let across = r * sqrt(max(2.0 - r * r, 0.0));
    return vec3f(copysign(sc.y * across, u), copysign(sc.x * across, v), z);
}

fn to_square(mapping: u32, d: vec3f) -> vec2f {
    if mapping == LATITUDE_LONGITUDE {
        return vec2f(turn_of(d.x, d.y), atan2(sqrt(d.x * d.x + d.y * d.y), d.z) / PI);
    }
    return sphere_to_octahedral(d);
}

fn environment_fetch(image: u32, mapping: u32, at: vec2<i32>) -> vec3f {
    let n = vec2<i32>(i32(words[image + 2u]), i32(words[image + 3u]));
    var p = at;
    if mapping == LATITUDE_LONGITUDE {
        p.x = wrapped(p.x, n.x, REPEAT);
        p.y = clamp(p.y, 0, n.y - 1);
    } else {
        if p.x < 0 || p.x >= n.x {
            p.x = select(2 * n.x - 1 - p.x, -p.x - 1, p.x < 0);
            p.y = n.y - 1 - p.y;
        }
        if p.y < 0 || p.y >= n.y {
            p.y = select(2 * n.y - 1 - p.y, -p.y - 1, p.y < 0);
            p.x = n.x - 1 - p.x;
        }
        p = clamp(p, vec2<i32>(0), n - vec2<i32>(1));
    }
    return texel(image, u32(p.x), u32(p.y)).xyz;
}

fn environment_radiance(environment: u32, direction: vec3f) -> vec3f {
    let radiance = vector_word(environment);
    let image = words[environment + 3u];
    if image == NONE {
        return radiance;
    }
    let mapping = words[environment + 4u];
    let size = vec2f(f32(words[image + 2u]), f32(words[image + 3u]));
    let uv = to_square(mapping, unit(turned(environment + 5u, direction)));
    let position = uv * size - 0.5;
    let low = floor(position);
    let f = position - low;
    let at = vec2<i32>(low);
    let a = environment_fetch(image, mapping, at);
    let b = environment_fetch(image, mapping, at + vec2<i32>(1, 0));
    let c = environment_fetch(image, mapping, at + vec2<i32>(0, 1));
    let d = environment_fetch(image, mapping, at + vec2<i32>(1, 1));
    let top = a + (b - a) * f.x;
    let bottom = c + (d - c) * f.x;
    return radiance * (top + (bottom - top) * f.y);
}

// The interval of a cumulative table of `n` values that holds u, and the place inside it.
fn invert_cdf(at: u32, n: u32, fraction: f32) -> vec2f {
    let u = fraction * float_word(at + n - 1u);
    // The first value above u.
    var low = 0u;
    var high = n;
    loop {
        if low >= high {
            break;
        }
        let middle = (low + high) / 2u;
        if float_word(at + middle) <= u {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let index = clamp(low, 1u, n - 1u) - 1u;
    let begin = float_word(at + index);
    let width = float_word(at + index + 1u) - begin;
    if width > 0.0 {
        return vec2f(f32(index), min((u - begin) / width, 1.0 - 0.5 * EPSILON));
    }
    return vec2f(f32(index), 0.5);
}

// sin^2 and cos^2 of half the polar angle at a row's edges: north, south.
fn band_of(y: u32, height: f32) -> vec4f {
    let half_step = 0.5 * PI / height;
    // A quarter turn holds all of it.
    let n = sin_cos_turn(half_step * f32(y) / TAU);
    let s = sin_cos_turn(half_step * f32(y + 1u) / TAU);
    return vec4f(n.x * n.x, s.x * s.x, n.y * n.y, s.y * s.y);
}

fn texel_solid_angle(mapping: u32, y: u32, size: vec2f) -> f32 {
    if mapping == LATITUDE_LONGITUDE {
        // A quarter turn is half of the picture's height, so a turn takes no detour by π.
        let step = 0.25 / size.y;
        let from_pole = min(f32(y), size.y - 1.0 - f32(y));
        let sines = sin_cos_turn(step * (2.0 * from_pole + 1.0)).x * sin_cos_turn(step).x;
        return 2.0 * TAU / size.x * sines;
    }
    return 2.0 * TAU / (size.x * size.y);
}

fn environment_sample(environment: u32, u: vec2f) -> vec3f {
    let image = words[environment + 3u];
    if image == NONE {
        return unit(turned(environment + 14u, sample_uniform_sphere(u)));
    }
    let width = words[environment + 26u];
    let height = words[environment + 27u];
    let row = invert_cdf(words[environment + 23u], height + 1u, u.y);
    let y = u32(row.x);
    let column = invert_cdf(words[environment + 24u] + y * (width + 1u), width + 1u, u.x);
    let size = vec2f(f32(width), f32(height));
    var local: vec3f;
    if words[environment + 4u] == LATITUDE_LONGITUDE {
        let band = band_of(y, size.y);
        let sin2 = band.x + row.y * (band.y - band.x);
        let cos2 = band.z + row.y * (band.w - band.z);
        let sc = sin_cos_turn((column.x + column.y) / size.x);
        let sin_theta = 2.0 * sqrt(sin2 * cos2);
        local = vec3f(sin_theta * sc.y, sin_theta * sc.x, cos2 - sin2);
    } else {
        local = octahedral_to_sphere(vec2f(column.x + column.y, row.x + row.y) / size);
    }
    return unit(turned(environment + 14u, local));
}

struct Cell {
    x: u32,
    y: u32,
    inside: vec2f,
}

fn to_cell(environment: u32, direction: vec3f) -> Cell {
    let width = words[environment + 26u];
    let height = words[environment + 27u];
    let mapping = words[environment + 4u];
    let position = to_square(mapping, direction) * vec2f(f32(width), f32(height));
    let x = min(u32(position.x), width - 1u);
    let y = min(u32(position.y), height - 1u);
    if mapping != LATITUDE_LONGITUDE {
        return Cell(x, y, position - vec2f(f32(x), f32(y)));
    }
    let band = band_of(y, f32(height));
    let across = direction.x * direction.x + direction.y * direction.y;
    var t: f32;
    if direction.z >= 0.0 {
        t = (0.5 * across / (1.0 + direction.z) - band.x) / (band.y - band.x);
    } else {
        t = (0.5 * across / (1.0 - direction.z) - band.z) / (band.w - band.z);
    }
    return Cell(x, y, vec2f(position.x - f32(x), clamp(t, 0.0, 1.0)));
}

fn environment_pdf(environment: u32, direction: vec3f) -> f32 {
    if words[environment + 3u] == NONE {
        return 1.0 / (4.0 * PI);
    }
    let cell = to_cell(environment, unit(turned(environment + 5u, direction)));
    let width = words[environment + 26u];
    let size = vec2f(f32(width), f32(words[environment + 27u]));
    return float_word(words[environment + 25u] + cell.y * width + cell.x)
        / texel_solid_angle(words[environment + 4u], cell.y, size);
}

// (u, v, 1), or zeros where the density is 0.
fn environment_invert(environment: u32, direction: vec3f) -> vec3f {
    let local = unit(turned(environment + 5u, direction));
    if words[environment + 3u] == NONE {
        return vec3f(invert_uniform_sphere(local), 1.0);
    }
    let cell = to_cell(environment, local);
    let width = words[environment + 26u];
    if !(float_word(words[environment + 25u] + cell.y * width + cell.x) > 0.0) {
        return vec3f(0.0);
    }
    let row = words[environment + 24u] + cell.y * (width + 1u) + cell.x;
    let rows = words[environment + 23u] + cell.y;
    return vec3f(
        float_word(row) + cell.inside.x * (float_word(row + 1u) - float_word(row)),
        float_word(rows) + cell.inside.y * (float_word(rows + 1u) - float_word(rows)),
        1.0,
    );
}

fn escaped_radiance(w: u32, direction: vec3f) -> vec3f {
    var sum = vec3f(0.0);
    //#if ENVIRONMENTS
    if ENVIRONMENTS {
        for (var i = 0u; i < inputs.worlds[w].environment_count; i++) {
            sum += environment_radiance(environment_number(w, i), direction);
        }
    }
    //#endif
    return sum;
}
