//! Resampled importance sampling with reuse between domains, for any kind of sample: the part of
//! every ReSTIR method that knows no renderer.
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | p̂ᵢ(y) | `target` | what a reservoir of domain i draws in proportion to; the luminance of the integrand |
//! | W | [`ContributionWeight`] | E\[W given Y\] = 1/p(Y), so that E\[f(Y) W\] = ∫ f; in units of 1 / measure |
//! | c | `confidence` | how much a reservoir counts in MIS weights; a relative weight, not a number of samples |
//! | T, \|∂T\| | [`ShiftMap`], `jacobian` | a partial bijection between two domains |
//! | p̂←ᵢ(y) | `from` | p̂ᵢ(T⁻¹ y) \|∂T⁻¹\|: domain i's target as the canonical domain sees it; 0 where T⁻¹ is undefined |
//! | mᵢ(y) | [`mis`] | MIS weight of input i; Σ mᵢ = 1 over the inputs that can produce y |
//! | wᵢ | `weight` | mᵢ p̂(T yᵢ) Wᵢ \|∂T\|: the weight with which input i is streamed |
//! | κ | canonical | the input of the domain itself, for which T is the identity |
//!
//! The four traits state numbered laws; [`laws`] checks them on any implementation, yours included.
//!
//! | trait | is | implementations here |
//! |---|---|---|
//! | [`Reservoir`] | a stream of weighted candidates in, one finished sample out | [`Plain`], [`WithVisibility`], [`WithRadiance`] |
//! | [`ShiftMap`] | a partial bijection between domains | [`Identity`]; others live with their samples |
//! | [`Mutator`] | a kernel that leaves a target invariant | they live with their samples; [`metropolis`] drives them |
//! | [`Estimator`] | a finished pixel to radiance, and what that promises | [`Selected`], [`WeightedVisibility`], [`ControlVariate`], [`Decoupled`] |
//!
//! Papers: Lin et al. (2022), *Generalized Resampled Importance Sampling*; Bitterli et al. (2020),
//! *Spatiotemporal reservoir resampling*; Sawhney et al. (2024), *Decorrelating ReSTIR Samplers via
//! MCMC Mutations*; Tokuyoshi (2024), *Efficient Visibility Reuse for Real-time ReSTIR*.
//!
//! # Example: two integrals that share their samples
//!
//! ```
//! use afterimage::math::rng::{RandomSource, Stream};
//! use afterimage::resampling::{Counting, Family, Finished, Identity, Input, Plain, Reservoir, merge};
//!
//! // Two pixels estimate ∫ x² dx = 1/3 and ∫ (1 − x)² dx = 1/3 over [0, 1]; a domain is the pixel's integrand.
//! let domains: [fn(&f32) -> f32; 2] = [|x| x * x, |x| (1.0 - x) * (1.0 - x)];
//! let mut map = Identity::new(|x: &f32, f: &fn(&f32) -> f32| f(x));
//! let mut random = Stream::from_key(1);
//! let (mut sum, n) = (0.0, 40_000);
//! for _ in 0..n {
//!     // Each takes one of four uniform candidates in proportion to its integrand. p = 1, so a candidate weighs f / (4 p).
//!     let mut inputs = Vec::new();
//!     for domain in &domains {
//!         let mut reservoir = Plain::default();
//!         for _ in 0..4 {
//!             let x = random.uniform();
//!             reservoir.stream(x, domain(&x) / 4.0, (), &mut random);
//!         }
//!         let target = reservoir.selected().map_or(0.0, |x| domain(&x));
//!         let finished: Finished<f32, Counting> = reservoir.finish(target, 1.0);
//!         inputs.push(Input { finished, target, domain });
//!     }
//!     // The first pixel also takes the second one's sample, in its own domain.
//!     let merged = merge(
//!         &mut map,
//!         Family::DefensivePairwise,
//!         &inputs[0],
//!         &inputs[1..],
//!         &mut Plain::default(),
//!         &mut random,
//!         |_| (),
//!     );
//!     sum += f64::from(merged.target * merged.finished.weight.get());
//! }
//! assert!((sum / f64::from(n) - 1.0 / 3.0).abs() < 0.003);
//! ```

mod claim;
mod estimate;
pub mod laws;
mod merge;
pub mod mis;
mod mutate;
mod reservoir;
mod shift;
#[cfg(test)]
mod tests;

/// Reservoirs, MIS weights and mutations in WGSL; needs [`crate::math::rng`]'s.
pub const RESAMPLING_WGSL: Module = crate::wgsl!("resampling.wgsl");
/// [`merge()`] and [`merge_history`] in WGSL; its head says what a host adds.
pub const MERGE_WGSL: Module = crate::wgsl!("merge.wgsl");

pub use claim::Claim;
pub use estimate::{
    ControlVariate, Decoupled, DecoupledState, Estimator, Merges, Selected, SelectedState,
    WeightedVisibility,
};
pub use merge::{Input, Merged, OtherInputs, Term, merge, merge_history};
pub use mis::Family;
pub use mutate::{
    Chain, Gaussian, Kelemen, Mutator, Proposal, SmallStep, metropolis, mutated_weight,
};
pub use reservoir::{
    ContributionWeight, Counting, Finished, Measure, Plain, PrimarySample, Reservoir, WithRadiance,
    WithVisibility,
};
pub use shift::{Identity, Integrand, ShiftMap, Shifted};

use crate::twin::Module;
