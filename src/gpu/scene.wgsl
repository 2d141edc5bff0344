// The scene as it lies in four arenas, and the loop's state. Who reads what is beside its reader;
// this holds words, textures and constants.

// What the plan leaves out; a pipeline sets them.
override TWO_LEVEL: bool = true;
override QUADRICS: bool = true;
override COVERAGE: bool = true;
override TEXTURES: bool = true;
override ENVIRONMENTS: bool = true;
override ANISOTROPIC: bool = true;
override ONE_SIDED_SHAPES: bool = true;
// Whether work is counted.
override COUNT: bool = true;

const NONE: u32 = 0xffffffffu;

struct World {
    placements: u32,
    top_nodes: u32,
    top_order: u32,
    top_reach: f32,
    bottom_nodes: u32,
    bottom_slots: u32,
    bottom_cold: u32,
    bottom_flags: u32,
    bottom_reach: f32,
    instances: u32,
    first_of_shape: u32,
    shapes: u32,
    lights: u32,
    light_count: u32,
    alias_slots: u32,
    alias_count: u32,
    probabilities: u32,
    environments: u32,
    environment_count: u32,
    emitter_placements: u32,
    emitter_nodes: u32,
    emitter_slots: u32,
    emitter_cold: u32,
    emitter_flags: u32,
    emitter_reach: f32,
    emitter_first: u32,
    padding_a: u32,
    padding_b: u32,
}

struct CameraRays {
    origin: vec4f,
    corner: vec4f,
    right: vec4f,
    down: vec4f,
}

struct Projection {
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    origin: vec4f,
    // per unit, middle x, middle y
    scale: vec4f,
}

struct Inputs {
    run: vec2<u32>,
    frame: u32,
    effort: u32,
    size: vec2<u32>,
    depth: u32,
    box_filter: u32,
    // Words from light of the previous frame to this one's, their number, the same back.
    remap: vec4<u32>,
    // Words from an instance to its place in the previous frame (or NONE: the same), whether there
    // is a previous frame.
    instances: vec4<u32>,
    srgb: u32,
    // The share of pixels with one estimate more than `effort`, in 2^-32 of the picture.
    extra_share: u32,
    padding_a: u32,
    padding_b: u32,
    camera: CameraRays,
    camera_before: CameraRays,
    projection: Projection,
    worlds: array<World, 2>,
    // Words where each of the loop's buffers begins: now, in the previous frame.
    buffers: array<vec4<u32>, 24>,
}

const NOW: u32 = 0u;
const BEFORE: u32 = 1u;

@group(0) @binding(0) var<uniform> inputs: Inputs;
@group(0) @binding(1) var<storage, read> nodes: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> geometry: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> words: array<u32>;
@group(0) @binding(4) var<storage, read> texels: array<u32>;
@group(0) @binding(5) var<storage, read_write> state: array<u32>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;

// The loop's first buffers.
const HITS: u32 = 0u;
const RADIANCE: u32 = 1u;
const EMISSION: u32 = 2u;

fn float_word(at: u32) -> f32 {
    return bitcast<f32>(words[at]);
}

fn vector_word(at: u32) -> vec3f {
    return vec3f(float_word(at), float_word(at + 1u), float_word(at + 2u));
}

fn write_vector(at: u32, v: vec3f) {
    state[at] = bitcast<u32>(v.x);
    state[at + 1u] = bitcast<u32>(v.y);
    state[at + 2u] = bitcast<u32>(v.z);
}

fn read_vector(at: u32) -> vec3f {
    return vec3f(bitcast<f32>(state[at]), bitcast<f32>(state[at + 1u]), bitcast<f32>(state[at + 2u]));
}

fn buffer_now(id: u32) -> u32 {
    return inputs.buffers[id].x;
}

fn buffer_before(id: u32) -> u32 {
    return inputs.buffers[id].y;
}

// Counters, in the order of `path::Counters`.
const PRIMARY_RAYS: u32 = 0u;
const BOUNCE_RAYS: u32 = 1u;
const SHADOW_RAYS: u32 = 2u;
const EMITTER_RAYS: u32 = 3u;
const SHADOW_RAYS_SAVED: u32 = 4u;
const PATHS: u32 = 5u;
const CANDIDATES: u32 = 6u;
const TILE_ENTRIES: u32 = 7u;
const SHIFTS: u32 = 8u;
const SHIFTS_FAILED: u32 = 9u;
const TEMPORAL_MERGES: u32 = 10u;
const SPATIAL_MERGES: u32 = 11u;
const REUSE_REJECTED: u32 = 12u;
const MUTATIONS: u32 = 13u;
const MUTATIONS_ACCEPTED: u32 = 14u;
const WEIGHTS_REJECTED: u32 = 15u;
const NON_FINITE: u32 = 16u;
const COUNTERS: u32 = 17u;

var<private> work: array<u32, 17>;

fn count(counter: u32, n: u32) {
    if COUNT {
        work[counter] += n;
    }
}

fn count_if(counter: u32, condition: bool) {
    if COUNT && condition {
        work[counter] += 1u;
    }
}

fn finish_counting() {
    if COUNT {
        for (var i = 0u; i < COUNTERS; i++) {
            let n = work[i];
            if n != 0u && atomicAdd(&counters[i], n) > 0xffffffffu - n {
                // The lower word wrapped.
                atomicAdd(&counters[COUNTERS + i], 1u);
            }
        }
    }
}

fn finite_or_counted(radiance: vec3f) -> vec3f {
    if is_finite3(radiance) && is_finite(luminance(radiance)) {
        return radiance;
    }
    count(NON_FINITE, 1u);
    return vec3f(0.0);
}

// Textures: programs in postfix, made when the scene is uploaded.
const OP_CONSTANT: u32 = 0u;
const OP_IMAGE: u32 = 1u;
const OP_CHECKERBOARD: u32 = 2u;
const OP_PRODUCT: u32 = 3u;
const OP_THRESHOLD: u32 = 4u;
const TEXTURE_STACK: u32 = 8u;

const REPEAT: u32 = 0u;
const CLAMP: u32 = 1u;
const BLACK: u32 = 2u;
const MIRROR: u32 = 3u;

fn texel(header: u32, x: u32, y: u32) -> vec4f {
    let format = words[header];
    let at = words[header + 1u] + (y * words[header + 2u] + x) * select(1u, 4u, format == 2u);
    if format == 2u {
        return bitcast<vec4f>(vec4<u32>(texels[at], texels[at + 1u], texels[at + 2u], texels[at + 3u]));
    }
    let bytes = texels[at];
    let rgba = vec4<u32>(bytes & 255u, (bytes >> 8u) & 255u, (bytes >> 16u) & 255u, bytes >> 24u);
    if format == 1u {
        return vec4f(rgba) * (1.0 / 255.0);
    }
    return vec4f(
        float_word(inputs.srgb + rgba.x),
        float_word(inputs.srgb + rgba.y),
        float_word(inputs.srgb + rgba.z),
        f32(rgba.w) * (1.0 / 255.0),
    );
}

// The place of pixel i of n, or -1 outside. |i| is below 2^30.
fn wrapped(i: i32, n: i32, wrap: u32) -> i32 {
    if wrap == REPEAT {
        let m = i % n;
        return select(m, m + n, m < 0);
    }
    if wrap == CLAMP {
        return clamp(i, 0, n - 1);
    }
    if wrap == BLACK {
        return select(-1, i, i >= 0 && i < n);
    }
    var m = i % (2 * n);
    if m < 0 {
        m += 2 * n;
    }
    return select(2 * n - 1 - m, m, m < n);
}

fn texel_or_black(header: u32, x: i32, y: i32) -> vec4f {
    if x < 0 || y < 0 {
        return vec4f(0.0);
    }
    return texel(header, u32(x), u32(y));
}

fn bilinear(header: u32, at: vec2f, wrap: u32) -> vec4f {
    if !(is_finite(at.x) && is_finite(at.y)) {
        return vec4f(0.0);
    }
    let size = vec2<u32>(words[header + 2u], words[header + 3u]);
    let inside = select(at, at - floor(at), wrap == REPEAT);
    let position = inside * vec2f(size) - 0.5;
    let low = floor(position);
    let f = position - low;
    // Beyond 2^30 pixels nothing but the wrap mode's border is left.
    let l = vec2<i32>(clamp(low, vec2f(-1073741824.0), vec2f(1073741823.0)));
    let n = vec2<i32>(size);
    let x0 = wrapped(l.x, n.x, wrap);
    let x1 = wrapped(l.x + 1, n.x, wrap);
    let y0 = wrapped(l.y, n.y, wrap);
    let y1 = wrapped(l.y + 1, n.y, wrap);
    let a = texel_or_black(header, x0, y0);
    let b = texel_or_black(header, x1, y0);
    let c = texel_or_black(header, x0, y1);
    let d = texel_or_black(header, x1, y1);
    let top = a + (b - a) * f.x;
    let bottom = c + (d - c) * f.x;
    return top + (bottom - top) * f.y;
}

fn mapped(at: u32, uv: vec2f) -> vec2f {
    return vec2f(
        float_word(at) * uv.x + float_word(at + 2u) * uv.y + float_word(at + 4u),
        float_word(at + 1u) * uv.x + float_word(at + 3u) * uv.y + float_word(at + 5u),
    );
}

fn channel_of(rgba: vec4f, channel: u32) -> f32 {
    switch channel {
        case 0u: { return rgba.x; }
        case 1u: { return rgba.y; }
        case 2u: { return rgba.z; }
        case 3u: { return rgba.w; }
        default: { return (rgba.x + rgba.y + rgba.z) / 3.0; }
    }
}

// RGBA of the texture whose program begins at `program` with its length.
fn texture_at(program: u32, uv: vec2f) -> vec4f {
    var stack: array<vec4f, TEXTURE_STACK>;
    var top = 0u;
    var at = program + 1u;
    let end = at + words[program];
    loop {
        if at >= end {
            break;
        }
        let op = words[at];
        switch op {
            case OP_CONSTANT: {
                stack[top] = vec4f(vector_word(at + 1u), float_word(at + 4u));
                top += 1u;
                at += 5u;
            }
            case OP_IMAGE: {
                let st = mapped(at + 1u, uv);
                let value = bilinear(words[at + 7u], vec2f(st.x, 1.0 - st.y), words[at + 8u]);
                var rgb = value.xyz * float_word(at + 9u);
                if words[at + 10u] != 0u {
                    rgb = max(vec3f(1.0) - rgb, vec3f(0.0));
                }
                stack[top] = vec4f(rgb, value.w);
                top += 1u;
                at += 11u;
            }
            case OP_CHECKERBOARD: {
                let st = mapped(at + 1u, uv);
                let sum = floor(st.x) + floor(st.y);
                let even = sum - 2.0 * floor(0.5 * sum) < 1.0;
                top -= 1u;
                let value = select(stack[top], stack[top - 1u], even);
                stack[top - 1u] = vec4f(value.xyz, 1.0);
                at += 7u;
            }
            case OP_PRODUCT: {
                top -= 1u;
                stack[top - 1u] *= stack[top];
                at += 1u;
            }
            default: {
                let value = channel_of(stack[top - 1u], words[at + 1u]);
                stack[top - 1u] = vec4f(select(0.0, 1.0, value >= float_word(at + 2u)));
                at += 3u;
            }
        }
    }
    return stack[0];
}

// A colour is NONE and three numbers, or a program.
fn color_at(at: u32, uv: vec2f) -> vec3f {
    //#if TEXTURES
    if TEXTURES && words[at] != NONE {
        return texture_at(words[at], uv).xyz;
    }
    //#endif
    return vector_word(at + 1u);
}

// A number is NONE and itself, or a channel and a program.
fn scalar_at(at: u32, uv: vec2f) -> f32 {
    //#if TEXTURES
    if TEXTURES && words[at] != NONE {
        return channel_of(texture_at(words[at + 1u], uv), words[at]);
    }
    //#endif
    return float_word(at + 1u);
}
