//! Light points as a [`Domain`] of the passes of reuse.

use glam::Vec3;

use super::{LightMeasure, LightPointMutator, LightPointShift, Receiver, Record, Sight, Time};
use crate::accel::{Hit, HitFilter};
use crate::counters::Counters;
use crate::light::{EmitterPoint, LightPoint};
use crate::math::rng::RandomSource;
use crate::pass::{FrameInputs, Pixel};
use crate::resampling::{Finished, Shifted, metropolis};
use crate::reuse::{Domain, Mutated, StoredReservoir};

/// The light points of one frame. With `IN_TARGET`, p̂ contains visibility.
#[derive(Debug)]
pub(crate) struct LightPoints<'a, F, const IN_TARGET: bool> {
    /// The frame.
    pub(crate) frame: &'a FrameInputs<'a>,
    /// Which hits stop a shadow ray.
    pub(crate) filter: &'a F,
    /// Probability that a mutation draws another light, in [0, 1].
    pub(crate) large_steps: f32,
}

impl<'a, F: HitFilter + Sync, const IN_TARGET: bool> Domain for LightPoints<'a, F, IN_TARGET> {
    type Sample = LightPoint;
    type Measure = LightMeasure;
    type Receiver = Receiver<'a>;
    type Record = Record;
    type Shift = LightPointShift<'a, F, IN_TARGET>;
    type Sight = (Sight, EmitterPoint);

    const IN_TARGET: bool = IN_TARGET;

    #[inline]
    fn frame(&self) -> &FrameInputs<'_> {
        self.frame
    }

    #[inline]
    fn receiver(&self, hit: Hit, pixel: Pixel) -> Receiver<'a> {
        Receiver::new(self.frame.world, hit, self.frame.primary_direction(pixel), Time::Now)
    }

    #[inline]
    fn receiver_before(&self, hit: Hit, pixel: Pixel) -> Option<Receiver<'a>> {
        let direction = self.frame.primary_direction_before(pixel)?;
        Some(Receiver::new(self.frame.previous?, hit, direction, Time::Before))
    }

    #[inline]
    fn normal(&self, receiver: &Receiver<'a>) -> Vec3 {
        receiver.surface().0.frame.normal
    }

    fn shift(&self) -> LightPointShift<'a, F, IN_TARGET> {
        let remap = self.frame.motion.and_then(|motion| motion.lights.as_ref());
        LightPointShift::new(self.filter, remap)
    }

    fn work(shift: &LightPointShift<'a, F, IN_TARGET>) -> Counters {
        shift.counters
    }

    #[inline]
    fn sight(&self, receiver: &Receiver<'a>, point: LightPoint) -> Option<(Sight, EmitterPoint)> {
        receiver.look(point)
    }

    #[inline]
    fn integrand((sight, _): &(Sight, EmitterPoint)) -> Vec3 {
        sight.integrand
    }

    #[inline]
    fn sees(
        &self,
        receiver: &Receiver<'a>,
        (sight, emitter): &(Sight, EmitterPoint),
        counters: &mut Counters,
    ) -> bool {
        receiver.sees(sight.arrival.direction, emitter, self.filter, counters)
    }

    fn mutated(
        &self,
        receiver: &Receiver<'a>,
        point: LightPoint,
        steps: u32,
        random: &mut impl RandomSource,
        counters: &mut Counters,
    ) -> Option<Mutated<LightPoint>> {
        let mut mutator = LightPointMutator::<F, IN_TARGET> {
            receiver,
            filter: self.filter,
            large: self.large_steps,
            counters: Counters::default(),
        };
        // The point was drawn with a positive target, which only rounding can take from it.
        let start = mutator.start(point)?;
        let chain = metropolis(&mut mutator, start, steps, random);
        *counters = *counters + mutator.counters;
        counters.mutations_accepted += u64::from(chain.accepted);
        (chain.accepted > 0).then(|| Mutated {
            sample: chain.state.point,
            target_before: start.target(),
            target: chain.state.target(),
        })
    }
}

impl StoredReservoir for Record {
    type Sample = LightPoint;
    type Measure = LightMeasure;

    #[inline]
    fn new(
        finished: &Finished<LightPoint, LightMeasure>,
        target: f32,
        age: u32,
        policy_bits: u16,
    ) -> Self {
        Self::new(finished, target, age, policy_bits)
    }

    #[inline]
    fn finished(&self) -> Finished<LightPoint, LightMeasure> {
        self.finished()
    }

    #[inline]
    fn target(&self) -> f32 {
        self.target
    }

    #[inline]
    fn confidence(&self) -> f32 {
        self.confidence()
    }

    #[inline]
    fn age(&self) -> u32 {
        self.age()
    }

    #[inline]
    fn policy_bits(&self) -> u16 {
        self.policy_bits()
    }

    #[inline]
    fn emptied(&self) -> Self {
        self.emptied()
    }

    /// T keeps the point, and with it the density.
    #[inline]
    fn slot(shifted: &Shifted<LightPoint, Vec3>) -> [f32; 4] {
        let [r, g, b] = shifted.integrand.to_array();
        [r, g, b, 1.0]
    }

    #[inline]
    fn arrived(&self, [r, g, b, density]: [f32; 4]) -> Option<Shifted<LightPoint, Vec3>> {
        if density == 0.0 {
            return None;
        }
        let sample = self.finished().sample?;
        Some(Shifted { sample, integrand: Vec3::new(r, g, b), jacobian: 1.0 })
    }
}
