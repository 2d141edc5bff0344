//! Guiding by lobes that learn in a Markov chain: `mcmm` (Dittebrandt et al. 2023, *Markov Chain
//! Mixture Models for Real-Time Direct Illumination*).
//!
//! Each pixel keeps one von Mises–Fisher lobe that aims at a light, or none. In each step of a
//! frame it may take a lobe from its surroundings in the previous frame, draws a direction from it
//! or from a defensive branch, and lets the lobe learn from what was found; the lobe that a
//! Metropolis chain over scores ends with is what the next frame reads. What makes the picture
//! unbiased is not the chain but that samples are weighed by sets of lobes that know nothing of
//! them: see [`crate::reuse::lobes`].
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | chains | hits, the last frame's lobes | lobes, radiance; tile by tile |
//! | paths | hits | adds all other light to radiance |
//!
//! Errors of consecutive frames are not correlated: given the lobes, each frame's samples are
//! fresh.

mod beyond;
mod kernels;
mod lanes;
mod parameters;
mod plan;
mod rungs;

pub use parameters::{LobeScore, McmmPaths, McmmPreset, ReadsMode, SetEstimator};

use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Band, FrameInputs};
use crate::plan::{BufferKey, BufferPlan, Plan, SceneFacts, Shot};
use crate::reuse::lobes::{Learning, LobeState, Prior, Shares};
use crate::spec;
use crate::techniques::{Entry, Technique};
use parameters::rows;

pub(super) const MCMM: Entry = Entry {
    name: "mcmm",
    about: "direct light guided by lobes that learn in a Markov chain (Dittebrandt et al. 2023); other light as nee; no correlation in time",
    parameters: || spec::describe(&rows(), &Mcmm::default()),
    build: |values| Ok(Box::new(spec::build(Mcmm::default(), &rows(), values)?.validated()?)),
    direct: true,
    rungs: rungs::RUNGS,
    variants: rungs::variants,
};

/// Numbers of the technique's kernels.
mod kernel {
    pub(super) const CHAINS: u32 = 0;
    pub(super) const PATHS: u32 = 1;
    pub(super) const ALL_PATHS: u32 = 2;
}

/// The lobes of pixels, as each frame leaves them.
pub(crate) const LOBES: BufferKey<LobeState> = BufferKey::new("lobes");

/// `mcmm`; [`Mcmm::default`] is the preset `best`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mcmm {
    /// What samples are weighed by.
    pub estimator: SetEstimator,
    /// Lanes of a tile, in [1, 64]: the lobes of a set with `ssmis`, and what `n` must not exceed
    /// with `tsmis`.
    ///
    /// More lobes find more lights, for more time a sample.
    pub set: u32,
    /// With `tsmis`, samples of an estimate, in [1, `set`].
    pub n: u32,
    /// With `mixture`, lobes of a mixture, in [1, 64].
    pub k: u32,
    /// b: share of BSDF sampling beside the lobe, in [0.01, 1].
    ///
    /// More is less noise where lobes do not reach, and less use of them.
    pub large: f32,
    /// c: share of light sampling, in [0, 0.95].
    ///
    /// More pays where many lights are seen that are equally bright.
    pub light: f32,
    /// Lobes of the previous frame that a pixel looks at in each step, in [0, 32].
    pub reads: u32,
    /// Whether a pixel that has a lobe looks at others.
    pub reads_mode: ReadsMode,
    /// Pixels of the unit of the window of reads, which reaches three of them in each direction;
    /// `None`: 15 in a picture of 1920 columns, in proportion to its width, at least 4.
    pub window: Option<f32>,
    /// `N_p`: samples that a lobe is worth before its first, in [0, 10000].
    pub prior: f32,
    /// `r_p`: mean cosine of a lobe before its first sample, in [0, 1]; `None`: of the emitter that
    /// the sample found.
    pub prior_mean: Option<f32>,
    /// Most samples that a lobe counts, in [1, 1024].
    pub cap: u32,
    /// Least share of a new sample, in [0, 1]: what makes lobes follow what changes, at the price
    /// of noise.
    pub alpha: f32,
    /// Share of its score that a pixel's own lobe of the previous frame keeps in each step, in [0,
    /// 1]; 0: it begins without one.
    pub carry: f32,
    /// What lobes are chosen by.
    pub score: LobeScore,
    /// Whether lobes follow their lights.
    pub follow: bool,
    /// Which light is guided.
    pub paths: McmmPaths,
    /// With `paths` other than `direct`, α below which a surface's directions are not guided, in
    /// [0, 1].
    pub roughness: f32,
    /// Of the other light: scatterings before Russian roulette may end a path, in [0, 1000].
    pub roulette_after: u32,
    /// A fault that tests plant.
    #[cfg(test)]
    planted: Planted,
}

/// Faults that tests plant, each of which makes the picture wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Planted {
    #[default]
    Nothing,
    /// With `tsmis`, states stay in their lanes.
    NoShift,
    /// With `ssmis`, lanes draw from their own lobes alone.
    NoTurn,
    /// Lanes without a pixel hand nothing on.
    DeadKeep,
    /// BSDF sampling counts as often as there are reads.
    Multiplicity,
    /// Lobes are those of the tile's first receiver.
    OtherReceiver,
    /// The chain keeps a lobe before it has learnt.
    StashFirst,
    /// The path tracer adds the caustics that lobes have found.
    Twice,
}

impl Default for Mcmm {
    fn default() -> Self {
        Self {
            estimator: SetEstimator::Ssmis,
            set: 32,
            n: 8,
            k: 16,
            large: 0.2,
            light: 0.25,
            reads: 5,
            reads_mode: ReadsMode::Always,
            window: None,
            prior: 1.0,
            prior_mean: None,
            cap: LobeState::MOST_SAMPLES,
            alpha: 0.1,
            carry: 0.9,
            score: LobeScore::Set,
            follow: true,
            paths: McmmPaths::Direct,
            roughness: 0.05,
            roulette_after: 5,
            #[cfg(test)]
            planted: Planted::Nothing,
        }
    }
}

impl Mcmm {
    /// Refuses parameters that are out of range or contradict each other.
    ///
    /// # Errors
    /// A usage error that names the parameter, what was given and what is allowed.
    pub fn validate(&self) -> Result<()> {
        spec::check(&rows(), self)?;
        let Self { estimator, n, set, .. } = *self;
        if estimator == SetEstimator::Tsmis && n > set {
            return Err(Error::usage(format!(
                "`n` is {n}, but a tile has {set} lanes (`set`), and a sample would meet its own pixel again; set `n` to at most {set}"
            )));
        }
        Ok(())
    }

    fn validated(self) -> Result<Self> {
        self.validate()?;
        Ok(self)
    }

    /// Width and height of a tile of `set` lanes: as square as its divisors allow, and wider than
    /// high.
    fn tile(&self) -> [u32; 2] {
        let set = self.set.max(1);
        let height =
            (1..=8).rev().find(|side| side * side <= set && set.is_multiple_of(*side)).unwrap_or(1);
        [set / height, height]
    }

    /// Steps of a pixel for each unit of effort.
    fn steps(&self) -> u32 {
        if self.estimator == SetEstimator::Tsmis { self.n } else { 1 }
    }

    /// Whether a test has planted this fault.
    #[cfg(test)]
    fn planted(&self, fault: Planted) -> bool {
        self.planted == fault
    }

    #[cfg(not(test))]
    #[expect(clippy::unused_self, reason = "the form of tests")]
    const fn planted(&self, _fault: Planted) -> bool {
        false
    }

    fn shares(&self) -> Shares {
        Shares { light: self.light, large: self.large }
    }

    fn learning(&self) -> Learning {
        Learning { cap: self.cap, least: self.alpha }
    }

    fn prior_of_lobes(&self) -> Prior {
        Prior { count: self.prior, spread: self.prior_mean.map(|mean| 1.0 - mean) }
    }

    /// Pixels of a unit of the window.
    fn window(&self, width: u32) -> f32 {
        self.window.unwrap_or_else(|| (15.0 / 1920.0 * width as f32).max(4.0))
    }
}

impl Technique for Mcmm {
    fn spec(&self) -> String {
        spec::write(MCMM.name, &Self::default(), &rows(), self)
    }

    fn validate(&self) -> Result<()> {
        Self::validate(self)
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        plan::plan(self, facts, shot)
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        kernels::run(self, kernel, inputs, band)
    }

    fn describe(&self, buffer: &BufferPlan, element: &[u32]) -> Vec<(&'static str, String)> {
        if buffer.name != LOBES.name {
            return Vec::new();
        }
        let lobe: LobeState = bytemuck::cast_slice(element)[0];
        let shape = lobe.shape(&self.prior_of_lobes());
        let Some(shape) = shape.filter(|_| lobe.is_some()) else {
            return vec![("lobe", "none".to_string())];
        };
        let [x, y, z] = lobe.target;
        vec![
            (if lobe.is_sky() { "direction" } else { "target" }, format!("({x}, {y}, {z})")),
            ("concentration", shape.kappa.to_string()),
            ("mean score", lobe.weight.to_string()),
            ("score", lobe.score.to_string()),
            ("samples", lobe.count().to_string()),
            ("light", lobe.light.to_string()),
        ]
    }

    /// Of each pixel's lobe its target (of a sky its direction), κ and N; 0 where there is none.
    fn layers<'f>(
        &self,
        _plan: &Plan,
        _size: [u32; 2],
        buffer: &dyn Fn(&str) -> Option<&'f [u32]>,
    ) -> Vec<(&'static str, Vec<f32>)> {
        let Some(words) = buffer(LOBES.name) else { return Vec::new() };
        let lobes: &[LobeState] = bytemuck::cast_slice(words);
        let prior = self.prior_of_lobes();
        let layer = |value: &dyn Fn(&LobeState) -> f32| {
            lobes.iter().map(|lobe| if lobe.is_some() { value(lobe) } else { 0.0 }).collect()
        };
        vec![
            ("lobe.x", layer(&|lobe| lobe.target[0])),
            ("lobe.y", layer(&|lobe| lobe.target[1])),
            ("lobe.z", layer(&|lobe| lobe.target[2])),
            ("lobe.kappa", layer(&|lobe| lobe.shape(&prior).map_or(0.0, |shape| shape.kappa))),
            ("lobe.samples", layer(&|lobe| lobe.count() as f32)),
        ]
    }
}

#[cfg(all(test, feature = "load"))]
mod tests;

#[cfg(test)]
mod keys {
    use super::*;
    use crate::techniques::parse;

    #[test]
    fn tiles_have_as_many_lanes_as_the_set() {
        let tile = |set| Mcmm { set, ..Mcmm::default() }.tile();
        for set in 1..=64 {
            let [width, height] = tile(set);
            assert!(width * height == set && width >= height, "{set}: {width} x {height}");
        }
        assert_eq!([32, 8, 16, 64, 7].map(tile), [[8, 4], [4, 2], [4, 4], [8, 8], [7, 1]]);
    }

    #[test]
    fn keys_and_presets_round_trip() {
        for spec in [
            "mcmm",
            "mcmm:estimator=tsmis,set=8",
            "mcmm:window=9,prior-mean=0.99",
            "mcmm:light=0,carry=0,score=branch,follow=false",
        ] {
            assert_eq!(parse(spec).unwrap().spec(), spec);
        }
        let paper = parse("mcmm:preset=paper,light=0.1").unwrap().spec();
        assert!(paper.contains("light=0.1") && paper.contains("carry=0"), "{paper}");
        assert_eq!(parse(&paper).unwrap().spec(), paper);
    }

    #[test]
    fn contradictions_name_both_sides() {
        for (spec, text) in [
            ("mcmm:estimator=tsmis,n=9,set=8", "set `n` to at most 8"),
            ("mcmm:large=0", "`large` is `0`, but must be a number in [0.01, 1]"),
            (
                "mcmm:prior-mean=sun",
                "`prior-mean` is `sun`, but must be `emitter` or a number in [0, 1]",
            ),
            ("mcmm:set=65", "`set` is `65`, but must be an integer in [1, 64]"),
        ] {
            let error = parse(spec).unwrap_err().to_string();
            assert!(error.contains(text), "{spec}: {error}");
        }
    }
}
