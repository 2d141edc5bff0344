//! Paths from the camera: the walk that every technique without reuse is made of, and that others
//! take their candidates from.
//!
//! | here | meaning |
//! |---|---|
//! | vertex 0 | the primary hit |
//! | segment | an edge of the path; the primary ray is the first, so direct light has two |
//! | `depth` | most segments a path may have |
//! | p̂ ℓ, `p_b` | density per unit solid angle of light sampling and of BSDF sampling, choices included |
//!
//! Numbers come from [`crate::math::rng::draw4`] with the path's seed by (vertex, block), so none
//! depends on an earlier branch.

use glam::Vec3;

use crate::accel::{Hit, HitFilter, HitPoint, Ray};
use crate::counters::Counters;
use crate::light::NO_LIGHT;
use crate::math::luminance;
use crate::math::rng::{
    BLOCK_LIGHT, BLOCK_LIGHTS, BLOCK_ROULETTE, BLOCK_SCATTER, draw4, unit_float,
};
use crate::surface::SurfacePoint;
use crate::world::World;

/// Which lights a vertex samples; kernels are compiled for one.
pub mod sampled {
    /// None: BSDF sampling alone.
    pub const NONE: u8 = 0;
    /// One, by power.
    pub const ONE: u8 = 1;
    /// Each of them once.
    pub const ALL: u8 = 2;
}

/// When a path ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most segments a path may have.
    pub depth: u32,
    /// Scatterings before Russian roulette may end a path.
    pub roulette_after: u32,
}

/// Share of technique `a` by the power heuristic with exponent 2 (Veach 1997, eq. 9.13): a² / (a² +
/// b²), for a > 0 and b ≥ 0.
#[inline]
#[must_use]
pub fn power_heuristic(a: f32, b: f32) -> f32 {
    // By the ratio: squares of densities overflow.
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}

/// Emitted radiance at a hit towards where the ray came from.
#[inline]
#[must_use]
pub fn emitted(world: &World, point: &HitPoint, direction: Vec3) -> Vec3 {
    match world.lights.of_surface(point.shape, point.element) {
        NO_LIGHT => Vec3::ZERO,
        light => world.lights.emitted(
            &world.scene,
            light,
            point.uv,
            -direction.dot(point.geometric_normal),
        ),
    }
}

/// Light reflected or transmitted towards the camera at a primary hit: one unbiased estimate of all
/// paths with 2 to `limits.depth` segments.
///
/// `LIGHTS` (of [`sampled`]) are sampled at every vertex with a non-delta lobe, combined with BSDF
/// sampling by the power heuristic. The primary ray's direction is of unit length.
#[inline]
#[must_use]
pub fn scattered_radiance<const LIGHTS: u8, F: HitFilter>(
    world: &World,
    filter: &F,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    counters: &mut Counters,
) -> Vec3 {
    walk::<LIGHTS, true, F>(world, filter, seed, primary, limits, counters)
}

/// As [`scattered_radiance`] with light sampling, without the light that comes straight to the
/// primary hit and leaves it by a lobe that is not a delta: what remains for the path tracer where
/// another technique estimates that part.
#[inline]
#[must_use]
pub fn indirect_radiance<F: HitFilter>(
    world: &World,
    filter: &F,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    counters: &mut Counters,
) -> Vec3 {
    walk::<{ sampled::ONE }, false, F>(world, filter, seed, primary, limits, counters)
}

#[inline]
fn walk<const LIGHTS: u8, const DIRECT: bool, F: HitFilter>(
    world: &World,
    filter: &F,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    counters: &mut Counters,
) -> Vec3 {
    let mut radiance = Vec3::ZERO;
    let mut throughput = Vec3::ONE;
    let mut eta_scale = 1.0_f32;
    let mut direction = primary.0;
    let mut hit = *primary.1;
    let mut point = world.accel.point(&hit);
    counters.paths += 1;
    for vertex in 0..limits.depth.saturating_sub(1) {
        let surface = world.surface_at(&hit, &point);
        if surface.bsdf.is_black() {
            break;
        }
        let outgoing = surface.frame.to_local(-direction);
        let counted = DIRECT || vertex > 0;
        if counted && surface.bsdf.has_non_delta() && !world.lights.is_empty() {
            let place = (world, filter, &surface, outgoing);
            if LIGHTS == sampled::ONE {
                let words = draw4(seed, vertex, BLOCK_LIGHT);
                let light = world.lights.choose(words[0], words[1]);
                let choice = world.lights.choice_probability(light);
                radiance += throughput
                    * direct_light(place, (light, choice), [words[2], words[3]], counters);
            } else if LIGHTS == sampled::ALL {
                for light in 0..world.lights.len() as u32 {
                    if world.lights.choice_probability(light) > 0.0 {
                        let [x, y, ..] = draw4(seed, vertex, BLOCK_LIGHTS | light);
                        radiance +=
                            throughput * direct_light(place, (light, 1.0), [x, y], counters);
                    }
                }
            }
        }

        let Some(sample) = surface.bsdf.sample(outgoing, draw4(seed, vertex, BLOCK_SCATTER)) else {
            break;
        };
        let last = vertex + 2 == limits.depth;
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
        if vertex >= limits.roulette_after {
            // Refraction squeezes radiance by η²; the path's importance is not less for it.
            let survival = (throughput.max_element() * eta_scale).min(0.95);
            if unit_float(draw4(seed, vertex, BLOCK_ROULETTE)[0]) >= survival {
                break;
            }
            throughput /= survival;
        }

        direction = surface.frame.to_world(sample.wi).normalize();
        let ray = Ray { origin: surface.origin(direction), direction, t_max: f32::INFINITY };
        counters.bounce_rays += 1;
        let weight = |light: u32, pdf: f32| match LIGHTS {
            _ if sample.delta => 1.0,
            sampled::NONE => 1.0,
            sampled::ONE => {
                power_heuristic(sample.pdf, world.lights.choice_probability(light) * pdf)
            }
            _ => power_heuristic(sample.pdf, pdf),
        };
        let Some(next) = world.accel.closest_hit(&ray, filter) else {
            for (light, environment) in world.lights.environments().filter(|_| counted) {
                let share = weight(light, environment.pdf(direction));
                radiance += throughput * environment.radiance(direction) * share;
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
        if light != NO_LIGHT && counted {
            let cos_light = -direction.dot(point.geometric_normal);
            let emission = world.lights.emitted(&world.scene, light, point.uv, cos_light);
            if emission != Vec3::ZERO {
                let pdf =
                    world.lights.pdf_towards(light, surface.position, point.position, cos_light);
                radiance += throughput * emission * weight(light, pdf);
            }
        }
    }
    radiance
}

/// One sample of a light that was chosen with a probability, weighted against BSDF sampling: with
/// its sum over lights an estimate of `∫ Le f |cos θ| V w_ℓ dω`.
#[inline]
fn direct_light<F: HitFilter>(
    (world, filter, surface, outgoing): (&World, &F, &SurfacePoint, Vec3),
    (light, choice): (u32, f32),
    words: [u32; 2],
    counters: &mut Counters,
) -> Vec3 {
    let u = glam::Vec2::from(words.map(unit_float));
    let Some(incident) = world.lights.sample_towards(&world.scene, light, surface.position, u)
    else {
        counters.shadow_rays_saved += 1;
        return Vec3::ZERO;
    };
    let scattered = surface.bsdf.evaluate(outgoing, surface.frame.to_local(incident.direction));
    if scattered.value == Vec3::ZERO {
        counters.shadow_rays_saved += 1;
        return Vec3::ZERO;
    }
    counters.shadow_rays += 1;
    if world.accel.occluded(&shadow_ray(surface, incident.direction, incident.end), filter) {
        return Vec3::ZERO;
    }
    let density = choice * incident.pdf;
    let share = if incident.delta { 1.0 } else { power_heuristic(density, scattered.pdf) };
    incident.radiance * scattered.value * (share / density)
}

/// The ray that asks whether a light point is seen from a surface; it ends before the light's own
/// surface.
#[inline]
#[must_use]
pub fn shadow_ray(surface: &SurfacePoint, direction: Vec3, end: Option<Vec3>) -> Ray {
    let origin = surface.origin(direction);
    match end {
        Some(end) => Ray { origin, direction: end - origin, t_max: 1.0 },
        None => Ray { origin, direction, t_max: f32::INFINITY },
    }
}

/// `radiance`, or black and counted where it is not finite.
#[inline]
#[must_use]
pub fn finite_or_counted(radiance: Vec3, counters: &mut Counters) -> Vec3 {
    debug_assert!(radiance.is_finite(), "an estimate is {radiance}");
    if luminance(radiance).is_finite() && radiance.is_finite() {
        radiance
    } else {
        counters.non_finite += 1;
        Vec3::ZERO
    }
}
