// Twin of `reuse::light_points::receiver`: what a light point shows to a
// receiver.

struct Receiver {
    w: u32,
    surface: SurfacePoint,
    outgoing: vec3f,
}

struct Sight {
    integrand: vec3f,
    bsdf_density: f32,
    arrival: Arrival,
    valid: bool,
}

// A sight with the emitter that it is of.
struct Look {
    sight: Sight,
    emitter: EmitterPoint,
}

fn receiver_new(w: u32, hit: Hit, direction: vec3f) -> Receiver {
    let surface = surface_at(w, hit, point_at(w, hit));
    return Receiver(w, surface, to_local(surface.frame, -direction));
}

fn receiver_scatters(receiver: Receiver) -> bool {
    return !bsdf_is_black(receiver.surface.bsdf) && bsdf_has_non_delta(receiver.surface.bsdf);
}

fn receiver_sight(receiver: Receiver, emitter: EmitterPoint) -> Sight {
    var sight: Sight;
    sight.valid = false;
    sight.arrival = emitter_towards(receiver.w, emitter, receiver.surface.position);
    if !sight.arrival.valid {
        return sight;
    }
    let scattered = bsdf_evaluate(
        receiver.surface.bsdf,
        receiver.outgoing,
        to_local(receiver.surface.frame, sight.arrival.direction),
    );
    sight.integrand = scattered.value * sight.arrival.radiance;
    sight.bsdf_density = scattered.pdf * sight.arrival.geometry;
    sight.valid = !all_zero(sight.integrand);
    return sight;
}

fn receiver_look(receiver: Receiver, point: LightPoint) -> Look {
    var look: Look;
    look.emitter = light_emitter(receiver.w, point);
    look.sight.valid = false;
    if look.emitter.valid {
        look.sight = receiver_sight(receiver, look.emitter);
    }
    return look;
}

fn receiver_normal(receiver: Receiver) -> vec3f {
    return receiver.surface.frame.normal;
}

// One shadow ray.
fn receiver_sees(receiver: Receiver, direction: vec3f, emitter: EmitterPoint) -> bool {
    let end = shadow_end(receiver.w, emitter, receiver.surface.position);
    count(SHADOW_RAYS, 1u);
    return !occluded(receiver.w, shadow_ray(receiver.surface, direction, end));
}
