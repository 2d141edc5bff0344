//! `list`: what exists.

use std::fmt::Write as _;
use std::path::Path;

use clap::{Args, ValueEnum};

use super::{Status, print};
use crate::{Result, techniques};

/// List techniques, scenes or adapters
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  afterimage list techniques")]
pub(super) struct ListArgs {
    /// What to list
    #[arg(value_enum)]
    what: What,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum What {
    /// What `--technique` and `--techniques` take, with parameters and their defaults
    Techniques,
    /// Scene files in ./scenes, and generators
    Scenes,
    /// What `--backend gpu` could run on
    Adapters,
}

pub(super) fn run(args: &ListArgs) -> Result<Status> {
    let text = match args.what {
        What::Techniques => {
            techniques::REGISTRY.iter().map(technique).collect::<Vec<_>>().join("\n")
        }
        What::Scenes => scenes()?,
        What::Adapters => adapters(),
    };
    print(&text)?;
    Ok(Status::Done)
}

#[cfg(feature = "gpu")]
fn adapters() -> String {
    let all = crate::gpu::adapters();
    if all.is_empty() {
        return "none: no Vulkan, Metal or Dx12 driver was found (on Debian, mesa-vulkan-drivers brings one in software)\n"
            .to_string();
    }
    table(all.into_iter().map(|a| (a.to_string(), format!("{}, {}", a.kind, a.driver))))
}

#[cfg(not(feature = "gpu"))]
fn adapters() -> String {
    "none: this build has no GPU backend (feature `gpu`); frames run on the CPU\n".to_string()
}

/// A technique with its parameters.
fn technique(entry: &techniques::Entry) -> String {
    let parameters = (entry.parameters)().into_iter().map(|p| {
        let default = if p.default.is_empty() { String::new() } else { format!("={}", p.default) };
        (format!("  {}{default}", p.key), format!("{}; {}", p.about, p.allowed))
    });
    format!("{}: {}\n{}", entry.name, entry.about, table(parameters))
}

fn scenes() -> Result<String> {
    let folder = Path::new("scenes");
    let mut rows = Vec::new();
    if let Ok(entries) = std::fs::read_dir(folder) {
        for entry in entries.filter_map(std::result::Result::ok) {
            let path = entry.path();
            let known =
                path.extension().is_some_and(|e| ["pbrt", "gltf", "glb"].iter().any(|k| e == *k));
            if known {
                rows.push((path.display().to_string(), first_comment(&path)));
            }
        }
    }
    rows.sort();
    rows.push((
        "many-lights:N[:SEED]".to_string(),
        "made in memory: N emitters of very different size and power".to_string(),
    ));
    Ok(table(rows.into_iter()))
}

/// The first line of a pbrt file's header comment.
fn first_comment(path: &Path) -> String {
    let Ok(text) = std::fs::read_to_string(path) else { return String::new() };
    let comment = text
        .lines()
        .find_map(|l| l.strip_prefix('#').map(|c| c.trim().to_string()).filter(|c| !c.is_empty()));
    comment.unwrap_or_default()
}

fn table(rows: impl Iterator<Item = (String, String)>) -> String {
    let rows: Vec<(String, String)> = rows.collect();
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    rows.iter().fold(String::new(), |mut text, (name, about)| {
        let _ = writeln!(text, "{}", format!("{name:width$}  {about}").trim_end());
        text
    })
}
