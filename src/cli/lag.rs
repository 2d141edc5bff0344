//! `lag`: how many frames a technique needs to show that the scene has changed at once
//! ([`crate::experiment::Lag`]).

use std::fmt::Write as _;

use clap::{Args, ValueEnum};

use super::args::{FilterArg, PictureArgs, ReferenceArgs};
use super::{Status, print};
use crate::experiment::{Change, Lag, LagOutcome, Session, technique};
use crate::stats::Moments;
use crate::{Error, Result};

/// Measure how many frames a technique takes to follow a sudden change
///
/// After some frames of a still scene its lights, or its smallest other surface, jump by their own
/// diagonal along x. Prints the step response (0: as before, 1: as after) and the error of the
/// frames that follow, as means over restarts with 95 % intervals, and the first frame whose mean
/// response is 90 % or more. Direct light (depth 2) unless --depth says otherwise.
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
    #[arg(long, value_enum, default_value_t = ChangeArg::Light)]
    change: ChangeArg,
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
enum ChangeArg {
    /// All lights
    Light,
    /// The smallest surface that does not emit
    Occluder,
}

pub(super) fn run(args: &LagArgs) -> Result<Status> {
    if args.reference.reference.is_some() {
        return Err(Error::usage("--reference is one picture, but a change has two: leave it out"));
    }
    let technique = technique(&args.technique)?;
    let mut picture = args.picture.clone();
    picture.depth = Some(picture.depth.unwrap_or(2));
    let session = picture.open(&args.scene, args.filter, None)?;
    let lag = Lag {
        change: match args.change {
            ChangeArg::Light => Change::Light,
            ChangeArg::Occluder => Change::Occluder,
        },
        before: args.before,
        after: args.after,
        restarts: args.restarts,
        effort: args.spp as f32,
        reference: args.reference.settings(),
    };
    let outcome = lag.run(&session, &technique)?;
    print(&table(&lag, &session, &technique.spec(), &outcome))?;
    Ok(Status::Done)
}

fn table(lag: &Lag, session: &Session, spec: &str, outcome: &LagOutcome) -> String {
    let [width, height] = session.shot.size;
    let what = match lag.change {
        Change::Light => "lights jump",
        Change::Occluder => "an occluder jumps",
    };
    let mut text = format!(
        "{spec} on {} at {width}x{height}, depth {}: {what} after {} frames; {} of {} pixels change\n",
        session.scene,
        session.shot.depth,
        lag.before,
        outcome.changed_pixels,
        session.shot.pixels()
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
    line("before", &outcome.steady, None);
    let response = &outcome.response;
    for at in 0..response.len() {
        // All at first, then ever fewer: 1 to 10, then every fifth, then the last.
        if at < 10 || (at + 1) % 5 == 0 || at + 1 == response.len() {
            line(&(at + 1).to_string(), &response[at], Some(&outcome.error[at]));
        }
    }
    let _ = match outcome.frames() {
        Some(frame) => writeln!(text, "90 % of the step in frame {frame}"),
        None => writeln!(text, "90 % of the step not within {} frames", response.len()),
    };
    let _ =
        writeln!(text, "seeds: restarts 0 to {} of --seed {}", lag.restarts - 1, session.shot.run);
    text
}
