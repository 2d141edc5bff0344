// Twin of `resampling::merge` (and of `merge_history`, with one other input whose confidence is
// capped).
//
// A host declares what it knows of a merge, and for inputs numbered 0 (the canonical one), 1, 2, …:
//
//     struct Sample { … }
//     struct Merge { … }
//     fn input_finished(m: ptr<function, Merge>, input: u32) -> Finished
//     fn input_target(m: ptr<function, Merge>, input: u32) -> f32
//         of its own sample, in its own domain
//     fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted
//     fn target_of(integrand: vec3f) -> f32
//     fn carry(m: ptr<function, Merge>, term: Term) -> Carried

// Empty where the weight is 0.
struct Finished {
    sample: Sample,
    weight: f32,
    confidence: f32,
}

struct Shifted {
    sample: Sample,
    integrand: vec3f,
    jacobian: f32,
    valid: bool,
}

// An input's part as it is streamed; for the canonical one `shifted` is not valid.
struct Term {
    input: u32,
    mis: f32,
    contribution: f32,
    weight: f32,
    shifted: Shifted,
}

// What an input brings to the reservoir besides its weight.
struct Carried {
    visibility: f32,
    radiance: vec3f,
}

struct Merged {
    finished: Finished,
    target_luminance: f32,
    source: u32,
    // Of the chosen sample, where it is another input's.
    integrand: vec3f,
    known: bool,
}

// An input's target at a sample of the canonical domain, as seen from there.
fn target_from(m: ptr<function, Merge>, sample: Sample, input: u32) -> f32 {
    let shifted = shift(m, sample, 0u, input);
    return select(0.0, target_of(shifted.integrand) * shifted.jacobian, shifted.valid);
}

fn merge(
    m: ptr<function, Merge>,
    family: u32,
    count: u32,
    r: ptr<function, Reservoir>,
    random: ptr<function, Stream>,
) -> Merged {
    let own = input_finished(m, 0u);
    let own_target = input_target(m, 0u);
    let has_own = own.weight > 0.0;
    var other_confidence = 0.0;
    for (var i = 1u; i <= count; i++) {
        other_confidence += input_finished(m, i).confidence;
    }
    let total = own.confidence + other_confidence;
    let is_pairwise = family == FAMILY_PAIRWISE || family == FAMILY_DEFENSIVE;
    let by_count = family <= FAMILY_CONTRIBUTION;
    let pairs = Pairwise(own.confidence, other_confidence, family == FAMILY_DEFENSIVE);
    var canonical_mis = 1.0;
    if other_confidence > 0.0 {
        if by_count {
            canonical_mis = own.confidence / total;
        } else if is_pairwise {
            canonical_mis = pairwise_canonical_alone(pairs);
        }
    }
    var any_other = false;
    var any_selected = false;
    var source = 0u;
    var chosen: Shifted;
    chosen.valid = false;

    for (var i = 1u; i <= count; i++) {
        let input = input_finished(m, i);
        if input.confidence <= 0.0 {
            continue;
        }
        //#if FAMILY=FAMILY_PAIRWISE|FAMILY_DEFENSIVE
        if is_pairwise && has_own {
            let there = target_from(m, own.sample, i);
            any_other = any_other || there > 0.0;
            canonical_mis += pairwise_canonical_part(pairs, input.confidence, there, own_target);
        }
        //#endif
        if !(input.weight > 0.0) {
            continue;
        }
        let candidate = shift(m, input.sample, i, 0u);
        if !candidate.valid {
            continue;
        }
        let here = target_of(candidate.integrand);
        if here <= 0.0 {
            continue;
        }
        let there = input_target(m, i) / candidate.jacobian;
        var mis = input.confidence / total;
        if is_pairwise {
            mis = pairwise_other(pairs, input.confidence, there, here);
        }
        //#if FAMILY=FAMILY_BALANCE
        if family == FAMILY_BALANCE {
            var rivals = 0.0;
            for (var rival = 1u; rival <= count; rival++) {
                let confidence = input_finished(m, rival).confidence;
                if rival != i && confidence > 0.0 {
                    rivals += confidence / input.confidence * (target_from(m, candidate.sample, rival) / there);
                }
            }
            rivals += own.confidence / input.confidence * (here / there);
            mis = 0.0;
            if there > 0.0 {
                mis = 1.0 / (1.0 + rivals);
            }
        }
        //#endif
        let contribution = mis * input.weight * candidate.jacobian;
        let weight = contribution * here;
        if weight != 0.0 {
            any_other = true;
            let carried = carry(m, Term(i, mis, contribution, weight, candidate));
            if reservoir_stream(r, weight, carried.visibility, carried.radiance, random) {
                any_selected = true;
                source = i;
                chosen = candidate;
            }
        }
    }

    if has_own {
        //#if FAMILY=FAMILY_BALANCE
        if family == FAMILY_BALANCE && other_confidence > 0.0 {
            var rivals = 0.0;
            for (var rival = 1u; rival <= count; rival++) {
                let confidence = input_finished(m, rival).confidence;
                if confidence > 0.0 {
                    let seen = target_from(m, own.sample, rival);
                    any_other = any_other || seen > 0.0;
                    rivals += confidence / own.confidence * (seen / own_target);
                }
            }
            canonical_mis = 1.0 / (1.0 + rivals);
        }
        //#endif
        if !any_other && !by_count {
            canonical_mis = 1.0;
        }
        let contribution = canonical_mis * own.weight;
        let weight = contribution * own_target;
        if weight != 0.0 {
            var none: Shifted;
            none.valid = false;
            let carried = carry(m, Term(0u, canonical_mis, contribution, weight, none));
            if reservoir_stream(r, weight, carried.visibility, carried.radiance, random) {
                any_selected = true;
                source = 0u;
                chosen.valid = false;
            }
            if !any_other && canonical_mis == 1.0 {
                return Merged(Finished(own.sample, own.weight, total), own_target, 0u, vec3f(0.0), false);
            }
        }
    }

    let nothing = Merged(Finished(own.sample, 0.0, total), 0.0, 0u, vec3f(0.0), false);
    if !any_selected {
        return nothing;
    }
    var sample = own.sample;
    var selected_target = own_target;
    if chosen.valid {
        sample = chosen.sample;
        selected_target = target_of(chosen.integrand);
    }
    var scale = 1.0;
    //#if FAMILY=FAMILY_INVERSE_COUNT|FAMILY_CONTRIBUTION
    if (family == FAMILY_INVERSE_COUNT || family == FAMILY_CONTRIBUTION) && other_confidence > 0.0 {
        var of_source = selected_target;
        if chosen.valid {
            of_source = input_target(m, source) / chosen.jacobian;
        }
        var reach = 0.0;
        var sum = 0.0;
        if selected_target > 0.0 {
            reach += own.confidence;
            sum += own.confidence * (selected_target / of_source);
        }
        for (var i = 1u; i <= count; i++) {
            let confidence = input_finished(m, i).confidence;
            var there = of_source;
            if i != source {
                if !(confidence > 0.0) {
                    continue;
                }
                there = target_from(m, sample, i);
            }
            if there > 0.0 {
                reach += confidence;
                sum += confidence * (there / of_source);
            }
        }
        if !any_other && reach == own.confidence {
            return Merged(Finished(own.sample, own.weight, total), selected_target, 0u, vec3f(0.0), false);
        }
        scale = total / select(sum, reach, family == FAMILY_INVERSE_COUNT);
    }
    //#endif
    let weight = contribution_weight((*r).weight_sum, selected_target, scale);
    if weight == 0.0 {
        return nothing;
    }
    return Merged(Finished(sample, weight, total), selected_target, source, chosen.integrand, chosen.valid);
}
