//! The metallic-roughness surface of glTF 2.0 (specification, appendix B) with `KHR_materials_ior`,
//! `_specular` and `_transmission`.
//!
//! | symbol | meaning |
//! |---|---|
//! | w(c) | (1 − c)⁵ |
//! | `F_d` | the dielectric's reflectance f₀ + (f₉₀ − f₀) w, f₀ = min(((n−1)/(n+1))² · tint, 1) · specular, f₉₀ = specular |
//! | F | metallic (base + (1 − base) w) + (1 − metallic) `F_d` |
//! | T | 1 − the largest channel of `F_d`; T̄ its mean over the hemisphere |
//!
//! | lobe | f |
//! |---|---|
//! | 0 specular | `F(o·h) D G₂/(4 o_z i_z)` |
//! | 1 diffuse | (1 − metallic)(1 − transmission) base `T(o_z) T(i_z)/(π T̄)` |
//! | 2 transmission, thin-walled | (1 − metallic) transmission base `T(o·h) D G₂/(4 o_z i_z)`, i mirrored in z; a delta where smooth |
//!
//! Deviation: the specification's diffuse factor is 1 − F(o·h), with which a grazing view reflects
//! up to 1.9 times what arrives. `T(o_z) T(i_z)/T̄` (Kelemen and Szirmay-Kalos 2001) is reciprocal,
//! keeps the sum below 1 (the diffuse lobe is scaled by 0.996 for that) and differs by a few
//! percent at steep angles. The back of a surface that is not double-sided is black.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::ggx::{Ggx, half_vector, reflect};
use super::{DeltaSample, Evaluation, Lobes, fresnel, mirror_to_front, select};
use crate::math::warp::{invert_cosine_hemisphere, sample_cosine_hemisphere};

/// ∫ w(μ) 2μ dμ.
const MEAN_SCHLICK: f32 = 1.0 / 21.0;

/// Factor on the diffuse lobe. A rough interface reflects a little more than `F(o_z)` at steep
/// angles, as its microfacets lean away: with the sum at smooth surfaces' 1, a white one reached
/// 1.0032 (n = 1.5, roughness 0.3, `o_z` = 0.6).
const DIFFUSE_SHARE: f32 = 0.996;

/// Least w in the estimate of the specular lobe: it reflects at o·h < 1 even where `o_z` = 1.
const LEAST_SCHLICK: f32 = 0.01;

/// Least T in the estimate of the transmission lobe, whose microfacets are never all at grazing
/// angles.
const LEAST_TRANSMITTANCE: f32 = 0.05;

/// Parameters of a metallic-roughness surface at a point; see the glTF 2.0 specification, section
/// 3.9.
#[derive(Clone, Copy, Debug)]
pub struct MetallicRoughness {
    /// Albedo of the dielectric part, F₀ of the metallic part; in [0, 1].
    pub base_color: Vec3,
    /// Share of metal, in [0, 1].
    pub metallic: f32,
    /// Perceptual: α is its square.
    pub roughness: f32,
    /// Index of refraction n of the dielectric part; 0 stands for infinity.
    pub ior: f32,
    /// Strength of the dielectric's reflection, in [0, 1].
    pub specular: f32,
    /// Tint of its f₀; not negative.
    pub specular_color: Vec3,
    /// Share of the diffuse part that passes straight through, in [0, 1].
    pub transmission: f32,
    /// Whether the back reflects too.
    pub double_sided: bool,
}

/// The lobes of [`MetallicRoughness`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Metallic {
    /// F = reflectance + edge · w.
    reflectance: Vec3,
    edge: Vec3,
    /// `T = passed − passed_edge · w`.
    passed: f32,
    passed_edge: f32,
    /// (1 − metallic)(1 − transmission) base/T̄, times `DIFFUSE_SHARE`.
    diffuse: Vec3,
    /// (1 − metallic) transmission base.
    transmission: Vec3,
    /// Largest channels of `reflectance`, `edge`, `diffuse` T̄ and `transmission`.
    strengths: [f32; 4],
    surface: Option<Ggx>,
    double_sided: bool,
}

impl Metallic {
    #[inline]
    pub(super) fn new(p: &MetallicRoughness) -> Self {
        let n = (p.ior - 1.0) / (p.ior + 1.0);
        let f0 = (n * n * p.specular_color).min(Vec3::ONE) * p.specular;
        let (metal, dielectric) = (p.metallic, 1.0 - p.metallic);
        let reflectance = metal * p.base_color + dielectric * f0;
        let edge = metal * (1.0 - p.base_color) + dielectric * (p.specular - f0);
        let passed = 1.0 - f0.max_element();
        let passed_edge = p.specular - f0.max_element();
        let mean = passed - passed_edge * MEAN_SCHLICK;
        let below = dielectric * (1.0 - p.transmission) * p.base_color;
        let diffuse = if mean > 0.0 { DIFFUSE_SHARE * below / mean } else { Vec3::ZERO };
        let transmission = dielectric * p.transmission * p.base_color;
        Self {
            reflectance,
            edge,
            passed,
            passed_edge,
            diffuse,
            transmission,
            strengths: [
                reflectance.max_element(),
                edge.max_element(),
                diffuse.max_element() * mean,
                transmission.max_element(),
            ],
            surface: Ggx::new(Vec2::splat(p.roughness * p.roughness)),
            double_sided: p.double_sided,
        }
    }

    /// Whether `wo` sees nothing but black.
    #[inline]
    fn hidden(&self, wo: Vec3) -> bool {
        !self.double_sided && wo.z <= 0.0
    }

    /// F at a cosine.
    #[inline]
    fn specular(&self, c: f32) -> Vec3 {
        self.reflectance + self.edge * fresnel::schlick_weight(c)
    }

    /// T at a cosine.
    #[inline]
    fn passed(&self, c: f32) -> f32 {
        self.passed - self.passed_edge * fresnel::schlick_weight(c)
    }

    #[inline]
    fn probabilities(&self, wo: Vec3) -> [f32; 3] {
        let w = fresnel::schlick_weight(wo.z.abs());
        let passed = self.passed - self.passed_edge * w;
        let [reflectance, edge, diffuse, transmission] = self.strengths;
        let specular = reflectance + edge * w.max(LEAST_SCHLICK);
        let diffuse = diffuse * passed;
        let transmission = transmission * passed.max(LEAST_TRANSMITTANCE);
        let sum = specular + diffuse + transmission;
        if sum > 0.0 {
            let scale = 1.0 / sum;
            [specular * scale, diffuse * scale, transmission * scale]
        } else {
            [1.0, 0.0, 0.0]
        }
    }
}

impl Lobes for Metallic {
    fn transmits(&self) -> bool {
        self.transmission != Vec3::ZERO
    }

    #[inline]
    fn count(&self) -> u32 {
        3
    }

    #[inline]
    fn is_delta(&self, lobe: u32) -> bool {
        lobe != 1 && self.surface.is_none()
    }

    #[inline]
    fn is_black(&self) -> bool {
        self.strengths == [0.0; 4]
    }

    #[inline]
    fn has_non_delta(&self) -> bool {
        self.surface.is_some() || self.strengths[2] > 0.0
    }

    #[inline]
    fn probability(&self, lobe: u32, wo: Vec3) -> f32 {
        self.probabilities(wo).get(lobe as usize).copied().unwrap_or(0.0)
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        let side = wo.z * wi.z;
        if self.hidden(wo) || side == 0.0 || lobes & 7 == 0 {
            return Evaluation::ZERO;
        }
        let probabilities = self.probabilities(wo);
        let (wo, wi) = mirror_to_front(wo, wi);
        let mut sum = Evaluation::ZERO;
        if side < 0.0 {
            if let Some(ggx) = self.surface
                && select(lobes, 2)
                && probabilities[2] > 0.0
            {
                let wi = Vec3::new(wi.x, wi.y, -wi.z);
                let Some(h) = half_vector(wo, wi) else { return sum };
                let (pdf, value) = ggx.reflection(wo, wi, h);
                sum.value = self.transmission * (self.passed(wo.dot(h)) * value);
                sum.pdf = probabilities[2] * pdf;
            }
            return sum;
        }
        if select(lobes, 1) {
            let cosine = wi.z * FRAC_1_PI;
            sum.value = self.diffuse * (self.passed(wo.z) * self.passed(wi.z) * cosine);
            sum.pdf = probabilities[1] * cosine;
        }
        if let Some(ggx) = self.surface
            && select(lobes, 0)
            && let Some(h) = half_vector(wo, wi)
        {
            let (pdf, value) = ggx.reflection(wo, wi, h);
            sum.value += self.specular(wo.dot(h)) * value;
            sum.pdf += probabilities[0] * pdf;
        }
        sum
    }

    #[inline]
    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        if self.hidden(wo) {
            return None;
        }
        let wi = if lobe == 1 {
            sample_cosine_hemisphere(u)
        } else {
            let (front, _) = mirror_to_front(wo, wo);
            reflect(front, self.surface?.sample_visible(front, u))
        };
        let side = if lobe == 2 { -wo.z } else { wo.z };
        (wi.z > 0.0).then(|| Vec3::new(wi.x, wi.y, wi.z.copysign(side)))
    }

    #[inline]
    fn delta(&self, lobe: u32, wo: Vec3) -> Option<DeltaSample> {
        if self.hidden(wo) {
            return None;
        }
        let probabilities = self.probabilities(wo);
        let cosine = wo.z.abs();
        Some(if lobe == 0 {
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            let pdf = probabilities[0];
            DeltaSample { wi, value: self.specular(cosine), pdf, eta: 1.0 }
        } else {
            let value = self.transmission * self.passed(cosine);
            DeltaSample { wi: -wo, value, pdf: probabilities[2], eta: 1.0 }
        })
    }

    #[inline]
    fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        if lobe == 1 {
            return Some(invert_cosine_hemisphere(wi));
        }
        let (wo, wi) = mirror_to_front(wo, wi);
        let wi = Vec3::new(wi.x, wi.y, wi.z.abs());
        Some(self.surface?.invert_visible(wo, half_vector(wo, wi)?))
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        let mean = self.passed - self.passed_edge * MEAN_SCHLICK;
        self.reflectance + self.passed * mean * self.diffuse + self.passed * self.transmission
    }

    #[inline]
    fn roughness(&self, lobe: u32) -> f32 {
        if lobe == 1 { 1.0 } else { self.surface.map_or(0.0, |ggx| ggx.min_alpha()) }
    }
}
