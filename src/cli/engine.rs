//! A scene and the settings that all frames of a run share.

use std::path::Path;
use std::sync::Arc;

use super::args::{BackendArg, FilterArg, PictureArgs, default_depth, default_size};
use super::{interrupt, note};
use crate::frame::{Backend, Frame, FrameLoop, Stage};
use crate::picture::Picture;
use crate::plan::{Filter, Plan, Shot};
use crate::report::CacheKey;
use crate::scene::{self, Loaded};
use crate::techniques::{self, Technique};
use crate::{Error, Result};

/// See the module's head.
#[derive(Debug)]
pub(super) struct Engine {
    /// As given.
    pub scene: String,
    /// For file names.
    pub name: String,
    /// Ready to render.
    pub stage: Stage,
    /// With effort 1.
    pub shot: Shot,
    /// What runs the frames.
    pub backend: Backend,
}

/// Reads a scene file, or makes the scene that a generator's name asks for; warnings go to standard error, once.
pub(super) fn load(scene: &str) -> Result<scene::Scene> {
    let path = Path::new(scene);
    let generator = scene.split(':').next().unwrap_or(scene);
    if !path.exists() && path.extension().is_none() && !generator.contains(std::path::is_separator)
    {
        return scene::generate(scene);
    }
    let Loaded { scene, warnings } = scene::load::load(path)?;
    for warning in warnings {
        note(&format!("warning: {warning}"));
    }
    Ok(scene)
}

/// What runs the frames, opened once a process.
#[cfg(feature = "gpu")]
fn backend(args: &PictureArgs) -> Result<Backend> {
    use std::sync::Mutex;
    static OPEN: Mutex<Option<(Option<String>, Arc<crate::gpu::Gpu>)>> = Mutex::new(None);
    if args.backend == BackendArg::Cpu {
        if args.adapter.is_some() {
            return Err(Error::usage("`--adapter` needs `--backend gpu`"));
        }
        return Ok(Backend::Cpu);
    }
    let mut open = OPEN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some((adapter, gpu)) = &*open
        && *adapter == args.adapter
    {
        return Ok(Backend::Gpu(gpu.clone()));
    }
    let gpu = crate::gpu::Gpu::open(args.adapter.as_deref())?;
    *open = Some((args.adapter.clone(), gpu.clone()));
    Ok(Backend::Gpu(gpu))
}

#[cfg(not(feature = "gpu"))]
fn backend(args: &PictureArgs) -> Result<Backend> {
    match args.backend {
        BackendArg::Cpu if args.adapter.is_none() => Ok(Backend::Cpu),
        _ => Err(Error::usage("this build has no backend `gpu` (feature `gpu`); known: cpu")),
    }
}

impl Engine {
    /// Loads the scene and settles size and depth: the option, else `size`, else the scene's.
    pub(super) fn open(
        scene: &str,
        args: &PictureArgs,
        filter: FilterArg,
        size: Option<[u32; 2]>,
    ) -> Result<Self> {
        let backend = backend(args)?;
        if let Some(threads) = args.threads {
            // Fails only where the pool exists already, with the threads of the same option.
            let _ = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global();
        }
        let loaded = load(scene)?;
        let shot = Shot {
            size: args.size.or(size).unwrap_or_else(|| default_size(loaded.film)),
            depth: args.depth.unwrap_or_else(|| default_depth(loaded.depth)),
            filter: match filter {
                FilterArg::Point => Filter::Point,
                FilterArg::Box => Filter::Box,
            },
            run: args.seed,
            effort: 1.0,
            fps: args.fps,
        };
        let name = loaded.name.clone();
        Ok(Self { scene: scene.to_string(), name, stage: Stage::new(loaded)?, shot, backend })
    }

    /// The same settings on the scene as it stands in frame `index`, without motion.
    pub(super) fn frozen(&self, index: u32) -> Result<Self> {
        let scene = self.stage.scene();
        if !self.stage.facts().moves() {
            return Ok(self.with_stage(self.stage.clone()));
        }
        let time = scene.time[0] + index as f32 / self.shot.fps as f32;
        self.with_scene(scene.at(time))
    }

    /// The same settings on another scene.
    pub(super) fn with_scene(&self, scene: scene::Scene) -> Result<Self> {
        Ok(self.with_stage(Stage::new(scene)?))
    }

    fn with_stage(&self, stage: Stage) -> Self {
        Self {
            scene: self.scene.clone(),
            name: self.name.clone(),
            stage,
            shot: self.shot,
            backend: self.backend.clone(),
        }
    }

    /// What a technique will run here.
    pub(super) fn plan(&self, technique: &dyn Technique) -> Plan {
        technique.plan(self.stage.facts(), &self.shot)
    }

    /// A technique before its first frame.
    pub(super) fn start(
        &self,
        technique: &Arc<dyn Technique>,
        effort: u32,
        seed: u64,
    ) -> Result<FrameLoop> {
        let shot = Shot { effort: effort as f32, run: seed, ..self.shot };
        let frames = FrameLoop::with_backend(technique.clone(), &self.stage, shot, &self.backend)?;
        if self.device().is_some() && frames.runs_on().is_none() {
            let spec = technique.spec();
            note(&format!("`{spec}` has no kernels for a graphics processor: it runs on the CPU"));
        }
        Ok(frames)
    }

    /// The graphics processor that frames were asked to run on.
    pub(super) fn device(&self) -> Option<String> {
        match &self.backend {
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => Some(gpu.info().to_string()),
            Backend::Cpu => None,
        }
    }

    /// As [`Engine::start`], on the CPU whatever runs the frames: for references, which all backends share.
    pub(super) fn start_reference(
        &self,
        technique: &Arc<dyn Technique>,
        effort: u32,
        seed: u64,
    ) -> Result<FrameLoop> {
        let shot = Shot { effort: effort as f32, run: seed, ..self.shot };
        FrameLoop::new(technique.clone(), &self.stage, shot)
    }

    /// The key of everything that the scene and the settings, but not the run, say about a picture.
    pub(super) fn key(&self, extra: &str) -> CacheKey {
        CacheKey::of(|hasher| {
            super::fingerprint::feed(self.stage.scene(), hasher);
            let Shot { size, depth, filter, run: _, effort: _, fps: _ } = self.shot;
            let text = format!("{} {size:?} {depth} {filter:?} {extra}", env!("CARGO_PKG_VERSION"));
            hasher.write(text.as_bytes());
        })
    }
}

/// The technique of a specification, ready to be shared by loops.
pub(super) fn technique(spec: &str) -> Result<Arc<dyn Technique>> {
    techniques::parse(spec).map(Arc::from)
}

/// Whether what was in earlier frames changes later ones.
pub(super) fn keeps_history(plan: &Plan) -> bool {
    plan.keeps_history()
}

/// Renders the next frame, unless the user asked to stop.
pub(super) fn next(frames: &mut FrameLoop) -> Result<Frame<'_>> {
    interrupt::check()?;
    frames.render()
}

/// Adds a frame's milliseconds of each pass to those of other frames.
pub(super) fn add_times(passes: &mut Vec<(&'static str, Vec<f64>)>, frame: &Frame<'_>) {
    for &(name, ms) in frame.passes {
        match passes.iter_mut().find(|(known, _)| *known == name) {
            Some((_, times)) => times.push(ms),
            None => passes.push((name, vec![ms])),
        }
    }
}

/// The weighted mean of pictures of one size, summed in f64.
#[derive(Debug)]
pub(super) struct Mean {
    size: [u32; 2],
    weight: f64,
    sum: Vec<glam::DVec3>,
}

impl Mean {
    pub(super) fn new(size: [u32; 2]) -> Self {
        Self {
            size,
            weight: 0.0,
            sum: vec![glam::DVec3::ZERO; size[0] as usize * size[1] as usize],
        }
    }

    /// Adds a picture that is itself the mean of `weight` estimates.
    pub(super) fn add(&mut self, picture: &Picture, weight: u32) {
        let weight = f64::from(weight);
        self.weight += weight;
        for (sum, pixel) in self.sum.iter_mut().zip(&picture.pixels) {
            *sum += weight * pixel.as_dvec3();
        }
    }

    /// The mean; black without any picture.
    pub(super) fn picture(&self) -> Picture {
        let share = if self.weight > 0.0 { self.weight.recip() } else { 0.0 };
        Picture::new(
            self.size[0],
            self.size[1],
            self.sum.iter().map(|s| (*s * share).as_vec3()).collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_weigh_pictures_by_their_estimates() {
        let mut mean = Mean::new([1, 1]);
        assert_eq!(mean.picture().pixels[0], glam::Vec3::ZERO);
        mean.add(&Picture::filled(1, 1, glam::Vec3::splat(1.0)), 3);
        mean.add(&Picture::filled(1, 1, glam::Vec3::splat(5.0)), 1);
        assert_eq!(mean.picture().pixels[0], glam::Vec3::splat(2.0));
    }
}
