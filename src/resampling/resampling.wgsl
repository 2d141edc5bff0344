// Twin of `resampling`: weighted reservoirs, MIS weights, mutated weights. Needs the random numbers
// of `math/rng.wgsl`.

const FAMILY_CONSTANT: u32 = 0u;
const FAMILY_INVERSE_COUNT: u32 = 1u;
const FAMILY_CONTRIBUTION: u32 = 2u;
const FAMILY_BALANCE: u32 = 3u;
const FAMILY_PAIRWISE: u32 = 4u;
const FAMILY_DEFENSIVE: u32 = 5u;

// The largest finite number; no infinity is ever named.
const MOST: f32 = 3.4028234e38;

// What streams through: the samples themselves stay with the caller.
struct Reservoir {
    weight_sum: f32,
    rejected: u32,
    // Sum of visibility times weight, and of what each input shows.
    visible: f32,
    radiance: vec3f,
}

fn reservoir_new() -> Reservoir {
    return Reservoir(0.0, 0u, 0.0, vec3f(0.0));
}

fn is_weight(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u && x >= 0.0;
}

// Whether a sample of this weight is the selected one from now on.
fn reservoir_stream(
    r: ptr<function, Reservoir>,
    weight: f32,
    visibility: f32,
    radiance: vec3f,
    random: ptr<function, Stream>,
) -> bool {
    let sum = (*r).weight_sum + weight;
    if !(is_weight(weight) && is_weight(sum)) {
        (*r).rejected += 1u;
        return false;
    }
    (*r).visible += visibility * weight;
    (*r).radiance += radiance;
    if weight == 0.0 {
        return false;
    }
    (*r).weight_sum = sum;
    return stream_choose(random, weight, sum);
}

// The mean visibility of what was streamed; 1 of nothing.
fn reservoir_visibility(r: Reservoir) -> f32 {
    if r.weight_sum > 0.0 {
        return min(r.visible / r.weight_sum, 1.0);
    }
    return 1.0;
}

// W; 0 where it is none in single precision: then the reservoir is empty.
fn contribution_weight(weight_sum: f32, target_luminance: f32, scale: f32) -> f32 {
    if !(target_luminance > 0.0) {
        return 0.0;
    }
    let weight = weight_sum / target_luminance * scale;
    return select(0.0, weight, is_weight(weight));
}

struct Pairwise {
    canonical: f32,
    others: f32,
    defensive: bool,
}

fn pairwise_pair(p: Pairwise, confidence: f32) -> f32 {
    return confidence / select(p.others, p.canonical + p.others, p.defensive);
}

fn pairwise_other(p: Pairwise, confidence: f32, there: f32, here: f32) -> f32 {
    if there <= 0.0 {
        return 0.0;
    }
    return pairwise_pair(p, confidence) / (1.0 + p.canonical / p.others * (here / there));
}

fn pairwise_canonical_part(p: Pairwise, confidence: f32, there: f32, here: f32) -> f32 {
    return pairwise_pair(p, confidence) / (1.0 + p.others / p.canonical * (there / here));
}

fn pairwise_canonical_alone(p: Pairwise) -> f32 {
    return select(0.0, p.canonical / (p.canonical + p.others), p.defensive);
}

// W after a mutation; 0: it is lost.
fn mutated_weight(weight: f32, target_before: f32, target_after: f32) -> f32 {
    let mutated = weight * (target_before / target_after);
    return select(0.0, mutated, is_weight(mutated));
}
