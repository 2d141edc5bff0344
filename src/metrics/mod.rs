//! How far a picture is from its reference. Quality only: whether a picture is *right* is
//! [`crate::stats`]' question, for these errors fall when a picture gets darker.
//!
//! | symbol | meaning |
//! |---|---|
//! | x, r | a value (one channel of one pixel) of the picture and of the reference |
//! | r̄ | mean of r over pixels and channels |
//! | Y | Rec. 709 luminance |
//!
//! Every metric but `mse` is unchanged, bit for bit where only sums and quotients occur, if picture
//! and reference are both scaled by a power of two. A mask is true where a pixel counts. Pixels
//! that are not finite are counted by [`Comparison::not_finite`] and enter no metric, neither its
//! sum nor its count; a report must show the count.

mod correlation;
mod denoise;
mod flip;
mod spectrum;

use glam::Vec3;

use crate::error::{Error, Result};
use crate::math::luminance;

pub use crate::picture::Picture;
pub use correlation::{COVARIANCE_RESTARTS, covariance_r8, covariance_r8_by_restart};
pub use denoise::{Guides, denoise};
pub use spectrum::Spectrum;

/// That two pictures are of one size, not empty, and have the pixels that they claim.
fn check_like(a: &Picture, b: &Picture) -> Result<()> {
    if (a.width, a.height) != (b.width, b.height) || a.width == 0 || a.height == 0 {
        return Err(Error::invalid(format!(
            "pictures of {} x {} and {} x {}, but their sizes must be equal and not 0",
            a.width, a.height, b.width, b.height
        )));
    }
    check_len(a, "a picture", a.pixels.len())?;
    check_len(a, "a picture", b.pixels.len())
}

fn check_len(picture: &Picture, what: &str, len: usize) -> Result<()> {
    if len == picture.width as usize * picture.height as usize {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "{what} of {len} values for {} x {} pixels",
        picture.width, picture.height
    )))
}

/// A picture beside its reference.
///
/// ```
/// use afterimage::metrics::{Comparison, Picture};
/// use glam::Vec3;
///
/// let picture = Picture::new(2, 1, vec![Vec3::splat(1.0), Vec3::splat(3.0)]);
/// let reference = Picture::new(2, 1, vec![Vec3::splat(2.0); 2]);
/// let comparison = Comparison::new(&picture, &reference, None)?;
/// assert_eq!(comparison.mse(), 1.0);
/// # Ok::<(), afterimage::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Comparison<'a> {
    picture: &'a Picture,
    reference: &'a Picture,
    /// True where a pixel counts: within the mask and finite.
    counts: Vec<bool>,
    /// Number of those.
    pixels: usize,
    not_finite: u64,
    /// r̄.
    reference_mean: f64,
}

/// A root-mean-square percentage error and what it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rmspe {
    /// The error as a fraction: 0.5 is 50 %; 0 if nothing is covered.
    pub value: f64,
    /// Share of the values with r > 10⁻³ r̄, the only ones where the error is defined.
    pub share: f64,
}

impl<'a> Comparison<'a> {
    /// Compares `picture` with `reference` where `mask` is true.
    ///
    /// # Errors
    ///
    /// If sizes differ, or the reference is not finite where the mask is true.
    pub fn new(
        picture: &'a Picture,
        reference: &'a Picture,
        mask: Option<&[bool]>,
    ) -> Result<Self> {
        check_like(picture, reference)?;
        let mut counts = match mask {
            Some(mask) => {
                check_len(picture, "a mask", mask.len())?;
                mask.to_vec()
            }
            None => vec![true; picture.pixels.len()],
        };
        let mut not_finite = 0;
        let mut sum = 0.0;
        let mut pixels = 0;
        for (i, counts) in counts.iter_mut().enumerate().filter(|(_, counts)| **counts) {
            let r = reference.pixels[i];
            if !r.is_finite() {
                return Err(Error::invalid(format!(
                    "{r} at pixel {i} of a reference, but it must be finite"
                )));
            }
            if picture.pixels[i].is_finite() {
                sum += r.to_array().map(f64::from).iter().sum::<f64>();
                pixels += 1;
            } else {
                *counts = false;
                not_finite += 1;
            }
        }
        let reference_mean = if pixels == 0 { 0.0 } else { sum / (3 * pixels) as f64 };
        Ok(Self { picture, reference, counts, pixels, not_finite, reference_mean })
    }

    /// Pixels within the mask whose value in the picture is not finite: any is a failure of its
    /// own.
    #[must_use]
    pub const fn not_finite(&self) -> u64 {
        self.not_finite
    }

    /// Pixels that the metrics cover.
    #[must_use]
    pub const fn pixels(&self) -> usize {
        self.pixels
    }

    /// r̄, the mean of the reference over covered pixels and channels.
    #[must_use]
    pub const fn reference_mean(&self) -> f64 {
        self.reference_mean
    }

    /// (x, r) of each channel of each covered pixel.
    fn values(&self) -> impl Iterator<Item = [(f64, f64); 3]> {
        let pairs = self.picture.pixels.iter().zip(&self.reference.pixels).zip(&self.counts);
        pairs.filter(|&(_, &counts)| counts).map(|((x, r), _)| {
            let (x, r) = (x.to_array(), r.to_array());
            core::array::from_fn(|c| (f64::from(x[c]), f64::from(r[c])))
        })
    }

    /// Mean over covered pixels and channels; 0 of nothing.
    fn mean(&self, error: impl Fn(f64, f64) -> f64) -> f64 {
        let sum: f64 = self.values().flatten().map(|(x, r)| error(x, r)).sum();
        if self.pixels == 0 { 0.0 } else { sum / (3 * self.pixels) as f64 }
    }

    fn relative_square(&self) -> impl Fn(f64, f64) -> f64 + use<> {
        let floor = 1e-2 * self.reference_mean * self.reference_mean;
        move |x, r| {
            let d = x - r;
            if d == 0.0 { 0.0 } else { d * d / (r * r + floor) }
        }
    }

    /// Mean of (x − r)².
    #[must_use]
    pub fn mse(&self) -> f64 {
        self.mean(|x, r| (x - r) * (x - r))
    }

    /// Mean of (x − r)² / (r² + 10⁻² r̄²): relative, with a floor that follows the exposure.
    /// Dominated by fireflies.
    #[must_use]
    pub fn relmse(&self) -> f64 {
        self.mean(self.relative_square())
    }

    /// [`relmse`](Self::relmse) without the worst 0.1 % of the pixels (rounded down: none of fewer
    /// than 1000). The quotient of both is an index of fireflies.
    #[must_use]
    pub fn relmse_trimmed(&self) -> f64 {
        let error = self.relative_square();
        let mut pixels: Vec<f64> =
            self.values().map(|v| v.iter().map(|&(x, r)| error(x, r)).sum::<f64>() / 3.0).collect();
        let kept = pixels.len() - pixels.len() / 1000;
        if kept == 0 {
            return 0.0;
        }
        pixels.select_nth_unstable_by(kept - 1, f64::total_cmp);
        pixels[..kept].iter().sum::<f64>() / kept as f64
    }

    /// Mean of 2 |x − r| / (|x| + |r|), in [0, 2]; 0 where both are 0. Resists outliers.
    #[must_use]
    pub fn smape(&self) -> f64 {
        self.mean(|x, r| if x == r { 0.0 } else { 2.0 * (x - r).abs() / (x.abs() + r.abs()) })
    }

    /// √ mean ((x − r) / r)² over the values with r > 10⁻³ r̄, and their share.
    #[must_use]
    pub fn rmspe(&self) -> Rmspe {
        let floor = 1e-3 * self.reference_mean;
        let mut sum = 0.0;
        let mut covered = 0usize;
        for (x, r) in self.values().flatten().filter(|&(_, r)| r > floor) {
            sum += ((x - r) / r).powi(2);
            covered += 1;
        }
        if covered == 0 {
            return Rmspe { value: 0.0, share: 0.0 };
        }
        Rmspe {
            value: (sum / covered as f64).sqrt(),
            share: covered as f64 / (3 * self.pixels) as f64,
        }
    }

    /// LDR-FLIP (Andersson et al. 2020), in [0, 1]: the difference seen when alternating between
    /// picture and reference at 67 pixels per degree, averaged over covered pixels.
    ///
    /// Both are exposed so that the reference's median luminance becomes 0.18 (its mean where the
    /// median is 0), then clamped to [0, 1]. Pixels that do not count are taken from the reference,
    /// so that their errors do not blur into others.
    #[must_use]
    pub fn flip(&self) -> f64 {
        let map = self.flip_map();
        let sum: f64 = map.iter().zip(&self.counts).filter(|(_, c)| **c).map(|(e, _)| e).sum();
        if self.pixels == 0 { 0.0 } else { sum / self.pixels as f64 }
    }

    /// The error of every pixel, of which [`flip`](Self::flip) is the mean; 0 where a pixel does
    /// not count but near others.
    #[must_use]
    pub fn flip_map(&self) -> Vec<f64> {
        let exposure = self.exposure();
        let expose = |v: Vec3| v.to_array().map(|c| (f64::from(c) * exposure).clamp(0.0, 1.0));
        let finite = |v: Vec3| if v.is_finite() { v } else { Vec3::ZERO };
        let reference: Vec<[f64; 3]> =
            self.reference.pixels.iter().map(|&r| expose(finite(r))).collect();
        let picture: Vec<[f64; 3]> = (0..reference.len())
            .map(|i| if self.counts[i] { expose(self.picture.pixels[i]) } else { reference[i] })
            .collect();
        flip::error_map(self.picture.width as usize, &picture, &reference)
    }

    fn exposure(&self) -> f64 {
        let mut y: Vec<f64> = (0..self.counts.len())
            .filter(|&i| self.counts[i])
            .map(|i| luminance(self.reference.pixels[i]).into())
            .collect();
        if y.is_empty() {
            return 1.0;
        }
        let mean = y.iter().sum::<f64>() / y.len() as f64;
        let middle = y.len() / 2;
        let median = *y.select_nth_unstable_by(middle, f64::total_cmp).1;
        match (median > 0.0, mean > 0.0) {
            (true, _) => 0.18 / median,
            (false, true) => 0.18 / mean,
            (false, false) => 1.0,
        }
    }

    /// The spectrum of the luminance error. With `deviation`, the standard deviation of every
    /// pixel's luminance over restarts ([`crate::stats::Restarts::luminance_deviation`]), the error
    /// is divided by it first, so that a few noisy regions do not speak for all; pixels of
    /// deviation 0 are left out.
    ///
    /// # Errors
    ///
    /// If `deviation` has another size.
    pub fn spectrum(&self, deviation: Option<&[f64]>) -> Result<Spectrum> {
        if let Some(deviation) = deviation {
            check_len(self.picture, "a deviation", deviation.len())?;
        }
        let error: Vec<Option<f64>> = (0..self.counts.len())
            .map(|i| {
                let [x, r] =
                    [self.picture, self.reference].map(|p| f64::from(luminance(p.pixels[i])));
                let scale = deviation.map_or(1.0, |d| d[i]);
                (self.counts[i] && scale > 0.0).then(|| (x - r) / scale)
            })
            .collect();
        Ok(Spectrum::of(self.picture.width as usize, self.picture.height as usize, &error))
    }

    /// Share of the error's power below 1/16 cycle per pixel: [`Spectrum::low_frequency_share`] of
    /// the plain error.
    #[must_use]
    pub fn low_frequency_share(&self) -> f64 {
        self.plain_spectrum().low_frequency_share()
    }

    /// Mean squared error after a Gaussian of 2.1 pixels, relative to white noise of the same
    /// `mse`: [`Spectrum::g`]`(2.1)` of the plain error.
    #[must_use]
    pub fn g_2_1(&self) -> f64 {
        self.plain_spectrum().g(2.1)
    }

    fn plain_spectrum(&self) -> Spectrum {
        self.spectrum(None).expect("no deviation, no size to be wrong")
    }

    /// [`relmse`](Self::relmse) after [`denoise`]: what is left for the eye behind a denoiser,
    /// which correlated errors pass.
    ///
    /// The reference is not filtered; blur counts as error, the same for every technique.
    ///
    /// # Errors
    ///
    /// If a guide has another size.
    pub fn relmse_denoised(&self, guides: &Guides<'_>) -> Result<f64> {
        let filtered = denoise(self.picture, guides, Some(&self.counts))?;
        let filtered = Comparison {
            picture: &filtered,
            reference: self.reference,
            counts: self.counts.clone(),
            ..*self
        };
        Ok(filtered.relmse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    pub(super) fn noise(width: u32, height: u32, key: u64) -> Picture {
        let mut stream = Stream::from_key(key);
        let pixels = (0..width * height)
            .map(|_| Vec3::new(stream.uniform(), stream.uniform(), stream.uniform()))
            .collect();
        Picture::new(width, height, pixels)
    }

    fn scaled(picture: &Picture, factor: f32) -> Picture {
        let pixels = picture.pixels.iter().map(|p| *p * factor).collect();
        Picture::new(picture.width, picture.height, pixels)
    }

    fn grey(values: &[f32]) -> Picture {
        Picture::new(values.len() as u32, 1, values.iter().map(|&v| Vec3::splat(v)).collect())
    }

    #[test]
    fn values_by_hand() {
        let (x, r) = (grey(&[1.0, 2.0, 0.0]), grey(&[2.0, 1.0, 0.0]));
        let c = Comparison::new(&x, &r, None).unwrap();
        assert_eq!(c.reference_mean(), 1.0);
        assert!((c.mse() - 2.0 / 3.0).abs() < 1e-15);
        assert!((c.relmse() - (1.0 / 4.01 + 1.0 / 1.01) / 3.0).abs() < 1e-15);
        assert_eq!(c.relmse(), c.relmse_trimmed());
        assert!((c.smape() - 4.0 / 9.0).abs() < 1e-15);
        let Rmspe { value, share } = c.rmspe();
        assert!((value - (1.25_f64 / 2.0).sqrt()).abs() < 1e-15);
        assert!((share - 2.0 / 3.0).abs() < 1e-15);
    }

    /// flip-evaluator 1.7, `evaluate(reference, picture, "LDR", inputsRGB=False, applyMagma=False)`
    /// on both, times 0.18 over the reference's median luminance of 0.2992875 and clamped. Times
    /// 0.18 over its mean, which a bright corner makes 3.3 times as large, it is 0.0847.
    #[test]
    fn flip_is_exposed_by_the_median() {
        let (width, height) = (24, 16);
        let at = |i: u32| {
            let (x, y) = (i % width, i / width);
            let gain = if x < 4 && y < 4 { 64.0 } else { 1.0 };
            let rgb = [(x % 8 + 1) as f32 / 16.0, (y % 4 + 1) as f32 / 8.0];
            let reference = gain * Vec3::new(rgb[0], rgb[1], (x * y % 5 + 1) as f32 / 16.0);
            let share = if (x + 2 * y).is_multiple_of(3) { 1.25 } else { 0.75 };
            [share * reference, reference]
        };
        let [x, r] = [0, 1].map(|side| {
            Picture::new(width, height, (0..width * height).map(|i| at(i)[side]).collect())
        });
        let flip = Comparison::new(&x, &r, None).unwrap().flip();
        assert!((flip - 0.124_964_3).abs() < 2e-6, "{flip}");
    }

    #[test]
    fn powers_of_two_change_nothing_and_an_absolute_floor_would() {
        let (x, r) = (noise(40, 30, 1), noise(40, 30, 2));
        let base = Comparison::new(&x, &r, None).unwrap();
        for k in [-40, -3, 20] {
            let factor = 2.0_f32.powi(k);
            let (x, r) = (scaled(&x, factor), scaled(&r, factor));
            let c = Comparison::new(&x, &r, None).unwrap();
            assert_eq!(c.relmse().to_bits(), base.relmse().to_bits());
            assert_eq!(c.relmse_trimmed().to_bits(), base.relmse_trimmed().to_bits());
            assert_eq!(c.smape().to_bits(), base.smape().to_bits());
            assert_eq!(c.rmspe().value.to_bits(), base.rmspe().value.to_bits());
            assert!((c.flip() / base.flip() - 1.0).abs() < 1e-12);
            assert!((c.g_2_1() / base.g_2_1() - 1.0).abs() < 1e-12);
            let absolute = |c: &Comparison<'_>| c.mean(|x, r| (x - r).powi(2) / (r * r + 0.01));
            assert!((absolute(&c) / absolute(&base) - 1.0).abs() > 0.01);
        }
    }

    #[test]
    fn trimming_removes_fireflies() {
        let r = Picture::new(50, 40, vec![Vec3::ONE; 2000]);
        let mut pixels = vec![Vec3::splat(1.1); 2000];
        pixels[7] = Vec3::splat(1000.0);
        pixels[1999] = Vec3::splat(500.0);
        let x = Picture::new(50, 40, pixels);
        let c = Comparison::new(&x, &r, None).unwrap();
        assert!((c.relmse_trimmed() - 0.01 / 1.01).abs() < 1e-6);
        assert!(c.relmse() > 100.0);
    }

    #[test]
    fn masked_and_bad_pixels_enter_nothing_and_bad_ones_are_counted() {
        let (x, r) = (noise(24, 20, 3), noise(24, 20, 4));
        let mut spoiled = x.clone();
        spoiled.pixels[5] = Vec3::splat(1e30);
        spoiled.pixels[9] = Vec3::new(0.0, f32::NAN, 0.0);
        let mut mask = vec![true; 480];
        mask[5] = false;
        let c = Comparison::new(&spoiled, &r, Some(&mask)).unwrap();
        assert_eq!((c.not_finite(), c.pixels()), (1, 478));
        mask[9] = false;
        let clean = Comparison::new(&x, &r, Some(&mask)).unwrap();
        let all = |c: &Comparison<'_>| {
            [
                c.mse(),
                c.relmse(),
                c.relmse_trimmed(),
                c.smape(),
                c.rmspe().value,
                c.flip(),
                c.g_2_1(),
                c.low_frequency_share(),
            ]
        };
        assert_eq!(all(&c), all(&clean));
        assert!(all(&c).iter().all(|v| v.is_finite() && *v > 0.0));
    }

    #[test]
    fn nothing_to_compare_and_black_are_zero() {
        let black = grey(&[0.0; 4]);
        for mask in [None, Some(&[false; 4][..])] {
            let c = Comparison::new(&black, &black, mask).unwrap();
            let values = [
                c.mse(),
                c.relmse(),
                c.relmse_trimmed(),
                c.smape(),
                c.rmspe().value,
                c.flip(),
                c.g_2_1(),
                c.low_frequency_share(),
            ];
            assert_eq!(values, [0.0; 8]);
        }
    }

    #[test]
    fn wrong_sizes_are_refused() {
        let empty = grey(&[]);
        assert!(Comparison::new(&empty, &empty, None).unwrap_err().is_invalid());
        let short = Picture { width: 2, height: 2, pixels: vec![Vec3::ZERO; 3] };
        assert!(Comparison::new(&short, &short, None).unwrap_err().is_invalid());
        let (a, b) = (grey(&[1.0, 2.0]), grey(&[1.0]));
        assert!(Comparison::new(&a, &b, None).unwrap_err().is_invalid());
        assert!(Comparison::new(&a, &a, Some(&[true])).unwrap_err().is_invalid());
        assert!(Comparison::new(&a, &grey(&[1.0, f32::INFINITY]), None).unwrap_err().is_invalid());
    }
}
