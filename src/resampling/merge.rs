//! Merging finished reservoirs of several domains into one: spatial and temporal reuse, for any
//! shift map and any MIS family.

use std::borrow::Borrow;

use super::mis::{Family, Pairwise};
use super::{Finished, Integrand, Measure, Reservoir, ShiftMap, Shifted};
use crate::math::rng::RandomSource;

/// A finished reservoir and the domain that it belongs to.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a, S, D, M> {
    /// Its sample, weight and confidence.
    pub finished: Finished<S, M>,
    /// p̂ᵢ(yᵢ): its own domain's target at its own sample; 0 without one.
    pub target: f32,
    /// Its domain.
    pub domain: &'a D,
}

/// The inputs of a merge besides the canonical one. A slice of [`Input`]s is the plain form; a host
/// that finds domains only when they are asked for (most merges ask for few) implements it for a
/// type of its own.
pub trait OtherInputs<S, D, M, I> {
    /// A domain, or a reference to one.
    type Domain<'s>: Borrow<D>
    where
        Self: 's;

    /// How many there are.
    fn count(&self) -> usize;

    /// Sample, weight and confidence of number `at`.
    fn finished(&self, at: usize) -> Finished<S, M>;

    /// p̂ of number `at` at its own sample, in its own domain.
    fn target(&self, at: usize) -> f32;

    /// The domain of number `at`.
    fn domain(&self, at: usize) -> Self::Domain<'_>;

    /// The shift of number `at`'s sample to the canonical domain, `Some(None)` if it is undefined,
    /// where the host knows it already: pixels that exchange their samples in pairs need each shift
    /// once for both.
    fn arriving(&self, _at: usize) -> Option<Option<Shifted<S, I>>> {
        None
    }

    /// p̂ of domain number `at` at T(y) times |∂T| for the canonical sample y, 0 if that shift is
    /// undefined, where the host knows it already.
    fn leaving(&self, _at: usize) -> Option<f32> {
        None
    }
}

impl<S: Copy, D, M: Measure, I> OtherInputs<S, D, M, I> for [Input<'_, S, D, M>] {
    type Domain<'s>
        = &'s D
    where
        Self: 's;

    fn count(&self) -> usize {
        self.len()
    }

    fn finished(&self, at: usize) -> Finished<S, M> {
        self[at].finished
    }

    fn target(&self, at: usize) -> f32 {
        self[at].target
    }

    fn domain(&self, at: usize) -> &D {
        self[at].domain
    }
}

/// An input's part in a merge, as it is streamed.
#[derive(Clone, Copy, Debug)]
pub struct Term<S, I> {
    /// 0 for the canonical input, else 1 + the place among the others.
    pub input: usize,
    /// mᵢ; cᵢ / C for families whose weights are known only after the selection.
    pub mis: f32,
    /// mᵢ Wᵢ |∂T|: times the integrand, the input's contribution.
    pub contribution: f32,
    /// wᵢ > 0.
    pub weight: f32,
    /// The sample in the canonical domain; `None` for the canonical input, which the caller knows.
    pub shifted: Option<Shifted<S, I>>,
}

/// The result of a merge.
#[derive(Clone, Copy, Debug)]
pub struct Merged<S, I, M> {
    /// The chosen sample with its new weight, and the sum of all confidences.
    pub finished: Finished<S, M>,
    /// p̂ of the chosen sample in the canonical domain; 0 without one.
    pub target: f32,
    /// Where it came from: 0 for the canonical input, else 1 + the place among the others.
    pub source: usize,
    /// The chosen sample's integrand; `None` if it came from the canonical input or there is none.
    pub integrand: Option<I>,
}

/// Merges `others` into `canonical`: wᵢ = mᵢ p̂(T yᵢ) Wᵢ |∂T|, Y ∝ w, W = Σw / p̂(Y) (Lin et al.
/// 2022, eq. 19, 22).
///
/// The others must have been accepted by their domains alone, never by their samples; one whose
/// shift fails stays in the MIS weights. `carry` is asked for each input that is streamed, which
/// those of weight 0 are not, others first, what it brings to `reservoir`, which must be empty.
///
/// Shifts from and to the others are only made where a weight needs them: none to an input while
/// the canonical has no sample, none at all for constant weights.
pub fn merge<T, R, M>(
    map: &mut T,
    family: Family,
    canonical: &Input<'_, T::Sample, T::Domain, M>,
    others: &(impl OtherInputs<T::Sample, T::Domain, M, T::Integrand> + ?Sized),
    reservoir: &mut R,
    random: &mut impl RandomSource,
    mut carry: impl FnMut(&Term<T::Sample, T::Integrand>) -> R::Carried,
) -> Merged<T::Sample, T::Integrand, M>
where
    T: ShiftMap,
    R: Reservoir<Sample = T::Sample>,
    M: Measure,
{
    let own = canonical.finished;
    let count = others.count();
    let other_confidence: f32 = (0..count).map(|at| others.finished(at).confidence).sum();
    let total = own.confidence + other_confidence;
    debug_assert!(own.confidence > 0.0, "the canonical input has confidence {}", own.confidence);
    debug_assert!(total.is_finite(), "the confidences sum to {total}: is there a cap?");
    let pairwise = Pairwise {
        canonical: own.confidence,
        others: other_confidence,
        defensive: family == Family::DefensivePairwise,
    };
    // The canonical's MIS weight, as far as it is known before its own turn.
    let mut canonical_mis = match family {
        _ if other_confidence <= 0.0 => 1.0,
        Family::Constant | Family::InverseCount | Family::Contribution => own.confidence / total,
        Family::Balance => 1.0,
        Family::Pairwise | Family::DefensivePairwise => pairwise.canonical_alone(),
    };
    let mut any_other = false;
    // Which input, and its shifted sample unless it is the canonical one.
    let mut source = 0;
    let mut shifted: Option<Shifted<T::Sample, T::Integrand>> = None;
    let mut any_selected = false;

    for at in 0..count {
        let Finished { sample, weight, confidence } = others.finished(at);
        if confidence <= 0.0 {
            continue;
        }
        if let Family::Pairwise | Family::DefensivePairwise = family
            && let Some(own_sample) = &own.sample
        {
            let from = leaving(map, others, at, own_sample, canonical.domain);
            any_other |= from > 0.0;
            canonical_mis += pairwise.canonical_part(confidence, from, canonical.target);
        }
        let Some(sample) = &sample else { continue };
        let arriving = others
            .arriving(at)
            .unwrap_or_else(|| map.shift(sample, others.domain(at).borrow(), canonical.domain));
        let Some(candidate) = arriving else { continue };
        let target = candidate.integrand.target();
        if target <= 0.0 {
            continue;
        }
        let from = others.target(at) / candidate.jacobian;
        let mis = match family {
            Family::Constant | Family::InverseCount | Family::Contribution => confidence / total,
            Family::Pairwise | Family::DefensivePairwise => {
                pairwise.other(confidence, from, target)
            }
            Family::Balance => {
                let mut rivals = 0.0;
                for rival in (0..count).filter(|&rival| rival != at) {
                    let rival_confidence = others.finished(rival).confidence;
                    if rival_confidence > 0.0 {
                        let rival = others.domain(rival);
                        let seen =
                            target_from(map, &candidate.sample, canonical.domain, rival.borrow());
                        rivals += rival_confidence / confidence * (seen / from);
                    }
                }
                rivals += own.confidence / confidence * (target / from);
                if from > 0.0 { 1.0 / (1.0 + rivals) } else { 0.0 }
            }
        };
        let contribution = mis * weight.get() * candidate.jacobian;
        let weight = contribution * target;
        // NaN is not passed over: the reservoir counts it.
        if weight != 0.0 {
            any_other = true;
            let term = Term { input: at + 1, mis, contribution, weight, shifted: Some(candidate) };
            if reservoir.stream(candidate.sample, weight, carry(&term), random) {
                (any_selected, source, shifted) = (true, at + 1, Some(candidate));
            }
        }
    }

    if let Some(sample) = own.sample {
        if family == Family::Balance && other_confidence > 0.0 {
            let mut rivals = 0.0;
            for rival in 0..count {
                let confidence = others.finished(rival).confidence;
                if confidence > 0.0 {
                    let seen = leaving(map, others, rival, &sample, canonical.domain);
                    any_other |= seen > 0.0;
                    rivals += confidence / own.confidence * (seen / canonical.target);
                }
            }
            canonical_mis = 1.0 / (1.0 + rivals);
        }
        if !any_other
            && !matches!(family, Family::Constant | Family::InverseCount | Family::Contribution)
        {
            // Nothing was merged: the shares sum to 1 but for rounding, and the canonical must come
            // out as it went in.
            canonical_mis = 1.0;
        }
        let contribution = canonical_mis * own.weight.get();
        let weight = contribution * canonical.target;
        if weight != 0.0 {
            let term = Term { input: 0, mis: canonical_mis, contribution, weight, shifted: None };
            if reservoir.stream(sample, weight, carry(&term), random) {
                (any_selected, source, shifted) = (true, 0, None);
            }
            if !any_other && canonical_mis == 1.0 {
                return Merged {
                    finished: Finished { confidence: total, ..own },
                    target: canonical.target,
                    source: 0,
                    integrand: None,
                };
            }
        }
    }

    let nothing =
        Merged { finished: Finished::empty(total), target: 0.0, source: 0, integrand: None };
    if !any_selected {
        return nothing;
    }
    let target = shifted.map_or(canonical.target, |s| s.integrand.target());
    let scale = match family {
        Family::InverseCount | Family::Contribution if other_confidence > 0.0 => {
            let sample = shifted.map_or(own.sample, |s| Some(s.sample));
            // p̂ of the selected sample in the domain that it comes from, as seen from here.
            let of_source = match (&shifted, source.checked_sub(1)) {
                (Some(shifted), Some(at)) => others.target(at) / shifted.jacobian,
                _ => target,
            };
            let mut reach = 0.0;
            let mut sum = 0.0;
            let mut reach_of = |confidence: f32, from: f32| {
                if from > 0.0 {
                    reach += confidence;
                    // Ratios of targets: sums of huge targets would overflow.
                    sum += confidence * (from / of_source);
                }
            };
            reach_of(own.confidence, target);
            for at in 0..count {
                let confidence = others.finished(at).confidence;
                if source == at + 1 {
                    reach_of(confidence, of_source);
                } else if let Some(sample) = &sample
                    && confidence > 0.0
                {
                    let from = if source == 0 {
                        leaving(map, others, at, sample, canonical.domain)
                    } else {
                        target_from(map, sample, canonical.domain, others.domain(at).borrow())
                    };
                    reach_of(confidence, from);
                }
            }
            if !any_other && reach == own.confidence {
                // As above: nothing was merged.
                return Merged {
                    finished: Finished { confidence: total, ..own },
                    target,
                    ..nothing
                };
            }
            if family == Family::InverseCount { total / reach } else { total / sum }
        }
        _ => 1.0,
    };
    let finished = reservoir.finish_scaled(scale, target, total);
    if finished.sample.is_none() {
        // W is 0 or infinite in f32.
        return nothing;
    }
    Merged { finished, target, source, integrand: shifted.map(|s| s.integrand) }
}

/// Merges last frame's reservoir into this frame's, its confidence capped at `cap` times the
/// canonical's.
///
/// Without a cap a chain of merges converges to a wrong picture: old samples outweigh all new ones.
/// The cap is in frames; a paper's M.
pub fn merge_history<T, R, M>(
    map: &mut T,
    (family, cap): (Family, f32),
    canonical: &Input<'_, T::Sample, T::Domain, M>,
    previous: &Input<'_, T::Sample, T::Domain, M>,
    reservoir: &mut R,
    random: &mut impl RandomSource,
    carry: impl FnMut(&Term<T::Sample, T::Integrand>) -> R::Carried,
) -> Merged<T::Sample, T::Integrand, M>
where
    T: ShiftMap,
    R: Reservoir<Sample = T::Sample>,
    M: Measure,
{
    let confidence = previous.finished.confidence.min(cap * canonical.finished.confidence);
    let capped = Input {
        finished: Finished { confidence, ..previous.finished },
        target: previous.target,
        domain: previous.domain,
    };
    merge(map, family, canonical, [capped].as_slice(), reservoir, random, carry)
}

/// p̂ of input number `at` at the canonical sample, as the canonical domain sees it.
#[inline]
fn leaving<T: ShiftMap, M>(
    map: &mut T,
    others: &(impl OtherInputs<T::Sample, T::Domain, M, T::Integrand> + ?Sized),
    at: usize,
    own_sample: &T::Sample,
    canonical: &T::Domain,
) -> f32 {
    others
        .leaving(at)
        .unwrap_or_else(|| target_from(map, own_sample, canonical, others.domain(at).borrow()))
}

/// p̂ of `domain` at T(y) times |∂T|: its target as the canonical domain sees it; 0 where T is
/// undefined.
#[inline]
fn target_from<T: ShiftMap>(
    map: &mut T,
    sample: &T::Sample,
    canonical: &T::Domain,
    domain: &T::Domain,
) -> f32 {
    map.shift(sample, canonical, domain).map_or(0.0, |s| s.integrand.target() * s.jacobian)
}
