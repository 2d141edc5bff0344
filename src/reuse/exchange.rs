//! Shifts made once for two pixels: where taps are involutions, the shift of a pixel's sample to
//! its partner is what the partner's merge streams and what the pixel's own weights ask for.
//!
//! | slot of a pixel's chain and tap | meaning |
//! |---|---|
//! | 0–2 | F of the own sample at the partner; where T is undefined, 0 has the number of the reason |
//! | 3 | the density that \|∂T\| is a ratio of ([`StoredReservoir::arrived`]); 0: T is undefined |
//!
//! A slot is made where either of both pixels takes from the other, so whoever accepts a partner
//! finds both shifts: one that nobody made would be taken for one that failed, which is a bias
//! (three targets where the sum 9 becomes 11: `an_accepted_slot_has_both_shifts`).

use super::passes::{self, Round};
use super::policy::Policy;
use super::spatial::RoundInputs;
use super::taps::Tap;
use super::{Domain, MAX_NEIGHBOURS, Reuse, StoredReservoir};
use crate::counters::Counters;
use crate::pass::Band;
use crate::resampling::{Family, ShiftMap};

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Makes the shifts of round number `round` over a band.
    pub(crate) fn exchange(&self, round: u32, band: &mut Band<'_>) -> Counters {
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let read = RoundInputs::new(self, Round::new(&self.settings, round));
        // Constant weights never ask what a sample would be elsewhere.
        let leaves = self.settings.mis != Family::Constant;
        let slots = self.settings.neighbours as usize;
        let pixels = band.pixels();
        let out: &mut [[f32; 4]] = band.take(inputs.id(passes::SHIFTS));
        let mut map = self.domain.shift();
        for (local, pixel) in pixels.enumerate() {
            let first = local * chains * slots;
            let out = &mut out[first..first + chains * slots];
            out.fill([0.0; 4]);
            let records = &read.records[pixel.index as usize * chains..][..chains];
            if records[0].confidence() <= 0.0 {
                continue;
            }
            let own = read.similar(pixel.index);
            let takes = leaves && read.takes(pixel.index);
            let (mut taps, mut count) = ([Tap::default(); MAX_NEIGHBOURS], 0);
            read.offsets.visit(inputs, pixel, |tap| {
                let Some(tap) = tap else { return };
                let [here, there] = read.fit(&own, tap.index);
                if (takes && here) || (there && read.takes(tap.index)) {
                    taps[count] = tap;
                    count += 1;
                }
            });
            if count == 0 {
                continue;
            }
            let receiver = read.receiver(self.domain, pixel.index);
            for (chain, record) in records.iter().enumerate() {
                let Some(sample) = record.finished().sample else { continue };
                for tap in &taps[..count] {
                    let partner = read.receiver(self.domain, tap.index);
                    let slot = map.shift(&sample, &receiver, &partner);
                    out[chain * slots + tap.number as usize] = match slot {
                        Some(shifted) => D::Record::slot(&shifted),
                        None => [D::lost(&map), 0.0, 0.0, 0.0],
                    };
                }
            }
        }
        D::work(&map)
    }
}
