//! Seeds of the parts of a run: no two parts share one.

use crate::math::rng::pcg4d;

#[cfg(test)]
mod tests;

/// What a seed is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum SeedUse {
    /// A restart of a technique that is judged.
    Restart = 1,
    /// Frames whose time is measured.
    Calibration = 2,
    /// Frames that estimate how much a technique varies before its reference is made.
    Pilot = 3,
    /// Points of the error-against-time curve.
    Curve = 4,
    /// The reference.
    Reference = 5,
    /// The second stage of a test.
    SecondStage = 6,
    /// Frames that a cached reference is checked against.
    Check = 7,
}

/// The seed of the `index`-th piece of what technique number `technique` does for one use.
pub(crate) fn seed(run: u64, what: SeedUse, technique: u32, index: u32) -> u64 {
    let low = pcg4d([run as u32, (run >> 32) as u32, what as u32, technique]);
    let [a, b, ..] = pcg4d([low[0], low[1] ^ index, low[2], low[3]]);
    u64::from(a) | u64::from(b) << 32
}
