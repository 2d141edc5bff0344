//! Goodness of fit of samples to a density: Pearson's χ² over a grid, the integral of the density,
//! and its support.
//!
//! | symbol | meaning |
//! |---|---|
//! | Oᵢ, Eᵢ | observed and expected count of cell i |
//! | N | number of samples |
//! | I | ∫ pdf over the domain |
//!
//! χ² compares shapes only; a pdf wrong by a constant factor passes it. So I is compared with 1
//! separately, and every sample must have a positive pdf. The expected counts come from adaptive
//! quadrature: a fixed 8 × 8 rule rejects correct narrow lobes.

use core::f64::consts::PI;
use core::fmt;

use glam::{Vec2, Vec3};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Cells with fewer expected samples are pooled, where the χ² law would not hold (Cochran 1954).
const MIN_EXPECTED: f64 = 5.0;

/// The result of Pearson's χ² test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChiSquare {
    /// X² = Σ (Oᵢ − Eᵢ)² / Eᵢ over the cells after pooling; infinite if something was observed
    /// where nothing can be.
    pub statistic: f64,
    /// Degrees of freedom: cells after pooling, minus one.
    pub dof: usize,
    /// Probability of a statistic at least this large if the samples follow the expectation; 1 if
    /// `dof` is 0, unless the statistic is infinite (then 0).
    pub p: f64,
}

/// Pearson's χ² test of counts against expectations (Pearson 1900).
///
/// `expected` may have any positive scale: it is scaled to the sum of `observed`. Cells expecting
/// fewer than 5 are pooled, and the pool, if it stays below 5, joins the smallest other cell. A
/// count in a cell of expectation 0 gives p = 0.
///
/// # Panics
///
/// If the lengths differ, or an expectation is negative or not finite.
#[must_use]
pub fn chi_square(observed: &[u64], expected: &[f64]) -> ChiSquare {
    assert_eq!(observed.len(), expected.len(), "one expectation per observed cell");
    assert!(
        expected.iter().all(|e| e.is_finite() && *e >= 0.0),
        "expectations must be finite and not negative"
    );
    let total: u64 = observed.iter().sum();
    let sum: f64 = expected.iter().sum();
    if total == 0 {
        return ChiSquare { statistic: 0.0, dof: 0, p: 1.0 };
    }
    if observed.iter().zip(expected).any(|(&o, &e)| o > 0 && e == 0.0) {
        return ChiSquare { statistic: f64::INFINITY, dof: 0, p: 0.0 };
    }
    let scale = total as f64 / sum;
    let mut cells: Vec<(f64, u64)> =
        expected.iter().zip(observed).map(|(&e, &o)| (e * scale, o)).collect();
    cells.sort_by(|a, b| a.0.total_cmp(&b.0));

    let mut pool = (0.0, 0u64);
    let mut statistic = 0.0;
    let mut count = 0usize;
    for (e, o) in cells {
        if e < MIN_EXPECTED || (pool.0 > 0.0 && pool.0 < MIN_EXPECTED) {
            pool = (pool.0 + e, pool.1 + o);
        } else {
            statistic += (o as f64 - e).powi(2) / e;
            count += 1;
        }
    }
    if pool.0 > 0.0 {
        statistic += (pool.1 as f64 - pool.0).powi(2) / pool.0;
        count += 1;
    }
    let dof = count.saturating_sub(1);
    let p = if dof == 0 {
        1.0
    } else {
        ChiSquared::new(dof as f64).expect("dof is positive").sf(statistic)
    };
    ChiSquare { statistic, dof, p }
}

/// The grid of a [`DensityCheck`] and how many samples it draws.
///
/// A coarse grid (20 × 20) has more power against smooth errors than a fine one; run both where it
/// matters. With N = 10⁶, α = 10⁻⁶ and 400 cells, a relative density error of 1.6 % (rms) is found
/// with probability 0.99.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells along cos θ (sphere) or y (square). Even on the sphere, so that the horizon is a cell
    /// border.
    pub rows: usize,
    /// Cells along φ (sphere) or x (square).
    pub columns: usize,
    /// Number of samples N.
    pub samples: u64,
    /// Largest accepted |I − 1|, beyond the sampling error of the discarded share; 10⁻³ by default.
    pub integral_tolerance: f64,
}

impl Grid {
    /// `rows` × `columns` cells and `samples` draws, integral tolerance 10⁻³.
    #[must_use]
    pub const fn new(rows: usize, columns: usize, samples: u64) -> Self {
        Self { rows, columns, samples, integral_tolerance: 1e-3 }
    }
}

/// How well a sampling function and its pdf agree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityCheck {
    /// Shape: binned samples against the integrated pdf.
    pub chi_square: ChiSquare,
    /// I, the integral of the pdf over the domain.
    pub integral: f64,
    /// Draws that returned `None`.
    pub discarded: u64,
    /// Samples whose pdf is zero: the pdf misses a part of the sampled support.
    pub outside: u64,
    /// Samples that are not finite, outside the domain or not of unit length.
    pub invalid_samples: u64,
    /// Evaluations of the pdf that were negative or not finite.
    pub invalid_pdfs: u64,
    /// Number of draws N.
    pub samples: u64,
    /// Accepted |I − (1 − discarded / N)| beyond its sampling error.
    pub integral_tolerance: f64,
}

impl DensityCheck {
    /// Whether nothing contradicts the pdf: χ² at level `alpha`, support, integral, finiteness.
    ///
    /// The integral must equal the share of draws that were not discarded, within the tolerance
    /// plus 5 binomial standard errors.
    #[must_use]
    pub fn agrees(&self, alpha: f64) -> bool {
        let n = self.samples as f64;
        let discarded = self.discarded as f64 / n;
        let slack = 5.0 * (discarded * (1.0 - discarded) / n).sqrt();
        self.chi_square.p >= alpha
            && self.outside == 0
            && self.invalid_samples == 0
            && self.invalid_pdfs == 0
            && (self.integral - (1.0 - discarded)).abs() <= self.integral_tolerance + slack
    }
}

impl fmt::Display for DensityCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ChiSquare { statistic, dof, p } = self.chi_square;
        write!(
            f,
            "chi-square {statistic:.1} with {dof} degrees of freedom, p = {p:.3e}; integral of the pdf {:.6}; of {} draws {} \
             discarded, {} with pdf 0, {} invalid; {} invalid pdfs",
            self.integral,
            self.samples,
            self.discarded,
            self.outside,
            self.invalid_samples,
            self.invalid_pdfs
        )
    }
}

/// Compares samples on the unit square with their pdf (per unit area).
///
/// `draw` returns `None` where the sampler gives up; then the pdf must integrate to the share of
/// the other draws.
#[must_use]
pub fn check_square(
    grid: Grid,
    mut draw: impl FnMut() -> Option<Vec2>,
    pdf: impl Fn(Vec2) -> f32,
) -> DensityCheck {
    check(
        grid,
        || {
            draw().map(|p| {
                let inside = (0.0..=1.0).contains(&p.x) && (0.0..=1.0).contains(&p.y);
                let place = inside.then_some([f64::from(p.x), f64::from(p.y)]);
                (place, if inside { f64::from(pdf(p)) } else { 0.0 })
            })
        },
        |[x, y]| f64::from(pdf(Vec2::new(x as f32, y as f32))),
    )
}

/// Compares sampled directions with their pdf per solid angle, binned over (φ, cos θ) around +z.
///
/// `draw` returns `None` where the sampler gives up (a direction below the horizon); then the pdf
/// must integrate to the share of the other draws.
///
/// ```
/// use afterimage::math::rng::{RandomSource, Stream};
/// use afterimage::stats::{Grid, check_sphere};
/// use glam::Vec3;
///
/// let mut stream = Stream::from_key(1);
/// let draw = || {
///     let (z, phi) = (2.0 * stream.uniform() - 1.0, core::f32::consts::TAU * stream.uniform());
///     let r = (1.0 - z * z).sqrt();
///     Some(Vec3::new(r * phi.cos(), r * phi.sin(), z))
/// };
/// let check = check_sphere(Grid::new(10, 20, 20_000), draw, |_| 0.25 * core::f32::consts::FRAC_1_PI);
/// assert!(check.agrees(1e-4), "{check}");
/// ```
#[must_use]
pub fn check_sphere(
    grid: Grid,
    mut draw: impl FnMut() -> Option<Vec3>,
    pdf: impl Fn(Vec3) -> f32,
) -> DensityCheck {
    check(
        grid,
        || {
            draw().map(|d| {
                let unit = d.is_finite() && (d.length_squared() - 1.0).abs() < 1e-4;
                let place = unit.then(|| {
                    let [x, y, z] = d.to_array().map(f64::from);
                    // 1 − |z| from x and y: z alone is rounded to 6e-8, coarser than a narrow lobe
                    // at the pole.
                    let from_pole = 0.5 * (x * x + y * y) / (1.0 + z.abs());
                    let v = if z > 0.0 { 1.0 - from_pole } else { from_pole };
                    [(y.atan2(x) / (2.0 * PI)).rem_euclid(1.0), v.clamp(0.0, 1.0)]
                });
                (place, if unit { f64::from(pdf(d)) } else { 0.0 })
            })
        },
        |[u, v]| {
            let (z, phi) = (2.0 * v - 1.0, 2.0 * PI * u);
            // (1 − z)(1 + z) = 4 v (1 − v), without cancellation at either pole.
            let r = 2.0 * (v * (1.0 - v)).sqrt();
            let d = Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
            4.0 * PI * f64::from(pdf(d))
        },
    )
}

/// `draw` gives the place on the unit square (None: invalid) and the sample's pdf; `density` is per
/// unit area of that square.
fn check(
    grid: Grid,
    mut draw: impl FnMut() -> Option<(Option<[f64; 2]>, f64)>,
    density: impl Fn([f64; 2]) -> f64,
) -> DensityCheck {
    assert!(
        grid.rows > 0 && grid.columns > 0 && grid.samples > 0,
        "a grid needs cells and samples"
    );
    let (mut discarded, mut outside, mut invalid_samples, mut invalid_pdfs) = (0, 0, 0, 0);
    let mut cells: Vec<Vec<[f64; 2]>> = vec![Vec::new(); grid.rows * grid.columns];
    for _ in 0..grid.samples {
        match draw() {
            None => discarded += 1,
            Some((None, _)) => invalid_samples += 1,
            Some((Some(place), pdf)) => {
                if !pdf.is_finite() || pdf < 0.0 {
                    invalid_pdfs += 1;
                } else if pdf == 0.0 {
                    outside += 1;
                }
                let column = ((place[0] * grid.columns as f64) as usize).min(grid.columns - 1);
                let row = ((place[1] * grid.rows as f64) as usize).min(grid.rows - 1);
                cells[row * grid.columns + column].push(place);
            }
        }
    }
    let observed: Vec<u64> = cells.iter().map(|c| c.len() as u64).collect();
    let mut quadrature =
        Quadrature { density, samples: grid.samples as f64, invalid: 0, left: MAX_BLOCKS };
    let size = [1.0 / grid.columns as f64, 1.0 / grid.rows as f64];
    let expected: Vec<f64> = cells
        .iter_mut()
        .enumerate()
        .map(|(i, places)| {
            let corner = [(i % grid.columns) as f64 * size[0], (i / grid.columns) as f64 * size[1]];
            quadrature.cell(Block { corner, size }, places)
        })
        .collect();
    DensityCheck {
        chi_square: chi_square(&observed, &expected),
        integral: expected.iter().sum(),
        discarded,
        outside,
        invalid_samples,
        invalid_pdfs: invalid_pdfs + quadrature.invalid,
        samples: grid.samples,
        integral_tolerance: grid.integral_tolerance,
    }
}

/// Subdivisions over all cells: bounds the time on a pdf that no quadrature integrates (2²² blocks,
/// 67 million evaluations).
const MAX_BLOCKS: u32 = 1 << 22;

/// Smallest block: 2⁻²⁶ of a cell. A lobe of κ = 10⁷ around a pole fills 10⁻⁶ of a cell.
const MAX_DEPTH: u32 = 26;

/// Quadrature error of a cell in standard deviations of its count: adds at most 10⁻⁴ to the cell's
/// share of X².
const CELL_ERROR: f64 = 0.01;

/// Gauss–Legendre nodes and weights of four points on [0, 1].
const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

#[derive(Clone, Copy)]
struct Block {
    corner: [f64; 2],
    size: [f64; 2],
}

struct Quadrature<D> {
    density: D,
    samples: f64,
    invalid: u64,
    left: u32,
}

impl<D: Fn([f64; 2]) -> f64> Quadrature<D> {
    fn cell(&mut self, block: Block, places: &mut [[f64; 2]]) -> f64 {
        // The tolerance needs the cell's probability before it is known; its share of samples will
        // do, as it only sets the effort.
        let count = places.len() as f64;
        let tolerance = CELL_ERROR * count.max(1.0).sqrt() / self.samples;
        let coarse = self.gauss(block);
        self.refine(block, coarse, places, tolerance, 0)
    }

    /// Subdivides while halving changes the integral, or while it disagrees with the samples
    /// inside. The latter finds peaks between the nodes; it can only make the integral more
    /// accurate, never bring a wrong pdf closer to the samples.
    fn refine(
        &mut self,
        block: Block,
        coarse: f64,
        places: &mut [[f64; 2]],
        tolerance: f64,
        depth: u32,
    ) -> f64 {
        let half = [0.5 * block.size[0], 0.5 * block.size[1]];
        let middle = [block.corner[0] + half[0], block.corner[1] + half[1]];
        let children =
            [block.corner, [middle[0], block.corner[1]], [block.corner[0], middle[1]], middle]
                .map(|corner| Block { corner, size: half });
        let parts = children.map(|child| self.gauss(child));
        let fine: f64 = parts.iter().sum();
        let expected = fine * self.samples;
        let surprise = (places.len() as f64 - expected).powi(2) > 25.0 * (expected + 1.0);
        if depth >= MAX_DEPTH || self.left == 0 || ((fine - coarse).abs() <= tolerance && !surprise)
        {
            return fine;
        }
        self.left -= 1;
        let (lower, upper) = partition(places, |p| p[1] < middle[1]);
        let (a, b) = partition(lower, |p| p[0] < middle[0]);
        let (c, d) = partition(upper, |p| p[0] < middle[0]);
        let mut sum = 0.0;
        for ((child, part), places) in children.into_iter().zip(parts).zip([a, b, c, d]) {
            // Along an edge of the pdf 2^depth blocks have errors of random sign, which add as
            // their root.
            sum += self.refine(
                child,
                part,
                places,
                tolerance * core::f64::consts::FRAC_1_SQRT_2,
                depth + 1,
            );
        }
        sum
    }

    fn gauss(&mut self, block: Block) -> f64 {
        let mut sum = 0.0;
        for (y, wy) in GAUSS {
            for (x, wx) in GAUSS {
                let p = [block.corner[0] + x * block.size[0], block.corner[1] + y * block.size[1]];
                let value = (self.density)(p);
                if value.is_finite() && value >= 0.0 {
                    sum += wx * wy * value;
                } else {
                    self.invalid += 1;
                }
            }
        }
        sum * block.size[0] * block.size[1]
    }
}

/// Moves the elements with `first` to the front; returns both parts.
fn partition<T>(items: &mut [T], first: impl Fn(&T) -> bool) -> (&mut [T], &mut [T]) {
    let mut split = 0;
    for i in 0..items.len() {
        if first(&items[i]) {
            items.swap(i, split);
            split += 1;
        }
    }
    items.split_at_mut(split)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    #[test]
    fn matches_scipy() {
        // SciPy 1.x: scipy.stats.chisquare([16, 18, 16, 14, 12, 12]) and with f_exp = [16, 16, 16,
        // 16, 16, 8].
        let observed = [16, 18, 16, 14, 12, 12];
        let even = chi_square(&observed, &[1.0; 6]);
        assert!((even.statistic - 2.0).abs() < 1e-12 && even.dof == 5, "{even:?}");
        assert!((even.p - 0.849_145_036_084_609_6).abs() < 1e-9, "{even:?}");
        let uneven = chi_square(&observed, &[16.0, 16.0, 16.0, 16.0, 16.0, 8.0]);
        assert!((uneven.statistic - 3.5).abs() < 1e-12, "{uneven:?}");
        assert!((uneven.p - 0.623_387_627_749_582_3).abs() < 1e-9, "{uneven:?}");
    }

    #[test]
    fn small_cells_are_pooled() {
        // 100 expected as 90, 6, 2, 2: the last two pool to 4 < 5 and take the 6 with them.
        let pooled = chi_square(&[88, 7, 2, 3], &[90.0, 6.0, 2.0, 2.0]);
        assert_eq!(pooled.dof, 1);
        assert!((pooled.statistic - (4.0 / 90.0 + 4.0 / 10.0)).abs() < 1e-12, "{pooled:?}");
    }

    #[test]
    fn impossible_cell_fails_and_no_data_passes() {
        assert_eq!(chi_square(&[10, 1], &[1.0, 0.0]).p, 0.0);
        assert_eq!(chi_square(&[0, 0], &[1.0, 0.0]).p, 1.0);
    }

    /// A direction of a von Mises–Fisher lobe around `frame`'s normal, with the log1p form of Jakob
    /// (2012).
    fn draw_lobe(kappa: f64, frame: crate::math::Frame, stream: &mut Stream) -> Vec3 {
        let u = (f64::from(stream.word()) + 0.5) / 4_294_967_296.0;
        let v = 2.0 * PI * (f64::from(stream.word()) + 0.5) / 4_294_967_296.0;
        let one_minus_cos = -(u * (-2.0 * kappa).exp_m1()).ln_1p() / kappa;
        let sin = (one_minus_cos * (2.0 - one_minus_cos)).max(0.0).sqrt();
        let local = [sin * v.cos(), sin * v.sin(), 1.0 - one_minus_cos].map(|c| c as f32);
        frame.to_world(Vec3::from_array(local)).normalize()
    }

    fn lobe_pdf(kappa: f64, mu: Vec3, d: Vec3) -> f32 {
        let chord = f64::from((d - mu).length_squared());
        let scale = kappa / (-2.0 * PI * (-2.0 * kappa).exp_m1());
        (scale * (-0.5 * kappa * chord).exp()) as f32
    }

    fn lobe(kappa: f64, pdf_kappa: f64, axis: Vec3, grid: Grid) -> DensityCheck {
        let frame = crate::math::Frame::from_normal(axis.normalize());
        let mut stream = Stream::from_key(kappa.to_bits());
        check_sphere(
            grid,
            || Some(draw_lobe(kappa, frame, &mut stream)),
            |d| lobe_pdf(pdf_kappa, frame.normal, d),
        )
    }

    #[test]
    fn correct_lobes_pass_and_the_wrong_one_fails() {
        // alpha = 1e-6 for each of nine correct lobes.
        let tilted = Vec3::new(0.3, -0.8, 0.4);
        for kappa in [1.0, 10.0, 200.0, 1e4, 1e6] {
            let check = lobe(kappa, kappa, tilted, Grid::new(20, 40, 200_000));
            assert!(check.agrees(1e-6), "kappa {kappa}: {check}");
        }
        for kappa in [10.0, 200.0, 1e4, 1e6] {
            let check = lobe(kappa, kappa, Vec3::Z, Grid::new(20, 20, 200_000));
            assert!(check.agrees(1e-6), "kappa {kappa} at the pole: {check}");
        }
        let wrong = lobe(10.0, 10.5, tilted, Grid::new(20, 40, 200_000));
        assert!(wrong.chi_square.p < 1e-12, "{wrong}");
    }

    #[test]
    fn normalisation_and_support_are_tested_apart() {
        let axis = Vec3::Z;
        let mut stream = Stream::from_key(3);
        let frame = crate::math::Frame::from_normal(axis);
        let too_large = check_sphere(
            Grid::new(20, 20, 100_000),
            || Some(draw_lobe(4.0, frame, &mut stream)),
            |d| 1.01 * lobe_pdf(4.0, axis, d),
        );
        assert!(too_large.chi_square.p > 1e-6 && !too_large.agrees(1e-6), "{too_large}");
        assert!((too_large.integral - 1.01).abs() < 1e-4, "{too_large}");

        let half = check_square(
            Grid::new(10, 10, 10_000),
            || Some(Vec2::new(stream.uniform(), stream.uniform())),
            |p| if p.x < 0.53 { 1.0 / 0.53 } else { 0.0 },
        );
        assert!(half.outside > 4000 && !half.agrees(1e-6), "{half}");
    }

    #[test]
    fn discarded_draws_lower_the_integral() {
        // A disk in the square: a share pi / 4 of the draws survives.
        let mut stream = Stream::from_key(4);
        let inside = |p: Vec2| (p - Vec2::splat(0.5)).length_squared() <= 0.25;
        let disk = check_square(
            Grid::new(20, 20, 200_000),
            || Some(Vec2::new(stream.uniform(), stream.uniform())).filter(|p| inside(*p)),
            |p| if inside(p) { 1.0 } else { 0.0 },
        );
        assert!(disk.agrees(1e-6), "{disk}");
        // The edge crosses 76 cells, each integrated to CELL_ERROR sqrt(500) / 200 000 = 1.1e-6.
        assert!((disk.integral - 0.25 * PI).abs() < 9e-5, "{disk}");
    }

    #[test]
    fn p_values_of_a_correct_pdf_are_rarely_small() {
        // 400 tests at alpha 0.05: 20 +- 4.4 rejections; 5 sigma bounds.
        let mut stream = Stream::from_key(5);
        let rejected = (0..400)
            .filter(|_| {
                let check = check_square(
                    Grid::new(4, 4, 800),
                    || Some(Vec2::new(stream.uniform(), stream.uniform())),
                    |_| 1.0,
                );
                check.chi_square.p < 0.05
            })
            .count();
        assert!((1..42).contains(&rejected), "{rejected} of 400");
    }
}
