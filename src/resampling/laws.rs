//! The traits' laws as checks for any implementation: each panics with what it found.
//!
//! They are exact: no statistics. Give them a handful of samples and domains that meet all the
//! cases of the map or reservoir.

use std::fmt::Debug;

use super::{Integrand, Mutator, Reservoir, ShiftMap};
use crate::math::rng::RandomSource;

/// A random source that says what it is told: `choose` takes its answers in turn, then refuses.
#[derive(Clone, Debug)]
struct Script<'a> {
    answers: &'a [bool],
    at: usize,
    /// Every question's probability.
    asked: Vec<f64>,
}

impl RandomSource for Script<'_> {
    fn choose(&mut self, weight: f32, total: f32) -> bool {
        self.asked.push(f64::from(weight) / f64::from(total));
        let answer = self.answers.get(self.at).copied().unwrap_or(false);
        self.at += 1;
        // What is certain is not decided by a script.
        weight > 0.0 && (answer || weight >= total)
    }

    fn index(&mut self, n: u32) -> u32 {
        n / 2
    }

    fn uniform(&mut self) -> f32 {
        0.5
    }
}

/// Laws 1 to 4 of [`Reservoir`], with `carried` as what each of the samples brings.
///
/// # Panics
/// If a law is broken.
pub fn check_reservoir<R>(samples: &[R::Sample], carried: R::Carried)
where
    R: Reservoir,
    R::Sample: PartialEq + Debug,
{
    let weights: Vec<f32> = (0..samples.len()).map(|i| [3.0, 0.0, 0.5, 2.0][i % 4]).collect();
    // Law 1: candidate i is selected if it is taken and no later one is: Π gives wᵢ / Σw for any
    // weights.
    for chosen in (0..samples.len()).filter(|&i| weights[i] > 0.0) {
        let mut reservoir = R::default();
        let mut probability = 1.0;
        for (i, sample) in samples.iter().enumerate() {
            let mut script = Script { answers: &[i == chosen], at: 0, asked: Vec::new() };
            let before = reservoir.selected();
            let taken = reservoir.stream(*sample, weights[i], carried, &mut script);
            if weights[i] == 0.0 {
                assert!(!taken && reservoir.selected() == before, "law 2: weight 0 was selected");
                continue;
            }
            let p = script.asked.first().copied().unwrap_or(1.0);
            if i == chosen {
                probability *= p;
            } else if i > chosen {
                probability *= 1.0 - p;
            }
        }
        let expected = f64::from(weights[chosen] / weights.iter().sum::<f32>());
        assert!(
            (probability - expected).abs() < 1e-6,
            "law 1: candidate {chosen} is selected with {probability}, not {expected}"
        );
        assert_eq!(reservoir.selected(), Some(samples[chosen]), "law 1");
        let finished = reservoir.finish::<super::Counting>(0.25, 3.0);
        let expected = weights.iter().sum::<f32>() / 0.25;
        assert!((finished.weight.get() - expected).abs() <= 1e-6 * expected, "law 3: W");
        assert_eq!((finished.sample, finished.confidence), (Some(samples[chosen]), 3.0), "law 3");
        let nothing = reservoir.finish::<super::Counting>(0.0, 3.0);
        assert_eq!((nothing.sample, nothing.weight.get()), (None, 0.0), "law 3: p̂ = 0");
        // Law 4.
        let before = (reservoir.weight_sum().to_bits(), reservoir.selected());
        for bad in [f32::NAN, f32::INFINITY, -1.0, f32::NEG_INFINITY] {
            let mut script = Script { answers: &[true], at: 0, asked: Vec::new() };
            let rejected = reservoir.rejected();
            assert!(!reservoir.stream(samples[0], bad, carried, &mut script), "law 4: took {bad}");
            assert_eq!(reservoir.rejected(), rejected + 1, "law 4: {bad} was not counted");
        }
        assert_eq!((reservoir.weight_sum().to_bits(), reservoir.selected()), before, "law 4");
    }
    let empty = R::default().finish::<super::Counting>(1.0, 2.0);
    assert_eq!((empty.sample.is_none(), empty.weight.get(), empty.confidence), (true, 0.0, 2.0));
}

/// Laws 1 to 4 of [`ShiftMap`] for every sample and every pair of domains; `same` tells whether two
/// samples are one, up to rounding.
///
/// # Panics
/// If a law is broken, or no shift is defined at all.
pub fn check_shift<T: ShiftMap>(
    map: &mut T,
    samples: &[T::Sample],
    domains: &[T::Domain],
    tolerance: f32,
    same: impl Fn(&T::Sample, &T::Sample) -> bool,
) where
    T::Sample: Debug,
{
    let mut defined = 0;
    for sample in samples {
        for (i, a) in domains.iter().enumerate() {
            for (j, b) in domains.iter().enumerate() {
                let Some(there) = map.shift(sample, a, b) else { continue };
                let target = there.integrand.target();
                assert!(target >= 0.0 && target.is_finite(), "target {target} of {sample:?}");
                assert!(there.jacobian > 0.0 && there.jacobian.is_finite());
                assert_eq!(map.stratum(sample), map.stratum(&there.sample), "law 4: {sample:?}");
                if i == j {
                    assert!(same(sample, &there.sample), "law 3: {sample:?} moved");
                    assert_eq!(there.jacobian, 1.0, "law 3: {sample:?}");
                }
                // T may be defined one way only where the target vanishes; then it weighs nothing.
                let Some(back) = map.shift(&there.sample, b, a) else { continue };
                assert!(
                    same(sample, &back.sample),
                    "law 1: {sample:?} came back as {:?}",
                    back.sample
                );
                let product = there.jacobian * back.jacobian;
                assert!((product - 1.0).abs() <= tolerance, "law 2: {product} for {sample:?}");
                defined += 1;
            }
        }
    }
    assert!(defined > 0, "no shift is defined");
}

/// Law 1 of [`Mutator`] on a finite set of states: builds the kernel that `outcomes` enumerates
/// (all states that a step from i can end in, with probabilities) and checks Σᵢ p̂ᵢ K(i→j) = p̂ⱼ to
/// a relative `tolerance` of the largest target.
///
/// # Panics
/// If the law is broken.
pub fn check_invariance(
    targets: &[f64],
    mut outcomes: impl FnMut(usize) -> Vec<(usize, f64)>,
    tolerance: f64,
) {
    let mut after = vec![0.0; targets.len()];
    for (from, target) in targets.iter().enumerate() {
        let reached = outcomes(from);
        let total: f64 = reached.iter().map(|(_, p)| p).sum();
        assert!((total - 1.0).abs() < 1e-9, "the kernel from {from} sums to {total}");
        for (to, probability) in reached {
            after[to] += target * probability;
        }
    }
    let largest = targets.iter().copied().fold(0.0, f64::max);
    for (state, (before, after)) in targets.iter().zip(&after).enumerate() {
        assert!(
            (before - after).abs() <= tolerance * largest,
            "law 1: state {state} has target {before}, after a step {after}"
        );
    }
}

/// That a mutator proposes symmetrically between regular states (law 2): a proposal from a state
/// that itself proposes, leads to one that does.
///
/// # Panics
/// If a proposal leads to a state that makes none, with a positive acceptance.
pub fn check_regular<M: Mutator>(
    mutator: &mut M,
    states: &[M::State],
    random: &mut impl RandomSource,
) {
    for state in states {
        if let Some(proposal) = mutator.propose(state, random)
            && proposal.acceptance > 0.0
        {
            let regular = (0..64).any(|_| mutator.propose(&proposal.state, random).is_some());
            assert!(regular, "law 2: a state was proposed that never proposes");
        }
    }
}
