//! How much a rough dielectric interface reflects in total: E(μ; α, η) = ∫ F(o·h) G₂/G₁ over the
//! visible normals of a direction with cosine μ.
//!
//! Tabulated row by row (one α, one η) on first use, over ⁴√μ and ⁴√α, which resolve the corner μ ~
//! α ~ 0; linear between. Indices between the table's nodes are interpolated in (η − 1)/(η + 1);
//! η = 1.5 is a node. For α of 0.002 and more the table differs from quadrature by less than 10⁻³.
//! The average over the hemisphere is that of the interpolant itself, so what is reflected and what
//! is not sum to 1.

use std::sync::OnceLock;

use glam::{Vec2, Vec3};

use super::fresnel;
use super::ggx::{Ggx, reflect};

/// Nodes along each axis.
pub(crate) const NODES: usize = 128;

/// Nodes per unit of (η − 1)/(η + 1): 1.5 lies at 0.2.
const INDEX_STEPS: f32 = 160.0;

/// Number of indices: up to η = 9.
const INDICES: usize = 129;

/// E over ⁴√μ at one α, and its mean ∫ E 2μ dμ.
#[derive(Debug)]
struct Row {
    values: [f32; NODES],
    mean: f32,
}

static ROWS: [[OnceLock<Box<Row>>; NODES]; INDICES] =
    [const { [const { OnceLock::new() }; NODES] }; INDICES];

/// E over μ, of one material.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoughReflectance {
    rows: [&'static Row; 4],
    weights: [f32; 4],
}

impl RoughReflectance {
    /// Of isotropic roughness `alpha` in [0, 1] and index `eta` in [1, 9] (both are clamped).
    pub(super) fn new(alpha: f32, eta: f32) -> Self {
        let (index, next, b) = index_cell(eta);
        let (at, a) = place(alpha.clamp(0.0, 1.0).sqrt().sqrt());
        Self {
            rows: [row(index, at), row(index, at + 1), row(next, at), row(next, at + 1)],
            weights: [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b],
        }
    }

    /// E(μ).
    #[inline]
    pub(super) fn at(&self, mu: f32) -> f32 {
        let (i, fraction) = place(mu.min(1.0).sqrt().sqrt());
        let mut sum = 0.0;
        for (row, weight) in self.rows.iter().zip(self.weights) {
            sum += weight * (row.values[i] + fraction * (row.values[i + 1] - row.values[i]));
        }
        sum
    }

    /// ∫ E 2μ dμ.
    #[inline]
    pub(super) fn mean(&self) -> f32 {
        self.rows.iter().zip(self.weights).map(|(row, weight)| weight * row.mean).sum()
    }
}

/// The two tabulated indices around η, and the weight of the second.
pub(crate) fn index_cell(eta: f32) -> (usize, usize, f32) {
    let s = ((eta - 1.0) / (eta + 1.0)).clamp(0.0, 0.8) * INDEX_STEPS;
    // 1.5 in single precision is its node, not a neighbour's fraction.
    let s = if (s - s.round()).abs() < 1e-4 { s.round() } else { s };
    let index = (s as usize).min(INDICES - 1);
    let b = s - index as f32;
    // A material between no indices needs no second one.
    (index, if b > 0.0 { index + 1 } else { index }, b)
}

/// Rows of index number `index`, one for each roughness number in `alphas`: its values, then its
/// mean.
#[cfg(feature = "gpu")]
pub(crate) fn rows_of(index: usize, alphas: std::ops::RangeInclusive<usize>) -> Vec<f32> {
    alphas
        .flat_map(|alpha| {
            let row = row(index, alpha);
            row.values.iter().copied().chain([row.mean])
        })
        .collect()
}

/// The cell and the position inside it of x in [0, 1].
#[inline]
fn place(x: f32) -> (usize, f32) {
    let x = x * (NODES - 1) as f32;
    let cell = (x as usize).min(NODES - 2);
    (cell, x - cell as f32)
}

fn row(index: usize, alpha: usize) -> &'static Row {
    ROWS[index][alpha].get_or_init(|| {
        let s = index as f32 / INDEX_STEPS;
        Box::new(Row::new(node(alpha), (1.0 + s) / (1.0 - s)))
    })
}

/// μ or α of a node.
fn node(i: usize) -> f32 {
    (i as f32 / (NODES - 1) as f32).powi(4)
}

impl Row {
    fn new(alpha: f32, eta: f32) -> Self {
        let values = std::array::from_fn(|i| quadrature(node(i), alpha, eta));
        // 2μ dμ = 8 x⁷ dx, times a linear function: four Gauss–Legendre nodes a cell are exact to
        // rounding.
        let mut mean = 0.0;
        for cell in 0..NODES - 1 {
            for (t, weight) in GAUSS_4 {
                let x = (cell as f64 + t) / (NODES - 1) as f64;
                let (low, high) = (f64::from(values[cell]), f64::from(values[cell + 1]));
                mean += weight * 8.0 * x.powi(7) * (low + t * (high - low));
            }
        }
        Self { values, mean: (mean / (NODES - 1) as f64) as f32 }
    }
}

/// Gauss–Legendre nodes and weights of four points on [0, 1].
const GAUSS_4: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// Cells of the composite rule along azimuth (a half turn, by symmetry) and along the cap.
const CELLS: [usize; 2] = [6, 14];

/// E(μ; α, η) by Gauss–Legendre over the square that the map of visible normals starts from.
fn quadrature(mu: f32, alpha: f32, eta: f32) -> f32 {
    // Rows below the threshold of smoothness still end the cell of rougher ones.
    let Some(ggx) = Ggx::nearly_smooth(alpha) else { return fresnel::dielectric(mu, eta) };
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu.max(f32::MIN_POSITIVE));
    let mut sum = 0.0;
    for a in 0..CELLS[0] {
        for (ta, weight_a) in GAUSS_4 {
            let x = 0.5 * (a as f64 + ta) / CELLS[0] as f64;
            for b in 0..CELLS[1] {
                for (tb, weight_b) in GAUSS_4 {
                    let y = (b as f64 + tb) / CELLS[1] as f64;
                    let h = ggx.sample_visible(wo, Vec2::new(x as f32, y as f32));
                    let wi = reflect(wo, h);
                    if wi.z > 0.0 {
                        let f = fresnel::dielectric(wo.dot(h).clamp(0.0, 1.0), eta);
                        sum += weight_a * weight_b * f64::from(f * ggx.shadowing(wo, wi));
                    }
                }
            }
        }
    }
    (sum / (CELLS[0] * CELLS[1]) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_agrees_with_quadrature_off_its_nodes() {
        let mut worst = (0.0f32, 0.0, 0.0, 0.0);
        for eta in [1.1, 1.33, 1.5, 2.4] {
            for alpha in [2e-3, 0.012, 0.05, 0.13, 0.3, 0.55, 0.81, 0.97] {
                let rough = RoughReflectance::new(alpha, eta);
                for mu in [1e-3, 2.7e-3, 0.011, 0.047, 0.12, 0.27, 0.52, 0.77, 0.98] {
                    let error = (rough.at(mu) - fine_quadrature(mu, alpha, eta)).abs();
                    if error > worst.0 {
                        worst = (error, mu, alpha, eta);
                    }
                }
            }
        }
        assert!(worst.0 < 1e-3, "error, mu, alpha, eta: {worst:?}");
    }

    /// The same integral by midpoints, 128 × 512 of them, sharing only the map of normals.
    fn fine_quadrature(mu: f32, alpha: f32, eta: f32) -> f32 {
        let ggx = Ggx::new(Vec2::splat(alpha)).unwrap();
        let wo = Vec3::new((1.0 - mu * mu).sqrt(), 0.0, mu);
        let mut sum = 0.0;
        for a in 0..128 {
            for b in 0..512 {
                let u = Vec2::new(0.5 * (a as f32 + 0.5) / 128.0, (b as f32 + 0.5) / 512.0);
                let h = ggx.sample_visible(wo, u);
                let wi = reflect(wo, h);
                if wi.z > 0.0 {
                    let f = fresnel::dielectric(wo.dot(h).clamp(0.0, 1.0), eta);
                    sum += f64::from(f * ggx.shadowing(wo, wi));
                }
            }
        }
        (sum / (128.0 * 512.0)) as f32
    }

    #[test]
    fn mean_agrees_with_midpoints_of_fresnel() {
        let n = 100_000;
        let expected: f64 = (0..n)
            .map(|i| {
                let mu = (f64::from(i) + 0.5) / f64::from(n);
                2.0 * mu * f64::from(fresnel::dielectric(mu as f32, 1.5)) / f64::from(n)
            })
            .sum();
        let mean = RoughReflectance::new(0.0, 1.5).mean();
        assert!((f64::from(mean) - expected).abs() < 2e-4, "{mean} {expected}");
    }
}
