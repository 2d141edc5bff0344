// Twin of `reuse::shade`: what a finished reservoir shows of its pixel.

// F V W, and the policy's bits, which hold the outcome of a ray where one was traced.
struct Shown {
    radiance: vec3f,
    bits: u32,
}

// What a reservoir's sample shows at its own receiver. Its integrand is `known` where a merge chose
// another input's sample.
fn shown_of(
    receiver: Receiver,
    sample: Sample,
    weight: f32,
    known: bool,
    integrand: vec3f,
    bits: u32,
) -> Shown {
    if !(weight > 0.0) {
        //#if SHADES_BY_RAY
        count(SHADOW_RAYS_SAVED, 1u);
        //#endif
        return Shown(vec3f(0.0), bits);
    }
    //#if POLICY=IN_TARGET|WIS
    if known {
        return Shown(integrand * (policy_visibility(bits) * weight), bits);
    }
    //#endif
    let sight = sight_of(receiver, sample);
    if !sight_is_valid(sight) {
        return Shown(vec3f(0.0), bits);
    }
    var kept = bits;
    //#if POLICY=IN_TARGET|WIS
    let visibility = policy_visibility(bits);
    //#else
    let outcome = policy_outcome(bits);
    var visible = outcome.seen;
    if outcome.known {
        count(SHADOW_RAYS_SAVED, 1u);
    } else {
        visible = sight_is_seen(receiver, sight);
        kept = policy_traced(bits, visible);
    }
    let visibility = select(0.0, 1.0, visible);
    //#endif
    return Shown(sight_integrand(sight) * (visibility * weight), kept);
}

// Shades what temporal reuse left, where there is no spatial pass.
fn shade(pixel: u32, x: u32, y: u32) {
    // Whether a surface scatters is the same for all chains.
    let first = read_record(buffer_now(B_RESERVOIRS), chain_place(pixel, 0u));
    var sum = vec3f(0.0);
    if record_confidence(first) > 0.0 {
        //#if !CONTROL
        let receiver = receiver_of(pixel);
        //#endif
        for (var chain = 0u; chain < chains(); chain++) {
            let at = chain_place(pixel, chain);
            //#if CONTROL
            let shown = control_estimate(read_control(buffer_now(B_CONTROLS), at));
            //#else
            let record = read_record(buffer_now(B_RESERVOIRS), at);
            let bits = record_policy_bits(record);
            let sample = record_sample(record);
            let none = vec3f(0.0);
            let shown = shown_of(receiver, sample, record.weight, false, none, bits).radiance;
            //#endif
            sum += finite_or_counted(shown);
        }
    }
    write_vector(buffer_now(RADIANCE) + pixel * 3u, sum / f32(chains()));
}
