//! `lag`: how many frames a technique needs to show that the scene has changed at once.
//!
//! The scene stands still until a light or an occluder jumps by its own diagonal. The step response of a frame is how far the pixels that
//! change have gone from the old scene's reference a to the new one's b:
//! s = Σ sign(b − a) (x − a) / Σ |b − a| over pixels whose luminance changes by more than a tenth of the largest change.
//! A technique whose every frame is unbiased has s = 1 in the first frame, however much history it keeps.

use std::fmt::Write as _;

use clap::{Args, ValueEnum};
use glam::Vec3;

use super::args::{FilterArg, PictureArgs, ReferenceArgs};
use super::engine::{self, Engine};
use super::progress::Progress;
use super::seeds::{Part, seed};
use super::{Status, figures, interrupt, motion, print, reference};
use crate::frame::{FrameLoop, Stage};
use crate::math::luminance;
use crate::picture::Picture;
use crate::plan::Shot;
use crate::scene::Scene;
use crate::stats::Moments;
use crate::{Error, Result};

/// The share of the step that is waited for.
const REACHED: f64 = 0.9;
/// A pixel changes if its luminance does by this share of the largest change.
const CHANGES: f64 = 0.1;
/// Standard deviation of a reference's pixel, over the picture's mean.
const REFERENCE_ERROR: f64 = 0.03;

/// Measure how many frames a technique takes to follow a sudden change
///
/// After some frames of a still scene its lights, or its smallest other surface, jump by their own diagonal along x. Prints the step
/// response (0: as before, 1: as after) and the error of the frames that follow, as means over restarts with 95 % intervals, and the
/// first frame whose mean response is 90 % or more. Direct light (depth 2) unless --depth says otherwise.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage lag scenes/penumbra.pbrt --technique nee
        without history the first frame is as new as any
  afterimage lag scenes/cornell.pbrt --technique restir-di:cap=50 --change occluder --before 60
        a block jumps after 60 frames")]
pub(super) struct LagArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A technique's specification; see `afterimage list techniques`
    #[arg(long, value_name = "SPEC")]
    technique: String,
    /// What jumps
    #[arg(long, value_enum, default_value_t = Change::Light)]
    change: Change,
    /// Frames before the change
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    before: u32,
    /// Frames after it
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    after: u32,
    /// Independent restarts
    #[arg(long, value_name = "R", default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    restarts: u32,
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Complete independent estimates a pixel and frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: u32,
    #[command(flatten)]
    reference: ReferenceArgs,
}

/// What changes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Change {
    /// All lights
    Light,
    /// The smallest surface that does not emit
    Occluder,
}

pub(super) fn run(args: &LagArgs) -> Result<Status> {
    if args.reference.reference.is_some() {
        return Err(Error::usage("--reference is one picture, but a change has two: leave it out"));
    }
    let technique = engine::technique(&args.technique)?;
    let mut picture = args.picture.clone();
    picture.depth = Some(picture.depth.unwrap_or(2));
    let engine = Engine::open(&args.scene, &picture, args.filter, None)?;
    let old = still(engine.stage.scene());
    let new = changed(&old, args.change)?;

    let stage = Stage::moving(old.clone())?;
    let shot = Shot { effort: args.spp as f32, ..engine.shot };
    let mut frames = FrameLoop::with_backend(technique.clone(), &stage, shot, &engine.backend)?;
    let [before, after] = references(args, &engine, [&old, &new], &mut frames)?;
    let step = Step::new(&before, &after)?;

    let progress = Progress::new("restarts", u64::from(args.restarts));
    let mut response = vec![Moments::new(); args.after as usize];
    let mut error = response.clone();
    let mut steady = Moments::new();
    for index in 0..args.restarts {
        frames.restart(seed(args.picture.seed, Part::Restart, 0, index));
        for at in 0..args.before {
            interrupt::check()?;
            let frame = frames.render_scene(old.clone())?;
            if at + 1 == args.before {
                steady.push(step.response(&frame.picture()));
            }
        }
        for (response, error) in response.iter_mut().zip(&mut error) {
            interrupt::check()?;
            let shown = frames.render_scene(new.clone())?.picture();
            response.push(step.response(&shown));
            error.push(figures::relmse(&shown, &after)?);
        }
        progress.step();
    }
    drop(progress);
    print(&table(args, &engine, &technique.spec(), &step, &steady, &response, &error))?;
    Ok(Status::Done)
}

/// As at its start, an instance a shape, without motion.
fn still(scene: &Scene) -> Scene {
    let mut scene = motion::apart(&scene.at(scene.time[0]));
    scene.time = [0.0, 0.0];
    scene
}

/// After the jump.
fn changed(scene: &Scene, change: Change) -> Result<Scene> {
    let mut made = scene.clone();
    let all = 0..scene.instances.len();
    let things: Vec<usize> = match change {
        Change::Light => all.filter(|&at| motion::emits(scene, &scene.instances[at])).collect(),
        Change::Occluder => vec![motion::occluder(scene)?],
    };
    let path = things.iter().map(|&at| motion::diagonal(scene, at)).fold(0.0, f32::max) * Vec3::X;
    if things.is_empty() {
        return Err(Error::usage(
            "no surface of the scene emits; lights without a surface have no size to jump by: try --change occluder",
        ));
    }
    for at in things {
        made.instances[at].to_world = motion::moved(&scene.instances[at].to_world, path);
    }
    Ok(made)
}

/// References of both scenes.
fn references(
    args: &LagArgs,
    engine: &Engine,
    scenes: [&Scene; 2],
    frames: &mut FrameLoop,
) -> Result<[Picture; 2]> {
    frames.restart(seed(args.picture.seed, Part::Pilot, 0, 0));
    let mean = frames.render_scene(scenes[0].clone())?.picture().mean_luminance();
    let error = REFERENCE_ERROR * mean;
    let variance = if error > 0.0 { error * error } else { f64::INFINITY };
    let of = |scene: &Scene| {
        let engine = engine.with_scene(scene.clone())?;
        Ok(reference::obtain(&engine, &args.reference, "nee", variance)?.reference.picture())
    };
    Ok([of(scenes[0])?, of(scenes[1])?])
}

/// Where and how far the picture changes.
struct Step {
    /// Pixel, luminance before, sign of its change.
    pixels: Vec<(usize, f64, f64)>,
    /// Σ |b − a|.
    size: f64,
}

impl Step {
    fn new(before: &Picture, after: &Picture) -> Result<Self> {
        let lum = |p: &Picture, at: usize| f64::from(luminance(p.pixels[at]));
        let change = |at: usize| lum(after, at) - lum(before, at);
        let count = before.pixels.len();
        let largest = (0..count).map(|at| change(at).abs()).fold(0.0, f64::max);
        if largest == 0.0 {
            return Err(Error::usage("the change changes no pixel: try another --change or scene"));
        }
        let pixels: Vec<_> = (0..count)
            .filter(|&at| change(at).abs() > CHANGES * largest)
            .map(|at| (at, lum(before, at), change(at).signum()))
            .collect();
        let size = pixels.iter().map(|&(at, ..)| change(at).abs()).sum();
        Ok(Self { pixels, size })
    }

    fn response(&self, shown: &Picture) -> f64 {
        let gone = |&(at, before, sign): &(usize, f64, f64)| {
            sign * (f64::from(luminance(shown.pixels[at])) - before)
        };
        self.pixels.iter().map(gone).sum::<f64>() / self.size
    }
}

/// The first frame, from 1, whose mean has gone far enough.
fn frames_to(share: f64, response: &[Moments]) -> Option<usize> {
    response.iter().position(|moments| moments.mean() >= share).map(|at| at + 1)
}

fn table(
    args: &LagArgs,
    engine: &Engine,
    spec: &str,
    step: &Step,
    steady: &Moments,
    response: &[Moments],
    error: &[Moments],
) -> String {
    let [width, height] = engine.shot.size;
    let what = match args.change {
        Change::Light => "lights jump",
        Change::Occluder => "an occluder jumps",
    };
    let mut text = format!(
        "{spec} on {} at {width}x{height}, depth {}: {what} after {} frames; {} of {} pixels change\n",
        engine.scene,
        engine.shot.depth,
        args.before,
        step.pixels.len(),
        engine.shot.pixels()
    );
    let _ = writeln!(text, "{:>8} {:>28} {:>28}", "frame", "response", "relmse");
    let mut line = |frame: &str, response: &Moments, error: Option<&Moments>| {
        let figure = |moments: &Moments| {
            let (low, high) = moments.estimate().interval(0.95);
            format!("{:.3} [{low:.3}, {high:.3}]", moments.mean())
        };
        let error = error.map_or(String::new(), figure);
        let _ = writeln!(text, "{frame:>8} {:>28} {error:>28}", figure(response));
    };
    line("before", steady, None);
    for at in 0..response.len() {
        // All at first, then ever fewer: 1 to 10, then every fifth, then the last.
        if at < 10 || (at + 1) % 5 == 0 || at + 1 == response.len() {
            line(&(at + 1).to_string(), &response[at], Some(&error[at]));
        }
    }
    let _ = match frames_to(REACHED, response) {
        Some(frame) => writeln!(text, "90 % of the step in frame {frame}"),
        None => writeln!(text, "90 % of the step not within {} frames", response.len()),
    };
    let _ = writeln!(
        text,
        "seeds: restarts 0 to {} of --seed {}",
        args.restarts - 1,
        args.picture.seed
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Picture {
        Picture::new(values.len() as u32, 1, values.iter().map(|v| Vec3::splat(*v)).collect())
    }

    #[test]
    fn response_runs_from_before_to_after_over_pixels_that_change() {
        let (before, after) = (grey(&[1.0, 2.0, 5.0, 0.0]), grey(&[3.0, 1.0, 5.0, 0.01]));
        let step = Step::new(&before, &after).unwrap();
        assert_eq!(step.pixels.len(), 2, "0.01 is less than a tenth of 2");
        assert!(step.response(&before).abs() < 1e-6);
        assert!((step.response(&after) - 1.0).abs() < 1e-6);
        // Half of the way in one pixel, all of it in the other: (1 + 1) / 3. Other pixels do not matter.
        let half = grey(&[2.0, 1.0, 900.0, 900.0]);
        assert!((step.response(&half) - 2.0 / 3.0).abs() < 1e-6);
        assert!(Step::new(&before, &before).is_err());
    }

    #[test]
    fn a_history_of_nine_tenths_takes_22_frames() {
        // 1 − 0.9^n ≥ 0.9 from n = 22; the mean over restarts counts, not a lucky one.
        let moments = |n: i32| -> Moments {
            let mean = 1.0 - 0.9_f64.powi(n);
            [mean - 0.3, mean + 0.3].into_iter().collect()
        };
        let response: Vec<Moments> = (1..=30).map(moments).collect();
        assert_eq!(frames_to(REACHED, &response), Some(22));
        assert_eq!(frames_to(REACHED, &response[..21]), None);
    }

    #[test]
    fn only_what_shall_jump_does() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
        let scene = still(&crate::scene::load::load(&path).unwrap().scene);
        for (change, emits) in [(Change::Light, true), (Change::Occluder, false)] {
            let new = changed(&scene, change).unwrap();
            let moved: Vec<bool> = scene
                .instances
                .iter()
                .zip(&new.instances)
                .filter(|(a, b)| a.to_world.fixed() != b.to_world.fixed())
                .map(|(a, _)| motion::emits(&scene, a))
                .collect();
            assert_eq!(moved, [emits]);
        }
        assert!(changed(&Scene::new("empty"), Change::Light).unwrap_err().is_usage());
    }
}
