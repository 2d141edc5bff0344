//! Spatial reuse: each pixel merges the reservoirs of a few neighbours with similar surfaces into
//! its own, round after round; the last round also shades.

use bytemuck::Zeroable;

use glam::Vec3;

use super::passes::{self, Keys, Round};
use super::policy::Policy;
use super::surfaces::Similar;
use super::taps::{Offsets, Tap};
use super::{Control, Domain, InputOf, MAX_NEIGHBOURS, Reuse, StoredReservoir, Taps, input};
use crate::counters::Counters;
use crate::math::rng::{Purpose, Stream};
use crate::pass::{Band, Pixel, PrimaryHit};
use crate::path::finite_or_counted;
use crate::plan::Plan;
use crate::resampling::{
    ControlVariate, DecoupledState, Estimator, Finished, Integrand, OtherInputs, Plain, Reservoir,
    Shifted, Term, WithRadiance, WithVisibility, merge,
};

/// The reservoir of a merge, which averages visibility and sums contributions.
type Rich<S> = WithRadiance<WithVisibility<Plain<S>>>;

/// What all pixels of a round read.
pub(super) struct RoundInputs<'r, R> {
    pub(super) records: &'r [R],
    pub(super) hits: &'r [PrimaryHit],
    normals: &'r [u32],
    pub(super) offsets: Offsets,
    /// A pixel of more confidence than this goes without its neighbours. Confidence depends on
    /// where surfaces were found again, and on no sample.
    mature: f32,
    /// Whether two surfaces must fit from both sides.
    mutual: bool,
    /// Shifts that are known already; none where merges make their own.
    shifts: &'r [[f32; 4]],
    chains: usize,
    /// Taps of a pixel.
    taps: usize,
}

impl<'r, R: StoredReservoir> RoundInputs<'r, R> {
    /// Those of a round.
    pub(super) fn new<D: Domain<Record = R>, P: Policy>(
        reuse: &'r Reuse<'_, D, P>,
        round: Round,
    ) -> Self {
        let (inputs, settings) = (reuse.domain.frame(), &reuse.settings);
        let shifts = inputs.plan.id(passes::SHIFTS);
        Self {
            records: inputs.at(Keys::<R>::at(round.from)),
            hits: inputs.read(Plan::HITS),
            normals: inputs.at(passes::NORMALS),
            offsets: Offsets::new(inputs, settings, round.number),
            mature: match passes::mature(settings, inputs.plan.still) {
                0 => f32::INFINITY,
                // The canonical sample of this frame counts as one more.
                frames => frames as f32,
            },
            mutual: settings.taps == Taps::Pairs,
            shifts: shifts.map_or(&[], |id| inputs.read(id)),
            chains: reuse.chains,
            taps: settings.neighbours as usize,
        }
    }

    /// Whether a pixel takes from neighbours at all.
    #[inline]
    pub(super) fn takes(&self, index: u32) -> bool {
        let confidence = self.records[index as usize * self.chains].confidence();
        confidence > 0.0 && confidence <= self.mature
    }

    /// Comparisons with the surface at a pixel.
    #[inline]
    pub(super) fn similar(&self, index: u32) -> Similar<'r> {
        Similar::new(self.hits, self.normals, index)
    }

    /// Whether the pixel whose surface is `own` may take from another one, and that one from it.
    #[inline]
    pub(super) fn fit(&self, own: &Similar<'_>, other: u32) -> [bool; 2] {
        let scatters = self.records[other as usize * self.chains].confidence() > 0.0;
        let [here, there] = own.both_ways(other);
        let both = here && there;
        [here, there].map(|side| scatters && if self.mutual { both } else { side })
    }

    /// The receiver at a pixel with confidence.
    #[inline]
    pub(super) fn receiver<D: Domain>(&self, domain: &D, index: u32) -> D::Receiver {
        let width = domain.frame().shot.size[0];
        let hit = self.hits[index as usize].get().expect("a surface, since it has confidence");
        domain.receiver(hit, Pixel { index, x: index % width, y: index / width })
    }

    /// Where the shift of a pixel's chain to the partner of a tap is.
    #[inline]
    pub(super) fn slot(&self, index: u32, chain: usize, tap: u32) -> usize {
        (index as usize * self.chains + chain) * self.taps + tap as usize
    }
}

/// The taps of a pixel that fit.
struct Found<'r, D: Domain> {
    domain: &'r D,
    read: &'r RoundInputs<'r, D::Record>,
    pixel: u32,
    taps: [Tap; MAX_NEIGHBOURS],
    count: usize,
}

/// The neighbours' reservoirs of one chain.
struct Neighbours<'f, 'r, D: Domain> {
    found: &'f Found<'r, D>,
    chain: usize,
}

impl<'r, D: Domain> Neighbours<'_, 'r, D> {
    fn record(&self, at: usize) -> &'r D::Record {
        let Found { read, taps, .. } = self.found;
        &read.records[taps[at].index as usize * read.chains + self.chain]
    }
}

impl<D: Domain> OtherInputs<D::Sample, D::Receiver, D::Measure, Vec3> for Neighbours<'_, '_, D> {
    // A receiver is made when a weight asks for it. (Tried and slower: to keep it for other chains;
    // an array of eight that are mostly empty costs more to make.)
    type Domain<'s>
        = D::Receiver
    where
        Self: 's;

    #[inline]
    fn count(&self) -> usize {
        self.found.count
    }

    #[inline]
    fn finished(&self, at: usize) -> Finished<D::Sample, D::Measure> {
        self.record(at).finished()
    }

    #[inline]
    fn target(&self, at: usize) -> f32 {
        self.record(at).target()
    }

    #[inline]
    fn domain(&self, at: usize) -> D::Receiver {
        let Found { domain, read, taps, .. } = self.found;
        read.receiver(*domain, taps[at].index)
    }

    #[inline]
    fn arriving(&self, at: usize) -> Option<Option<Shifted<D::Sample, Vec3>>> {
        let Found { read, taps, .. } = self.found;
        let Tap { index, number, .. } = taps[at];
        let slot = read.shifts.get(read.slot(index, self.chain, number))?;
        Some(self.record(at).arrived(*slot))
    }

    #[inline]
    fn leaving(&self, at: usize) -> Option<f32> {
        let Found { read, pixel, taps, .. } = self.found;
        let slot = read.shifts.get(read.slot(*pixel, self.chain, taps[at].number))?;
        let record = &read.records[*pixel as usize * read.chains + self.chain];
        let there = record.arrived(*slot);
        Some(there.map_or(0.0, |there| there.integrand.target() * there.jacobian))
    }
}

/// One chain of a pixel before a merge.
struct Own<'r, D: Domain> {
    record: D::Record,
    control: Control,
    receiver: &'r D::Receiver,
}

/// One chain of a pixel after a merge: what it keeps, and what it shows.
struct Outcome<R> {
    record: R,
    control: Control,
    shown: Vec3,
}

/// What the rays of one merge said.
struct Seen<'c> {
    /// By input: whether its sample is seen from here.
    inputs: [bool; MAX_NEIGHBOURS + 1],
    /// The own sample's policy bits, after a ray if one was needed.
    own_bits: u16,
    counters: &'c mut Counters,
}

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Runs round number `round` over a band.
    pub(crate) fn spatial(&self, round: u32, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let round = Round::new(&self.settings, round);
        let read = RoundInputs::new(self, round);
        let pixels = band.pixels();
        let out: &mut [D::Record] =
            band.take_some(round.to.map(|place| inputs.id(Keys::<D::Record>::at(place))));
        let (from, to) = round.controls();
        // A round that updates the estimates in place finds them in what it writes.
        let in_place = to == Some(from);
        let controls: &[Control] =
            if P::CONTROL && !in_place { inputs.at(from.control_key()) } else { &[] };
        let control_out: &mut [Control] = match to {
            Some(to) if P::CONTROL => band.take(inputs.id(to.control_key())),
            _ => &mut [],
        };
        let radiance: &mut [[f32; 3]] = band.take_some(round.last.then_some(Plan::RADIANCE));
        let mut map = self.domain.shift();
        for (local, pixel) in pixels.enumerate() {
            let first = pixel.index as usize * chains;
            let own = local * chains..(local + 1) * chains;
            // Whether a surface scatters is the same for all chains.
            let scatters = read.records[first].confidence() > 0.0;
            let Some(hit) = read.hits[pixel.index as usize].get().filter(|_| scatters) else {
                if let Some(out) = out.get_mut(own.clone()) {
                    out.fill(D::Record::zeroed());
                }
                if let Some(out) = control_out.get_mut(own) {
                    out.fill(Control::default());
                }
                if let Some(out) = radiance.get_mut(local) {
                    *out = [0.0; 3];
                }
                continue;
            };
            let receiver = self.domain.receiver(hit, pixel);
            let mut found = Found {
                domain: self.domain,
                read: &read,
                pixel: pixel.index,
                taps: [Tap::default(); MAX_NEIGHBOURS],
                count: 0,
            };
            if read.takes(pixel.index) {
                self.find(pixel, &mut found, &mut counters);
            }
            let mut sum = Vec3::ZERO;
            for (chain, at) in own.enumerate() {
                let control = match (P::CONTROL, in_place) {
                    (false, _) => Control::default(),
                    (true, false) => controls[first + chain],
                    (true, true) => control_out[at],
                };
                let own =
                    Own::<D> { record: read.records[first + chain], control, receiver: &receiver };
                let others = Neighbours { found: &found, chain };
                let mut random = self.stream(pixel, Purpose::Selection, 16 + round.number, chain);
                let outcome = self.merge_neighbours(
                    round,
                    &own,
                    &others,
                    &mut map,
                    &mut random,
                    &mut counters,
                );
                if let Some(out) = out.get_mut(at) {
                    *out = outcome.record;
                }
                if let Some(out) = control_out.get_mut(at) {
                    *out = outcome.control;
                }
                if round.last {
                    sum += finite_or_counted(outcome.shown, &mut counters);
                }
            }
            if let Some(out) = radiance.get_mut(local) {
                *out = self.mean(sum).to_array();
            }
        }
        counters + D::work(&map)
    }

    /// Finds the taps of a pixel whose surfaces fit.
    #[inline]
    fn find(&self, pixel: Pixel, found: &mut Found<'_, D>, counters: &mut Counters) {
        let read = found.read;
        let own = read.similar(pixel.index);
        read.offsets.visit(self.domain.frame(), pixel, |tap| {
            match tap.filter(|tap| read.fit(&own, tap.index)[0]) {
                Some(tap) => {
                    found.taps[found.count] = tap;
                    found.count += 1;
                }
                None => counters.reuse_rejected += 1,
            }
        });
        counters.spatial_merges += (found.count * self.chains) as u64;
    }

    /// Merges one chain of a pixel with that of its neighbours.
    #[inline]
    fn merge_neighbours(
        &self,
        round: Round,
        own: &Own<'_, D>,
        others: &Neighbours<'_, '_, D>,
        map: &mut D::Shift,
        random: &mut Stream,
        counters: &mut Counters,
    ) -> Outcome<D::Record> {
        let decoupled = round.last && self.settings.decoupled;
        let canonical = input::<D>(&own.record, own.receiver);
        let mut seen = Seen {
            inputs: [false; MAX_NEIGHBOURS + 1],
            own_bits: own.record.policy_bits(),
            counters,
        };
        let mut reservoir = Rich::default();
        let merged =
            merge(map, self.settings.mis, &canonical, others, &mut reservoir, random, |term| {
                self.carried(decoupled, own, &canonical, term, &mut seen)
            });
        seen.counters.weights_rejected += u64::from(reservoir.rejected());

        let average = reservoir.inner().visibility();
        let (age, bits) = self.inherited_from(decoupled, own, others, merged.source, &seen);
        let mut bits = self.policy.averaged(bits, average);
        let mut control = own.control;
        if P::CONTROL {
            // The receiver has not changed since C̄ was made.
            let share = canonical.finished.confidence / merged.finished.confidence;
            let correction = self.correction(share, own.control, &canonical);
            let state = DecoupledState { radiance: reservoir.radiance(), correction };
            let estimate = finite_or_counted(ControlVariate::radiance(&state), seen.counters);
            let visible = match merged.source {
                0 => own.control.visible(),
                source => seen.inputs[source],
            };
            control = Control::new(estimate, visible);
        }
        let shown = match (round.last, P::CONTROL) {
            (false, _) => Vec3::ZERO,
            (true, true) => control.estimate(),
            (true, false) if decoupled => reservoir.radiance(),
            (true, false) => self.shown(own.receiver, &merged, &mut bits, seen.counters),
        };
        let record = D::Record::new(&merged.finished, merged.target, age, bits);
        Outcome { record, control, shown }
    }

    /// What an input brings to the reservoir: its visibility, and its contribution where terms are
    /// shown.
    #[inline]
    fn carried(
        &self,
        decoupled: bool,
        own: &Own<'_, D>,
        canonical: &InputOf<'_, D>,
        term: &Term<D::Sample, Vec3>,
        seen: &mut Seen<'_>,
    ) -> (((), f32), Vec3) {
        let shows = P::CONTROL || decoupled;
        let mut shown = Vec3::ZERO;
        let mut visibility = self.policy.average(own.record.policy_bits());
        if let Some(shifted) = &term.shifted {
            let traced = P::TRACES_TERMS || (decoupled && !D::IN_TARGET);
            let visible = !traced || self.look(own.receiver, shifted.sample, seen.counters).1;
            seen.inputs[term.input] = visible;
            visibility = f32::from(u8::from(visible));
            if shows && visible {
                shown = shifted.integrand * term.contribution;
            }
        } else if shows {
            let visible = if P::CONTROL {
                own.control.visible()
            } else if D::IN_TARGET {
                true
            } else {
                self.policy.outcome(seen.own_bits).unwrap_or_else(|| {
                    let sample = canonical.finished.sample;
                    let visible = sample
                        .is_some_and(|sample| self.look(own.receiver, sample, seen.counters).1);
                    seen.own_bits = self.policy.traced(seen.own_bits, visible);
                    visible
                })
            };
            seen.inputs[0] = visible;
            if visible {
                shown = self.own_integrand(canonical) * term.contribution;
            }
        }
        (((), visibility), shown)
    }

    /// Age and policy bits of the sample that a merge chose.
    #[inline]
    fn inherited_from(
        &self,
        decoupled: bool,
        own: &Own<'_, D>,
        others: &Neighbours<'_, '_, D>,
        source: usize,
        seen: &Seen<'_>,
    ) -> (u32, u16) {
        if source == 0 {
            return (own.record.age(), seen.own_bits);
        }
        let other = others.record(source - 1);
        let bits = if decoupled {
            self.policy.traced(other.policy_bits(), seen.inputs[source])
        } else {
            self.policy.pixels_away(other.policy_bits(), others.found.taps[source - 1].distance)
        };
        (other.age(), bits)
    }
}
