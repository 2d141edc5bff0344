// Twin of `reuse::policy::stored`: outcomes of shadow rays that are used again. Needs nothing.

// A stored outcome: 1 bit visible, 7 bits distance in pixels, 8 bits age in frames.
struct Reused {
    visible: bool,
    distance: u32,
    age: u32,
}

fn reused_fresh(visible: bool) -> Reused {
    return Reused(visible, 0u, 0u);
}

fn reused_pack(r: Reused) -> u32 {
    return (select(0u, 1u, r.visible) << 15u) | (min(r.distance, 127u) << 8u) | min(r.age, 255u);
}

fn reused_unpack(bits: u32) -> Reused {
    return Reused((bits >> 15u) != 0u, (bits >> 8u) & 127u, bits & 255u);
}

fn reused_moved(r: Reused, frames: u32, pixels: u32) -> Reused {
    return Reused(r.visible, r.distance + pixels, r.age + frames);
}

fn reused_usable(r: Reused, max_age: u32, max_distance: u32) -> bool {
    return (r.age <= max_age || max_age >= 255u) && r.distance <= max_distance;
}
