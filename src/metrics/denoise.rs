//! One fixed denoiser, so that "what is left after denoising" means the same for every technique.

use glam::Vec3;

use super::{Picture, check_len, check_like};
use crate::error::{Error, Result};

/// What the first hit of each pixel is: noise-free, row by row from the top.
#[derive(Clone, Copy, Debug)]
pub struct Guides<'a> {
    /// Diffuse (or specular) reflectance, per channel.
    pub albedo: &'a [Vec3],
    /// Unit shading normal.
    pub normal: &'a [Vec3],
    /// Distance to the camera, in any unit; not positive or not finite where nothing is hit: such
    /// pixels stay as they are.
    pub depth: &'a [f32],
}

/// Iterations; the taps of iteration i are 2^i pixels apart, so the filter reaches 2 (1 + 2 +
/// 4 + 8) = 30 pixels.
const ITERATIONS: u32 = 4;

/// The one-dimensional B₃ spline.
const SPLINE: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// Exponent of the cosine between normals: half weight at 6°, as in Schied et al. (2017).
const NORMAL_EXPONENT: i32 = 128;

/// Relative difference of depth at which the weight falls to 1/e.
const DEPTH_SCALE: f32 = 0.1;

/// Albedo below which a channel is not divided out: dividing by less would raise noise that the
/// product hides again.
const MIN_ALBEDO: f32 = 0.01;

/// A joint bilateral filter: the edge-avoiding à-trous wavelet of Dammertz et al. (2010) on
/// radiance divided by albedo.
///
/// Weights are a B₃ spline times cos¹²⁸ between normals times exp(−(Δz / 0.1 z)²). Unlike Dammertz'
/// they do not look at the colour: the filter is linear in the picture and the same for all
/// techniques, so it measures noise and nothing else; shadows blur. Pixels where `counts` is false,
/// that are not finite or hit nothing, give to no other.
///
/// # Errors
///
/// If a guide or `counts` has another size.
pub fn denoise(picture: &Picture, guides: &Guides<'_>, counts: Option<&[bool]>) -> Result<Picture> {
    check_like(picture, picture)?;
    check_len(picture, "an albedo guide", guides.albedo.len())?;
    check_len(picture, "a normal guide", guides.normal.len())?;
    check_len(picture, "a depth guide", guides.depth.len())?;
    if let Some(counts) = counts {
        check_len(picture, "a mask", counts.len())?;
    }
    if let Some(bad) = guides.albedo.iter().position(|a| !a.is_finite()) {
        return Err(Error::invalid(format!(
            "an albedo guide with {} at pixel {bad}, but it must be finite",
            guides.albedo[bad]
        )));
    }
    let (width, height) = (picture.width as i32, picture.height as i32);
    let albedo = |i: usize| guides.albedo[i].max(Vec3::splat(MIN_ALBEDO));
    let takes_part: Vec<bool> = (0..picture.pixels.len())
        .map(|i| {
            let hit = guides.depth[i] > 0.0 && guides.depth[i].is_finite();
            hit && picture.pixels[i].is_finite()
                && guides.normal[i].is_finite()
                && counts.is_none_or(|c| c[i])
        })
        .collect();
    let mut light: Vec<Vec3> = (0..takes_part.len())
        .map(|i| if takes_part[i] { picture.pixels[i] / albedo(i) } else { Vec3::ZERO })
        .collect();
    for iteration in 0..ITERATIONS {
        let step = 1 << iteration;
        light = (0..light.len())
            .map(|i| {
                if !takes_part[i] {
                    return Vec3::ZERO;
                }
                let (x, y) = (i as i32 % width, i as i32 / width);
                let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
                for (dy, wy) in (-2..=2).zip(SPLINE) {
                    for (dx, wx) in (-2..=2).zip(SPLINE) {
                        let (qx, qy) = (x + dx * step, y + dy * step);
                        if !(0..width).contains(&qx) || !(0..height).contains(&qy) {
                            continue;
                        }
                        let q = (qy * width + qx) as usize;
                        if takes_part[q] {
                            let weight = wx * wy * similarity(guides, i, q);
                            sum += light[q] * weight;
                            weights += weight;
                        }
                    }
                }
                // The pixel's own tap has weight (6/16)²: the sum is never 0.
                sum / weights
            })
            .collect();
    }
    let pixels = (0..light.len())
        .map(|i| if takes_part[i] { light[i] * albedo(i) } else { picture.pixels[i] })
        .collect();
    Ok(Picture::new(picture.width, picture.height, pixels))
}

/// 1 for a pixel with itself, whatever its guides.
fn similarity(guides: &Guides<'_>, p: usize, q: usize) -> f32 {
    if p == q {
        return 1.0;
    }
    let cosine = guides.normal[p].dot(guides.normal[q]).clamp(0.0, 1.0);
    let depth = (guides.depth[q] - guides.depth[p]) / (DEPTH_SCALE * guides.depth[p]);
    cosine.powi(NORMAL_EXPONENT) * (-depth * depth).exp()
}

#[cfg(test)]
mod tests {
    use super::super::Comparison;
    use super::super::tests::noise;
    use super::*;

    const SIDE: u32 = 48;
    const WIDTH: usize = SIDE as usize;
    const PIXELS: usize = WIDTH * WIDTH;

    /// Left half: a wall facing +z with checkered albedo. Right half: a wall facing +x.
    fn guides() -> (Vec<Vec3>, Vec<Vec3>, Vec<f32>) {
        let left = |i: usize| i % WIDTH < WIDTH / 2;
        let albedo = (0..PIXELS).map(|i| Vec3::splat(if i % 2 == 0 { 0.9 } else { 0.1 })).collect();
        let normal = (0..PIXELS).map(|i| if left(i) { Vec3::Z } else { Vec3::X }).collect();
        (albedo, normal, vec![5.0; PIXELS])
    }

    #[test]
    fn keeps_what_the_guides_show_and_removes_noise() {
        let (albedo, normal, depth) = guides();
        let guides = Guides { albedo: &albedo, normal: &normal, depth: &depth };
        let truth: Vec<Vec3> = (0..PIXELS)
            .map(|i| albedo[i] * if normal[i] == Vec3::Z { 1.0 } else { 0.25 })
            .collect();
        let reference = Picture::new(SIDE, SIDE, truth.clone());
        let clean = denoise(&reference, &guides, None).unwrap();
        for (a, b) in clean.pixels.iter().zip(&truth) {
            assert!((*a - *b).abs().max_element() < 1e-5, "{a} {b}");
        }
        let random = noise(SIDE, SIDE, 1);
        let noisy = truth.iter().zip(&random.pixels).map(|(t, n)| *t * 2.0 * *n).collect();
        let noisy = Picture::new(SIDE, SIDE, noisy);
        let white = Comparison::new(&noisy, &reference, None).unwrap();
        let left_white = white.relmse_denoised(&guides).unwrap() / white.relmse();
        assert!(left_white < 0.02, "{left_white}");

        // Noise of the same size shared by 16 x 16 blocks: the control passes the denoiser.
        let block = |i: usize| i / WIDTH / 16 * 16 * WIDTH + i % WIDTH / 16 * 16;
        let blotchy = (0..PIXELS).map(|i| truth[i] * 2.0 * random.pixels[block(i)]).collect();
        let blotchy = Picture::new(SIDE, SIDE, blotchy);
        let red = Comparison::new(&blotchy, &reference, None).unwrap();
        let left_red = red.relmse_denoised(&guides).unwrap() / red.relmse();
        assert!(left_red > 5.0 * left_white, "{left_red} {left_white}");
    }

    #[test]
    fn bad_and_empty_pixels_stay_alone() {
        let (albedo, normal, mut depth) = guides();
        depth[100] = f32::INFINITY;
        let guides = Guides { albedo: &albedo, normal: &normal, depth: &depth };
        let mut pixels = vec![Vec3::ONE; PIXELS];
        pixels[100] = Vec3::splat(1e9);
        pixels[300] = Vec3::NAN;
        let result = denoise(&Picture::new(SIDE, SIDE, pixels), &guides, None).unwrap();
        assert_eq!(result.pixels[100], Vec3::splat(1e9));
        assert!(result.pixels[300].is_nan());
        let others = (0..PIXELS).filter(|i| ![100, 300].contains(i));
        assert!(others.map(|i| result.pixels[i]).all(|p| p.is_finite() && p.max_element() < 20.0));
        let short = Guides { depth: &depth[1..], ..guides };
        assert!(denoise(&result, &short, None).unwrap_err().is_invalid());
    }
}
