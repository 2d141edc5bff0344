// Twin of `reuse::policy`: what the passes ask of a visibility policy. Directives know it as
// POLICY, by names that Rust declares, and its constants as flags: TRACES_INITIAL, DROPS_OCCLUDED,
// TRACES_TERMS, SHADES_BY_RAY, KEEPS_OUTCOME, CONTROL. A policy keeps 16 bits beside each
// reservoir.

//#if POLICY=REUSE
override VISIBILITY_AGE: u32 = 4u;
override VISIBILITY_DISTANCE: u32 = 16u;
//#endif

// A stored outcome of a shadow ray, where there is one that may still be used.
struct Outcome {
    known: bool,
    seen: bool,
}

// The bits of a sample whose ray said `seen` in this frame, at this pixel.
fn policy_traced(bits: u32, seen: bool) -> u32 {
    var traced = bits;
    //#if POLICY=REUSE
    traced = reused_pack(reused_fresh(seen));
    //#endif
    //#if POLICY=WIS
    traced = pack_average(select(0.0, 1.0, seen));
    //#endif
    return traced;
}

// The bits in the next frame.
fn policy_a_frame_later(bits: u32) -> u32 {
    var later = bits;
    //#if POLICY=REUSE
    later = reused_pack(reused_moved(reused_unpack(bits), 1u, 0u));
    //#endif
    return later;
}

// The bits at a pixel that is `pixels` away.
fn policy_from_afar(bits: u32, pixels: u32) -> u32 {
    var there = bits;
    //#if POLICY=REUSE
    there = reused_pack(reused_moved(reused_unpack(bits), 0u, pixels));
    //#endif
    return there;
}

// The averaged visibility that an input brings to a merge; 0 where none is averaged.
fn policy_average(bits: u32) -> f32 {
    var average = 0.0;
    //#if POLICY=WIS
    average = unpack_average(bits);
    //#endif
    return average;
}

// The bits after a merge whose reservoir averaged to `average`.
fn policy_averaged(bits: u32, average: f32) -> u32 {
    var averaged = bits;
    //#if POLICY=WIS
    averaged = pack_average(average);
    //#endif
    return averaged;
}

// The visibility that shading uses, for policies that ask for no ray there.
fn policy_visibility(bits: u32) -> f32 {
    var visibility = 1.0;
    //#if POLICY=WIS
    visibility = unpack_average(bits);
    //#endif
    return visibility;
}

// The stored outcome of the selected sample.
fn policy_outcome(bits: u32) -> Outcome {
    var outcome = Outcome(false, false);
    //#if POLICY=REUSE
    let stored = reused_unpack(bits);
    if reused_usable(stored, VISIBILITY_AGE, VISIBILITY_DISTANCE) {
        outcome = Outcome(true, stored.visible);
    }
    //#endif
    return outcome;
}
