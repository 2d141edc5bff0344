//! What is done with the outcomes of shadow rays, apart from how samples are chosen: a type a
//! policy.
//!
//! | policy | rays a pixel and frame | shown |
//! |---|---|---|
//! | [`Visibility::Trace`] | 1 at shading | F(Y) V(Y) W |
//! | [`Visibility::InTarget`] | 1 initial, one in every evaluation of a target | F(Y) W, V(Y) being in W |
//! | [`Visibility::Bitterli`] | 1 initial, 1 at shading | F(Y) V(Y) W; occluded initial samples are dropped |
//! | [`Visibility::Reuse`] | 1 initial, 1 for samples whose visibility is too old or comes from too far | F(Y) V(Y) W with a stored V |
//! | [`Visibility::Wis`] | 1 initial, 1 a neighbour | F(Y) V̄ W, V̄ averaged along the chain |
//! | [`Visibility::WisControlVariate`] | 1 initial, 1 a neighbour, 1 for the history where anything moves | Σ mᵢ Fᵢ + Σ aᵢ (C̄ᵢ − F̃ᵢ) |
//!
//! Papers: Bitterli et al. (2020); Wyman and Panteleev (2021), *Rearchitecting Spatiotemporal
//! Resampling for Production*; Tokuyoshi (2024).

mod bitterli;
mod control_variate;
mod in_target;
mod stored;
mod trace;
mod wis;

pub(crate) use bitterli::Bitterli;
pub(crate) use control_variate::WisControlVariate;
pub(crate) use in_target::{InTarget, InTargetControl};
pub(crate) use stored::StoredOutcome;
pub use stored::{REUSE_AGE, REUSE_DISTANCE, Reused};
pub(crate) use trace::Trace;
pub(crate) use wis::Wis;
#[cfg(all(test, feature = "gpu"))]
pub(crate) use wis::{pack_average, unpack_average};

use crate::spec::Choice;

/// A visibility policy by its name; see the module's table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// One ray at shading; targets know no visibility.
    Trace,
    /// Visibility is part of every target: the best samples, many rays.
    #[default]
    InTarget,
    /// Initial visibility is folded into W: fewer black samples, biased where pixels see different
    /// lights.
    Bitterli,
    /// A stored outcome is used again while it is fresh.
    Reuse,
    /// Outcomes are averaged under the distribution that the sample is drawn from.
    Wis,
    /// Outcomes correct an estimate that is kept beside the reservoir: unbiased for any weights and
    /// under motion.
    WisControlVariate,
}

/// What the passes ask of a policy. The policy keeps 16 bits beside each reservoir; what they mean
/// is its own business.
pub(crate) trait Policy: Copy + Send + Sync {
    /// Whether it belongs to targets that contain visibility.
    const IN_TARGET: bool = false;
    /// Whether a ray is traced to each fresh sample.
    const TRACES_INITIAL: bool = true;
    /// Whether a fresh sample that is not seen is dropped.
    const DROPS_OCCLUDED: bool = false;
    /// Whether a ray is traced to each neighbour's sample.
    const TRACES_TERMS: bool = false;
    /// Whether shading may take a ray.
    const SHADES_BY_RAY: bool = false;
    /// Whether an outcome is kept of the selected sample, so that a moved sample needs a new one.
    const KEEPS_OUTCOME: bool = false;
    /// Whether an estimate of the pixel is kept beside the reservoir ([`super::Control`]).
    const CONTROL: bool = false;

    /// The bits of a sample whose ray said `seen` in this frame, at this pixel.
    fn traced(self, bits: u16, seen: bool) -> u16 {
        let _ = seen;
        bits
    }

    /// The bits in the next frame.
    fn a_frame_later(self, bits: u16) -> u16 {
        bits
    }

    /// The bits at a pixel that is `pixels` away.
    fn pixels_away(self, bits: u16, pixels: u32) -> u16 {
        let _ = pixels;
        bits
    }

    /// The averaged visibility that an input brings to a merge; 0 where none is averaged.
    fn average(self, bits: u16) -> f32 {
        let _ = bits;
        0.0
    }

    /// The bits after a merge whose reservoir averaged to `average`.
    fn averaged(self, bits: u16, average: f32) -> u16 {
        let _ = average;
        bits
    }

    /// The visibility that shading uses without asking for a ray.
    fn visibility(self, bits: u16) -> Option<f32> {
        let _ = bits;
        None
    }

    /// A stored outcome of the selected sample that may still be used.
    fn outcome(self, bits: u16) -> Option<bool> {
        let _ = bits;
        None
    }
}

impl Visibility {
    /// All, in the order of the module's table.
    pub const ALL: [Self; 6] = [
        Self::Trace,
        Self::InTarget,
        Self::Bitterli,
        Self::Reuse,
        Self::Wis,
        Self::WisControlVariate,
    ];

    /// The name in a SPEC.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::InTarget => "in-target",
            Self::Bitterli => "bitterli",
            Self::Reuse => "reuse",
            Self::Wis => "wis",
            Self::WisControlVariate => "wis-cv",
        }
    }
}

impl Choice for Visibility {
    const ALL: &'static [Self] = &Self::ALL;

    fn name(self) -> &'static str {
        self.name()
    }
}

/// What is done with a policy once its type is known.
pub(crate) trait WithPolicy {
    /// The result.
    type Output;

    /// With the policy.
    fn with<P: Policy>(self, policy: P) -> Self::Output;
}

impl Visibility {
    /// Chooses the type of the policy, so that no ray asks for it. `limits` are those of
    /// [`Visibility::Reuse`].
    pub(crate) fn choose<W: WithPolicy>(self, limits: StoredOutcome, then: W) -> W::Output {
        match self {
            Self::Trace => then.with(Trace),
            Self::InTarget => then.with(InTarget),
            Self::Bitterli => then.with(Bitterli),
            Self::Reuse => then.with(limits),
            Self::Wis => then.with(Wis),
            Self::WisControlVariate => then.with(WisControlVariate),
        }
    }
}
