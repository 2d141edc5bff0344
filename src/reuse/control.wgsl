// Twin of `reuse::control`: the state of the control variate. Needs nothing.

// An estimate in RGB with one exponent, and whether the selected sample is seen: two words.
const CONTROL_BIAS: i32 = 16384;

// The smallest e with x < 2^e, for positive x.
fn exponent_above(x: f32) -> i32 {
    let bits = bitcast<u32>(x);
    let exponent = (bits >> 23u) & 255u;
    if exponent == 0u {
        return 32 - i32(countLeadingZeros(bits)) - 149;
    }
    return i32(exponent) - 126;
}

// x · 2^e in two steps, each within the exponents of normal numbers.
fn scaled(x: f32, e: i32) -> f32 {
    let half_e = e / 2;
    let rest = e - half_e;
    return x * bitcast<f32>(u32(clamp(half_e, -126, 127) + 127) << 23u)
        * bitcast<f32>(u32(clamp(rest, -126, 127) + 127) << 23u);
}

fn rounded_away(x: f32) -> f32 {
    let whole = trunc(x);
    if abs(x - whole) >= 0.5 {
        return whole + sign(x);
    }
    return whole;
}

fn mantissa(x: f32, exponent: i32) -> u32 {
    return u32(i32(clamp(rounded_away(scaled(x, 15 - exponent)), -32767.0, 32767.0))) & 0xffffu;
}

fn control_new(estimate: vec3f, visible: bool) -> vec2<u32> {
    let largest = max(abs(estimate.x), max(abs(estimate.y), abs(estimate.z)));
    let flag = select(0u, 0x80000000u, visible);
    if largest == 0.0 {
        return vec2<u32>(0u, flag | (u32(CONTROL_BIAS) << 16u));
    }
    let exponent = exponent_above(largest);
    return vec2<u32>(
        mantissa(estimate.x, exponent) | (mantissa(estimate.y, exponent) << 16u),
        mantissa(estimate.z, exponent) | flag | (u32(exponent + CONTROL_BIAS) << 16u),
    );
}

fn signed16(bits: u32) -> f32 {
    return f32(i32(bits << 16u) >> 16u);
}

fn control_estimate(control: vec2<u32>) -> vec3f {
    let exponent = i32((control.y >> 16u) & 0x7fffu) - CONTROL_BIAS;
    return vec3f(
        scaled(signed16(control.x & 0xffffu), exponent - 15),
        scaled(signed16(control.x >> 16u), exponent - 15),
        scaled(signed16(control.y & 0xffffu), exponent - 15),
    );
}

fn control_visible(control: vec2<u32>) -> bool {
    return (control.y >> 31u) != 0u;
}
