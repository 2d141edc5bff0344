//! Samples that pixels and frames share: the passes of reuse, written once for any kind of sample.
//!
//! | here | meaning |
//! |---|---|
//! | `Domain` | what a sample is, where it is received, how it is shifted, mutated and seen |
//! | `Policy` | what is done with the outcomes of shadow rays |
//! | [`Settings`] | the parameters that all passes share |
//! | chain | one reservoir of a pixel with a history of its own; a pixel has `effort` of them |
//! | tap | a neighbour of a pixel in one round of spatial reuse |
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | initial | hits | reservoirs, normals (the domain's own kernel) |
//! | temporal | reservoirs, the previous frame's history | reservoirs, in place |
//! | boiling | reservoirs of a tile | reservoirs, in place; biased |
//! | mutate | reservoirs | reservoirs, in place |
//! | shifts | reservoirs | each sample as the pixel's partners see it, where that is shared |
//! | spatial | reservoirs, shifts | history (the last round, which also shades) |
//! | shade | reservoirs | radiance, where there is no spatial pass |
//!
//! Laws that the passes keep for any domain and policy:
//! 1. Which history and which neighbours a pixel takes is decided by surfaces and fresh numbers
//!    alone, never by a sample.
//! 2. A chain takes from the chain of the same number only, so the chains of a pixel are
//!    independent given the surfaces and the taps, and their mean has the variance of one divided
//!    by their number.
//!
//! Papers: Bitterli et al. (2020), *Spatiotemporal reservoir resampling*; Lin et al. (2022),
//! *Generalized Resampled Importance Sampling*; Sawhney et al. (2024), *Decorrelating ReSTIR
//! Samplers via MCMC Mutations*.

mod boiling;
mod control;
mod exchange;
pub mod light_points;
pub mod lobes;
mod mutate;
pub(crate) mod parameters;
pub(crate) mod passes;
pub mod paths;
pub mod policy;
mod shade;
mod spatial;
mod surfaces;
mod taps;
mod temporal;
pub(crate) mod twin;

use bytemuck::Pod;
use glam::Vec3;

pub(crate) use boiling::limit as boiling_limit;
pub use control::Control;
pub use parameters::{Kernel, MAX_NEIGHBOURS, Settings, SpatialUse, Taps};
pub use policy::{REUSE_AGE, REUSE_DISTANCE, Reused, Visibility};
pub use twin::{CONTROL_WGSL, STORED_WGSL, WIS_WGSL};

use crate::accel::Hit;
use crate::counters::Counters;
use crate::math::rng::{Purpose, RandomSource, Stream};
use crate::pass::{FrameInputs, Pixel};
use crate::resampling::{Finished, Input, Measure, ShiftMap, Shifted};
use policy::Policy;

/// A finished reservoir as it lies in a buffer. All zeros is an empty record without confidence.
pub(crate) trait StoredReservoir: Pod + Send + Sync {
    /// What is stored.
    type Sample: Copy;
    /// The measure of its contribution weight.
    type Measure: Measure;

    /// A finished reservoir with p̂ of its sample, the sample's age in frames, and the policy's
    /// bits.
    fn new(
        finished: &Finished<Self::Sample, Self::Measure>,
        target: f32,
        age: u32,
        policy_bits: u16,
    ) -> Self;

    /// The finished reservoir.
    fn finished(&self) -> Finished<Self::Sample, Self::Measure>;

    /// p̂ of the sample at its own pixel; 0 without one.
    fn target(&self) -> f32;

    /// c: 0 where the surface scatters nothing.
    fn confidence(&self) -> f32;

    /// Frames since the sample was a fresh candidate.
    fn age(&self) -> u32;

    /// What the visibility policy keeps.
    fn policy_bits(&self) -> u16;

    /// Whether both carry the same sample; `false` where that cannot be told.
    fn is_same(&self, _other: &Self) -> bool {
        false
    }

    /// The same without its sample; its confidence stays.
    fn emptied(&self) -> Self;

    /// A slot keeps of a shift within a frame all that [`Self::arrived`] does not find in the
    /// record that the sample came from.
    fn slot(shifted: &Shifted<Self::Sample, Vec3>) -> [f32; 4];

    /// The record's sample at the receiver of a slot; `None` where its shift is undefined.
    fn arrived(&self, slot: [f32; 4]) -> Option<Shifted<Self::Sample, Vec3>>;
}

/// What the passes must know of a kind of sample. A domain is made for one frame, so its receivers
/// borrow that frame's worlds.
pub(crate) trait Domain: Sync {
    /// What is drawn.
    type Sample: Copy;
    /// The measure of contribution weights.
    type Measure: Measure;
    /// A primary hit with all that the integrand depends on besides the sample.
    type Receiver;
    /// A finished reservoir in a buffer.
    type Record: StoredReservoir<Sample = Self::Sample, Measure = Self::Measure>;
    /// The shift between receivers, of this frame or of the previous one.
    type Shift: ShiftMap<Sample = Self::Sample, Domain = Self::Receiver, Integrand = Vec3>;
    /// A sample as a receiver sees it.
    type Sight;

    /// Whether p̂ contains visibility.
    const IN_TARGET: bool;

    /// The frame.
    fn frame(&self) -> &FrameInputs<'_>;

    /// Parts of the light that have reservoirs of their own, one after the other for each chain;
    /// what a pixel shows is their sum.
    fn parts(&self) -> u32 {
        1
    }

    /// The number of the reason why the shift map's last shift was undefined, from 1 on; for
    /// pictures.
    fn lost(_shift: &Self::Shift) -> f32 {
        0.0
    }

    /// The receiver at a pixel's hit.
    fn receiver(&self, hit: Hit, pixel: Pixel) -> Self::Receiver;

    /// The receiver at a pixel's hit in the previous frame; `None` in the first.
    fn receiver_before(&self, hit: Hit, pixel: Pixel) -> Option<Self::Receiver>;

    /// The unit normal of a receiver's surface.
    fn normal(&self, receiver: &Self::Receiver) -> Vec3;

    /// A shift map for one band.
    fn shift(&self) -> Self::Shift;

    /// The work that a shift map has done.
    fn work(shift: &Self::Shift) -> Counters;

    /// A sample of a receiver's own frame; `None` where the integrand is 0.
    fn sight(&self, receiver: &Self::Receiver, sample: Self::Sample) -> Option<Self::Sight>;

    /// F, without visibility.
    fn integrand(sight: &Self::Sight) -> Vec3;

    /// Whether nothing stands between the receiver and a sample: one shadow ray.
    fn sees(&self, receiver: &Self::Receiver, sight: &Self::Sight, counters: &mut Counters)
    -> bool;

    /// The sample after `steps` mutations; `None` where none was accepted.
    fn mutated(
        &self,
        receiver: &Self::Receiver,
        sample: Self::Sample,
        steps: u32,
        random: &mut impl RandomSource,
        counters: &mut Counters,
    ) -> Option<Mutated<Self::Sample>>;
}

/// Where a chain of mutations ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mutated<S> {
    /// The new sample.
    pub(crate) sample: S,
    /// p̂ of the sample that the chain began with.
    pub(crate) target_before: f32,
    /// p̂ of the new sample.
    pub(crate) target: f32,
}

/// The passes of reuse in one frame, for a domain and a policy.
#[derive(Debug)]
pub(crate) struct Reuse<'a, D, P> {
    /// What is reused.
    pub(crate) domain: &'a D,
    /// What is done with shadow rays.
    pub(crate) policy: P,
    /// The parameters.
    pub(crate) settings: Settings,
    /// Reservoirs of a pixel: chains times the domain's parts.
    chains: usize,
}

/// An input of a merge of domain `D`.
type InputOf<'r, D> =
    Input<'r, <D as Domain>::Sample, <D as Domain>::Receiver, <D as Domain>::Measure>;

impl<'a, D: Domain, P: Policy> Reuse<'a, D, P> {
    /// The passes for a domain's frame.
    pub(crate) fn new(domain: &'a D, policy: P, settings: Settings) -> Self {
        let chains = (domain.frame().shot.chains() * domain.parts()) as usize;
        Self { domain, policy, settings, chains }
    }

    /// The numbers of a chain for one purpose and round.
    fn stream(&self, pixel: Pixel, purpose: Purpose, round: u32, chain: usize) -> Stream {
        // Rounds are below 256.
        self.domain.frame().stream(pixel.index, purpose, round | (chain as u32) << 8)
    }

    /// F and V of a sample of this frame: one shadow ray, none where F is 0.
    #[inline]
    fn look(
        &self,
        receiver: &D::Receiver,
        sample: D::Sample,
        counters: &mut Counters,
    ) -> (Vec3, bool) {
        match self.domain.sight(receiver, sample) {
            Some(sight) => (D::integrand(&sight), self.domain.sees(receiver, &sight, counters)),
            None => {
                counters.shadow_rays_saved += 1;
                (Vec3::ZERO, false)
            }
        }
    }

    /// F, without visibility, of an input's own sample at its own receiver.
    #[inline]
    fn own_integrand(&self, input: &InputOf<'_, D>) -> Vec3 {
        input
            .finished
            .sample
            .and_then(|sample| self.domain.sight(input.domain, sample))
            .map_or(Vec3::ZERO, |sight| D::integrand(&sight))
    }
}

/// A record as an input of a merge.
#[inline]
fn input<'r, D: Domain>(record: &D::Record, receiver: &'r D::Receiver) -> InputOf<'r, D> {
    Input { finished: record.finished(), target: record.target(), domain: receiver }
}
