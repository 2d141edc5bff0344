//! Visibility averaged along the chain of merges (Tokuyoshi 2024, eq. 4): V̄ = Σ V̄ᵢ wᵢ / Σ wᵢ.

use super::Policy;

/// [`super::Visibility::Wis`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wis;

impl Policy for Wis {
    const TRACES_TERMS: bool = true;

    fn traced(self, _bits: u16, seen: bool) -> u16 {
        pack_average(f32::from(u8::from(seen)))
    }

    fn average(self, bits: u16) -> f32 {
        unpack_average(bits)
    }

    fn averaged(self, _bits: u16, average: f32) -> u16 {
        pack_average(average)
    }

    fn visibility(self, bits: u16) -> Option<f32> {
        Some(unpack_average(bits))
    }
}

/// An average in [0, 1] as 16 bits, rounded to nearest. A chain of averages needs that: truncation
/// loses 25 % over a cap of 20 with 6 bits.
#[inline]
pub(crate) fn pack_average(average: f32) -> u16 {
    (average * 65535.0 + 0.5) as u16
}

/// Inverse of [`pack_average`]; 0 and 1 are exact.
#[inline]
pub(crate) fn unpack_average(bits: u16) -> f32 {
    f32::from(bits) / 65535.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_round_to_the_nearest_and_ends_are_exact() {
        for bits in 0..=u16::MAX {
            assert_eq!(pack_average(unpack_average(bits)), bits);
        }
        assert_eq!((pack_average(0.0), pack_average(1.0)), (0, u16::MAX));
        for bits in (0..u16::MAX).step_by(101) {
            let between = |part: f32| pack_average((f32::from(bits) + part) / 65535.0);
            assert_eq!((between(0.4), between(0.6)), (bits, bits + 1));
        }
    }

    /// A chain of averages V̄ ← (20 V̄ + v) / 21 over 500 frames: the stored mean drifts by less
    /// than 0.2 % of what f64 keeps; 6 truncated bits, the control, lose a quarter.
    #[test]
    fn chains_of_averages_do_not_drift() {
        use crate::math::rng::{RandomSource, Stream};
        let (mut stored, mut exact, mut truncated) = (0.0, 0.0, 0.0);
        for run in 0..200 {
            let mut random = Stream::from_key(run);
            let (mut a, mut b, mut c) = (pack_average(0.5), 0.5_f64, 0.5_f32);
            for _ in 0..500 {
                let v = f32::from(u8::from(random.uniform() < 0.3));
                a = pack_average((20.0 * unpack_average(a) + v) / 21.0);
                b = (20.0 * b + f64::from(v)) / 21.0;
                c = ((20.0 * c + v) / 21.0 * 63.0).floor() / 63.0;
            }
            stored += f64::from(unpack_average(a));
            exact += b;
            truncated += f64::from(c);
        }
        assert!((stored / exact - 1.0).abs() < 0.002, "{stored} against {exact}");
        assert!(truncated / exact < 0.85, "the control must drift: {truncated} against {exact}");
    }
}
