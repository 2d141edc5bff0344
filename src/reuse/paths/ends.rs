//! What vertices make of the lights, emitters and directions that follow them.

use glam::Vec3;

use super::failure::Failure;
use super::{Ending, NO_LOBE};
use crate::accel::HitPoint;
use crate::light::{Arrival, LightPoint, NO_LIGHT};
use crate::math::offset_origin;
use crate::path::{Vertex, power_heuristic};
use crate::surface::bsdf::Evaluation;
use crate::world::World;

/// A direction, and the point where a ray along it ends; `None`: at infinity.
pub(super) type Sight = (Vec3, Option<Vec3>);

/// Where a ray along `direction` to a point ends: off its surface.
#[inline]
pub(super) fn end_at(point: &HitPoint, direction: Vec3) -> Vec3 {
    let normal = point.geometric_normal;
    let side = 1.0_f32.copysign(-direction.dot(normal));
    offset_origin(point.position, normal * side, point.error)
}

/// An emitter that a direction met.
pub(super) struct Met {
    /// L.
    pub(super) emission: Vec3,
    /// p ℓ at the vertex before.
    pub(super) density: f32,
}

impl Met {
    /// The emitter at a point, seen from `from` along `direction`.
    #[inline]
    pub(super) fn new(
        world: &World,
        from: Vec3,
        direction: Vec3,
        point: &HitPoint,
    ) -> Result<Self, Failure> {
        let lights = &world.lights;
        let light = lights.of_surface(point.shape, point.element);
        if light == NO_LIGHT {
            return Err(Failure::LightGone);
        }
        let cosine = -direction.dot(point.geometric_normal);
        let emission = lights.emitted(&world.scene, light, point.uv, cosine);
        if emission == Vec3::ZERO {
            return Err(Failure::Back);
        }
        let pdf = lights.pdf_towards(light, from, point.position, cosine);
        Ok(Self { emission, density: lights.choice_probability(light) * pdf })
    }
}

/// How a vertex is left, as far as ω asks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Leaves {
    /// To a light that it samples.
    Sampling {
        /// Whether ω is 1.
        delta: bool,
    },
    /// To the path's end.
    Last,
    /// To another vertex.
    Between,
}

impl Leaves {
    #[inline]
    pub(super) fn new(samples_light: bool, ending: Ending, last: bool) -> Self {
        match (samples_light, last) {
            (true, _) => Self::Sampling { delta: ending == Ending::Light { delta: true } },
            (false, true) => Self::Last,
            (false, false) => Self::Between,
        }
    }

    /// What a vertex makes of what arrives from there: f/p̄ ω L, or f/pℓ ω L.
    #[inline]
    pub(super) fn made_of(self, there: &Evaluation, radiance: Vec3, light_density: f32) -> Vec3 {
        match self {
            Self::Sampling { delta } => {
                let share = if delta { 1.0 } else { power_heuristic(light_density, there.pdf) };
                there.value * radiance * (share / light_density)
            }
            Self::Last => {
                let share = power_heuristic(there.pdf, light_density);
                there.value / there.pdf * radiance * share
            }
            Self::Between => there.value / there.pdf * radiance,
        }
    }
}

/// The lobes of `x_r` in the direction onward.
#[derive(Clone, Copy)]
pub(super) struct Onward {
    /// All lobes.
    pub(super) total: Evaluation,
    /// Joint density with `ℓ_r`; 1 where a light is sampled.
    pub(super) joint: f32,
}

/// The lobes of a vertex in a direction onward, which is taken by `lobe`, or by all for a light
/// sample.
#[inline]
pub(super) fn onward_from(at: &Vertex, lobe: u8, direction: Vec3) -> Result<Onward, Failure> {
    let bsdf = &at.surface.bsdf;
    let wi = at.surface.frame.to_local(direction);
    let onward = if lobe == NO_LOBE {
        Onward { total: bsdf.evaluate(at.outgoing, wi), joint: 1.0 }
    } else {
        let (total, joint) = bsdf.evaluate_with_lobe(lobe.into(), at.outgoing, wi);
        Onward { total, joint }
    };
    let lost = onward.joint <= 0.0 || onward.total.value == Vec3::ZERO;
    if lost { Err(Failure::Back) } else { Ok(onward) }
}

/// A light point as a vertex samples it.
pub(super) struct LightEnd {
    /// What arrives; its geometry is 0 for lights that no direction meets.
    pub(super) arrival: Arrival,
    /// Density of light sampling at the vertex, choice included, in the light's measure.
    pub(super) density: f32,
}

/// The light point as a vertex at `from` samples it; `None` where nothing arrives.
#[inline]
pub(super) fn light_end(world: &World, from: Vec3, point: LightPoint) -> Option<LightEnd> {
    let lights = &world.lights;
    let arrival = lights.emitter(&world.scene, point)?.towards(lights, from)?;
    let density = lights.density_towards(point, from, arrival.geometry);
    (density > 0.0).then_some(LightEnd { arrival, density })
}
