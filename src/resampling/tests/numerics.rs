//! Weights, targets and Jacobians of any size: what comes out is finite, and what was rejected is
//! counted.

use proptest::prelude::*;

use super::{Sample, assert_close};
use crate::math::rng::Stream;
use crate::resampling::mis::{Pairwise, balance, share, weights};
use crate::resampling::{
    ContributionWeight, Counting, Family, Finished, Input, Plain, Reservoir, ShiftMap, Shifted,
    WithVisibility, merge,
};

/// Mostly anything in [1e-38, 1e38], sometimes 0 or 1.
fn any_size() -> impl Strategy<Value = f32> {
    prop_oneof![
        6 => (-38.0_f32..38.0).prop_map(|exponent| 10.0_f32.powf(exponent)),
        1 => Just(0.0),
        1 => Just(1.0),
        1 => Just(1e-38),
        1 => Just(1e38),
    ]
}

fn positive() -> impl Strategy<Value = f32> {
    any_size().prop_map(|x| if x > 0.0 { x } else { 1e-38 })
}

fn confidence() -> impl Strategy<Value = f32> {
    prop_oneof![Just(0.0), Just(1.0), Just(20.0), Just(7.0 / 3.0)]
}

/// A neighbour, and what its shifts there and back find.
#[derive(Clone, Copy, Debug)]
struct Neighbour {
    weight: f32,
    target: f32,
    confidence: f32,
    /// Target and Jacobian in the canonical domain.
    here: Option<(f32, f32)>,
    /// Of a canonical sample in the neighbour's.
    there: Option<(f32, f32)>,
}

fn neighbour() -> impl Strategy<Value = Neighbour> {
    let shift = || prop::option::weighted(0.8, (any_size(), positive()));
    (any_size(), positive(), confidence(), shift(), shift()).prop_map(
        |(weight, target, confidence, here, there)| Neighbour {
            weight,
            target,
            confidence,
            here,
            there,
        },
    )
}

/// Says what it is told: samples are the numbers of the domains that they come from.
struct Told<'a>(&'a [Neighbour]);

impl ShiftMap for Told<'_> {
    type Sample = usize;
    type Domain = usize;
    type Integrand = f32;
    type Stratum = ();

    fn shift(
        &mut self,
        &sample: &usize,
        &from: &usize,
        &to: &usize,
    ) -> Option<Shifted<usize, f32>> {
        let found = if to == 0 { self.0[from - 1].here } else { self.0[to - 1].there };
        found.map(|(integrand, jacobian)| Shifted { sample, integrand, jacobian })
    }

    fn stratum(&self, _sample: &usize) {}
}

fn finished(domain: usize, weight: f32, confidence: f32) -> Sample {
    if weight == 0.0 {
        return Finished::empty(confidence);
    }
    Finished { sample: Some(domain), weight: ContributionWeight::new(weight), confidence }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(20_000) })]

    #[test]
    fn a_merge_of_numbers_of_any_size_is_finite(
        neighbours in prop::collection::vec(neighbour(), 0..4),
        (weight, target) in (any_size(), positive()),
        own in prop_oneof![Just(1.0_f32), Just(20.0), Just(7.0 / 3.0)],
        key in any::<u64>(),
    ) {
        let domains: Vec<usize> = (0..=neighbours.len()).collect();
        let canonical: Input<'_, usize, usize, Counting> =
            Input { finished: finished(0, weight, own), target, domain: &0 };
        let others: Vec<_> = neighbours
            .iter()
            .zip(&domains[1..])
            .map(|(n, domain)| {
                let finished = finished(*domain, n.weight, n.confidence);
                Input { finished, target: n.target, domain }
            })
            .collect();
        for family in Family::ALL {
            let mut reservoir = WithVisibility::<Plain<usize>>::default();
            let mut random = Stream::from_key(key);
            let mut asked = 0;
            let mut infinite = 0;
            let out = merge(&mut Told(&neighbours), family, &canonical, others.as_slice(), &mut reservoir, &mut random, |term| {
                asked += 1;
                infinite += u32::from(!term.weight.is_finite());
                ((), 0.5)
            });
            let weight = out.finished.weight.get();
            prop_assert!(weight.is_finite() && weight >= 0.0, "{:?}: {}", family, weight);
            prop_assert_eq!(weight > 0.0, out.finished.sample.is_some(), "{:?}", family);
            prop_assert!(out.target.is_finite());
            prop_assert_eq!(out.target > 0.0, out.finished.sample.is_some(), "{:?}", family);
            prop_assert!(out.finished.sample.is_some() || out.integrand.is_none());
            prop_assert!(out.finished.confidence.is_finite() && out.finished.confidence >= own);
            prop_assert!((0.0..=1.0).contains(&reservoir.visibility()));
            prop_assert!(reservoir.weight_sum().is_finite());
            // Whatever was not finite is counted, sums that overflow besides.
            prop_assert!(reservoir.rejected() >= infinite, "{} of {}", reservoir.rejected(), infinite);
            prop_assert!(asked <= others.len() + 1);
        }
    }

    #[test]
    fn weights_of_numbers_of_any_size_are_shares(
        from in prop::collection::vec((any_size(), confidence()), 0..5),
        (target, own) in (positive(), prop_oneof![Just(1.0_f32), Just(20.0)]),
    ) {
        let targets: Vec<f32> = [target].into_iter().chain(from.iter().map(|f| f.0)).collect();
        let confidences: Vec<f32> = [own].into_iter().chain(from.iter().map(|f| f.1)).collect();
        for family in Family::ALL {
            let weights = weights(family, &confidences, &targets);
            prop_assert!(weights.iter().all(|w| (0.0..=1.0 + 1e-6).contains(w)), "{:?}: {:?}", family, weights);
            if family.partitions_unity() {
                let sum: f64 = weights.iter().map(|&w| f64::from(w)).sum();
                prop_assert!((sum - 1.0).abs() < 1e-6, "{:?}: {:?} sum to {}", family, weights, sum);
            }
        }
    }

    #[test]
    fn a_reservoir_of_numbers_of_any_size_is_finite(
        weights in prop::collection::vec(
            prop_oneof![4 => any_size(), 1 => Just(f32::NAN), 1 => Just(f32::INFINITY), 1 => Just(-1.0)],
            0..20,
        ),
        target in any_size(),
        key in any::<u64>(),
    ) {
        let mut reservoir = WithVisibility::<Plain<usize>>::default();
        let mut random = Stream::from_key(key);
        let mut sum = 0.0_f64;
        let mut rejected = 0;
        for (i, &weight) in weights.iter().enumerate() {
            let before = reservoir.rejected();
            reservoir.stream(i, weight, ((), 1.0), &mut random);
            if reservoir.rejected() == before { sum += f64::from(weight) } else { rejected += 1 }
            prop_assert!(weight >= 0.0 && weight.is_finite() || reservoir.rejected() == before + 1);
        }
        prop_assert_eq!(reservoir.rejected(), rejected);
        prop_assert!((f64::from(reservoir.weight_sum()) - sum).abs() <= 1e-5 * sum);
        prop_assert_eq!(reservoir.selected().is_some(), sum > 0.0);
        prop_assert!(reservoir.selected().is_none_or(|i| weights[i] > 0.0 && weights[i].is_finite()));
        prop_assert!((0.0..=1.0).contains(&reservoir.visibility()));
        let finished: Finished<usize, Counting> = reservoir.finish(target, 1.0);
        prop_assert!(finished.weight.get().is_finite());
        prop_assert_eq!(finished.weight.get() > 0.0, finished.sample.is_some());
    }
}

#[test]
fn a_weight_that_is_not_a_number_is_counted() {
    // p̂ / |∂T| is infinite in f32, and so is another's, as the balance weight compares them.
    let told = Neighbour {
        weight: 1.0,
        target: 1e38,
        confidence: 1.0,
        here: Some((1.0, 1e-38)),
        there: Some((1e38, 1e38)),
    };
    let neighbours = [told; 2];
    let canonical = Input { finished: finished(0, 1.0, 1.0), target: 1.0, domain: &0 };
    let others = [1, 2].map(|domain| (finished(domain, 1.0, 1.0), domain));
    let others = others.each_ref().map(|(finished, domain)| Input {
        finished: *finished,
        target: told.target,
        domain,
    });
    let mut reservoir = Plain::default();
    let mut random = Stream::from_key(1);
    let mut map = Told(&neighbours);
    merge(
        &mut map,
        Family::Balance,
        &canonical,
        others.as_slice(),
        &mut reservoir,
        &mut random,
        |_| (),
    );
    assert_eq!(reservoir.rejected(), 2);
}

/// Two neighbours that are alike share by halves whatever their targets' unit: a product of
/// confidence and target would overflow, or be 0.
#[test]
fn balance_is_a_matter_of_ratios() {
    for target in [1e-38, 1.0, 3e38] {
        let told = Neighbour {
            weight: 1.0,
            target,
            confidence: 20.0,
            here: Some((1e-3 * target.min(1.0), 1.0)),
            there: Some((target, 1.0)),
        };
        let neighbours = [told; 2];
        let canonical: Input<'_, usize, usize, Counting> =
            Input { finished: finished(0, 0.0, 1.0), target: 0.0, domain: &0 };
        let others = [1, 2].map(|domain| (finished(domain, 1.0, 20.0), domain));
        let others = others.each_ref().map(|(finished, domain)| Input {
            finished: *finished,
            target,
            domain,
        });
        let mut shares = Vec::new();
        merge(
            &mut Told(&neighbours),
            Family::Balance,
            &canonical,
            others.as_slice(),
            &mut Plain::default(),
            &mut Stream::from_key(1),
            |term| shares.push(term.mis),
        );
        assert_eq!(shares.len(), 2);
        for share in shares {
            assert!((share - 0.5).abs() < 1e-3, "{target}: {share}");
        }
    }
}

#[test]
fn shares_of_extremes_are_what_they_are_of_ordinary_numbers() {
    assert_eq!((share(0.0, 0.0), share(0.0, 1.0), share(1.0, 0.0)), (0.0, 0.0, 1.0));
    assert_eq!(share(3e38, 3e38), 0.5);
    assert_eq!(share(1e-38, 1e38), 0.0);
    assert_close(balance((1.0, 3e38), [(1.0, 3e38), (2.0, 3e38)].into_iter()).into(), 0.25);
    let pairwise = Pairwise { canonical: 1.0, others: 1.0, defensive: false };
    assert_eq!(pairwise.other(1.0, 3e38, 3e38), 0.5);
    assert_eq!(pairwise.canonical_part(1.0, 1e38, 1e-38), 0.0);
    assert_eq!(pairwise.canonical_part(1.0, 0.0, 1e-38), 1.0);
}
