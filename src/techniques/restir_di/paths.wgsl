// Twin of `paths` of `kernels.rs`: the path tracer's share, all light or what is left beside the
// resampled light, which is there already.

override ROULETTE_AFTER: u32 = 5u;
override ALL_LIGHT: bool = false;

// Path seeds of other light are numbered from here on, candidates from 0.
const OTHER_PATHS: u32 = 0x80000000u;

fn paths(pixel: u32, x: u32, y: u32) {
    let estimates = estimates_of(x, y);
    let hit = primary_hit(pixel);
    var sum = vec3f(0.0);
    if hit.primitive != MISS {
        let direction = primary_direction(x, y);
        for (var sample = 0u; sample < estimates; sample++) {
            let number = select(OTHER_PATHS + sample, sample, ALL_LIGHT);
            let seed = path_seed(inputs.run, pixel, inputs.frame, number);
            let path = walk(seed, direction, hit, ROULETTE_AFTER, SAMPLE_ONE, ALL_LIGHT);
            sum += finite_or_counted(path);
        }
    }
    let mean = sum * (1.0 / f32(estimates));
    let at = buffer_now(RADIANCE) + pixel * 3u;
    if ALL_LIGHT {
        write_vector(at, mean);
    } else {
        write_vector(at, read_vector(at) + mean);
    }
}
