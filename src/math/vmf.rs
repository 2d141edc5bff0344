//! The von Mises–Fisher distribution on the sphere, V(ω) = κ/(4π sinh κ) e^{κ μ·ω}, for 0 ≤ κ ≤ 10⁸
//! in single precision.
//!
//! | symbol | meaning |
//! |---|---|
//! | μ | mean direction, unit |
//! | κ | concentration; 0 is uniform |
//! | r | mean cosine E[μ·ω] = coth κ − 1/κ |
//!
//! The exponent is written with the chord, κ (μ·ω − 1) = −½ κ ‖ω − μ‖², because a dot product of
//! nearly equal vectors loses what κ magnifies; the normalisation with expm1, which has neither
//! overflow nor a limit to switch to.
//!
//! Papers: Jakob 2012, *Numerically stable sampling of the von Mises Fisher distribution on S²*;
//! Banerjee et al. 2005 (κ from r).

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::Lanes;
use super::exp::{exp, exp_m1, ln, ln_1p};
use super::warp::{one_minus_z, sin_cos_turn, turn_of};

/// Largest κ for which the functions here keep their precision.
pub const MAX_KAPPA: f32 = 1e8;

/// Half of the spacing of [`super::rng::unit_float`].
const HALF_STEP: f32 = 0.5 / 16_777_216.0;

/// x/(eˣ − 1) at x = −2κ, over 4π: the density's value at its peak, κ/(2π (1 − e^{−2κ})).
#[inline]
pub(crate) fn peak(kappa: f32) -> f32 {
    let x = -2.0 * kappa;
    let denominator = exp_m1(x);
    let ratio = if denominator == 0.0 { 1.0 } else { x / denominator };
    ratio * (0.5 / TAU)
}

/// [`peak`] of eight concentrations above 0.
#[inline(always)]
pub(crate) fn peaks(kappa: Lanes) -> Lanes {
    let x = kappa * -2.0;
    let denominator = x.exp_m1();
    // A concentration below 10⁻⁸ rounds the denominator to 0.
    let none = denominator.below(Lanes::ZERO).not();
    none.select(Lanes::splat(1.0), x / denominator) * (0.5 / TAU)
}

/// V at a direction whose squared distance from μ is `chord_squared` = ‖ω − μ‖², per solid angle.
/// `kappa` in [0, 10⁸].
#[inline]
#[must_use]
pub fn vmf_pdf_chord(kappa: f32, chord_squared: f32) -> f32 {
    vmf_pdf_below_peak(peak(kappa), kappa, chord_squared)
}

/// Returns what [`vmf_pdf_chord`] does, with V at the peak known.
#[inline]
pub(crate) fn vmf_pdf_below_peak(peak: f32, kappa: f32, chord_squared: f32) -> f32 {
    peak * exp(-0.5 * kappa * chord_squared)
}

/// V(ω), per solid angle, for unit vectors.
#[inline]
#[must_use]
pub fn vmf_pdf(kappa: f32, mu: Vec3, direction: Vec3) -> f32 {
    vmf_pdf_chord(kappa, direction.distance_squared(mu))
}

/// ln V(ω): finite where V itself underflows.
#[inline]
#[must_use]
pub fn vmf_log_pdf(kappa: f32, mu: Vec3, direction: Vec3) -> f32 {
    ln(peak(kappa)) - 0.5 * kappa * direction.distance_squared(mu)
}

/// A direction around +z with density V for μ = +z: `u.x` is the azimuth in turns, `u.y` the
/// distribution function of 1 − z.
///
/// x and y keep their precision for lobes so narrow that z rounds to 1.
#[inline]
#[must_use]
pub fn sample_vmf(kappa: f32, u: Vec2) -> Vec3 {
    let below = if kappa > 3e-8 {
        // The distribution function v at the centre of u's cell, and t = 1 − v, both exact where
        // they are small: no ln 0.
        let v = u.y + HALF_STEP;
        let t = (1.0 - u.y) - HALF_STEP;
        let missing = exp_m1(-2.0 * kappa);
        let x = v * missing;
        let log = if x > -0.5 { ln_1p(x) } else { ln(t + v * (1.0 + missing)) };
        -log / kappa
    } else {
        2.0 * u.y
    };
    let below = below.clamp(0.0, 2.0);
    let (s, c) = sin_cos_turn(u.x);
    let sin_theta = (below * (2.0 - below)).sqrt();
    Vec3::new(sin_theta * c, sin_theta * s, 1.0 - below)
}

/// Inverse of [`sample_vmf`].
#[inline]
#[must_use]
pub fn invert_vmf(kappa: f32, direction: Vec3) -> Vec2 {
    let below = one_minus_z(direction);
    let v = if kappa > 3e-8 { exp_m1(-kappa * below) / exp_m1(-2.0 * kappa) } else { 0.5 * below };
    Vec2::new(turn_of(direction.x, direction.y), v.clamp(0.0, 1.0 - 0.5 * f32::EPSILON))
}

/// 1 − r of the distribution: 1 + 1/κ − coth κ, in [0, 1].
#[must_use]
pub fn vmf_one_minus_mean_cosine(kappa: f32) -> f32 {
    (1.0 - mean_cosine(f64::from(kappa))) as f32
}

/// r = coth κ − 1/κ, in [0, 1).
#[must_use]
pub fn vmf_mean_cosine(kappa: f32) -> f32 {
    mean_cosine(f64::from(kappa)) as f32
}

fn mean_cosine(kappa: f64) -> f64 {
    if kappa < 1e-2 {
        // The next term, 2κ⁵/945, is below 10⁻¹² of the first.
        return kappa / 3.0 * (1.0 - kappa * kappa / 15.0);
    }
    // coth κ = 1 + 2/(e^{2κ} − 1)
    1.0 + 2.0 / (2.0 * kappa).exp_m1() - 1.0 / kappa
}

/// κ ≈ (3r − r³)/(1 − r²) from 1 − r (Banerjee et al. 2005): exact at both ends, at most 5 % too
/// large between, cheap.
///
/// Takes 1 − r, not r: near 1 a rounded r has no digits left for κ. Clamped to [0, [`MAX_KAPPA`]];
/// NaN gives 0.
#[inline]
#[must_use]
pub fn approximate_vmf_kappa(one_minus_r: f32) -> f32 {
    let d = one_minus_r;
    let r = 1.0 - d;
    let kappa = r * (3.0 - r * r) / (d * (2.0 - d));
    // d > 0 keeps κ from being NaN.
    if d > 0.0 {
        kappa.clamp(0.0, MAX_KAPPA)
    } else if d <= 0.0 {
        MAX_KAPPA
    } else {
        0.0
    }
}

/// The κ whose mean cosine is r, from 1 − r: inverse of [`vmf_one_minus_mean_cosine`], by Newton
/// steps from [`approximate_vmf_kappa`]. Clamped to [0, [`MAX_KAPPA`]].
#[must_use]
pub fn vmf_kappa(one_minus_r: f32) -> f32 {
    let mut kappa = f64::from(approximate_vmf_kappa(one_minus_r));
    if kappa <= 0.0 || kappa >= f64::from(MAX_KAPPA) {
        return kappa as f32;
    }
    let r = 1.0 - f64::from(one_minus_r);
    for _ in 0..4 {
        let value = mean_cosine(kappa);
        // r' = 1 − r² − 2r/κ, whose limit at 0 is 1/3.
        let slope =
            if kappa < 1e-2 { 1.0 / 3.0 } else { 1.0 - value * value - 2.0 * value / kappa };
        kappa = (kappa - (value - r) / slope).max(0.5 * kappa);
    }
    kappa.min(f64::from(MAX_KAPPA)) as f32
}

#[cfg(test)]
mod tests {
    //! Statistical tests: fixed seeds, α = 10⁻⁶; 5·10⁵ samples on 20 × 20 cells show a relative
    //! density error of 2.3 % (rms) with probability 0.99.

    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::stats::{Grid, check_sphere};

    const KAPPAS: [f32; 9] = [0.0, 1e-8, 1e-4, 0.1, 1.0, 10.0, 100.0, 1e4, 1e6];

    #[test]
    fn samples_follow_the_density() {
        let mut stream = Stream::from_key(1);
        for kappa in KAPPAS.into_iter().filter(|&kappa| kappa <= 1e4) {
            let mut draw = || sample_vmf(kappa, Vec2::new(stream.uniform(), stream.uniform()));
            let check = check_sphere(
                Grid::new(20, 20, 500_000),
                || Some(draw()),
                |d| vmf_pdf(kappa, Vec3::Z, d),
            );
            // The far tail underflows; samples reach no further than κ (1 − z) = 17.
            assert!(check.agrees(1e-6), "{kappa}: {check}");
            let control = check_sphere(
                Grid::new(20, 20, 500_000),
                || Some(draw()),
                |d| 1.01 * vmf_pdf(kappa, Vec3::Z, d),
            );
            assert!(!control.agrees(1e-6), "{kappa}: 1 % too large passes");
        }
    }

    #[test]
    fn tails_of_narrow_lobes_are_exponential() {
        // κ (1 − z) has mean and deviation 1; z itself is useless here.
        let mut stream = Stream::from_key(2);
        for kappa in [1e4, 1e6, 1e7, 1e8f32] {
            let n = 200_000;
            let mut sum = 0.0;
            for _ in 0..n {
                let d = sample_vmf(kappa, Vec2::new(stream.uniform(), stream.uniform()));
                sum += f64::from(kappa * one_minus_z(d));
            }
            // 5 standard errors: 1.1 %.
            assert!((sum / f64::from(n) - 1.0).abs() < 5.0 / f64::from(n).sqrt(), "{kappa}");
        }
    }

    #[test]
    fn density_matches_double_precision() {
        for kappa in [1e-8f32, 1e-4, 0.5, 30.0, 1e4, 1e6, 1e8] {
            for chord in [0.0f32, 0.3, 1.0, 3.0] {
                let chord_squared = (chord * chord / kappa.max(1.0)).min(4.0);
                let k = f64::from(kappa);
                let expected = k / (std::f64::consts::TAU * -(-2.0 * k).exp_m1())
                    * (-0.5 * k * f64::from(chord_squared)).exp();
                let found = f64::from(vmf_pdf_chord(kappa, chord_squared));
                assert!(
                    (found / expected - 1.0).abs() < 2e-6,
                    "{kappa} {chord}: {found} {expected}"
                );
            }
        }
        assert!((vmf_pdf(0.0, Vec3::Z, Vec3::X) - 0.25 * std::f32::consts::FRAC_1_PI).abs() < 1e-8);
        assert!(vmf_log_pdf(1e6, Vec3::Z, -Vec3::Z).is_finite());
        let (d, kappa) = (Vec3::new(0.6, 0.0, 0.8), 20.0);
        assert!((vmf_log_pdf(kappa, Vec3::Z, d) - vmf_pdf(kappa, Vec3::Z, d).ln()).abs() < 1e-5);
    }

    #[test]
    fn inverse_undoes_samples() {
        let mut stream = Stream::from_key(3);
        for kappa in KAPPAS {
            for _ in 0..2_000 {
                let u = Vec2::new(stream.uniform(), stream.uniform());
                let back = invert_vmf(kappa, sample_vmf(kappa, u));
                let error = (back - u).abs();
                let radius = u.y.sqrt().min((1.0 - u.y).sqrt()).max(1e-3);
                let azimuth = error.x.min(1.0 - error.x);
                assert!(azimuth < 1e-6 / radius && error.y < 3e-6, "{kappa}: {u} {back}");
            }
        }
    }

    #[test]
    fn extremes_stay_finite() {
        let last = 1.0 - 2.0 * HALF_STEP;
        for kappa in KAPPAS.into_iter().chain([3e-8, 89.0, MAX_KAPPA]) {
            for x in [0.0, last] {
                for y in [0.0, 0.5, last] {
                    let d = sample_vmf(kappa, Vec2::new(x, y));
                    assert!(d.is_normalized(), "{kappa} {x} {y}: {d}");
                    assert!(vmf_pdf(kappa, Vec3::Z, d).is_finite());
                }
            }
        }
    }

    #[test]
    fn concentration_and_mean_cosine_are_inverse() {
        for kappa in [1e-3f32, 0.1, 1.0, 5.0, 10.0, 1e3, 1e5, 1e7] {
            let missing = vmf_one_minus_mean_cosine(kappa);
            let found = vmf_kappa(missing);
            // 1 − r has a rounding of 2⁻²⁵ at κ → 0, that is 1.8e-7 of κ there.
            let tolerance = 1e-6 * kappa + 2e-7;
            assert!((found - kappa).abs() < tolerance, "{kappa}: {found}");
            let rough = approximate_vmf_kappa(missing);
            assert!((rough / kappa - 1.0).abs() < 0.051, "{kappa}: {rough}");
            assert!((vmf_mean_cosine(kappa) + missing - 1.0).abs() < 1e-6);
        }
        for kappa in [0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3] {
            let third = kappa / 3.0;
            assert!((vmf_mean_cosine(kappa) - third).abs() <= 1e-6 * third, "{kappa}");
        }
        assert_eq!(vmf_kappa(0.0), MAX_KAPPA);
        assert_eq!(vmf_kappa(1.0), 0.0);
        assert_eq!(approximate_vmf_kappa(f32::NAN), 0.0);
    }
}
