// Twin of `reuse::policy::wis`: averages of visibility in 16 bits. Needs nothing.

fn pack_average(visibility: f32) -> u32 {
    return u32(visibility * 65535.0 + 0.5);
}

fn unpack_average(bits: u32) -> f32 {
    return f32(bits) / 65535.0;
}
