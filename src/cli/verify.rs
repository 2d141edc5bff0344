//! `verify`: is a technique's mean right, at every age of its history?
//!
//! The sample is a whole restart; pictures of one restart are never taken for independent. At every
//! age the image and its four tiles, in luminance and each channel, are compared with a reference
//! made by another technique: [`Trial`]. With `--ladder` a table of rungs is verified, from one
//! without any reuse to all of it on moving scenes: [`super::ladder`].

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;

use super::args::{
    Ages, FilterArg, PictureArgs, ReferenceArgs, SceneArgs, parse_ages, parse_percent,
};
use super::part::{percent, place};
use super::{Status, ladder, print};
use crate::experiment::{
    self, AgeOutcome, ReferencePool, Session, SourcedReference, StageOutcome, Trial, technique,
};
use crate::plan::Claim;
use crate::stats::{Verdict, welch};
use crate::techniques::Technique;
use crate::{Error, Result};

/// Scenes that are verified where none is named.
const SCENES: [&str; 4] = [
    "scenes/cornell.pbrt",
    "scenes/penumbra.pbrt",
    "scenes/plates.pbrt",
    "scenes/many_lights.pbrt",
];
/// Test whether a technique is unbiased: restarts against a reference of another technique
///
/// Prints, for every scene and frame age, the verdict (pass, fail, inconclusive), the relative bias
/// with its interval, the number of restarts, their skewness and the seeds. `pass` means: with 99.9
/// % confidence the bias of the image is below DELTA and that of each of its four tiles below 2
/// DELTA, in luminance and every channel, at every age. `fail` means: a difference is certain
/// (10^-4) and above half of that. `inconclusive`: neither is shown.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage verify nee scenes/penumbra.pbrt --check
        exit status 1 if it is found biased
  afterimage verify nee --quick
        a minute instead of many, on scenes/cornell.pbrt: finds 1 %, not 0.5 %
  afterimage verify nee scenes/moving.pbrt --ages 1,10,31 --delta 1
        the frames that are judged, and how far they may be off
  afterimage verify restir-di scenes/cornell.pbrt --motion light --quick
        a still scene whose lights are made to slide
  afterimage verify restir-di --ladder --out ladder.md
        rung by rung: no reuse, over space, over time, moving camera, light, occluder, mutations, visibility
  afterimage verify restir-di --ladder --plan
        how many restarts each rung needs, and how long they take
  afterimage verify restir-di:candidates=8 --ladder --quick --rungs moving --check
        some rungs, coarsely")]
pub(super) struct VerifyArgs {
    /// A technique's specification; see `afterimage list techniques`
    #[arg(value_name = "SPEC")]
    pub technique: String,
    /// pbrt or glTF files, or generators [default: some of ./scenes]
    #[arg(value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// DELTA 1 %, 32x32 pixels, fewer ages, one scene: finds large errors only
    #[arg(long)]
    pub quick: bool,
    /// Verify SPEC as far as its parts go: a table of rungs, each with parameters and motion of its
    /// own; 64x64 pixels unless given, and depth 2 where only direct light is the technique's own
    #[arg(long)]
    pub ladder: bool,
    /// Only the rung of this name, or rungs whose name contains it; `still`: all without motion
    #[arg(long, value_name = "TEXT", requires = "ladder")]
    pub rungs: Option<String>,
    /// Print what each rung of the ladder is going to cost, from pilots, and stop
    #[arg(long, requires = "ladder")]
    pub plan: bool,
    /// Forget what an earlier run of the same ladder kept: verdicts, and restarts of rungs that it
    /// did not finish
    #[arg(long, requires = "ladder")]
    pub fresh: bool,
    /// Minutes that the ladder may take: rungs that are not decided get them, the cheapest first,
    /// and what is left open goes on with the same command; with --quick rungs get as many restarts
    /// as fit, and nothing is kept [default: 120, with --quick 7]
    #[arg(long, value_name = "M", requires = "ladder", value_parser = super::args::parse_positive)]
    pub minutes: Option<f64>,
    /// Write the ladder's table as Markdown, too
    #[arg(long, value_name = "FILE.md", requires = "ladder")]
    pub out: Option<PathBuf>,
    /// Bias of the image that passes, in percent; tiles may have twice as much [default: 0.5, with
    /// --quick 1]
    #[arg(long, value_name = "PERCENT", value_parser = parse_percent)]
    pub delta: Option<f64>,
    /// Frames after the cold start that are judged [default: 1,2,5,20,50, with --quick 1,5,20; 1
    /// where all frames are alike]
    #[arg(long, value_name = "N,N", value_parser = parse_ages)]
    pub ages: Option<Ages>,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub changes: SceneArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    pub filter: FilterArg,
    /// Restarts of the first stage; where that is no pass, a second makes four times as many
    /// [default: as many as a pilot asks for, at least 64, as fit into 20 minutes or, with --quick,
    /// one; fewer reach old ages than young ones]
    #[arg(long, value_name = "R", value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    pub restarts: Option<u32>,
    /// Complete independent estimates a pixel and frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    pub spp: u32,
    /// What makes the reference [default: nee; bsdf for nee itself]
    #[arg(long, value_name = "SPEC")]
    pub against: Option<String>,
    #[command(flatten)]
    pub reference: ReferenceArgs,
    /// Exit with status 1 if a technique that claims to be unbiased fails
    #[arg(long)]
    pub check: bool,
}

impl VerifyArgs {
    /// How each scene or rung is tested.
    pub(super) fn trial(&self) -> Result<Trial> {
        let default = if self.quick { Trial::quick() } else { Trial::default() };
        Ok(Trial {
            ages: match &self.ages {
                Some(Ages(ages)) => experiment::Ages::Given(ages.clone()),
                None => default.ages,
            },
            effort: self.spp as f32,
            delta: self.delta.map_or(default.delta, |percent| 0.01 * percent),
            restarts: self.restarts,
            against: self.against.as_deref().map(technique).transpose()?,
            reference: self.reference.settings(),
            ..default
        })
    }

    /// Opens a scene for small pictures and many restarts: the tiles' means are as certain, and the
    /// restarts' law is better known.
    pub(super) fn open(
        &self,
        scene: &str,
        picture: &PictureArgs,
        size: Option<[u32; 2]>,
    ) -> Result<Session> {
        let mut session = picture.open_changed(scene, &self.changes, self.filter, size)?;
        if self.picture.size.is_none() && self.reference.reference.is_none() {
            let halves = session.shot.size.map(|side| side.div_ceil(2));
            session.shot.size = match (self.quick, self.ladder) {
                (true, _) => [32, 32],
                (false, true) => [64, 64],
                (false, false) => halves,
            };
        }
        Ok(session)
    }
}

pub(super) fn run(args: &VerifyArgs) -> Result<Status> {
    if args.ladder {
        return ladder::run(args);
    }
    let technique = technique(&args.technique)?;
    let trial = args.trial()?;
    let mut failed = false;
    for scene in scenes(args)? {
        failed |= verify(args, &scene, &technique, &trial)?;
    }
    Ok(if failed && args.check { Status::CheckFailed } else { Status::Done })
}

fn scenes(args: &VerifyArgs) -> Result<Vec<String>> {
    if !args.scenes.is_empty() {
        return Ok(args.scenes.clone());
    }
    existing(&SCENES[..if args.quick { 1 } else { SCENES.len() }])
}

/// Those of the repository's scenes that are here.
pub(super) fn existing(scenes: &[&str]) -> Result<Vec<String>> {
    let found: Vec<String> =
        scenes.iter().filter(|s| Path::new(s).exists()).map(|s| (*s).to_string()).collect();
    if found.is_empty() {
        let message = format!(
            "no scene is given, and there is no {} here: name a scene file or a generator such as many-lights:100",
            scenes[0]
        );
        return Err(Error::usage(message));
    }
    Ok(found)
}

/// Whether the technique failed although it claims to be unbiased.
fn verify(
    args: &VerifyArgs,
    scene: &str,
    technique: &Arc<dyn Technique>,
    trial: &Trial,
) -> Result<bool> {
    let session = args.open(scene, &args.picture, trial.reference.size()?)?;
    let plan = session.plan(&**technique);
    print(&format!(
        "{} on {scene} at {}x{}, depth {}: claims to be {}\n",
        plan.technique, session.shot.size[0], session.shot.size[1], session.shot.depth, plan.claim
    ))?;
    let against = trial.against(&**technique)?.spec();
    let mut stage = 0;
    let outcome =
        trial.run(&session, technique, &mut ReferencePool::default(), |judged, references| {
            let head = if stage == 0 { describe(&references[0], &against) } else { String::new() };
            let still = !session.stage.facts().moves();
            stage = judged.stage;
            print(&(head + &table(stage, judged, args.picture.seed, still)))
        })?;
    let verdict = outcome.last().verdict;
    print(&format!("verdict    {verdict}\n\n"))?;
    Ok(verdict == Verdict::Fail && plan.claim == Claim::Unbiased)
}

fn describe(made: &SourcedReference, against: &str) -> String {
    match (made.info.samples, made.reference.variance()) {
        (Some(samples), Some(variance)) => {
            let mean = made.reference.picture().mean_luminance();
            let noise = (variance / made.reference.picture().pixels.len() as f64).sqrt() / mean;
            format!(
                "reference  `{against}`, {samples} samples a pixel, standard error of the mean about {:.3} %\n",
                100.0 * noise
            )
        }
        _ => format!(
            "reference  {}, whose noise is not known and counts as none\n",
            made.info.source
        ),
    }
}

fn table(stage: u32, judged: &StageOutcome, run: u64, still: bool) -> String {
    let confidence = judged.confidence();
    let mut text = format!(
        "stage {stage}    {:>5} {:>13} {:>24} {:>8} {:>24} {:>24} {:>6} {:>9} {:>6}\n",
        "frame",
        "verdict",
        format!("bias % [{:.1} %]", 100.0 * confidence),
        "p",
        "worst tile",
        "its bias %",
        "n",
        "skewness",
        "tiles"
    );
    for age in &judged.ages {
        let worst = judged_tile(age, confidence);
        let _ = writeln!(
            text,
            "           {:>5} {:>13} {:>24} {:>8.1e} {:>24} {:>24} {:>6} {:>9.2} {:>6}",
            age.frames,
            age.verdict().name(),
            percent(age.image(), confidence),
            age.image().test.p,
            worst.map_or(String::new(), place),
            worst.map_or(String::new(), |part| percent(part, confidence)),
            age.restarts.count(),
            age.restarts.luminance().skewness(),
            age.tiles_failed()
        );
    }
    if let Some(slope) = slope(judged).filter(|_| still) {
        let _ = writeln!(text, "           first against last age: p = {slope:.1e}");
    }
    let _ = writeln!(
        text,
        "           seeds: restarts 0 to {} of --seed {run}",
        judged.ages[0].restarts.count().saturating_sub(1)
    );
    text
}

fn judged_tile(age: &AgeOutcome, confidence: f64) -> Option<&crate::stats::Part> {
    age.parts
        .iter()
        .filter(|part| part.place != crate::stats::Place::Image)
        .max_by(|a, b| a.reach(confidence).total_cmp(&b.reach(confidence)))
}

/// p of equal mean luminance at the first and the last age of a still scene; `None` for a single
/// age.
///
/// Ages of one restart are positively correlated, so treating them as independent overstates the
/// difference's error: conservative.
fn slope(judged: &StageOutcome) -> Option<f64> {
    let (first, last) = (judged.ages.first()?, judged.ages.last()?);
    if first.frames == last.frames {
        return None;
    }
    Some(welch(&first.restarts.luminance().estimate(), &last.restarts.luminance().estimate()).p)
}
