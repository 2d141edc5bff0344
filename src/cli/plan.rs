//! `plan`: what a technique will run on a scene, and what the scene lets it leave out.

use clap::Args;
use serde_json::{Value, json};

use super::args::{FilterArg, PictureArgs};
use super::engine::{self, Engine};
use super::{Status, print};
use crate::Result;
use crate::plan::{Domain, Elements, Plan, Runs, SceneFacts};

/// Show what a technique will run on a scene, what is skipped, and why
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  afterimage plan scenes/cornell.pbrt --technique nee")]
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
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &PlanArgs) -> Result<Status> {
    let technique = engine::technique(&args.technique)?;
    let engine = Engine::open(&args.scene, &args.picture, args.filter, None)?;
    let plan = engine.plan(&*technique);
    let pixels = engine.shot.pixels();
    let text = if args.json {
        format!("{:#}\n", to_json(&plan, engine.stage.facts(), pixels))
    } else {
        let mut text = format!("scene      {}\n", engine.scene);
        for (name, value) in engine.stage.facts().entries() {
            text.push_str(&format!("  {name:<30} {value}\n"));
        }
        format!("{text}{plan}bytes      {} a pixel\n", plan.bytes_per_pixel(pixels))
    };
    print(&text)?;
    Ok(Status::Done)
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
                Domain::Tiles { width, height, origin } => {
                    json!({ "tiles": [width, height], "origin": origin })
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
        .zip(plan.rays_per_pixel)
        .map(|(kind, most)| ((*kind).to_string(), most.into()))
        .collect();
    let constants: serde_json::Map<String, Value> =
        plan.constants.iter().map(|(name, value)| ((*name).to_string(), (*value).into())).collect();
    json!({
        "technique": plan.technique,
        "claim": super::compare::claim(&plan.claim),
        "facts": facts,
        "passes": passes,
        "buffers": buffers,
        "skipped": skipped,
        "rays_per_pixel_at_most": rays,
        "constants": constants,
        "bytes_per_pixel": plan.bytes_per_pixel(pixels),
    })
}
