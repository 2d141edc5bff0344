//! Lobes of the previous frame around a place, taken in proportion to their scores.

use std::sync::LazyLock;

use glam::IVec2;

use super::LobeState;
use crate::math::rng::Stream;
use crate::resampling::{Plain, Reservoir};

/// Entries of the table of offsets: 12 bits an axis.
const ENTRIES: usize = 1 << 12;

/// Bits behind the point of the table's numbers, and of a scale in pixels; a product of both is
/// below 2³¹ for scales up to 1,000.
const UNIT_BITS: u32 = 13;
const SCALE_BITS: u32 = 6;

/// Quantiles of the sum of six uniform numbers less 3, which has the density of a B-spline of
/// degree 5, at the centres of [`ENTRIES`] cells: variance ½, reach ±3. In whole numbers, since
/// rounding to pixels is a call into the system's library otherwise.
static UNITS: LazyLock<[i16; ENTRIES]> = LazyLock::new(|| {
    // Distribution function of the sum s of six uniforms: Σ (−1)ᵏ C(6, k) (s − k)⁶₊ / 6!.
    const BINOMIAL: [f64; 7] = [1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0];
    let below = |s: f64| -> f64 {
        let terms = BINOMIAL.iter().zip(0..);
        terms.map(|(c, k)| c * (s - f64::from(k)).max(0.0).powi(6)).sum::<f64>() / 720.0
    };
    std::array::from_fn(|entry| {
        let wanted = (entry as f64 + 0.5) / ENTRIES as f64;
        let (mut low, mut high) = (0.0, 6.0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if below(middle) < wanted { low = middle } else { high = middle }
        }
        ((0.5 * (low + high) - 3.0) * f64::from(1 << UNIT_BITS)).round() as i16
    })
});

/// How a pixel looks for lobes in its surroundings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reads {
    count: u32,
    /// In 2⁻⁶ pixels.
    scale: i32,
    units: &'static [i16; ENTRIES],
}

impl Reads {
    /// Looks at `count` states in a window whose unit is `scale` pixels: it reaches three of them.
    pub(crate) fn new(count: u32, scale: f32) -> Self {
        let scale = (scale * (1 << SCALE_BITS) as f32).round() as i32;
        Self { count, scale, units: &UNITS }
    }

    /// The offset of a word's 12 highest and 12 lowest bits, in pixels.
    #[inline]
    pub(crate) fn offset(&self, word: u32) -> IVec2 {
        const BITS: u32 = UNIT_BITS + SCALE_BITS;
        let along = |entry: u32| {
            let unit = i32::from(self.units[entry as usize & (ENTRIES - 1)]);
            (unit * self.scale + (1 << (BITS - 1))) >> BITS
        };
        IVec2::new(along(word >> 20), along(word))
    }

    /// The place in `previous`, a picture of `size` pixels, around pixel `center`; `None` outside.
    #[inline]
    pub(crate) fn place(&self, word: u32, center: IVec2, size: [u32; 2]) -> Option<u32> {
        let at = center.wrapping_add(self.offset(word)).as_uvec2();
        // Negative coordinates wrap to large ones.
        (at.x < size[0] && at.y < size[1]).then(|| at.y * size[0] + at.x)
    }

    /// One of `own` and of the states that are looked at, in proportion to `score`; `None` keeps
    /// `own`, also where all have a score of 0.
    #[inline]
    pub(crate) fn choose(
        &self,
        own: &LobeState,
        previous: &[LobeState],
        (center, size): (IVec2, [u32; 2]),
        score: impl Fn(&LobeState) -> f32,
        random: &mut Stream,
    ) -> Option<LobeState> {
        let mut reservoir = Plain::default();
        reservoir.stream(None, score(own), (), random);
        for _ in 0..self.count {
            let Some(place) = self.place(random.word(), center, size) else { continue };
            let found = &previous[place as usize];
            reservoir.stream(Some(place), score(found), (), random);
        }
        reservoir.selected().flatten().map(|place| previous[place as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean 0, variance 15² · 6/12 per axis, within ±45: the window of 91 pixels.
    #[test]
    fn offsets_are_those_of_a_spline_of_degree_five() {
        let reads = Reads::new(1, 15.0);
        let mut random = Stream::from_key(3);
        let (mut sum, mut squares, mut product, n) = ([0.0; 2], [0.0; 2], 0.0, 400_000);
        for _ in 0..n {
            let offset = reads.offset(random.word()).as_dvec2().to_array();
            for axis in 0..2 {
                sum[axis] += offset[axis];
                squares[axis] += offset[axis] * offset[axis];
                assert!(offset[axis].abs() <= 45.0);
            }
            product += offset[0] * offset[1];
        }
        let n = f64::from(n);
        for axis in 0..2 {
            let (mean, variance) = (sum[axis] / n, squares[axis] / n);
            // Four standard errors; rounding to pixels adds 1/12.
            assert!(mean.abs() < 4.0 * (112.5 / n).sqrt(), "{mean}");
            assert!((variance - 112.5 - 1.0 / 12.0).abs() < 0.01 * 112.5, "{variance}");
        }
        assert!((product / n).abs() < 4.0 * 112.5 / n.sqrt());
        // The fourth moment tells degree 5 from others: kurtosis 3 − 6/(5 · 6) = 2.8.
        let fourth: f64 = UNITS.iter().map(|u| f64::from(*u).powi(4)).sum();
        let second: f64 = UNITS.iter().map(|u| f64::from(*u).powi(2)).sum();
        let kurtosis = fourth / second.powi(2) * ENTRIES as f64;
        assert!((kurtosis - 2.8).abs() < 0.01, "{kurtosis}");
    }

    /// States are chosen in proportion to their scores, χ² over 20,000 choices; one of score 0
    /// never is, and outside of the picture nothing is.
    #[test]
    fn states_are_chosen_by_their_scores() {
        let reads = Reads::new(5, 0.0);
        let lobe = |light: u32, score: f32| {
            let mut lobe = LobeState::NONE;
            (lobe.light, lobe.score) = (light, score);
            lobe
        };
        let (own, previous) = (lobe(1, 2.0), [lobe(2, 3.0)]);
        let mut random = Stream::from_key(4);
        let (at, n) = ((IVec2::ZERO, [1, 1]), 20_000);
        let mut taken = 0;
        for _ in 0..n {
            let chosen = reads.choose(&own, &previous, at, |lobe| lobe.score, &mut random);
            taken += u32::from(chosen.is_some());
        }
        let share = 15.0 / 17.0;
        let deviation = f64::from(n) * share * (1.0 - share);
        assert!(
            (f64::from(taken) - f64::from(n) * share).abs() < 4.0 * deviation.sqrt(),
            "{taken}"
        );
        for (own, other) in [(2.0, 0.0), (0.0, 0.0)] {
            for _ in 0..200 {
                let (own, previous) = (lobe(1, own), [lobe(2, other)]);
                let chosen = reads.choose(&own, &previous, at, |lobe| lobe.score, &mut random);
                assert!(chosen.is_none());
            }
        }
        let outside = (IVec2::new(-1, 0), [1, 1]);
        assert!(reads.choose(&own, &previous, outside, |_| 1.0, &mut random).is_none());
    }
}
