// Twin of `math::rng`: the same numbers, bit for bit. Needs nothing else, so that a host may take
// it alone.

const BLOCK_SCATTER: u32 = 0u;
const BLOCK_LIGHT: u32 = 1u;
const BLOCK_ROULETTE: u32 = 2u;
const BLOCK_LIGHTS: u32 = 0x80000000u;

const PURPOSE_PATH_SEED: u32 = 1u;
const PURPOSE_JITTER: u32 = 2u;
const PURPOSE_SELECTION: u32 = 3u;
const PURPOSE_TEMPORAL_ROUNDING: u32 = 4u;
const PURPOSE_NEIGHBOURS: u32 = 5u;
const PURPOSE_MUTATION: u32 = 6u;
const PURPOSE_TILE_MASK: u32 = 7u;
const PURPOSE_LIGHT_TILE: u32 = 8u;
const PURPOSE_TAPS: u32 = 9u;
const PURPOSE_EFFORT: u32 = 10u;

fn pcg4d(v: vec4<u32>) -> vec4<u32> {
    var w = v * 1664525u + vec4<u32>(1013904223u);
    w.x += w.y * w.w;
    w.y += w.z * w.x;
    w.z += w.x * w.y;
    w.w += w.y * w.z;
    w ^= w >> vec4<u32>(16u);
    w.x += w.y * w.w;
    w.y += w.z * w.x;
    w.z += w.x * w.y;
    w.w += w.y * w.z;
    return w;
}

fn unit_float(word: u32) -> f32 {
    return f32(word >> 8u) * (1.0 / 16777216.0);
}

// A 64-bit seed is (low word, high word).
fn draw4(seed: vec2<u32>, vertex: u32, block: u32) -> vec4<u32> {
    return pcg4d(vec4<u32>(seed, vertex, block));
}

fn second_round(a: vec4<u32>, purpose: u32, round_: u32) -> vec2<u32> {
    return pcg4d(vec4<u32>(a.x ^ purpose, a.y ^ round_, a.z, a.w)).xy;
}

fn stream_key(run: vec2<u32>, cell: u32, frame: u32, purpose: u32, round_: u32) -> vec2<u32> {
    return second_round(pcg4d(vec4<u32>(run, cell, frame)), purpose, round_);
}

fn path_seed(run: vec2<u32>, pixel: u32, frame: u32, candidate: u32) -> vec2<u32> {
    return stream_key(run, pixel, frame, PURPOSE_PATH_SEED, candidate);
}

// The upper and lower word of a product.
fn wide_product(a: u32, b: u32) -> vec2<u32> {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let left = (a >> 16u) * (b & 0xffffu);
    let right = (a & 0xffffu) * (b >> 16u);
    let middle = (low >> 16u) + (left & 0xffffu) + (right & 0xffffu);
    let high = (a >> 16u) * (b >> 16u) + (left >> 16u) + (right >> 16u) + (middle >> 16u);
    return vec2<u32>(high, a * b);
}

struct Stream {
    key: vec2<u32>,
    counter: u32,
    left: u32,
    words: vec4<u32>,
}

fn stream_from_key(key: vec2<u32>) -> Stream {
    return Stream(key, 0u, 0u, vec4<u32>(0u));
}

fn stream_new(run: vec2<u32>, cell: u32, frame: u32, purpose: u32, round_: u32) -> Stream {
    return stream_from_key(stream_key(run, cell, frame, purpose, round_));
}

fn stream_word(s: ptr<function, Stream>) -> u32 {
    if (*s).left == 0u {
        (*s).words = pcg4d(vec4<u32>((*s).key, (*s).counter, 0xA5u));
        (*s).counter += 1u;
        (*s).left = 4u;
    }
    (*s).left -= 1u;
    let at = (*s).left;
    let w = (*s).words;
    // By comparisons: a dynamic index into a vector is slow on some devices.
    return select(select(w.x, w.y, at == 1u), select(w.z, w.w, at == 3u), at >= 2u);
}

// Whether word / 2^32 < weight / total, exactly: the 56-bit product of word and total's mantissa
// against weight's, shifted.
fn is_below(word: u32, weight: f32, total: f32) -> bool {
    if !(weight > 0.0) {
        return false;
    }
    let weight_bits = bitcast<u32>(weight);
    let total_bits = bitcast<u32>(total);
    let apart = (total_bits >> 23u) - (weight_bits >> 23u);
    let product = wide_product(word, (total_bits & 0x7fffffu) | 0x800000u);
    let mantissa = (weight_bits & 0x7fffffu) | 0x800000u;
    if apart >= 56u {
        return product.x == 0u && product.y == 0u;
    }
    if apart <= 32u {
        // mantissa · 2^(32 − apart) in two words; a shift by 32 is none in this language.
        let high = select(mantissa >> apart, 0u, apart == 32u);
        let low = select(select(mantissa << (32u - apart), 0u, apart == 0u), mantissa, apart == 32u);
        return product.x < high || (product.x == high && product.y < low);
    }
    // Shifted down: equality with what is left means the rest decides.
    let low = mantissa >> (apart - 32u);
    let rest = mantissa << (64u - apart);
    return product.x == 0u && (product.y < low || (product.y == low && rest != 0u));
}

// True with probability weight / total.
fn stream_choose(s: ptr<function, Stream>, weight: f32, total: f32) -> bool {
    return is_below(stream_word(s), weight, total);
}

fn stream_index(s: ptr<function, Stream>, n: u32) -> u32 {
    return wide_product(stream_word(s), n).x;
}

fn stream_uniform(s: ptr<function, Stream>) -> f32 {
    return unit_float(stream_word(s));
}
