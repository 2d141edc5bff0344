//! Mutations of the light point: it moves on its light, or to another light.
//!
//! The chain's coordinates are the light and u, v on it, so the invariant density is p̂ times the
//! measure of a unit of (u, v): the light's area, or 1 / density for environments. A small step
//! moves u and v on the torus by Kelemen's kernel (Kelemen et al. 2002): |Δ| between 1/1024 and
//! 1/64, log-uniform. A large step draws light and place anew, by power and uniformly, so its
//! acceptance holds the ratio of the lights' probabilities.

use glam::{Vec2, Vec3};

use super::Receiver;
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::light::LightPoint;
use crate::math::luminance;
use crate::math::rng::RandomSource;
use crate::resampling::{Mutator, Proposal};

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

/// Bounds of a small step, and ln of their ratio (Kelemen et al. 2002, as in common implementations
/// of primary-sample-space MLT).
const LARGEST: f32 = 1.0 / 64.0;
const LOG_RATIO: f32 = 2.772_588_7;

/// One coordinate on the torus.
fn perturb(u: f32, random: &mut impl RandomSource) -> f32 {
    let step = LARGEST * (-LOG_RATIO * random.uniform()).exp();
    let moved = if random.choose(1.0, 2.0) { u + step } else { u - step };
    let wrapped = moved - moved.floor();
    // u − step may round to 1 after wrapping.
    if wrapped < 1.0 { wrapped } else { 0.0 }
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
            let uv = Vec2::new(perturb(point.uv.x, random), perturb(point.uv.y, random));
            lights.point_with(point.light, uv)
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
