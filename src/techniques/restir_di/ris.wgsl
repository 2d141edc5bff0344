// Twin of `ris` of `kernels.rs`: candidates without reuse, F V W of a fresh reservoir.

fn ris(pixel: u32, x: u32, y: u32) {
    let estimates = estimates_of(x, y);
    let hit = primary_hit(pixel);
    var sum = vec3f(0.0);
    if hit.primitive != MISS {
        let receiver = receiver_new(NOW, hit, primary_direction(x, y));
        if receiver_scatters(receiver) {
            sum = sum_of_estimates(receiver, pixel, tile_of(x, y), estimates);
        }
    }
    write_vector(buffer_now(RADIANCE) + pixel * 3u, sum / f32(estimates));
}

fn sum_of_estimates(receiver: Receiver, pixel: u32, tile: u32, estimates: u32) -> vec3f {
    let each = CANDIDATE_LIGHTS + CANDIDATE_BSDF;
    let seeds = pixel_seeds(pixel);
    var sum = vec3f(0.0);
    for (var estimate = 0u; estimate < estimates; estimate++) {
        var random = stream_of(pixel, PURPOSE_SELECTION, estimate);
        let chosen = candidates(receiver, seeds, estimate * each, tile, &random);
        if !chosen.valid {
            count(SHADOW_RAYS_SAVED, 1u);
            continue;
        }
        if receiver_sees(receiver, chosen.sight.arrival.direction, chosen.emitter) {
            let luminance_of_it = luminance(chosen.sight.integrand);
            let weight = contribution_weight(chosen.weight_sum, luminance_of_it, 1.0);
            sum += finite_or_counted(chosen.sight.integrand * weight);
        }
    }
    return sum;
}
