//! Lambert under a dielectric coat: an analytic plastic. Lobe 0 is the coat's reflection, lobe 1
//! the base.
//!
//! | symbol | meaning |
//! |---|---|
//! | η | index of the coat over that outside |
//! | E(μ) | what the coat's interface reflects of light from cosine μ; T = 1 − E |
//! | Ē, T̄ | their means over the hemisphere, ∫ · 2μ dμ |
//! | ρ | albedo of the base |
//!
//! base: f = ρ T(o) T(i)/(π η² (1 − ρ F̄)), where F̄ = 1 − T̄/η² is what the interface sends back
//! of the diffuse light inside. This is the "nonlinear" rough plastic of Mitsuba 3 (light is
//! coloured at every inner bounce), with two differences: E has height-correlated masking, and F̄
//! follows from Ē by energy conservation instead of a second integral (equal for a smooth coat), so
//! that ρ = 1 scatters all that E leaves. For different roughness along the tangents E is that of
//! `√(α_x α_y)`.
//!
//! pbrt-v4's `coateddiffuse` walks randomly through the layer instead; its absorbing or scattering
//! medium is not modelled here.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::ggx::{Ggx, half_vector, reflect};
use super::interface::RoughReflectance;
use super::{DeltaSample, Evaluation, Lobes, fresnel, mirror_to_front, select};
use crate::math::warp::{invert_cosine_hemisphere, sample_cosine_hemisphere};

/// A coat over a diffuse base.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coated {
    /// ρ/(η² (1 − ρ F̄)).
    base: Vec3,
    /// Largest channel of the base's reflection of light inside: base · T̄.
    base_strength: f32,
    eta: f32,
    coat: Coat,
}

#[derive(Clone, Copy, Debug)]
enum Coat {
    Smooth,
    Rough(Ggx, RoughReflectance),
}

/// The isotropic α whose table a coat is read from; 0 where it is smooth.
#[cfg(feature = "gpu")]
pub(crate) fn coat_alpha(alpha: Vec2) -> f32 {
    Ggx::new(alpha).map_or(0.0, |ggx| ggx.mean_alpha())
}

impl Coated {
    pub(super) fn new(reflectance: Vec3, eta: f32, alpha: Vec2) -> Self {
        // A coat is denser than what surrounds it.
        let eta = eta.max(1.0);
        let (coat, rough) = match Ggx::new(alpha) {
            Some(ggx) => {
                let rough = RoughReflectance::new(ggx.mean_alpha(), eta);
                (Coat::Rough(ggx, rough), rough)
            }
            None => (Coat::Smooth, RoughReflectance::new(0.0, eta)),
        };
        let passed = 1.0 - rough.mean();
        let inside = 1.0 - passed / (eta * eta);
        let base = reflectance / (eta * eta * (1.0 - reflectance * inside));
        Self { base, base_strength: base.max_element() * passed, eta, coat }
    }

    /// E(μ).
    #[inline]
    fn reflected(&self, mu: f32) -> f32 {
        match self.coat {
            Coat::Smooth => fresnel::dielectric(mu, self.eta),
            Coat::Rough(_, rough) => rough.at(mu),
        }
    }

    /// Probability of the coat, given E(o): its share of all that is reflected.
    #[inline]
    fn coat_probability(&self, reflected: f32) -> f32 {
        let base = (1.0 - reflected) * self.base_strength;
        if base > 0.0 { reflected / (reflected + base) } else { 1.0 }
    }
}

impl Lobes for Coated {
    #[inline]
    fn count(&self) -> u32 {
        2
    }

    #[inline]
    fn is_delta(&self, lobe: u32) -> bool {
        lobe == 0 && matches!(self.coat, Coat::Smooth)
    }

    #[inline]
    fn is_black(&self) -> bool {
        self.base == Vec3::ZERO && self.eta == 1.0
    }

    #[inline]
    fn probability(&self, lobe: u32, wo: Vec3) -> f32 {
        let coat = self.coat_probability(self.reflected(wo.z.abs()));
        if lobe == 0 { coat } else { 1.0 - coat }
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        if !(wo.z * wi.z > 0.0 && lobes & 3 != 0) {
            return Evaluation::ZERO;
        }
        let (wo, wi) = mirror_to_front(wo, wi);
        let reflected = self.reflected(wo.z);
        let coat_probability = self.coat_probability(reflected);
        let mut sum = Evaluation::ZERO;
        if select(lobes, 1) {
            let cosine = wi.z * FRAC_1_PI;
            let passed = (1.0 - reflected) * (1.0 - self.reflected(wi.z));
            sum.value = self.base * (passed * cosine);
            sum.pdf = (1.0 - coat_probability) * cosine;
        }
        if let Coat::Rough(ggx, _) = self.coat
            && select(lobes, 0)
            && let Some(h) = half_vector(wo, wi)
        {
            let (pdf, value) = ggx.reflection(wo, wi, h);
            sum.value += value * fresnel::dielectric(wo.dot(h).min(1.0), self.eta);
            sum.pdf += coat_probability * pdf;
        }
        sum
    }

    #[inline]
    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let wi = match (lobe, self.coat) {
            (0, Coat::Rough(ggx, _)) => {
                let (front, _) = mirror_to_front(wo, wo);
                reflect(front, ggx.sample_visible(front, u))
            }
            (0, Coat::Smooth) => return None,
            _ => sample_cosine_hemisphere(u),
        };
        (wi.z > 0.0).then(|| Vec3::new(wi.x, wi.y, wi.z.copysign(wo.z)))
    }

    #[inline]
    fn delta(&self, _: u32, wo: Vec3) -> Option<DeltaSample> {
        let f = self.reflected(wo.z.abs());
        let wi = Vec3::new(-wo.x, -wo.y, wo.z);
        Some(DeltaSample { wi, value: Vec3::splat(f), pdf: self.coat_probability(f), eta: 1.0 })
    }

    #[inline]
    fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        let (wo, wi) = mirror_to_front(wo, wi);
        match (lobe, self.coat) {
            (0, Coat::Rough(ggx, _)) => Some(ggx.invert_visible(wo, half_vector(wo, wi)?)),
            (0, Coat::Smooth) => None,
            _ => Some(invert_cosine_hemisphere(wi)),
        }
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        let reflected = self.reflected(1.0);
        let passed = self.base_strength / self.base.max_element().max(f32::MIN_POSITIVE);
        Vec3::splat(reflected) + (1.0 - reflected) * passed * self.base
    }

    #[inline]
    fn roughness(&self, lobe: u32) -> f32 {
        match self.coat {
            _ if lobe == 1 => 1.0,
            Coat::Smooth => 0.0,
            Coat::Rough(ggx, _) => ggx.min_alpha(),
        }
    }
}
