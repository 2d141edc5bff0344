//! Spheres and disks, in their object's space and in f64.
//!
//! | symbol | meaning |
//! |---|---|
//! | o, d | ray relative to the centre |
//! | (u, v) of a sphere's hit | octahedral code of the object-space normal |
//! | (u, v) of a disk's hit | position in units of the radius in `Frame::from_normal` |
//!
//! A root within 2⁻⁴⁰ (|o| + r) / |d| of 0 is not told from the origin's own surface and dropped:
//! the roundings of the stable quadratic (Pharr, Jakob, Humphreys 2023, section 6.8.3) are below
//! 2⁻⁴⁸ of that, an origin offset from the surface is 2⁻²⁵ away.

use glam::{DVec2, DVec3, Vec2};

use crate::math::{octahedral_decode, octahedral_encode};

/// Parameters of the hits with a sphere, ascending; NaN is a miss.
#[inline]
pub(super) fn sphere_roots(
    center: DVec3,
    radius: f64,
    origin: DVec3,
    direction: DVec3,
) -> [f64; 2] {
    let o = origin - center;
    let a = direction.length_squared();
    let b = -o.dot(direction);
    // The discriminant from the distance of centre and line: no cancellation of large squares.
    let off = o + direction * (b / a);
    let discriminant = radius * radius - off.length_squared();
    if discriminant < 0.0 || discriminant.is_nan() {
        return [f64::NAN; 2];
    }
    let q = b + (a * discriminant).sqrt().copysign(b);
    let c = (o.length() - radius) * (o.length() + radius);
    let (t0, t1) = (c / q, q / a);
    let smallest = near_bound(o, radius, a);
    let keep = |t: f64| if t > smallest { t } else { f64::NAN };
    if t0 < t1 { [keep(t0), keep(t1)] } else { [keep(t1), keep(t0)] }
}

/// Parameter of the hit with a disk, if any.
#[inline]
pub(super) fn disk_root(
    center: DVec3,
    normal: DVec3,
    radius: f64,
    origin: DVec3,
    direction: DVec3,
) -> Option<f64> {
    let o = origin - center;
    let t = -o.dot(normal) / direction.dot(normal);
    let at = o + direction * t;
    let at = at - normal * at.dot(normal);
    (t.is_finite()
        && at.length_squared() <= radius * radius
        && t > near_bound(o, radius, direction.length_squared()))
    .then_some(t)
}

fn near_bound(o: DVec3, radius: f64, direction_squared: f64) -> f64 {
    const BOUND: f64 = 1.0 / (1_u64 << 40) as f64;
    BOUND * (o.length() + radius) / direction_squared.sqrt()
}

/// (u, v) of a point on a sphere, given relative to its centre.
#[inline]
pub(super) fn sphere_encode(at: DVec3) -> Vec2 {
    octahedral_encode(at.normalize().as_vec3())
}

/// The unit outward normal of a sphere's (u, v).
#[inline]
pub(super) fn sphere_decode(uv: Vec2) -> DVec3 {
    octahedral_decode(uv).as_dvec3().normalize()
}

/// Tangents of a disk, orthonormal with its normal, in f64.
#[inline]
pub(super) fn disk_tangents(normal: DVec3) -> (DVec3, DVec3) {
    // Duff et al. 2017, as `Frame::from_normal`.
    let sign = 1.0_f64.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    (
        DVec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        DVec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    )
}

/// (u, v) of a point on a disk, given relative to its centre.
#[inline]
pub(super) fn disk_encode(at: DVec3, normal: DVec3, radius: f64) -> Vec2 {
    let (tangent, bitangent) = disk_tangents(normal);
    (DVec2::new(at.dot(tangent), at.dot(bitangent)) / radius).as_vec2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sphere_roots_by_hand() {
        let roots = |o: DVec3| sphere_roots(DVec3::ZERO, 1.0, o, DVec3::Z * 2.0);
        assert_eq!(roots(DVec3::new(0.0, 0.0, -3.0)), [1.0, 2.0]);
        let inside = roots(DVec3::ZERO);
        assert!(inside[0].is_nan() && inside[1] == 0.5, "{inside:?}");
        assert!(roots(DVec3::new(0.0, 0.0, 3.0)).iter().all(|t| t.is_nan()));
        assert!(roots(DVec3::new(1.1, 0.0, -3.0)).iter().all(|t| t.is_nan()));
    }

    /// `b² − a c` of a ball of 1 m at 10⁸ m has no digit of its radius left.
    #[test]
    fn far_spheres_are_where_they_are() {
        let at = |x: f64| sphere_roots(DVec3::ZERO, 1.0, DVec3::new(x, 0.0, -1e8), DVec3::Z * 2.0);
        for x in [0.0_f64, 0.5, 0.9, 0.999] {
            let half = (1.0 - x * x).sqrt();
            let [near, far] = at(x).map(|t| 2.0 * t - 1e8);
            assert!((near + half).abs() < 1e-7 && (far - half).abs() < 1e-7, "{x}: {near} {far}");
        }
        assert!(at(1.001).iter().all(|t| t.is_nan()));
    }

    #[test]
    fn disk_includes_its_rim_and_misses_edge_on() {
        let root = |o: DVec3, d: DVec3| disk_root(DVec3::ZERO, DVec3::Z, 2.0, o, d);
        assert_eq!(root(DVec3::new(2.0, 0.0, -3.0), DVec3::Z), Some(3.0));
        assert_eq!(root(DVec3::new(2.1, 0.0, -3.0), DVec3::Z), None);
        assert_eq!(root(DVec3::new(-3.0, 0.0, 0.0), DVec3::X), None);
    }
}
