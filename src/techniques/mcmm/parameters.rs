//! The parameters of `mcmm`.

use super::Mcmm;
use crate::spec::{Choice, Field, Row, row};

/// What samples are weighed by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetEstimator {
    /// The mean density of all lobes of the tile, of which one drew: stochastic MIS over the set of
    /// a tile (Dittebrandt et al. 2023, eq. 9).
    #[default]
    Ssmis,
    /// The densities of the pixel's own n techniques, all of which drew (eq. 8).
    Tsmis,
    /// The density of a mixture of K lobes by their scores (Alber et al. 2025).
    Mixture,
}

impl Choice for SetEstimator {
    const ALL: &'static [Self] = &[Self::Ssmis, Self::Tsmis, Self::Mixture];

    fn name(self) -> &'static str {
        match self {
            Self::Ssmis => "ssmis",
            Self::Tsmis => "tsmis",
            Self::Mixture => "mixture",
        }
    }
}

/// What lobes are chosen by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LobeScore {
    /// F over the density of the set: what its own set lacks scores high, so that the population
    /// balances itself.
    #[default]
    Set,
    /// F over the density of the branch that drew (Dittebrandt et al. 2023).
    Branch,
}

impl Choice for LobeScore {
    const ALL: &'static [Self] = &[Self::Set, Self::Branch];

    fn name(self) -> &'static str {
        match self {
            Self::Set => "set",
            Self::Branch => "branch",
        }
    }
}

/// When a pixel looks at other pixels' lobes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReadsMode {
    /// In every step.
    #[default]
    Always,
    /// Until it has one of a positive score (Dittebrandt et al. 2023, alg. 1); much noisier.
    Until,
}

impl Choice for ReadsMode {
    const ALL: &'static [Self] = &[Self::Always, Self::Until];

    fn name(self) -> &'static str {
        match self {
            Self::Always => "always",
            Self::Until => "until",
        }
    }
}

/// Which light is guided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum McmmPaths {
    /// What comes straight to the primary hit and leaves it by a lobe that is not a delta.
    #[default]
    Direct,
    /// That, and what comes there through perfectly specular surfaces alone.
    Caustics,
    /// All that leaves the primary hit by a lobe that is not a delta.
    All,
}

impl Choice for McmmPaths {
    const ALL: &'static [Self] = &[Self::Direct, Self::Caustics, Self::All];

    fn name(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::Caustics => "caustics",
            Self::All => "all",
        }
    }
}

/// Values of all parameters for a purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum McmmPreset {
    /// The least error that was found: the default.
    #[default]
    Best,
    /// As Dittebrandt et al. (2023) print it, but for what this crate does in all presets.
    Paper,
    /// As their own release has it: estimates of eight samples, five reads in every step.
    Falcor,
}

impl Choice for McmmPreset {
    const ALL: &'static [Self] = &[Self::Best, Self::Paper, Self::Falcor];

    fn name(self) -> &'static str {
        match self {
            Self::Best => "best",
            Self::Paper => "paper",
            Self::Falcor => "falcor",
        }
    }
}

impl McmmPreset {
    /// The technique with these values.
    #[must_use]
    pub fn values(self) -> Mcmm {
        let best = Mcmm::default();
        let paper = Mcmm {
            light: 0.0,
            prior: 0.1,
            prior_mean: Some(0.0),
            carry: 0.0,
            score: LobeScore::Branch,
            follow: false,
            ..best
        };
        match self {
            Self::Best => best,
            Self::Paper => Mcmm { reads_mode: ReadsMode::Until, ..paper },
            Self::Falcor => Mcmm { estimator: SetEstimator::Tsmis, set: 8, ..paper },
        }
    }
}

/// The rows of all of them; the preset comes first, so that the others change its values.
pub(super) fn rows() -> Vec<Row<Mcmm>> {
    vec![
        Row {
            key: "preset",
            about: "values to begin with, which other keys change: least error; the paper's; those of its authors' release",
            field: Field::Choice(
                || McmmPreset::ALL.iter().map(|preset| preset.name()).collect(),
                // A SPEC says all that differs from the first.
                |_| 0,
                |technique, place| *technique = McmmPreset::ALL[place].values(),
            ),
        },
        row!(
            Mcmm,
            "estimator",
            choice estimator: SetEstimator,
            "what samples are weighed by: a tile's lobes, the pixel's own of n steps, or a mixture of k"
        ),
        row!(Mcmm, "set", set: 1..=64, "lanes of a tile; with ssmis the lobes of a set: more find more lights, for more time"),
        row!(Mcmm, "n", n: 1..=64, "with tsmis, samples of an estimate, at most `set`; time grows with its square"),
        row!(Mcmm, "k", k: 1..=64, "with mixture, lobes of a mixture"),
        row!(Mcmm, "large", number large: 0.01..=1.0, "share of BSDF sampling beside the lobe; 1 uses no lobe"),
        row!(Mcmm, "light", number light: 0.0..=0.95, "share of light sampling; pays where many equally bright lights are seen, and finds point lights"),
        row!(Mcmm, "reads", reads: 0..=32, "lobes around the pixel in the previous frame that each step looks at; mixture looks at k − 1"),
        row!(Mcmm, "reads-mode", choice reads_mode: ReadsMode, "look at them in every step, or until there is a lobe"),
        row!(Mcmm, "window", optional "auto" window: 0.0..=1000.0, "pixels of the window's unit (it reaches three of them); auto: 15 at 1920 columns, at least 4"),
        row!(Mcmm, "prior", number prior: 0.0..=10_000.0, "samples that a lobe is worth before its first"),
        row!(Mcmm, "prior-mean", optional "emitter" prior_mean: 0.0..=1.0, "mean cosine before the first sample; higher is narrower; emitter: as wide as what was found"),
        row!(Mcmm, "cap", cap: 1..=1024, "most samples that a lobe counts"),
        row!(Mcmm, "alpha", number alpha: 0.0..=1.0, "least share of a new sample; higher follows changes faster, with more noise"),
        row!(Mcmm, "carry", number carry: 0.0..=1.0, "share of its score that the pixel's own lobe keeps a step; 0 begins anew in each frame"),
        row!(Mcmm, "score", choice score: LobeScore, "what lobes are chosen by: F over the set's density, or over that of the branch"),
        row!(Mcmm, "follow", choice follow: bool, "lobes move with their lights"),
        row!(Mcmm, "paths", choice paths: McmmPaths, "which light is guided: direct, also through mirrors and glass, or all"),
        row!(Mcmm, "roughness", number roughness: 0.0..=1.0, "with paths=caustics or all, surfaces smoother than this are not guided"),
        row!(Mcmm, "roulette", roulette_after: 0..=1000, "of the other light: scatterings before Russian roulette may end a path"),
    ]
}
