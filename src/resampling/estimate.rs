//! Estimators: what a finished pixel shows, and when that is right in the mean.

use glam::Vec3;

use super::Claim;

/// What a merge promises, as far as it decides an estimator's bias; found from parameters and
/// scene, before any sample.
///
/// See `docs/visibility.md` for the counterexamples behind each condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent conditions, each with a sentence of its own"
)]
pub struct Merges {
    /// Whether anything is reused at all. Without it every estimator is f V W of a fresh sample.
    pub reuse: bool,
    /// Whether merges of unequal domains use weights that sum to 1 over the inputs that reach a
    /// sample.
    pub partition: bool,
    /// The same of the weights that single inputs are shown with: false for families that know
    /// theirs only after the selection, where supports differ.
    pub streamed_partition: bool,
    /// Whether an input that carries an averaged visibility keeps a MIS weight mᵢ p̂ |∂T| / p̂ᵢ
    /// that is the same for all samples.
    pub chained_weight_constant: bool,
    /// Whether the visibility function is the same wherever a chain has been: receiver, lights and
    /// occluders stay.
    pub still: bool,
    /// Whether f / p̂ is the same for all samples of a receiver, in every channel.
    pub target_proportional: bool,
    /// Whether a stored visibility is used only for the receiver that it was found at.
    pub own_visibility: bool,
    /// Whether a sample of positive target can have been dropped because one receiver did not see
    /// it.
    pub drops_occluded: bool,
    /// Whether confidences, coefficients, the choice of neighbours and the number of mutations
    /// depend on surfaces alone, never on a sample: its weight, its age, whether it was occluded.
    pub sample_blind: bool,
}

/// A pixel's final state to radiance.
///
/// Laws:
/// 1. With one sample of one technique, every estimator is f / p: where nothing is reused, merges
///    leave f(Y) V(Y) W of it, with W = 1/p.
/// 2. `claim` depends on parameters and scene only, and says which condition fails.
/// 3. Radiance is linear in the samples' weights.
pub trait Estimator {
    /// What it needs of a pixel.
    type State;

    /// The facts that decide whether its mean is right: [`Merges`] for what shows the outcome of
    /// merges. An estimator over other sets of samples brings facts of its own.
    type Conditions;

    /// The pixel's radiance.
    fn radiance(state: &Self::State) -> Vec3;

    /// What the mean of that is.
    fn claim(conditions: &Self::Conditions) -> Claim;
}

/// The selected sample: its unshadowed integrand, its visibility here, its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelectedState {
    /// f(Y), without visibility.
    pub integrand: Vec3,
    /// V(Y), or the average V̄, in [0, 1].
    pub visibility: f32,
    /// W.
    pub weight: f32,
}

fn reasons(conditions: &Merges) -> Vec<String> {
    let mut reasons = Vec::new();
    if conditions.reuse && !conditions.partition {
        reasons.push(
            "constant MIS weights lose what a neighbour cannot reach (supports may differ)".into(),
        );
    }
    if conditions.reuse && conditions.drops_occluded {
        reasons.push("samples that one pixel does not see are lost to pixels that do".into());
    }
    if conditions.reuse && !conditions.sample_blind {
        reasons.push("how much a sample counts depends on the sample".into());
    }
    reasons
}

/// f(Y) V(Y) W.
#[derive(Clone, Copy, Debug)]
pub struct Selected;

impl Estimator for Selected {
    type State = SelectedState;
    type Conditions = Merges;

    #[inline]
    fn radiance(state: &SelectedState) -> Vec3 {
        state.integrand * (state.visibility * state.weight)
    }

    fn claim(conditions: &Merges) -> Claim {
        let mut reasons = reasons(conditions);
        if conditions.reuse && !conditions.own_visibility {
            reasons.push("a visibility is reused where it was not found".into());
        }
        Claim::unless(&reasons)
    }
}

/// f(Y) V̄ W with V̄ averaged along the chain of merges (Tokuyoshi 2024, eq. 4 and 5).
///
/// Unbiased if and only if every chained input has a weight mᵢ p̂ |∂T| / p̂ᵢ that is the same for
/// all samples and the same visibility function, the target is proportional to f, and fresh inputs
/// cover the rest of the support. The paper's condition (static scene, p̂ ∝ f, any weights that sum
/// to 1) is not enough: with balance weights the smallest example gives 15/16.
#[derive(Clone, Copy, Debug)]
pub struct WeightedVisibility;

impl Estimator for WeightedVisibility {
    type State = SelectedState;
    type Conditions = Merges;

    #[inline]
    fn radiance(state: &SelectedState) -> Vec3 {
        Selected::radiance(state)
    }

    fn claim(conditions: &Merges) -> Claim {
        let mut reasons = reasons(conditions);
        if conditions.reuse {
            if !conditions.still {
                reasons.push(
                    "averaged visibility lags behind what moves (receiver, lights or occluders)"
                        .into(),
                );
            }
            if !conditions.chained_weight_constant {
                reasons
                    .push("the MIS weight of the chained visibility depends on the sample".into());
            }
            if !conditions.target_proportional {
                reasons.push(
                    "the target is not proportional to the integrand in every channel: colour leaks, luminance does not".into(),
                );
            }
        }
        Claim::unless(&reasons)
    }
}

/// Σ mᵢ F(yᵢ) Wᵢ |∂T| over all inputs of the last merge, each with its own visibility.
#[derive(Clone, Copy, Debug)]
pub struct Decoupled;

/// What [`Decoupled`] and [`ControlVariate`] need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoupledState {
    /// Σ mᵢ Fᵢ Wᵢ |∂T|, shadowed.
    pub radiance: Vec3,
    /// Σ aᵢ (C̄ᵢ − F̃ᵢ) over the pixel's own chain; may be negative. 0 without a control variate.
    pub correction: Vec3,
}

impl Estimator for Decoupled {
    type State = DecoupledState;
    type Conditions = Merges;

    #[inline]
    fn radiance(state: &DecoupledState) -> Vec3 {
        state.radiance
    }

    fn claim(conditions: &Merges) -> Claim {
        match Selected::claim(conditions) {
            Claim::Unbiased if conditions.reuse && !conditions.streamed_partition => Claim::Biased(
                "the inputs' own weights lose what one of them cannot reach: only the selected one's is right".into(),
            ),
            claim => claim,
        }
    }
}

/// C = Σ mᵢ Fᵢ + Σ aᵢ (C̄ᵢ − F̃ᵢ): the chain's earlier estimate C̄ᵢ corrects, minus F̃ᵢ, the same
/// sample's contribution *at the receiver where C̄ᵢ was made*. E[C̄ᵢ − F̃ᵢ] = 0 given the surfaces,
/// so C is unbiased for any MIS weights, any target, any channel, and under motion, for
/// coefficients aᵢ that know no sample. Subtracting the contribution at the new receiver instead is
/// biased as soon as anything moves.
#[derive(Clone, Copy, Debug)]
pub struct ControlVariate;

impl Estimator for ControlVariate {
    type State = DecoupledState;
    type Conditions = Merges;

    #[inline]
    fn radiance(state: &DecoupledState) -> Vec3 {
        state.radiance + state.correction
    }

    fn claim(conditions: &Merges) -> Claim {
        Decoupled::claim(conditions)
    }
}
