//! Paths as a [`Domain`] of the passes of reuse, and their initial pass.

use std::marker::PhantomData;

use glam::Vec3;

use super::{Connects, PathMutator, PathReceiver, PathSample, PathShift, Records, Tree};
use crate::accel::{Hit, HitFilter};
use crate::counters::Counters;
use crate::math::rng::{Purpose, RandomSource, Stream};
use crate::pass::{Band, FrameInputs, Pixel, PrimaryHit};
use crate::path::{Limits, Steps, finite_or_counted, sampled, walk};
use crate::plan::Plan;
use crate::resampling::{
    ContributionWeight, Finished, Gaussian, Kelemen, Plain, PrimarySample, Reservoir, SmallStep,
    metropolis,
};
use crate::reuse::light_points::{Chosen, PATHS, Receiver, Sources, Time, candidates};
use crate::reuse::passes::{self, Keys, NORMALS};
use crate::reuse::surfaces::pack_normal;
use crate::reuse::{Control, Domain, Kernel, Mutated};

/// The paths of one frame.
#[derive(Debug)]
pub(crate) struct Paths<'a, F, R> {
    /// The frame.
    pub(crate) frame: &'a FrameInputs<'a>,
    /// Which hits count.
    pub(crate) filter: &'a F,
    /// Which pairs of vertices a shift may connect.
    pub(crate) connects: Connects,
    /// Whether lights or geometry move.
    pub(crate) retraces: bool,
    /// 2 where direct light has reservoirs of its own, which come first; else 1.
    pub(crate) parts: u32,
    /// How mutations step.
    pub(crate) kernel: Kernel,
    /// What is stored.
    pub(crate) records: PhantomData<fn() -> R>,
}

/// Where the initial pass takes paths and light points from.
pub(crate) struct Fresh<'a> {
    /// Walks a chain whose paths are chosen from.
    pub(crate) walks: u32,
    /// The limits of these walks.
    pub(crate) limits: Limits,
    /// Where candidates for direct light come from; `None`: it is part of the walks.
    pub(crate) direct: Option<Sources<'a>>,
}

/// A chain's reservoir on its way, and all light that was met.
struct Filling {
    reservoir: Plain<PathSample>,
    sum: Vec3,
    /// The light point that was streamed.
    direct: Option<(f32, Finished<PathSample, PrimarySample>)>,
}

impl<F: HitFilter + Sync, R: Records> Paths<'_, F, R> {
    /// Fills a band of reservoirs with candidates for direct light and the trees of fresh walks,
    /// estimates with the sums of both, and the normals that later passes compare.
    pub(crate) fn initial(&self, mut fresh: Fresh<'_>, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let inputs = self.frame;
        let chains = inputs.shot.chains();
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let records: &mut [R] = band.take(inputs.id(Keys::<R>::RESERVOIRS));
        let controls: &mut [Control] = band.take_some(inputs.plan.id(passes::CONTROLS));
        let normals: &mut [u32] = band.take_some(inputs.plan.id(NORMALS));
        for (local, pixel) in pixels.enumerate() {
            let reservoirs = chains * self.parts;
            let own = local * reservoirs as usize..(local + 1) * reservoirs as usize;
            let direction = inputs.primary_direction(pixel);
            let receiver = hits[pixel.index as usize]
                .get()
                .map(|hit| (hit, Receiver::new(inputs.world, hit, direction, Time::Now)));
            if let Some(normal) = normals.get_mut(local) {
                let surface = receiver.as_ref().map(|(_, receiver)| &receiver.surface().0);
                *normal = surface.map_or(0, |surface| pack_normal(surface.frame.normal));
            }
            let scatters = |receiver: &Receiver<'_>| !receiver.surface().0.bsdf.is_black();
            let Some((hit, receiver)) = receiver.filter(|(_, receiver)| scatters(receiver)) else {
                records[own.clone()].fill(R::zeroed());
                if let Some(controls) = controls.get_mut(own) {
                    controls.fill(Control::default());
                }
                continue;
            };
            let seeds = inputs.seeds(pixel.index);
            for (number, at) in (0..reservoirs).zip(own) {
                let (chain, part) = (number / self.parts, number % self.parts);
                let [for_direct, for_walks] = [0, self.parts - 1].map(|its| part == its);
                let mut random = inputs.stream(pixel.index, Purpose::Selection, number << 8);
                let mut filling =
                    Filling { reservoir: Plain::default(), sum: Vec3::ZERO, direct: None };
                if let Some(sources) = &mut fresh.direct
                    && for_direct
                    && receiver.scatters()
                {
                    let from = sources.at(pixel);
                    let first = (seeds, chain * (from.lights + from.bsdf));
                    let chosen = candidates(&receiver, from, first, &mut random, &mut counters);
                    match chosen {
                        Some(chosen) => self.stream_direct(
                            &mut filling,
                            &receiver,
                            &chosen,
                            &mut random,
                            &mut counters,
                        ),
                        None => counters.shadow_rays_saved += 1,
                    }
                }
                for walk in 0..if for_walks { fresh.walks } else { 0 } {
                    let number = chain * fresh.walks + walk;
                    let seed = match &fresh.direct {
                        Some(_) => seeds.seed(PATHS + number),
                        None => seeds.seed(number),
                    };
                    self.stream_walk(
                        &mut filling,
                        &fresh,
                        (seed, (direction, &hit)),
                        &mut random,
                        &mut counters,
                    );
                }
                counters.weights_rejected += u64::from(filling.reservoir.rejected());
                if let Some(control) = controls.get_mut(at) {
                    *control = Control::new(finite_or_counted(filling.sum, &mut counters), true);
                }
                records[at] = R::new(&filling.finish(), 0.0, 0, 0);
            }
        }
        counters
    }

    /// Streams the light point that candidates chose, if it is seen.
    #[inline]
    fn stream_direct(
        &self,
        filling: &mut Filling,
        receiver: &Receiver<'_>,
        chosen: &Chosen,
        random: &mut Stream,
        counters: &mut Counters,
    ) {
        let weight = chosen.finish(1.0).weight;
        let target = chosen.sight.target();
        if weight.get() > 0.0 && chosen.is_seen(receiver, self.filter, counters) {
            let sample = PathSample::direct(chosen.point, chosen.integrand());
            let finished = Finished {
                sample: Some(sample),
                weight: ContributionWeight::new(weight.get()),
                confidence: 1.0,
            };
            filling.reservoir.stream(sample, target * weight.get(), (), random);
            filling.direct = Some((filling.reservoir.weight_sum(), finished));
            filling.sum += chosen.integrand() * weight.get();
        }
    }

    /// Streams the paths of a walk.
    #[inline]
    fn stream_walk(
        &self,
        filling: &mut Filling,
        fresh: &Fresh<'_>,
        (seed, primary): (u64, (Vec3, &Hit)),
        random: &mut Stream,
        counters: &mut Counters,
    ) {
        let walk = (seed, fresh.walks);
        let limits = (fresh.limits, fresh.direct.is_none());
        let reservoir = &mut filling.reservoir;
        let sum = if R::MUTABLE {
            self.grow::<true>(walk, primary, limits, reservoir, random, counters)
        } else {
            self.grow::<false>(walk, primary, limits, reservoir, random, counters)
        };
        filling.sum += sum / fresh.walks as f32;
    }

    /// Streams the paths of a walk into a reservoir, those of direct light too if the limits say
    /// so, and returns the light of all of them.
    #[inline]
    fn grow<const MUTABLE: bool>(
        &self,
        (seed, walks): (u64, u32),
        primary: (Vec3, &Hit),
        (limits, direct): (Limits, bool),
        reservoir: &mut Plain<PathSample>,
        random: &mut Stream,
        counters: &mut Counters,
    ) -> Vec3 {
        let world = self.frame.world;
        let steps = Steps::<{ sampled::ONE }, F> { world, filter: self.filter };
        let how = (seed, walks);
        let mut tree = Tree::<_, MUTABLE>::new(world, self.connects, how, reservoir, random);
        if direct {
            walk::<_, true, F>(&steps, seed, primary, limits, &mut tree, counters);
        } else {
            walk::<_, false, F>(&steps, seed, primary, limits, &mut tree, counters);
        }
        tree.sum
    }
}

impl Filling {
    fn finish(self) -> Finished<PathSample, PrimarySample> {
        // Where there is nothing but the light point, W is its own, which a product and a quotient
        // would only round.
        match self.direct {
            Some((sum, finished)) if sum == self.reservoir.weight_sum() => finished,
            _ => {
                let target = self.reservoir.selected().map_or(0.0, |sample| sample.target());
                self.reservoir.finish(target, 1.0)
            }
        }
    }
}

impl<'a, F: HitFilter + Sync, R: Records> Paths<'a, F, R> {
    fn moved<K: SmallStep>(
        &self,
        receiver: &PathReceiver<'a>,
        sample: PathSample,
        steps: u32,
        random: &mut impl RandomSource,
        counters: &mut Counters,
    ) -> Option<Mutated<PathSample>> {
        let mut shift = self.shift();
        let begun = PathMutator::<_, K>::new(&mut shift, receiver, &sample);
        let chain =
            begun.map(|(mut mutator, state)| metropolis(&mut mutator, state, steps, random));
        *counters = *counters + shift.counters;
        let chain = chain.filter(|chain| chain.accepted > 0)?;
        counters.mutations_accepted += u64::from(chain.accepted);
        let moved = chain.state.sample(&sample);
        let (target_before, target) = (sample.target(), moved.target());
        Some(Mutated { sample: moved, target_before, target })
    }
}

impl<'a, F: HitFilter + Sync, R: Records> Domain for Paths<'a, F, R> {
    type Sample = PathSample;
    type Measure = PrimarySample;
    type Receiver = PathReceiver<'a>;
    type Record = R;
    type Shift = PathShift<'a, F>;
    /// F, which a sample carries.
    type Sight = Vec3;

    const IN_TARGET: bool = true;

    #[inline]
    fn frame(&self) -> &FrameInputs<'_> {
        self.frame
    }

    fn parts(&self) -> u32 {
        self.parts
    }

    fn lost(shift: &PathShift<'a, F>) -> f32 {
        shift.lost.map_or(0.0, |failure| failure.number() as f32)
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
            .retracing(self.retraces)
            .mutable(R::MUTABLE)
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
        receiver: &PathReceiver<'a>,
        sample: PathSample,
        steps: u32,
        random: &mut impl RandomSource,
        counters: &mut Counters,
    ) -> Option<Mutated<PathSample>> {
        match self.kernel {
            _ if !R::MUTABLE => None,
            Kernel::Kelemen => self.moved::<Kelemen>(receiver, sample, steps, random, counters),
            Kernel::Gaussian => self.moved::<Gaussian>(receiver, sample, steps, random, counters),
        }
    }
}
