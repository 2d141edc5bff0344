// Twin of `pass`: what a kernel is given of the frame, and primary hits as they lie in the loop's
// first buffer.

// The numbers of a cell (a pixel, tile or item) in this frame for one purpose and round.
fn stream_of(cell: u32, purpose: u32, round_: u32) -> Stream {
    return stream_new(inputs.run, cell, inputs.frame, purpose, round_);
}

// The first round of the hash of a pixel's path seeds in this frame.
fn pixel_seeds(pixel: u32) -> vec4<u32> {
    return pcg4d(vec4<u32>(inputs.run, pixel, inputs.frame));
}

// How many independent estimates a pixel gets in this frame: one more than others where its number
// in a lattice, shifted anew in each frame, is below the effort's fraction.
fn estimates_of(x: u32, y: u32) -> u32 {
    if inputs.extra_share == 0u {
        return inputs.effort;
    }
    var random = stream_of(0u, PURPOSE_EFFORT, 0u);
    let place = x * 3242174889u + y * 2447445414u + stream_word(&random);
    return inputs.effort + select(0u, 1u, place < inputs.extra_share);
}

fn sample_position(camera_frame: u32, x: u32, y: u32, sample: u32) -> vec2f {
    let corner = vec2f(f32(x), f32(y));
    if inputs.box_filter == 0u {
        return corner + vec2f(0.5);
    }
    let pixel = y * inputs.size.x + x;
    var jitter = stream_new(inputs.run, pixel, camera_frame, PURPOSE_JITTER, sample);
    let u = stream_uniform(&jitter);
    return corner + vec2f(u, stream_uniform(&jitter));
}

// Unit direction of a pixel's first primary ray.
fn primary_direction(x: u32, y: u32) -> vec3f {
    return camera_ray(inputs.camera, sample_position(inputs.frame, x, y, 0u)).direction;
}

// The same in the previous frame.
fn primary_direction_before(x: u32, y: u32) -> vec3f {
    let position = sample_position(inputs.frame - 1u, x, y, 0u);
    return camera_ray(inputs.camera_before, position).direction;
}

fn read_hit(at: u32) -> Hit {
    return Hit(
        bitcast<f32>(state[at]),
        bitcast<f32>(state[at + 1u]),
        bitcast<f32>(state[at + 2u]),
        state[at + 3u],
        state[at + 4u],
    );
}

fn primary_hit(pixel: u32) -> Hit {
    return read_hit(buffer_now(HITS) + pixel * 5u);
}

fn primary_hit_before(pixel: u32) -> Hit {
    return read_hit(buffer_before(HITS) + pixel * 5u);
}

fn write_hit(pixel: u32, hit: Hit) {
    let at = buffer_now(HITS) + pixel * 5u;
    // A miss has an infinite distance, which no expression of this language may make.
    state[at] = select(bitcast<u32>(hit.t), 0x7f800000u, hit.primitive == MISS);
    state[at + 1u] = bitcast<u32>(hit.u);
    state[at + 2u] = bitcast<u32>(hit.v);
    state[at + 3u] = hit.primitive;
    state[at + 4u] = hit.instance;
}
