//! Seeds of the parts of a run: no two parts share one.

use crate::math::rng::pcg4d;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uses_techniques_and_restarts_have_seeds_of_their_own() {
        let mut seen = std::collections::HashSet::new();
        for run in [0, 1, u64::MAX] {
            for what in [
                SeedUse::Restart,
                SeedUse::Calibration,
                SeedUse::Pilot,
                SeedUse::Curve,
                SeedUse::Reference,
                SeedUse::SecondStage,
                SeedUse::Check,
            ] {
                for technique in 0..10 {
                    for index in 0..100 {
                        assert!(seen.insert(seed(run, what, technique, index)));
                    }
                }
            }
        }
    }
}
