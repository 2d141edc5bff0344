//! The technique's kernels; estimator and coverage filter are types, so that no ray asks for them.

use super::beyond::{DeltaFirst, WithoutCaustics};
use super::lanes::{Chains, estimator};
use super::{Mcmm, McmmPaths, Planted, SetEstimator, kernel};
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::pass::{Band, FrameInputs};
use crate::path::Sum;
use crate::techniques::other_light;
use crate::world::WithFilter;

/// Runs a kernel over a band.
pub(super) fn run(
    technique: &Mcmm,
    kernel: u32,
    inputs: &FrameInputs<'_>,
    band: &mut Band<'_>,
) -> Counters {
    inputs.world.with_filter(Call { technique, kernel, inputs, band })
}

/// One call of a kernel, before its types are chosen.
struct Call<'a, 'b, 'c> {
    technique: &'a Mcmm,
    kernel: u32,
    inputs: &'a FrameInputs<'b>,
    band: &'a mut Band<'c>,
}

impl WithFilter for Call<'_, '_, '_> {
    type Output = Counters;

    fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
        let Call { technique, kernel, inputs, band } = self;
        let roulette_after = technique.roulette_after;
        match kernel {
            kernel::PATHS => match technique.paths {
                _ if technique.planted(Planted::Twice) => {
                    other_light::add::<false, Sum, F>(inputs, &filter, roulette_after, band)
                }
                McmmPaths::Direct => {
                    other_light::add::<false, Sum, F>(inputs, &filter, roulette_after, band)
                }
                McmmPaths::Caustics => other_light::add::<false, WithoutCaustics, F>(
                    inputs,
                    &filter,
                    roulette_after,
                    band,
                ),
                McmmPaths::All => {
                    other_light::add::<false, DeltaFirst, F>(inputs, &filter, roulette_after, band)
                }
            },
            kernel::ALL_PATHS => {
                other_light::add::<true, Sum, F>(inputs, &filter, roulette_after, band)
            }
            _ => {
                let chains = Chains::new(technique, inputs, &filter);
                match technique.estimator {
                    SetEstimator::Ssmis => chains.run::<{ estimator::SSMIS }>(band),
                    SetEstimator::Tsmis => chains.run::<{ estimator::TSMIS }>(band),
                    SetEstimator::Mixture => chains.run::<{ estimator::MIXTURE }>(band),
                }
            }
        }
    }
}
