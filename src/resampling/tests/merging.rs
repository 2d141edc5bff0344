//! MIS weights and merges: partition of unity, exact sums, failed shifts, nothing to merge.

use super::{Finite, Sample, assert_close, is_close};
use crate::math::rng::{RandomSource, Stream};
use crate::resampling::mis::weights;
use crate::resampling::{
    ContributionWeight, Counting, Family, Finished, Input, Merged, OtherInputs, Plain, Reservoir,
    ShiftMap, Shifted, Term, WithVisibility, merge, merge_history,
};
use crate::stats::{Enumerator, enumerate_f64, expectation};

const CONFIDENCES: [f32; 4] = [0.0, 1.0, 20.0, 7.0 / 3.0];

fn confidences(n: usize, random: &mut Stream) -> Vec<f32> {
    // The canonical one is never 0.
    (0..n)
        .map(|i| CONFIDENCES[if i == 0 { 1 + random.index(3) } else { random.index(4) } as usize])
        .collect()
}

#[test]
fn weights_of_all_families_but_the_constant_one_sum_to_one_over_the_inputs_that_reach_a_sample() {
    let mut random = Stream::from_key(5);
    let mut constant_fails = 0;
    for _ in 0..20_000 {
        let n = 1 + random.index(5) as usize;
        let confidences = confidences(n, &mut random);
        let from: Vec<f32> = (0..n)
            .map(|i| {
                let zero = i > 0 && random.index(3) == 0;
                if zero { 0.0 } else { (20.0 * random.uniform() - 10.0).exp() }
            })
            .collect();
        for family in Family::ALL {
            let weights = weights(family, &confidences, &from);
            let reaching: f32 =
                weights.iter().zip(&from).filter(|&(_, &f)| f > 0.0).map(|(w, _)| w).sum();
            let partition = is_close(reaching.into(), 1.0);
            assert!(
                weights.iter().all(|w| (0.0..=1.0 + 1e-6).contains(w)),
                "{family:?} {weights:?}"
            );
            if family.partitions_unity() {
                assert!(partition, "{family:?}: {confidences:?} {from:?} {weights:?}");
                assert!(
                    weights.iter().zip(&from).all(|(&w, &f)| w == 0.0 || f > 0.0),
                    "{family:?}"
                );
            } else {
                constant_fails += u32::from(!partition);
            }
            if family == Family::DefensivePairwise {
                let least = confidences[0] / confidences.iter().sum::<f32>();
                assert!(weights[0] >= least * (1.0 - 1e-6), "{} < {least}", weights[0]);
            }
        }
    }
    // Control.
    assert!(constant_fails > 5000, "constant weights fail {constant_fails} times only");
}

pub(super) type Out = Merged<usize, f32, Counting>;

pub(super) fn merged(
    map: &Finite,
    family: Family,
    inputs: &[Sample],
    random: &mut impl RandomSource,
    see: impl FnMut(&Term<usize, f32>),
) -> (Out, Plain<usize>) {
    let domains: Vec<usize> = (0..inputs.len()).collect();
    let inputs: Vec<_> = inputs.iter().zip(&domains).map(|(&f, d)| map.input(f, d)).collect();
    let mut reservoir = Plain::default();
    let (canonical, others) = inputs.split_first().unwrap();
    let out = merge(&mut map.clone(), family, canonical, others, &mut reservoir, random, see);
    (out, reservoir)
}

/// Inputs whose host made every shift to and from the canonical domain beforehand.
struct Exchanged<'a> {
    inputs: &'a [Input<'a, usize, usize, Counting>],
    arriving: Vec<Option<Shifted<usize, f32>>>,
    leaving: Vec<f32>,
}

impl<'a> Exchanged<'a> {
    fn new(map: &Finite, all: &'a [Input<'a, usize, usize, Counting>]) -> Self {
        let mut map = map.clone();
        let (canonical, inputs) = all.split_first().unwrap();
        let arriving = inputs
            .iter()
            .map(|input| map.shift(&input.finished.sample?, input.domain, canonical.domain))
            .collect();
        let mut leaves = |to: &usize| {
            let shifted = map.shift(&canonical.finished.sample?, canonical.domain, to)?;
            Some(shifted.integrand * shifted.jacobian)
        };
        let leaving = inputs.iter().map(|input| leaves(input.domain).unwrap_or(0.0)).collect();
        Self { inputs, arriving, leaving }
    }
}

impl OtherInputs<usize, usize, Counting, f32> for Exchanged<'_> {
    type Domain<'s>
        = &'s usize
    where
        Self: 's;

    fn count(&self) -> usize {
        self.inputs.len()
    }

    fn finished(&self, at: usize) -> Sample {
        self.inputs[at].finished
    }

    fn target(&self, at: usize) -> f32 {
        self.inputs[at].target
    }

    fn domain(&self, at: usize) -> &usize {
        self.inputs[at].domain
    }

    fn arriving(&self, at: usize) -> Option<Option<Shifted<usize, f32>>> {
        Some(self.arriving[at])
    }

    fn leaving(&self, at: usize) -> Option<f32> {
        Some(self.leaving[at])
    }
}

/// A map that counts how often it is asked.
struct Asked(Finite, u32);

impl ShiftMap for Asked {
    type Sample = usize;
    type Domain = usize;
    type Integrand = f32;
    type Stratum = ();

    fn shift(&mut self, sample: &usize, from: &usize, to: &usize) -> Option<Shifted<usize, f32>> {
        self.1 += 1;
        self.0.shift(sample, from, to)
    }

    fn stratum(&self, _sample: &usize) {}
}

#[test]
fn shifts_that_the_host_knows_are_taken_from_it_and_change_nothing() {
    let mut random = Stream::from_key(31);
    let mut saved = [0; 2];
    for round in 0..3000 {
        let map = Finite::random(&mut random);
        let confidences = confidences(map.mass.len(), &mut random);
        let domains: Vec<usize> = (0..map.mass.len()).collect();
        let inputs: Vec<_> = domains
            .iter()
            .map(|d| map.input(map.initial(*d, (1, confidences[*d]), &mut random), d))
            .collect();
        let (canonical, others) = inputs.split_first().unwrap();
        for family in Family::ALL {
            let run = |known: bool| {
                let mut map = Asked(map.clone(), 0);
                let mut reservoir = Plain::default();
                let mut random = Stream::from_key(round);
                let out = if known {
                    let others = Exchanged::new(&map.0, &inputs);
                    merge(&mut map, family, canonical, &others, &mut reservoir, &mut random, |_| ())
                } else {
                    merge(&mut map, family, canonical, others, &mut reservoir, &mut random, |_| ())
                };
                (format!("{out:?} {reservoir:?}"), map.1)
            };
            let ((plain, asked), (known, still_asked)) = (run(false), run(true));
            assert_eq!(plain, known, "{family:?}");
            // Between two others nobody knows the shifts of a third one.
            let of_a_third =
                matches!(family, Family::Balance | Family::InverseCount | Family::Contribution);
            if !of_a_third || others.len() < 2 {
                assert_eq!(still_asked, 0, "{family:?} with {} others", others.len());
            }
            saved[usize::from(of_a_third)] += asked - still_asked;
        }
    }
    // Control: without them the map is asked, in families of both kinds.
    assert!(saved.iter().all(|&calls| calls > 1000), "{saved:?}");
}

/// E[1{Y = y} W] of every canonical state y: equal to its mass, it gives all integrals.
fn measure(map: &Finite, mut run: impl FnMut(&mut Enumerator<f64>) -> Sample) -> Vec<f64> {
    let outcomes = enumerate_f64(|random| {
        let out = run(random);
        (out.sample, f64::from(out.weight.get()))
    });
    assert_close(expectation(&outcomes, |_| 1.0), 1.0);
    (0..map.mass[0].len())
        .map(|y| expectation(&outcomes, |&(sample, w)| if sample == Some(y) { w } else { 0.0 }))
        .collect()
}

fn expected(map: &Finite) -> Vec<f64> {
    map.mass[0]
        .iter()
        .zip(&map.target[0])
        .map(|(&m, &t)| if t > 0.0 { m.into() } else { 0.0 })
        .collect()
}

#[test]
fn a_merge_is_exact_on_random_domains_with_partial_maps_and_jacobians() {
    let mut random = Stream::from_key(11);
    let mut constant_fails = 0;
    for _ in 0..150 {
        let map = Finite::random(&mut random);
        let confidences = confidences(map.mass.len(), &mut random);
        let candidates = if map.mass.len() < 3 { 2 } else { 1 };
        for family in Family::ALL {
            let measured = measure(&map, |random| {
                let inputs: Vec<Sample> = confidences
                    .iter()
                    .enumerate()
                    .map(|(domain, &c)| map.initial(domain, (candidates, c), random))
                    .collect();
                let out = merged(&map, family, &inputs, random, |_| ()).0.finished;
                assert!((out.confidence - confidences.iter().sum::<f32>()).abs() < 1e-5);
                out
            });
            let exact =
                measured.iter().zip(expected(&map)).all(|(&value, exact)| is_close(value, exact));
            if family == Family::Constant {
                constant_fails += u32::from(!exact);
            } else {
                assert!(exact, "{family:?}: {measured:?} for {map:?}, {confidences:?}");
            }
        }
    }
    // Control.
    assert!(constant_fails > 75, "constant weights fail {constant_fails} times only");
}

#[test]
fn all_terms_together_are_as_exact_as_the_selected_one_if_their_weights_are_known_in_time() {
    let mut random = Stream::from_key(13);
    let mut late_fails = 0;
    for _ in 0..150 {
        let map = Finite::random(&mut random);
        let confidences = confidences(map.mass.len(), &mut random);
        for family in Family::ALL {
            let outcomes = enumerate_f64(|random| {
                let inputs: Vec<Sample> = confidences
                    .iter()
                    .enumerate()
                    .map(|(domain, &c)| map.initial(domain, (1, c), random))
                    .collect();
                let mut shown = [0.0; 4];
                // The selection does not matter here.
                let mut chance = Stream::from_key(1);
                merged(&map, family, &inputs, &mut chance, |term| {
                    let sample = term.shifted.map_or(inputs[0].sample, |s| Some(s.sample));
                    shown[sample.unwrap()] += f64::from(term.contribution);
                });
                shown
            });
            let exact = expected(&map)
                .into_iter()
                .enumerate()
                .all(|(y, exact)| is_close(expectation(&outcomes, |shown| shown[y]), exact));
            if family.terms_partition_unity() {
                assert!(exact, "{family:?}: {map:?}, {confidences:?}");
            } else {
                late_fails += u32::from(!exact);
            }
        }
    }
    // Control: constant weights, of three families.
    assert!(late_fails > 3 * 75, "constant weights fail {late_fails} times only");
}

#[test]
fn an_input_that_cannot_draw_what_its_target_says_is_a_loss() {
    let map = Finite::shared(&[&[1.0, 1.0], &[1.0, 1.0]]);
    let measured = measure(&map, |random| {
        let inputs = [map.initial(0, (1, 1.0), random), certain(1, 1.0, 1.0)];
        merged(&map, Family::DefensivePairwise, &inputs, random, |_| ()).0.finished
    });
    assert_close(measured.iter().sum(), 7.0 / 4.0);
}

#[test]
fn a_merge_weighs_as_the_plain_formulas_say() {
    let mut random = Stream::from_key(12);
    for _ in 0..2000 {
        let map = Finite::random(&mut random);
        let confidences = confidences(map.mass.len(), &mut random);
        let inputs: Vec<Sample> = confidences
            .iter()
            .enumerate()
            .map(|(domain, &c)| map.initial(domain, (1, c), &mut random))
            .collect();
        for family in Family::ALL {
            let mut seen = Vec::new();
            let (merged, reservoir) =
                merged(&map, family, &inputs, &mut random, |term| seen.push(*term));
            let late = matches!(family, Family::InverseCount | Family::Contribution);
            for term in seen {
                let state = term.shifted.map_or(inputs[0].sample, |s| Some(s.sample)).unwrap();
                let family = if late { Family::Constant } else { family };
                let expected = weights(family, &confidences, &map.from(state))[term.input];
                assert_close(term.mis.into(), expected.into());
                let jacobian = term.shifted.map_or(1.0, |s| s.jacobian);
                let contribution = term.mis * inputs[term.input].weight.get() * jacobian;
                assert_close(term.contribution.into(), contribution.into());
                assert_close(term.weight.into(), (contribution * map.target[0][state]).into());
            }
            let Some(state) = merged.finished.sample else { continue };
            assert_eq!(merged.target, map.target[0][state]);
            if late {
                // What the sum of weights became, per cᵢ / C of the input that won.
                let scale = merged.finished.weight.get() * merged.target / reservoir.weight_sum();
                let share = confidences[merged.source] / confidences.iter().sum::<f32>();
                let expected = weights(family, &confidences, &map.from(state))[merged.source];
                assert_close((scale * share).into(), expected.into());
            }
        }
    }
}

#[test]
fn constant_weights_lose_a_seventh_of_the_one_over_m_toy() {
    let map = Finite::shared(&[&[4.0, 1.0, 0.0, 2.0], &[1.0, 3.0, 5.0, 0.0]]);
    for family in Family::ALL {
        for candidates in [1, 2] {
            let measured = measure(&map, |random| {
                let inputs = [0, 1].map(|domain| map.initial(domain, (candidates, 1.0), random));
                merged(&map, family, &inputs, random, |_| ()).0.finished
            });
            let sum = |f: [f64; 4]| measured.iter().zip(f).map(|(m, f)| m * f).sum::<f64>();
            let constant = family == Family::Constant;
            assert_close(sum([4.0, 1.0, 0.0, 2.0]), if constant { 6.0 } else { 7.0 });
            assert_close(sum([1.0, 5.0, 0.0, 3.0]), if constant { 7.5 } else { 9.0 });
        }
    }
}

pub(super) fn certain(state: usize, weight: f32, confidence: f32) -> Sample {
    Finished { sample: Some(state), weight: ContributionWeight::new(weight), confidence }
}

#[test]
fn a_failed_shift_keeps_its_domain() {
    let mut map = Finite::shared(&[&[1.0, 1.0], &[1.0, 1.0]]);
    map.image[1] = vec![Some(0), None];
    let total = |law: f32, family, drop: fn(usize, usize) -> bool| {
        measure(&map, |random| {
            let own = random.index(2) as usize;
            let state = usize::from(!random.choose(law, 1.0));
            let other = certain(state, 1.0 / [law, 1.0 - law][state], 1.0);
            let inputs = [certain(own, 2.0, 1.0), other];
            let accepted = if drop(own, state) { 1 } else { 2 };
            merged(&map, family, &inputs[..accepted], random, |_| ()).0.finished
        })
        .iter()
        .sum::<f64>()
    };
    for family in Family::ALL.into_iter().filter(|f| f.partitions_unity()) {
        assert_close(total(0.5, family, |_, _| false), 2.0);
        assert_close(total(0.75, family, |_, _| false), 2.0);
    }
    // Controls: who drops a neighbour for what it drew, is wrong.
    let defensive = Family::DefensivePairwise;
    assert_close(total(0.5, defensive, |_, other| other == 1), 17.0 / 8.0);
    assert_close(total(0.75, defensive, |_, other| other == 1), 33.0 / 16.0);
    assert_close(total(0.75, defensive, |own, other| own == 1 || other == 1), 31.0 / 16.0);
}

/// Pixels that swap their samples need both shifts of a partner that they accept: one that was not
/// made, taken for one that is undefined, makes the sum 9 become 11.
#[test]
fn an_accepted_slot_has_both_shifts() {
    let map = Finite::shared(&[&[1.0, 1.0, 2.0], &[3.0, 1.0, 0.0]]);
    let total = |made: bool| {
        let found = measure(&map, |random| {
            let own = map.input(certain(random.index(3) as usize, 3.0, 1.0), &0);
            let all = [own, map.input(certain(random.index(2) as usize, 2.0, 1.0), &1)];
            let mut others = Exchanged::new(&map, &all);
            if !made {
                others.leaving = vec![0.0];
            }
            let (family, mut reservoir) = (Family::DefensivePairwise, Plain::default());
            let mut map = map.clone();
            merge(&mut map, family, &all[0], &others, &mut reservoir, random, |_| ()).finished
        });
        found.iter().zip([4.0, 2.0, 3.0]).map(|(weight, f)| weight * f).sum::<f64>()
    };
    assert_close(total(true), 9.0);
    assert_close(total(false), 11.0);
}

#[test]
fn without_anything_to_merge_the_canonical_comes_out_bit_for_bit() {
    // 0.7 / 3 is no f32, nor are the thirds.
    let map = Finite {
        mass: vec![vec![0.1, 0.3, 0.7]; 4],
        target: vec![vec![0.7, 0.3, 0.9]; 4],
        image: vec![
            vec![Some(0), Some(1), Some(2)],
            vec![None; 3],
            vec![None; 3],
            vec![None, None, Some(2)],
        ],
    };
    let own = certain(1, 0.1 / 0.3, 1.0 / 3.0);
    let mut random = Stream::from_key(3);
    let cases: [&[Sample]; 5] = [
        &[],
        // They count for nothing.
        &[certain(0, 3.0, 0.0), Finished::empty(0.0), certain(2, 1.0, 0.0)],
        // Their shifts fail.
        &[certain(0, 3.0, 7.0 / 3.0), certain(1, 3.0, 20.0)],
        // They have nothing and cannot reach the canonical's sample.
        &[Finished::empty(7.0 / 3.0), Finished::empty(1.0), Finished::empty(20.0)],
        &[certain(0, 3.0, 0.7), Finished::empty(0.0), certain(1, 3.0, 20.0)],
    ];
    for others in cases {
        let inputs: Vec<Sample> = [&[own], others].concat();
        let total: f32 = own.confidence + others.iter().map(|o| o.confidence).sum::<f32>();
        for family in Family::ALL {
            let out = merged(&map, family, &inputs, &mut random, |_| ()).0;
            assert_eq!(out.finished.confidence, total);
            if family == Family::Constant && total > own.confidence {
                assert!(out.finished.weight.get() < own.weight.get(), "the control");
                continue;
            }
            assert_eq!(out.finished.sample, own.sample);
            let (weight, expected) = (out.finished.weight.get(), own.weight.get());
            assert_eq!(weight.to_bits(), expected.to_bits(), "{family:?}: {weight} for {expected}");
            assert_eq!((out.target, out.source, out.integrand), (0.3, 0, None));
        }
    }
}

#[test]
fn a_canonical_of_any_numbers_comes_out_bit_for_bit() {
    let mut random = Stream::from_key(4);
    for _ in 0..2000 {
        let mut any = |from: f32| from + random.uniform();
        let map = Finite {
            mass: vec![vec![any(0.1)]; 3],
            target: vec![vec![any(0.1)]; 3],
            image: vec![vec![Some(0)], vec![None], vec![None]],
        };
        let own = certain(0, any(0.1), any(0.1));
        let inputs = [own, certain(0, any(0.1), any(0.1)), Finished::empty(any(0.1))];
        for family in Family::ALL.into_iter().filter(|f| f.partitions_unity()) {
            let out = merged(&map, family, &inputs, &mut random, |_| ()).0.finished;
            assert_eq!((out.sample, out.weight), (own.sample, own.weight), "{family:?}");
        }
    }
}

#[test]
fn an_empty_canonical_takes_what_a_neighbour_has_and_sums_confidences() {
    let map = Finite::shared(&[&[0.0, 1.0], &[1.0, 1.0]]);
    let mut random = Stream::from_key(3);
    for family in Family::ALL {
        let inputs = [Finished::empty(2.0), certain(1, 2.0, 1.0)];
        let out = merged(&map, family, &inputs, &mut random, |_| ()).0;
        let mis = weights(family, &[2.0, 1.0], &[1.0, 1.0])[1];
        assert_eq!((out.finished.sample, out.finished.confidence, out.source), (Some(1), 3.0, 1));
        assert_close(out.finished.weight.get().into(), (2.0 * mis).into());
        let inputs = [Finished::empty(2.0), Finished::empty(1.0)];
        let out = merged(&map, family, &inputs, &mut random, |_| ()).0;
        assert_eq!((out.finished, out.target), (Finished::empty(3.0), 0.0));
    }
}

#[test]
fn temporal_caps_the_confidence_and_nothing_else() {
    let mut map = Finite::shared(&[&[1.0, 2.0], &[3.0, 1.0]]);
    let (own, before) = (certain(0, 2.0, 2.0), certain(1, 0.5, 100.0));
    let run = |map: &mut Finite, cap| {
        enumerate_f64(|random| {
            let inputs = [map.input(own, &0), map.input(before, &1)];
            let family = Family::Balance;
            let out = merge_history(
                map,
                (family, cap),
                &inputs[0],
                &inputs[1],
                &mut Plain::default(),
                random,
                |_| (),
            );
            (out.finished.sample, out.finished.weight.get(), out.finished.confidence)
        })
    };
    let capped = run(&mut map, 3.0);
    assert!(capped.iter().all(|o| o.value.2 == 8.0));
    assert!(run(&mut map, 1000.0).iter().all(|o| o.value.2 == 102.0));
    // Weights 2·1·(2·1)/(2·1 + 6·3) and ½·2·(6·1)/(6·1 + 2·2).
    let sum = 0.2 + 0.6;
    for outcome in capped {
        let target = [1.0, 2.0][outcome.value.0.unwrap()];
        assert_close(outcome.value.1.into(), sum / target);
        assert_close(outcome.probability, [0.25, 0.75][outcome.value.0.unwrap()]);
    }
}

#[test]
fn the_average_visibility_of_a_merge_is_that_of_its_weights() {
    let mut map = Finite::shared(&[&[1.0, 1.0], &[1.0, 1.0]]);
    let inputs: [Input<'_, _, _, _>; 2] =
        [map.input(certain(0, 2.0, 1.0), &0), map.input(certain(1, 2.0, 3.0), &1)];
    let mut reservoir = WithVisibility::<Plain<usize>>::default();
    let out = merge(
        &mut map,
        Family::Balance,
        &inputs[0],
        &inputs[1..],
        &mut reservoir,
        &mut Stream::from_key(1),
        |term| ((), [1.0, 0.5][term.input]),
    );
    assert_close(reservoir.visibility().into(), 0.25 + 0.75 * 0.5);
    assert_close(out.finished.weight.get().into(), 2.0);
    assert_eq!(reservoir.rejected(), 0);
}
