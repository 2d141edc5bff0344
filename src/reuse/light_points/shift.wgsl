// Twin of the shift of `reuse::light_points::receiver`: a light point keeps its place on its light.

// A light point of the world `from_w` at a receiver.
fn shift_to(point: LightPoint, from_w: u32, receiver: Receiver) -> Shifted {
    var shifted = Shifted(point, vec3f(0.0), 1.0, false);
    count(SHIFTS, 1u);
    let moved = carried_over(point, from_w, receiver.w);
    if moved.jacobian > 0.0 {
        let look = receiver_look(receiver, moved.point);
        var visible = look.sight.valid;
        //#if POLICY=IN_TARGET
        if visible {
            visible = receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
        }
        //#endif
        if visible {
            shifted = Shifted(moved.point, look.sight.integrand, moved.jacobian, true);
        }
    }
    count_if(SHIFTS_FAILED, !shifted.valid);
    return shifted;
}

// A light point of one world in another; the ratio of the light's areas, 0 where there is none.
struct Moved {
    point: LightPoint,
    jacobian: f32,
}

fn carried_over(point: LightPoint, from_w: u32, to_w: u32) -> Moved {
    if from_w == to_w {
        return Moved(point, 1.0);
    }
    var light = point.light;
    if inputs.remap.x != NONE {
        let first = select(inputs.remap.z, inputs.remap.x, to_w == NOW);
        let length = select(inputs.remap.w, inputs.remap.y, to_w == NOW);
        if light >= length {
            return Moved(point, 0.0);
        }
        light = words[first + light];
        if light == NO_LIGHT {
            return Moved(point, 0.0);
        }
    }
    let moved = LightPoint(light, point.uv);
    if !same_kind(to_w, light, from_w, point.light) {
        return Moved(moved, 0.0);
    }
    let jacobian = light_measure(to_w, moved) / light_measure(from_w, point);
    return Moved(moved, select(0.0, jacobian, is_finite(jacobian) && jacobian > 0.0));
}
