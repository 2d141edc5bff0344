//! Shading: what a finished reservoir shows of its pixel.

use glam::Vec3;

use super::passes::{self, Keys};
use super::policy::Policy;
use super::{Control, Domain, Reuse, StoredReservoir};
use crate::counters::Counters;
use crate::pass::{Band, PrimaryHit};
use crate::path::finite_or_counted;
use crate::plan::Plan;
use crate::resampling::{Estimator, Merged, Selected, SelectedState};

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Shades what temporal reuse left, where there is no spatial pass.
    pub(crate) fn shade(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let records = inputs.at(Keys::<D::Record>::RESERVOIRS);
        let controls: &[Control] = inputs.some(passes::CONTROLS);
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        for (pixel, out) in pixels.zip(radiance) {
            let mut sum = Vec3::ZERO;
            let first = pixel.index as usize * chains;
            // Whether a surface scatters is the same for all chains.
            let scatters = records[first].confidence() > 0.0;
            if let Some(hit) = hits[pixel.index as usize].get().filter(|_| scatters) {
                let receiver = (!P::CONTROL).then(|| self.domain.receiver(hit, pixel));
                for at in first..first + chains {
                    let shown = match &receiver {
                        None => controls[at].estimate(),
                        Some(receiver) => {
                            let record = &records[at];
                            let merged = Merged {
                                finished: record.finished(),
                                target: record.target(),
                                source: 0,
                                integrand: None,
                            };
                            let mut bits = record.policy_bits();
                            self.shown(receiver, &merged, &mut bits, &mut counters)
                        }
                    };
                    sum += finite_or_counted(shown, &mut counters);
                }
            }
            *out = self.mean(sum).to_array();
        }
        counters
    }

    /// The mean over chains of what the parts of each show together.
    #[inline]
    pub(super) fn mean(&self, sum: Vec3) -> Vec3 {
        sum / self.domain.frame().shot.chains() as f32
    }

    /// F(Y) V W of a finished reservoir; a ray where the policy asks for one, whose outcome `bits`
    /// then holds.
    #[inline]
    pub(super) fn shown(
        &self,
        receiver: &D::Receiver,
        merged: &Merged<D::Sample, Vec3, D::Measure>,
        bits: &mut u16,
        counters: &mut Counters,
    ) -> Vec3 {
        let Some(sample) = merged.finished.sample else {
            counters.shadow_rays_saved += u64::from(P::SHADES_BY_RAY);
            return Vec3::ZERO;
        };
        let weight = merged.finished.weight.get();
        if let Some(visibility) = self.policy.visibility(*bits) {
            // The integrand is known already where a neighbour's sample was chosen.
            let integrand = merged
                .integrand
                .or_else(|| Some(D::integrand(&self.domain.sight(receiver, sample)?)))
                .unwrap_or(Vec3::ZERO);
            return Selected::radiance(&SelectedState { integrand, visibility, weight });
        }
        let Some(sight) = self.domain.sight(receiver, sample) else { return Vec3::ZERO };
        let visible = match self.policy.outcome(*bits) {
            Some(visible) => {
                counters.shadow_rays_saved += 1;
                visible
            }
            None => {
                let visible = self.domain.sees(receiver, &sight, counters);
                *bits = self.policy.traced(*bits, visible);
                visible
            }
        };
        let (integrand, visibility) = (D::integrand(&sight), f32::from(u8::from(visible)));
        Selected::radiance(&SelectedState { integrand, visibility, weight })
    }
}
