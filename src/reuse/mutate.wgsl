// Twin of `reuse::mutate`: a sample moves by a Markov chain that leaves p̂ invariant, so pixels
// that took the same sample stop sharing it.

fn mutate(pixel: u32, x: u32, y: u32) {
    let hit = primary_hit(pixel);
    if hit.primitive == MISS {
        return;
    }
    var any = false;
    for (var chain = 0u; chain < chains(); chain++) {
        let record = read_record(buffer_now(B_RESERVOIRS), chain_place(pixel, chain));
        any = any || record.weight > 0.0;
    }
    if !any {
        return;
    }
    let receiver = receiver_new(NOW, hit, primary_direction(x, y));
    for (var chain = 0u; chain < chains(); chain++) {
        mutate_chain(receiver, pixel, chain);
    }
}

fn mutate_chain(receiver: Receiver, pixel: u32, chain: u32) {
    let at = chain_place(pixel, chain);
    let record = read_record(buffer_now(B_RESERVOIRS), at);
    if !(record.weight > 0.0) {
        return;
    }
    var random = chain_stream(pixel, PURPOSE_MUTATION, 0u, chain);
    let moved = mutated(receiver, record_sample(record), &random);
    if !moved.any {
        return;
    }
    var bits = record_policy_bits(record);
    //#if KEEPS_OUTCOME
    // What the ray to the old sample said is not true of the new one.
    let visible = is_seen(receiver, moved.sample);
    bits = policy_traced(bits, visible);
    //#if CONTROL
    let control = read_control(buffer_now(B_CONTROLS), at);
    write_control(buffer_now(B_CONTROLS), at, control_new(control_estimate(control), visible));
    //#endif
    //#endif
    write_record(buffer_now(B_RESERVOIRS), at, record_new(
        moved.sample,
        mutated_weight(record.weight, moved.target_before, moved.target_after),
        record_confidence(record),
        moved.target_after,
        record_age(record),
        bits,
    ));
}
