//! Options that several commands share, and how their values are read.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// How pictures are made; the same for every technique and reference of a run.
#[derive(Args, Clone, Debug)]
pub(super) struct PictureArgs {
    /// Picture size in pixels [default: the film's shape, longer side 256]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Path segments from the camera: 1 is emission seen directly, 2 direct light [default: the scene's, at most 8]
    #[arg(long, value_name = "D", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub depth: Option<u32>,
    /// Frames a second: frame i shows time start + i/FPS, up to the scene's end
    #[arg(long, value_name = "FPS", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub fps: u32,
    /// Seed of the run; all others derive from it
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// What runs the frames
    #[arg(long, value_enum, default_value_t = BackendArg::Cpu)]
    pub backend: BackendArg,
    /// With --backend gpu, the first adapter whose name contains this, API in brackets: see `afterimage list adapters`
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
    /// Threads [default: one a logical core]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
}

/// Where references come from.
#[derive(Args, Clone, Debug)]
pub(super) struct ReferenceArgs {
    /// Compare with this picture instead of making a reference
    #[arg(long, value_name = "FILE.exr")]
    pub reference: Option<PathBuf>,
    /// Stop making the reference after so many seconds; its remaining noise is stated
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = parse_positive)]
    pub reference_time: f64,
    /// Folder of references [default: `$XDG_CACHE_HOME/afterimage` or `~/.cache/afterimage`]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
}

/// The positions of primary rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FilterArg {
    /// Through pixel centres, the same in every frame
    Point,
    /// Jittered over the pixel, anew in every frame
    Box,
}

impl FilterArg {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Box => "box",
        }
    }
}

/// Where frames are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum BackendArg {
    /// All cores, or --threads
    Cpu,
    /// The graphics processor; references stay on the CPU
    Gpu,
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let wrong = || {
        format!(
            "`{text}` is no size; give WIDTHxHEIGHT in pixels, each from 1 to 16384, as in 640x360"
        )
    };
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=16384).contains(n));
    Ok([side(width).ok_or_else(wrong)?, side(height).ok_or_else(wrong)?])
}

/// A pixel, `X,Y` from the upper left corner.
pub(super) fn parse_pixel(text: &str) -> Result<[u32; 2], String> {
    let wrong =
        || format!("`{text}` is no pixel; give X,Y from the upper left corner, as in 120,64");
    let (x, y) = text.split_once(',').ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse::<u32>().map_err(|_| wrong());
    Ok([number(x)?, number(y)?])
}

/// A finite number above zero.
pub(super) fn parse_positive(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|v| v.is_finite() && *v > 0.0)
        .ok_or_else(|| format!("`{text}` must be a number above 0"))
}

/// Frames, rising. (A type of its own: an option of type `Vec` would be one that repeats.)
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Ages(pub Vec<u32>);

/// Frames from 1, separated by commas.
pub(super) fn parse_ages(text: &str) -> Result<Ages, String> {
    let wrong = || format!("`{text}` must be frames from 1 to 100000, as in 1,5,20");
    let mut ages = text
        .split(',')
        .map(|n| n.trim().parse::<u32>().ok().filter(|n| (1..=100_000).contains(n)))
        .collect::<Option<Vec<u32>>>()
        .ok_or_else(wrong)?;
    ages.sort_unstable();
    ages.dedup();
    Ok(Ages(ages))
}

/// A share in percent.
pub(super) fn parse_percent(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|v| *v > 0.0 && *v < 100.0)
        .ok_or_else(|| format!("`{text}` must be a number of percent above 0 and below 100"))
}

/// Specifications separated by `;`. Commas separate parameters inside one, so they cannot part two.
pub(super) fn split_specs(text: &str) -> Vec<String> {
    text.split(';').map(str::trim).filter(|s| !s.is_empty()).map(String::from).collect()
}

/// The film's shape with its longer side 256.
pub(super) fn default_size(film: [u32; 2]) -> [u32; 2] {
    let longer = f64::from(film[0].max(film[1]).max(1));
    film.map(|side| ((f64::from(side) * 256.0 / longer).round() as u32).max(1))
}

/// The scene's own depth, at most 8.
pub(super) fn default_depth(scene: u32) -> u32 {
    scene.clamp(1, 8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_pixels() {
        assert_eq!(parse_size("640x360").unwrap(), [640, 360]);
        for wrong in ["640", "0x3", "3x", "x", "-1x5", "99999x1", "3x4x5"] {
            assert!(parse_size(wrong).unwrap_err().contains("WIDTHxHEIGHT"), "{wrong}");
        }
        assert_eq!(parse_pixel("3, 4").unwrap(), [3, 4]);
        assert!(parse_pixel("3").is_err() && parse_pixel("3,-1").is_err());
        for wrong in ["0", "-1", "nan", "inf", "x"] {
            assert!(parse_positive(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn ages_are_sorted_and_percents_are_percents() {
        assert_eq!(parse_ages("20, 1,5,5").unwrap(), Ages(vec![1, 5, 20]));
        for wrong in ["", "0", "1,,2", "1;2", "-1", "1000000"] {
            assert!(parse_ages(wrong).unwrap_err().contains("1,5,20"), "{wrong}");
        }
        for wrong in ["0", "-1", "100", "nan", "x"] {
            assert!(parse_percent(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn specs_split_at_semicolons_only() {
        assert_eq!(
            split_specs("nee; restir-pt:mutations=5,cap=50;"),
            ["nee", "restir-pt:mutations=5,cap=50"]
        );
        assert!(split_specs(" ; ").is_empty());
    }

    #[test]
    fn defaults_follow_the_film() {
        assert_eq!(default_size([1280, 720]), [256, 144]);
        assert_eq!(default_size([100, 400]), [64, 256]);
        assert_eq!(default_size([10000, 1]), [256, 1]);
        assert_eq!(default_depth(66), 8);
        assert_eq!(default_depth(6), 6);
    }
}
