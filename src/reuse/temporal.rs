//! Temporal reuse: the history of the pixel that saw the same surface one frame ago is merged into
//! this frame's reservoir, its confidence capped.

use std::marker::PhantomData;

use glam::Vec3;

use super::passes::{self, Keys};
use super::policy::Policy;
use super::surfaces::reproject;
use super::{Control, Domain, InputOf, Reuse, Settings, StoredReservoir, input};
use crate::counters::Counters;
use crate::math::rng::{Purpose, RandomSource, Stream};
use crate::pass::{Band, Pixel, PrimaryHit};
use crate::path::finite_or_counted;
use crate::plan::Plan;
use crate::resampling::{
    ControlVariate, DecoupledState, Estimator, Finished, Input, Plain, Reservoir, ShiftMap,
    Shifted, WithRadiance, WithVisibility, merge_history,
};

/// Side of the square in which duplicates are looked for: that of *ReSTIR PT Enhanced* (2026).
pub(super) const AROUND: u32 = 17;
/// Number of pixels of the square that are looked at; the paper looks at all.
const LOOKS: u32 = 16;
/// Round of their numbers, beside those of spatial rounds.
const FIRST_LOOK: u32 = 64;

/// A sample with its target: where two frames have the same receiver, targets need not be evaluated
/// again.
#[derive(Clone, Copy)]
struct Known<S> {
    sample: S,
    target: f32,
}

/// The identity between a pixel and itself one frame ago.
struct Same<S>(PhantomData<S>);

impl<S: Copy> ShiftMap for Same<S> {
    type Sample = Known<S>;
    type Domain = ();
    type Integrand = f32;
    type Stratum = ();

    #[inline]
    fn shift(&mut self, sample: &Known<S>, (): &(), (): &()) -> Option<Shifted<Known<S>, f32>> {
        Some(Shifted { sample: *sample, integrand: sample.target, jacobian: 1.0 })
    }

    fn stratum(&self, _: &Known<S>) {}
}

/// One chain of a pixel in this frame, and what it was in the previous one.
struct Frames<'r, D: Domain> {
    /// The most confidence that the history may have, in multiples of the canonical's.
    cap: f32,
    record: D::Record,
    receiver: &'r D::Receiver,
    control: Control,
    previous: D::Record,
    receiver_before: &'r D::Receiver,
    control_before: Control,
}

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Runs the pass over a band.
    pub(crate) fn temporal(&self, band: &mut Band<'_>) -> Counters {
        // A control variate needs the shifted integrands, not the targets alone.
        if self.domain.frame().plan.still && !P::CONTROL {
            self.temporal_still(band)
        } else {
            self.temporal_moving(band)
        }
    }

    /// Where nothing moves: the same pixel, the same receiver, the targets that are stored.
    fn temporal_still(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let history = passes::history::<D::Record>(inputs);
        let pixels = band.pixels();
        let records: &mut [D::Record] = band.take(inputs.id(Keys::<D::Record>::RESERVOIRS));
        for (local, pixel) in pixels.enumerate() {
            let first = pixel.index as usize * chains;
            for chain in 0..chains {
                let record = &mut records[local * chains + chain];
                let previous = self.aged(history[first + chain]);
                if record.confidence() == 0.0 || previous.confidence() == 0.0 {
                    continue;
                }
                counters.temporal_merges += 1;
                let input = |record: &D::Record| {
                    let Finished { sample, weight, confidence } = record.finished();
                    let target = record.target();
                    let sample = sample.map(|sample| Known { sample, target });
                    Input { finished: Finished { sample, weight, confidence }, target, domain: &() }
                };
                let mut reservoir = WithVisibility::<Plain<Known<D::Sample>>>::default();
                let averages =
                    [&*record, &previous].map(|record| self.policy.average(record.policy_bits()));
                let merged = merge_history(
                    &mut Same(PhantomData),
                    (
                        self.settings.temporal_mis,
                        self.cap(history, [pixel; 2], (first + chain, chain)),
                    ),
                    &input(record),
                    &input(&previous),
                    &mut reservoir,
                    &mut self.stream(pixel, Purpose::Selection, 1, chain),
                    |term| ((), averages[term.input]),
                );
                counters.weights_rejected += u64::from(reservoir.rejected());
                let Finished { sample, weight, confidence } = merged.finished;
                let sample = sample.map(|known| known.sample);
                let finished = Finished { sample, weight, confidence };
                let average = reservoir.visibility();
                let (age, bits) = self.inherited(record, &previous, merged.source, average);
                *record = D::Record::new(&finished, merged.target, age, bits);
            }
        }
        counters
    }

    /// The general form: reprojection, and shifts between the two frames' receivers.
    fn temporal_moving(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let history = passes::history::<D::Record>(inputs);
        let history_controls = passes::history_controls(inputs);
        let pixels = band.pixels();
        let records: &mut [D::Record] = band.take(inputs.id(Keys::<D::Record>::RESERVOIRS));
        let controls: &mut [Control] = band.take_some(inputs.plan.id(passes::CONTROLS));
        let mut map = self.domain.shift();
        for (local, pixel) in pixels.enumerate() {
            let own = local * chains..(local + 1) * chains;
            let Some(hit) = hits[pixel.index as usize].get() else { continue };
            if records[own.start].confidence() == 0.0 {
                continue;
            }
            let receiver = self.domain.receiver(hit, pixel);
            let receiver_before;
            let (there, before) = if inputs.plan.still {
                (pixel, &receiver)
            } else {
                let found = reproject(inputs, &hit, self.domain.normal(&receiver), pixel);
                let Some((there, hit)) = found else {
                    counters.reuse_rejected += 1;
                    continue;
                };
                receiver_before = self.domain.receiver_before(hit, there);
                match &receiver_before {
                    Some(before) => (there, before),
                    None => continue,
                }
            };
            for (chain, at) in own.enumerate() {
                let from = there.index as usize * chains + chain;
                let previous = self.aged(history[from]);
                if previous.confidence() == 0.0 {
                    continue;
                }
                counters.temporal_merges += 1;
                let mut frames = Frames::<D> {
                    cap: self.cap(history, [pixel, there], (from, chain)),
                    record: records[at],
                    receiver: &receiver,
                    control: Control::default(),
                    previous,
                    receiver_before: before,
                    control_before: Control::default(),
                };
                if P::CONTROL {
                    (frames.control, frames.control_before) =
                        (controls[at], history_controls[from]);
                }
                let mut random = self.stream(pixel, Purpose::Selection, 1, chain);
                let (record, control) =
                    self.merge_frames(&frames, &mut map, &mut random, &mut counters);
                records[at] = record;
                if P::CONTROL {
                    controls[at] = control;
                }
            }
        }
        counters + D::work(&map)
    }

    /// Merges one chain of a pixel with what it was one frame ago: the record and the estimate
    /// after it.
    #[inline]
    fn merge_frames(
        &self,
        frames: &Frames<'_, D>,
        map: &mut D::Shift,
        random: &mut Stream,
        counters: &mut Counters,
    ) -> (D::Record, Control) {
        let still = self.domain.frame().plan.still;
        let cap = frames.cap;
        let canonical = input::<D>(&frames.record, frames.receiver);
        let past = input::<D>(&frames.previous, frames.receiver_before);
        let mut reservoir = WithRadiance::<WithVisibility<Plain<D::Sample>>>::default();
        let averages = [&frames.record, &frames.previous]
            .map(|record| self.policy.average(record.policy_bits()));
        // V of the previous sample here and now, once it was asked for.
        let mut past_visible = false;
        let merged = merge_history(
            map,
            (self.settings.temporal_mis, cap),
            &canonical,
            &past,
            &mut reservoir,
            random,
            |term| {
                let mut shown = Vec3::ZERO;
                if P::CONTROL {
                    let (integrand, visible) = match &term.shifted {
                        None => (self.own_integrand(&canonical), frames.control.visible()),
                        Some(shifted) => {
                            past_visible = if still {
                                frames.control_before.visible()
                            } else {
                                self.look(frames.receiver, shifted.sample, counters).1
                            };
                            (shifted.integrand, past_visible)
                        }
                    };
                    if visible {
                        shown = integrand * term.contribution;
                    }
                }
                (((), averages[term.input]), shown)
            },
        );
        counters.weights_rejected += u64::from(reservoir.rejected());
        let average = reservoir.inner().visibility();
        let (age, bits) = self.inherited(&frames.record, &frames.previous, merged.source, average);
        let mut control = Control::default();
        if P::CONTROL {
            let confidence = past.finished.confidence.min(cap);
            let share = confidence / (confidence + canonical.finished.confidence);
            let correction = self.correction(share, frames.control_before, &past);
            let state = DecoupledState { radiance: reservoir.radiance(), correction };
            let estimate = finite_or_counted(ControlVariate::radiance(&state), counters);
            let visible = if merged.source == 0 { frames.control.visible() } else { past_visible };
            control = Control::new(estimate, visible);
        }
        (D::Record::new(&merged.finished, merged.target, age, bits), control)
    }

    /// a (C̄ − F̃): what the estimate kept with an input corrects. F̃ = F V W is the input's own
    /// contribution at the receiver where C̄ was made, so the difference has mean 0.
    pub(super) fn correction(&self, share: f32, control: Control, input: &InputOf<'_, D>) -> Vec3 {
        let contribution = if control.visible() {
            self.own_integrand(input) * input.finished.weight.get()
        } else {
            Vec3::ZERO
        };
        share * (control.estimate() - contribution)
    }

    /// Age and policy bits after a temporal merge whose averaged visibility is `average`.
    #[inline]
    fn inherited(
        &self,
        record: &D::Record,
        previous: &D::Record,
        source: usize,
        average: f32,
    ) -> (u32, u16) {
        let (age, bits) = match source {
            0 => (record.age(), record.policy_bits()),
            _ => (previous.age() + 1, self.policy.a_frame_later(previous.policy_bits())),
        };
        (age, self.policy.averaged(bits, average))
    }

    /// How much the history of a pixel counts at most: the cap, or less where some of [`LOOKS`]
    /// pixels around it, in a square of [`AROUND`] pixels, carry its sample too. That depends on
    /// the samples, so it is biased.
    #[inline]
    fn cap(
        &self,
        history: &[D::Record],
        [pixel, there]: [Pixel; 2],
        (from, chain): (usize, usize),
    ) -> f32 {
        let Settings { cap, duplicates, .. } = self.settings;
        let cap = cap as f32;
        if duplicates == 0.0 {
            return cap;
        }
        let [width, height] = self.domain.frame().shot.size;
        let mut random = self.stream(pixel, Purpose::Neighbours, FIRST_LOOK, chain);
        let mut near = |at: u32, size: u32| {
            // Places beyond the picture's edge count as those at the edge.
            let at = (at + random.index(AROUND)).saturating_sub(AROUND / 2);
            at.min(size - 1)
        };
        let mut same = 0;
        for _ in 0..LOOKS {
            let (x, y) = (near(there.x, width), near(there.y, height));
            let other = (y * width + x) as usize * self.chains + chain;
            same += u32::from(other != from && history[other].is_same(&history[from]));
        }
        let share = same as f32 / LOOKS as f32;
        (cap * (1.0 - duplicates * share)).floor()
    }

    /// A record of the previous frame, without its sample where that is too old.
    #[inline]
    fn aged(&self, previous: D::Record) -> D::Record {
        let max_age = self.settings.max_age;
        if max_age > 0 && previous.age() >= max_age { previous.emptied() } else { previous }
    }
}
