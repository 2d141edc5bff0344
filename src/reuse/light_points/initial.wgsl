// Twin of `reuse::light_points::initial`: what a pixel's reservoirs begin with.

// A chain's reservoir before it is stored.
struct Fresh {
    record: Record,
    control: vec2<u32>,
}

fn initial(pixel: u32, x: u32, y: u32) {
    let hit = primary_hit(pixel);
    var normal = 0u;
    var scatters = false;
    var receiver: Receiver;
    if hit.primitive != MISS {
        receiver = receiver_new(NOW, hit, primary_direction(x, y));
        normal = pack_normal(receiver_normal(receiver));
        scatters = receiver_scatters(receiver);
    }
    //#if KEEP_NORMALS
    state[buffer_now(B_NORMALS) + pixel] = normal;
    //#endif
    let tile = tile_of(x, y);
    let each = CANDIDATE_LIGHTS + CANDIDATE_BSDF;
    for (var chain = 0u; chain < chains(); chain++) {
        var fresh = Fresh(record_none(), vec2<u32>(0u));
        if scatters {
            var random = chain_stream(pixel, PURPOSE_SELECTION, 0u, chain);
            let first = chain * each;
            let chosen = candidates(receiver, pixel_seeds(pixel), first, tile, &random);
            fresh = fresh_of(receiver, chosen);
        }
        let at = chain_place(pixel, chain);
        write_record(buffer_now(B_RESERVOIRS), at, fresh.record);
        //#if CONTROL
        write_control(buffer_now(B_CONTROLS), at, fresh.control);
        //#endif
    }
}

// The reservoir of a selected candidate, with what the policy keeps of its visibility.
fn fresh_of(receiver: Receiver, chosen: Chosen) -> Fresh {
    var target_luminance = 0.0;
    var weight = 0.0;
    if chosen.valid {
        target_luminance = luminance(chosen.sight.integrand);
        weight = contribution_weight(chosen.weight_sum, target_luminance, 1.0);
    }
    var bits = 0u;
    var control = vec2<u32>(0u);
    //#if TRACES_INITIAL
    if weight > 0.0 {
        let seen = receiver_sees(receiver, chosen.sight.arrival.direction, chosen.emitter);
        bits = policy_traced(0u, seen);
        //#if CONTROL
        let shown = chosen.sight.integrand * select(0.0, weight, seen);
        control = control_new(finite_or_counted(shown), seen);
        //#endif
        //#if DROPS_OCCLUDED
        if !seen {
            weight = 0.0;
        }
        //#endif
    } else {
        count(SHADOW_RAYS_SAVED, 1u);
    }
    //#endif
    let record = record_new(chosen.point, weight, 1.0, target_luminance, 0u, bits);
    return Fresh(record, control);
}
