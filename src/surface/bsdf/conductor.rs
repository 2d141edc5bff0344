//! Metals: GGX microfacets or a perfect mirror, with the exact conductor Fresnel term, on both
//! sides of the surface.

use glam::{Vec2, Vec3};

use super::ggx::{Ggx, half_vector, reflect};
use super::{DeltaSample, Evaluation, Lobes, fresnel, mirror_to_front, select};

/// One reflection lobe: `f cos θ_i = F(o·h) D(h) G₂/(4 o_z)`, or a delta of weight `F(o_z)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Conductor {
    /// Real part of the index of refraction.
    pub(super) eta: Vec3,
    /// Imaginary part.
    pub(super) k: Vec3,
    /// `None`: a perfect mirror.
    pub(super) surface: Option<Ggx>,
}

impl Conductor {
    /// The metal with reflectance r at normal incidence: η = 1, k = 2 √r/√(1 − r) (pbrt-v4). `r` is
    /// cut to [0, 1 − 2⁻²⁴].
    #[inline]
    pub(super) fn from_reflectance(r: Vec3, surface: Option<Ggx>) -> Self {
        // One ulp below 1, where k is 8192 and F is 1 to single precision; pbrt cuts at 0.9999.
        let r = r.clamp(Vec3::ZERO, Vec3::splat(1.0 - 0.5 * f32::EPSILON));
        let k = 2.0 * (r / (1.0 - r)).map(f32::sqrt);
        Self { eta: Vec3::ONE, k, surface }
    }
}

impl Lobes for Conductor {
    #[inline]
    fn count(&self) -> u32 {
        1
    }

    #[inline]
    fn is_delta(&self, _: u32) -> bool {
        self.surface.is_none()
    }

    #[inline]
    fn is_black(&self) -> bool {
        // η = 1, k = 0 in all channels: no interface.
        self.eta == Vec3::ONE && self.k == Vec3::ZERO
    }

    #[inline]
    fn probability(&self, lobe: u32, _: Vec3) -> f32 {
        if lobe == 0 { 1.0 } else { 0.0 }
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        let Some(ggx) = self.surface else { return Evaluation::ZERO };
        if !(wo.z * wi.z > 0.0 && select(lobes, 0)) {
            return Evaluation::ZERO;
        }
        let (wo, wi) = mirror_to_front(wo, wi);
        let Some(h) = half_vector(wo, wi) else { return Evaluation::ZERO };
        let (pdf, value) = ggx.reflection(wo, wi, h);
        let f = fresnel::conductor(wo.dot(h).min(1.0), self.eta, self.k);
        Evaluation { value: f * value, pdf }
    }

    #[inline]
    fn direction(&self, _: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let ggx = self.surface?;
        let (front, _) = mirror_to_front(wo, wo);
        let wi = reflect(front, ggx.sample_visible(front, u));
        (wi.z > 0.0).then(|| Vec3::new(wi.x, wi.y, wi.z.copysign(wo.z)))
    }

    #[inline]
    fn delta(&self, _: u32, wo: Vec3) -> Option<DeltaSample> {
        let value = fresnel::conductor(wo.z.abs(), self.eta, self.k);
        Some(DeltaSample { wi: Vec3::new(-wo.x, -wo.y, wo.z), value, pdf: 1.0, eta: 1.0 })
    }

    #[inline]
    fn invert(&self, _: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        let ggx = self.surface?;
        let (wo, wi) = mirror_to_front(wo, wi);
        Some(ggx.invert_visible(wo, half_vector(wo, wi)?))
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        fresnel::conductor(1.0, self.eta, self.k)
    }

    #[inline]
    fn roughness(&self, _lobe: u32) -> f32 {
        self.surface.map_or(0.0, |ggx| ggx.min_alpha())
    }
}
