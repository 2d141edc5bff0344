//! The GGX distribution of microfacet normals and its visible part.
//!
//! | symbol | meaning |
//! |---|---|
//! | `α_x`, `α_y` | roughness along the tangents |
//! | h | microfacet normal, unit, `h_z` > 0 |
//! | D | density of normals, per solid angle of h and projected area |
//! | ‖w‖_α | `√(α_x² w_x² + α_y² w_y² + w_z²)`: the length of w stretched into the frame where the surface has α = 1 |
//! | G₁, G₂ | Smith masking; masking and shadowing with correlated heights (Heitz 2014) |
//!
//! In these terms `Λ(w) = (‖w‖_α / w_z − 1)/2`, so `G₁(w) = 2 w_z/(w_z + ‖w‖_α)` and
//! `G₂(o, i) = 2 o_z i_z/(‖o‖_α i_z + ‖i‖_α o_z)`: no division by a cosine, finite at every angle.
//!
//! Papers: Walter et al. 2007; Heitz 2014; Dupuy and Benyoub 2023, *Sampling Visible GGX Normals
//! with Spherical Caps*.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use crate::math::warp::{one_minus_z, sin_cos_turn, turn_of};

/// Surfaces whose larger α is below this are perfectly smooth (as in pbrt-v4): a lobe narrower than
/// 10⁻³ rad looks the same, and directions in single precision no longer resolve its density.
pub(super) const SMOOTH: f32 = 1e-3;

/// The smaller α of a surface that is not [`SMOOTH`]: at 10⁻⁴ the microfacet normal of two unit
/// vectors in single precision is still known to 10⁻³ of the lobe's width.
const NARROWEST: f32 = 1e-4;

/// Roughness along both tangents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ggx {
    alpha: Vec2,
}

impl Ggx {
    /// A rough surface, or `None` where it is to be treated as perfectly smooth.
    #[inline]
    pub(super) fn new(alpha: Vec2) -> Option<Self> {
        (alpha.max_element() >= SMOOTH).then(|| Self { alpha: alpha.max(Vec2::splat(NARROWEST)) })
    }

    /// An isotropic surface down to α = 10⁻⁴.
    pub(super) fn nearly_smooth(alpha: f32) -> Option<Self> {
        (alpha >= NARROWEST).then(|| Self { alpha: Vec2::splat(alpha) })
    }

    /// The smaller α.
    #[inline]
    pub(super) fn min_alpha(&self) -> f32 {
        self.alpha.min_element()
    }

    /// The isotropic α of the same area: `√(α_x α_y)`.
    #[inline]
    pub(super) fn mean_alpha(&self) -> f32 {
        (self.alpha.x * self.alpha.y).sqrt()
    }

    /// G₂(o, i)/G₁(o), the weight of a reflection off a visible normal for F = 1; in [0, 1].
    #[inline]
    pub(super) fn shadowing(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (o, i) = (self.stretched(wo), self.stretched(wi));
        wi.z * (wo.z + o) / (o * wi.z + i * wo.z)
    }

    /// D(h) for a unit h: `1/(π α_x α_y ((h_x/α_x)² + (h_y/α_y)² + h_z²)²)`.
    #[inline]
    pub(super) fn density(&self, h: Vec3) -> f32 {
        let s = Vec2::new(h.x, h.y) / self.alpha;
        let length = s.length_squared() + h.z * h.z;
        FRAC_1_PI / (self.alpha.x * self.alpha.y * length * length)
    }

    /// ‖w‖_α.
    #[inline]
    pub(super) fn stretched(&self, w: Vec3) -> f32 {
        let s = self.alpha * Vec2::new(w.x, w.y);
        (s.length_squared() + w.z * w.z).sqrt()
    }

    /// Density of reflected directions, `D(h) G₁(o)/(4 o_z)`, and `D(h) G₂/(4 o_z)`, the reflected
    /// light times the incident cosine for F = 1. `wo` and `wi` above the horizon, `h` their unit
    /// half vector.
    #[inline]
    pub(super) fn reflection(&self, wo: Vec3, wi: Vec3, h: Vec3) -> (f32, f32) {
        let d = 0.5 * self.density(h);
        let (o, i) = (self.stretched(wo), self.stretched(wi));
        (d / (wo.z + o), d * wi.z / (o * wi.z + i * wo.z))
    }

    /// A visible normal of `wo` (`o_z` > 0), density `D(h) G₁(o) (o·h)/o_z` (Dupuy and Benyoub
    /// 2023, listing 3).
    #[inline]
    pub(super) fn sample_visible(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let v = self.stretch(wo);
        let (s, c) = sin_cos_turn(u.x);
        // 1 − z of the cap's point, exact near the pole.
        let below = u.y * (1.0 + v.z);
        let sin_theta = (below * (2.0 - below)).max(0.0).sqrt();
        let h = Vec3::new(sin_theta * c + v.x, sin_theta * s + v.y, (1.0 - below) + v.z);
        // At the cap's rim h_z rounds to either side of zero.
        Vec3::new(h.x * self.alpha.x, h.y * self.alpha.y, h.z.max(0.0)).normalize_or(Vec3::Z)
    }

    /// Inverse of [`Ggx::sample_visible`] at a unit `h`.
    #[inline]
    pub(super) fn invert_visible(&self, wo: Vec3, h: Vec3) -> Vec2 {
        let v = self.stretch(wo);
        let n = Vec3::new(h.x / self.alpha.x, h.y / self.alpha.y, h.z).normalize();
        let c = (2.0 * n.dot(v) * n - v).normalize();
        let below = one_minus_z(c) / (1.0 + v.z);
        Vec2::new(turn_of(c.x, c.y), below.min(1.0 - 0.5 * f32::EPSILON))
    }

    /// `w` in the frame where the surface has α = 1, unit.
    #[inline]
    fn stretch(&self, w: Vec3) -> Vec3 {
        Vec3::new(self.alpha.x * w.x, self.alpha.y * w.y, w.z) / self.stretched(w)
    }
}

/// `wo` mirrored at `h`.
#[inline]
pub(super) fn reflect(wo: Vec3, h: Vec3) -> Vec3 {
    2.0 * wo.dot(h) * h - wo
}

/// The unit vector half way; `None` where the directions are opposite to within single precision.
#[inline]
pub(super) fn half_vector(wo: Vec3, wi: Vec3) -> Option<Vec3> {
    (wo + wi).try_normalize()
}
