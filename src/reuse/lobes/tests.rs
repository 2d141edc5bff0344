//! Sets of techniques that learn, enumerated: two directions, `p_h` = (½, ½), lobes (⅞, ⅛) and (⅛,
//! ⅞), b = ⅕; a technique learns from each direction that found light. Everything is a fraction.

use super::{LobeChain, LobeState, Permutation};
use crate::math::rng::RandomSource;
use crate::resampling::laws::check_invariance;
use crate::resampling::{Mutator, Proposal};
use crate::stats::{Enumerator, Rational, enumerate, expectation};

fn ratio(numerator: i128, denominator: i128) -> Rational {
    Rational::new(numerator, denominator)
}

/// Eighths of a lobe's density at direction 0, by the direction that it aims at.
#[derive(Clone, Copy)]
struct Lobes([i128; 2]);

const SOFT: Lobes = Lobes([7, 1]);
/// A lobe that never looks where it does not aim.
const HARD: Lobes = Lobes([8, 0]);

/// A direction that a technique drew: its density by each technique is asked for later.
#[derive(Clone, Copy)]
struct Draw {
    direction: usize,
    /// Where the lobe aims, if there is one.
    lobe: Option<usize>,
    large: bool,
}

impl Lobes {
    fn density(self, lobe: usize, direction: usize) -> Rational {
        let at_zero = self.0[lobe];
        ratio(if direction == 0 { at_zero } else { 8 - at_zero }, 8)
    }

    fn draw(self, lobe: Option<usize>, random: &mut Enumerator) -> Draw {
        let large = lobe.is_none() || random.choose(1.0, 5.0);
        let zero = match lobe {
            Some(lobe) if !large => random.choose(self.0[lobe] as f32, 8.0),
            _ => random.choose(1.0, 2.0),
        };
        Draw { direction: usize::from(!zero), lobe, large }
    }

    /// The mixture of a technique's branches, or with `branch` that of the one that drew.
    fn technique(self, of: &Draw, direction: usize, branch: bool) -> Rational {
        let large = ratio(1, 2);
        match of.lobe {
            None => large,
            Some(lobe) if branch && !of.large => self.density(lobe, direction),
            Some(_) if branch => large,
            Some(lobe) => ratio(1, 5) * large + ratio(4, 5) * self.density(lobe, direction),
        }
    }
}

/// The ways in which states may move in a step.
#[derive(Clone, Copy, PartialEq)]
enum Moves {
    /// Each lane takes that of the lane before.
    Shift,
    /// None moves.
    None,
    /// Lanes without a pixel hand nothing on: those behind them keep their own.
    DeadKeep,
}

/// The mean of lane 0's estimate by the sum of its own n techniques' densities.
fn tsmis(
    lanes: u32,
    n: usize,
    f: [i128; 2],
    dead: u32,
    moves: Moves,
    (lobes, branch): (Lobes, bool),
) -> Rational {
    let outcomes = enumerate(|random| {
        let mut states: Vec<Option<usize>> = vec![None; lanes as usize];
        let mut permutation = Permutation::new(lanes);
        let mut history: Vec<Draw> = Vec::new();
        for _ in 0..n {
            if moves == Moves::Shift {
                permutation.shift();
            }
            for lane in 0..lanes - dead {
                let state = &mut states[permutation.slot(lane)];
                let draw = lobes.draw(*state, random);
                if f[draw.direction] > 0 {
                    *state = Some(draw.direction);
                }
                if lane == 0 {
                    history.push(draw);
                }
            }
        }
        history.iter().fold(ratio(0, 1), |sum, draw| {
            let density = history
                .iter()
                .fold(ratio(0, 1), |sum, of| sum + lobes.technique(of, draw.direction, branch));
            sum + ratio(f[draw.direction], 1) * density.recip()
        })
    });
    expectation(&outcomes, |estimate| *estimate)
}

/// The mean of lane 0's estimate of n steps, each by the mean density of all lanes' lobes; each
/// lane has its own F.
fn ssmis(f: &[[i128; 2]], n: usize, permuted: bool) -> Rational {
    let lanes = f.len() as u32;
    let outcomes = enumerate(|random| {
        let mut states: Vec<Option<usize>> = vec![None; f.len()];
        let mut permutation = Permutation::new(lanes);
        let mut sum = ratio(0, 1);
        for _ in 0..n {
            let set = states.clone();
            if permuted {
                permutation.turn(random.index(lanes));
            }
            for (lane, f) in f.iter().enumerate() {
                let state = &mut states[permutation.slot(lane as u32)];
                let draw = SOFT.draw(*state, random);
                if lane == 0 && f[draw.direction] > 0 {
                    let density = set.iter().fold(ratio(0, 1), |sum, lobe| {
                        let of = Draw { lobe: *lobe, ..draw };
                        sum + SOFT.technique(&of, draw.direction, false)
                    });
                    let mean = density * ratio(1, lanes.into());
                    sum = sum + ratio(f[draw.direction], n as i128) * mean.recip();
                }
                if f[draw.direction] > 0 {
                    *state = Some(draw.direction);
                }
            }
        }
        sum
    });
    expectation(&outcomes, |estimate| *estimate)
}

/// A sample meets the pixel that drew it again after as many steps as there are lanes, so n samples
/// of n lanes are unbiased and n + 1 are not.
#[test]
fn samples_come_back_after_as_many_steps_as_lanes() {
    let (one, both) = ([1, 0], [3, 1]);
    let mixture = (SOFT, false);
    let shifted = |lanes, n, f| tsmis(lanes, n, f, 0, Moves::Shift, mixture);
    assert_eq!([shifted(2, 2, one), shifted(2, 2, both)], [ratio(1, 1), ratio(4, 1)]);
    assert_eq!([shifted(3, 3, one), shifted(3, 3, both)], [ratio(1, 1), ratio(4, 1)]);
    let still = |f| tsmis(2, 2, f, 0, Moves::None, mixture);
    assert_eq!([still(one), still(both)], [ratio(49, 52), ratio(304, 91)]);
    assert_eq!([shifted(1, 2, one), shifted(1, 2, both)], [ratio(49, 52), ratio(304, 91)]);
    assert!(shifted(2, 3, one) == ratio(83, 84) && shifted(2, 3, both) == ratio(80, 21));
}

/// Lanes without a pixel hand states on; where the lane behind one keeps its own instead, it meets
/// its own sample.
#[test]
fn lanes_without_a_pixel_hand_states_on() {
    let mean = |moves| tsmis(2, 2, [1, 0], 1, moves, (SOFT, false));
    assert_eq!(mean(Moves::Shift), ratio(1, 1));
    assert_eq!(mean(Moves::DeadKeep), ratio(49, 52));
}

/// Densities of the branch that drew are as right in the mean as those of the mixture, but for
/// directions that a lobe never draws; what the mixture brings is less variance.
#[test]
fn the_mixture_is_for_variance() {
    let mean = |lobes, branch| tsmis(2, 2, [3, 1], 0, Moves::Shift, (lobes, branch));
    assert_eq!(mean(SOFT, true), ratio(4, 1));
    assert_eq!([mean(HARD, false), mean(HARD, true)], [ratio(4, 1), ratio(4, 1)]);
}

/// Without the turn a lane draws from its own lobe alone, and the mean over the tile's lobes is no
/// longer the density: where neighbours see other lights. Where all see the same, nobody can tell.
#[test]
fn the_lobe_that_draws_is_chosen_uniformly() {
    let (same, other) = ([[3, 1], [3, 1]], [[1, 0], [0, 1]]);
    assert_eq!([ssmis(&same, 3, true), ssmis(&same, 3, false)], [ratio(4, 1), ratio(4, 1)]);
    assert_eq!(ssmis(&other, 3, true), ratio(1, 1));
    assert_eq!(ssmis(&other, 3, false), ratio(1309, 1040));
}

/// A lane of one technique at frame t: numbers of eight levels, of which the lobe (6, 2)/8 takes
/// six. Where a number comes again that the technique has learnt from, it says where it lies.
#[test]
fn numbers_are_never_drawn_again() {
    let mean = |frames: usize, number: &dyn Fn(usize) -> usize| {
        let outcomes = enumerate(|random| {
            let numbers: Vec<u32> = (0..frames).map(|_| random.index(8)).collect();
            let mut lobe = None;
            let mut estimate = ratio(0, 1);
            for frame in 0..frames {
                // Lobes aim at the direction that found light, which is the first.
                let limit = if lobe.is_some() { 6 } else { 4 };
                let first = numbers[number(frame)] < limit;
                estimate = if first { ratio(8, i128::from(limit)) } else { ratio(0, 1) };
                if first {
                    lobe = Some(0);
                }
            }
            estimate
        });
        expectation(&outcomes, |estimate| *estimate)
    };
    assert_eq!([2, 3, 4].map(|frames| mean(frames, &|frame| frame)), [ratio(1, 1); 3]);
    assert_eq!([2, 3, 4].map(|frames| mean(frames, &|_| 0)), [ratio(2, 3); 3]);
    assert_eq!(mean(3, &|frame| frame % 2), ratio(5, 6));
}

/// The chain keeps F where the technique stands still, by the mixture's density; where the
/// technique is the chain's own lobe it does not: (13/5, 7/5) for (3, 1).
#[test]
fn chains_keep_the_integrand_of_a_technique_that_stands_still() {
    const F: [f32; 2] = [3.0, 1.0];
    // b p_h + (1 − b) V of the lobe that aims at 0, and of the one that aims at 1.
    let mixture = |lobe: usize, direction: usize| if lobe == direction { 0.8_f32 } else { 0.2 };
    let state = |direction: usize, score: f32| {
        let mut lobe = LobeState::NONE;
        (lobe.light, lobe.weight, lobe.score) = (direction as u32, 1.0, score);
        lobe
    };
    let step = |technique: &dyn Fn(usize) -> usize, from: usize| -> Vec<(usize, f64)> {
        let t = technique(from);
        let now = state(from, F[from] / mixture(t, from));
        let mut reached = vec![(from, 1.0)];
        for direction in [0, 1] {
            let proposed = state(direction, F[direction] / mixture(t, direction));
            let mut chain = LobeChain(|| Some(proposed));
            let random = &mut crate::math::rng::Stream::from_key(1);
            let Some(Proposal { acceptance, .. }) = chain.propose(&now, random) else { continue };
            let probability = f64::from(mixture(t, direction) * acceptance);
            reached.push((direction, probability));
            reached[0].1 -= probability;
        }
        reached
    };
    check_invariance(&F.map(f64::from), |from| step(&|_| 0, from), 1e-6);
    let mut after = [0.0; 2];
    for from in [0, 1] {
        for (to, probability) in step(&|own| own, from) {
            after[to] += f64::from(F[from]) * probability;
        }
    }
    assert!((after[0] - 2.6).abs() < 1e-6 && (after[1] - 1.4).abs() < 1e-6, "{after:?}");
    // A state without a score is left at once, and a draw that found nothing proposes nothing.
    let random = &mut crate::math::rng::Stream::from_key(1);
    let proposal = LobeChain(|| Some(state(0, 0.1))).propose(&LobeState::NONE, random);
    assert_eq!(proposal.map(|proposal| proposal.acceptance), Some(1.0));
    assert!(LobeChain(|| None).propose(&state(0, 1.0), random).is_none());
}
