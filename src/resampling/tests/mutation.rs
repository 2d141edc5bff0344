//! Mutated samples keep their integrals; and chains of merges, with and without a cap.

use super::laws::{Ring, metropolis_rule};
use super::{Finite, Sample, assert_close, is_close};
use crate::math::rng::{RandomSource, Stream};
use crate::resampling::{
    Chain, Counting, Family, Finished, Mutator, Plain, merge, merge_history, metropolis,
    mutated_weight,
};
use crate::stats::{Enumerator, enumerate_f64, expectation};

const TARGET: [f32; 4] = [1.0, 2.0, 5.0, 3.0];
const F: [f64; 4] = [7.0, 1.0, 0.0, 4.0];
const SUM: f64 = 12.0;

/// A state that is not drawn like the target, with a weight that is right only in the mean.
fn drawn(random: &mut impl RandomSource) -> (usize, f32) {
    let mut left = 10.0;
    let mut state = 0;
    for (i, tenths) in [4.0, 3.0, 1.0, 2.0].into_iter().enumerate() {
        if random.choose(tenths, left) {
            state = i;
            break;
        }
        left -= tenths;
    }
    let inverse = [2.5, 10.0 / 3.0, 10.0, 5.0][state];
    (state, inverse * [0.5, 1.5][random.index(2) as usize])
}

/// E[f(Y) W'] for the state that `walk` makes of a drawn state and weight.
fn mean(walk: impl Fn(usize, f32, &mut Enumerator<f64>) -> usize) -> f64 {
    let outcomes = enumerate_f64(|random| {
        let (before, weight) = drawn(random);
        let after = walk(before, weight, random);
        let mutated = mutated_weight(weight, TARGET[before], TARGET[after]);
        // The pixel's own luminance never changes.
        assert!(
            (mutated * TARGET[after] - weight * TARGET[before]).abs()
                <= 1e-6 * weight * TARGET[before]
        );
        F[after] * f64::from(mutated)
    });
    expectation(&outcomes, |&value| value)
}

fn ring(acceptance: fn(f32, f32) -> f32) -> Ring<'static> {
    Ring { target: &TARGET, acceptance }
}

#[test]
fn mutations_keep_all_integrals_for_any_number_of_steps() {
    for steps in [0, 1, 2, 3, 5] {
        let walk = |state, _, random: &mut _| {
            metropolis(&mut ring(metropolis_rule), state, steps, random).state
        };
        assert_close(mean(walk), SUM);
    }
}

#[test]
fn the_weight_changes_by_the_target_before_over_the_target_after() {
    // Control: the inverse ratio.
    for (steps, wrong) in [(1, 10.65), (2, 8.29), (3, 8.89), (5, 8.72)] {
        let outcomes = enumerate_f64(|random| {
            let (before, weight) = drawn(random);
            let after = metropolis(&mut ring(metropolis_rule), before, steps, random).state;
            F[after] * f64::from(mutated_weight(weight, TARGET[after], TARGET[before]))
        });
        let found = expectation(&outcomes, |&value| value);
        assert!((found - wrong).abs() < 0.005, "{found} instead of {wrong}");
    }
}

#[test]
fn the_last_state_is_committed_even_if_the_last_proposal_was_rejected() {
    // Control: it is not.
    for (steps, wrong) in
        [(1, SUM), (2, 2047.0 / 144.0), (3, 25_231.0 / 1728.0), (5, 18_369_539.0 / 1_244_160.0)]
    {
        let walk = |before, _, random: &mut _| {
            let mut ring = ring(metropolis_rule);
            let so_far = metropolis(&mut ring, before, steps - 1, random).state;
            let Chain { state, accepted } = metropolis(&mut ring, so_far, 1, random);
            if accepted > 0 { state } else { before }
        };
        assert_close(mean(walk), wrong);
    }
}

#[test]
fn the_number_of_steps_does_not_know_the_sample() {
    // Controls: by its weight, and by its state.
    let step = |state, steps, random: &mut _| {
        metropolis(&mut ring(metropolis_rule), state, steps, random).state
    };
    let by_weight = mean(|state, weight, random| step(state, u32::from(weight >= 4.0), random));
    assert_close(by_weight, 275.0 / 16.0);
    let by_state = mean(|state, _, random| step(state, if state < 2 { 3 } else { 0 }, random));
    assert_close(by_state, 15_979.0 / 2160.0);
}

/// Fickel's blue-noise acceptance (2023, with its weight 1) asks how a picture would
/// look, and not the target: with the least of such rules, which accepts all, the pixel's luminance
/// is right (as `mean` asserts), its colour is not.
#[test]
fn blue_noise_acceptance_is_biased_in_colour() {
    let all = |state, _, random: &mut _| metropolis(&mut ring(|_, _| 1.0), state, 1, random).state;
    assert_close(mean(all), 23.0);
    let luminance = enumerate_f64(|random| {
        let (before, weight) = drawn(random);
        let after = metropolis(&mut ring(|_, _| 1.0), before, 1, random).state;
        f64::from(TARGET[after] * mutated_weight(weight, TARGET[before], TARGET[after]))
    });
    assert_close(expectation(&luminance, |&value| value), 11.0);
}

/// A mutator that never leaves {0, 1}, and stays elsewhere.
struct Class;

impl Mutator for Class {
    type State = usize;

    fn propose(
        &mut self,
        &state: &usize,
        _random: &mut impl RandomSource,
    ) -> Option<crate::resampling::Proposal<usize>> {
        let to = 1 - state.min(1);
        let acceptance = metropolis_rule(TARGET[state], TARGET[to]);
        (state < 2).then_some(crate::resampling::Proposal { state: to, acceptance })
    }
}

#[test]
fn a_chain_may_be_kept_to_a_class_that_it_never_leaves() {
    for steps in [1, 2] {
        assert_close(
            mean(|state, _, random| metropolis(&mut Class, state, steps, random).state),
            SUM,
        );
    }
}

#[test]
fn a_mutated_weight_is_finite_and_zero_without_a_target() {
    assert_eq!(mutated_weight(2.0, 3.0, 0.0), 0.0);
    assert_eq!(mutated_weight(0.0, 0.0, 0.0), 0.0);
    assert_eq!(mutated_weight(1e30, 1e30, 1e-30), 0.0);
    assert_eq!(mutated_weight(2.0, 3.0, 6.0), 1.0);
}

#[test]
fn mutations_between_reuses_keep_a_merge_exact() {
    let map = Finite::shared(&[&[1.0, 2.0, 0.0], &[3.0, 1.0, 2.0]]);
    let mutated = |sample: Sample, domain: usize, random: &mut _| {
        let Some(before) = sample.sample else { return sample };
        let target = &map.target[domain];
        let rule = |a: f32, b: f32| if b > 0.0 { metropolis_rule(a, b) } else { 0.0 };
        let after = metropolis(&mut Ring { target, acceptance: rule }, before, 2, random).state;
        let weight = mutated_weight(sample.weight.get(), target[before], target[after]);
        Finished { sample: Some(after), weight: super::ContributionWeight::new(weight), ..sample }
    };
    for family in Family::ALL.into_iter().filter(|f| f.partitions_unity()) {
        let outcomes = enumerate_f64(|random| {
            let samples = [0, 1].map(|domain| {
                let initial = map.initial(domain, (1, 1.0), random);
                mutated(initial, domain, random)
            });
            let inputs = [map.input(samples[0], &0), map.input(samples[1], &1)];
            let mut plain = Plain::default();
            let out = merge(
                &mut map.clone(),
                family,
                &inputs[0],
                &inputs[1..],
                &mut plain,
                random,
                |_| (),
            );
            (out.finished.sample, f64::from(out.finished.weight.get()))
        });
        for state in 0..2 {
            let of = |&(y, w): &(Option<usize>, f64)| if y == Some(state) { w } else { 0.0 };
            let found = expectation(&outcomes, of);
            assert!(is_close(found, 1.0), "{family:?}: {found}");
        }
    }
}

/// Error of one run's mean over frames of the canonical pixel of two that pass their samples to and
/// fro, squared, in the mean over runs.
fn squared_error(cap: f32, frames: u32) -> f64 {
    let map = Finite::shared(&[&[1.0, 2.0, 3.0], &[2.0, 2.0, 1.0]]);
    // Each pixel is the canonical one of its own merge.
    let swapped = Finite::shared(&[&[2.0, 2.0, 1.0], &[1.0, 2.0, 3.0]]);
    let maps = [map, swapped];
    let runs = 64;
    let mut error = 0.0;
    for run in 0..runs {
        let mut random = Stream::from_key(run);
        let mut pixels: Option<[Finished<usize, Counting>; 2]> = None;
        // Σ f W for an f apart from the target.
        let mut shown = 0.0;
        for _ in 0..frames {
            let fresh = [0, 1].map(|i| maps[i].initial(0, (1, 1.0), &mut random));
            let now = [0, 1].map(|i| match pixels {
                None => fresh[i],
                Some(before) => {
                    let inputs = [fresh[i], before[i]].map(|f| maps[i].input(f, &0));
                    let how = (Family::Balance, cap);
                    let (map, reservoir) = (&mut maps[i].clone(), &mut Plain::default());
                    merge_history(map, how, &inputs[0], &inputs[1], reservoir, &mut random, |_| ())
                        .finished
                }
            });
            let merged = [0, 1].map(|i| {
                let inputs = [maps[i].input(now[i], &0), maps[i].input(now[1 - i], &1)];
                let (map, reservoir) = (&mut maps[i].clone(), &mut Plain::default());
                merge(
                    map,
                    Family::Balance,
                    &inputs[0],
                    &inputs[1..],
                    reservoir,
                    &mut random,
                    |_| (),
                )
                .finished
            });
            shown += merged[0]
                .sample
                .map_or(0.0, |y| [4.0, 1.0, 1.0][y] * f64::from(merged[0].weight.get()));
            pixels = Some(merged);
        }
        let mean = shown / f64::from(frames);
        error += (mean / 6.0 - 1.0).powi(2) / runs as f64;
    }
    error
}

#[test]
fn without_a_cap_a_chain_of_merges_converges_to_a_wrong_value() {
    let [short, long] = [100, 3000].map(|frames| squared_error(1e6, frames));
    // Control: thirty times the frames change nothing. A cap of 10⁶ frames is none, but for f32:
    // confidences double in each frame.
    assert!(long > 0.02 && long > 0.5 * short, "{short} {long}");
    let [short, long] = [100, 3000].map(|frames| squared_error(5.0, frames));
    assert!(long < 0.005 && long < 0.1 * short, "{short} {long}");
}
