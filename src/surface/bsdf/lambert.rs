//! Diffuse reflection and transmission (Lambert).

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::{Evaluation, Lobes, select};
use crate::math::warp::{invert_cosine_hemisphere, sample_cosine_hemisphere};
use crate::math::{Lanes, Lanes3, Mask};

/// f = ρ/π on the side of `wo`, on both sides of the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Diffuse {
    /// Albedo ρ.
    pub(super) reflectance: Vec3,
}

impl Lobes for Diffuse {
    #[inline]
    fn count(&self) -> u32 {
        1
    }

    #[inline]
    fn is_delta(&self, _: u32) -> bool {
        false
    }

    #[inline]
    fn is_black(&self) -> bool {
        self.reflectance == Vec3::ZERO
    }

    #[inline]
    fn probability(&self, lobe: u32, _: Vec3) -> f32 {
        if lobe == 0 { 1.0 } else { 0.0 }
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        if wo.z * wi.z > 0.0 && select(lobes, 0) {
            let pdf = wi.z.abs() * FRAC_1_PI;
            Evaluation { value: self.reflectance * pdf, pdf }
        } else {
            Evaluation::ZERO
        }
    }

    #[inline(always)]
    fn evaluate_lanes(&self, wo: Vec3, wi: &Lanes3, alive: Mask) -> (Lanes3, Lanes) {
        let same_side = Lanes::ZERO.below(wi.z * wo.z);
        let pdf = same_side.and(alive).select(wi.z.abs() * FRAC_1_PI, Lanes::ZERO);
        let Vec3 { x, y, z } = self.reflectance;
        (Lanes3 { x: pdf * x, y: pdf * y, z: pdf * z }, pdf)
    }

    #[inline]
    fn direction(&self, _: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let wi = sample_cosine_hemisphere(u);
        Some(Vec3::new(wi.x, wi.y, wi.z.copysign(wo.z)))
    }

    #[inline]
    fn invert(&self, _: u32, _: Vec3, wi: Vec3) -> Option<Vec2> {
        Some(invert_cosine_hemisphere(wi))
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        self.reflectance
    }

    #[inline]
    fn roughness(&self, _lobe: u32) -> f32 {
        1.0
    }
}

/// f = ρ/π on the side of `wo`, τ/π on the other. Lobe 0 reflects, lobe 1 transmits.
#[derive(Clone, Copy, Debug)]
pub(super) struct DiffuseTransmission {
    reflectance: Vec3,
    transmittance: Vec3,
    /// Of lobe 0.
    probability: f32,
}

impl DiffuseTransmission {
    #[inline]
    pub(super) fn new(reflectance: Vec3, transmittance: Vec3) -> Self {
        let (r, t) = (reflectance.max_element(), transmittance.max_element());
        let probability = if r + t > 0.0 { r / (r + t) } else { 1.0 };
        Self { reflectance, transmittance, probability }
    }
}

impl Lobes for DiffuseTransmission {
    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn count(&self) -> u32 {
        2
    }

    #[inline]
    fn is_delta(&self, _: u32) -> bool {
        false
    }

    #[inline]
    fn is_black(&self) -> bool {
        self.reflectance == Vec3::ZERO && self.transmittance == Vec3::ZERO
    }

    #[inline]
    fn probability(&self, lobe: u32, _: Vec3) -> f32 {
        if lobe == 0 { self.probability } else { 1.0 - self.probability }
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        let side = wo.z * wi.z;
        let (lobe, albedo, probability) = if side > 0.0 {
            (0, self.reflectance, self.probability)
        } else if side < 0.0 {
            (1, self.transmittance, 1.0 - self.probability)
        } else {
            return Evaluation::ZERO;
        };
        if !select(lobes, lobe) {
            return Evaluation::ZERO;
        }
        let cosine = wi.z.abs() * FRAC_1_PI;
        Evaluation { value: albedo * cosine, pdf: probability * cosine }
    }

    #[inline]
    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let wi = sample_cosine_hemisphere(u);
        let side = if lobe == 0 { wo.z } else { -wo.z };
        Some(Vec3::new(wi.x, wi.y, wi.z.copysign(side)))
    }

    #[inline]
    fn invert(&self, _: u32, _: Vec3, wi: Vec3) -> Option<Vec2> {
        Some(invert_cosine_hemisphere(wi))
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        self.reflectance + self.transmittance
    }

    #[inline]
    fn roughness(&self, _lobe: u32) -> f32 {
        1.0
    }
}
