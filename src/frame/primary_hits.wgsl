// Twin of the frame loop's own pass: hits through pixel centres, and directly visible emission.

fn primary_hits(pixel: u32, x: u32, y: u32) {
    let ray = camera_ray(inputs.camera, sample_position(inputs.frame, x, y, 0u));
    let hit = camera_hit(NOW, ray);
    var seen: vec3f;
    if hit.primitive == MISS {
        seen = escaped_radiance(NOW, ray.direction);
    } else {
        seen = emitted(NOW, point_at(NOW, hit), ray.direction);
    }
    write_vector(buffer_now(EMISSION) + pixel * 3u, seen);
    write_hit(pixel, hit);
    count(PRIMARY_RAYS, 1u);
}
