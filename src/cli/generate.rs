//! `generate`: the text of a generated scene.

use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;

use super::{Status, note, print};
use crate::report::write_atomic;
use crate::{Result, scene};

/// Write a generated scene as pbrt text
///
/// Every command takes the same name in place of a file, without writing one: `afterimage compare
/// many-lights:1000`.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  afterimage generate many-lights:1000:7 --out lights.pbrt")]
pub(super) struct GenerateArgs {
    /// NAME:N[:SEED], such as many-lights:1000
    #[arg(value_name = "GENERATOR")]
    generator: String,
    /// The file to write [default: standard output]
    #[arg(long, value_name = "FILE.pbrt")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &GenerateArgs) -> Result<Status> {
    let text = scene::generate_pbrt(&args.generator)?;
    match &args.out {
        Some(path) => {
            write_atomic(path, |writer| writer.write_all(text.as_bytes()))?;
            note(&format!("wrote {}", path.display()));
        }
        None => print(&text)?,
    }
    Ok(Status::Done)
}
