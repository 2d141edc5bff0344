// Twin of `reuse`: what its passes share, for any domain. The domain's modules declare
//
//     alias Sample = …                 what is reused
//     struct Receiver { … }            a primary hit with all that the integrand depends on besides
//     fn receiver_new(w: u32, hit: Hit, direction: vec3f) -> Receiver
//     fn receiver_normal(receiver: Receiver) -> vec3f
//     fn sight_of(receiver: Receiver, sample: Sample)         a sample as a receiver sees it, of
//         which tell sight_is_valid, sight_integrand (F, without visibility) and
//         sight_is_seen(receiver, sight), which traces one shadow ray
//     struct Record { weight: f32, target_luminance: f32, packed: u32, … }
//     fn record_empty(packed: u32) -> Record;  fn record_none() -> Record
//     fn record_new(sample: Sample, weight: f32, confidence: f32, target_luminance: f32, age: u32,
//                   policy_bits: u32) -> Record
//     fn record_sample, record_confidence, record_age, record_policy_bits (record: Record)
//     fn read_record(first: u32, at: u32) -> Record
//     fn write_record(first: u32, at: u32, record: Record)
//
// and, where records are merged or moved,
//
//     fn shift_to(sample: Sample, from_w: u32, receiver: Receiver) -> Shifted
//     fn mutated(receiver: Receiver, sample: Sample, random: ptr<function, Stream>) -> Mutated
//
// A pixel has `chains()` chains: reservoirs with a history of their own. A chain takes from the
// chain of the same number only.

override B_RESERVOIRS: u32 = 0u;
//#if CONTROL
override B_CONTROLS: u32 = 0u;
//#endif

fn chains() -> u32 {
    return inputs.effort;
}

// The place of a pixel's chain in a buffer that has one element a chain.
fn chain_place(pixel: u32, chain: u32) -> u32 {
    return pixel * chains() + chain;
}

// The numbers of a chain for one purpose and round, which is below 256.
fn chain_stream(pixel: u32, purpose: u32, round_: u32, chain: u32) -> Stream {
    return stream_of(pixel, purpose, round_ | (chain << 8u));
}

// The receiver at a pixel whose primary ray hits something.
fn receiver_of(pixel: u32) -> Receiver {
    let x = pixel % inputs.size.x;
    let y = pixel / inputs.size.x;
    return receiver_new(NOW, primary_hit(pixel), primary_direction(x, y));
}

// Whether a sample of this frame is seen: one shadow ray, none where F is 0.
fn is_seen(receiver: Receiver, sample: Sample) -> bool {
    let sight = sight_of(receiver, sample);
    if !sight_is_valid(sight) {
        count(SHADOW_RAYS_SAVED, 1u);
        return false;
    }
    return sight_is_seen(receiver, sight);
}

// F, without visibility, of a record's own sample at its own receiver.
fn own_integrand(receiver: Receiver, record: Record) -> vec3f {
    if !(record.weight > 0.0) {
        return vec3f(0.0);
    }
    let sight = sight_of(receiver, record_sample(record));
    return select(vec3f(0.0), sight_integrand(sight), vec3<bool>(sight_is_valid(sight)));
}

//#if CONTROL
fn read_control(first: u32, place: u32) -> vec2<u32> {
    return vec2<u32>(state[first + 2u * place], state[first + 2u * place + 1u]);
}

fn write_control(first: u32, place: u32, control: vec2<u32>) {
    state[first + 2u * place] = control.x;
    state[first + 2u * place + 1u] = control.y;
}

// a (C̄ − F̃): what the estimate kept with a record corrects. F̃ = F V W is the record's own
// contribution at the receiver where C̄ was made, so the difference has mean 0.
fn correction(share: f32, control: vec2<u32>, receiver: Receiver, record: Record) -> vec3f {
    var contribution = vec3f(0.0);
    if control_visible(control) {
        contribution = own_integrand(receiver, record) * record.weight;
    }
    return share * (control_estimate(control) - contribution);
}
//#endif
