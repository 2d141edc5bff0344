//! Directions that two lobes can draw, as numbers: F holds the total density, the Jacobian the
//! joint one. And what holds of any stream of candidates, in whatever order they come.

use super::{Finite, Sample, ShiftMap, Shifted, assert_close, is_close};
use crate::math::rng::{RandomSource, Stream};
use crate::resampling::{Family, Input, Plain, Reservoir, merge};
use crate::stats::enumerate_f64;

/// Receivers that share three directions and have two lobes each. States are (lobe, direction), at
/// lobe · 3 + direction; their mass, what a state takes of the space of numbers, is the joint
/// density of both.
struct Lobes {
    map: Finite,
    /// Σ f of the canonical receiver.
    sum: f64,
    /// p̄ by receiver and direction.
    totals: Vec<[f32; 3]>,
}

/// One receiver: f by direction, the lobes' probabilities and their densities by direction.
type Receiver = ([f32; 3], [f32; 2], [[f32; 3]; 2]);

impl Lobes {
    fn new(receivers: &[Receiver]) -> Self {
        let masses = |of: &Receiver| (0..6).map(|state| mass_of(of, state)).collect();
        let mass: Vec<Vec<f32>> = receivers.iter().map(masses).collect();
        let totals: Vec<[f32; 3]> =
            mass.iter().map(|mass| [0, 1, 2].map(|at| mass[at] + mass[at + 3])).collect();
        let target = receivers.iter().zip(&totals).zip(&mass).map(|(((f, ..), total), mass)| {
            let of = |state: usize| f[state % 3] / total[state % 3];
            (0..6).map(|state| if mass[state] > 0.0 { of(state) } else { 0.0 }).collect()
        });
        // A lobe that cannot draw a direction has no numbers for it: T is undefined there.
        let there = |mass: &Vec<f32>, state: usize| {
            (mass[state] > 0.0 && mass_of(&receivers[0], state) > 0.0).then_some(state)
        };
        let image =
            mass.iter().map(|mass| (0..6).map(|state| there(mass, state)).collect()).collect();
        let sum = receivers[0].0.iter().map(|f| f64::from(*f)).sum();
        let map = Finite { target: target.collect(), image, mass };
        Self { map, sum, totals }
    }

    /// A state by its numbers, uniform in them.
    fn drawn(&self, receiver: usize, random: &mut impl RandomSource) -> Sample {
        let mass = &self.map.mass[receiver];
        let mut reservoir = Plain::default();
        for (state, &mass) in mass.iter().enumerate() {
            reservoir.stream(state, mass, (), random);
        }
        // A fresh state's W is 1: its numbers were uniform.
        let state = reservoir.selected().expect("some state has a mass");
        super::merging::certain(state, 1.0, 1.0)
    }
}

/// Joint density of a state's lobe and direction.
fn mass_of((_, chance, density): &Receiver, state: usize) -> f32 {
    chance[state / 3] * density[state / 3][state % 3]
}

/// The map with a Jacobian of total densities.
struct Totals<'a>(&'a Lobes);

impl ShiftMap for Totals<'_> {
    type Sample = usize;
    type Domain = usize;
    type Integrand = f32;
    type Stratum = ();

    fn shift(&mut self, sample: &usize, from: &usize, to: &usize) -> Option<Shifted<usize, f32>> {
        let shifted = self.0.map.clone().shift(sample, from, to)?;
        let totals = &self.0.totals;
        let jacobian = totals[*to][shifted.sample % 3] / totals[*from][sample % 3];
        Some(Shifted { jacobian, ..shifted })
    }

    fn stratum(&self, _: &usize) {}
}

/// E[F(Y) W] of a merge of fresh samples of all receivers.
fn mean<T>(lobes: &Lobes, family: Family, mut map: T) -> f64
where
    T: ShiftMap<Sample = usize, Domain = usize, Integrand = f32>,
{
    let outcomes = enumerate_f64(|random| {
        let domains: Vec<usize> = (0..lobes.map.mass.len()).collect();
        let inputs: Vec<Input<'_, _, _, _>> =
            domains.iter().map(|d| lobes.map.input(lobes.drawn(*d, random), d)).collect();
        let (canonical, others) = inputs.split_first().unwrap();
        let mut reservoir = Plain::default();
        let out = merge(&mut map, family, canonical, others, &mut reservoir, random, |_| ());
        f64::from(out.target) * f64::from(out.finished.weight.get())
    });
    crate::stats::expectation(&outcomes, |value| *value)
}

/// Totals f/p̄ in F and joint densities in J are exact for any lobes that overlap, whose choice
/// differs between receivers, one of which is as rare as one in a million; a lobe that cannot draw
/// a direction loses nothing, since the other's F is larger. With totals in J the mean is off.
#[test]
fn f_has_totals_and_the_jacobian_joint_densities() {
    let even: Receiver = ([1.0, 2.0, 4.0], [0.5, 0.5], [[0.7, 0.2, 0.1], [0.1, 0.1, 0.8]]);
    let uneven: Receiver = ([3.0, 1.0, 2.0], [0.9, 0.1], [[0.2, 0.5, 0.3], [0.0, 0.4, 0.6]]);
    // A lobe that is chosen once in a million times.
    let rare: Receiver =
        ([2.0, 0.5, 1.0], [1e-6, 1.0 - 1e-6], [[0.5, 0.25, 0.25], [0.3, 0.3, 0.4]]);
    for receivers in [vec![even, uneven], vec![uneven, even], vec![rare, even, uneven]] {
        let lobes = Lobes::new(&receivers);
        for family in Family::ALL.into_iter().filter(|family| family.partitions_unity()) {
            assert_close(mean(&lobes, family, lobes.map.clone()), lobes.sum);
            let wrong = mean(&lobes, family, Totals(&lobes));
            assert!((wrong / lobes.sum - 1.0).abs() > 0.005, "{family:?}: {wrong}");
        }
    }
}

/// A stream keeps each candidate as often as a list that is known as a whole: w / Σw, in whatever
/// order they come.
#[test]
fn the_order_of_a_stream_means_nothing() {
    let weights = [1.0, 2.0, 0.0, 4.0_f32];
    for order in [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1], [1, 3, 0, 2]] {
        let outcomes = enumerate_f64(|random| {
            let mut reservoir = Plain::default();
            for at in order {
                reservoir.stream(at, weights[at], (), random);
            }
            assert_eq!(reservoir.weight_sum(), 7.0);
            reservoir.selected().unwrap()
        });
        for (at, weight) in weights.iter().enumerate() {
            let kept =
                crate::stats::expectation(&outcomes, |kept| f64::from(u8::from(*kept == at)));
            assert_close(kept, f64::from(*weight) / 7.0);
        }
    }
}

/// Merging two of three first, whichever they are, and the third afterwards, is merging all three:
/// where targets are the same and confidences are counts, the selected states and their weights
/// agree in distribution.
#[test]
fn merges_are_associative() {
    let target: &[f32] = &[1.0, 3.0, 0.5];
    let map = Finite::shared(&[target, target, target]);
    // E[1{Y = y}] and E[1{Y = y} W].
    let found = |how: u32, family: Family| -> Vec<f64> {
        let outcomes = enumerate_f64(|random| {
            let inputs = [0, 1, 2].map(|domain| map.initial(domain, (1, 1.0), random));
            let mut two = |a: Sample, b: Sample| {
                super::merging::merged(&map, family, &[a, b], random, |_| ()).0.finished
            };
            let [a, b, c] = inputs;
            let out = match how {
                0 => {
                    let first = two(a, b);
                    two(first, c)
                }
                1 => {
                    let later = two(b, c);
                    two(a, later)
                }
                _ => super::merging::merged(&map, family, &inputs, random, |_| ()).0.finished,
            };
            (out.sample.unwrap(), f64::from(out.weight.get()))
        });
        let of = |f: &dyn Fn(usize, f64) -> f64| {
            crate::stats::expectation(&outcomes, |(state, weight)| f(*state, *weight))
        };
        let mut all: Vec<f64> =
            (0..3).map(|y| of(&|state, _| f64::from(u8::from(state == y)))).collect();
        all.extend((0..3).map(|y| of(&|state, w| if state == y { w } else { 0.0 })));
        all
    };
    for family in [Family::Constant, Family::Balance, Family::Pairwise] {
        let whole = found(2, family);
        for how in [0, 1] {
            let nested = found(how, family);
            assert!(nested.iter().zip(&whole).all(|(a, b)| is_close(*a, *b)), "{family:?}");
        }
    }
}

/// Defensive weights leave the canonical input its share at least, and no merge of inputs that each
/// weigh one can weigh more than Cₙ² / (C c) for the others and one for the canonical: others
/// whose p̂ is far below the canonical's are worth little (Lin et al. 2022, eq. 39).
#[test]
fn defensive_weights_are_bounded() {
    let mut random = Stream::from_key(44);
    let mut largest = 0.0_f32;
    for _ in 0..3000 {
        let map = Finite::random(&mut random);
        let count = map.mass.len();
        let confidences: Vec<f32> =
            (0..count).map(|_| [1.0, 20.0, 7.0 / 3.0][random.index(3) as usize]).collect();
        let inputs: Vec<Sample> = (0..count)
            .map(|domain| {
                let state = random.index(map.mass[domain].len() as u32) as usize;
                let target = map.target[domain][state];
                if target == 0.0 {
                    return Sample::empty(confidences[domain]);
                }
                super::merging::certain(state, 1.0 / target, confidences[domain])
            })
            .collect();
        let total: f32 = confidences.iter().sum();
        let (own, others) = (confidences[0], total - confidences[0]);
        let mut sum = 0.0;
        let family = Family::DefensivePairwise;
        super::merging::merged(&map, family, &inputs, &mut random, |term| {
            if term.input == 0 {
                assert!(term.mis >= own / total - 1e-6, "{} of {own} in {total}", term.mis);
                assert!(term.mis <= 1.0 + 1e-6);
            } else {
                sum += term.weight;
            }
        });
        let bound = others * others / (total * own);
        assert!(sum <= bound * (1.0 + 1e-5) + 1e-6, "{sum} above {bound}");
        largest = largest.max(if bound > 0.0 { sum / bound } else { 0.0 });
    }
    assert!(largest > 0.4, "the bound is far away: {largest}");
}
