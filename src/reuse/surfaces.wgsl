// Twin of `reuse::surfaces`: which pixels may share their samples. All of it depends on surfaces
// and fresh numbers alone.

override B_NORMALS: u32 = 0u;
override RADIUS: f32 = 16.0;
override ROUND: u32 = 0u;

const COSINE: f32 = 0.5;
const DEPTH: f32 = 0.1;

fn similar(normal: vec3f, distance: f32, other_normal: vec3f, other_distance: f32) -> bool {
    return dot3(normal, other_normal) >= COSINE
        && abs(other_distance - distance) < DEPTH * distance;
}

fn pack_normal(normal: vec3f) -> u32 {
    let p = octahedral_encode(normal) * 32767.0;
    let x = u32(i32(rounded_away(p.x))) & 0xffffu;
    return x | ((u32(i32(rounded_away(p.y))) & 0xffffu) << 16u);
}

fn unpack_normal(word: u32) -> vec3f {
    return octahedral_decode(vec2f(signed16(word & 0xffffu), signed16(word >> 16u)) / 32767.0);
}

fn normal_at(pixel: u32) -> vec3f {
    return unpack_normal(state[buffer_now(B_NORMALS) + pixel]);
}

//#if !STILL
// A pixel of the previous frame with its hit; the pixel is NONE where another surface was seen.
struct Reprojected {
    pixel: u32,
    x: u32,
    y: u32,
    hit: Hit,
}

// The pixel of the previous frame that saw the surface of a hit, whose normal is `normal`.
//
// The motion vector is position − p, with position the surface point's place in the previous
// frame's picture and p this frame's sample position; it is rounded to a pixel with a probability
// in proportion to its overlap.
fn reproject(hit: Hit, normal: vec3f, pixel: u32, x: u32, y: u32) -> Reprojected {
    var none: Reprojected;
    none.pixel = NONE;
    if inputs.instances.y == 0u {
        return none;
    }
    // The surface point in the previous frame's world.
    var instance = hit.instance;
    if inputs.instances.x != NONE {
        instance = words[inputs.instances.x + instance];
    }
    if instance >= inputs.worlds[BEFORE].instances {
        return none;
    }
    let placement = placement_at(inputs.worlds[BEFORE].placements, instance);
    let before = point_under(NOW, hit, placement);
    // Its place in the previous frame's picture.
    let p = inputs.projection;
    let local = vec3f(
        dot3(p.row_x.xyz, before) + p.row_x.w,
        dot3(p.row_y.xyz, before) + p.row_y.w,
        dot3(p.row_z.xyz, before) + p.row_z.w,
    );
    if !(local.z > 0.0) {
        return none;
    }
    let position = vec2f(local.x, -local.y) * (p.scale.x / local.z) + p.scale.yz;
    if !(is_finite(position.x) && is_finite(position.y)) {
        return none;
    }
    // Rounded to a pixel.
    let moved = position - sample_position(inputs.frame, x, y, 0u);
    var random = stream_of(pixel, PURPOSE_TEMPORAL_ROUNDING, 0u);
    let u = stream_uniform(&random);
    let place = floor(vec2f(f32(x), f32(y)) + moved + vec2f(u, stream_uniform(&random)));
    let size = vec2f(inputs.size);
    if !(place.x >= 0.0 && place.y >= 0.0 && place.x < size.x && place.y < size.y) {
        return none;
    }
    // The surface that was seen there.
    let at = u32(place.y) * inputs.size.x + u32(place.x);
    let there = primary_hit_before(at);
    if there.primitive == MISS {
        return none;
    }
    let normal_there = unpack_normal(state[buffer_before(B_NORMALS) + at]);
    let away = before - p.origin.xyz;
    if !similar(normal, sqrt(dot3(away, away)), normal_there, there.t) {
        return none;
    }
    return Reprojected(at, u32(place.x), u32(place.y), there);
}
//#endif

// A neighbour of a pixel, and how far away it is in pixels along the axis where it is farther. The
// pixel is NONE where it would lie outside of the picture, or be the pixel itself.
struct Tap {
    pixel: u32,
    distance: u32,
}

fn tap_at(x: u32, y: u32, dx: i32, dy: i32) -> Tap {
    let nx = i32(x) + dx;
    let ny = i32(y) + dy;
    let size = vec2<i32>(inputs.size);
    if nx < 0 || ny < 0 || nx >= size.x || ny >= size.y || (dx == 0 && dy == 0) {
        return Tap(NONE, 0u);
    }
    return Tap(u32(ny) * inputs.size.x + u32(nx), u32(max(abs(dx), abs(dy))));
}

//#if XOR
// Tap `number` of a pixel by an exchange that all pixels of a round share: x ↦ ((x + s) xor m) − s
// is its own inverse, so pixels swap their samples in pairs. Masks are uniform over the quarter of
// a disk.
fn partner_tap(x: u32, y: u32, number: u32) -> Tap {
    var random = stream_of(number, PURPOSE_TAPS, ROUND);
    let radius = RADIUS * sqrt(stream_uniform(&random));
    let sc = sin_cos_turn(0.25 * stream_uniform(&random));
    var mask = vec2<u32>(u32(rounded_away(radius * sc.y)), u32(rounded_away(radius * sc.x)));
    if mask.x == 0u && mask.y == 0u {
        // A mask of zeros would leave every pixel with itself.
        mask.x = 1u;
    }
    let s = stream_word(&random);
    let shift_by = vec2<u32>(s, stream_word(&random));
    let at = vec2<u32>(x, y);
    let away = vec2<i32>(((at + shift_by) ^ mask) - shift_by - at);
    return tap_at(x, y, away.x, away.y);
}
//#endif

//#if PAIRS
// Changes one half of a place in a block of 2^bits by a function of the other.
fn scramble(half: u32, key: u32, bits: u32) -> u32 {
    return ((half * 0x9E3779B9u ^ key) * 0x85EBCA6Bu) >> (32u - bits);
}

// Tap `number` of a pixel in pairs that are drawn in square blocks: see Blocks in taps.rs.
fn partner_tap(x: u32, y: u32, number: u32) -> Tap {
    var random = stream_of(number, PURPOSE_TAPS, ROUND);
    let square = 1.5 * RADIUS * RADIUS;
    var bits = firstLeadingBit(u32(max(square, 4.0))) / 2u;
    let smaller = f32(1u << (2u * bits));
    if stream_uniform(&random) * 3.0 < square / smaller - 1.0 {
        bits += 1u;
    }
    let ox = stream_word(&random);
    let oy = stream_word(&random);
    let k = stream_word(&random);
    let at = vec2<u32>(x + ox, y + oy);
    let block = at >> vec2<u32>(bits);
    let keys = pcg4d(vec4<u32>(block.x, block.y, k, stream_word(&random)));
    let inside = at & vec2<u32>((1u << bits) - 1u);
    var a = inside.x;
    var b = inside.y;
    a ^= scramble(b, keys.x, bits);
    b ^= scramble(a, keys.y, bits);
    a ^= scramble(b, keys.z, bits);
    b ^= scramble(a, keys.w, bits);
    a ^= 1u;
    b ^= scramble(a, keys.w, bits);
    a ^= scramble(b, keys.z, bits);
    b ^= scramble(a, keys.y, bits);
    a ^= scramble(b, keys.x, bits);
    return tap_at(x, y, i32(a) - i32(inside.x), i32(b) - i32(inside.y));
}
//#endif

// The next tap of a pixel, uniformly over a disk.
fn random_tap(x: u32, y: u32, random: ptr<function, Stream>) -> Tap {
    let radius = RADIUS * sqrt(stream_uniform(random));
    let sc = sin_cos_turn(stream_uniform(random));
    return tap_at(x, y, i32(rounded_away(radius * sc.y)), i32(rounded_away(radius * sc.x)));
}
