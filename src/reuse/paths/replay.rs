//! Replay: a path by its own numbers at another receiver, up to a vertex or to its end.

use glam::Vec3;

use super::PathSample;
use super::failure::Failure;
use super::shift::{Connected, PathReceiver, PathShift};
use super::suffix::end_there;
use super::trail::Trail;
use crate::accel::HitFilter;
#[cfg(test)]
use crate::math::rng::recording;
use crate::path::{Steps, Vertex, sampled};
use crate::surface::bsdf::BsdfSample;

/// A path that is replayed, at a vertex.
#[derive(Debug)]
pub(super) struct Replay {
    pub(super) vertex: Vertex,
    number: u32,
    pub(super) trail: Trail,
    /// Π f/p̄ so far.
    pub(super) throughput: Vec3,
}

impl<F: HitFilter> PathShift<'_, F> {
    /// Replays a path to vertex number `end`. No pair on the way may be connected.
    pub(super) fn replay<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        seed: u64,
        to: &PathReceiver<'_>,
        end: u32,
    ) -> Result<Replay, Failure> {
        let world = steps.world;
        let point = world.accel.point(&to.hit);
        let vertex = Vertex::new(world, &to.hit, &point, to.direction).ok_or(Failure::Replay)?;
        let mut replay =
            Replay { vertex, number: 0, trail: Trail::default(), throughput: Vec3::ONE };
        replay.trail.arrive(&self.connects, 0, &replay.vertex, (&point, to.hit.t));
        while replay.number < end {
            let (direction, _) = self.scatter(steps, seed, &mut replay)?;
            let hit = steps.onward(&replay.vertex, direction, &mut self.counters);
            let hit = hit.ok_or(Failure::Length)?;
            let point = world.accel.point(&hit);
            replay.number += 1;
            replay.vertex = Vertex::new(world, &hit, &point, direction).ok_or(Failure::Replay)?;
            replay.trail.arrive(&self.connects, replay.number, &replay.vertex, (&point, hit.t));
        }
        Ok(replay)
    }

    /// Scatters at the vertex of a replay by its own numbers. Fails where that connects its pair.
    #[inline]
    fn scatter<G: HitFilter>(
        &self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        seed: u64,
        replay: &mut Replay,
    ) -> Result<(Vec3, BsdfSample), Failure> {
        #[cfg(test)]
        let _replay = recording::Replay::begin();
        let Replay { vertex, number, trail, throughput } = replay;
        let scattered = steps.scatter(vertex, (seed, *number)).ok_or(Failure::Replay)?;
        let bsdf = &vertex.surface.bsdf;
        let lobe = scattered.lobe.into();
        if trail.connects(&self.connects, bsdf, Some(lobe), scattered.pdf) {
            return Err(Failure::Earlier);
        }
        let rough = self.connects.is_rough(bsdf, lobe);
        trail.leave(scattered.lobe, rough, scattered.pdf, 0.0);
        *throughput *= scattered.value / scattered.pdf;
        if *throughput == Vec3::ZERO {
            return Err(Failure::Replay);
        }
        Ok((vertex.surface.frame.to_world(scattered.wi).normalize(), scattered))
    }

    /// The whole path by its numbers: as long, with an end of the same kind, and never connected.
    pub(super) fn replay_to_the_end<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        sample: &PathSample,
        to: &PathReceiver<'_>,
        sky: u32,
    ) -> Result<Connected, Failure> {
        let mut replay = self.replay(steps, sample.seed, to, u32::from(sample.last))?;
        let (direction, scattered) = self.scatter(steps, sample.seed, &mut replay)?;
        let hit = steps.onward(&replay.vertex, direction, &mut self.counters);
        let left = (&replay.vertex, direction, scattered.beside_lights());
        let there = end_there(steps, left, hit, (sample.ending, sky))?;
        // A sky is as far away as anything.
        let trail = &replay.trail;
        let far = |point| trail.leaves_to(&self.connects, &trail.way_to(point));
        if trail.rough && there.point.as_ref().is_none_or(far) {
            return Err(Failure::Earlier);
        }
        let integrand = replay.throughput * (there.found.emission * there.found.share);
        Ok(Connected { integrand, ending: there.ending, reconnection: None, jacobian: 1.0 })
    }
}
