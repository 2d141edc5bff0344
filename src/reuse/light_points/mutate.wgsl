// Twin of `reuse::light_points::mutate`, and of the domain's `mutated`: moves of a light point.

override STEPS: u32 = 0u;
override LARGE_STEPS: f32 = 0.3;

const LARGEST_STEP: f32 = 1.0 / 64.0;
const LOG_RATIO: f32 = 2.7725887;

struct PointState {
    point: LightPoint,
    integrand: vec3f,
    measure: f32,
    valid: bool,
}

// Where a chain ended; `any`: whether it moved at all.
struct Mutated {
    sample: LightPoint,
    target_before: f32,
    target_after: f32,
    any: bool,
}

struct Proposal {
    state: PointState,
    acceptance: f32,
    valid: bool,
}

fn perturbed(u: f32, random: ptr<function, Stream>) -> f32 {
    let step = LARGEST_STEP * exp(-LOG_RATIO * stream_uniform(random));
    let moved = select(u - step, u + step, stream_choose(random, 1.0, 2.0));
    let wrapped_u = moved - floor(moved);
    return select(0.0, wrapped_u, wrapped_u < 1.0);
}

// The state at a light point; with `asked`, only where it is seen.
fn point_state(receiver: Receiver, point: LightPoint, asked: bool) -> PointState {
    let look = receiver_look(receiver, point);
    var s = PointState(point, look.sight.integrand, 0.0, look.sight.valid);
    if !s.valid {
        return s;
    }
    if asked {
        s.valid = receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
    }
    s.measure = light_measure(NOW, point);
    s.valid = s.valid && is_finite(s.measure);
    return s;
}

// Another light, or a step on the same one.
fn propose(
    receiver: Receiver,
    current: PointState,
    random: ptr<function, Stream>,
) -> Proposal {
    count(MUTATIONS, 1u);
    var proposal = Proposal(current, 0.0, false);
    let large = stream_choose(random, LARGE_STEPS, 1.0);
    var point: LightPoint;
    if large {
        let index = stream_index(random, NONE);
        let light = choose_light(NOW, index, stream_index(random, NONE));
        let u = stream_uniform(random);
        point = light_point_with(NOW, light, vec2f(u, stream_uniform(random)));
    } else {
        let u = perturbed(current.point.uv.x, random);
        let uv = vec2f(u, perturbed(current.point.uv.y, random));
        point = light_point_with(NOW, current.point.light, uv);
    }
    let same = point.light == current.point.light && point.uv.x == current.point.uv.x
        && point.uv.y == current.point.uv.y;
    if same {
        return proposal;
    }
    //#if POLICY=IN_TARGET
    proposal.state = point_state(receiver, point, true);
    //#else
    proposal.state = point_state(receiver, point, false);
    //#endif
    if !proposal.state.valid {
        return proposal;
    }
    let next = proposal.state;
    var ratio = luminance(next.integrand) / luminance(current.integrand)
        * (next.measure / current.measure);
    if large {
        ratio *= choice_probability(NOW, current.point.light)
            / choice_probability(NOW, point.light);
    }
    proposal.acceptance = min(ratio, 1.0);
    proposal.valid = true;
    return proposal;
}

fn mutated(receiver: Receiver, sample: LightPoint, random: ptr<function, Stream>) -> Mutated {
    // The point was drawn with a positive target, which only rounding can take from it.
    let start = point_state(receiver, sample, false);
    if !start.valid {
        return Mutated(sample, 0.0, 0.0, false);
    }
    var current = start;
    var accepted = 0u;
    for (var step = 0u; step < STEPS; step++) {
        let proposal = propose(receiver, current, random);
        if proposal.valid && stream_choose(random, proposal.acceptance, 1.0) {
            current = proposal.state;
            accepted += 1u;
        }
    }
    count(MUTATIONS_ACCEPTED, accepted);
    let target_before = luminance(start.integrand);
    return Mutated(current.point, target_before, luminance(current.integrand), accepted > 0u);
}
