//! How much a smooth interface reflects.
//!
//! | symbol | meaning |
//! |---|---|
//! | c | cosine of the angle of incidence, in [0, 1] |
//! | η | index of refraction on the far side over that on the near side |
//! | k | the imaginary part of a conductor's index |

use glam::Vec3;

/// Unpolarised reflectance of a dielectric; 1 under total internal reflection, 0 at η = 1.
#[inline]
pub(super) fn dielectric(c: f32, eta: f32) -> f32 {
    match refracted_cosine(c, eta) {
        None => 1.0,
        Some(t) => {
            let s = (c - eta * t) / (c + eta * t);
            let p = (eta * c - t) / (eta * c + t);
            0.5 * (s * s + p * p)
        }
    }
}

/// Cosine of the refracted angle; `None` under total internal reflection and where nothing arrives
/// (c = 0).
#[inline]
pub(super) fn refracted_cosine(c: f32, eta: f32) -> Option<f32> {
    // 1 − (1 − c²)/η² with the cancellation of η → 1 taken out.
    let squared = (eta * eta - 1.0 + c * c) / (eta * eta);
    (squared > 0.0 && c > 0.0).then(|| squared.sqrt())
}

/// Unpolarised reflectance of a conductor with index η + i k, per channel.
///
/// With a + i b = √((η + i k)² − sin²): `r_s` = ((a−c)² + b²)/((a+c)² + b²), `r_p` = `r_s` ((ac −
/// s²)² + b²c²)/((ac + s²)² + b²c²), s² = 1 − c². Sums of squares instead of the usual differences:
/// a reflectance of 10⁻⁶ keeps its digits.
#[inline]
pub(super) fn conductor(c: f32, eta: Vec3, k: Vec3) -> Vec3 {
    let c2 = c * c;
    let s2 = 1.0 - c2;
    let p = (eta * eta - 1.0) + c2 - k * k;
    let q = eta * k;
    let modulus = (p * p + 4.0 * q * q).map(f32::sqrt);
    // The larger of a and b; the other follows from a b = η k.
    let large = (0.5 * (modulus + p.abs())).map(f32::sqrt);
    let small = q / large.max(Vec3::splat(f32::MIN_POSITIVE));
    let positive = p.cmpge(Vec3::ZERO);
    let a = Vec3::select(positive, large, small);
    let b = Vec3::select(positive, small, large);
    let b2 = b * b;
    let square = |v: Vec3| v * v;
    let s_numerator = square(a - c) + b2;
    let s_denominator = square(a + c) + b2;
    let p_numerator = square(a * c - s2) + b2 * c2;
    let p_denominator = square(a * c + s2) + b2 * c2;
    // Both denominators vanish together only at c = 0, η = 1, k = 0.
    let rs = s_numerator / s_denominator.max(Vec3::splat(f32::MIN_POSITIVE));
    let rp = rs * p_numerator / p_denominator.max(Vec3::splat(f32::MIN_POSITIVE));
    0.5 * (rs + rp)
}

/// (1 − c)⁵ (Schlick 1994).
#[inline]
pub(super) fn schlick_weight(c: f32) -> f32 {
    let m = (1.0 - c).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glass_at_normal_and_sixty_degrees() {
        assert!((dielectric(1.0, 1.5) - 0.04).abs() < 1e-7);
        assert!((dielectric(0.5, 1.5) - 0.089_186_7).abs() < 1e-6);
    }

    #[test]
    fn dielectric_edge_cases() {
        for c in [0.0, 1e-7, 0.5, 1.0] {
            for eta in [1.0, 1.0 + 1e-6, 1.5, 1.0 / 1.5, 10.0, 0.1] {
                let f = dielectric(c, eta);
                assert!((0.0..=1.0).contains(&f), "c {c}, eta {eta}: {f}");
            }
        }
        assert_eq!(dielectric(0.5, 1.0), 0.0);
        // The exact critical angle from inside of glass: sin = 1/1.5.
        let critical = (1.0f32 - 1.0 / 2.25).sqrt();
        assert!(dielectric(critical, 1.0 / 1.5) > 0.99);
        assert_eq!(dielectric(critical - 1e-3, 1.0 / 1.5), 1.0);
    }

    #[test]
    fn conductor_at_normal_incidence_is_the_textbook_ratio() {
        for (eta, k) in [(0.2f64, 3.9f64), (1.5, 0.0), (1.0, 2e-3), (2.0, 100.0)] {
            let expected = ((eta - 1.0).powi(2) + k * k) / ((eta + 1.0).powi(2) + k * k);
            let found = conductor(1.0, Vec3::splat(eta as f32), Vec3::splat(k as f32)).x;
            assert!((f64::from(found) / expected - 1.0).abs() < 2e-6, "{eta} {k}: {found}");
        }
    }

    #[test]
    fn conductor_without_absorption_is_a_dielectric() {
        for c in [0.05, 0.3, 0.7, 1.0] {
            let found = conductor(c, Vec3::splat(1.5), Vec3::ZERO).x;
            assert!((found - dielectric(c, 1.5)).abs() < 1e-6);
        }
    }
}
