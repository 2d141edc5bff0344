//! `inspect`: one pixel, from its surface over its candidates to its single estimates and what its
//! reservoir keeps ([`crate::experiment::Inspection`]).

use std::fmt::Write as _;

use clap::Args;
use glam::Vec3;

use super::args::{FilterArg, PictureArgs, parse_pixel};
use super::{Status, print};
use crate::Result;
use crate::experiment::{BufferState, Candidate, Inspected, Inspection, SeenSurface, technique};
use crate::math::luminance;
use crate::report::figure;
use crate::stats::Moments;

/// Lights that are shown.
const MOST_LIGHTS: usize = 12;

/// Look at one pixel: surface, lights, candidates with their weights, a technique's estimates one
/// by one, its reservoir
#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  afterimage inspect scenes/cornell.pbrt --technique nee --pixel 128,150 --samples 16"
)]
pub(super) struct InspectArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A technique's specification; see `afterimage list techniques`
    #[arg(long, value_name = "SPEC")]
    technique: String,
    /// The pixel, from the upper left corner
    #[arg(long, value_name = "X,Y", value_parser = parse_pixel)]
    pixel: [u32; 2],
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Which frame after a cold start
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Independent estimates to show
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
}

pub(super) fn run(args: &InspectArgs) -> Result<Status> {
    let technique = technique(&args.technique)?;
    let session = args.picture.open(&args.scene, args.filter, None)?;
    let inspection = Inspection { pixel: args.pixel, frame: args.frames, samples: args.samples };
    let Inspected { surface: found, candidates: samples, plan, estimates: values, state } =
        inspection.run(&session, &technique)?;
    let ([x, y], [width, height]) = (args.pixel, session.shot.size);
    let mut text =
        format!("pixel {x},{y} of {} at {width}x{height}, frame {}\n", session.scene, args.frames);
    match &found {
        Ok(found) => surface(&mut text, found),
        Err(sky) => {
            let _ = writeln!(text, "hits nothing; the sky emits {sky}");
        }
    }
    candidates(&mut text, &samples);
    let _ = writeln!(text, "\n`{}` claims to be {}", plan.technique, plan.claim);
    estimates(&mut text, &values);
    if !state.is_empty() {
        let _ = writeln!(text, "\nstate after the last estimate");
    }
    for BufferState { buffer, fields } in state {
        let fields: Vec<String> =
            fields.into_iter().map(|(name, value)| format!("{name} {value}")).collect();
        let _ = writeln!(text, "{buffer:>12}  {}", fields.join(", "));
    }
    print(&text)?;
    Ok(Status::Done)
}

/// The surface and the lights.
fn surface(text: &mut String, found: &SeenSurface) {
    let _ = writeln!(text, "distance   {}", figure(f64::from(found.distance)));
    let _ = writeln!(text, "position   {}", found.position);
    let _ = writeln!(text, "normal     {}", found.normal);
    let _ = writeln!(text, "albedo     {}", found.albedo);
    let _ = writeln!(text, "emits      {}", found.emitted);
    let lights = &found.lights;
    let _ = writeln!(text, "\n{} lights\n{:>8}  {:>12}", lights.len(), "light", "chosen with");
    for (light, chance) in lights.iter().take(MOST_LIGHTS) {
        let _ = writeln!(text, "{light:>8}  {:>12}", figure(f64::from(*chance)));
    }
    if lights.len() > MOST_LIGHTS {
        let _ = writeln!(text, "     ...  {} more", lights.len() - MOST_LIGHTS);
    }
}

/// Light samples as the pixel sees them, with what resampling and MIS make of each.
fn candidates(text: &mut String, samples: &[Candidate]) {
    if samples.is_empty() {
        return;
    }
    let _ = writeln!(
        text,
        "\n{} light samples: target p, densities of light and BSDF sampling, share of light sampling (balance; power, as `nee`),\n\
         weight p / density, seen or not\n{:>8}  {:>10} {:>10} {:>10} {:>8} {:>8} {:>10} {:>5}",
        samples.len(),
        "light",
        "target",
        "by light",
        "by BSDF",
        "balance",
        "power",
        "weight",
        "seen"
    );
    for Candidate { light, sight } in samples {
        let Some(sight) = sight else {
            let _ = writeln!(text, "{light:>8}  {:>10}", 0);
            continue;
        };
        let [target, density, bsdf, balance, power, weight] =
            [sight.target, sight.by_light, sight.by_bsdf, sight.balance, sight.power, sight.weight]
                .map(|v| figure(f64::from(v)));
        let seen = if sight.seen { "yes" } else { "no" };
        let _ = writeln!(
            text,
            "{light:>8}  {target:>10} {density:>10} {bsdf:>10} {balance:>8} {power:>8} {weight:>10} {seen:>5}"
        );
    }
}

/// Independent estimates one by one, and their moments.
fn estimates(text: &mut String, values: &[Vec3]) {
    let _ = writeln!(
        text,
        "{:>8}  {:>10} {:>10} {:>10} {:>10}",
        "estimate", "red", "green", "blue", "luminance"
    );
    let mut moments = Moments::new();
    for (at, value) in values.iter().enumerate() {
        let grey = luminance(*value);
        moments.push(f64::from(grey));
        let [r, g, b] = value.to_array().map(|v| figure(f64::from(v)));
        let _ = writeln!(
            text,
            "{:>8}  {r:>10} {g:>10} {b:>10} {:>10}",
            at + 1,
            figure(f64::from(grey))
        );
    }
    let zeros = values.iter().filter(|value| **value == Vec3::ZERO).count();
    let _ = writeln!(
        text,
        "mean luminance {}, standard deviation {}, skewness {}, {zeros} of {} black",
        figure(moments.mean()),
        figure(moments.variance().sqrt()),
        figure(moments.skewness()),
        values.len()
    );
}
