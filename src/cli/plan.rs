//! `plan`: what a technique will run on a scene, what the scene lets it leave out, and what is left
//! takes.

use std::sync::Arc;

use clap::Args;
use serde_json::{Value, json};

use super::args::{FilterArg, PictureArgs};
use super::{Status, print};
use crate::Result;
use crate::counters::Counters;
use crate::experiment::{Session, add_times, claim, median_p99, technique};
use crate::plan::{Domain, Elements, Grid, Plan, Runs, SceneFacts};
use crate::report::{align, figure};
use crate::techniques::Technique;

/// Show what a technique will run on a scene, what is skipped, and why
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage plan scenes/cornell.pbrt --technique nee
  afterimage plan many-lights:1000 --technique restir-di --depth 2 --threads 1 --measure 40
        and what each pass takes, and how many rays, once history is full")]
pub(super) struct PlanArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A technique's specification; see `afterimage list techniques`
    #[arg(long, value_name = "SPEC")]
    technique: String,
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Independent estimates a pixel and frame; of a technique that keeps reservoirs, chains of
    /// them
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    spp: f32,
    /// Print JSON
    #[arg(long, conflicts_with = "measure")]
    json: bool,
    /// Render N frames and show what each pass and pixel took, as medians of the second half of
    /// them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    measure: Option<u32>,
}

pub(super) fn run(args: &PlanArgs) -> Result<Status> {
    let technique = technique(&args.technique)?;
    let mut session = args.picture.open(&args.scene, args.filter, None)?;
    session.shot.effort = args.spp;
    session.shot.validate()?;
    let plan = session.plan(&*technique);
    let pixels = session.shot.pixels();
    let text = if args.json {
        format!("{:#}\n", to_json(&plan, session.stage.facts(), pixels))
    } else {
        let mut text = format!("scene      {}\n", session.scene);
        for (name, value) in session.stage.facts().entries() {
            text.push_str(&format!("  {name:<30} {value}\n"));
        }
        let bytes = plan.bytes_per_pixel(pixels);
        let measured = match args.measure {
            Some(frames) => measured(&session, &technique, frames)?,
            None => String::new(),
        };
        format!("{text}{plan}bytes      {bytes} a pixel\n{measured}")
    };
    print(&text)?;
    Ok(Status::Done)
}

/// Time of each pass and work of a pixel in a steady frame.
fn measured(session: &Session, technique: &Arc<dyn Technique>, count: u32) -> Result<String> {
    let mut frames = session.start(technique, session.shot.effort, session.shot.run)?;
    let progress = session.host().begin("frames", u64::from(count));
    let mut passes: Vec<(&'static str, Vec<f64>)> = Vec::new();
    let mut totals = Vec::new();
    let mut work = Counters::default();
    for index in 0..count {
        let frame = session.next(&mut frames)?;
        if index >= count / 2 {
            totals.push(frame.milliseconds());
            work = work + frame.counters;
            add_times(&mut passes, &frame);
        }
        progress.step();
    }
    drop(progress);
    let pixels = session.shot.pixels() as f64;
    let [total, _] = median_p99(&totals);
    let line = |name: &str, ms: f64| {
        let share = format!("{:.0} %", 100.0 * ms / total);
        vec![name.to_string(), figure(ms), figure(1e6 * ms / pixels), share]
    };
    let mut times: Vec<Vec<String>> =
        passes.iter().map(|(name, times)| line(name, median_p99(times)[0])).collect();
    times.push(line("frame", total));
    let header = |names: &[&str]| names.iter().map(|name| (*name).to_string()).collect::<Vec<_>>();
    let watched = totals.len() as f64 * pixels;
    let work: Vec<Vec<String>> = work
        .entries()
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| vec![name.to_string(), figure(count as f64 / watched)])
        .collect();
    Ok(format!(
        "\n{}\n{}",
        align(&header(&["pass", "ms", "ns a pixel", "share"]), &times),
        align(&header(&["work", "a pixel"]), &work)
    ))
}

fn to_json(plan: &Plan, facts: &SceneFacts, pixels: usize) -> Value {
    let facts: serde_json::Map<String, Value> =
        facts.entries().into_iter().map(|(name, value)| (name.to_string(), value.into())).collect();
    let passes: Vec<Value> = plan
        .passes
        .iter()
        .map(|pass| {
            let domain = match pass.domain {
                Domain::Pixels => json!("pixels"),
                Domain::Tiles { width, height, grid: Grid::Fixed(origin) } => {
                    json!({ "tiles": [width, height], "origin": origin })
                }
                Domain::Tiles { width, height, grid: Grid::PerFrame(_) } => {
                    json!({ "tiles": [width, height], "origin": "another in each frame" })
                }
                Domain::Items(n) => json!({ "items": n }),
            };
            let writes: Vec<&str> = pass.writes.iter().map(|id| plan.buffers[id.0].name).collect();
            let runs = match pass.runs {
                Runs::Always => "always",
                Runs::Once => "once",
                Runs::WithHistory => "with history",
            };
            json!({ "name": pass.name, "domain": domain, "writes": writes, "runs": runs })
        })
        .collect();
    let buffers: Vec<Value> = plan
        .buffers
        .iter()
        .map(|buffer| {
            let elements = match buffer.elements {
                Elements::Pixels => json!("pixels"),
                Elements::Items(n) => json!(n),
            };
            json!({ "name": buffer.name, "bytes": buffer.bytes, "elements": elements, "history": buffer.history })
        })
        .collect();
    let skipped: Vec<Value> =
        plan.skipped.iter().map(|s| json!({ "what": s.what, "because": s.because })).collect();
    let rays: serde_json::Map<String, Value> = Plan::RAY_KINDS
        .iter()
        .zip(plan.rays_per_pixel())
        .map(|(kind, most)| ((*kind).to_string(), most.into()))
        .collect();
    let constants: serde_json::Map<String, Value> =
        plan.constants.iter().map(|(name, value)| ((*name).to_string(), (*value).into())).collect();
    json!({
        "technique": plan.technique,
        "claim": claim(&plan.claim),
        "facts": facts,
        "passes": passes,
        "buffers": buffers,
        "skipped": skipped,
        "rays_per_pixel_at_most": rays,
        "constants": constants,
        "bytes_per_pixel": plan.bytes_per_pixel(pixels),
    })
}
