// Twin of `path_tracer.rs`.

override SAMPLED: u32 = 1u;
override ROULETTE_AFTER: u32 = 5u;

fn paths(pixel: u32, x: u32, y: u32) {
    let box_filter = inputs.box_filter != 0u;
    let estimates = estimates_of(x, y);
    var sum = vec3f(0.0);
    var seen = vec3f(0.0);
    for (var sample = 0u; sample < estimates; sample++) {
        let ray = camera_ray(inputs.camera, sample_position(inputs.frame, x, y, sample));
        var hit: Hit;
        if box_filter {
            count(PRIMARY_RAYS, 1u);
            hit = camera_hit(NOW, ray);
            if hit.primitive == MISS {
                seen += escaped_radiance(NOW, ray.direction);
            } else {
                seen += emitted(NOW, point_at(NOW, hit), ray.direction);
            }
        } else {
            hit = primary_hit(pixel);
        }
        if hit.primitive != MISS {
            let seed = path_seed(inputs.run, pixel, inputs.frame, sample);
            sum += finite_or_counted(walk(seed, ray.direction, hit, ROULETTE_AFTER, SAMPLED, true));
        }
    }
    let mean = 1.0 / f32(estimates);
    write_vector(buffer_now(RADIANCE) + pixel * 3u, sum * mean);
    if box_filter {
        write_vector(buffer_now(EMISSION) + pixel * 3u, seen * mean);
    }
}
