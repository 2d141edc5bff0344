//! Mutations: moving a finished sample by a Markov chain between two reuses, so that pixels that
//! took the same sample stop sharing it (Sawhney et al. 2024).
//!
//! If a kernel K leaves p̂ invariant, Σₓ p̂(x) K(x→y) = p̂(y), and X has contribution weight W,
//! then Y ~ K(X, ·) has W′ = W p̂(X) / p̂(Y): E[f(Y) W′] = ∫ f. X need not be distributed like p̂,
//! and p̂(Y) W′ = p̂(X) W: the pixel's own luminance estimate never changes.

use std::f32::consts::TAU;

use glam::Vec2;

use crate::math::rng::RandomSource;

/// A state that a chain might move to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal<S> {
    /// Where to.
    pub state: S,
    /// Probability to accept, in [0, 1].
    pub acceptance: f32,
}

/// A Markov kernel that leaves a target p̂ invariant, in the measure of the sample's contribution
/// weight.
///
/// Laws:
/// 1. Invariance: with the Metropolis rule, Σₓ p̂(x) K(x→y) = p̂(y).
/// 2. `None` means that the state stays; it may depend on state and numbers only, and the same test
///    must hold for the state proposed from (a proposal that is never made must not be accepted in
///    the other direction).
/// 3. How often a chain is moved may depend on what the kernel preserves and on the surface, never
///    on the sample's weight, age or origin.
pub trait Mutator {
    /// The chain's state.
    type State: Clone;

    /// A proposal, or `None`: stay.
    fn propose(
        &mut self,
        state: &Self::State,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<Self::State>>;
}

/// Where a chain ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain<S> {
    /// The chain's state after the last step, whether or not the last proposal was accepted.
    pub state: S,
    /// Accepted proposals.
    pub accepted: u32,
}

/// Moves a chain `steps` times.
///
/// The state is always committed. Committing only if the *last* proposal was accepted, as the
/// pseudo-code of Fickel (2023, alg. 3) has it, is not invariant for two or more steps: the error
/// is Σ f(y) ((Pⁿ⁻¹ r)(y) − r(y)), with r the rejection probability.
pub fn metropolis<M: Mutator>(
    mutator: &mut M,
    state: M::State,
    steps: u32,
    random: &mut impl RandomSource,
) -> Chain<M::State> {
    let mut chain = Chain { state, accepted: 0 };
    for _ in 0..steps {
        if let Some(proposal) = mutator.propose(&chain.state, random) {
            debug_assert!(
                (0.0..=1.0).contains(&proposal.acceptance),
                "an acceptance is {}",
                proposal.acceptance
            );
            if random.choose(proposal.acceptance, 1.0) {
                chain.state = proposal.state;
                chain.accepted += 1;
            }
        }
    }
    chain
}

/// W′ = W p̂(X) / p̂(Y); 0 where p̂(Y) is 0, which no chain reaches.
#[inline]
#[must_use]
pub fn mutated_weight(weight: f32, target_before: f32, target_after: f32) -> f32 {
    let mutated = weight * (target_before / target_after);
    if mutated.is_finite() { mutated } else { 0.0 }
}

/// A symmetric step of two numbers on the torus: every step is as likely as its reverse.
pub trait SmallStep {
    /// Where it leads, in [0, 1)².
    fn step(u: Vec2, random: &mut impl RandomSource) -> Vec2;
}

/// |Δ| of each number between 1/1024 and 1/64, log-uniform (Kelemen et al. 2002, with the bounds of
/// common implementations of primary-sample-space MLT).
#[derive(Clone, Copy, Debug)]
pub struct Kelemen;

/// Normal steps of standard deviation 1/64, the largest step of [`Kelemen`]'s.
#[derive(Clone, Copy, Debug)]
pub struct Gaussian;

const LARGEST: f32 = 1.0 / 64.0;
/// ln 16, of the ratio of Kelemen's bounds.
const LOG_RATIO: f32 = 2.772_588_7;

#[inline]
fn wrap(u: f32) -> f32 {
    let wrapped = u - u.floor();
    // Just below 0 it may round to 1.
    if wrapped < 1.0 { wrapped } else { 0.0 }
}

impl SmallStep for Kelemen {
    #[inline]
    fn step(u: Vec2, random: &mut impl RandomSource) -> Vec2 {
        let mut moved = |u: f32| {
            let step = LARGEST * (-LOG_RATIO * random.uniform()).exp();
            wrap(if random.choose(1.0, 2.0) { u + step } else { u - step })
        };
        let x = moved(u.x);
        Vec2::new(x, moved(u.y))
    }
}

impl SmallStep for Gaussian {
    #[inline]
    fn step(u: Vec2, random: &mut impl RandomSource) -> Vec2 {
        // Box and Muller (1958); 1 − u is in (0, 1].
        let radius = LARGEST * (-2.0 * (1.0 - random.uniform()).ln()).sqrt();
        let (sin, cos) = (TAU * random.uniform()).sin_cos();
        Vec2::new(wrap(u.x + radius * cos), wrap(u.y + radius * sin))
    }
}
