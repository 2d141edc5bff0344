//! Paths as a [`Domain`] of the passes of reuse, and their initial pass.

use glam::Vec3;

use super::{Connects, MOST_SEGMENTS, PathReceiver, PathRecord, PathSample, PathShift, Tree};
use crate::accel::{Hit, HitFilter};
use crate::counters::Counters;
use crate::math::rng::{Purpose, RandomSource};
use crate::pass::{Band, FrameInputs, Pixel, PrimaryHit};
use crate::path::{Limits, Steps, sampled, walk};
use crate::plan::Plan;
use crate::resampling::{Finished, Plain, PrimarySample, Reservoir};
use crate::reuse::light_points::Time;
use crate::reuse::passes::{Keys, NORMALS};
use crate::reuse::surfaces::pack_normal;
use crate::reuse::{Domain, Mutated, StoredReservoir};

/// The paths of one frame.
#[derive(Debug)]
pub(crate) struct Paths<'a, F> {
    /// The frame.
    pub(crate) frame: &'a FrameInputs<'a>,
    /// Which hits count.
    pub(crate) filter: &'a F,
    /// Which pairs of vertices a shift may connect.
    pub(crate) connects: Connects,
}

impl<F: HitFilter + Sync> Paths<'_, F> {
    /// Fills a band of reservoirs with the trees of fresh walks, and the normals that later passes
    /// compare.
    pub(crate) fn initial(&self, walks: u32, roulette_after: u32, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let inputs = self.frame;
        let world = inputs.world;
        let chains = inputs.shot.chains();
        let limits = Limits { depth: inputs.shot.depth.min(MOST_SEGMENTS), roulette_after };
        let steps = Steps::<{ sampled::ONE }, F> { world, filter: self.filter };
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let records: &mut [PathRecord] = band.take(inputs.id(Keys::<PathRecord>::RESERVOIRS));
        let normals: &mut [u32] = band.take_some(inputs.plan.id(NORMALS));
        for (local, pixel) in pixels.enumerate() {
            let own = local * chains as usize..(local + 1) * chains as usize;
            let hit = hits[pixel.index as usize].get();
            let surface = hit.map(|hit| world.surface(&hit));
            if let Some(normal) = normals.get_mut(local) {
                *normal = surface.as_ref().map_or(0, |surface| pack_normal(surface.frame.normal));
            }
            let Some(hit) = hit.filter(|_| surface.is_some_and(|s| !s.bsdf.is_black())) else {
                records[own].fill(PathRecord::default());
                continue;
            };
            let primary = (inputs.primary_direction(pixel), &hit);
            let seeds = inputs.seeds(pixel.index);
            for (chain, record) in (0..chains).zip(&mut records[own]) {
                let mut random = inputs.stream(pixel.index, Purpose::Selection, chain << 8);
                let mut reservoir = Plain::<PathSample>::default();
                for number in 0..walks {
                    let seed = seeds.seed(chain * walks + number);
                    let how = (seed, walks);
                    let mut tree =
                        Tree::new(world, self.connects, how, &mut reservoir, &mut random);
                    walk::<_, true, F>(&steps, seed, primary, limits, &mut tree, &mut counters);
                }
                counters.weights_rejected += u64::from(reservoir.rejected());
                let target = reservoir.selected().map_or(0.0, |sample| sample.target());
                *record = PathRecord::new(&reservoir.finish(target, 1.0), 0);
            }
        }
        counters
    }
}

impl<'a, F: HitFilter + Sync> Domain for Paths<'a, F> {
    type Sample = PathSample;
    type Measure = PrimarySample;
    type Receiver = PathReceiver<'a>;
    type Record = PathRecord;
    type Shift = PathShift<'a, F>;
    /// F, which a sample carries.
    type Sight = Vec3;

    const IN_TARGET: bool = true;

    #[inline]
    fn frame(&self) -> &FrameInputs<'_> {
        self.frame
    }

    #[inline]
    fn receiver(&self, hit: Hit, pixel: Pixel) -> PathReceiver<'a> {
        let direction = self.frame.primary_direction(pixel);
        PathReceiver { world: self.frame.world, time: Time::Now, direction, hit }
    }

    #[inline]
    fn receiver_before(&self, hit: Hit, pixel: Pixel) -> Option<PathReceiver<'a>> {
        let direction = self.frame.primary_direction_before(pixel)?;
        Some(PathReceiver { world: self.frame.previous?, time: Time::Before, direction, hit })
    }

    fn normal(&self, receiver: &PathReceiver<'a>) -> Vec3 {
        receiver.world.accel.point(&receiver.hit).shading_normal
    }

    fn shift(&self) -> PathShift<'a, F> {
        PathShift::new(self.filter, self.connects, self.frame.motion)
    }

    fn work(shift: &PathShift<'a, F>) -> Counters {
        shift.counters
    }

    #[inline]
    fn sight(&self, _receiver: &PathReceiver<'a>, sample: PathSample) -> Option<Vec3> {
        Some(sample.integrand)
    }

    #[inline]
    fn integrand(sight: &Vec3) -> Vec3 {
        *sight
    }

    #[inline]
    fn sees(&self, _: &PathReceiver<'a>, _: &Vec3, _: &mut Counters) -> bool {
        // Visibility is part of F.
        true
    }

    fn mutated(
        &self,
        _receiver: &PathReceiver<'a>,
        _sample: PathSample,
        _steps: u32,
        _random: &mut impl RandomSource,
        _counters: &mut Counters,
    ) -> Option<Mutated<PathSample>> {
        None
    }
}

impl StoredReservoir for PathRecord {
    type Sample = PathSample;
    type Measure = PrimarySample;

    #[inline]
    fn new(finished: &Finished<PathSample, PrimarySample>, _target: f32, age: u32, _: u16) -> Self {
        Self::new(finished, age)
    }

    #[inline]
    fn finished(&self) -> Finished<PathSample, PrimarySample> {
        self.finished()
    }

    #[inline]
    fn target(&self) -> f32 {
        crate::math::luminance(self.integrand())
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
        0
    }

    #[inline]
    fn emptied(&self) -> Self {
        Self::new(&Finished::empty(self.confidence()), self.age())
    }
}
