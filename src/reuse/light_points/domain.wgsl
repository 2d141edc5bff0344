// Twin of `reuse::light_points::domain`: light points as a domain of the passes of reuse.

fn sight_of(receiver: Receiver, point: LightPoint) -> Look {
    return receiver_look(receiver, point);
}

fn sight_is_valid(look: Look) -> bool {
    return look.sight.valid;
}

fn sight_integrand(look: Look) -> vec3f {
    return look.sight.integrand;
}

fn sight_is_seen(receiver: Receiver, look: Look) -> bool {
    return receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
}
