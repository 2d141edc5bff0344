//! Mutations of the light point: it moves on its light, or to another light.
//!
//! The chain's coordinates are the light and u, v on it, so the invariant density is p̂ times the
//! measure of a unit of (u, v): the light's area, or 1 / density for environments. A small step
//! moves u and v on the torus by [`Kelemen`]'s kernel. A large step draws light and place anew, by
//! power and uniformly, so its acceptance holds the ratio of the lights' probabilities.

use glam::{Vec2, Vec3};

use super::Receiver;
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::light::LightPoint;
use crate::math::luminance;
use crate::math::rng::RandomSource;
use crate::resampling::{Kelemen, Mutator, Proposal, SmallStep};

/// A chain's state: a light point at one receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointState {
    /// Where.
    pub point: LightPoint,
    /// F, with visibility if the target has it.
    pub integrand: Vec3,
    /// Measure of a unit of (u, v).
    measure: f32,
}

impl PointState {
    /// p̂.
    #[must_use]
    pub fn target(&self) -> f32 {
        luminance(self.integrand)
    }
}

/// The kernel at one receiver. With `IN_TARGET`, each proposal takes a shadow ray.
#[derive(Debug)]
pub struct LightPointMutator<'a, F, const IN_TARGET: bool> {
    /// Where light is received.
    pub receiver: &'a Receiver<'a>,
    /// Which hits stop a shadow ray.
    pub filter: &'a F,
    /// Probability of a large step, in [0, 1].
    pub large: f32,
    /// Work done.
    pub counters: Counters,
}

impl<F: HitFilter, const IN_TARGET: bool> LightPointMutator<'_, F, IN_TARGET> {
    /// The state at a light point whose target is known to be positive, so that no ray is needed;
    /// `None` where F is 0.
    #[must_use]
    pub fn start(&self, point: LightPoint) -> Option<PointState> {
        let (sight, _) = self.receiver.look(point)?;
        let measure = self.receiver.world().lights.measure(point);
        measure.is_finite().then_some(PointState { point, integrand: sight.integrand, measure })
    }

    /// The state at a light point; `None` where p̂ is 0.
    #[must_use]
    pub fn state(&mut self, point: LightPoint) -> Option<PointState> {
        let (sight, emitter) = self.receiver.look(point)?;
        let seen = !IN_TARGET
            || self.receiver.sees(
                sight.arrival.direction,
                &emitter,
                self.filter,
                &mut self.counters,
            );
        let measure = self.receiver.world().lights.measure(point);
        (seen && measure.is_finite()).then_some(PointState {
            point,
            integrand: sight.integrand,
            measure,
        })
    }
}

impl<F: HitFilter, const IN_TARGET: bool> Mutator for LightPointMutator<'_, F, IN_TARGET> {
    type State = PointState;

    fn propose(
        &mut self,
        state: &PointState,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<PointState>> {
        let lights = &self.receiver.world().lights;
        let PointState { point, measure, .. } = *state;
        self.counters.mutations += 1;
        let large = random.choose(self.large, 1.0);
        let proposed = if large {
            let light = lights.choose(random.index(u32::MAX), random.index(u32::MAX));
            let uv = Vec2::new(random.uniform(), random.uniform());
            lights.point_with(light, uv)
        } else {
            lights.point_with(point.light, Kelemen::step(point.uv, random))
        };
        if proposed == point {
            return None;
        }
        let next = self.state(proposed)?;
        let mut ratio = next.target() / state.target() * (next.measure / measure);
        if large {
            ratio *=
                lights.choice_probability(point.light) / lights.choice_probability(proposed.light);
        }
        // NaN only where both targets vanish, which no state's does.
        Some(Proposal { state: next, acceptance: ratio.min(1.0) })
    }
}
