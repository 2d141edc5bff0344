//! `verify`: is a technique's mean right, at every age of its history?
//!
//! The sample is a whole restart; pictures of one restart are never taken for independent. For every frame age on the ladder, image and
//! tiles are compared with a reference made by another technique ([`bias`]). Two stages: where the first is not a pass, fresh
//! seeds and four times as many restarts decide. The first stage fails at α₁ = 10⁻², the second at α₂ = 10⁻² after a fail and at
//! 10⁻⁴ after an inconclusive first stage, so that an unbiased technique fails with probability 10⁻⁴ a scene (shared by the ages).

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use clap::Args;

use super::args::{FilterArg, PictureArgs, ReferenceArgs};
use super::engine::{self, Engine, keeps_history};
use super::progress::Progress;
use super::reference::{self, Made};
use super::seeds::{Part, seed};
use super::{Status, bias, print};
use crate::plan::Claim;
use crate::stats::{Criteria, PictureTest, Restarts, Verdict, welch};
use crate::techniques::Technique;
use crate::{Error, Result};

/// Scenes that are verified where none is named.
const SCENES: [&str; 4] = [
    "scenes/cornell.pbrt",
    "scenes/penumbra.pbrt",
    "scenes/plates.pbrt",
    "scenes/many_lights.pbrt",
];
/// Frame ages at which a technique with history is tested.
const AGES: [u32; 8] = [1, 2, 3, 5, 10, 20, 50, 100];
/// Level of the first stage, and of the second after a fail.
const STAGE_ALPHA: f64 = 1e-2;
/// Level of both together.
const ALPHA: f64 = 1e-4;

/// Test whether a technique is unbiased: restarts against a reference of another technique
///
/// Prints, for every scene and frame age, the verdict (pass, fail, inconclusive), the relative bias with its interval, the number of
/// restarts, their skewness and the seeds. `pass` means: the bias is below 0.5 % with 99 % confidence and no tile differs.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage verify nee scenes/penumbra.pbrt --check
        exit status 1 if it is found biased
  afterimage verify nee --quick
        a minute instead of many, on scenes/cornell.pbrt")]
pub(super) struct VerifyArgs {
    /// A technique's specification; see `afterimage list techniques`
    #[arg(value_name = "SPEC")]
    technique: String,
    /// pbrt or glTF files, or generators [default: some of ./scenes]
    #[arg(value_name = "SCENE")]
    scenes: Vec<String>,
    /// Fewer restarts and ages, on one scene: finds large errors only
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Restarts of the first stage [default: 256, with --quick 64]
    #[arg(long, value_name = "R", value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    restarts: Option<u32>,
    /// Complete independent estimates a pixel and frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: u32,
    /// What makes the reference [default: nee; bsdf for nee itself]
    #[arg(long, value_name = "SPEC")]
    against: Option<String>,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// Exit with status 1 if a technique that claims to be unbiased fails
    #[arg(long)]
    check: bool,
}

/// One frame age.
struct Age {
    /// Frames since the cold start.
    frames: u32,
    restarts: Restarts,
}

pub(super) fn run(args: &VerifyArgs) -> Result<Status> {
    let technique = engine::technique(&args.technique)?;
    let against = args.against.clone().unwrap_or_else(|| other_than(&technique.spec()).to_string());
    engine::technique(&against)?;
    let mut failed = false;
    for scene in scenes(args)? {
        failed |= verify(args, &scene, &technique, &against)?;
    }
    Ok(if failed && args.check { Status::CheckFailed } else { Status::Done })
}

/// A technique compared with itself is never found wrong.
fn other_than(spec: &str) -> &'static str {
    if spec.split(':').next() == Some("nee") { "bsdf" } else { "nee" }
}

fn scenes(args: &VerifyArgs) -> Result<Vec<String>> {
    if !args.scenes.is_empty() {
        return Ok(args.scenes.clone());
    }
    let count = if args.quick { 1 } else { SCENES.len() };
    let found: Vec<String> = SCENES[..count]
        .iter()
        .filter(|s| Path::new(s).exists())
        .map(|s| (*s).to_string())
        .collect();
    if found.is_empty() {
        let message = format!(
            "no scene is given, and there is no {} here: name a scene file or a generator such as many-lights:100",
            SCENES[0]
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
    against: &str,
) -> Result<bool> {
    let size = reference::file_size(&args.reference)?;
    let mut engine = Engine::open(scene, &args.picture, args.filter, size)?;
    if args.picture.size.is_none() && size.is_none() {
        // Small pictures and many restarts: the tiles' means are as certain, and the restarts' law is better known.
        engine.shot.size =
            engine.shot.size.map(|side| side.div_ceil(if args.quick { 4 } else { 2 }));
    }
    let plan = engine.plan(&**technique);
    let moving = engine.stage.facts().moves();
    let ages: Vec<u32> = match (keeps_history(&plan) || moving, args.quick) {
        (false, _) => vec![1],
        (true, true) => vec![1, 5, 20],
        (true, false) => AGES.to_vec(),
    };
    let count = args.restarts.unwrap_or(if args.quick { 64 } else { 256 });
    print(&format!(
        "{} on {scene} at {}x{}, depth {}: claims to be {}\n",
        plan.technique, engine.shot.size[0], engine.shot.size[1], engine.shot.depth, plan.claim
    ))?;

    let first = stage(&engine, technique, &ages, count, args, Part::Restart)?;
    let pixels = engine.shot.pixels();
    let variance = first
        .iter()
        .map(|a| bias::mean_variance(&a.restarts, pixels))
        .fold(f64::INFINITY, f64::min);
    // The second stage has four times as many restarts; the reference shall be as good again.
    let target = variance / (16.0 * f64::from(count));
    let mut references = Vec::new();
    for &age in if moving { &ages[..] } else { &ages[..1] } {
        references.push(reference::obtain(
            &engine.frozen(age - 1)?,
            &args.reference,
            against,
            target,
        )?);
    }
    print(&describe(&references[0], against))?;

    let one = judge(&first, &references, STAGE_ALPHA)?;
    let mut verdict = one.iter().map(|t| t.verdict).fold(Verdict::Pass, Verdict::and);
    print(&table("stage 1", &first, &one, args.picture.seed))?;
    if verdict != Verdict::Pass {
        let second = stage(&engine, technique, &ages, 4 * count, args, Part::SecondStage)?;
        let alpha = if verdict == Verdict::Fail { ALPHA / STAGE_ALPHA } else { ALPHA };
        let two = judge(&second, &references, alpha)?;
        print(&table("stage 2", &second, &two, args.picture.seed))?;
        verdict = two.iter().map(|t| t.verdict).fold(Verdict::Pass, Verdict::and);
    }
    print(&format!("verdict    {verdict}\n\n"))?;
    Ok(verdict == Verdict::Fail && plan.claim == Claim::Unbiased)
}

/// Independent restarts, looked at at every age.
fn stage(
    engine: &Engine,
    technique: &Arc<dyn Technique>,
    ages: &[u32],
    count: u32,
    args: &VerifyArgs,
    part: Part,
) -> Result<Vec<Age>> {
    let mut found = Vec::new();
    for &frames in ages {
        found.push(Age { frames, restarts: bias::restarts(engine.shot.size)? });
    }
    let progress = Progress::new("restarts", u64::from(count));
    let mut frames = engine.start(technique, args.spp, 0)?;
    for index in 0..count {
        frames.restart(seed(args.picture.seed, part, 0, index));
        let mut done = 0;
        for age in &mut found {
            while done + 1 < age.frames {
                engine::next(&mut frames)?;
                done += 1;
            }
            let frame = engine::next(&mut frames)?;
            done += 1;
            age.restarts.push(&frame.picture().pixels)?;
        }
        progress.step();
    }
    Ok(found)
}

/// Every age against its reference; `alpha` is shared among them.
fn judge(ages: &[Age], references: &[Made], alpha: f64) -> Result<Vec<PictureTest>> {
    let share = alpha / (2.0 * ages.len() as f64);
    // Four quantities (luminance, red, green, blue) at the image scale; Holm takes care of the tiles'.
    let criteria =
        Criteria { difference_alpha: share / 4.0, tile_alpha: share, ..Criteria::default() };
    ages.iter()
        .enumerate()
        .map(|(at, age)| {
            bias::judge(
                &age.restarts,
                &references[at.min(references.len() - 1)].reference,
                &criteria,
            )
        })
        .collect()
}

fn describe(made: &Made, against: &str) -> String {
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

fn table(name: &str, ages: &[Age], tests: &[PictureTest], run: u64) -> String {
    let mut text = format!(
        "{name}    {:>5} {:>13} {:>9} {:>20} {:>8} {:>6} {:>9} {:>6}\n",
        "frame", "verdict", "bias %", "98 % interval", "p", "n", "skewness", "tiles"
    );
    for (age, test) in ages.iter().zip(tests) {
        let (low, high) = test.relative_interval();
        let interval = format!("[{:+.3}, {:+.3}]", 100.0 * low, 100.0 * high);
        let _ = writeln!(
            text,
            "           {:>5} {:>13} {:>+9.3} {interval:>20} {:>8.1e} {:>6} {:>9.2} {:>6}",
            age.frames,
            test.verdict.name(),
            100.0 * test.relative(),
            test.luminance.test.p,
            test.restarts,
            age.restarts.luminance().skewness(),
            test.tiles_rejected
        );
    }
    if let Some(slope) = slope(ages) {
        let _ = writeln!(text, "           first against last age: p = {slope:.1e}");
    }
    let _ = writeln!(
        text,
        "           seeds: restarts 0 to {} of --seed {run}",
        ages[0].restarts.count().saturating_sub(1)
    );
    text
}

/// p of equal mean luminance at the first and the last age (meaningful in a still scene); `None` for a single age.
///
/// Ages of one restart are positively correlated, so treating them as independent overstates the difference's error: conservative.
fn slope(ages: &[Age]) -> Option<f64> {
    let (first, last) = (ages.first()?, ages.last()?);
    if first.frames == last.frames {
        return None;
    }
    Some(welch(&first.restarts.luminance().estimate(), &last.restarts.luminance().estimate()).p)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_technique_is_its_own_judge() {
        assert_eq!(other_than("nee"), "bsdf");
        assert_eq!(other_than("nee:roulette=3"), "bsdf");
        assert_eq!(other_than("bsdf"), "nee");
    }

    #[test]
    fn the_ladder_begins_at_a_cold_start_and_rises() {
        assert_eq!(AGES[0], 1);
        assert!(AGES.is_sorted());
    }
}
