//! The parameters of `restir-pt`.

use super::RestirPt;
use crate::reuse::light_points::LightTiles;
use crate::reuse::parameters::reuse_rows;
use crate::reuse::paths::{Predicate, ShiftKind};
use crate::reuse::{Kernel, Settings};
use crate::spec::{Choice, Field, Row, row};

/// Where direct light comes from: light that comes straight to the primary hit and leaves it by a
/// lobe that is not a delta.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Direct {
    /// From candidates as in `restir-di`, in the same reservoir as all other paths.
    #[default]
    Union,
    /// From the walks.
    Tree,
    /// From candidates as in `restir-di`, in a reservoir of its own beside that of all other paths
    /// (Lin et al. 2022): less noise, for twice the memory and reuse.
    Separate,
}

impl Choice for Direct {
    const ALL: &'static [Self] = &[Self::Union, Self::Tree, Self::Separate];

    fn name(self) -> &'static str {
        match self {
            Self::Union => "union",
            Self::Tree => "tree",
            Self::Separate => "separate",
        }
    }
}

/// What is shown of a pixel, with m, F, W and \|∂T\| those of the inputs of its last merge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shade {
    /// F W of the path that was selected.
    Selected,
    /// Σ m F W \|∂T\|: all of them, with less noise in colour.
    Decoupled,
    /// C̄ = Σ m F W \|∂T\| + a (C̄ − F̃): all of them correct an estimate that is kept beside the
    /// reservoir, with F̃ = F W of the sample that C̄ was kept with and a the history's share of
    /// confidence; it begins with all light of the pixel's own walks (Tokuyoshi 2024, whose
    /// estimator is for visibility).
    #[default]
    Control,
}

impl Choice for Shade {
    const ALL: &'static [Self] = &[Self::Selected, Self::Decoupled, Self::Control];

    fn name(self) -> &'static str {
        match self {
            Self::Selected => "selected",
            Self::Decoupled => "decoupled",
            Self::Control => "control",
        }
    }
}

/// Values of all parameters for a purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// Frame by frame, unbiased: the default.
    #[default]
    Unbiased,
    /// Single pictures: no history, 32 walks a pixel, three rounds of six neighbours at most ten
    /// pixels away.
    Offline,
    /// Frame by frame with fewer bright blotches: history counts less where pixels carry the same
    /// path, and the brightest reservoirs are dropped; biased.
    Interactive,
}

impl Choice for Preset {
    const ALL: &'static [Self] = &[Self::Unbiased, Self::Offline, Self::Interactive];

    fn name(self) -> &'static str {
        match self {
            Self::Unbiased => "unbiased",
            Self::Offline => "offline",
            Self::Interactive => "interactive",
        }
    }
}

impl Preset {
    /// The technique with these values.
    #[must_use]
    pub fn values(self) -> RestirPt {
        let unbiased = RestirPt::default();
        let reuse = unbiased.reuse;
        match self {
            Self::Unbiased => unbiased,
            Self::Offline => {
                let reuse = Settings { cap: 0, neighbours: 6, radius: 10.0, rounds: 3, ..reuse };
                RestirPt { trees: 32, reuse, ..unbiased }
            }
            Self::Interactive => {
                RestirPt { reuse: Settings { duplicates: 1.0, boiling: 0.2, ..reuse }, ..unbiased }
            }
        }
    }
}

/// The rows of all of them; the preset comes first, so that the others change its values.
pub(super) fn rows() -> Vec<Row<RestirPt>> {
    let mut rows = vec![
        Row {
            key: "preset",
            about: "values to begin with, which other keys change: for frames, unbiased; for single pictures; for frames with fewer blotches, biased",
            field: Field::Choice(
                || Preset::ALL.iter().map(|preset| preset.name()).collect(),
                // A SPEC says all that differs from the first.
                |_| 0,
                |technique, place| *technique = Preset::ALL[place].values(),
            ),
        },
        row!(
            RestirPt,
            "trees",
            trees: 1..=1024,
            "walks a pixel and frame whose paths a reservoir chooses from; more is less noise for more time"
        ),
        row!(
            RestirPt,
            "roulette",
            roulette_after: 0..=1000,
            "scatterings before Russian roulette may end a walk"
        ),
        row!(
            RestirPt,
            "shift",
            choice shift: ShiftKind,
            "how paths are shifted: replay up to a connection, a connection at the primary hit or not at all, or replay alone"
        ),
        row!(
            RestirPt,
            "predicate",
            choice predicate: Predicate,
            "when vertices are far enough apart to be connected: from 1 % of the scene's diagonal on, or by what both directions cover of it"
        ),
        row!(
            RestirPt,
            "direct",
            choice direct: Direct,
            "direct light: from candidates as in restir-di, in the same reservoir as all other light, from the walks, or from candidates in a reservoir of its own (less noise, twice the memory)"
        ),
        row!(
            RestirPt,
            "candidates",
            candidates: 1..=1024,
            "unless direct=tree, light samples a pixel, frame and chain"
        ),
        row!(
            RestirPt,
            "bsdf",
            bsdf: 0..=64,
            "unless direct=tree, BSDF samples a pixel, frame and chain; a ray each"
        ),
        row!(
            RestirPt,
            "tiles",
            choice tiles: LightTiles,
            "unless direct=tree, light points made ahead in tiles that fit the cache"
        ),
        row!(
            RestirPt,
            "shared",
            choice shared: bool,
            "with taps=xor or pairs, whether a shift is made once for both pixels that ask for it; the picture is the same"
        ),
        row!(
            RestirPt,
            "shade",
            choice shade: Shade,
            "what is shown: the selected path, all inputs of the last merge, or an estimate that all of them correct, with the least noise in colour for 8 bytes; only that can be below 0 in a pixel"
        ),
    ];
    rows.push(row!(
        RestirPt,
        "duplicates",
        number reuse.duplicates: 0.0..=1.0,
        "how much less history counts where pixels nearby carry the same path; 0 is off; biased"
    ));
    rows.push(row!(
        RestirPt,
        "kernel",
        choice reuse.kernel: Kernel,
        "how a mutation steps: log-uniform (Kelemen et al. 2002) or normal"
    ));
    rows.push(row!(
        RestirPt,
        "mutate-share",
        number reuse.mutate_share: 0.001..=1.0,
        "share of the pixels that are mutated in a frame; less is less time"
    ));
    // `shade` says how paths are shown.
    let ours = |row: &Row<RestirPt>| row.key != "decoupled";
    rows.extend(reuse_rows!(RestirPt, reuse).into_iter().filter(ours));
    rows
}
