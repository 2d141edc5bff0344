//! The parameters that all passes of reuse share.

use crate::resampling::Family;
use crate::spec::Choice;

/// Most neighbours a round.
pub const MAX_NEIGHBOURS: usize = 8;

/// Which neighbours a pixel takes samples from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Taps {
    /// Each pixel its own, uniformly over a disk.
    Random,
    /// The same exchange for all pixels of a frame, x ↦ ((x + s) xor m) − s: pixels swap their
    /// samples in pairs, so no sample is taken by many pixels at once.
    #[default]
    Xor,
    /// Pixels swap their samples in pairs that are drawn at random in blocks as wide as the radius
    /// asks for; whether two surfaces fit is asked once for both.
    Pairs,
}

impl Choice for Taps {
    const ALL: &'static [Self] = &[Self::Random, Self::Xor, Self::Pairs];

    fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Xor => "xor",
            Self::Pairs => "pairs",
        }
    }
}

/// What becomes of the spatial result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpatialUse {
    /// It is shown, and the next frame takes it as history: samples spread farther, and pixels that
    /// carry the same sample err together.
    #[default]
    Feedback,
    /// It is shown and not kept: the history of a pixel is its own.
    Display,
}

impl Choice for SpatialUse {
    const ALL: &'static [Self] = &[Self::Feedback, Self::Display];

    fn name(self) -> &'static str {
        match self {
            Self::Feedback => "feedback",
            Self::Display => "display",
        }
    }
}

/// How a mutation of a path steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Log-uniform between 1/1024 and 1/64 ([`crate::resampling::Kelemen`]).
    #[default]
    Kelemen,
    /// Normal, of standard deviation 1/64 ([`crate::resampling::Gaussian`]).
    Gaussian,
}

impl Choice for Kernel {
    const ALL: &'static [Self] = &[Self::Kelemen, Self::Gaussian];

    fn name(self) -> &'static str {
        match self {
            Self::Kelemen => "kelemen",
            Self::Gaussian => "gaussian",
        }
    }
}

/// Parameters of temporal and spatial reuse, mutations and the boiling filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Frames of history that count, in [0, 250]; 0 is no temporal reuse.
    pub cap: u32,
    /// Weights of the temporal merge.
    pub temporal_mis: Family,
    /// Pixels that a round takes samples from, in [0, 8]; 0 is no spatial reuse.
    pub neighbours: u32,
    /// How far away they are at most, in pixels, in [1, 1000].
    pub radius: f32,
    /// Which they are.
    pub taps: Taps,
    /// Rounds of spatial reuse, in [1, 8].
    pub rounds: u32,
    /// Weights of the spatial merge.
    pub mis: Family,
    /// What becomes of the spatial result.
    pub spatial: SpatialUse,
    /// Where nothing moves, frames of history from which a pixel takes nothing from its neighbours,
    /// in [0, 250]; 0: every pixel always takes. Old samples of a still pixel are as good as fresh
    /// ones, and neighbours that carry the same sample err together.
    pub mature: u32,
    /// Whether all inputs of the last merge are shown, not the selected one.
    pub decoupled: bool,
    /// Mutations between temporal and spatial reuse, in [0, 64].
    pub mutations: u32,
    /// How they step. Only for paths.
    pub kernel: Kernel,
    /// Share of the reservoirs that are mutated in a frame, in (0, 1]. Only for paths.
    pub mutate_share: f32,
    /// Strength in [0, 1] of the boiling filter; 0 is off.
    pub boiling: f32,
    /// Frames after which a sample is dropped, in [0, 255]; 0 is never.
    pub max_age: u32,
    /// How much less history counts, in [0, 1], where pixels nearby carry the same sample; 0 is
    /// off. Only for kinds of samples that can tell ([`super::paths`]).
    pub duplicates: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            cap: 20,
            temporal_mis: Family::Balance,
            neighbours: 1,
            radius: 16.0,
            taps: Taps::Xor,
            rounds: 1,
            mis: Family::DefensivePairwise,
            spatial: SpatialUse::Feedback,
            mature: 8,
            decoupled: false,
            mutations: 0,
            kernel: Kernel::Kelemen,
            mutate_share: 1.0,
            boiling: 0.0,
            max_age: 0,
            duplicates: 0.0,
        }
    }
}

impl Choice for Family {
    const ALL: &'static [Self] = &Self::ALL;

    fn name(self) -> &'static str {
        self.name()
    }
}

/// The rows of the parameters in [`Settings`], for a technique that has fields of the same names,
/// or a field with the settings, whose name comes second.
macro_rules! reuse_rows {
    ($technique:ty $(, $settings:ident)?) => {
        [
            $crate::spec::row!(
                $technique,
                "cap",
                $($settings.)? cap: 0..=250,
                "frames of history that count (Bitterli et al. 2020: 20); 0 is no temporal reuse; higher is less noise, slower reaction and more correlation"
            ),
            $crate::spec::row!(
                $technique,
                "temporal-mis",
                choice $($settings.)? temporal_mis: $crate::resampling::Family,
                "weights of the temporal merge"
            ),
            $crate::spec::row!(
                $technique,
                "neighbours",
                $($settings.)? neighbours: 0..=$crate::reuse::MAX_NEIGHBOURS as u32,
                "pixels that a round takes samples from; 0 is no spatial reuse; more is less noise for more time"
            ),
            $crate::spec::row!(
                $technique,
                "radius",
                number $($settings.)? radius: 1.0..=1000.0,
                "how far away they are at most, in pixels; more is less correlation, and more neighbours that do not fit"
            ),
            $crate::spec::row!(
                $technique,
                "taps",
                choice $($settings.)? taps: $crate::reuse::Taps,
                "which they are: each pixel its own, or pixels exchange in pairs, by one offset a frame or at random"
            ),
            $crate::spec::row!($technique, "rounds", $($settings.)? rounds: 1..=8, "rounds of spatial reuse"),
            $crate::spec::row!(
                $technique,
                "mis",
                choice $($settings.)? mis: $crate::resampling::Family,
                "weights of the spatial merge; constant is biased"
            ),
            $crate::spec::row!(
                $technique,
                "spatial",
                choice $($settings.)? spatial: $crate::reuse::SpatialUse,
                "what becomes of the spatial result: it is kept as history, or shown only"
            ),
            $crate::spec::row!(
                $technique,
                "mature",
                $($settings.)? mature: 0..=250,
                "where nothing moves, frames of history from which a pixel takes nothing from its neighbours; 0: every pixel always takes; higher is less noise in young frames, more time and more correlation"
            ),
            $crate::spec::row!(
                $technique,
                "mutations",
                $($settings.)? mutations: 0..=64,
                "mutations between temporal and spatial reuse (Sawhney et al. 2024); more is less correlation for more time"
            ),
            $crate::spec::row!(
                $technique,
                "decoupled",
                choice $($settings.)? decoupled: bool,
                "shade with all inputs of the last merge instead of the selected one; less noise in colour for a ray a neighbour"
            ),
            $crate::spec::row!(
                $technique,
                "boiling",
                number $($settings.)? boiling: 0.0..=1.0,
                "strength of a filter that drops bright reservoirs; 0 is off; biased"
            ),
            $crate::spec::row!(
                $technique,
                "max-age",
                $($settings.)? max_age: 0..=255,
                "frames after which a sample is dropped; 0 is never; biased"
            ),
        ]
    };
}
pub(crate) use reuse_rows;
