// Twin of the frame loop's own pass: hits through pixel centres, and directly visible emission.

@compute @workgroup_size(8, 8)
fn primary_hits(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= inputs.size.x || id.y >= inputs.size.y {
        return;
    }
    let pixel = id.y * inputs.size.x + id.x;
    let ray = camera_ray(inputs.camera, sample_position(inputs.frame, id.x, id.y, 0u));
    let hit = closest_hit(NOW, ray);
    var seen: vec3f;
    if hit.primitive == MISS {
        seen = escaped_radiance(NOW, ray.direction);
    } else {
        seen = emitted(NOW, point_at(NOW, hit), ray.direction);
    }
    write_vector(buffer_now(EMISSION) + pixel * 3u, seen);
    write_hit(pixel, hit);
    count(PRIMARY_RAYS, 1u);
    finish_counting();
}
