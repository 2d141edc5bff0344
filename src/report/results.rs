//! The schema of `results.json`, version 1. Names and nesting are a contract with scripts: add
//! fields, never rename or remove one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// [`Results::schema`].
pub const SCHEMA: u32 = 1;

/// Names that [`Row::metrics`] may hold and tables show, in their order; lower is better for all.
/// `rmspe_share` is there as well: the share of pixels that `rmspe` is over.
pub const METRICS: [&str; 11] = [
    "relmse",
    "relmse_trimmed",
    "mse",
    "smape",
    "rmspe",
    "flip",
    "ttuv",
    "relmse_denoised",
    "covariance_r8",
    "low_frequency_share",
    "g_2_1",
];

/// Everything that one `compare` measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Results {
    /// This crate's version.
    pub afterimage: String,
    /// The commit it was built from, or `unknown`.
    pub commit: String,
    /// Processor, threads, operating system.
    pub machine: String,
    /// The command line.
    pub command: String,
    /// The scene as given.
    pub scene: String,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Path segments from the camera.
    pub depth: u32,
    /// Of the run; restarts derive theirs from it.
    pub seed: u64,
    /// `point` or `box`.
    pub filter: String,
    /// What the pictures were compared with.
    pub reference: ReferenceInfo,
    /// Version of this schema.
    pub schema: u32,
    /// Whether the user stopped the run early: there are fewer restarts then.
    #[serde(default)]
    pub interrupted: bool,
    /// Restarts, of all techniques together, that an earlier, interrupted run made: with the times
    /// that they took then.
    #[serde(default)]
    pub resumed: u32,
    /// One a technique.
    pub rows: Vec<Row>,
    /// Error against time, one a technique.
    #[serde(default)]
    pub curves: Vec<Curve>,
    /// Error of each frame after a cold start, of techniques that keep history.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warmups: Vec<Warmup>,
    /// Power of the error by frequency, one a technique.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spectra: Vec<ErrorSpectrum>,
}

/// Where the reference came from, and how good it is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReferenceInfo {
    /// `made`, `cache`, `cache, continued` or the file's name.
    pub source: String,
    /// Of the technique that made it.
    pub technique: Option<String>,
    /// Samples a pixel.
    pub samples: Option<u64>,
    /// Variance of its pixels and channels, averaged over the picture, W²·sr⁻²·m⁻⁴.
    pub variance: Option<f64>,
    /// `variance` over the smallest `mse` in the rows: 0.01 or less by default.
    pub share_of_smallest_mse: Option<f64>,
}

/// One technique's figures.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Its specification.
    pub technique: String,
    /// What it was given.
    pub budget: Budget,
    /// Whether its effort is whole, as that of a technique with reservoirs is. Its frame takes what
    /// it takes, near to the budget: `ttuv`, error times time, is what compares it.
    #[serde(default)]
    pub whole_effort: bool,
    /// What it promises on this scene.
    pub claim: Claim,
    /// `cpu` or `gpu`.
    pub backend: String,
    /// Frames from a cold start.
    pub frames: u32,
    /// Independent restarts.
    pub restarts: u32,
    /// Time of a frame.
    pub ms_per_frame: FrameTime,
    /// Rays of a steady frame by kind, per pixel.
    pub rays_per_pixel: BTreeMap<String, f64>,
    /// State kept between passes and frames.
    pub bytes_per_pixel: f64,
    /// Time of each pass of a steady frame.
    pub passes: Vec<PassTime>,
    /// By name; see [`METRICS`].
    pub metrics: BTreeMap<String, Figure>,
    /// The bias test.
    pub bias: Option<Bias>,
    /// Estimates that were not finite: each is a bug.
    #[serde(default)]
    pub non_finite: u64,
    /// What each restart measured, in their order: what all figures above are made of.
    #[serde(default)]
    pub samples: Vec<Sample>,
}

/// What one restart measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Of its frames' random numbers ([`Shot::run`](crate::plan::Shot::run)): a loop with it
    /// renders the same pictures.
    pub seed: u64,
    /// Milliseconds of every frame, the cold start first.
    pub ms: Vec<f64>,
    /// Rays by kind, over its steady frames in all: all but the cold start, unless there is no
    /// other.
    pub rays: BTreeMap<String, u64>,
    /// Time of each pass in the same frames.
    pub passes: Vec<PassSample>,
    /// By name, of the judged picture; see [`METRICS`].
    pub metrics: BTreeMap<String, f64>,
    /// `relmse` of every frame, the cold start first, where [`Results::warmups`] has the technique.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warmup: Vec<f64>,
    /// Estimates that were not finite, in any frame.
    #[serde(default)]
    pub non_finite: u64,
}

impl Sample {
    /// Times of the frames after the cold start; the cold start's where there is no other.
    #[must_use]
    pub fn steady(&self) -> &[f64] {
        if self.ms.len() > 1 { &self.ms[1..] } else { &self.ms }
    }
}

/// Times of a pass in one restart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassSample {
    /// Its name in the plan.
    pub name: String,
    /// Milliseconds of each steady frame that it ran in.
    pub ms: Vec<f64>,
}

/// What a technique may spend on a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Budget {
    /// Of what.
    pub kind: BudgetKind,
    /// Milliseconds a frame, or samples a pixel.
    pub value: f64,
    /// Complete independent estimates a pixel and frame; with a fraction, so many pixels have one
    /// more.
    pub effort: f32,
    /// Whether a technique whose effort may have a fraction has a median steady frame that is more
    /// than 5 % off the budget. One with whole efforts is never marked.
    pub over_budget: bool,
}

/// The unit of [`Budget::value`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BudgetKind {
    /// Milliseconds a frame.
    FrameTime,
    /// Samples a pixel.
    Spp,
}

/// What a technique promises about its mean, in the form of `results.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Claim {
    /// Every frame's mean is the truth.
    Unbiased,
    /// The truth in the limit.
    Consistent,
    /// Not the truth, and why.
    Biased(String),
}

impl std::fmt::Display for Claim {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Unbiased => "unbiased",
            Self::Consistent => "consistent",
            Self::Biased(_) => "biased",
        })
    }
}

/// Milliseconds a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameTime {
    /// Of all frames but each restart's first.
    pub median: f64,
    /// 99th percentile of the same.
    pub p99: f64,
    /// Median of the restarts' first frames.
    pub first: f64,
    /// 95 % interval of the mean, over restarts, of a restart's median steady frame (Student).
    /// Restarts of all techniques go by turns, so it covers changes of the machine's speed, as far
    /// as they do not last for much of the run.
    #[serde(default)]
    pub ci: Option<[f64; 2]>,
    /// Median of steady frames at the calibrated effort, before the first restart; none without a
    /// frame time to keep.
    #[serde(default)]
    pub calibrated: Option<f64>,
    /// The same frames again, after everything else.
    #[serde(default)]
    pub recalibrated: Option<f64>,
    /// The times that `calibrated` and `recalibrated` are medians of.
    #[serde(default)]
    pub calibrations: [Vec<f64>; 2],
}

impl FrameTime {
    /// A change of the calibrated time that is more than this share of it is a drift.
    pub const DRIFT: f64 = 0.05;

    /// How much longer the calibrated frames take after the run than before, as a share; `None`
    /// where that is 5 % or less, or not known.
    #[must_use]
    pub fn drift(&self) -> Option<f64> {
        let change = self.recalibrated? / self.calibrated? - 1.0;
        (change.abs() > Self::DRIFT).then_some(change)
    }
}

/// Time of a pass.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PassTime {
    /// Its name in the plan.
    pub name: String,
    /// Median milliseconds of a steady frame.
    pub ms: f64,
}

/// A measured number with its 95 % interval over restarts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Over restarts.
    pub mean: f64,
    /// Lower and upper end; none with fewer than two restarts.
    pub ci: Option<[f64; 2]>,
}

impl Figure {
    /// Whether both intervals are known and share no point.
    #[must_use]
    pub fn apart(&self, other: &Self) -> bool {
        matches!((self.ci, other.ci), (Some(a), Some(b)) if a[1] < b[0] || b[1] < a[0])
    }
}

/// The outcome of the bias test.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Bias {
    /// `pass`, `fail` or `inconclusive`.
    pub verdict: String,
    /// Of the image's mean luminance, relative to the reference.
    pub relative: f64,
    /// 95 % interval of `relative`.
    pub ci: Option<[f64; 2]>,
    /// Tiles whose means differ from the reference's (Holm).
    pub tiles_rejected: u32,
}

/// Error against time of one technique.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Curve {
    /// Its specification.
    pub technique: String,
    /// By rising effort.
    pub points: Vec<CurvePoint>,
}

/// One budget of a [`Curve`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Complete independent estimates a pixel and frame.
    pub effort: f32,
    /// Median steady frame.
    pub ms: f64,
    /// At that effort.
    pub relmse: Figure,
    /// What each restart measured: seed, times and `relmse`. The row's own effort has none: its
    /// point is of [`Row::samples`].
    #[serde(default)]
    pub samples: Vec<Sample>,
}

/// How a technique's frames become better with its history.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Warmup {
    /// Its specification.
    pub technique: String,
    /// `relmse` of the displayed frame; the first is the cold start.
    pub relmse: Vec<Figure>,
}

/// The radial power spectrum of a technique's error.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ErrorSpectrum {
    /// Its specification.
    pub technique: String,
    /// By rising frequency.
    pub points: Vec<SpectrumPoint>,
}

/// A ring of frequencies.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct SpectrumPoint {
    /// Upper end of the ring in cycles a pixel.
    pub cycles: f64,
    /// Mean power in it; white noise of any variance has 1.
    pub power: Figure,
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn row(technique: &str, relmse: f64, half: f64) -> Row {
        let figure = Figure { mean: relmse, ci: Some([relmse - half, relmse + half]) };
        Row {
            technique: technique.into(),
            budget: Budget { kind: BudgetKind::Spp, value: 1.0, effort: 1.0, over_budget: false },
            whole_effort: false,
            claim: Claim::Unbiased,
            backend: "cpu".into(),
            frames: 16,
            restarts: 20,
            ms_per_frame: FrameTime {
                median: 10.0,
                p99: 12.0,
                first: 15.0,
                ci: Some([9.5, 10.5]),
                calibrated: Some(10.0),
                recalibrated: Some(10.2),
                calibrations: [vec![10.0], vec![10.2]],
            },
            rays_per_pixel: BTreeMap::from([("shadow".into(), 3.5)]),
            bytes_per_pixel: 0.0,
            passes: vec![PassTime { name: "path".into(), ms: 9.0 }],
            metrics: BTreeMap::from([("relmse".into(), figure)]),
            bias: None,
            non_finite: 0,
            samples: Vec::new(),
        }
    }

    pub(crate) fn results(rows: Vec<Row>) -> Results {
        Results {
            afterimage: "0".into(),
            commit: "unknown".into(),
            machine: "m".into(),
            command: "afterimage compare x".into(),
            scene: "x".into(),
            size: [32, 32],
            depth: 8,
            seed: 1,
            filter: "point".into(),
            reference: ReferenceInfo {
                source: "made".into(),
                technique: Some("nee".into()),
                samples: Some(64),
                variance: Some(1e-4),
                share_of_smallest_mse: Some(0.01),
            },
            schema: SCHEMA,
            interrupted: false,
            resumed: 0,
            rows,
            curves: Vec::new(),
            warmups: Vec::new(),
            spectra: Vec::new(),
        }
    }

    #[test]
    fn json_has_the_names_of_the_contract() {
        let mut biased = row("mcmm:set=32", 0.5, 0.1);
        biased.claim = Claim::Biased("coloured lights".into());
        biased.bias =
            Some(Bias { verdict: "pass".into(), relative: 0.0, ci: None, tiles_rejected: 0 });
        let json = serde_json::to_value(results(vec![row("nee", 0.5, 0.1), biased])).unwrap();
        for key in "afterimage commit machine command scene size depth seed reference schema rows"
            .split(' ')
        {
            assert!(json.get(key).is_some(), "{key}");
        }
        let first = &json["rows"][0];
        for key in "technique budget claim backend frames restarts ms_per_frame rays_per_pixel \
                    bytes_per_pixel passes metrics bias"
            .split_whitespace()
        {
            assert!(first.get(key).is_some(), "{key}");
        }
        assert_eq!(json["schema"], 1);
        assert_eq!(first["claim"], "unbiased");
        assert_eq!(json["rows"][1]["claim"]["biased"], "coloured lights");
        assert_eq!(json["rows"][1]["bias"]["verdict"], "pass");
        assert_eq!(first["metrics"]["relmse"]["mean"], 0.5);
        assert_eq!(first["budget"]["kind"], "spp");
        assert_eq!(first["ms_per_frame"]["ci"][1], 10.5);
        // What older files lack is optional.
        let mut old = json.clone();
        let time = old["rows"][0]["ms_per_frame"].as_object_mut().unwrap();
        time.retain(|name, _| ["median", "p99", "first"].contains(&name.as_str()));
        let old: Results = serde_json::from_value(old).unwrap();
        assert_eq!(old.rows[0].ms_per_frame.ci, None);
        assert!(json.get("warmups").is_none() && json.get("spectra").is_none());
        let _: Results = serde_json::from_value(json).unwrap();
    }

    #[test]
    fn small_changes_of_time_are_no_drift_and_unknown_ones_neither() {
        let time = |before, after| FrameTime {
            calibrated: before,
            recalibrated: after,
            ..row("a", 1.0, 0.1).ms_per_frame
        };
        assert_eq!(time(Some(10.0), Some(10.4)).drift(), None);
        assert_eq!(time(Some(10.0), Some(9.6)).drift(), None);
        assert_eq!((time(None, Some(9.0)).drift(), time(Some(9.0), None).drift()), (None, None));
        assert!((time(Some(10.0), Some(11.0)).drift().unwrap() - 0.1).abs() < 1e-12);
        assert!((time(Some(10.0), Some(9.0)).drift().unwrap() + 0.1).abs() < 1e-12);
    }

    #[test]
    fn intervals_that_touch_are_not_apart() {
        let a = Figure { mean: 1.0, ci: Some([0.5, 1.5]) };
        let b = Figure { mean: 2.0, ci: Some([1.5, 2.5]) };
        let c = Figure { mean: 3.0, ci: Some([2.0, 4.0]) };
        assert!(!a.apart(&b) && a.apart(&c) && c.apart(&a));
        assert!(!a.apart(&Figure { mean: 9.0, ci: None }));
    }
}
