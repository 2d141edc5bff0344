//! The part of a path behind `x_r` is kept as it is where neither lights nor geometry move, and
//! traced again in the destination's world where they do.
//!
//! There `x_r` moves with its instance, the direction from it stays, and all behind it follows the
//! path's own numbers: T is the identity in them, and its \|∂T\| stays 1. The way back traces in
//! the other world by the same numbers, so T⁻¹ finds the path that was left.

use glam::Vec3;

use super::failure::Failure;
use super::{Ending, PathSample, Reconnection};
use crate::accel::{Hit, HitFilter, HitPoint};
use crate::counters::Counters;
use crate::light::NO_LIGHT;
#[cfg(test)]
use crate::math::rng::recording::Replay;
use crate::path::{Ending as Found, LightSample, Steps, Vertex, sampled};

/// The part of a path behind `x_r`.
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
            let left = (at, direction, scattered);
            let There { found: end, ending, .. } =
                end_there(steps, left, hit, (sample.ending, sky))?;
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

/// The end of a path in the destination's world.
pub(super) struct There {
    pub(super) found: Found,
    pub(super) ending: Ending,
    /// Its place; `None` for a sky.
    pub(super) point: Option<HitPoint>,
}

/// The end that a vertex's direction finds at `hit`, or without one in sky number `sky`. It must be
/// of the kind that the path had. `left` is the vertex, the direction, and its density as for
/// [`Steps::ending`].
pub(super) fn end_there<F: HitFilter>(
    steps: &Steps<'_, { sampled::ONE }, F>,
    left: (&Vertex, Vec3, Option<f32>),
    hit: Option<Hit>,
    (ending, sky): (Ending, u32),
) -> Result<There, Failure> {
    let (at, direction, scattered) = left;
    match (ending, hit) {
        (Ending::Emitter, Some(hit)) => {
            let world = steps.world;
            let (shape, element) = world.accel.shape_of(&hit);
            let light = world.lights.of_surface(shape, element);
            if light == NO_LIGHT {
                return Err(Failure::Length);
            }
            let point = world.accel.point(&hit);
            let found = steps.ending(at, scattered, direction, light, &point);
            let found = found.ok_or(Failure::Back)?;
            Ok(There { found, ending, point: Some(point) })
        }
        (Ending::Sky { .. }, None) => {
            let found = steps.skies(scattered, direction).nth(sky as usize);
            let found = found.ok_or(Failure::LightGone)?;
            Ok(There { found, ending: Ending::Sky { sky }, point: None })
        }
        _ => Err(Failure::Length),
    }
}
