//! Covariance between neighbouring pixels: the blotches that reuse leaves, invisible to per-pixel
//! errors.

use super::{Picture, check_len, check_like};
use crate::error::{Error, Result};
use crate::math::luminance;
use crate::stats::{Estimate, Moments};

/// Fewest restarts of [`covariance_r8`]: with 10 its coefficient of variation is twice that of 30
/// (6 % against 3 % on a 96² field).
pub const COVARIANCE_RESTARTS: usize = 30;

/// Half side of the box.
const RADIUS: usize = 8;

/// Covariance of a pixel's luminance with its neighbourhood over K restarts, relative to the
/// reference's squared mean luminance Ȳ (Fickel 2023, section 6.2; Sawhney et al. 2022):
///
/// c = 1/n Σᵢ 1/|Bᵢ| Σ_{j ∈ Bᵢ} cᵢⱼ / Ȳ², cᵢⱼ = 1/(K−1) Σₘ (Yₘᵢ − Ȳᵢ)(Yₘⱼ − Ȳⱼ),
///
/// where Bᵢ is the 17 × 17 box around i, cut at borders and mask, with i itself. So independent
/// noise of variance v gives v/289, not 0. Dividing by Ȳ², which the thesis leaves open, makes it
/// independent of exposure. Boxes are read from summed-area tables: the time is O(K n).
///
/// The estimate's variance is that over restarts, for [`Estimate::interval`]. A pixel that is not
/// finite in any restart is left out, as if masked.
///
/// # Errors
///
/// If there are fewer than [`COVARIANCE_RESTARTS`] restarts or sizes differ.
pub fn covariance_r8(
    restarts: &[Picture],
    reference: &Picture,
    mask: Option<&[bool]>,
) -> Result<Estimate> {
    let each = covariance_r8_by_restart(restarts, reference, mask)?;
    Ok(each.into_iter().collect::<Moments>().estimate())
}

/// Returns what each restart adds to [`covariance_r8`], which is their mean. Differences between
/// techniques that were restarted with the same seeds, whose noise is largely the same, are taken
/// restart by restart.
///
/// # Errors
///
/// It fails where [`covariance_r8`] does.
pub fn covariance_r8_by_restart(
    restarts: &[Picture],
    reference: &Picture,
    mask: Option<&[bool]>,
) -> Result<Vec<f64>> {
    covariance(restarts, reference, mask, RADIUS)
}

fn covariance(
    restarts: &[Picture],
    reference: &Picture,
    mask: Option<&[bool]>,
    radius: usize,
) -> Result<Vec<f64>> {
    if restarts.len() < COVARIANCE_RESTARTS {
        return Err(Error::invalid(format!(
            "a covariance over {} restarts, but at least {COVARIANCE_RESTARTS} are needed",
            restarts.len()
        )));
    }
    if let Some(mask) = mask {
        check_len(reference, "a mask", mask.len())?;
    }
    for picture in restarts {
        check_like(picture, reference)?;
    }
    let (width, pixels) = (reference.width as usize, reference.pixels.len());
    let counts: Vec<bool> = (0..pixels)
        .map(|i| {
            mask.is_none_or(|m| m[i])
                && reference.pixels[i].is_finite()
                && restarts.iter().all(|p| p.pixels[i].is_finite())
        })
        .collect();
    let n = counts.iter().filter(|c| **c).count();
    let y = |picture: &Picture, i: usize| f64::from(luminance(picture.pixels[i]));
    let k = restarts.len() as f64;
    let mut mean = vec![0.0; pixels];
    let mut exposure = 0.0;
    for i in (0..pixels).filter(|&i| counts[i]) {
        mean[i] = restarts.iter().map(|p| y(p, i)).sum::<f64>() / k;
        exposure += y(reference, i);
    }
    exposure /= n.max(1) as f64;
    let members = BoxSum::new(width, (0..pixels).map(|i| f64::from(u8::from(counts[i]))));
    let per_restart = restarts
        .iter()
        .map(|picture| {
            let deviation: Vec<f64> = (0..pixels)
                .map(|i| if counts[i] { y(picture, i) - mean[i] } else { 0.0 })
                .collect();
            let sums = BoxSum::new(width, deviation.iter().copied());
            let total: f64 = (0..pixels)
                .filter(|&i| counts[i])
                .map(|i| deviation[i] * sums.around(i, radius) / members.around(i, radius))
                .sum();
            // The mean over restarts of this is the sum divided by K − 1.
            if n == 0 { 0.0 } else { total / n as f64 * k / (k - 1.0) / (exposure * exposure) }
        })
        .collect();
    Ok(per_restart)
}

/// A summed-area table (Crow 1984).
struct BoxSum {
    width: usize,
    height: usize,
    /// Sum over all pixels left of and above, one row and column larger than the picture.
    table: Vec<f64>,
}

impl BoxSum {
    fn new(width: usize, values: impl ExactSizeIterator<Item = f64>) -> Self {
        let height = values.len() / width;
        let stride = width + 1;
        let mut table = vec![0.0; stride * (height + 1)];
        let mut row = 0.0;
        for (i, value) in values.enumerate() {
            let (x, y) = (i % width, i / width);
            row = if x == 0 { value } else { row + value };
            table[(y + 1) * stride + x + 1] = table[y * stride + x + 1] + row;
        }
        Self { width, height, table }
    }

    /// Sum over the box of half side `radius` around a pixel, cut at the borders.
    fn around(&self, pixel: usize, radius: usize) -> f64 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let (left, right) = (x.saturating_sub(radius), (x + radius + 1).min(self.width));
        let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(self.height));
        let at = |x: usize, y: usize| self.table[y * (self.width + 1) + x];
        at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::tests::noise;
    use super::*;

    /// Directly from the definition, O(K n r²).
    fn brute_force(restarts: &[Picture], reference: &Picture, counts: &[bool], radius: i32) -> f64 {
        let (w, h) = (reference.width as i32, reference.height as i32);
        let k = restarts.len() as f64;
        let y = |p: &Picture, i: usize| f64::from(luminance(p.pixels[i]));
        let mean = |i: usize| restarts.iter().map(|p| y(p, i)).sum::<f64>() / k;
        let covariance = |i: usize, j: usize| {
            let (a, b) = (mean(i), mean(j));
            restarts.iter().map(|p| (y(p, i) - a) * (y(p, j) - b)).sum::<f64>() / (k - 1.0)
        };
        let counted: Vec<usize> = (0..counts.len()).filter(|&i| counts[i]).collect();
        let mut total = 0.0;
        for &i in &counted {
            let (x, y) = (i as i32 % w, i as i32 / w);
            let box_of: Vec<usize> = (-radius..=radius)
                .flat_map(|dy| (-radius..=radius).map(move |dx| (x + dx, y + dy)))
                .filter(|&(x, y)| (0..w).contains(&x) && (0..h).contains(&y))
                .map(|(x, y)| (y * w + x) as usize)
                .filter(|&j| counts[j])
                .collect();
            total += box_of.iter().map(|&j| covariance(i, j)).sum::<f64>() / box_of.len() as f64;
        }
        let n = counted.len() as f64;
        let exposure = counted.iter().map(|&i| y(reference, i)).sum::<f64>() / n;
        total / n / (exposure * exposure)
    }

    #[test]
    fn equals_the_definition() {
        let restarts: Vec<Picture> = (0..30).map(|k| noise(11, 9, k)).collect();
        let reference = noise(11, 9, 99);
        let mut mask = vec![true; 99];
        mask[..7].fill(false);
        let terms = covariance(&restarts, &reference, Some(&mask), 2).unwrap();
        let fast = terms.into_iter().collect::<Moments>().mean();
        let slow = brute_force(&restarts, &reference, &mask, 2);
        assert!((fast / slow - 1.0).abs() < 1e-12, "{fast} {slow}");
    }

    #[test]
    fn shared_noise_counts_in_full_and_independent_noise_little() {
        let reference = Picture::new(64, 64, vec![Vec3::splat(2.0); 4096]);
        // Variance of luminance: uniform channels, (0.2126² + 0.7152² + 0.0722²) / 12.
        let variance = (0.2126_f64.powi(2) + 0.7152_f64.powi(2) + 0.0722_f64.powi(2)) / 12.0;
        let independent: Vec<Picture> = (0..40).map(|k| noise(64, 64, k)).collect();
        let low = covariance_r8(&independent, &reference, None).unwrap();
        // Most boxes have 289 pixels, those at the border fewer.
        let expected = variance / 4.0 / 289.0;
        assert!((0.7..1.6).contains(&(low.mean / expected)), "{}", low.mean / expected);
        // 8 x 8 blocks share their noise: a box of 17 x 17 holds 64 pixels of the own block.
        let blocks: Vec<Picture> = independent
            .iter()
            .map(|p| {
                let pixels = (0..4096).map(|i| p.pixels[i / 512 * 512 + i % 64 / 8 * 8]).collect();
                Picture::new(64, 64, pixels)
            })
            .collect();
        let high = covariance_r8(&blocks, &reference, None).unwrap();
        let (lower, upper) = high.interval(0.9999);
        assert!(lower > 3.0 * low.mean && lower < 64.0 * expected * 1.4 && upper > 64.0 * expected);
    }

    #[test]
    fn ten_restarts_are_refused() {
        let restarts: Vec<Picture> = (0..10).map(|k| noise(4, 4, k)).collect();
        let message = covariance_r8(&restarts, &restarts[0], None).unwrap_err().to_string();
        assert_eq!(message, "a covariance over 10 restarts, but at least 30 are needed");
    }
}
