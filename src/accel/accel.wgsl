// Twin of `accel`: the same trees and the same order of tests, in f32. What the CPU proves in f64
// is here an error bound that a hit must exceed (Pharr, Jakob, Humphreys 2023, section 6.8): a hit
// that cannot be told from the ray's own surface is none.

struct Ray {
    origin: vec3f,
    direction: vec3f,
    t_max: f32,
}

struct Hit {
    t: f32,
    u: f32,
    v: f32,
    primitive: u32,
    instance: u32,
}

const MISS: u32 = 0xffffffffu;
const LEAF: u32 = 0x80000000u;
const SLOTS: u32 = 0x1fffffffu;
const MAX_COORDINATE: f32 = 1e18;
const ROUNDING: f32 = 8.0 * EPSILON;

// A tree over primitives: where it lies in the arenas.
struct Bottom {
    nodes: u32,
    slots: u32,
    cold: u32,
    // 1: anything but triangles; 2: its space is the world.
    flags: u32,
    reach: f32,
    placements: u32,
}

fn bottom_of_world(w: u32) -> Bottom {
    return Bottom(
        inputs.worlds[w].bottom_nodes,
        inputs.worlds[w].bottom_slots,
        inputs.worlds[w].bottom_cold,
        inputs.worlds[w].bottom_flags,
        inputs.worlds[w].bottom_reach,
        inputs.worlds[w].placements,
    );
}

fn emitters_of_world(w: u32) -> Bottom {
    return Bottom(
        inputs.worlds[w].emitter_nodes,
        inputs.worlds[w].emitter_slots,
        inputs.worlds[w].emitter_cold,
        inputs.worlds[w].emitter_flags,
        inputs.worlds[w].emitter_reach,
        inputs.worlds[w].emitter_placements,
    );
}

// Placements: rows to object space, rows to world space, (first shape, nodes, slots, cold), (flags,
// reach, ., .).
const PLACEMENT: u32 = 8u;
const IDENTITY: u32 = 4u;

fn placement_at(placements: u32, instance: u32) -> u32 {
    return placements + instance * PLACEMENT;
}

fn bottom_of_instance(w: u32, instance: u32) -> Bottom {
    if !TWO_LEVEL {
        return bottom_of_world(w);
    }
    let at = placement_at(inputs.worlds[w].placements, instance);
    let a = nodes[at + 6u];
    let b = nodes[at + 7u];
    return Bottom(a.y, a.z, a.w, b.x, bitcast<f32>(b.y), inputs.worlds[w].placements);
}

fn row_point(at: u32, p: vec3f) -> vec3f {
    let x = bitcast<vec4f>(nodes[at]);
    let y = bitcast<vec4f>(nodes[at + 1u]);
    let z = bitcast<vec4f>(nodes[at + 2u]);
    return vec3f(dot3(x.xyz, p) + x.w, dot3(y.xyz, p) + y.w, dot3(z.xyz, p) + z.w);
}

fn row_vector(at: u32, v: vec3f) -> vec3f {
    let x = bitcast<vec4f>(nodes[at]);
    let y = bitcast<vec4f>(nodes[at + 1u]);
    let z = bitcast<vec4f>(nodes[at + 2u]);
    return vec3f(dot3(x.xyz, v), dot3(y.xyz, v), dot3(z.xyz, v));
}

// Sum of the magnitudes that a point with component magnitudes p is transformed with.
fn row_magnitude(at: u32, p: vec3f) -> vec3f {
    let x = abs(bitcast<vec4f>(nodes[at]));
    let y = abs(bitcast<vec4f>(nodes[at + 1u]));
    let z = abs(bitcast<vec4f>(nodes[at + 2u]));
    return vec3f(dot3(x.xyz, p) + x.w, dot3(y.xyz, p) + y.w, dot3(z.xyz, p) + z.w);
}

// By the transpose of the rows to object space.
fn normal_to_world(placement: u32, n: vec3f) -> vec3f {
    let x = bitcast<vec4f>(nodes[placement]);
    let y = bitcast<vec4f>(nodes[placement + 1u]);
    let z = bitcast<vec4f>(nodes[placement + 2u]);
    return x.xyz * n.x + y.xyz * n.y + z.xyz * n.z;
}

// A ray in some tree's space, with bounds on what its transformation cost.
struct LocalRay {
    origin: vec3f,
    direction: vec3f,
    origin_error: vec3f,
    direction_error: vec3f,
}

fn world_ray(ray: Ray) -> LocalRay {
    return LocalRay(ray.origin, ray.direction, vec3f(0.0), vec3f(0.0));
}

fn ray_to_object(placement: u32, ray: LocalRay) -> LocalRay {
    let x = abs(bitcast<vec4f>(nodes[placement]));
    let y = abs(bitcast<vec4f>(nodes[placement + 1u]));
    let z = abs(bitcast<vec4f>(nodes[placement + 2u]));
    let d = abs(ray.direction);
    // Rows are rounded to f32, three products and sums follow.
    return LocalRay(
        row_point(placement, ray.origin),
        row_vector(placement, ray.direction),
        gamma(5.0) * row_magnitude(placement, abs(ray.origin)),
        gamma(4.0) * vec3f(dot3(x.xyz, d), dot3(y.xyz, d), dot3(z.xyz, d)),
    );
}

struct BoxRay {
    origin: vec3f,
    inverse: vec3f,
    slack: vec3f,
    // Relative error of plane distances.
    rounding: vec3f,
}

fn box_ray(ray: LocalRay, reach: f32) -> BoxRay {
    let magnitude = abs(ray.direction);
    let m = max3(magnitude);
    let limit = m * (1.0 / 1073741824.0);
    var inverse = vec3f(1.0) / ray.direction;
    var slack = vec3f(0.0);
    let range = 2.0 * (max3(abs(ray.origin)) + reach) / m;
    for (var axis = 0u; axis < 3u; axis++) {
        if magnitude[axis] < limit {
            inverse[axis] = copysign(1.0 / limit, ray.direction[axis]);
            slack[axis] = range;
        }
    }
    slack += ray.origin_error * abs(inverse);
    return BoxRay(ray.origin, inverse, slack, vec3f(ROUNDING) + ray.direction_error * abs(inverse));
}

// Children that wait, nearest on top; trees share it, each from a base of its own.
var<private> stack: array<vec2<u32>, STACK>;

struct Leaves {
    nodes: u32,
    base: u32,
    top: u32,
}

fn all_leaves(root: u32, base: u32) -> Leaves {
    stack[base] = vec2<u32>(0u, 0u);
    return Leaves(root, base, base + 1u);
}

fn byte_of(w: vec2<u32>, i: u32) -> u32 {
    return (select(w.x, w.y, i >= 4u) >> ((i & 3u) * 8u)) & 255u;
}

fn spacing(e: u32) -> f32 {
    return bitcast<f32>((e & 255u) << 23u);
}

// The next leaf that the ray may hit before `limit`: a count in bits 29 and 30, the first primitive
// below; NONE at the end.
fn next_leaf(it: ptr<function, Leaves>, ray: BoxRay, limit: f32, ordered: bool) -> u32 {
    loop {
        if (*it).top == (*it).base {
            return NONE;
        }
        (*it).top -= 1u;
        let entry = stack[(*it).top];
        if bitcast<f32>(entry.y) > limit {
            continue;
        }
        if (entry.x & LEAF) != 0u {
            return entry.x;
        }
        let at = (*it).nodes + entry.x * 5u;
        let n0 = nodes[at];
        let n1 = nodes[at + 1u];
        let n2 = nodes[at + 2u];
        let n3 = nodes[at + 3u];
        let n4 = nodes[at + 4u];
        let p = bitcast<vec3f>(n0.xyz);
        let extent = vec3f(spacing(n0.w), spacing(n0.w >> 8u), spacing(n0.w >> 16u));
        let imask = n0.w >> 24u;
        let meta_bytes = n1.zw;
        let b = extent * ray.inverse;
        let a = (p - ray.origin) * ray.inverse;
        let slack = (abs(a) + abs(b) * 255.0) * ray.rounding + ray.slack;
        let low = a - slack;
        let high = a + slack;
        let back = ray.inverse < vec3f(0.0);
        let near_x = select(n2.xy, n2.zw, back.x);
        let far_x = select(n2.zw, n2.xy, back.x);
        let near_y = select(n3.xy, n3.zw, back.y);
        let far_y = select(n3.zw, n3.xy, back.y);
        let near_z = select(n4.xy, n4.zw, back.z);
        let far_z = select(n4.zw, n4.xy, back.z);
        let base = (*it).top;
        for (var i = 0u; i < 8u; i++) {
            let meta_byte = byte_of(meta_bytes, i);
            if meta_byte == 0u {
                continue;
            }
            let enter = vec3f(f32(byte_of(near_x, i)), f32(byte_of(near_y, i)), f32(byte_of(near_z, i))) * b + low;
            let leave = vec3f(f32(byte_of(far_x, i)), f32(byte_of(far_y, i)), f32(byte_of(far_z, i))) * b + high;
            let near = max(max3(enter), 0.0);
            let far = min(min(leave.x, min(leave.y, leave.z)), limit);
            if !(near <= far) {
                continue;
            }
            var child: u32;
            if ((imask >> i) & 1u) != 0u {
                child = n1.x + countOneBits(imask & ((1u << i) - 1u));
            } else {
                child = LEAF | (countOneBits(meta_byte >> 5u) << 29u) | (n1.y + (meta_byte & 31u));
            }
            var place = (*it).top;
            if ordered {
                loop {
                    if place == base || bitcast<f32>(stack[place - 1u].y) >= near {
                        break;
                    }
                    stack[place] = stack[place - 1u];
                    place -= 1u;
                }
            }
            stack[place] = vec2<u32>(child, bitcast<u32>(near));
            (*it).top += 1u;
        }
    }
    return NONE;
}

struct TriangleRay {
    axis: u32,
    // Along i, j, k.
    origin: vec3f,
    shear: vec3f,
    origin_error: vec3f,
    shear_error: vec2f,
}

// (i, j, k) of a vector, k being the ray's longest axis.
fn permuted(v: vec3f, axis: u32) -> vec3f {
    return select(select(v.xyz, v.zxy, axis == 1u), v.yzx, axis == 0u);
}

fn triangle_ray(ray: LocalRay) -> TriangleRay {
    let a = abs(ray.direction);
    var axis = 2u;
    if a.x > a.y {
        axis = select(2u, 0u, a.x > a.z);
    } else {
        axis = select(2u, 1u, a.y > a.z);
    }
    let d = permuted(ray.direction, axis);
    let inverse = 1.0 / d.z;
    let e = permuted(ray.direction_error, axis);
    // |s| <= 1: the error of a quotient of two that are off.
    let shear_error = (e.xy + e.zz) * abs(inverse);
    return TriangleRay(
        axis,
        permuted(ray.origin, axis),
        vec3f(d.xy * inverse, inverse),
        permuted(ray.origin_error, axis),
        shear_error,
    );
}

struct Crossing {
    t: f32,
    u: f32,
    v: f32,
    // Bound on t's error; negative where there is no crossing.
    error: f32,
}

const NO_CROSSING: Crossing = Crossing(0.0, 0.0, 0.0, -1.0);

fn cross_triangle(slot: u32, ray: TriangleRay, limit: f32) -> Crossing {
    let xs = bitcast<vec4f>(geometry[slot]).xyz;
    let ys = bitcast<vec4f>(geometry[slot + 1u]).xyz;
    let zs = bitcast<vec4f>(geometry[slot + 2u]).xyz;
    var i = ys;
    var j = zs;
    var k = xs;
    if ray.axis == 1u {
        i = zs;
        j = xs;
        k = ys;
    } else if ray.axis == 2u {
        i = xs;
        j = ys;
        k = zs;
    }
    let z = k - ray.origin.z;
    let raw_x = i - ray.origin.x;
    let raw_y = j - ray.origin.y;
    let x = raw_x - ray.shear.x * z;
    let y = raw_y - ray.shear.y * z;
    let e = vec3f(x.z * y.y - y.z * x.y, x.x * y.z - y.x * x.z, x.y * y.x - y.y * x.x);
    let negative = e.x < 0.0 || e.y < 0.0 || e.z < 0.0;
    let positive = e.x > 0.0 || e.y > 0.0 || e.z > 0.0;
    if negative == positive {
        return NO_CROSSING;
    }
    let det = e.x + e.y + e.z;
    if det == 0.0 {
        return NO_CROSSING;
    }
    let inverse = 1.0 / det;
    let sum = e.x * z.x + e.y * z.y + e.z * z.z;
    let t = sum * (ray.shear.z * inverse);
    if !(t > 0.0 && t <= limit) {
        return NO_CROSSING;
    }
    // u = 2^-24. A difference costs 1 u of itself, the shear 3 u of a product with a factor <= 1,
    // the last difference 1 u.
    const U: f32 = 0.5 * EPSILON;
    let most_z = max3(abs(z));
    let delta_z = U * most_z + ray.origin_error.z;
    let delta_x = U * (2.0 * max3(abs(raw_x)) + 6.0 * most_z)
        + ray.origin_error.x + ray.origin_error.z + ray.shear_error.x * most_z;
    let delta_y = U * (2.0 * max3(abs(raw_y)) + 6.0 * most_z)
        + ray.origin_error.y + ray.origin_error.z + ray.shear_error.y * most_z;
    let most_x = max3(abs(x));
    let most_y = max3(abs(y));
    let delta_e = 2.0 * (delta_x * most_y + delta_y * most_x) + 3.0 * U * most_x * most_y;
    let most_e = max3(abs(e));
    let delta_sum = 3.0 * (delta_e * most_z + delta_z * most_e + 3.0 * U * most_e * most_z);
    // t > its error, multiplied by |det d_k|.
    if !(abs(sum) > delta_sum) {
        return NO_CROSSING;
    }
    let error = (delta_sum * abs(ray.shear.z) + 3.0 * delta_e * t) * abs(inverse);
    return Crossing(t, e.y * inverse, e.z * inverse, error);
}

// A hit's t and its uncertainty from a rounded direction, 2^-24 sum |n_i d_i| / |n.d|, and from the
// test, at or beyond the end.
fn past_end(t: f32, error: f32, normal: vec3f, direction: vec3f, limit: f32) -> bool {
    let product = normal * direction;
    let relative = 0.5 * EPSILON * dot3(abs(product), vec3f(1.0)) / abs(product.x + product.y + product.z);
    return t * (1.0 + relative) + error >= limit;
}

// A search in progress, in the units of a ray whose direction is neither long nor short.
struct Search {
    w: u32,
    any: bool,
    found: bool,
    // Whether the caller's ray ends somewhere.
    ends: bool,
    limit: f32,
    unit: f32,
    direction: vec3f,
    best: Hit,
    caller: Ray,
}

fn cold_at(cold: u32, primitive: u32) -> u32 {
    return cold + primitive * 6u;
}

//#if ONE_SIDED_SHAPES
// Whether the search in progress is a camera ray's, which passes the backs of one-sided surfaces.
var<private> passes_backs: bool = false;
//#endif

fn rank_before(w: u32, a: Hit, b: Hit) -> bool {
    let ca = geometry[cold_at(bottom_of_instance(w, a.instance).cold, a.primitive)];
    let cb = geometry[cold_at(bottom_of_instance(w, b.instance).cold, b.primitive)];
    // (shape, element, instance, smooth)
    if a.instance != b.instance {
        return a.instance < b.instance;
    }
    if ca.x != cb.x {
        return ca.x < cb.x;
    }
    return ca.y < cb.y;
}

fn offer(s: ptr<function, Search>, t: f32, u: f32, v: f32, primitive: u32, instance: u32) -> bool {
    if t > (*s).limit {
        return false;
    }
    let hit = Hit(t * (*s).unit, u, v, primitive, instance);
    if t == (*s).limit && (!(*s).found || !rank_before((*s).w, hit, (*s).best)) {
        return false;
    }
    //#if ONE_SIDED_SHAPES
    if ONE_SIDED_SHAPES && passes_backs && is_hidden_back((*s).w, (*s).caller, hit) {
        return false;
    }
    //#endif
    //#if COVERAGE
    if COVERAGE && !covers((*s).w, (*s).caller, hit) {
        return false;
    }
    //#endif
    (*s).limit = t;
    (*s).best = hit;
    (*s).found = true;
    return true;
}

//#if QUADRICS
// Parameters of the hits with a sphere, ascending; -1 is none.
fn sphere_roots(center: vec3f, radius: f32, origin: vec3f, direction: vec3f, smallest: f32) -> vec2f {
    let o = origin - center;
    let a = dot3(direction, direction);
    let b = -dot3(o, direction);
    let off = o + direction * (b / a);
    let discriminant = radius * radius - dot3(off, off);
    if !(discriminant >= 0.0) {
        return vec2f(-1.0);
    }
    let q = b + copysign(sqrt(a * discriminant), b);
    let length = sqrt(dot3(o, o));
    let c = (length - radius) * (length + radius);
    if q == 0.0 {
        return vec2f(-1.0);
    }
    let t0 = c / q;
    let t1 = q / a;
    let near = min(t0, t1);
    let far = max(t0, t1);
    return vec2f(select(-1.0, near, near > smallest), select(-1.0, far, far > smallest));
}

// Roots nearer than this to 0 are not told from the origin's own surface: 2^-18 of what the
// quadratic's terms are made of, 32 times its roundings.
fn near_bound(o: vec3f, radius: f32, direction: vec3f, origin_error: vec3f) -> f32 {
    const BOUND: f32 = 1.0 / 262144.0;
    return (BOUND * (sqrt(dot3(o, o)) + radius) + 4.0 * max3(origin_error)) / sqrt(dot3(direction, direction));
}
//#endif

fn disk_tangents(normal: vec3f) -> Frame {
    return frame_from_normal(normal);
}

//#if QUADRICS
// Where a ray meets a sphere or a disk, at most twice.
struct QuadricCrossings {
    instance: u32,
    // Ascending; -1 is none.
    t: vec2f,
    uv: vec4f,
    error: f32,
    // In object space.
    normal_a: vec3f,
    normal_b: vec3f,
}

fn cross_quadric(bottom: Bottom, ray: LocalRay, number: u32, known_instance: u32, kind: f32) -> QuadricCrossings {
    let slot = bottom.slots + number * 3u;
    let xs = bitcast<vec4f>(geometry[slot]);
    let ys = bitcast<vec4f>(geometry[slot + 1u]);
    let zs = bitcast<vec4f>(geometry[slot + 2u]);
    var found: QuadricCrossings;
    found.t = vec2f(-1.0);
    found.instance = known_instance;
    if known_instance == NONE {
        found.instance = geometry[cold_at(bottom.cold, number)].z;
    }
    let placement = placement_at(bottom.placements, found.instance);
    var local = ray;
    if (bottom.flags & 2u) != 0u && (nodes[placement + 7u].x & IDENTITY) == 0u {
        local = ray_to_object(placement, ray);
    }
    let center = vec3f(xs.x, ys.x, zs.x);
    let radius = xs.y;
    let o = local.origin - center;
    found.error = near_bound(o, radius, local.direction, local.origin_error);
    if kind == 1.0 {
        found.t = sphere_roots(center, radius, local.origin, local.direction, found.error);
        found.normal_a = o + local.direction * found.t.x;
        found.normal_b = o + local.direction * found.t.y;
        found.uv = vec4f(octahedral_encode(unit(found.normal_a)), octahedral_encode(unit(found.normal_b)));
        return found;
    }
    let normal = unit(vec3f(xs.z, ys.z, zs.z));
    let t = -dot3(o, normal) / dot3(local.direction, normal);
    if !is_finite(t) {
        return found;
    }
    let off = o + local.direction * t;
    let at = off - normal * dot3(off, normal);
    if !(dot3(at, at) <= radius * radius && t > found.error) {
        return found;
    }
    let f = disk_tangents(normal);
    found.t.x = t;
    found.normal_a = normal;
    found.uv = vec4f(dot3(at, f.tangent) / radius, dot3(at, f.bitangent) / radius, 0.0, 0.0);
    return found;
}

fn offer_quadric(
    s: ptr<function, Search>,
    bottom: Bottom,
    ray: LocalRay,
    number: u32,
    known_instance: u32,
    kind: f32,
) -> bool {
    let found = cross_quadric(bottom, ray, number, known_instance, kind);
    let placement = placement_at(bottom.placements, found.instance);
    for (var i = 0u; i < 2u; i++) {
        let first = i == 0u;
        let t = select(found.t.y, found.t.x, first);
        if t < 0.0 {
            continue;
        }
        let normal = select(found.normal_b, found.normal_a, first);
        if (*s).any && (*s).ends
            && past_end(t, found.error, normal_to_world(placement, normal), (*s).direction, (*s).limit) {
            continue;
        }
        let uv = select(found.uv.zw, found.uv.xy, first);
        if offer(s, t, uv.x, uv.y, number, found.instance) && (*s).any {
            return true;
        }
    }
    return false;
}
//#endif

fn single(
    s: ptr<function, Search>,
    bottom: Bottom,
    local: LocalRay,
    triangle: TriangleRay,
    number: u32,
    instance: u32,
) -> bool {
    let slot = bottom.slots + number * 3u;
    //#if QUADRICS
    if QUADRICS && (bottom.flags & 1u) != 0u {
        let kind = bitcast<f32>(geometry[slot].w);
        if kind != 0.0 {
            return offer_quadric(s, bottom, local, number, instance, kind);
        }
    }
    //#endif
    let crossing = cross_triangle(slot, triangle, (*s).limit);
    if crossing.error < 0.0 {
        return false;
    }
    if (*s).any && (*s).ends {
        let xs = bitcast<vec4f>(geometry[slot]);
        let ys = bitcast<vec4f>(geometry[slot + 1u]);
        let zs = bitcast<vec4f>(geometry[slot + 2u]);
        let e1 = vec3f(xs.y - xs.x, ys.y - ys.x, zs.y - zs.x);
        let e2 = vec3f(xs.z - xs.x, ys.z - ys.x, zs.z - zs.x);
        // In the ray's own space: n.d keeps its value under the transform.
        if past_end(crossing.t, crossing.error, cross(e1, e2), local.direction, (*s).limit) {
            return false;
        }
    }
    var place = instance;
    if place == NONE {
        place = geometry[cold_at(bottom.cold, number)].z;
    }
    return offer(s, crossing.t, crossing.u, crossing.v, number, place) && (*s).any;
}

// Whether a leaf ended the search.
fn search_bottom(
    s: ptr<function, Search>,
    bottom: Bottom,
    ray: LocalRay,
    instance: u32,
    base: u32,
) -> bool {
    let boxes = box_ray(ray, bottom.reach);
    let triangle = triangle_ray(ray);
    var leaves = all_leaves(bottom.nodes, base);
    loop {
        let leaf = next_leaf(&leaves, boxes, (*s).limit, !(*s).any);
        if leaf == NONE {
            return false;
        }
        var first = leaf & SLOTS;
        var end = first + ((leaf >> 29u) & 3u);
        // A group stands for a range of slots behind all others.
        var resume = end;
        var number = first;
        loop {
            if number >= end {
                if end == resume {
                    break;
                }
                number = first;
                end = resume;
                if number >= end {
                    break;
                }
            }
            let head = geometry[bottom.slots + number * 3u];
            if (bottom.flags & 1u) != 0u && end == resume && bitcast<f32>(head.w) == 3.0 {
                let members = geometry[bottom.slots + number * 3u + 1u].x;
                first = number + 1u;
                number = head.x;
                end = head.x + members;
                continue;
            }
            if single(s, bottom, ray, triangle, number, instance) {
                return true;
            }
            number += 1u;
        }
    }
    return false;
}

// An exponent of 2 that brings the direction's largest component to [1, 2).
fn unit_of(m: f32) -> f32 {
    if m >= 1.0 / 65536.0 && m <= 65536.0 {
        return 1.0;
    }
    return bitcast<f32>((254u - ((bitcast<u32>(m) >> 23u) & 255u)) << 23u);
}

fn query(w: u32, ray: Ray, any: bool) -> Search {
    let m = max3(abs(ray.direction));
    var s: Search;
    s.w = w;
    s.any = any;
    s.found = false;
    s.caller = ray;
    s.best = Hit(0.0, 0.0, 0.0, MISS, MISS);
    let valid = is_finite3(ray.direction) && max3(abs(ray.origin)) <= MAX_COORDINATE && m > 0.0 && ray.t_max > 0.0;
    if !valid {
        return s;
    }
    let unit_length = unit_of(m);
    s.unit = unit_length;
    s.ends = ray.t_max < FAR;
    s.limit = min(ray.t_max / unit_length, FAR);
    s.direction = ray.direction * unit_length;
    let local = LocalRay(ray.origin, s.direction, vec3f(0.0), vec3f(0.0));
    //#if !TWO_LEVEL
    if !TWO_LEVEL {
        let bottom = bottom_of_world(w);
        if bottom.nodes != NONE {
            search_bottom(&s, bottom, local, NONE, 0u);
        }
        return s;
    }
    //#else
    let root = inputs.worlds[w].top_nodes;
    if root == NONE {
        return s;
    }
    let boxes = box_ray(local, inputs.worlds[w].top_reach);
    var leaves = all_leaves(root, 0u);
    loop {
        let leaf = next_leaf(&leaves, boxes, s.limit, !any);
        if leaf == NONE {
            return s;
        }
        let first = leaf & SLOTS;
        let end = first + ((leaf >> 29u) & 3u);
        for (var i = first; i < end; i++) {
            let instance = words[inputs.worlds[w].top_order + i];
            let bottom = bottom_of_instance(w, instance);
            if bottom.nodes == NONE {
                continue;
            }
            var inside = local;
            if (bottom.flags & IDENTITY) == 0u {
                inside = ray_to_object(placement_at(bottom.placements, instance), local);
            }
            if search_bottom(&s, bottom, inside, instance, leaves.top) {
                return s;
            }
        }
    }
    //#endif
    return s;
}

fn closest_hit(w: u32, ray: Ray) -> Hit {
    return query(w, ray, false).best;
}

fn occluded(w: u32, ray: Ray) -> bool {
    return query(w, ray, true).found;
}

// The geometry at a hit, in world space.
struct HitPoint {
    position: vec3f,
    error: vec3f,
    geometric_normal: vec3f,
    shading_normal: vec3f,
    uv: vec2f,
    shape: u32,
    element: u32,
    instance: u32,
}

//#if QUADRICS
fn quadric_point(bottom: Bottom, hit: Hit, cold: vec4<u32>, first_shape: u32) -> HitPoint {
    let placement = placement_at(bottom.placements, hit.instance);
    let slot = bottom.slots + hit.primitive * 3u;
    let xs = bitcast<vec4f>(geometry[slot]);
    let ys = bitcast<vec4f>(geometry[slot + 1u]);
    let zs = bitcast<vec4f>(geometry[slot + 2u]);
    let center = vec3f(xs.x, ys.x, zs.x);
    let radius = xs.y;
    let side = select(1.0, -1.0, (cold.w & 2u) != 0u);
    var at: vec3f;
    var normal: vec3f;
    var uv: vec2f;
    if xs.w == 1.0 {
        normal = octahedral_decode(vec2f(hit.u, hit.v));
        at = normal * radius;
        uv = uv_on_sphere(normal);
    } else {
        normal = unit(vec3f(xs.z, ys.z, zs.z));
        let f = disk_tangents(normal);
        at = (f.tangent * hit.u + f.bitangent * hit.v) * radius;
        uv = vec2f(turn_of(hit.u, hit.v), 1.0 - sqrt(hit.u * hit.u + hit.v * hit.v));
    }
    let position = row_point(placement + 3u, center + at);
    // Decoding, two products and sums, then the transform's.
    let error = gamma(12.0) * row_magnitude(placement + 3u, abs(center) + vec3f(radius));
    let world_normal = unit(normal_to_world(placement, normal * side));
    return HitPoint(position, error, world_normal, world_normal, uv, first_shape + cold.x, cold.y, hit.instance);
}
//#endif

// Azimuth from +x and polar angle from -z, both in [0, 1].
fn uv_on_sphere(normal: vec3f) -> vec2f {
    let across = sqrt(normal.x * normal.x + normal.y * normal.y);
    return vec2f(turn_of(normal.x, normal.y), 1.0 - atan2(across, normal.z) / PI);
}

fn point_in(w: u32, bottom: Bottom, hit: Hit, placed: bool) -> HitPoint {
    let at = cold_at(bottom.cold, hit.primitive);
    let cold = geometry[at];
    let placement = placement_at(bottom.placements, hit.instance);
    var first_shape = 0u;
    if placed {
        first_shape = nodes[placement + 6u].x;
    }
    let slot = bottom.slots + hit.primitive * 3u;
    let xs = bitcast<vec4f>(geometry[slot]);
    //#if QUADRICS
    if QUADRICS && (bottom.flags & 1u) != 0u && xs.w != 0.0 {
        return quadric_point(bottom, hit, cold, first_shape);
    }
    //#endif
    let ys = bitcast<vec4f>(geometry[slot + 1u]);
    let zs = bitcast<vec4f>(geometry[slot + 2u]);
    let weights = vec3f(1.0 - hit.u - hit.v, hit.u, hit.v);
    var position = vec3f(dot3(xs.xyz, weights), dot3(ys.xyz, weights), dot3(zs.xyz, weights));
    let magnitude = vec3f(
        dot3(abs(xs.xyz), abs(weights)),
        dot3(abs(ys.xyz), abs(weights)),
        dot3(abs(zs.xyz), abs(weights)),
    );
    var error = gamma(7.0) * magnitude;
    let c1 = geometry[at + 1u];
    let c2 = geometry[at + 2u];
    let c3 = geometry[at + 3u];
    let c4 = geometry[at + 4u];
    let c5 = geometry[at + 5u];
    var normal = bitcast<vec3f>(c1.xyz);
    var shading = normal;
    if (cold.w & 1u) != 0u {
        let n0 = bitcast<vec3f>(vec3<u32>(c1.w, c2.x, c2.y));
        let n1 = bitcast<vec3f>(vec3<u32>(c2.z, c2.w, c3.x));
        let n2 = bitcast<vec3f>(vec3<u32>(c3.y, c3.z, c3.w));
        let n = n0 * weights.x + n1 * weights.y + n2 * weights.z;
        let squared = dot3(n, n);
        if squared > 0.0 && is_finite(squared) && dot3(n, normal) > 0.0 {
            shading = n / sqrt(squared);
        }
    }
    //#if TWO_LEVEL
    if placed {
        position = row_point(placement + 3u, position);
        error = row_magnitude(placement + 3u, magnitude) * gamma(11.0);
        normal = unit(normal_to_world(placement, normal));
        shading = unit(normal_to_world(placement, shading));
        if !(dot3(shading, normal) > 0.0) {
            shading = normal;
        }
    }
    //#endif
    let uv0 = bitcast<vec2f>(c4.xy);
    let uv1 = bitcast<vec2f>(c4.zw);
    let uv2 = bitcast<vec2f>(c5.xy);
    let uv = uv0 * weights.x + uv1 * weights.y + uv2 * weights.z;
    return HitPoint(
        position,
        error + vec3f(MIN_POSITIVE),
        normal,
        shading,
        uv,
        first_shape + cold.x,
        cold.y,
        hit.instance,
    );
}

fn point_at(w: u32, hit: Hit) -> HitPoint {
    return point_in(w, bottom_of_instance(w, hit.instance), hit, TWO_LEVEL);
}

// Running shape number and element.
fn shape_of(w: u32, hit: Hit) -> vec2<u32> {
    let bottom = bottom_of_instance(w, hit.instance);
    let cold = geometry[cold_at(bottom.cold, hit.primitive)];
    var first = 0u;
    if TWO_LEVEL {
        first = nodes[placement_at(bottom.placements, hit.instance) + 6u].x;
    }
    return vec2<u32>(first + cold.x, cold.y);
}

// Derivative of position along the first texture coordinate.
fn tangent_at(w: u32, hit: Hit, geometric_normal: vec3f) -> vec3f {
    let bottom = bottom_of_instance(w, hit.instance);
    let placement = placement_at(bottom.placements, hit.instance);
    let slot = bottom.slots + hit.primitive * 3u;
    let xs = bitcast<vec4f>(geometry[slot]);
    let ys = bitcast<vec4f>(geometry[slot + 1u]);
    let zs = bitcast<vec4f>(geometry[slot + 2u]);
    var dpdu: vec3f;
    if QUADRICS && (bottom.flags & 1u) != 0u && xs.w != 0.0 {
        if xs.w == 1.0 {
            let at = octahedral_decode(vec2f(hit.u, hit.v)) * xs.y;
            dpdu = row_vector(placement + 3u, vec3f(-at.y, at.x, 0.0) * TAU);
        } else {
            let f = disk_tangents(unit(vec3f(xs.z, ys.z, zs.z)));
            dpdu = row_vector(placement + 3u, (f.bitangent * hit.u - f.tangent * hit.v) * (xs.y * TAU));
        }
    } else {
        let at = cold_at(bottom.cold, hit.primitive);
        let c4 = bitcast<vec4f>(geometry[at + 4u]);
        let c5 = bitcast<vec4f>(geometry[at + 5u]);
        let e1 = vec3f(xs.y - xs.x, ys.y - ys.x, zs.y - zs.x);
        let e2 = vec3f(xs.z - xs.x, ys.z - ys.x, zs.z - zs.x);
        let d1 = c4.zw - c4.xy;
        let d2 = c5.xy - c4.xy;
        dpdu = (e1 * d2.y - e2 * d1.y) / (d1.x * d2.y - d1.y * d2.x);
        if TWO_LEVEL {
            dpdu = row_vector(placement + 3u, dpdu);
        }
    }
    if is_finite3(dpdu) && dot3(dpdu, dpdu) > 0.0 {
        return dpdu;
    }
    return frame_from_normal(geometric_normal).tangent;
}

// Where the surface point of a hit would be if its instance stood where `placement` says.
fn point_under(w: u32, hit: Hit, placement: u32) -> vec3f {
    let bottom = bottom_of_instance(w, hit.instance);
    let slot = bottom.slots + hit.primitive * 3u;
    let xs = bitcast<vec4f>(geometry[slot]);
    let ys = bitcast<vec4f>(geometry[slot + 1u]);
    let zs = bitcast<vec4f>(geometry[slot + 2u]);
    var local: vec3f;
    if QUADRICS && (bottom.flags & 1u) != 0u && xs.w != 0.0 {
        let center = vec3f(xs.x, ys.x, zs.x);
        if xs.w == 1.0 {
            local = center + octahedral_decode(vec2f(hit.u, hit.v)) * xs.y;
        } else {
            let f = disk_tangents(unit(vec3f(xs.z, ys.z, zs.z)));
            local = center + (f.tangent * hit.u + f.bitangent * hit.v) * xs.y;
        }
    } else {
        let weights = vec3f(1.0 - hit.u - hit.v, hit.u, hit.v);
        local = vec3f(dot3(xs.xyz, weights), dot3(ys.xyz, weights), dot3(zs.xyz, weights));
        if !TWO_LEVEL {
            // The tree is in world space already, and so is what does not move.
            return local;
        }
    }
    return row_point(placement + 3u, local);
}

fn camera_ray(camera: CameraRays, position: vec2f) -> Ray {
    let direction = camera.corner.xyz + camera.right.xyz * position.x + camera.down.xyz * position.y;
    return Ray(camera.origin.xyz, unit(direction), FAR);
}
