//! `compare`: the main job. Techniques at equal frame time or equal effort against one reference
//! ([`crate::experiment::Comparison`]).

use std::path::PathBuf;

use clap::Args;

use super::args::{FilterArg, PictureArgs, ReferenceArgs, SceneArgs, parse_positive, split_specs};
use super::command_line::command_line;
use super::{Status, note, print};
use crate::experiment::{Compared, Comparison, Keep, Spending, file_name, technique};
use crate::report::{Claim, Row, summary};
use crate::techniques::REGISTRY;
use crate::{Error, Result};

/// Compare techniques on a scene, at equal frame time or equal effort
///
/// Renders or reuses a reference, runs each technique over independent restarts, prints a table,
/// and writes results.json, table.md, table.csv, curve.csv, `error_time.svg`, spectrum.csv,
/// warmup.csv, warmup.svg, contact.png and EXR and PNG pictures to the output folder. References
/// are cached. Ctrl-C writes the restarts that are done and stops; a second Ctrl-C stops at once.
/// However it was stopped, the same command goes on with the restarts that are done.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage compare scenes/cornell.pbrt
        all techniques, each with the frame time of the slowest
  afterimage compare scenes/plates.pbrt --frame-time 100 --restarts 40
        as many estimates a frame as fit into 100 ms
  afterimage compare many-lights:10000:7 --techniques 'nee;bsdf' --spp 4
        equal effort: 4 estimates a pixel each
  afterimage compare scenes/moving.pbrt --frames 32 --check
        judge the 32nd frame; exit status 1 if an unbiased technique is found biased
  afterimage compare scenes/cornell.pbrt --motion light:0.005 --look-at 0,1,-4,0,1,0,0,1,0
        the lights slide, seen by another camera")]
pub(super) struct CompareArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Specifications, separated by semicolons [default: all techniques]
    #[arg(long, value_name = "SPEC;SPEC", value_delimiter = None)]
    techniques: Option<String>,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    changes: SceneArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Milliseconds a frame: without reservoirs met within 5 %, else marked; with reservoirs by the
    /// nearest whole effort [default: the slowest technique's at effort 1]
    #[arg(long, value_name = "MS", conflicts_with = "spp", value_parser = parse_positive)]
    frame_time: Option<f64>,
    /// Complete independent estimates a pixel and frame, instead of a frame time
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: Option<u32>,
    /// Judge this frame after a cold start (of a technique without history, in a still scene, the
    /// second: all have one law)
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
    /// Write the error of every frame for all techniques [default: for those that keep history,
    /// where the scene is still]
    #[arg(long, conflicts_with = "accumulate")]
    warmup: bool,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// Folder for what is written [default: out/SCENE]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Begin anew, even where the same comparison was interrupted
    #[arg(long)]
    fresh: bool,
    /// Exit with status 1 if a technique that claims to be unbiased fails the bias test
    #[arg(long)]
    check: bool,
}

impl CompareArgs {
    fn comparison(&self) -> Result<Comparison> {
        let spending = match (self.spp, self.frame_time) {
            (Some(spp), _) => Spending::Estimates(spp),
            (None, Some(ms)) => Spending::Milliseconds(ms),
            (None, None) => Spending::Slowest,
        };
        let reference = self.reference.settings();
        Ok(Comparison {
            spending,
            frames: self.frames,
            accumulate: self.accumulate,
            restarts: self.restarts,
            curve_restarts: self.curve_restarts,
            warmup: self.warmup,
            keep: Some(Keep::beside(&reference, self.fresh)?),
            reference,
        })
    }
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
    let techniques = specs.iter().map(|spec| technique(spec)).collect::<Result<Vec<_>>>()?;
    let comparison = args.comparison()?;
    let size = comparison.reference.size()?;
    let session = args.picture.open_changed(&args.scene, &args.changes, args.filter, size)?;
    let mut compared = comparison.run(&session, &techniques)?;
    compared.results.command = command_line();

    let folder =
        args.out.clone().unwrap_or_else(|| PathBuf::from("out").join(file_name(&session.name)));
    compared.write(&folder)?;
    print(&summary(&compared.results))?;
    note(&format!(
        "wrote {0}; all metrics: {0}/table.md, their meaning: docs/metrics.md",
        folder.display()
    ));
    Ok(status(&compared, args.check))
}

/// Says what went wrong, if anything did.
fn status(compared: &Compared, check: bool) -> Status {
    let rows = &compared.results.rows;
    for row in rows.iter().filter(|row| row.non_finite > 0) {
        note(&format!(
            "warning: `{}` made {} estimates that are not finite",
            row.technique, row.non_finite
        ));
    }
    if compared.results.interrupted {
        note("stopped by the user; the same command goes on");
        return Status::Interrupted;
    }
    let failed = |row: &Row| {
        row.claim == Claim::Unbiased && row.bias.as_ref().is_some_and(|b| b.verdict == "fail")
    };
    if check && rows.iter().any(failed) { Status::CheckFailed } else { Status::Done }
}
