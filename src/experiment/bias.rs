//! Whether a technique's mean is the reference's: the picture and its four quarters, over
//! independent restarts.

use crate::Result;
use crate::report::{Bias, Reference};
use crate::stats::{self, Criteria, PictureTest, Restarts};

/// No restarts yet of a picture in four tiles.
pub(crate) fn restarts(size: [u32; 2]) -> Result<Restarts> {
    let [width, height] = size.map(|side| side as usize);
    // A tile of half the longer side gives two columns and two rows at most, and at least one of
    // each.
    Restarts::new(width, height, width.max(height).div_ceil(2), None)
}

/// The truth that tests compare with, as a reference gives it. One read from a file has no known
/// variance and counts as exact.
pub(crate) fn truth(reference: &Reference) -> Result<stats::Truth> {
    let Some(variance) = reference.pixel_variances() else { return exact(reference) };
    let [width, height] = reference.size().map(|side| side as usize);
    let dof = (reference.frames() - 1) as f64;
    stats::Truth::with_variance(width, height, reference.picture().pixels, variance, dof)
}

/// A reference's means as if they had no error.
pub(crate) fn exact(reference: &Reference) -> Result<stats::Truth> {
    let [width, height] = reference.size().map(|side| side as usize);
    stats::Truth::exact(width, height, reference.picture().pixels)
}

/// Tests restarts against a reference.
pub(crate) fn judge(
    restarts: &Restarts,
    reference: &Reference,
    criteria: &Criteria,
) -> Result<PictureTest> {
    restarts.compare(&truth(reference)?, criteria)
}

/// As `results.json` has it: the difference of mean luminance with its 95 % interval, relative to
/// the reference.
pub(crate) fn report(test: &PictureTest) -> Bias {
    let scale = test.reference_luminance.recip();
    let relative = test.relative();
    let (low, high) = test.luminance.test.interval(0.95);
    let ci = [low * scale, high * scale];
    Bias {
        verdict: test.verdict.name().to_string(),
        // Black against black differs by nothing.
        relative: if relative.is_finite() { relative } else { 0.0 },
        ci: ci.iter().all(|v| v.is_finite()).then_some(ci),
        tiles_rejected: test.tiles.iter().filter(|t| t.rejected).count() as u32,
    }
}

/// Variance of a single restart's pixel, averaged over pixels and channels; infinite with fewer
/// than two restarts.
pub(crate) fn mean_variance(restarts: &Restarts, pixels: usize) -> f64 {
    let sum: f64 = (0..pixels).flat_map(|i| restarts.pixel(i)).map(stats::Moments::variance).sum();
    sum / (3 * pixels) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{pcg4d, unit_float};
    use crate::picture::Picture;
    use crate::stats::Verdict;
    use glam::Vec3;

    const SIZE: [u32; 2] = [16, 12];

    /// Grey pixels uniform in [0, 2), times `gain` in the lower right quarter: c = 0.58.
    fn picture(seed: u32, gain: f32) -> Picture {
        let pixels = (0..SIZE[0] * SIZE[1])
            .map(|at| {
                let factor = if at % SIZE[0] >= 8 && at / SIZE[0] >= 8 { gain } else { 1.0 };
                Vec3::splat(2.0 * factor * unit_float(pcg4d([seed, at, 7, 9])[0]))
            })
            .collect();
        Picture::new(SIZE[0], SIZE[1], pixels)
    }

    /// 4000 restarts against 4000 frames: the standard error of the difference is 0.09 % (image),
    /// 0.23 % (tile of 32 pixels).
    fn outcome(gain: f32) -> PictureTest {
        let mut reference = Reference::new(SIZE);
        let mut sample = restarts(SIZE).unwrap();
        for i in 0..4000 {
            reference.add(&picture(i, 1.0));
            sample.push(&picture(100_000 + i, gain).pixels).unwrap();
        }
        judge(&sample, &reference, &Criteria::default()).unwrap()
    }

    #[test]
    fn equal_means_pass_and_a_bias_in_one_tile_fails() {
        let equal = outcome(1.0);
        assert_eq!((equal.verdict, report(&equal).tiles_rejected), (Verdict::Pass, 0));
        assert_eq!(equal.tiles.len(), 4);
        let bias = report(&equal);
        let [low, high] = bias.ci.unwrap();
        assert!(low < bias.relative && bias.relative < high && high - low < 0.005);
        // The control: 2 % in one tile, 8 standard errors there, is 0.33 % of the image.
        let biased = outcome(1.02);
        assert_eq!((biased.verdict, report(&biased).tiles_rejected), (Verdict::Fail, 1));
    }

    #[test]
    fn variance_of_one_restart_by_hand() {
        let mut sample = restarts([1, 1]).unwrap();
        assert!(mean_variance(&sample, 1).is_infinite());
        for value in [1.0, 3.0] {
            sample.push(&[Vec3::new(value, 5.0, 5.0)]).unwrap();
        }
        assert!((mean_variance(&sample, 1) - 2.0 / 3.0).abs() < 1e-12);
    }
}
