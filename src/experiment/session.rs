//! A scene and the settings that all frames of an experiment share.

use std::path::Path;
use std::sync::Arc;

use super::fingerprint;
use super::host::{Host, Silent};
use super::look_at::LookAt;
use super::moving::SceneMotion;
use crate::error::ErrorKind;
use crate::frame::{Backend, Frame, FrameLoop, Stage};
use crate::picture::Picture;
use crate::plan::{Filter, Plan, Shot};
use crate::report::CacheKey;
use crate::scene::{self, Loaded, Scene};
use crate::techniques::{self, Technique};
use crate::{Error, Result};

/// How pictures are made: the same for every technique and reference of an experiment.
#[derive(Clone, Debug)]
pub struct SessionSettings {
    /// Width and height in pixels; `None`: the film's shape, its longer side 256.
    pub size: Option<[u32; 2]>,
    /// Path segments from the camera, 1 being emission that is seen directly; `None`: the scene's,
    /// at most 8.
    pub depth: Option<u32>,
    /// Positions of primary rays.
    pub filter: Filter,
    /// Frames a second: frame i shows time start + i / fps, up to the scene's end.
    pub fps: u32,
    /// Seed of the run, from which all others derive.
    pub seed: u64,
    /// What runs the frames; references are always made on the CPU.
    pub backend: Backend,
    /// A camera in place of the scene's, which keeps its angle.
    pub look_at: Option<LookAt>,
    /// What alone moves; `None`: what the scene moves.
    pub motion: Option<SceneMotion>,
}

impl Default for SessionSettings {
    /// 256 pixels across, the scene's depth, the point filter, 30 frames a second, seed 1, on the
    /// CPU, and the scene as it is.
    fn default() -> Self {
        Self {
            size: None,
            depth: None,
            filter: Filter::Point,
            fps: 30,
            seed: 1,
            backend: Backend::Cpu,
            look_at: None,
            motion: None,
        }
    }
}

/// A scene that is ready to render, what all frames share, and the host that hears of the work.
#[derive(Clone, Debug)]
pub struct Session {
    /// The scene as it was given: a file's path or a generator's name.
    pub scene: String,
    /// The scene's own name, for names of files.
    pub name: String,
    /// The scene, ready to render.
    pub stage: Stage,
    /// What is rendered, with effort 1. Its run is the seed that all others derive from.
    pub shot: Shot,
    /// What runs the frames.
    pub backend: Backend,
    host: Arc<dyn Host>,
}

/// Reads a scene file, or makes the scene that a generator's name stands for. The host is told of
/// the loader's warnings.
///
/// # Errors
/// A file that cannot be read or holds no scene; a generator that does not exist.
pub fn load_scene(scene: &str, host: &dyn Host) -> Result<Scene> {
    let path = Path::new(scene);
    let generator = scene.split(':').next().unwrap_or(scene);
    if !path.exists() && path.extension().is_none() && !generator.contains(std::path::is_separator)
    {
        return scene::generate(scene);
    }
    let Loaded { scene, warnings } = scene::load::load(path)?;
    for warning in warnings {
        host.note(&format!("warning: {warning}"));
    }
    Ok(scene)
}

impl Session {
    /// A session on a scene that was built in code, without a host.
    ///
    /// # Errors
    /// Whatever [`Stage::new`] and [`Shot::validate`] refuse; a motion of something that the scene
    /// has not.
    pub fn new(scene: Scene, settings: &SessionSettings) -> Result<Self> {
        Self::with_host(scene, settings, Arc::new(Silent))
    }

    /// A session on a scene file or a generator such as `many-lights:1000`.
    ///
    /// # Errors
    /// As [`load_scene`] and [`Session::new`].
    pub fn open(scene: &str, settings: &SessionSettings, host: Arc<dyn Host>) -> Result<Self> {
        let loaded = load_scene(scene, &*host)?;
        let depth = loaded.depth;
        let session = Self { scene: scene.to_string(), ..Self::with_host(loaded, settings, host)? };
        if settings.depth.is_none() && session.shot.depth < depth {
            let used = session.shot.depth;
            session.host.note(&format!(
                "warning: {scene}: paths end after {used} segments, the file asks for {depth}; `depth` sets another limit"
            ));
        }
        Ok(session)
    }

    /// A session whose host hears of progress and may stop it.
    ///
    /// # Errors
    /// As [`Session::new`].
    pub fn with_host(
        mut scene: Scene,
        settings: &SessionSettings,
        host: Arc<dyn Host>,
    ) -> Result<Self> {
        let SessionSettings { size, depth, filter, fps, seed, backend, look_at, motion } =
            settings.clone();
        if let Some(look_at) = look_at {
            scene.camera = look_at.camera(&scene.camera, scene.time[0]);
        }
        if let Some(motion) = motion {
            // A rate of no frames is refused below, where the scene is not at fault.
            scene = motion.apply(&scene, fps.max(1), |text| host.note(text))?;
        }
        let shot = Shot {
            size: size.unwrap_or_else(|| default_size(scene.film)),
            depth: depth.unwrap_or_else(|| default_depth(scene.depth)),
            filter,
            run: seed,
            effort: 1.0,
            fps,
        };
        shot.validate()?;
        let name = scene.name.clone();
        Ok(Self { scene: name.clone(), name, stage: Stage::new(scene)?, shot, backend, host })
    }

    /// The program that hears of the work.
    #[must_use]
    pub fn host(&self) -> &dyn Host {
        &*self.host
    }

    /// The same with another program that hears of the work.
    pub(super) fn heard_by(&self, host: impl FnOnce(Arc<dyn Host>) -> Arc<dyn Host>) -> Self {
        Self { host: host(self.host.clone()), ..self.clone() }
    }

    /// The same settings on the scene as it stands in frame `index`, without motion.
    ///
    /// # Errors
    /// As [`Session::new`].
    pub fn frozen(&self, index: u32) -> Result<Self> {
        let scene = self.stage.scene();
        if !self.stage.facts().moves() {
            return Ok(self.clone());
        }
        let time = scene.time[0] + index as f32 / self.shot.fps as f32;
        self.with_scene(scene.at(time))
    }

    /// The same settings on another scene.
    ///
    /// # Errors
    /// As [`Session::new`].
    pub fn with_scene(&self, scene: Scene) -> Result<Self> {
        Ok(Self { stage: Stage::new(scene)?, ..self.clone() })
    }

    /// What a technique will run here.
    #[must_use]
    pub fn plan(&self, technique: &dyn Technique) -> Plan {
        technique.plan(self.stage.facts(), &self.shot)
    }

    /// A technique before its first frame. The host is told where it runs on the CPU although a
    /// graphics processor was chosen.
    ///
    /// # Errors
    /// As [`FrameLoop::with_backend`].
    pub fn start(
        &self,
        technique: &Arc<dyn Technique>,
        effort: f32,
        seed: u64,
    ) -> Result<FrameLoop> {
        let shot = Shot { effort, run: seed, ..self.shot };
        let frames = FrameLoop::with_backend(technique.clone(), &self.stage, shot, &self.backend)?;
        if self.device().is_some() && frames.runs_on().is_none() {
            let spec = technique.spec();
            self.host.note(&format!(
                "`{spec}` has no kernels for a graphics processor: it runs on the CPU"
            ));
        }
        Ok(frames)
    }

    /// As [`Session::start`], on the CPU whatever runs the frames: for references, which all
    /// backends share.
    pub(super) fn start_reference(
        &self,
        technique: &Arc<dyn Technique>,
        effort: f32,
        seed: u64,
    ) -> Result<FrameLoop> {
        let shot = Shot { effort, run: seed, ..self.shot };
        FrameLoop::new(technique.clone(), &self.stage, shot)
    }

    /// Renders the next frame of a loop, unless the host has stopped the work.
    ///
    /// # Errors
    /// An interruption; else as [`FrameLoop::render`].
    pub fn next<'a>(&self, frames: &'a mut FrameLoop) -> Result<Frame<'a>> {
        self.check()?;
        frames.render()
    }

    /// Gives an error where the host has stopped the work.
    ///
    /// # Errors
    /// An interruption ([`Error::is_interrupted`]).
    pub fn check(&self) -> Result<()> {
        if self.host.stopped() {
            return Err(Error::new(ErrorKind::Interrupted, "stopped by the user"));
        }
        Ok(())
    }

    /// The graphics processor that frames were asked to run on.
    #[must_use]
    pub fn device(&self) -> Option<String> {
        match &self.backend {
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => Some(gpu.info().to_string()),
            Backend::Cpu => None,
        }
    }

    /// The key of everything that the scene and the settings, but not the run, say about a picture.
    pub(super) fn key(&self, extra: &str) -> CacheKey {
        CacheKey::of(|hasher| {
            fingerprint::feed(self.stage.scene(), hasher);
            let Shot { size, depth, filter, run: _, effort: _, fps: _ } = self.shot;
            let text = format!("{} {size:?} {depth} {filter:?} {extra}", env!("CARGO_PKG_VERSION"));
            hasher.write(text.as_bytes());
        })
    }
}

/// The registered technique of a specification, ready to be shared by loops.
///
/// # Errors
/// As [`techniques::parse`].
pub fn technique(spec: &str) -> Result<Arc<dyn Technique>> {
    techniques::parse(spec).map(Arc::from)
}

/// The film's shape with its longer side 256.
fn default_size(film: [u32; 2]) -> [u32; 2] {
    let longer = f64::from(film[0].max(film[1]).max(1));
    film.map(|side| ((f64::from(side) * 256.0 / longer).round() as u32).max(1))
}

/// The scene's own depth, at most 8.
fn default_depth(scene: u32) -> u32 {
    scene.clamp(1, 8)
}

/// Adds a frame's milliseconds of each pass to those of other frames.
pub(crate) fn add_times(passes: &mut Vec<(&'static str, Vec<f64>)>, frame: &Frame<'_>) {
    for &(name, ms) in frame.passes {
        match passes.iter_mut().find(|(known, _)| *known == name) {
            Some((_, times)) => times.push(ms),
            None => passes.push((name, vec![ms])),
        }
    }
}

/// The weighted mean of pictures of one size, summed in f64.
#[derive(Debug)]
pub(crate) struct Mean {
    size: [u32; 2],
    weight: f64,
    sum: Vec<glam::DVec3>,
}

impl Mean {
    pub(crate) fn new(size: [u32; 2]) -> Self {
        Self {
            size,
            weight: 0.0,
            sum: vec![glam::DVec3::ZERO; size[0] as usize * size[1] as usize],
        }
    }

    /// Adds a picture that is itself the mean of `weight` estimates.
    pub(crate) fn add(&mut self, picture: &Picture, weight: u32) {
        let weight = f64::from(weight);
        self.weight += weight;
        for (sum, pixel) in self.sum.iter_mut().zip(&picture.pixels) {
            *sum += weight * pixel.as_dvec3();
        }
    }

    /// The mean; black without any picture.
    pub(crate) fn picture(&self) -> Picture {
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

    #[test]
    fn defaults_follow_the_film() {
        assert_eq!(default_size([1280, 720]), [256, 144]);
        assert_eq!(default_size([100, 400]), [64, 256]);
        assert_eq!(default_size([10000, 1]), [256, 1]);
        assert_eq!(default_depth(66), 8);
        assert_eq!(default_depth(6), 6);
    }
}
