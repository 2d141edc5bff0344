// Twin of `reuse::temporal`: the history of the pixel that saw the same surface one frame ago is
// merged into this frame's reservoir, its confidence capped.
//
// | flag | the pass |
// |---|---|
// | STILL | compares a pixel with itself one frame ago |
// | STORED_TARGETS | does so by stored targets: no receiver is made |
// | CONTROL | keeps an estimate beside the reservoir |

override FAMILY: u32 = 5u;
override CAP: f32 = 20.0;
override MAX_AGE: u32 = 0u;
override B_HISTORY: u32 = 0u;
//#if CONTROL
override B_HISTORY_CONTROLS: u32 = 0u;
//#endif

// What the merge asks for: input 0 is this frame's, 1 the previous one's.
struct Merge {
    records: array<Record, 2>,
    //#if !STORED_TARGETS
    receiver: Receiver,
    receiver_before: Receiver,
    //#endif
    //#if CONTROL
    controls: array<vec2<u32>, 2>,
    // Whether the previous sample is seen here and now, once it was asked for.
    is_seen: bool,
    //#endif
}

fn input_finished(m: ptr<function, Merge>, input: u32) -> Finished {
    let record = (*m).records[input];
    var confidence = record_confidence(record);
    if input == 1u {
        confidence = min(confidence, CAP * record_confidence((*m).records[0]));
    }
    return Finished(record_sample(record), record.weight, confidence);
}

fn input_target(m: ptr<function, Merge>, input: u32) -> f32 {
    return (*m).records[input].target_luminance;
}

//#if STORED_TARGETS
fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted {
    return Shifted(sample, vec3f((*m).records[origin].target_luminance), 1.0, true);
}

// A stored target travels as a grey integrand, whose luminance would round.
fn target_of(integrand: vec3f) -> f32 {
    return integrand.x;
}
//#else
fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted {
    var receiver = (*m).receiver;
    var from_w = NOW;
    //#if !STILL
    if destination == 1u {
        receiver = (*m).receiver_before;
    } else {
        from_w = BEFORE;
    }
    //#endif
    return shift_to(sample, from_w, receiver);
}

fn target_of(integrand: vec3f) -> f32 {
    return luminance(integrand);
}
//#endif

fn carry(m: ptr<function, Merge>, term: Term) -> Carried {
    let bits = record_policy_bits((*m).records[term.input]);
    var carried = Carried(policy_average(bits), vec3f(0.0));
    //#if CONTROL
    var integrand = term.shifted.integrand;
    var visible = control_visible((*m).controls[0]);
    if term.input == 0u {
        integrand = own_integrand((*m).receiver, (*m).records[0]);
    } else {
        //#if STILL
        visible = control_visible((*m).controls[1]);
        //#else
        visible = is_seen((*m).receiver, term.shifted.sample);
        //#endif
        (*m).is_seen = visible;
    }
    if visible {
        carried.radiance = integrand * term.contribution;
    }
    //#endif
    return carried;
}

// A record of the previous frame, without its sample where that is too old.
fn aged(record: Record) -> Record {
    if MAX_AGE > 0u && record_age(record) >= MAX_AGE {
        return record_empty(record.packed);
    }
    return record;
}

// Where the previous frame's elements begin: in a buffer of their own, or in the other half of this
// frame's.
fn history_of(own: u32, history: u32) -> u32 {
    //#if OWN_HISTORY
    return buffer_before(own);
    //#else
    return buffer_now(history);
    //#endif
}

fn temporal(pixel: u32, x: u32, y: u32) {
    // Whether a surface scatters is the same for all chains.
    let first = read_record(buffer_now(B_RESERVOIRS), chain_place(pixel, 0u));
    if record_confidence(first) == 0.0 {
        return;
    }
    var m: Merge;
    var pixel_before = pixel;
    //#if !STORED_TARGETS
    let hit = primary_hit(pixel);
    m.receiver = receiver_new(NOW, hit, primary_direction(x, y));
    m.receiver_before = m.receiver;
    //#if !STILL
    let before = reproject(hit, receiver_normal(m.receiver), pixel, x, y);
    if before.pixel == NONE {
        count(REUSE_REJECTED, 1u);
        return;
    }
    pixel_before = before.pixel;
    m.receiver_before =
        receiver_new(BEFORE, before.hit, primary_direction_before(before.x, before.y));
    //#endif
    //#endif
    for (var chain = 0u; chain < chains(); chain++) {
        merge_history(&m, pixel, pixel_before, chain);
    }
}

// Merges one chain of a pixel with that of `pixel_before`.
fn merge_history(m: ptr<function, Merge>, pixel: u32, pixel_before: u32, chain: u32) {
    let at = chain_place(pixel, chain);
    let from_at = chain_place(pixel_before, chain);
    let own = read_record(buffer_now(B_RESERVOIRS), at);
    let history = aged(read_record(history_of(B_RESERVOIRS, B_HISTORY), from_at));
    if record_confidence(history) == 0.0 {
        return;
    }
    count(TEMPORAL_MERGES, 1u);
    (*m).records[0] = own;
    (*m).records[1] = history;
    //#if CONTROL
    let control = read_control(buffer_now(B_CONTROLS), at);
    let history_control = read_control(history_of(B_CONTROLS, B_HISTORY_CONTROLS), from_at);
    (*m).controls[0] = control;
    (*m).controls[1] = history_control;
    (*m).is_seen = false;
    //#endif
    var r = reservoir_new();
    var random = chain_stream(pixel, PURPOSE_SELECTION, 1u, chain);
    let merged = merge(m, FAMILY, 1u, &r, &random);
    count(WEIGHTS_REJECTED, r.rejected);

    // What the selected sample brings with it.
    var age = record_age(own);
    var bits = record_policy_bits(own);
    if merged.source > 0u {
        age = record_age(history) + 1u;
        bits = policy_a_frame_later(record_policy_bits(history));
    }
    bits = policy_averaged(bits, reservoir_visibility(r));

    // The estimate beside it: C = Σ m F W + a (C̄ − F̃).
    //#if CONTROL
    let confidence = min(record_confidence(history), CAP);
    let share = confidence / (confidence + record_confidence(own));
    let corrected =
        r.radiance + correction(share, history_control, (*m).receiver_before, history);
    let visible = select((*m).is_seen, control_visible(control), merged.source == 0u);
    write_control(buffer_now(B_CONTROLS), at, control_new(finite_or_counted(corrected), visible));
    //#endif
    write_record(buffer_now(B_RESERVOIRS), at, record_new(
        merged.finished.sample,
        merged.finished.weight,
        merged.finished.confidence,
        merged.target_luminance,
        age,
        bits,
    ));
}
