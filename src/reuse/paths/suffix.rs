//! The part of a path behind `x_r` is kept as it is where neither lights nor geometry move, and
//! traced again in the destination's world where they do.
//!
//! There `x_r` moves with its instance, the direction from it stays, and all behind it follows the
//! path's own numbers: T is the identity in them, and its \|∂T\| stays 1. The way back traces in
//! the other world by the same numbers, so T⁻¹ finds the path that was left.

//! Where `x_r` may have been mutated, the numbers of `v_r` and `v_{r+1}` say nothing. So T keeps
//! more there, of mutated paths and of others alike, since a map that asked whether a path was
//! mutated would be two maps: the direction that a rough `v_{r+1}` is left by, and the point on the
//! light that `v_r` sampled. \|∂T\| then has the ratio of their densities.

use glam::Vec3;

use super::ends::{LightEnd, light_end};
use super::failure::Failure;
use super::shift::{PathReceiver, PathShift};
use super::{Anchor, Ending, NO_LOBE, Next, PathSample, Place, Reconnection};
use crate::accel::{Hit, HitFilter, HitPoint};
use crate::counters::Counters;
use crate::light::{LightPoint, NO_LIGHT};
#[cfg(test)]
use crate::math::rng::recording::Replay;
use crate::path::{Ending as Found, LightSample, Steps, Vertex, sampled};
use crate::surface::bsdf::Evaluation;
use crate::world::World;

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
    /// As [`Reconnection::next`].
    pub(super) next: Next,
    /// Its part of \|∂T\|.
    pub(super) ratio: f32,
}

/// How `v_{r+1}` is left in the destination's world.
#[derive(Clone, Copy, Debug)]
pub(super) enum Turn {
    /// By the path's own numbers.
    Drawn,
    /// By the path's own numbers, by a lobe that is not rough.
    Smooth,
    /// Along the direction that is kept, which had this joint density at the source.
    Kept(f32),
}

impl Suffix {
    /// That of the source.
    #[inline]
    pub(super) fn kept(sample: &PathSample, kept: &Reconnection) -> Self {
        let Reconnection { direction, radiance, light_density, next, .. } = *kept;
        Self { direction, radiance, light_density, ending: sample.ending, next, ratio: 1.0 }
    }

    /// Of a path whose last vertex is `x_r`, and samples a light.
    pub(super) fn lit(sample: &LightSample) -> Self {
        Self {
            direction: sample.incident.direction,
            radiance: sample.incident.radiance,
            light_density: sample.density,
            ending: Ending::Light { delta: sample.incident.delta },
            next: Next::default(),
            ratio: 1.0,
        }
    }
}

impl<F: HitFilter> PathShift<'_, F> {
    /// The suffix in the destination's world, from `x_r` at `vertex` along the direction that is
    /// kept, whose density over all lobes is `scattered`. The path must be as long there and end in
    /// the same way, in sky number `sky` if in one.
    pub(super) fn traced<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        vertex: &Vertex,
        sample: &PathSample,
        (kept, scattered, turn): (&Reconnection, f32, Turn),
        sky: u32,
    ) -> Result<Suffix, Failure> {
        #[cfg(test)]
        let _replay = Replay::begin();
        let world = steps.world;
        let last = u32::from(sample.last);
        let by_light = matches!(sample.ending, Ending::Light { .. });
        let first = u32::from(kept.vertex) + 1;
        let mut number = u32::from(kept.vertex);
        let mut behind: Option<Vertex> = None;
        let mut scattered = Some(scattered);
        let mut direction = kept.direction;
        // Π f/p̄ of v_{r+1} …, and the same without v_{r+1}.
        let (mut throughput, mut beyond) = (Vec3::ONE, Vec3::ONE);
        let (mut next, mut ratio) = (Next::default(), 1.0);
        loop {
            let at = behind.as_ref().unwrap_or(vertex);
            let hit = steps.onward(at, direction, &mut self.counters);
            if number < last {
                let hit = hit.ok_or(Failure::Length)?;
                let point = world.accel.point(&hit);
                number += 1;
                let there = Vertex::new(world, &hit, &point, direction).ok_or(Failure::Length)?;
                if number == last && by_light {
                    let numbers = (sample.seed, number);
                    let light = light_again(steps, &there, numbers, &mut self.counters)?;
                    if number == first {
                        next = Next::vertex(&hit, NO_LOBE, light.incident.direction)
                            .lit(light.incident.radiance, light.density);
                    } else {
                        next = next.lit(beyond * light.contribution(), 0.0);
                    }
                    return Ok(Suffix {
                        direction: kept.direction,
                        radiance: throughput * light.contribution(),
                        light_density: 0.0,
                        ending: Ending::Light { delta: light.incident.delta },
                        next: if self.mutable { next } else { Next::default() },
                        ratio,
                    });
                }
                let factor;
                if let (true, Turn::Kept(before)) = (number == first, turn) {
                    let (total, joint) = self.turned(&there, &kept.next)?;
                    ratio = joint / before;
                    factor = total.value / total.pdf;
                    direction = kept.next.direction();
                    scattered = Some(total.pdf);
                    next = kept.next.moved_to(&hit);
                } else {
                    let numbers = (sample.seed, number);
                    let drawn = steps.scatter(&there, numbers).ok_or(Failure::Length)?;
                    factor = drawn.value / drawn.pdf;
                    direction = there.surface.frame.to_world(drawn.wi).normalize();
                    scattered = drawn.beside_lights();
                    if number == first {
                        let bsdf = &there.surface.bsdf;
                        // The way back would keep the direction.
                        if matches!(turn, Turn::Smooth)
                            && self.connects.is_rough(bsdf, drawn.lobe.into())
                        {
                            return Err(Failure::Lobe);
                        }
                        next = Next::vertex(&hit, drawn.lobe, direction);
                    }
                }
                throughput *= factor;
                if number > first {
                    beyond *= factor;
                }
                if throughput == Vec3::ZERO {
                    return Err(Failure::Back);
                }
                behind = Some(there);
                continue;
            }
            let left = (at, direction, scattered);
            let There { found: end, ending, .. } =
                end_there(steps, left, hit, (sample.ending, sky))?;
            let at_once = kept.vertex == sample.last;
            next = match (at_once, hit) {
                (true, Some(hit)) => Next::end(Place::Surface(hit)),
                (true, None) => Next::end(Place::Sky),
                (false, _) if last == first => next.lit(end.emission, end.density),
                (false, _) => next.lit(beyond * end.emission * end.share, 0.0),
            };
            return Ok(Suffix {
                direction: kept.direction,
                radiance: if at_once {
                    end.emission
                } else {
                    throughput * end.emission * end.share
                },
                light_density: if at_once { end.density } else { 0.0 },
                ending,
                next: if self.mutable { next } else { Next::default() },
                ratio,
            });
        }
    }

    /// How `v_{r+1}` is left by a path that may have been mutated: along the same direction where
    /// that was taken by a rough lobe.
    pub(super) fn turn_of(
        &self,
        sample: &PathSample,
        kept: &Reconnection,
        from: &PathReceiver<'_>,
    ) -> Result<Turn, Failure> {
        let lobe = u32::from(kept.next.lobe());
        if kept.vertex == sample.last || kept.next.lobe() == NO_LOBE {
            return Ok(Turn::Drawn);
        }
        let Some(Place::Surface(hit)) = kept.next.place() else { return Err(Failure::Length) };
        let point = from.world.accel.point(&hit);
        let there = Vertex::new(from.world, &hit, &point, kept.direction).ok_or(Failure::Length)?;
        if !self.connects.is_rough(&there.surface.bsdf, lobe) {
            return Ok(Turn::Smooth);
        }
        let (_, joint) = self.turned(&there, &kept.next)?;
        Ok(Turn::Kept(joint))
    }

    /// All lobes of `v_{r+1}` along the direction that is kept, and the joint density of its lobe,
    /// which must be rough.
    pub(super) fn turned(&self, at: &Vertex, next: &Next) -> Result<(Evaluation, f32), Failure> {
        let bsdf = &at.surface.bsdf;
        let lobe = u32::from(next.lobe());
        if lobe >= bsdf.lobe_count() || bsdf.is_delta(lobe) || !self.connects.is_rough(bsdf, lobe) {
            return Err(Failure::Lobe);
        }
        let wi = at.surface.frame.to_local(next.direction());
        let (total, joint) = bsdf.evaluate_with_lobe(lobe, at.outgoing, wi);
        let lost = joint <= 0.0 || total.value == Vec3::ZERO;
        if lost { Err(Failure::Back) } else { Ok((total, joint)) }
    }

    /// The suffix of a path that samples a light at `x_r`, which keeps the place on that light; and
    /// what `x_r` at `vertex` makes of it.
    pub(super) fn lit_again<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        vertex: &Vertex,
        kept: &Reconnection,
        (from, to): (&PathReceiver<'_>, &PathReceiver<'_>),
    ) -> Result<(Suffix, Evaluation), Failure> {
        let (Some(Place::Light(before)), Anchor::Surface(hit)) = (kept.next.place(), kept.anchor)
        else {
            return Err(Failure::LightGone);
        };
        let (point, scaling) = self.point_there(before, from, to)?;
        let was = from.world.accel.point(&hit).position;
        let was = light_end(from.world, was, before).ok_or(Failure::Back)?;
        let lit = Lit::new(steps.world, vertex, point)?;
        self.look(steps, &vertex.surface, (lit.suffix.direction, lit.end))?;
        let ratio = lit.density / was.density * scaling;
        Ok((Suffix { ratio, ..lit.suffix }, lit.scattered))
    }
}

/// A point on a light as the last vertex samples it, if nothing stands between.
pub(super) struct Lit {
    pub(super) suffix: Suffix,
    pub(super) scattered: Evaluation,
    /// Density of light sampling in the light's measure, choice included.
    pub(super) density: f32,
    /// Where a shadow ray ends.
    pub(super) end: Option<Vec3>,
}

impl Lit {
    pub(super) fn new(world: &World, vertex: &Vertex, point: LightPoint) -> Result<Self, Failure> {
        let from = vertex.surface.position;
        let LightEnd { arrival, density } = light_end(world, from, point).ok_or(Failure::Back)?;
        let wi = vertex.surface.frame.to_local(arrival.direction);
        let scattered = vertex.surface.bsdf.evaluate(vertex.outgoing, wi);
        if scattered.value == Vec3::ZERO {
            return Err(Failure::Back);
        }
        let emitter = world.lights.emitter(&world.scene, point).ok_or(Failure::LightGone)?;
        let delta = arrival.geometry == 0.0;
        let geometry = if delta { 1.0 } else { arrival.geometry };
        let suffix = Suffix {
            direction: arrival.direction,
            radiance: arrival.radiance / geometry,
            light_density: density / geometry,
            ending: Ending::Light { delta },
            next: Next::end(Place::Light(point)),
            ratio: 1.0,
        };
        Ok(Self { suffix, scattered, density, end: world.lights.shadow_end(&emitter, from) })
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
