//! Frames, colours, rounding bounds: what every other module may use.
//!
//! | here | meaning |
//! |---|---|
//! | local frame | the shading normal is +z, directions point away from the surface |
//! | `gamma(n)` | bound on the relative error of n roundings (Higham 2002): n ε / (1 − n ε), ε = 2⁻²⁴ |

mod exp;
mod lanes;
pub mod rng;
pub mod vmf;
pub mod warp;

use glam::{Vec2, Vec3};

pub(crate) use exp::{exp, ln};
pub(crate) use lanes::{LANES, Lanes, Lanes3, Mask};

/// Weights of linear Rec. 709 RGB.
const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// Rec. 709 luminance of linear RGB, the crate's one scalarisation of colour.
#[inline]
#[must_use]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(LUMINANCE)
}

/// [`luminance`] of eight colours.
#[inline(always)]
pub(crate) fn luminances(rgb: Lanes3) -> Lanes {
    rgb.dot_with(LUMINANCE)
}

/// `n ε / (1 − n ε)` with ε = 2⁻²⁴: the relative error of n rounded operations stays below it
/// (Higham 2002, lemma 3.1).
#[inline]
#[must_use]
pub const fn gamma(n: u32) -> f32 {
    let nu = n as f32 * (0.5 * f32::EPSILON);
    nu / (1.0 - nu)
}

/// `(a c) − (b d)` to within 1.5 ulp, without catastrophic cancellation (Kahan; Jeannerod et al.
/// 2013).
#[inline]
#[must_use]
pub fn difference_of_products(a: f32, c: f32, b: f32, d: f32) -> f32 {
    // In f64 both products of f32 factors are exact, so one rounding remains.
    (f64::from(a) * f64::from(c) - f64::from(b) * f64::from(d)) as f32
}

/// An orthonormal frame; `normal` is its +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Local +x.
    pub tangent: Vec3,
    /// Local +y.
    pub bitangent: Vec3,
    /// Local +z.
    pub normal: Vec3,
}

impl Frame {
    /// A frame around a unit normal, continuous except at `n_z` = −0 (Duff et al. 2017, listing 3):
    /// no branch, error below 2·10⁻⁷.
    #[inline]
    #[must_use]
    pub fn from_normal(n: Vec3) -> Self {
        let sign = 1.0_f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            bitangent: Vec3::new(b, sign + n.y * n.y * a, -n.y),
            normal: n,
        }
    }

    /// A frame around unit `normal` whose +x is `tangent` made orthogonal; falls back to any frame
    /// where they are parallel.
    #[inline]
    #[must_use]
    pub fn from_normal_and_tangent(normal: Vec3, tangent: Vec3) -> Self {
        let t = tangent - normal * normal.dot(tangent);
        match t.try_normalize() {
            Some(t) => Self { tangent: t, bitangent: normal.cross(t), normal },
            None => Self::from_normal(normal),
        }
    }

    /// World to local.
    #[inline]
    #[must_use]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.tangent), v.dot(self.bitangent), v.dot(self.normal))
    }

    /// World to local, of eight vectors.
    #[inline(always)]
    pub(crate) fn lanes_to_local(&self, v: Lanes3) -> Lanes3 {
        Lanes3 {
            x: v.dot_with(self.tangent),
            y: v.dot_with(self.bitangent),
            z: v.dot_with(self.normal),
        }
    }

    /// Local to world.
    #[inline]
    #[must_use]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.tangent * v.x + self.bitangent * v.y + self.normal * v.z
    }
}

/// Moves `p` along unit `n`, out of the box `p ± error`, and at least one unit in the last place
/// further in every component, so that rounding never brings it back (Pharr, Jakob, Humphreys 2023,
/// section 6.8.6). `n` must point to the side the ray leaves to.
#[inline]
#[must_use]
pub fn offset_origin(p: Vec3, n: Vec3, error: Vec3) -> Vec3 {
    let moved = p + n * n.abs().dot(error);
    // A share of 2⁻²³ is at least one unit in the last place, so the sum cannot round back.
    moved + n.signum() * (moved.abs() * f32::EPSILON)
}

/// Octahedral code of a unit direction, in [−1, 1]² (Cigolle et al. 2014).
#[inline]
#[must_use]
pub fn octahedral_encode(d: Vec3) -> Vec2 {
    let p = Vec2::new(d.x, d.y) / (d.x.abs() + d.y.abs() + d.z.abs());
    if d.z >= 0.0 { p } else { octahedral_wrap(p) }
}

/// Inverse of [`octahedral_encode`]: a unit direction.
#[inline]
#[must_use]
pub fn octahedral_decode(p: Vec2) -> Vec3 {
    let z = 1.0 - p.x.abs() - p.y.abs();
    let q = if z >= 0.0 { p } else { octahedral_wrap(p) };
    Vec3::new(q.x, q.y, z).normalize()
}

#[inline]
fn octahedral_wrap(p: Vec2) -> Vec2 {
    Vec2::new((1.0 - p.y.abs()).copysign(p.x), (1.0 - p.x.abs()).copysign(p.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_is_orthonormal_near_both_poles() {
        for n in [
            Vec3::Z,
            -Vec3::Z,
            Vec3::new(1e-4, -1e-4, -1.0).normalize(),
            Vec3::new(3e-8, 0.0, -1.0),
        ] {
            let f = Frame::from_normal(n);
            let error = [
                f.tangent.dot(f.bitangent),
                f.tangent.dot(n),
                f.bitangent.dot(n),
                f.tangent.length() - 1.0,
                f.bitangent.length() - 1.0,
                f.tangent.cross(f.bitangent).dot(n) - 1.0,
            ];
            assert!(error.iter().all(|e| e.abs() < 4e-7), "{n}: {error:?}");
        }
    }

    #[test]
    fn a_frame_with_a_tangent_is_right_handed_and_keeps_it() {
        let normal = Vec3::new(1.0, -2.0, 3.0).normalize();
        for tangent in [Vec3::X, Vec3::new(0.2, 3.0, -1.0), -Vec3::Z] {
            let f = Frame::from_normal_and_tangent(normal, tangent);
            assert!((f.tangent.cross(f.bitangent) - normal).length() < 1e-6, "{tangent}");
            assert!(f.tangent.dot(tangent) > 0.0 && f.bitangent.dot(tangent).abs() < 1e-6);
        }
        let along = Frame::from_normal_and_tangent(Vec3::Z, Vec3::Z);
        assert_eq!(along, Frame::from_normal(Vec3::Z));
    }

    #[test]
    fn octahedral_round_trip_at_seams_and_poles() {
        for d in [
            Vec3::X,
            -Vec3::X,
            Vec3::Y,
            Vec3::Z,
            -Vec3::Z,
            Vec3::new(1.0, -1.0, 0.0),
            Vec3::new(0.3, -0.4, -0.9),
        ] {
            let d = d.normalize();
            assert!((octahedral_decode(octahedral_encode(d)) - d).length() < 1e-6, "{d}");
        }
    }

    #[test]
    fn differences_of_products_keep_what_is_left() {
        // (1 + ε) (1 − ε) − 1 = −ε², of which single precision has nothing.
        let epsilon = 1.0 / 8192.0;
        let left = difference_of_products(1.0 + epsilon, 1.0 - epsilon, 1.0, 1.0);
        assert_eq!(left, -epsilon * epsilon);
    }

    #[test]
    fn luminance_of_white_is_one() {
        assert!((luminance(Vec3::ONE) - 1.0).abs() < 1e-7);
    }
}
