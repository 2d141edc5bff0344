//! `compare`: the main job. Techniques at equal frame time or equal effort, over independent restarts, against one reference.
//!
//! 1. Effort: integer efforts are calibrated to the frame time (or set by `--spp`).
//! 2. Pilot: a few restarts estimate how much each technique varies, from which follows how good the reference must be.
//! 3. Reference: see [`super::reference`].
//! 4. Restarts, interleaved over techniques, so that a change of the machine's speed meets all alike.
//! 5. Curve: the same at other efforts, with fewer restarts.

mod write;

pub(super) use write::{file_name, guide_layers, sum};

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use super::args::{FilterArg, PictureArgs, ReferenceArgs, parse_positive, split_specs};
use super::calibrate::{calibrate, median_p99, meets};
use super::engine::{self, Engine, Mean, keeps_history};
use super::progress::Progress;
use super::reference::Made;
use super::seeds::{Part, seed};
use super::{Status, bias, figures, machine, note, print, reference};
use crate::counters::Counters;
use crate::frame::{FrameLoop, Guides};
use crate::metrics;
use crate::picture::Picture;
use crate::report::{
    Budget, BudgetKind, Claim, Curve, CurvePoint, ErrorSpectrum, Figure, FrameTime, PassTime,
    Results, Row, SCHEMA, SpectrumPoint, Warmup, summary,
};
use crate::stats::{Criteria, Moments, Restarts};
use crate::techniques::{REGISTRY, Technique};
use crate::{Error, Result};

/// Restarts of the pilot.
const PILOT: u32 = 2;
/// Steady frames of a measurement of frame time.
const TIMED_FRAMES: u32 = 9;
/// A reference's variance over the smallest mse, unless its time is up first (Celarek et al. 2019 on noisy references).
const REFERENCE_SHARE: f64 = 0.01;

/// Compare techniques on a scene, at equal frame time or equal effort
///
/// Renders or reuses a reference, runs each technique over independent restarts, prints a table, and writes results.json, table.md,
/// table.csv, curve.csv, `error_time.svg`, spectrum.csv, warmup.csv, warmup.svg, contact.png and EXR and PNG pictures to the output folder. References are cached.
/// Ctrl-C writes the restarts that are done and stops; a second Ctrl-C stops at once.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage compare scenes/cornell.pbrt
        all techniques, each with the frame time of the slowest
  afterimage compare scenes/plates.pbrt --frame-time 100 --restarts 40
        as many estimates a frame as fit into 100 ms
  afterimage compare many-lights:10000:7 --techniques 'nee;bsdf' --spp 4
        equal effort: 4.0 estimates a pixel each
  afterimage compare scenes/moving.pbrt --frames 32 --check
        judge the 32nd frame; exit status 1 if an unbiased technique is found biased")]
pub(super) struct CompareArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Specifications, separated by semicolons [default: all techniques]
    #[arg(long, value_name = "SPEC;SPEC", value_delimiter = None)]
    techniques: Option<String>,
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Milliseconds a frame, met within 5 % where an effort fits, else marked [default: the slowest technique's at effort 1]
    #[arg(long, value_name = "MS", conflicts_with = "spp", value_parser = parse_positive)]
    frame_time: Option<f64>,
    /// Complete independent estimates a pixel and frame, instead of a frame time
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: Option<u32>,
    /// Judge this frame after a cold start (of a technique without history, in a still scene, the second: all have one law)
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Judge the mean of all frames instead of the last
    #[arg(long)]
    accumulate: bool,
    /// Independent restarts a technique
    #[arg(long, value_name = "R", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    restarts: u32,
    /// Restarts of each further point of the error-against-time curve; 0 leaves the curve out
    #[arg(long, value_name = "R", default_value_t = 4)]
    curve_restarts: u32,
    /// Write the error of every frame for all techniques [default: for those that keep history, where the scene is still]
    #[arg(long, conflicts_with = "accumulate")]
    warmup: bool,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// Folder for what is written [default: out/SCENE]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Exit with status 1 if a technique that claims to be unbiased fails the bias test
    #[arg(long)]
    check: bool,
}

/// A technique with what was measured of it.
struct Contender {
    spec: String,
    technique: Arc<dyn Technique>,
    number: u32,
    effort: u32,
    frames: FrameLoop,
    steady: Vec<f64>,
    first: Vec<f64>,
    passes: Vec<(&'static str, Vec<f64>)>,
    work: Counters,
    work_frames: u64,
    restarts: Restarts,
    metrics: Vec<(&'static str, Moments)>,
    /// `relmse` of each frame, where that is asked for.
    warmup: Vec<Moments>,
    /// Power of the error in each ring.
    rings: Vec<Moments>,
    /// For figures that need all restarts at once.
    pictures: Vec<Picture>,
    shown: Option<Picture>,
    emission: Option<Picture>,
}

/// What the judged frames of a restart are.
#[derive(Clone, Copy, Debug)]
struct Judged {
    frames: u32,
    accumulate: bool,
}

pub(super) fn run(args: &CompareArgs) -> Result<Status> {
    let specs = match &args.techniques {
        Some(text) => split_specs(text),
        None => REGISTRY.iter().map(|entry| entry.name.to_string()).collect(),
    };
    if specs.is_empty() {
        return Err(Error::usage("--techniques names none; give SPEC;SPEC, as in 'nee;bsdf'"));
    }
    // Wrong names are found before any work.
    let techniques =
        specs.iter().map(|spec| engine::technique(spec)).collect::<Result<Vec<_>>>()?;
    let engine = Engine::open(
        &args.scene,
        &args.picture,
        args.filter,
        reference::file_size(&args.reference)?,
    )?;
    if args.warmup && engine.stage.facts().moves() {
        return Err(Error::usage(
            "--warmup needs a scene that does not move: its frames have no common reference",
        ));
    }
    if args.accumulate && engine.stage.facts().moves() {
        return Err(Error::usage(
            "--accumulate needs a scene that does not move: the mean over its frames has no reference",
        ));
    }
    let judged = Judged { frames: args.frames, accumulate: args.accumulate };

    let (budget, efforts) = efforts(&engine, &techniques, args)?;
    let mut contenders = Vec::new();
    for (at, technique) in techniques.into_iter().enumerate() {
        let frames = engine.start(&technique, efforts[at], 0)?;
        contenders.push(Contender {
            spec: technique.spec(),
            technique,
            number: at as u32,
            effort: efforts[at],
            frames,
            steady: Vec::new(),
            first: Vec::new(),
            passes: Vec::new(),
            work: Counters::default(),
            work_frames: 0,
            restarts: bias::restarts(engine.shot.size)?,
            metrics: Vec::new(),
            warmup: Vec::new(),
            rings: vec![Moments::new(); figures::RINGS],
            pictures: Vec::new(),
            shown: None,
            emission: None,
        });
    }
    let variance = pilot(&engine, &mut contenders, judged, args.picture.seed)?;
    // The curve's longest frames are four times as long, so their error is as many times smaller.
    let reach = if args.curve_restarts > 0 { 4.0 } else { 1.0 };
    let frozen = engine.frozen(args.frames - 1)?;
    let mut made =
        reference::obtain(&frozen, &args.reference, "nee", REFERENCE_SHARE * variance / reach)?;
    let truth = made.reference.picture();

    let mut interrupted = false;
    let guides = Guides::new(frozen.stage.first_world(), None, engine.shot.size);
    let warms = !args.accumulate && !engine.stage.facts().moves();
    for contender in &mut contenders {
        if warms && (args.warmup || keeps_history(contender.frames.plan())) {
            contender.warmup = vec![Moments::new(); args.frames as usize];
        }
    }
    let moves = engine.stage.facts().moves();
    match restarts(&mut contenders, (judged, moves), args, &truth, &guides) {
        Ok(()) => {}
        Err(error)
            if error.is_interrupted() && contenders.iter().all(|c| c.restarts.count() > 0) =>
        {
            interrupted = true;
        }
        Err(error) => return Err(error),
    }
    let mut curves = Vec::new();
    if !interrupted && args.curve_restarts > 0 {
        match self::curves(&engine, &contenders, judged, args, &truth) {
            Ok(found) => curves = found,
            Err(error) if error.is_interrupted() => interrupted = true,
            Err(error) => return Err(error),
        }
    }

    let rows = contenders
        .iter()
        .map(|c| row(&engine, c, budget, judged, &made, &truth))
        .collect::<Result<Vec<Row>>>()?;
    let smallest = rows
        .iter()
        .filter_map(|r| r.metrics.get("mse"))
        .map(|f| f.mean)
        .fold(f64::INFINITY, f64::min);
    made.info.share_of_smallest_mse =
        made.info.variance.map(|v| v / smallest).filter(|share| share.is_finite());
    let results = Results {
        afterimage: env!("CARGO_PKG_VERSION").to_string(),
        commit: machine::commit(),
        machine: match engine.device() {
            Some(device) => format!("{}; {device}", machine::describe()),
            None => machine::describe(),
        },
        command: machine::command(),
        scene: engine.scene.clone(),
        size: engine.shot.size,
        depth: engine.shot.depth,
        seed: args.picture.seed,
        filter: args.filter.name().to_string(),
        reference: made.info.clone(),
        schema: SCHEMA,
        interrupted,
        rows,
        curves,
        warmups: contenders
            .iter()
            .filter(|c| !c.warmup.is_empty())
            .map(|c| Warmup {
                technique: c.spec.clone(),
                relmse: c.warmup.iter().map(figures::over_restarts).collect(),
            })
            .collect(),
        spectra: contenders.iter().map(spectrum).collect(),
    };
    let folder =
        args.out.clone().unwrap_or_else(|| PathBuf::from("out").join(file_name(&engine.name)));
    write::all(&folder, &results, &contenders, (&truth, &guides))?;
    print(&summary(&results))?;
    note(&format!(
        "wrote {0}; all metrics: {0}/table.md, their meaning: docs/metrics.md",
        folder.display()
    ));
    for contender in &contenders {
        if contender.work.non_finite > 0 {
            note(&format!(
                "warning: `{}` made {} estimates that are not finite",
                contender.spec, contender.work.non_finite
            ));
        }
    }
    if interrupted {
        note("stopped by the user");
        return Ok(Status::Interrupted);
    }
    let failed = |row: &Row| {
        row.claim == Claim::Unbiased && row.bias.as_ref().is_some_and(|b| b.verdict == "fail")
    };
    Ok(if args.check && results.rows.iter().any(failed) {
        Status::CheckFailed
    } else {
        Status::Done
    })
}

/// The budget, and each technique's effort in it.
fn efforts(
    engine: &Engine,
    techniques: &[Arc<dyn Technique>],
    args: &CompareArgs,
) -> Result<((BudgetKind, f64), Vec<u32>)> {
    if let Some(spp) = args.spp {
        return Ok(((BudgetKind::Spp, f64::from(spp)), vec![spp; techniques.len()]));
    }
    let progress = Progress::new("calibration", techniques.len() as u64);
    let time = |at: usize, effort: u32| {
        progress.say(&format!("{} at effort {effort}", techniques[at].spec()));
        steady_time(
            engine,
            &techniques[at],
            effort,
            seed(args.picture.seed, Part::Calibration, at as u32, effort),
        )
    };
    let at_one = (0..techniques.len()).map(|at| time(at, 1)).collect::<Result<Vec<f64>>>()?;
    let budget = args.frame_time.unwrap_or_else(|| at_one.iter().copied().fold(0.0, f64::max));
    let mut efforts = Vec::new();
    for (at, &first) in at_one.iter().enumerate() {
        let (effort, _) =
            calibrate(budget, |effort| if effort == 1 { Ok(first) } else { time(at, effort) })?;
        efforts.push(effort);
        progress.step();
    }
    Ok(((BudgetKind::FrameTime, budget), efforts))
}

/// Median milliseconds of frames after the first.
fn steady_time(
    engine: &Engine,
    technique: &Arc<dyn Technique>,
    effort: u32,
    run: u64,
) -> Result<f64> {
    let mut frames = engine.start(technique, effort, run)?;
    engine::next(&mut frames)?;
    let times = (0..TIMED_FRAMES)
        .map(|_| Ok(engine::next(&mut frames)?.milliseconds()))
        .collect::<Result<Vec<f64>>>()?;
    Ok(median_p99(&times)[0])
}

/// The smallest variance of a pixel among techniques: a lower bound of their mean squared errors, found without a reference.
fn pilot(engine: &Engine, contenders: &mut [Contender], judged: Judged, run: u64) -> Result<f64> {
    let progress = Progress::new("pilot", contenders.len() as u64 * u64::from(PILOT));
    let mut smallest = f64::INFINITY;
    for contender in contenders {
        let frames = needed_frames(contender, judged);
        let mut restarts = bias::restarts(engine.shot.size)?;
        for index in 0..PILOT {
            progress.say(&contender.spec);
            contender.frames.restart(seed(run, Part::Pilot, contender.number, index));
            let judged = Judged { frames, ..judged };
            restarts.push(&judged_picture(&mut contender.frames, judged, |_, _| {})?.pixels)?;
            progress.step();
        }
        let variance = bias::mean_variance(&restarts, engine.shot.pixels());
        // A picture without any noise (black, or emission only) says nothing about what the reference needs.
        if variance > 0.0 {
            smallest = smallest.min(variance);
        }
    }
    Ok(smallest)
}

/// Frames that a picture of the judged quality takes where no time is measured: without history, all frames are alike.
fn needed_frames(contender: &Contender, judged: Judged) -> u32 {
    if judged.accumulate || keeps_history(contender.frames.plan()) { judged.frames } else { 1 }
}

/// Renders from a cold start, hands each frame to `each`, and gives the picture that is judged.
fn judged_picture(
    frames: &mut FrameLoop,
    judged: Judged,
    mut each: impl FnMut(u32, &crate::frame::Frame<'_>),
) -> Result<Picture> {
    let mut mean = judged.accumulate.then(|| Mean::new(frames.shot().size));
    for index in 0..judged.frames {
        let frame = engine::next(frames)?;
        each(index, &frame);
        if let Some(mean) = &mut mean {
            mean.add(&frame.picture(), 1);
        }
        if index + 1 == judged.frames {
            return Ok(mean.map_or_else(|| frame.picture(), |m| m.picture()));
        }
    }
    Err(Error::usage("--frames is 0, but must be at least 1"))
}

/// All restarts of all techniques.
fn restarts(
    contenders: &mut [Contender],
    (judged, moves): (Judged, bool),
    args: &CompareArgs,
    truth: &Picture,
    guides: &Guides,
) -> Result<()> {
    let guides =
        metrics::Guides { albedo: &guides.albedo, normal: &guides.normal, depth: &guides.depth };
    let progress = Progress::new("restarts", u64::from(args.restarts) * contenders.len() as u64);
    for index in 0..args.restarts {
        for contender in contenders.iter_mut() {
            progress.say(&contender.spec);
            // Without history and motion all frames have one law: a first and a steady one give picture and times.
            let all = moves || !contender.warmup.is_empty();
            let needed = if all { judged.frames } else { needed_frames(contender, judged).max(2) };
            let judged = Judged { frames: judged.frames.min(needed), ..judged };
            let Contender {
                number,
                frames,
                steady,
                first,
                passes,
                work,
                work_frames,
                emission,
                warmup,
                ..
            } = &mut *contender;
            frames.restart(seed(args.picture.seed, Part::Restart, *number, index));
            let mut shown = Ok(());
            let picture = judged_picture(frames, judged, |at, frame| {
                if let Some(moments) = warmup.get_mut(at as usize) {
                    match figures::relmse(&frame.picture(), truth) {
                        Ok(relmse) => moments.push(relmse),
                        Err(error) => shown = Err(error),
                    }
                }
                let ms = frame.milliseconds();
                let times = if at == 0 { &mut *first } else { &mut *steady };
                times.push(ms);
                // Passes that run in the first frame only are no part of a steady frame, unless there is no other.
                if at > 0 || judged.frames == 1 {
                    *work = *work + frame.counters;
                    *work_frames += 1;
                    engine::add_times(passes, frame);
                }
                if emission.is_none() && at + 1 == judged.frames {
                    *emission = Some(frame.emission());
                }
            })?;
            shown?;
            contender.restarts.push(&picture.pixels)?;
            for (ring, power) in contender.rings.iter_mut().zip(figures::spectrum(&picture, truth)?)
            {
                ring.push(power);
            }
            for (name, value) in figures::of_picture(&picture, truth, Some(&guides))? {
                match contender.metrics.iter_mut().find(|(known, _)| *known == name) {
                    Some((_, moments)) => moments.push(value),
                    None => {
                        let mut moments = Moments::new();
                        moments.push(value);
                        contender.metrics.push((name, moments));
                    }
                }
            }
            if args.restarts >= figures::COVARIANCE_NEEDS {
                contender.pictures.push(picture.clone());
            }
            contender.shown.get_or_insert(picture);
            progress.step();
        }
    }
    Ok(())
}

/// Error against time: each technique at a quarter to twice its effort, or at one to four times an effort of 1.
fn curves(
    engine: &Engine,
    contenders: &[Contender],
    judged: Judged,
    args: &CompareArgs,
    truth: &Picture,
) -> Result<Vec<Curve>> {
    let efforts_of = |effort: u32| {
        let mut efforts =
            vec![effort.div_ceil(4), effort.div_ceil(2), effort, effort.saturating_mul(2)];
        efforts.dedup();
        // A line needs three points; four times the effort takes as long as all others together.
        if efforts.len() < 3 {
            efforts.push(effort.saturating_mul(4));
        }
        efforts
    };
    let steps: usize = contenders.iter().map(|c| efforts_of(c.effort).len() - 1).sum();
    let progress = Progress::new("curve", steps as u64 * u64::from(args.curve_restarts));
    let mut curves = Vec::new();
    for contender in contenders {
        let history = judged.accumulate || keeps_history(contender.frames.plan());
        // Without history a second frame gives the time and the picture.
        let judged =
            if history { judged } else { Judged { frames: judged.frames.min(2), ..judged } };
        let mut points = Vec::new();
        for effort in efforts_of(contender.effort) {
            if effort == contender.effort {
                let relmse = contender.metrics.iter().find(|(name, _)| *name == "relmse");
                if let Some((_, moments)) = relmse {
                    points.push(CurvePoint {
                        effort,
                        ms: steady(contender),
                        relmse: figures::over_restarts(moments),
                    });
                }
                continue;
            }
            progress.say(&format!("{} at effort {effort}", contender.spec));
            let mut frames = engine.start(&contender.technique, effort, 0)?;
            let (mut times, mut moments) = (Vec::new(), Moments::new());
            for index in 0..args.curve_restarts {
                let run = seed(
                    args.picture.seed,
                    Part::Curve,
                    contender.number,
                    effort.wrapping_mul(4096).wrapping_add(index),
                );
                frames.restart(run);
                let picture = judged_picture(&mut frames, judged, |at, frame| {
                    if at > 0 || judged.frames == 1 {
                        times.push(frame.milliseconds());
                    }
                })?;
                moments.push(figures::relmse(&picture, truth)?);
                progress.step();
            }
            points.push(CurvePoint {
                effort,
                ms: median_p99(&times)[0],
                relmse: figures::over_restarts(&moments),
            });
        }
        curves.push(Curve { technique: contender.spec.clone(), points });
    }
    Ok(curves)
}

/// Median steady frame; of the first frames where there are no others.
fn steady(contender: &Contender) -> f64 {
    let times = if contender.steady.is_empty() { &contender.first } else { &contender.steady };
    median_p99(times)[0]
}

fn row(
    engine: &Engine,
    contender: &Contender,
    budget: (BudgetKind, f64),
    judged: Judged,
    made: &Made,
    truth: &Picture,
) -> Result<Row> {
    let plan = contender.frames.plan();
    let pixels = engine.shot.pixels() as f64;
    let times = if contender.steady.is_empty() { &contender.first } else { &contender.steady };
    let [median, p99] = median_p99(times);
    let per_pixel = pixels * contender.work_frames.max(1) as f64;
    let rays_per_pixel = contender
        .work
        .entries()
        .into_iter()
        .filter_map(|(name, n)| {
            Some((name.strip_suffix("_rays")?.to_string(), n as f64 / per_pixel))
        })
        .collect();
    let mut metrics: BTreeMap<String, Figure> = contender
        .metrics
        .iter()
        .map(|(name, moments)| ((*name).to_string(), figures::over_restarts(moments)))
        .collect();
    if let Some(relmse) = metrics.get("relmse").copied() {
        let seconds = median * 1e-3;
        let ci = relmse.ci.map(|ends| ends.map(|end| end * seconds));
        metrics.insert("ttuv".to_string(), Figure { mean: relmse.mean * seconds, ci });
    }
    if contender.pictures.len() >= figures::COVARIANCE_NEEDS as usize {
        metrics
            .insert("covariance_r8".to_string(), figures::covariance(&contender.pictures, truth)?);
    }
    let (kind, value) = budget;
    Ok(Row {
        technique: contender.spec.clone(),
        budget: Budget {
            kind,
            value,
            effort: contender.effort,
            over_budget: kind == BudgetKind::FrameTime && !meets(median, value),
        },
        claim: claim(&plan.claim),
        backend: if contender.frames.runs_on().is_some() { "gpu" } else { "cpu" }.to_string(),
        frames: judged.frames,
        restarts: contender.restarts.count() as u32,
        ms_per_frame: FrameTime { median, p99, first: median_p99(&contender.first)[0] },
        rays_per_pixel,
        bytes_per_pixel: plan.bytes_per_pixel(engine.shot.pixels()),
        passes: contender
            .passes
            .iter()
            .map(|(name, times)| PassTime { name: (*name).to_string(), ms: median_p99(times)[0] })
            .collect(),
        metrics,
        bias: Some(bias::report(&bias::judge(
            &contender.restarts,
            &made.reference,
            &Criteria::default(),
        )?)),
        non_finite: contender.work.non_finite,
    })
}

fn spectrum(contender: &Contender) -> ErrorSpectrum {
    let points = (1..)
        .zip(&contender.rings)
        .map(|(ring, power)| SpectrumPoint {
            cycles: 0.5 * f64::from(ring) / figures::RINGS as f64,
            power: figures::over_restarts(power),
        })
        // Small pictures leave rings empty.
        .filter(|point| point.power.mean.is_finite())
        .collect();
    ErrorSpectrum { technique: contender.spec.clone(), points }
}

/// The plan's claim in the form of `results.json`.
pub(super) fn claim(claim: &crate::plan::Claim) -> Claim {
    match claim {
        crate::plan::Claim::Unbiased => Claim::Unbiased,
        crate::plan::Claim::Consistent => Claim::Consistent,
        crate::plan::Claim::Biased(why) => Claim::Biased(why.clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn claims_keep_their_reason() {
        assert_eq!(claim(&crate::plan::Claim::Biased("x".into())), Claim::Biased("x".into()));
        assert_eq!(claim(&crate::plan::Claim::Unbiased), Claim::Unbiased);
    }
}
