//! Options that several commands share, and how their values are read.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::Vec3;

use super::host::terminal;
use crate::experiment::{LookAt, ReferenceSettings, SceneMotion, Session, SessionSettings};
use crate::frame::Backend;
use crate::plan::Filter;
use crate::techniques::Moving;
use crate::{Error, Result};

/// How pictures are made; the same for every technique and reference of a run.
#[derive(Args, Clone, Debug)]
pub(super) struct PictureArgs {
    /// Picture size in pixels [default: the film's shape, longer side 256]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Path segments from the camera: 1 is emission seen directly, 2 direct light [default: the
    /// scene's, at most 8]
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
    /// With --backend gpu, the first adapter whose name contains this, API in brackets: see
    /// `afterimage list adapters`
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
    /// Threads [default: one a logical core]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
}

impl PictureArgs {
    /// The scene with these settings; `size` is for where none is given.
    ///
    /// # Errors
    /// As [`Session::open`]; a backend that is not there.
    pub(super) fn open(
        &self,
        scene: &str,
        filter: FilterArg,
        size: Option<[u32; 2]>,
    ) -> Result<Session> {
        self.open_changed(scene, &SceneArgs::default(), filter, size)
    }

    /// As [`PictureArgs::open`], the scene changed.
    ///
    /// # Errors
    /// As [`PictureArgs::open`]; a motion of something that the scene has not.
    pub(super) fn open_changed(
        &self,
        scene: &str,
        changes: &SceneArgs,
        filter: FilterArg,
        size: Option<[u32; 2]>,
    ) -> Result<Session> {
        let backend = self.backend()?;
        if let Some(threads) = self.threads {
            // This fails only where the pool exists already, with the threads of the same option.
            let _ = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        }
        let settings = SessionSettings {
            size: self.size.or(size),
            depth: self.depth,
            filter: match filter {
                FilterArg::Point => Filter::Point,
                FilterArg::Box => Filter::Box,
            },
            fps: self.fps,
            seed: self.seed,
            backend,
            look_at: changes.look_at,
            motion: changes.motion,
        };
        Session::open(scene, &settings, terminal())
    }

    /// What runs the frames, opened once a process.
    #[cfg(feature = "gpu")]
    fn backend(&self) -> Result<Backend> {
        use std::sync::{Arc, Mutex, PoisonError};
        static OPEN: Mutex<Option<(Option<String>, Arc<crate::gpu::Gpu>)>> = Mutex::new(None);
        if self.backend == BackendArg::Cpu {
            if self.adapter.is_some() {
                return Err(Error::usage("`--adapter` needs `--backend gpu`"));
            }
            return Ok(Backend::Cpu);
        }
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((adapter, gpu)) = &*open
            && *adapter == self.adapter
        {
            return Ok(Backend::Gpu(gpu.clone()));
        }
        let gpu = crate::gpu::Gpu::open(self.adapter.as_deref())?;
        *open = Some((self.adapter.clone(), gpu.clone()));
        Ok(Backend::Gpu(gpu))
    }

    #[cfg(not(feature = "gpu"))]
    fn backend(&self) -> Result<Backend> {
        match self.backend {
            BackendArg::Cpu if self.adapter.is_none() => Ok(Backend::Cpu),
            _ => Err(Error::usage("this build has no backend `gpu` (feature `gpu`); known: cpu")),
        }
    }
}

/// What is changed in a scene before anything is rendered.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct SceneArgs {
    /// Let only this move: camera, light, occluder or all. What the file does not move slides by
    /// SHARE of the scene's diagonal a frame, the camera to its right, else along x [default of
    /// SHARE: 0.001]
    #[arg(long, value_name = "WHAT[:SHARE]", value_parser = parse_motion)]
    pub motion: Option<SceneMotion>,
    /// A camera in place of the file's, which keeps its angle: eye, target, up vector
    #[arg(long, value_name = "EX,EY,EZ,TX,TY,TZ,UX,UY,UZ", value_parser = parse_look_at, allow_hyphen_values = true)]
    pub look_at: Option<LookAt>,
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

impl ReferenceArgs {
    pub(super) fn settings(&self) -> ReferenceSettings {
        ReferenceSettings {
            file: self.reference.clone(),
            seconds: self.reference_time,
            cache: self.cache.clone(),
        }
    }
}

/// The positions of primary rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FilterArg {
    /// Through pixel centres, the same in every frame
    Point,
    /// Jittered over the pixel, anew in every frame
    Box,
}

/// Where frames are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum BackendArg {
    /// All cores, or --threads
    Cpu,
    /// The graphics processor; references stay on the CPU
    Gpu,
}

fn parse_size(text: &str) -> std::result::Result<[u32; 2], String> {
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
pub(super) fn parse_pixel(text: &str) -> std::result::Result<[u32; 2], String> {
    let wrong =
        || format!("`{text}` is no pixel; give X,Y from the upper left corner, as in 120,64");
    let (x, y) = text.split_once(',').ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse::<u32>().map_err(|_| wrong());
    Ok([number(x)?, number(y)?])
}

/// What moves, and how fast.
pub(super) fn parse_motion(text: &str) -> std::result::Result<SceneMotion, String> {
    let wrong = || {
        format!(
            "`{text}` is no motion; give camera, light, occluder or all, and a share of the scene's diagonal a frame in (0, {}] if \
             it shall not be {}, as in light:0.01",
            SceneMotion::MOST,
            SceneMotion::DEFAULT_SHARE
        )
    };
    let (what, share) = match text.split_once(':') {
        Some((what, share)) => (what, Some(share.parse().map_err(|_| wrong())?)),
        None => (text, None),
    };
    let moving = match what {
        "camera" => Moving::Camera,
        "light" => Moving::Light,
        "occluder" => Moving::Occluder,
        "all" => Moving::All,
        _ => return Err(wrong()),
    };
    SceneMotion::new(moving, share).map_err(|_| wrong())
}

/// Eye, target and up vector.
pub(super) fn parse_look_at(text: &str) -> std::result::Result<LookAt, String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|numbers| <[f32; 9]>::try_from(numbers).ok());
    let Some([ex, ey, ez, tx, ty, tz, ux, uy, uz]) = numbers else {
        return Err(format!(
            "`{text}` is no view; give nine numbers, eye, target and up vector, as in 0,1,-5,0,1,0,0,1,0"
        ));
    };
    LookAt::new(Vec3::new(ex, ey, ez), Vec3::new(tx, ty, tz), Vec3::new(ux, uy, uz))
        .map_err(|error| error.to_string())
}

/// A finite number above zero.
pub(super) fn parse_positive(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|v| v.is_finite() && *v > 0.0)
        .ok_or_else(|| format!("`{text}` must be a number above 0"))
}

/// Frames, rising. (A type of its own: an option of type `Vec` would be one that repeats.)
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Ages(pub Vec<u32>);

/// Frames from 1, separated by commas.
pub(super) fn parse_ages(text: &str) -> std::result::Result<Ages, String> {
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
pub(super) fn parse_percent(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|v| *v > 0.0 && *v < 100.0)
        .ok_or_else(|| format!("`{text}` must be a number of percent above 0 and below 100"))
}

/// Specifications separated by `;`. Commas separate parameters inside one, so they cannot part two.
pub(super) fn split_specs(text: &str) -> Vec<String> {
    text.split(';').map(str::trim).filter(|s| !s.is_empty()).map(String::from).collect()
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
    fn motions_and_views() {
        let motion = |moving, share| SceneMotion::new(moving, share).unwrap();
        assert_eq!(parse_motion("camera"), Ok(motion(Moving::Camera, None)));
        assert_eq!(parse_motion("all:0.1"), Ok(motion(Moving::All, Some(0.1))));
        for wrong in
            ["", "still", "light:", "light:0", "light:0.2", "light:nan", "light:-0.1", "x:0.1"]
        {
            let error = parse_motion(wrong).unwrap_err();
            assert!(error.contains("(0, 0.1]") && error.contains("occluder"), "{error}");
        }
        assert!(parse_look_at("-1, 2,3,4,5,6,0,1,0").is_ok());
        for (wrong, why) in [
            ("", "nine"),
            ("1,2,3", "nine"),
            ("1,2,3,4,5,6,7,8,9,10", "nine"),
            ("1,2,3,4,5,6,0,one,0", "nine"),
            ("1,2,3,4,5,nan,0,1,0", "finite"),
            ("1,2,3,1,2,3,0,1,0", "target"),
            ("0,0,0,0,5,0,0,1,0", "up vector"),
        ] {
            let error = parse_look_at(wrong).unwrap_err();
            assert!(error.contains(why), "{wrong}: {error}");
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
}
