//! Reasons why a shift of a path is undefined, and their counters.

use crate::counters::Counters;

/// Why a shift is undefined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The replayed numbers scatter nothing, or at a black surface.
    Replay,
    /// A pair before `x_r` may be connected here.
    Earlier,
    /// The replayed path leaves the scene, or ends where the other went on.
    Length,
    /// The lobe that is to be connected by does not scatter there, or is not rough here.
    Lobe,
    /// The pair is too near here.
    Near,
    /// Nothing is scattered or sent towards here: the back of a surface.
    Back,
    /// Something stands between.
    Occluded,
    /// The light is not there.
    LightGone,
    /// The object is not there.
    ObjectGone,
    /// A product left f32.
    NotFinite,
}

impl Failure {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Replay,
        Self::Earlier,
        Self::Length,
        Self::Lobe,
        Self::Near,
        Self::Back,
        Self::Occluded,
        Self::LightGone,
        Self::ObjectGone,
        Self::NotFinite,
    ];

    /// Its place in [`Failure::ALL`], from 1 on.
    #[must_use]
    pub fn number(self) -> u32 {
        1 + Self::ALL.iter().position(|reason| *reason == self).unwrap_or(0) as u32
    }

    /// Where shifts that failed for it are counted.
    #[must_use]
    pub const fn counter(self, counters: &mut Counters) -> &mut u64 {
        match self {
            Self::Replay => &mut counters.failed_replay,
            Self::Earlier => &mut counters.failed_earlier,
            Self::Length => &mut counters.failed_length,
            Self::Lobe => &mut counters.failed_lobe,
            Self::Near => &mut counters.failed_near,
            Self::Back => &mut counters.failed_back,
            Self::Occluded => &mut counters.failed_occluded,
            Self::LightGone => &mut counters.failed_light_gone,
            Self::ObjectGone => &mut counters.failed_object_gone,
            Self::NotFinite => &mut counters.failed_not_finite,
        }
    }
}
