//! The technique's own kernels, and the choice of types for those of reuse: policy, target and
//! coverage filter are types, so that no ray asks for them.

use glam::Vec3;

use super::{RestirDi, kernel};
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::math::rng::Purpose;
use crate::pass::{Band, FrameInputs, PrimaryHit};
use crate::path::{Sum, finite_or_counted};
use crate::plan::Plan;
use crate::reuse::light_points::{LightPoints, candidates};
use crate::reuse::passes::kernel as reuse_kernel;
use crate::reuse::policy::{Policy, WithPolicy};
use crate::reuse::{Domain, Reuse};
use crate::techniques::other_light;
use crate::world::WithFilter;

/// Runs a kernel over a band.
pub(super) fn run(
    technique: &RestirDi,
    kernel: u32,
    inputs: &FrameInputs<'_>,
    band: &mut Band<'_>,
) -> Counters {
    inputs.world.with_filter(Call { technique, kernel, inputs, band })
}

/// One call of a kernel, before its types are chosen.
struct Call<'a, 'b, 'c> {
    technique: &'a RestirDi,
    kernel: u32,
    inputs: &'a FrameInputs<'b>,
    band: &'a mut Band<'c>,
}

impl WithFilter for Call<'_, '_, '_> {
    type Output = Counters;

    fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
        let Call { technique, kernel, inputs, band } = self;
        let at = Kernels { technique, inputs, filter: &filter };
        let roulette_after = technique.roulette_after;
        match kernel {
            kernel::TILES => at.light_points::<false>().tiles(band),
            kernel::RIS => at.ris(band),
            kernel::PATHS => {
                other_light::add::<false, Sum, F>(inputs, &filter, roulette_after, band)
            }
            kernel::ALL_PATHS => {
                other_light::add::<true, Sum, F>(inputs, &filter, roulette_after, band)
            }
            _ => technique
                .visibility
                .choose(technique.limits(), Reusing { kernels: at, kernel, band }),
        }
    }
}

/// A call of a kernel of reuse, before the policy's type is chosen.
struct Reusing<'a, 'b, 'c, F> {
    kernels: Kernels<'a, F>,
    kernel: u32,
    band: &'b mut Band<'c>,
}

impl<F: HitFilter + Sync> WithPolicy for Reusing<'_, '_, '_, F> {
    type Output = Counters;

    fn with<P: Policy>(self, policy: P) -> Counters {
        let Self { kernels, kernel, band } = self;
        if P::IN_TARGET {
            kernels.reuse::<P, true>(policy, kernel, band)
        } else {
            kernels.reuse::<P, false>(policy, kernel, band)
        }
    }
}

/// What all kernels need.
struct Kernels<'a, F> {
    technique: &'a RestirDi,
    inputs: &'a FrameInputs<'a>,
    filter: &'a F,
}

impl<'a, F: HitFilter + Sync> Kernels<'a, F> {
    fn light_points<const IN_TARGET: bool>(&self) -> LightPoints<'a, F, IN_TARGET> {
        let large_steps = self.technique.large_steps;
        LightPoints { frame: self.inputs, filter: self.filter, large_steps }
    }

    fn reuse<P: Policy, const IN_TARGET: bool>(
        &self,
        policy: P,
        kernel: u32,
        band: &mut Band<'_>,
    ) -> Counters {
        let domain = self.light_points::<IN_TARGET>();
        let reuse = Reuse::new(&domain, policy, self.technique.settings());
        match kernel {
            reuse_kernel::INITIAL => {
                domain.initial(policy, self.technique.supply().sources(self.inputs), band)
            }
            reuse_kernel::TEMPORAL => reuse.temporal(band),
            reuse_kernel::BOILING => reuse.boiling(band),
            reuse_kernel::MUTATE => reuse.mutate(band),
            reuse_kernel::SHADE => reuse.shade(band),
            round => reuse.spatial(round - reuse_kernel::SPATIAL, band),
        }
    }

    /// Candidates without reuse: F V W of a fresh reservoir.
    fn ris(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let domain = self.light_points::<false>();
        let (inputs, mut sources) = (self.inputs, self.technique.supply().sources(self.inputs));
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        for (pixel, out) in pixels.zip(radiance) {
            let mut sum = Vec3::ZERO;
            let estimates = inputs.estimates(pixel);
            if let Some(hit) = hits[pixel.index as usize].get()
                && let receiver = domain.receiver(hit, pixel)
                && receiver.scatters()
            {
                let (seeds, from) = (inputs.seeds(pixel.index), sources.at(pixel));
                let each = from.lights + from.bsdf;
                for estimate in 0..estimates {
                    let mut selection = inputs.stream(pixel.index, Purpose::Selection, estimate);
                    let first = (seeds, estimate * each);
                    let chosen = candidates(&receiver, from, first, &mut selection, &mut counters);
                    let Some(chosen) = chosen else {
                        counters.shadow_rays_saved += 1;
                        continue;
                    };
                    if chosen.is_seen(&receiver, self.filter, &mut counters) {
                        let weight = chosen.finish(1.0).weight.get();
                        sum += finite_or_counted(chosen.integrand() * weight, &mut counters);
                    }
                }
            }
            *out = (sum / estimates as f32).to_array();
        }
        counters
    }
}
