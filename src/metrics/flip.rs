//! LDR-FLIP on exposed linear RGB in [0, 1] (Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström,
//! Fairchild 2020, *FLIP: A Difference Evaluator for Alternating Images*, HPG). Our own writing of
//! the paper's equations; agrees with the authors' `flip-evaluator` to f32 rounding.
//!
//! | step | what |
//! |---|---|
//! | colour | YCxCz, filtered by the eye's contrast sensitivity, to L*a*b* with Hunt's effect, HyAB distance |
//! | feature | edges and points of unfiltered Y: first and second derivatives of a Gaussian |
//! | both | colour error raised to (1 − feature error) |

use core::f64::consts::PI;

/// Pixels per degree: a 0.7 m wide screen of 3840 pixels at 0.7 m.
const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

/// (a, b) of the terms a √(π/b) exp(−π² x² / b) of the contrast sensitivity kernels, x in degrees
/// (table 1 of the paper).
const ACHROMATIC: &[(f64, f64)] = &[(1.0, 0.0047)];
const RED_GREEN: &[(f64, f64)] = &[(1.0, 0.0053)];
const BLUE_YELLOW: &[(f64, f64)] = &[(34.1, 0.04), (13.5, 0.025)];

/// Rec. 709 to CIE XYZ, in the rounding-free form of sRGB's primaries and white (Lindbloom).
const RGB_TO_XYZ: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

/// The FLIP error of every pixel.
pub(super) fn error_map(width: usize, picture: &[[f64; 3]], reference: &[[f64; 3]]) -> Vec<f64> {
    let colours = ColourSpace::new();
    let largest =
        hyab(colours.hunt_lab([0.0, 1.0, 0.0]), colours.hunt_lab([0.0, 0.0, 1.0])).powf(0.7);
    let [a, b] = [picture, reference].map(|image| Seen::new(width, image, &colours));
    (0..picture.len())
        .map(|i| {
            let colour = redistribute(hyab(a.lab[i], b.lab[i]).powf(0.7), largest);
            let feature = (a.edge[i] - b.edge[i]).abs().max((a.point[i] - b.point[i]).abs());
            colour.powf(1.0 - (feature * core::f64::consts::FRAC_1_SQRT_2).sqrt())
        })
        .collect()
}

/// Maps errors below 0.4 of the largest to [0, 0.95], the others to the rest.
fn redistribute(error: f64, largest: f64) -> f64 {
    let knee = 0.4 * largest;
    if error < knee { 0.95 / knee * error } else { 0.95 + (error - knee) / (largest - knee) * 0.05 }
}

fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// What the eye makes of an image.
struct Seen {
    lab: Vec<[f64; 3]>,
    edge: Vec<f64>,
    point: Vec<f64>,
}

impl Seen {
    fn new(width: usize, image: &[[f64; 3]], colours: &ColourSpace) -> Self {
        let channels: [Vec<f64>; 3] =
            core::array::from_fn(|c| image.iter().map(|&rgb| colours.ycxcz(rgb)[c]).collect());
        let [y, cx, cz] = [ACHROMATIC, RED_GREEN, BLUE_YELLOW]
            .iter()
            .zip(&channels)
            .map(|(kernel, channel)| contrast_filter(width, channel, kernel))
            .collect::<Vec<_>>()
            .try_into()
            .expect("three channels");
        let lab = (0..image.len())
            .map(|i| colours.hunt_lab(colours.rgb([y[i], cx[i], cz[i]]).map(|c| c.clamp(0.0, 1.0))))
            .collect();

        // Half of the 0.082 degrees of an edge detector in the eye.
        let deviation = 0.5 * 0.082 * PIXELS_PER_DEGREE;
        let radius = (3.0 * deviation).ceil() as i32;
        let gauss = |x: i32| (-0.5 * (f64::from(x) / deviation).powi(2)).exp();
        let taps = |f: &dyn Fn(i32) -> f64| (-radius..=radius).map(f).collect::<Vec<f64>>();
        let blur = balanced(taps(&gauss));
        let first = balanced(taps(&|x| -f64::from(x) * gauss(x)));
        let second = balanced(taps(&|x| ((f64::from(x) / deviation).powi(2) - 1.0) * gauss(x)));
        let normalised: Vec<f64> = channels[0].iter().map(|y| (y + 16.0) / 116.0).collect();
        let magnitude = |kernel: &[f64]| -> Vec<f64> {
            let x = separable(width, &normalised, kernel, &blur);
            let y = separable(width, &normalised, &blur, kernel);
            x.into_iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
        };
        Self { lab, edge: magnitude(&first), point: magnitude(&second) }
    }
}

/// Scales the positive taps to sum 1 and the negative ones to −1.
fn balanced(mut taps: Vec<f64>) -> Vec<f64> {
    let positive: f64 = taps.iter().filter(|t| **t > 0.0).sum();
    let negative: f64 = -taps.iter().filter(|t| **t < 0.0).sum::<f64>();
    for tap in &mut taps {
        *tap /= if *tap > 0.0 { positive } else { negative.max(f64::MIN_POSITIVE) };
    }
    taps
}

/// A sum of Gaussians, normalised together; each is separable.
fn contrast_filter(width: usize, channel: &[f64], kernel: &[(f64, f64)]) -> Vec<f64> {
    // One radius for all channels: three deviations of the widest term.
    let radius = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let mut sum = vec![0.0; channel.len()];
    let mut total = 0.0;
    for &(a, b) in kernel {
        let taps: Vec<f64> = (-radius..=radius)
            .map(|x| (-(PI * f64::from(x) / PIXELS_PER_DEGREE).powi(2) / b).exp())
            .collect();
        let weight = a * (PI / b).sqrt();
        total += weight * taps.iter().sum::<f64>().powi(2);
        for (s, v) in sum.iter_mut().zip(separable(width, channel, &taps, &taps)) {
            *s += weight * v;
        }
    }
    sum.iter_mut().for_each(|s| *s /= total);
    sum
}

/// Correlation with `horizontal` ⊗ `vertical`; the border repeats.
fn separable(width: usize, image: &[f64], horizontal: &[f64], vertical: &[f64]) -> Vec<f64> {
    let height = image.len() / width;
    let radius = horizontal.len() / 2;
    let mut rows = vec![0.0; image.len()];
    let mut padded = vec![0.0; width + 2 * radius];
    for (row, out) in image.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        padded[..radius].fill(row[0]);
        padded[radius..radius + width].copy_from_slice(row);
        padded[radius + width..].fill(row[width - 1]);
        for (window, o) in padded.windows(horizontal.len()).zip(out) {
            *o = window.iter().zip(horizontal).map(|(v, t)| v * t).sum();
        }
    }
    let mut result = vec![0.0; image.len()];
    for (y, out) in result.chunks_exact_mut(width).enumerate() {
        for (k, &tap) in vertical.iter().enumerate() {
            let source = (y + k).saturating_sub(radius).min(height - 1) * width;
            for (o, v) in out.iter_mut().zip(&rows[source..source + width]) {
                *o += tap * v;
            }
        }
    }
    result
}

struct ColourSpace {
    white: [f64; 3],
    xyz_to_rgb: [[f64; 3]; 3],
}

impl ColourSpace {
    fn new() -> Self {
        Self { white: apply(&RGB_TO_XYZ, [1.0; 3]), xyz_to_rgb: inverse(&RGB_TO_XYZ) }
    }

    /// XYZ relative to white.
    fn relative_xyz(&self, rgb: [f64; 3]) -> [f64; 3] {
        let xyz = apply(&RGB_TO_XYZ, rgb);
        core::array::from_fn(|c| xyz[c] / self.white[c])
    }

    /// The linearised L*a*b* of Flohr et al. (1993).
    fn ycxcz(&self, rgb: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.relative_xyz(rgb);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    fn rgb(&self, [l, cx, cz]: [f64; 3]) -> [f64; 3] {
        let y = (l + 16.0) / 116.0;
        let relative = [y + cx / 500.0, y, y - cz / 200.0];
        apply(&self.xyz_to_rgb, core::array::from_fn(|c| relative[c] * self.white[c]))
    }

    /// L*a*b* with chroma scaled by lightness (Hunt's effect).
    fn hunt_lab(&self, rgb: [f64; 3]) -> [f64; 3] {
        const DELTA: f64 = 6.0 / 29.0;
        let f = |t: f64| {
            if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
        };
        let [x, y, z] = self.relative_xyz(rgb).map(f);
        let l = 116.0 * y - 16.0;
        [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
    }
}

fn apply(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    core::array::from_fn(|i| m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2])
}

/// Transposed cofactors over the determinant.
fn inverse(m: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cofactor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    core::array::from_fn(|i| core::array::from_fn(|j| cofactor(j, i) / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two synthetic pictures: a gradient with stripes, and the same with coloured dots, an offset
    /// and a shifted edge.
    fn pair(width: usize, height: usize) -> [Vec<[f64; 3]>; 2] {
        let reference = |x: usize, y: usize| {
            let stripe = if (x / 6).is_multiple_of(2) { 0.25 } else { 0.0 };
            [x as f64 / 64.0 + stripe, y as f64 / 64.0, ((x * y) % 16) as f64 / 32.0]
        };
        let picture = |x: usize, y: usize| {
            let [r, g, b] = reference(x, y);
            let dot = if (x * 7 + y * 13).is_multiple_of(23) { 0.5 } else { 0.0 };
            let edge = if x > 20 && y > 17 { 0.125 } else { 0.0 };
            [(r + dot).min(1.0), (g + edge).min(1.0), b]
        };
        let image = |f: &dyn Fn(usize, usize) -> [f64; 3]| {
            (0..width * height).map(|i| f(i % width, i / width)).collect()
        };
        [image(&picture), image(&reference)]
    }

    #[test]
    fn agrees_with_the_authors_implementation() {
        // flip-evaluator 1.7: evaluate(reference, picture, "LDR", inputsRGB=False,
        // applyMagma=False) on the same pictures, in f32.
        let [picture, reference] = pair(48, 40);
        let map = error_map(48, &picture, &reference);
        let mean = map.iter().sum::<f64>() / map.len() as f64;
        assert!((mean - 0.205_558_6).abs() < 2e-5, "{mean}");
        for (index, expected) in [
            (0, 0.512_757_4),
            (47, 0.132_741_0),
            (500, 0.114_878_2),
            (1000, 0.480_117_0),
            (1463, 0.469_308_3),
            (1919, 0.396_265_1),
        ] {
            assert!((map[index] - expected).abs() < 2e-4, "{index}: {}", map[index]);
        }
    }

    #[test]
    fn equal_pictures_differ_nowhere_and_black_from_white_everywhere() {
        let [_, reference] = pair(20, 10);
        assert!(error_map(20, &reference, &reference).iter().all(|&e| e == 0.0));
        let map = error_map(20, &[[0.0; 3]; 200], &[[1.0; 3]; 200]);
        assert!(map.iter().all(|e| (0.9..=1.0).contains(e)), "{}", map[0]);
    }

    #[test]
    fn colour_spaces_invert() {
        let colours = ColourSpace::new();
        for rgb in [[0.1, 0.7, 0.3], [1.0, 0.0, 0.0], [0.0; 3]] {
            let back = colours.rgb(colours.ycxcz(rgb));
            assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-14), "{back:?}");
        }
    }
}
