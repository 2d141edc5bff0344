//! Glass: interfaces that reflect (lobe 0) and refract (lobe 1), rough, smooth or as a thin pane.
//!
//! | symbol | meaning |
//! |---|---|
//! | η | index of refraction at `wi` over that at `wo` for refracted light; the material's index where `wo` is outside (`o_z` > 0) |
//! | h | microfacet normal on the side of `wo`: o + i, or −(o + η i) turned to that side, normalised |
//! | F | reflectance of the interface at o·h |
//!
//! Refraction (Walter et al. 2007, equations 17 and 21, with radiance scaled by 1/η²):
//! `f |i_z| = (1 − F) D G₂ |i·h| (o·h)/(|o_z| (i·h + o·h/η)²)/η²`, density
//! `D G₁ (o·h)/|o_z| · |i·h|/(i·h + o·h/η)²`. G₂ has the form of correlated heights on both sides
//! of the surface (as in pbrt-v4; Heitz 2014 derives another one for refraction).

use glam::{Vec2, Vec3};

use super::ggx::{Ggx, half_vector, reflect};
use super::{DeltaSample, Evaluation, Lobes, fresnel, mirror_to_front, select};

/// An index this near to 1 bends light by less than 10⁻³ rad, and the microfacet normal of a nearly
/// straight path is lost to rounding: rough interfaces below it are treated as smooth ones.
const INDEX_MATCHED: f32 = 1e-3;

/// Least probability of either lobe: keeps the weight of a rarely chosen lobe below 20.
const LEAST_PROBABILITY: f32 = 0.05;

/// An interface between two media.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dielectric {
    /// Index of refraction, inside over outside.
    eta: f32,
    /// `None`: smooth.
    surface: Option<Ggx>,
}

impl Dielectric {
    #[inline]
    pub(super) fn new(eta: f32, alpha: Vec2) -> Self {
        let rough = (eta - 1.0).abs() >= INDEX_MATCHED;
        Self { eta, surface: if rough { Ggx::new(alpha) } else { None } }
    }

    /// Index beyond the surface over that on the side of `wo`.
    #[inline]
    fn relative(&self, wo: Vec3) -> f32 {
        if wo.z > 0.0 { self.eta } else { 1.0 / self.eta }
    }

    /// Probability of reflection; depends on `wo` only, so that a lobe's density is its own.
    #[inline]
    fn reflection_probability(&self, wo: Vec3) -> f32 {
        let (cosine, eta) = (wo.z.abs(), self.relative(wo));
        match self.surface {
            None => fresnel::dielectric(cosine, eta),
            Some(ggx) => {
                // F at two microfacets leaning to and fro by half of the roughness, as far as they
                // are seen.
                let lean = 0.5 * ggx.mean_alpha();
                let scale = 1.0 / (1.0 + lean * lean).sqrt();
                let sine = lean * (1.0 - cosine * cosine).max(0.0).sqrt();
                let near = (scale * (cosine + sine)).min(1.0);
                let far = (scale * (cosine - sine)).max(0.0);
                let seen =
                    near * fresnel::dielectric(near, eta) + far * fresnel::dielectric(far, eta);
                (seen / (near + far)).clamp(LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY)
            }
        }
    }
}

/// The refraction of `wo` at `h` (o·h > 0) into an index η times as large; not normalised against
/// rounding.
#[inline]
fn refract(wo: Vec3, h: Vec3, eta: f32) -> Option<Vec3> {
    let c = wo.dot(h);
    let t = fresnel::refracted_cosine(c, eta)?;
    Some((c / eta - t) * h - wo / eta)
}

impl Lobes for Dielectric {
    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn count(&self) -> u32 {
        2
    }

    #[inline]
    fn is_delta(&self, _: u32) -> bool {
        self.surface.is_none()
    }

    #[inline]
    fn is_black(&self) -> bool {
        false
    }

    #[inline]
    fn probability(&self, lobe: u32, wo: Vec3) -> f32 {
        let r = self.reflection_probability(wo);
        if lobe == 0 { r } else { 1.0 - r }
    }

    #[inline]
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        let Some(ggx) = self.surface else { return Evaluation::ZERO };
        let eta = self.relative(wo);
        let side = wo.z * wi.z;
        let (front_o, front_i) = mirror_to_front(wo, wi);
        if side > 0.0 && select(lobes, 0) {
            let Some(h) = half_vector(front_o, front_i) else { return Evaluation::ZERO };
            let (pdf, value) = ggx.reflection(front_o, front_i, h);
            let f = fresnel::dielectric(front_o.dot(h).min(1.0), eta);
            let probability = self.reflection_probability(wo);
            Evaluation { value: Vec3::splat(f * value), pdf: probability * pdf }
        } else if side < 0.0 && select(lobes, 1) {
            let Some(h) = half_vector(front_o, front_i * eta) else { return Evaluation::ZERO };
            let h = if h.z < 0.0 { -h } else { h };
            let (oh, ih) = (front_o.dot(h), front_i.dot(h));
            // Microfacets that either direction sees from behind do not refract.
            if !(oh > 0.0 && ih < 0.0) {
                return Evaluation::ZERO;
            }
            let root = ih + oh / eta;
            let jacobian = -ih / (root * root);
            // The forms of `Ggx::reflection`, times 4 o·h |dh/di| with i mirrored to the front for
            // the masking.
            let (pdf, value) =
                ggx.reflection(front_o, Vec3::new(front_i.x, front_i.y, -front_i.z), h);
            let refracted = 4.0 * oh * jacobian;
            let f = fresnel::dielectric(oh.min(1.0), eta);
            let probability = 1.0 - self.reflection_probability(wo);
            Evaluation {
                value: Vec3::splat((1.0 - f) * value * refracted / (eta * eta)),
                pdf: probability * pdf * refracted,
            }
        } else {
            Evaluation::ZERO
        }
    }

    #[inline]
    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let ggx = self.surface?;
        let (front, _) = mirror_to_front(wo, wo);
        let h = ggx.sample_visible(front, u);
        let side = 1.0_f32.copysign(wo.z);
        let wi = if lobe == 0 {
            let wi = reflect(front, h);
            (wi.z > 0.0).then_some(wi)?
        } else {
            let wi = refract(front, h, self.relative(wo))?.normalize();
            (wi.z < 0.0).then_some(wi)?
        };
        Some(Vec3::new(wi.x, wi.y, wi.z * side))
    }

    #[inline]
    fn delta(&self, lobe: u32, wo: Vec3) -> Option<DeltaSample> {
        let f = self.reflection_probability(wo);
        if lobe == 0 {
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            return Some(DeltaSample { wi, value: Vec3::splat(f), pdf: f, eta: 1.0 });
        }
        let eta = self.relative(wo);
        let (front, _) = mirror_to_front(wo, wo);
        let wi = refract(front, Vec3::Z, eta)?.normalize();
        let value = Vec3::splat((1.0 - f) / (eta * eta));
        let wi = Vec3::new(wi.x, wi.y, wi.z * 1.0_f32.copysign(wo.z));
        Some(DeltaSample { wi, value, pdf: 1.0 - f, eta })
    }

    #[inline]
    fn eta(&self, lobe: u32, wo: Vec3) -> f32 {
        if lobe == 0 { 1.0 } else { self.relative(wo) }
    }

    #[inline]
    fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        let ggx = self.surface?;
        let (front_o, front_i) = mirror_to_front(wo, wi);
        let eta = if lobe == 0 { 1.0 } else { self.relative(wo) };
        let h = half_vector(front_o, front_i * eta)?;
        Some(ggx.invert_visible(front_o, if h.z < 0.0 { -h } else { h }))
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        Vec3::ONE
    }

    #[inline]
    fn roughness(&self, _lobe: u32) -> f32 {
        self.surface.map_or(0.0, |ggx| ggx.min_alpha())
    }
}

/// A pane without thickness: mirrored with R' = 2R/(1 + R) (lobe 0) or straight through with 1 − R'
/// (lobe 1), all inner reflections summed.
#[derive(Clone, Copy, Debug)]
pub(super) struct ThinDielectric {
    /// Index of refraction of the pane.
    pub(super) eta: f32,
}

impl ThinDielectric {
    #[inline]
    fn reflectance(&self, wo: Vec3) -> f32 {
        let r = fresnel::dielectric(wo.z.abs(), self.eta);
        2.0 * r / (1.0 + r)
    }
}

impl Lobes for ThinDielectric {
    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn count(&self) -> u32 {
        2
    }

    #[inline]
    fn is_delta(&self, _: u32) -> bool {
        true
    }

    #[inline]
    fn is_black(&self) -> bool {
        false
    }

    #[inline]
    fn probability(&self, lobe: u32, wo: Vec3) -> f32 {
        let r = self.reflectance(wo);
        if lobe == 0 { r } else { 1.0 - r }
    }

    #[inline]
    fn evaluate(&self, _: Vec3, _: Vec3, _: u32) -> Evaluation {
        Evaluation::ZERO
    }

    #[inline]
    fn direction(&self, _: u32, _: Vec3, _: Vec2) -> Option<Vec3> {
        None
    }

    #[inline]
    fn delta(&self, lobe: u32, wo: Vec3) -> Option<DeltaSample> {
        let pdf = self.probability(lobe, wo);
        let wi = if lobe == 0 { Vec3::new(-wo.x, -wo.y, wo.z) } else { -wo };
        Some(DeltaSample { wi, value: Vec3::splat(pdf), pdf, eta: 1.0 })
    }

    #[inline]
    fn invert(&self, _: u32, _: Vec3, _: Vec3) -> Option<Vec2> {
        None
    }

    #[inline]
    fn albedo(&self) -> Vec3 {
        Vec3::ONE
    }

    #[inline]
    fn roughness(&self, _lobe: u32) -> f32 {
        0.0
    }
}
