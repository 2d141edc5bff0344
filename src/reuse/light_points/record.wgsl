// Twin of `reuse::light_points::record`: a finished reservoir in six words.

alias Sample = LightPoint;

struct Record {
    point: LightPoint,
    weight: f32,
    target_luminance: f32,
    packed: u32,
}

const RECORD: u32 = 6u;
const MAX_CONFIDENCE: f32 = 255.0;

// The confidence, age and bits of `packed`, without a sample.
fn record_empty(packed: u32) -> Record {
    return Record(LightPoint(NO_LIGHT, vec2f(0.0)), 0.0, 0.0, packed);
}

// All zeros: without confidence.
fn record_none() -> Record {
    return Record(LightPoint(0u, vec2f(0.0)), 0.0, 0.0, 0u);
}

fn record_new(
    point: LightPoint,
    weight: f32,
    confidence: f32,
    target_luminance: f32,
    age: u32,
    policy_bits: u32,
) -> Record {
    let whole = u32(min(confidence, MAX_CONFIDENCE));
    let packed = whole | (min(age, 255u) << 8u) | (policy_bits << 16u);
    if weight > 0.0 {
        return Record(point, weight, target_luminance, packed);
    }
    return record_empty(packed);
}

fn record_sample(record: Record) -> LightPoint {
    return record.point;
}

fn record_confidence(record: Record) -> f32 {
    return f32(record.packed & 255u);
}

fn record_age(record: Record) -> u32 {
    return (record.packed >> 8u) & 255u;
}

fn record_policy_bits(record: Record) -> u32 {
    return record.packed >> 16u;
}

fn read_record(first: u32, place: u32) -> Record {
    let at = first + place * RECORD;
    let uv = vec2f(bitcast<f32>(state[at + 1u]), bitcast<f32>(state[at + 2u]));
    return Record(
        LightPoint(state[at], uv),
        bitcast<f32>(state[at + 3u]),
        bitcast<f32>(state[at + 4u]),
        state[at + 5u],
    );
}

fn write_record(first: u32, place: u32, record: Record) {
    let at = first + place * RECORD;
    state[at] = record.point.light;
    state[at + 1u] = bitcast<u32>(record.point.uv.x);
    state[at + 2u] = bitcast<u32>(record.point.uv.y);
    state[at + 3u] = bitcast<u32>(record.weight);
    state[at + 4u] = bitcast<u32>(record.target_luminance);
    state[at + 5u] = record.packed;
}
