//! The walk in steps: what every path is made of, whoever wants it.
//!
//! | step | draws | gives |
//! |---|---|---|
//! | [`Vertex::at`] | nothing | a surface that scatters, with the direction back along the path |
//! | [`Steps::light`] | light, its place | [`LightSample`]: a light that is seen, weighted against BSDF sampling |
//! | [`Steps::scatter`] | lobe, direction | a direction; f/p is its factor |
//! | [`survival`] | – | the chance that Russian roulette leaves |
//! | [`Steps::onward`] | nothing | the next hit: one ray |
//! | [`Steps::ending`], [`Steps::skies`] | nothing | [`Ending`]: emission that a direction found, weighted against light sampling |
//!
//! [`walk`] takes them in turn and tells a [`Visitor`] what it meets. Who goes only a part of the
//! way, or another way, takes the steps by itself: the numbers are those of (seed, vertex, block),
//! whatever was asked before.

use glam::{Vec2, Vec3};

use super::{Limits, power_heuristic, sampled, shadow_ray};
use crate::accel::{Hit, HitFilter, HitPoint, Ray};
use crate::counters::Counters;
use crate::light::{Incident, NO_LIGHT};
use crate::math::rng::{
    BLOCK_LIGHT, BLOCK_LIGHTS, BLOCK_ROULETTE, BLOCK_SCATTER, draw4, unit_float,
};
use crate::surface::SurfacePoint;
use crate::surface::bsdf::{BsdfSample, Evaluation};
use crate::world::World;

/// A vertex of a path: a surface and the direction that the path came from.
#[derive(Debug)]
pub struct Vertex {
    /// The surface.
    pub surface: SurfacePoint,
    /// Unit direction to the vertex before, in the surface's local frame.
    pub outgoing: Vec3,
}

impl Vertex {
    /// The surface at a hit by a ray along unit `direction`.
    #[inline(always)]
    #[must_use]
    pub fn at(world: &World, hit: &Hit, point: &HitPoint, direction: Vec3) -> Self {
        // In place: a surface that is made first and moved here costs a copy a vertex.
        let mut vertex = Self { surface: world.surface_at(hit, point), outgoing: Vec3::ZERO };
        vertex.outgoing = vertex.surface.frame.to_local(-direction);
        vertex
    }

    /// As [`Vertex::at`]; `None` where the surface scatters nothing.
    #[inline]
    #[must_use]
    pub fn new(world: &World, hit: &Hit, point: &HitPoint, direction: Vec3) -> Option<Self> {
        let vertex = Self::at(world, hit, point, direction);
        (!vertex.surface.bsdf.is_black()).then_some(vertex)
    }
}

/// A light that a vertex sampled and sees.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Its number.
    pub light: u32,
    /// The numbers on it.
    pub u: Vec2,
    /// What it sends.
    pub incident: Incident,
    /// What the vertex makes of that direction: all lobes that are not deltas.
    pub scattered: Evaluation,
    /// p ℓ: density per unit solid angle of light sampling, choice included; of a delta light the
    /// probability of its choice.
    pub density: f32,
    /// ω: the share of light sampling in the pair of techniques; 1 for delta lights.
    pub share: f32,
}

impl LightSample {
    /// L f \|cos θ\| ω / p ℓ.
    #[inline(always)]
    #[must_use]
    pub fn contribution(&self) -> Vec3 {
        self.incident.radiance * self.scattered.value * (self.share / self.density)
    }
}

/// Emission that BSDF sampling found at the end of a segment.
#[derive(Clone, Copy, Debug)]
pub struct Ending {
    /// The emitter's number.
    pub light: u32,
    /// L towards the vertex before.
    pub emission: Vec3,
    /// p ℓ of light sampling at the vertex before, choice included; 0 where it does not take part.
    pub density: f32,
    /// ω: the share of BSDF sampling; 1 after a delta lobe.
    pub share: f32,
}

/// What a walk meets. Throughput is the product of f/p and of 1/q of all roulette so far.
///
/// Vertices are numbered from 0, the primary hit.
pub trait Visitor {
    /// A vertex that scatters.
    #[inline(always)]
    fn vertex(&mut self, _number: u32, _at: &Vertex, _hit: &Hit, _point: &HitPoint) {}

    /// A light that the vertex sees; [`LightSample::contribution`] with the throughput is the
    /// light of a path that ends there.
    fn light(&mut self, number: u32, at: &Vertex, throughput: Vec3, sample: &LightSample);

    /// Whether the path is followed along a sample; asked before [`Visitor::scatter`].
    #[inline(always)]
    fn follows(&self, _number: u32, _sample: &BsdfSample) -> bool {
        true
    }

    /// The direction that the vertex scatters into; `direction` is the sample's in world space.
    #[inline(always)]
    fn scatter(&mut self, _number: u32, _at: &Vertex, _sample: &BsdfSample, _direction: Vec3) {}

    /// The path goes on with probability `survival`.
    #[inline(always)]
    fn survive(&mut self, _survival: f32) {}

    /// An emitter that the direction meets at a hit.
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Ending, hit: &Hit, at: &HitPoint);

    /// A sky that the direction leaves to.
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Ending, direction: Vec3);
}

/// The sum of all light of a path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sum(pub Vec3);

impl Visitor for Sum {
    #[inline(always)]
    fn light(&mut self, _: u32, _: &Vertex, throughput: Vec3, sample: &LightSample) {
        self.0 += throughput * sample.contribution();
    }

    #[inline(always)]
    fn emitter(&mut self, _: u32, throughput: Vec3, end: &Ending, _: &Hit, _: &HitPoint) {
        self.0 += throughput * end.emission * end.share;
    }

    #[inline(always)]
    fn sky(&mut self, _: u32, throughput: Vec3, end: &Ending, _: Vec3) {
        self.0 += throughput * end.emission * end.share;
    }
}

/// A visitor that sums light.
pub trait Total: Visitor + Default {
    /// The sum.
    fn total(&self) -> Vec3;
}

impl Total for Sum {
    #[inline(always)]
    fn total(&self) -> Vec3 {
        self.0
    }
}

/// The steps of paths in one world, which sample `LIGHTS` (of [`sampled`]) at a vertex.
#[derive(Debug)]
pub struct Steps<'a, const LIGHTS: u8, F> {
    /// Where.
    pub world: &'a World,
    /// Which hits count.
    pub filter: &'a F,
}

impl<const LIGHTS: u8, F: HitFilter> Steps<'_, LIGHTS, F> {
    /// The light that vertex `number` of a seed samples by power, if it is seen and scattered.
    #[inline(always)]
    pub fn light(
        &self,
        at: &Vertex,
        (seed, number): (u64, u32),
        counters: &mut Counters,
    ) -> Option<LightSample> {
        let words = draw4(seed, number, BLOCK_LIGHT);
        let light = self.world.lights.choose(words[0], words[1]);
        let choice = self.world.lights.choice_probability(light);
        self.lit(at, (light, choice), [words[2], words[3]], counters)
    }

    /// As [`Steps::light`], with a light of one's own choice.
    #[inline(always)]
    fn lit(
        &self,
        at: &Vertex,
        (light, choice): (u32, f32),
        words: [u32; 2],
        counters: &mut Counters,
    ) -> Option<LightSample> {
        let Self { world, filter } = self;
        let Vertex { surface, outgoing } = at;
        let u = Vec2::from(words.map(unit_float));
        let Some(incident) = world.lights.sample_towards(&world.scene, light, surface.position, u)
        else {
            counters.shadow_rays_saved += 1;
            return None;
        };
        let scattered =
            surface.bsdf.evaluate(*outgoing, surface.frame.to_local(incident.direction));
        if scattered.value == Vec3::ZERO {
            counters.shadow_rays_saved += 1;
            return None;
        }
        counters.shadow_rays += 1;
        let ray = shadow_ray(surface, incident.direction, incident.end);
        if world.accel.occluded(&ray, *filter) {
            return None;
        }
        let density = choice * incident.pdf;
        let share = if incident.delta { 1.0 } else { power_heuristic(density, scattered.pdf) };
        Some(LightSample { light, u, incident, scattered, density, share })
    }

    /// The direction that vertex `number` of a seed scatters into.
    #[inline(always)]
    #[must_use]
    pub fn scatter(&self, at: &Vertex, (seed, number): (u64, u32)) -> Option<BsdfSample> {
        at.surface.bsdf.sample(at.outgoing, draw4(seed, number, BLOCK_SCATTER))
    }

    /// The nearest surface along unit `direction` from a vertex: one ray.
    #[inline(always)]
    pub fn onward(&self, at: &Vertex, direction: Vec3, counters: &mut Counters) -> Option<Hit> {
        let origin = at.surface.origin(direction);
        counters.bounce_rays += 1;
        let ray = Ray { origin, direction, t_max: f32::INFINITY };
        self.world.accel.closest_hit(&ray, self.filter)
    }

    /// Density of light sampling, choice included, and the share of BSDF sampling beside it, whose
    /// density is `scattered`.
    #[inline(always)]
    fn weighed(&self, scattered: Option<f32>, light: u32, pdf: impl FnOnce() -> f32) -> (f32, f32) {
        let Some(scattered) = scattered.filter(|_| LIGHTS != sampled::NONE) else {
            return (0.0, 1.0);
        };
        let density = if LIGHTS == sampled::ONE {
            self.world.lights.choice_probability(light) * pdf()
        } else {
            pdf()
        };
        (density, power_heuristic(scattered, density))
    }

    /// The emission of light number `light` that a direction met at `point`; `None` where there is
    /// none. `scattered` is the density of BSDF sampling there ([`BsdfSample::beside_lights`]).
    #[inline(always)]
    #[must_use]
    pub fn ending(
        &self,
        from: &Vertex,
        scattered: Option<f32>,
        direction: Vec3,
        light: u32,
        point: &HitPoint,
    ) -> Option<Ending> {
        let lights = &self.world.lights;
        let cos_light = -direction.dot(point.geometric_normal);
        let emission = lights.emitted(&self.world.scene, light, point.uv, cos_light);
        if emission == Vec3::ZERO {
            return None;
        }
        let pdf = || lights.pdf_towards(light, from.surface.position, point.position, cos_light);
        let (density, share) = self.weighed(scattered, light, pdf);
        Some(Ending { light, emission, density, share })
    }

    /// The light of each sky along a direction, with `scattered` as for [`Steps::ending`].
    #[inline(always)]
    pub fn skies(&self, scattered: Option<f32>, direction: Vec3) -> impl Iterator<Item = Ending> {
        self.world.lights.environments().map(move |(light, environment)| {
            let (density, share) = self.weighed(scattered, light, || environment.pdf(direction));
            Ending { light, emission: environment.radiance(direction), density, share }
        })
    }
}

/// The chance that Russian roulette leaves a path of this throughput. Refraction squeezes radiance
/// by η²; the path's importance is not less for it.
#[inline(always)]
#[must_use]
pub fn survival(throughput: Vec3, eta_scale: f32) -> f32 {
    (throughput.max_element() * eta_scale).min(0.95)
}

/// Follows the path of a seed from a primary hit, which a ray along the unit direction
/// `primary.0` met, and tells `visitor` of everything that a path of 2 to `limits.depth` segments
/// may end with.
///
/// Without `DIRECT`, light that comes straight to the primary hit and leaves it by a lobe that is
/// not a delta is left out.
#[inline(always)]
pub fn walk<const LIGHTS: u8, const DIRECT: bool, F: HitFilter>(
    steps: &Steps<'_, LIGHTS, F>,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    visitor: &mut impl Visitor,
    counters: &mut Counters,
) {
    counters.paths += 1;
    walk_from::<LIGHTS, DIRECT, F>(steps, (seed, 0), primary, limits, visitor, counters);
}

/// Does what [`walk`] does from vertex number `first` on, which a ray along the unit direction
/// `at.0` met at the hit `at.1`; throughput begins with 1 there. What the hit itself emits is not
/// asked.
#[inline(always)]
pub fn walk_from<const LIGHTS: u8, const DIRECT: bool, F: HitFilter>(
    steps: &Steps<'_, LIGHTS, F>,
    (seed, first): (u64, u32),
    at: (Vec3, &Hit),
    limits: Limits,
    visitor: &mut impl Visitor,
    counters: &mut Counters,
) {
    let world = steps.world;
    let mut throughput = Vec3::ONE;
    let mut eta_scale = 1.0_f32;
    let mut direction = at.0;
    let mut hit = *at.1;
    let mut point = world.accel.point(&hit);
    for number in first..limits.depth.saturating_sub(1) {
        let vertex = Vertex::at(world, &hit, &point, direction);
        if vertex.surface.bsdf.is_black() {
            break;
        }
        visitor.vertex(number, &vertex, &hit, &point);
        let counted = DIRECT || number > 0;
        if counted && vertex.surface.bsdf.has_non_delta() && !world.lights.is_empty() {
            if LIGHTS == sampled::ONE {
                if let Some(sample) = steps.light(&vertex, (seed, number), counters) {
                    visitor.light(number, &vertex, throughput, &sample);
                }
            } else if LIGHTS == sampled::ALL {
                for light in 0..world.lights.len() as u32 {
                    if world.lights.choice_probability(light) > 0.0 {
                        let [x, y, ..] = draw4(seed, number, BLOCK_LIGHTS | light);
                        if let Some(sample) = steps.lit(&vertex, (light, 1.0), [x, y], counters) {
                            visitor.light(number, &vertex, throughput, &sample);
                        }
                    }
                }
            }
        }

        let Some(sample) = steps.scatter(&vertex, (seed, number)) else { break };
        if !visitor.follows(number, &sample) {
            break;
        }
        let last = number + 2 == limits.depth;
        // Whether emission at the end of this segment belongs to the estimate.
        let counted = counted || sample.delta;
        if last && !counted {
            break;
        }
        throughput *= sample.value / sample.pdf;
        if sample.transmission {
            eta_scale *= sample.eta * sample.eta;
        }
        if throughput == Vec3::ZERO {
            break;
        }
        direction = vertex.surface.frame.to_world(sample.wi).normalize();
        visitor.scatter(number, &vertex, &sample, direction);
        if number >= limits.roulette_after {
            let survival = survival(throughput, eta_scale);
            if unit_float(draw4(seed, number, BLOCK_ROULETTE)[0]) >= survival {
                break;
            }
            throughput /= survival;
            visitor.survive(survival);
        }

        let Some(next) = steps.onward(&vertex, direction, counters) else {
            if counted {
                for end in steps.skies(sample.beside_lights(), direction) {
                    visitor.sky(number, throughput, &end, direction);
                }
            }
            break;
        };
        let (shape, element) = world.accel.shape_of(&next);
        let light = world.lights.of_surface(shape, element);
        if last && light == NO_LIGHT {
            break;
        }
        hit = next;
        point = world.accel.point(&next);
        if light != NO_LIGHT
            && counted
            && let Some(end) =
                steps.ending(&vertex, sample.beside_lights(), direction, light, &point)
        {
            visitor.emitter(number, throughput, &end, &hit, &point);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Radiance is η² as dense in glass, and roulette must not take that for light: at η = 1.5 a
    /// path of throughput 0.4 outside has 0.4 / 2.25 inside, and lives as long.
    #[test]
    fn roulette_does_not_see_refraction() {
        let (outside, eta) = (Vec3::new(0.4, 0.2, 0.1), 1.5_f32);
        let inside = outside / (eta * eta);
        assert_eq!(survival(outside, 1.0), 0.4);
        assert!((survival(inside, eta * eta) - 0.4).abs() < 1e-6);
        assert_eq!(survival(Vec3::splat(9.0), 1.0), 0.95);
    }
}
