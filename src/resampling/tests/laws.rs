//! The laws on what is here, and on implementations that break them.

use glam::Vec3;

use super::Finite;
use crate::math::rng::{RandomSource, Stream};
use crate::resampling::laws::{check_invariance, check_regular, check_reservoir, check_shift};
use crate::resampling::{
    Identity, Mutator, Plain, Proposal, Reservoir, ShiftMap, Shifted, WithRadiance, WithVisibility,
    metropolis,
};
use crate::stats::enumerate_f64;

#[test]
fn all_reservoirs_keep_the_laws() {
    let samples = [7_u32, 1, 5, 2, 9];
    check_reservoir::<Plain<u32>>(&samples, ());
    check_reservoir::<WithVisibility<Plain<u32>>>(&samples, ((), 0.25));
    check_reservoir::<WithRadiance<WithVisibility<Plain<u32>>>>(&samples, (((), 0.25), Vec3::ONE));
}

/// A plain reservoir with one of three faults.
#[derive(Default)]
struct Broken<const FAULT: u8>(Plain<u32>);

const TAKES_ZEROS: u8 = 0;
const FIRST_COME: u8 = 1;
const TRUSTING: u8 = 2;

impl<const FAULT: u8> Reservoir for Broken<FAULT> {
    type Sample = u32;
    type Carried = ();

    fn stream(
        &mut self,
        sample: u32,
        weight: f32,
        carried: (),
        random: &mut impl RandomSource,
    ) -> bool {
        match FAULT {
            // As u·Σw <= w at u = 0.
            TAKES_ZEROS if weight == 0.0 => {
                self.0 = Plain::default();
                self.0.stream(sample, 1.0, carried, random)
            }
            // The weight before instead of after the candidate in the total.
            FIRST_COME if self.0.weight_sum() > 0.0 && weight > 0.0 => {
                let total = self.0.weight_sum().max(weight);
                let taken = random.choose(weight, total);
                let mut other = Plain::default();
                let kept = if taken { Some(sample) } else { self.0.selected() };
                other.stream(kept.unwrap_or(sample), self.0.weight_sum() + weight, (), random);
                self.0 = other;
                taken
            }
            TRUSTING if !weight.is_finite() => false,
            _ => self.0.stream(sample, weight, carried, random),
        }
    }

    fn selected(&self) -> Option<u32> {
        self.0.selected()
    }

    fn weight_sum(&self) -> f32 {
        self.0.weight_sum()
    }

    fn rejected(&self) -> u32 {
        self.0.rejected()
    }
}

#[test]
#[should_panic(expected = "law 2: weight 0 was selected")]
fn a_reservoir_that_selects_zero_weights_is_found() {
    check_reservoir::<Broken<TAKES_ZEROS>>(&[7, 1, 5, 2], ());
}

#[test]
#[should_panic(expected = "law 1: candidate")]
fn a_reservoir_with_the_wrong_total_is_found() {
    check_reservoir::<Broken<FIRST_COME>>(&[7, 1, 5, 2], ());
}

#[test]
#[should_panic(expected = "was not counted")]
fn a_reservoir_that_does_not_count_what_it_rejects_is_found() {
    check_reservoir::<Broken<TRUSTING>>(&[7, 1, 5, 2], ());
}

/// Three domains of three states, with a state that maps nowhere and Jacobians of 1/4 to 4.
fn finite() -> Finite {
    Finite {
        mass: vec![vec![1.0, 2.0, 0.5], vec![2.0, 0.5, 1.0], vec![0.25, 1.0, 4.0]],
        target: vec![vec![1.0, 0.0, 2.0], vec![3.0, 1.0, 0.0], vec![1.0, 1.0, 5.0]],
        image: vec![
            vec![Some(0), Some(1), Some(2)],
            vec![Some(1), None, Some(0)],
            vec![Some(2), Some(0), None],
        ],
    }
}

#[test]
fn shifts_keep_the_laws() {
    let mut identity = Identity::new(|x: &f32, scale: &f32| x * scale);
    check_shift(&mut identity, &[0.0, 0.5, 2.0], &[1.0, 3.0], 0.0, |a, b| a == b);
    check_shift(&mut finite(), &[0, 1, 2], &[0, 1, 2], 1e-6, |a, b| a == b);
}

/// The map of another, with a fault.
struct Faulty(Finite, fn(&mut Shifted<usize, f32>, usize, usize));

impl ShiftMap for Faulty {
    type Sample = usize;
    type Domain = usize;
    type Integrand = f32;
    type Stratum = ();

    fn shift(&mut self, sample: &usize, from: &usize, to: &usize) -> Option<Shifted<usize, f32>> {
        let mut shifted = self.0.shift(sample, from, to)?;
        (self.1)(&mut shifted, *from, *to);
        Some(shifted)
    }

    fn stratum(&self, _sample: &usize) {}
}

#[test]
#[should_panic(expected = "law 2")]
fn a_jacobian_inverted_one_way_is_found() {
    let fault = |s: &mut Shifted<_, _>, from, to| {
        if from < to {
            s.jacobian = 1.0 / s.jacobian;
        }
    };
    check_shift(&mut Faulty(finite(), fault), &[0, 1, 2], &[0, 1, 2], 1e-6, |a, b| a == b);
}

#[test]
#[should_panic(expected = "law 1")]
fn a_map_that_does_not_lead_back_is_found() {
    let fault = |s: &mut Shifted<usize, _>, from, to| {
        if (from, to) == (0, 1) {
            s.sample = 1 - s.sample;
        }
    };
    check_shift(&mut Faulty(finite(), fault), &[0, 1, 2], &[0, 1, 2], 1e9, |a, b| a == b);
}

#[test]
#[should_panic(expected = "law 3")]
fn a_map_that_moves_a_sample_at_home_is_found() {
    let fault = |s: &mut Shifted<usize, _>, from, to| {
        if from == to {
            s.sample = (s.sample + 1) % 3;
        }
    };
    check_shift(&mut Faulty(finite(), fault), &[0, 1, 2], &[0, 1, 2], 1e9, |a, b| a == b);
}

/// A random walk on a ring whose acceptance is a function of the two targets.
pub(super) struct Ring<'a> {
    pub(super) target: &'a [f32],
    pub(super) acceptance: fn(f32, f32) -> f32,
}

/// Metropolis for a symmetric proposal.
pub(super) fn metropolis_rule(before: f32, after: f32) -> f32 {
    (after / before).min(1.0)
}

impl Mutator for Ring<'_> {
    type State = usize;

    fn propose(
        &mut self,
        &state: &usize,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<usize>> {
        let n = self.target.len();
        let to = (state + if random.index(2) == 0 { 1 } else { n - 1 }) % n;
        let acceptance = (self.acceptance)(self.target[state], self.target[to]);
        Some(Proposal { state: to, acceptance })
    }
}

fn kernel(ring: &mut Ring<'_>, from: usize, steps: u32) -> Vec<(usize, f64)> {
    enumerate_f64(|random| metropolis(ring, from, steps, random).state)
        .into_iter()
        .map(|outcome| (outcome.value, outcome.probability))
        .collect()
}

const RING: [f32; 4] = [1.0, 2.0, 5.0, 3.0];

#[test]
fn metropolis_leaves_its_target_invariant_for_any_number_of_steps() {
    let mut ring = Ring { target: &RING, acceptance: metropolis_rule };
    for steps in [1, 2, 3, 5] {
        check_invariance(&RING.map(f64::from), |from| kernel(&mut ring, from, steps), 1e-7);
    }
    check_regular(&mut ring, &[0, 1, 2, 3], &mut Stream::from_key(1));
}

#[test]
#[should_panic(expected = "law 1: state 0 has target 1")]
fn an_inverted_acceptance_is_found() {
    let mut ring = Ring { target: &RING, acceptance: |a, b| metropolis_rule(b, a) };
    check_invariance(&RING.map(f64::from), |from| kernel(&mut ring, from, 1), 1e-7);
}

/// Steps up from an even state; odd ones never propose.
struct OneWay;

impl Mutator for OneWay {
    type State = usize;

    fn propose(
        &mut self,
        &state: &usize,
        _random: &mut impl RandomSource,
    ) -> Option<Proposal<usize>> {
        state.is_multiple_of(2).then_some(Proposal { state: state + 1, acceptance: 1.0 })
    }
}

#[test]
#[should_panic(expected = "law 2: a state was proposed that never proposes")]
fn a_proposal_into_a_state_that_never_proposes_is_found() {
    check_regular(&mut OneWay, &[0], &mut Stream::from_key(1));
}
