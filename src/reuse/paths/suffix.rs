//! What a path sends towards `x_r`: kept as it is where neither lights nor geometry move, traced
//! again in the destination's world where they do.
//!
//! There `x_r` moves with its instance, the direction from it stays, and all behind it follows the
//! path's own numbers: T is the identity in them, and its \|∂T\| stays 1. The way back traces in
//! the other world by the same numbers, so T⁻¹ finds the path that was left.

use glam::Vec3;

use super::shift::Failure;
use super::{Ending, PathSample, Reconnection};
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::light::NO_LIGHT;
#[cfg(test)]
use crate::math::rng::recording::Replay;
use crate::path::{LightSample, Steps, Vertex, sampled};

/// What `x_r` scatters onward.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suffix {
    /// As [`Reconnection::direction`].
    pub(super) direction: Vec3,
    /// As [`Reconnection::radiance`].
    pub(super) radiance: Vec3,
    /// As [`Reconnection::light_density`].
    pub(super) light_density: f32,
    /// How the path ends.
    pub(super) ending: Ending,
}

impl Suffix {
    /// That of the source.
    #[inline]
    pub(super) fn kept(sample: &PathSample, kept: &Reconnection) -> Self {
        let Reconnection { direction, radiance, light_density, .. } = *kept;
        Self { direction, radiance, light_density, ending: sample.ending }
    }

    /// Of a path whose last vertex is `x_r`, and samples a light.
    pub(super) fn lit(sample: &LightSample) -> Self {
        Self {
            direction: sample.incident.direction,
            radiance: sample.incident.radiance,
            light_density: sample.density,
            ending: Ending::Light { delta: sample.incident.delta },
        }
    }

    /// That of the destination's world, from `x_r` at `vertex` along the direction that is kept,
    /// whose density over all lobes is `scattered`. The path must be as long there and end in the
    /// same way, in sky number `sky` if in one.
    pub(super) fn traced<F: HitFilter>(
        steps: &Steps<'_, { sampled::ONE }, F>,
        vertex: &Vertex,
        sample: &PathSample,
        (kept, scattered): (&Reconnection, f32),
        sky: u32,
        counters: &mut Counters,
    ) -> Result<Self, Failure> {
        #[cfg(test)]
        let _replay = Replay::begin();
        let world = steps.world;
        let last = u32::from(sample.last);
        let by_light = matches!(sample.ending, Ending::Light { .. });
        let mut number = u32::from(kept.vertex);
        let mut behind: Option<Vertex> = None;
        let mut scattered = Some(scattered);
        let mut direction = kept.direction;
        let mut throughput = Vec3::ONE;
        loop {
            let at = behind.as_ref().unwrap_or(vertex);
            let hit = steps.onward(at, direction, counters);
            if number < last {
                let hit = hit.ok_or(Failure::Length)?;
                let point = world.accel.point(&hit);
                number += 1;
                let next = Vertex::new(world, &hit, &point, direction).ok_or(Failure::Length)?;
                if number == last && by_light {
                    let light = light_again(steps, &next, (sample.seed, number), counters)?;
                    return Ok(Self {
                        direction: kept.direction,
                        radiance: throughput * light.contribution(),
                        light_density: 0.0,
                        ending: Ending::Light { delta: light.incident.delta },
                    });
                }
                let drawn = steps.scatter(&next, (sample.seed, number)).ok_or(Failure::Length)?;
                throughput *= drawn.value / drawn.pdf;
                if throughput == Vec3::ZERO {
                    return Err(Failure::Back);
                }
                direction = next.surface.frame.to_world(drawn.wi).normalize();
                scattered = drawn.beside_lights();
                behind = Some(next);
                continue;
            }
            let (end, ending) = match (sample.ending, hit) {
                (Ending::Emitter, Some(hit)) => {
                    let (shape, element) = world.accel.shape_of(&hit);
                    let light = world.lights.of_surface(shape, element);
                    if light == NO_LIGHT {
                        return Err(Failure::Length);
                    }
                    let point = world.accel.point(&hit);
                    let end = steps.ending(at, scattered, direction, light, &point);
                    (end.ok_or(Failure::Back)?, Ending::Emitter)
                }
                (Ending::Sky { .. }, None) => {
                    let end = steps.skies(scattered, direction).nth(sky as usize);
                    (end.ok_or(Failure::LightGone)?, Ending::Sky { sky })
                }
                _ => return Err(Failure::Length),
            };
            let at_once = kept.vertex == sample.last;
            return Ok(Self {
                direction: kept.direction,
                radiance: if at_once {
                    end.emission
                } else {
                    throughput * end.emission * end.share
                },
                light_density: if at_once { end.density } else { 0.0 },
                ending,
            });
        }
    }
}

/// The light that vertex `number` of a seed samples in the destination's world.
pub(super) fn light_again<F: HitFilter>(
    steps: &Steps<'_, { sampled::ONE }, F>,
    at: &Vertex,
    numbers: (u64, u32),
    counters: &mut Counters,
) -> Result<LightSample, Failure> {
    #[cfg(test)]
    let _replay = Replay::begin();
    if steps.world.lights.is_empty() {
        return Err(Failure::LightGone);
    }
    steps.light(at, numbers, counters).ok_or(Failure::Occluded)
}
