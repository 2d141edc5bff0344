// Twin of `reuse::spatial`: each pixel merges the reservoirs of a few neighbours with similar
// surfaces into its own; the last round also shades.
//
// | flag | the round |
// |---|---|
// | LAST | shades |
// | KEPT | writes the merged reservoirs |
// | TRACED | traces a ray to each neighbour's sample |
// | XOR, PAIRS | takes its taps by exchanges, or by pairs in blocks, for which two surfaces must fit
// from both sides |
// | DECOUPLED | shows all inputs, not the selected one |
// | CONTROL, CONTROL_KEPT | has an estimate beside the reservoir, writes it |

override FAMILY: u32 = 5u;
override NEIGHBOURS: u32 = 1u;
override MATURE: u32 = 0u;
override B_FROM: u32 = 0u;
override B_TO: u32 = 0u;
//#if CONTROL
override B_CONTROL_FROM: u32 = 0u;
override B_CONTROL_TO: u32 = 0u;
//#endif

// What the merge asks for: input 0 is the pixel's own, the others are its taps'. The composer
// declares INPUTS, the most inputs of a merge.
struct Merge {
    records: array<Record, INPUTS>,
    taps: array<Tap, INPUTS>,
    receiver: Receiver,
    // The own sample's policy bits, after a ray if one was needed.
    own_bits: u32,
    // By input: whether its sample is seen from here.
    seen: array<bool, INPUTS>,
    //#if CONTROL
    control: vec2<u32>,
    //#endif
}

fn input_finished(m: ptr<function, Merge>, input: u32) -> Finished {
    let record = (*m).records[input];
    return Finished(record_sample(record), record.weight, record_confidence(record));
}

fn input_target(m: ptr<function, Merge>, input: u32) -> f32 {
    return (*m).records[input].target_luminance;
}

fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted {
    var receiver = (*m).receiver;
    if destination > 0u {
        receiver = receiver_of((*m).taps[destination].pixel);
    }
    return shift_to(sample, NOW, receiver);
}

fn target_of(integrand: vec3f) -> f32 {
    return luminance(integrand);
}

// What an input brings to the reservoir: its visibility, and its contribution where all are shown.
fn carry(m: ptr<function, Merge>, term: Term) -> Carried {
    let bits = record_policy_bits((*m).records[0]);
    var carried = Carried(policy_average(bits), vec3f(0.0));
    if term.input > 0u {
        var visible = true;
        //#if TRACED
        visible = is_seen((*m).receiver, term.shifted.sample);
        //#endif
        (*m).seen[term.input] = visible;
        carried.visibility = select(0.0, 1.0, visible);
        //#if SHOWS
        if visible {
            carried.radiance = term.shifted.integrand * term.contribution;
        }
        //#endif
    }
    //#if SHOWS
    if term.input == 0u {
        var visible = true;
        //#if CONTROL
        visible = control_visible((*m).control);
        //#endif
        //#if TRACES_OWN
        let outcome = policy_outcome((*m).own_bits);
        visible = outcome.seen;
        if !outcome.known {
            visible = is_seen((*m).receiver, record_sample((*m).records[0]));
            (*m).own_bits = policy_traced((*m).own_bits, visible);
        }
        //#endif
        (*m).seen[0] = visible;
        if visible {
            let integrand = own_integrand((*m).receiver, (*m).records[0]);
            carried.radiance = integrand * term.contribution;
        }
    }
    //#endif
    return carried;
}

fn spatial(pixel: u32, x: u32, y: u32) {
    // Whether a surface scatters is the same for all chains.
    let first = read_record(buffer_now(B_FROM), chain_place(pixel, 0u));
    let scatters = record_confidence(first) > 0.0;
    var m: Merge;
    var found = 0u;
    if scatters {
        let hit = primary_hit(pixel);
        m.receiver = receiver_new(NOW, hit, primary_direction(x, y));
        // A pixel with history enough goes without its neighbours.
        if MATURE == 0u || record_confidence(first) <= f32(MATURE) {
            found = find_taps(&m, hit.t, pixel, x, y);
        }
    }
    var sum = vec3f(0.0);
    for (var chain = 0u; chain < chains(); chain++) {
        if scatters {
            sum += finite_or_counted(merge_neighbours(&m, found, pixel, chain));
        } else {
            write_nothing(chain_place(pixel, chain));
        }
    }
    //#if LAST
    write_vector(buffer_now(RADIANCE) + pixel * 3u, sum / f32(chains()));
    //#endif
}

// The taps of a pixel whose surfaces fit, from 1 on.
fn find_taps(m: ptr<function, Merge>, distance: f32, pixel: u32, x: u32, y: u32) -> u32 {
    var found = 0u;
    let normal = normal_at(pixel);
    //#if !SWAPS
    var random = stream_of(pixel, PURPOSE_NEIGHBOURS, ROUND);
    //#endif
    for (var i = 0u; i < NEIGHBOURS; i++) {
        //#if SWAPS
        let tap = partner_tap(x, y, i);
        //#else
        let tap = random_tap(x, y, &random);
        //#endif
        var fits = tap.pixel != NONE;
        if fits {
            let record = read_record(buffer_now(B_FROM), chain_place(tap.pixel, 0u));
            let normal_there = normal_at(tap.pixel);
            let distance_there = primary_hit(tap.pixel).t;
            fits = record_confidence(record) > 0.0
                && similar(normal, distance, normal_there, distance_there);
            //#if PAIRS
            fits = fits && similar(normal_there, distance_there, normal, distance);
            //#endif
        }
        if fits {
            found += 1u;
            (*m).taps[found] = tap;
        }
        count_if(REUSE_REJECTED, !fits);
    }
    count(SPATIAL_MERGES, found * chains());
    return found;
}

// Leaves a chain of a pixel without a reservoir.
fn write_nothing(at: u32) {
    //#if KEPT
    write_record(buffer_now(B_TO), at, record_none());
    //#endif
    //#if CONTROL_KEPT
    write_control(buffer_now(B_CONTROL_TO), at, vec2<u32>(0u));
    //#endif
}

// Merges one chain of a pixel with that of its neighbours; what it shows in the last round.
fn merge_neighbours(m: ptr<function, Merge>, found: u32, pixel: u32, chain: u32) -> vec3f {
    let at = chain_place(pixel, chain);
    let own = read_record(buffer_now(B_FROM), at);
    (*m).records[0] = own;
    (*m).own_bits = record_policy_bits(own);
    for (var input = 1u; input <= found; input++) {
        let place = chain_place((*m).taps[input].pixel, chain);
        (*m).records[input] = read_record(buffer_now(B_FROM), place);
        (*m).seen[input] = false;
    }
    //#if CONTROL
    (*m).control = read_control(buffer_now(B_CONTROL_FROM), at);
    //#endif
    var r = reservoir_new();
    var random = chain_stream(pixel, PURPOSE_SELECTION, 16u + ROUND, chain);
    let merged = merge(m, FAMILY, found, &r, &random);
    count(WEIGHTS_REJECTED, r.rejected);

    // What the selected sample brings with it.
    var age = record_age(own);
    var bits = (*m).own_bits;
    if merged.source > 0u {
        let other = (*m).records[merged.source];
        age = record_age(other);
        //#if DECOUPLED
        bits = policy_traced(record_policy_bits(other), (*m).seen[merged.source]);
        //#else
        let distance = (*m).taps[merged.source].distance;
        bits = policy_from_afar(record_policy_bits(other), distance);
        //#endif
    }
    bits = policy_averaged(bits, reservoir_visibility(r));

    // The estimate beside it: C = Σ m F W + a (C̄ − F̃). The receiver has not changed since C̄ was
    // made.
    //#if CONTROL
    let share = record_confidence(own) / merged.finished.confidence;
    let corrected = r.radiance + correction(share, (*m).control, (*m).receiver, own);
    var visible = control_visible((*m).control);
    if merged.source > 0u {
        visible = (*m).seen[merged.source];
    }
    let control = control_new(finite_or_counted(corrected), visible);
    //#endif

    // What is shown.
    var shown = vec3f(0.0);
    //#if LAST
    //#if CONTROL
    shown = control_estimate(control);
    //#else
    //#if DECOUPLED
    shown = r.radiance;
    //#else
    let result = shown_of(
        (*m).receiver,
        merged.finished.sample,
        merged.finished.weight,
        merged.known,
        merged.integrand,
        bits,
    );
    shown = result.radiance;
    bits = result.bits;
    //#endif
    //#endif
    //#endif

    //#if KEPT
    write_record(buffer_now(B_TO), at, record_new(
        merged.finished.sample,
        merged.finished.weight,
        merged.finished.confidence,
        merged.target_luminance,
        age,
        bits,
    ));
    //#endif
    //#if CONTROL_KEPT
    write_control(buffer_now(B_CONTROL_TO), at, control);
    //#endif
    return shown;
}
