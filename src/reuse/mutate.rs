//! Mutations between temporal and spatial reuse (Sawhney et al. 2024): a sample moves by a Markov
//! chain that leaves p̂ invariant, so pixels that took the same sample stop sharing it.

use super::passes::{self, Keys};
use super::policy::Policy;
use super::{Control, Domain, Mutated, Reuse, Settings, StoredReservoir};
use crate::counters::Counters;
use crate::math::rng::{Purpose, RandomSource};
use crate::pass::{Band, PrimaryHit};
use crate::plan::Plan;
use crate::resampling::{ContributionWeight, Finished, mutated_weight};

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Runs the pass over a band.
    pub(crate) fn mutate(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let records: &mut [D::Record] = band.take(inputs.id(Keys::<D::Record>::RESERVOIRS));
        let controls: &mut [Control] = band.take_some(inputs.plan.id(passes::CONTROLS));
        for (local, pixel) in pixels.enumerate() {
            let Some(hit) = hits[pixel.index as usize].get() else { continue };
            let mut receiver = None;
            for chain in 0..chains {
                let at = local * chains + chain;
                let record = records[at];
                let Finished { sample: Some(sample), weight, confidence } = record.finished()
                else {
                    continue;
                };
                let mut random = self.stream(pixel, Purpose::Mutation, 0, chain);
                let Settings { mutations: steps, mutate_share, .. } = self.settings;
                // Not asked of the sample: that would be biased.
                if mutate_share < 1.0 && !random.choose(mutate_share, 1.0) {
                    continue;
                }
                let receiver = receiver.get_or_insert_with(|| self.domain.receiver(hit, pixel));
                let mutated =
                    self.domain.mutated(receiver, sample, steps, &mut random, &mut counters);
                let Some(Mutated { sample, target_before, target }) = mutated else { continue };
                let moved = mutated_weight(weight.get(), target_before, target);
                let finished: Finished<D::Sample, D::Measure> = if moved > 0.0 {
                    let weight = ContributionWeight::new(moved);
                    Finished { sample: Some(sample), weight, confidence }
                } else {
                    Finished::empty(confidence)
                };
                let mut bits = record.policy_bits();
                if P::KEEPS_OUTCOME {
                    // What the ray to the old sample said is not true of the new one. An average
                    // belongs to all samples and stays.
                    let (_, seen) = self.look(receiver, sample, &mut counters);
                    bits = self.policy.traced(bits, seen);
                    if P::CONTROL {
                        controls[at] = Control::new(controls[at].estimate(), seen);
                    }
                }
                records[at] = D::Record::new(&finished, target, record.age(), bits);
            }
        }
        counters
    }
}
