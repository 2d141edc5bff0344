//! `diff`: the metrics of one picture against another.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;

use super::{Status, print};
use crate::experiment::figures;
use crate::picture::Picture;
use crate::report::{METRICS, figure, read_exr};
use crate::{Error, Result};

/// Metrics of picture A against picture B
///
/// B is the reference. A layer named `emission` (directly visible emission, as `render` writes it)
/// is taken out of its picture first.
#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  afterimage diff out/cornell/nee.exr out/cornell/reference.exr --json"
)]
pub(super) struct DiffArgs {
    /// The picture that is judged
    #[arg(value_name = "A.exr")]
    a: PathBuf,
    /// What it is compared with
    #[arg(value_name = "B.exr")]
    b: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &DiffArgs) -> Result<Status> {
    let [a, b] = [read(&args.a)?, read(&args.b)?];
    if [a.width, a.height] != [b.width, b.height] {
        let message = format!(
            "is {}x{}, but {} is {}x{}: both must have one size",
            a.width,
            a.height,
            args.b.display(),
            b.width,
            b.height
        );
        return Err(Error::invalid(message).with_path(&args.a));
    }
    let mut found = figures::of_picture(&a, &b, None)?;
    let ratio = a.mean_luminance() / b.mean_luminance();
    if ratio.is_finite() {
        found.push(("mean_ratio", ratio));
    }
    let order = |name: &str| METRICS.iter().position(|m| *m == name).unwrap_or(METRICS.len());
    found.sort_by_key(|(name, _)| order(name));
    let text = if args.json {
        let map: serde_json::Map<String, serde_json::Value> =
            found.iter().map(|(name, value)| ((*name).to_string(), (*value).into())).collect();
        format!("{}\n", serde_json::Value::Object(map))
    } else {
        found.iter().fold(String::new(), |mut text, (name, value)| {
            let _ = writeln!(text, "{name:16} {}", figure(*value));
            text
        })
    };
    print(&text)?;
    Ok(Status::Done)
}

/// Reflected light only, where the file tells emission apart.
fn read(path: &std::path::Path) -> Result<Picture> {
    let mut file = read_exr(path)?;
    if let Some(emission) = &file.emission {
        if emission.pixels.len() != file.picture.pixels.len() {
            return Err(Error::invalid("its emission layer has another size than its picture")
                .with_path(path));
        }
        for (pixel, emitted) in file.picture.pixels.iter_mut().zip(&emission.pixels) {
            *pixel -= *emitted;
        }
    }
    if !file.picture.pixels.iter().all(|p| p.is_finite()) {
        return Err(Error::invalid("it has pixels that are not finite").with_path(path));
    }
    Ok(file.picture)
}
