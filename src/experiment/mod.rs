//! Experiments with techniques, without a command line: comparison at equal time, tests of means,
//! ladders of such tests, lag. What `afterimage compare`, `verify`, `lag` and `inspect` print is
//! found here.
//!
//! ```text
//! Scene + SessionSettings ──► Session ──► Comparison, Trial, Ladder, Lag, Inspection ──► outcome
//!                               ▲                      (plain settings with defaults)
//!                   Host: progress, remarks, whether to stop
//! ```
//!
//! An experiment is a plain struct of settings with defaults and a method `run`, which takes a
//! [`Session`] and techniques, registered or not. A [`Host`] hears of progress and may stop the
//! work between two frames.
//!
//! | experiment | answers |
//! |---|---|
//! | [`Comparison`] | which technique has the smallest error in equal time? |
//! | [`Trial`] | is a technique's mean right, at every age of its history? |
//! | [`Ladder`] | which part of a technique makes its mean wrong? |
//! | [`Lag`] | how many frames does a sudden change take to show? |
//! | [`Inspection`] | what happens at one pixel? |
//!
//! `examples/experiment.rs` runs two of them on a scene built in code.

mod bias;
mod calibrate;
mod comparison;
pub(crate) mod figures;
mod fingerprint;
mod host;
mod inspect;
mod kept;
mod ladder;
mod lag;
mod look_at;
pub(crate) mod machine;
mod moving;
mod reference;
pub(crate) mod seeds;
mod session;
mod trial;

pub use comparison::{Compared, Comparison, Shown, Spending};
pub use host::{Host, Silent, Steps};
pub use inspect::{BufferState, Candidate, CandidateSight, Inspected, Inspection, SeenSurface};
pub use kept::Keep;
pub use ladder::{Ladder, LadderOutcome, LadderRow, LadderScenes, PlannedRung};
pub use lag::{Change, Lag, LagOutcome};
pub use look_at::LookAt;
pub use moving::SceneMotion;
pub use reference::{ReferenceSettings, SourcedReference};
pub use session::{Session, SessionSettings, load_scene, technique};
pub use trial::{AgeOutcome, Ages, ReferencePool, StageOutcome, Trial, TrialOutcome, TrialPlan};

// What the command shares with experiments beyond their interface.
#[cfg(feature = "cli")]
pub(crate) use self::{
    calibrate::median_p99,
    comparison::{claim, file_name, guide_layers, sum},
    session::{Mean, add_times},
};
