//! The loop over frames: the scene's time, buffers and their history, the order of passes. It knows
//! no technique.
//!
//! ```text
//! Stage (scene, facts, first world) ──► FrameLoop::new(technique, stage, shot) ──► render() ──► Frame (picture, layers, counters, times)
//! ```
//!
//! A pass writes only its own pixels, tiles or items and reads only what earlier passes wrote, so
//! the result has the same bits for any number of threads. Threads are those of the rayon pool that
//! the caller installs.

mod cpu;
#[expect(clippy::module_inception, reason = "the file of the type `Frame`")]
mod frame;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
#[cfg(not(feature = "gpu"))]
#[path = "no_gpu.rs"]
mod gpu;
#[cfg(all(test, feature = "gpu"))]
mod gpu_tests;
mod guides;
mod hits;
mod runner;
mod stage;

use std::sync::Arc;
use std::time::Instant;

pub use frame::Frame;
pub use guides::Guides;
pub use stage::Stage;

use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Buffer, FrameInputs};
use crate::plan::{Elements, Kernel, Plan, Runs, SceneFacts, Shot};
use crate::scene::{CameraRays, Scene};
use crate::techniques::Technique;
use crate::world::{Motion, World};
use hits::primary_hits;
use runner::Runner;

/// What runs a loop's passes. State has the same bytes on both.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub enum Backend {
    /// The threads of the rayon pool that the caller installs.
    #[default]
    Cpu,
    /// A graphics processor. A technique without kernels for one runs on the CPU
    /// ([`FrameLoop::runs_on`]).
    #[cfg(feature = "gpu")]
    Gpu(Arc<crate::gpu::Gpu>),
}

/// Runs one technique on one scene, frame after frame.
#[derive(Debug)]
pub struct FrameLoop {
    technique: Arc<dyn Technique>,
    stage: Stage,
    shot: Shot,
    plan: Plan,
    world: Arc<World>,
    previous: Option<Arc<World>>,
    buffers: Vec<Buffer>,
    next_frame: u32,
    /// Of the last frame; kept so that a frame allocates nothing.
    passes: Vec<(&'static str, f64)>,
    chosen: Vec<usize>,
    /// Of the last frame.
    counters: Counters,
    /// Frames that were submitted, and not finished.
    under_way: u32,
    /// The worlds of the frame that was finished last.
    shown: (Arc<World>, Option<Arc<World>>),
    runner: Runner,
}

impl FrameLoop {
    /// A loop before its first frame, on the CPU.
    ///
    /// # Errors
    /// A picture without pixels or with 2³¹ or more, a depth of 0, an effort below 1 or, for chains
    /// of reservoirs, one that is not whole; no frames a second; parameters that
    /// [`Technique::validate`] refuses.
    pub fn new(technique: Arc<dyn Technique>, stage: &Stage, shot: Shot) -> Result<Self> {
        Self::with_backend(technique, stage, shot, &Backend::Cpu)
    }

    /// A loop before its first frame.
    ///
    /// # Errors
    /// As [`FrameLoop::new`]; on a graphics processor whatever it has not enough of, by name
    /// ([`Error::is_gpu`]).
    pub fn with_backend(
        technique: Arc<dyn Technique>,
        stage: &Stage,
        shot: Shot,
        backend: &Backend,
    ) -> Result<Self> {
        shot.validate()?;
        let (effort, pixels) = (shot.effort, shot.pixels());
        technique.validate()?;
        let plan = technique.plan(&stage.facts, &shot);
        if plan.chains && effort.fract() != 0.0 {
            return Err(Error::usage(format!(
                "effort is {effort}, but `{}` has as many chains of reservoirs a pixel, so it must be whole",
                plan.technique
            )));
        }
        let world = stage.first.clone();
        // Here, so that loops made one after another and run side by side share the tree instead of
        // building one each.
        if plan.emitters {
            world.prepare_emitters()?;
        }
        let moves = stage.facts.moves();
        let runner = Runner::new(backend, &*technique, &plan, &world, (shot, moves))?;
        let buffers = plan
            .buffers
            .iter()
            .map(|buffer| {
                let elements = match (&runner, buffer.elements) {
                    // The device holds them.
                    (Runner::Gpu(_), _) => 0,
                    (Runner::Cpu, Elements::Pixels) => pixels,
                    (Runner::Cpu, Elements::Items(n)) => n as usize,
                };
                let words = vec![0; elements * buffer.bytes as usize / 4];
                Buffer {
                    previous: if buffer.history { words.clone() } else { Vec::new() },
                    current: words,
                }
            })
            .collect();
        Ok(Self {
            technique,
            stage: stage.clone(),
            shot,
            plan,
            world,
            previous: None,
            buffers,
            next_frame: 0,
            passes: Vec::new(),
            chosen: Vec::new(),
            counters: Counters::default(),
            under_way: 0,
            shown: (stage.first.clone(), None),
            runner,
        })
    }

    /// The graphics processor that runs the passes, by name; `None`: the CPU does.
    #[must_use]
    pub fn runs_on(&self) -> Option<String> {
        match &self.runner {
            Runner::Cpu => None,
            Runner::Gpu(device) => Some(device.name()),
        }
    }

    /// Bytes that the scene takes on the graphics processor; 0 on the CPU.
    #[must_use]
    pub fn scene_bytes(&self) -> u64 {
        match &self.runner {
            Runner::Cpu => 0,
            Runner::Gpu(device) => device.scene_bytes(),
        }
    }

    /// Bytes of the scene that were sent to the graphics processor for the frame that was begun
    /// last: 0 in a first frame, whose scene belongs to loading, where nothing but the camera
    /// moved, and on the CPU.
    #[must_use]
    pub fn sent_bytes(&self) -> u64 {
        match &self.runner {
            Runner::Cpu => 0,
            Runner::Gpu(device) => device.sent_bytes(),
        }
    }

    /// Lets the CPU run the first `passes` passes of every frame, from the same bytes: how the pass
    /// that two backends disagree in is found. Without a graphics processor all run there anyway.
    pub fn run_on_cpu(&mut self, passes: usize) {
        if let Runner::Gpu(device) = &mut self.runner {
            device.run_on_cpu(passes);
        }
    }

    /// What runs.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What is rendered.
    #[must_use]
    pub fn shot(&self) -> &Shot {
        &self.shot
    }

    /// The world of the frame that was rendered last (or will be first).
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Forgets all history and begins again at the first frame, with the random numbers of another
    /// run.
    pub fn restart(&mut self, run: u64) {
        self.shot.run = run;
        self.world = self.stage.first.clone();
        self.previous = None;
        self.next_frame = 0;
        self.under_way = 0;
        for buffer in &mut self.buffers {
            buffer.current.fill(0);
            buffer.previous.fill(0);
        }
        if let Runner::Gpu(device) = &mut self.runner {
            device.restart();
        }
    }

    /// Renders the next frame at its own time: start + index / fps, clamped at the scene's end.
    ///
    /// # Errors
    /// Geometry of a moving scene that no acceleration structure can be built for; a graphics
    /// processor that failed; frames that were [submitted](FrameLoop::submit) and not finished.
    pub fn render(&mut self) -> Result<Frame<'_>> {
        self.refuse_frames_under_way()?;
        self.advance()?;
        self.collect()
    }

    /// Frames that may be [submitted](FrameLoop::submit) and not finished.
    pub const MOST_UNDER_WAY: u32 = 2;

    /// Starts the next frame without waiting for it: a graphics processor works on it while the
    /// host prepares the one after. On the CPU it is rendered when it is
    /// [finished](FrameLoop::finish).
    ///
    /// # Errors
    /// As [`FrameLoop::render`]; more than [`FrameLoop::MOST_UNDER_WAY`] frames.
    pub fn submit(&mut self) -> Result<()> {
        if self.under_way >= Self::MOST_UNDER_WAY {
            return Err(Error::usage(format!(
                "{} frames are under way, at most {} are possible: finish one first",
                self.under_way,
                Self::MOST_UNDER_WAY
            )));
        }
        if self.runs_on_device() {
            self.advance()?;
        }
        self.under_way += 1;
        Ok(())
    }

    /// Waits for the oldest frame that was submitted.
    ///
    /// # Errors
    /// As [`FrameLoop::render`]; no frame that was submitted.
    pub fn finish(&mut self) -> Result<Frame<'_>> {
        if self.under_way == 0 {
            return Err(Error::usage("no frame is under way: submit one first"));
        }
        self.under_way -= 1;
        if !self.runs_on_device() {
            self.advance()?;
        }
        self.collect()
    }

    fn refuse_frames_under_way(&self) -> Result<()> {
        if self.under_way > 0 {
            return Err(Error::usage("frames were submitted: finish them first"));
        }
        Ok(())
    }

    fn runs_on_device(&self) -> bool {
        matches!(self.runner, Runner::Gpu(_))
    }

    /// Begins the next frame at its own time.
    fn advance(&mut self) -> Result<()> {
        let begin = Instant::now();
        let mut moved = None;
        if self.next_frame > 0 && self.stage.facts.moves() {
            let time = self.stage.scene.time[0] + self.next_frame as f32 / self.shot.fps as f32;
            moved = Some(Arc::new(self.world.next(self.stage.scene.at(time))?));
        }
        let updated = moved.is_some().then(|| begin.elapsed());
        self.step(moved, updated)
    }

    /// Renders the next frame of a scene that the host moves: `scene` is as it stands now, with
    /// fixed transforms. Things may come, go and change, but only be of kinds that the stage's
    /// scene had.
    ///
    /// # Errors
    /// A stage that is not [`Stage::moving`], whose plan may have left out what motion needs; a
    /// kind of light or surface that the stage's scene had not ([`SceneFacts::lacks`]), which the
    /// plan may have left out; whatever [`Scene::validate`] refuses.
    pub fn render_scene(&mut self, scene: Scene) -> Result<Frame<'_>> {
        let facts = &self.stage.facts;
        if !(facts.moving_camera && facts.moving_lights && facts.moving_geometry) {
            return Err(Error::usage(
                "the stage was planned for a scene that moves by itself or not at all; make it with Stage::moving",
            ));
        }
        self.refuse_frames_under_way()?;
        let begin = Instant::now();
        scene.validate()?;
        let moved = Arc::new(self.world.next(scene)?);
        let now = SceneFacts::new(&moved.scene, moved.lights.counts());
        if let Some(what) = self.stage.facts.lacks(&now) {
            return Err(Error::usage(format!(
                "the scene has {what}, but the one that the stage was made with has none, so the plan may leave out what that takes; \
                 make the stage with a scene that has one"
            )));
        }
        let elapsed = begin.elapsed();
        self.step(Some(moved), Some(elapsed))?;
        self.collect()
    }

    fn step(
        &mut self,
        moved: Option<Arc<World>>,
        updated: Option<std::time::Duration>,
    ) -> Result<()> {
        let index = self.next_frame;
        let first = index == 0;
        let before = (self.world.clone(), self.previous.clone());
        if !first {
            self.previous = Some(self.world.clone());
        }
        if let Some(world) = moved {
            self.world = world;
        }
        let begin = Instant::now();
        let camera = self.world.scene.camera.rays(self.shot.size);
        if self.plan.emitters {
            self.world.prepare_emitters()?;
        }
        let motion = match &self.previous {
            Some(previous) if self.plan.keeps_history() && !self.plan.still => {
                Some(Motion::new(previous, &self.world, self.shot.size))
            }
            _ => None,
        };
        self.passes.clear();
        self.passes.reserve(self.plan.passes.len() + 1);
        if let Some(elapsed) = updated {
            // With the emitters' tree and the tables of what moved; in the first frame they belong
            // to loading, as the scene's own tree.
            self.passes.push(("scene update", (elapsed + begin.elapsed()).as_secs_f64() * 1e3));
        }
        self.chosen.clear();
        self.chosen.extend((0..self.plan.passes.len()).filter(
            |&at| match self.plan.passes[at].runs {
                Runs::Always => true,
                Runs::Once => first,
                Runs::WithHistory => !first,
            },
        ));
        self.next_frame = self.next_frame.wrapping_add(1);
        let mut runner = std::mem::replace(&mut self.runner, Runner::Cpu);
        let outcome = match &mut runner {
            Runner::Cpu => {
                self.run_here(motion.as_ref(), camera, index);
                Ok(())
            }
            Runner::Gpu(device) => self.run_on(device, motion.as_ref(), camera, index),
        };
        self.runner = runner;
        if outcome.is_err() {
            // The loop is where it was: a frame that was refused has never been.
            (self.world, self.previous) = before;
            self.next_frame = index;
        }
        outcome
    }

    /// Runs the chosen passes on the CPU.
    fn run_here(&mut self, motion: Option<&Motion>, camera: CameraRays, index: u32) {
        for (buffer, plan) in self.buffers.iter_mut().zip(&self.plan.buffers) {
            if plan.history && index > 0 {
                std::mem::swap(&mut buffer.current, &mut buffer.previous);
            }
        }
        self.counters = self.run_passes(self.chosen.len(), motion, camera, index);
        self.shown = (self.world.clone(), self.previous.clone());
    }

    /// Starts the chosen passes on the graphics processor, after those that the CPU was asked to
    /// run.
    fn run_on(
        &mut self,
        device: &mut gpu::Device,
        motion: Option<&Motion>,
        camera: CameraRays,
        index: u32,
    ) -> Result<()> {
        let here = device.begin(self, motion, &camera, index)?;
        let mut counters = Counters::default();
        if here > 0 {
            device.download(&mut self.buffers)?;
            counters = self.run_passes(here, motion, camera, index);
            device.upload(&self.buffers);
        }
        device.submit(self, here, counters, index);
        Ok(())
    }

    /// The frame that was begun first, once it is done.
    fn collect(&mut self) -> Result<Frame<'_>> {
        let mut index = self.next_frame.wrapping_sub(1);
        if let Runner::Gpu(device) = &mut self.runner
            && let Some(landed) = device.collect(&self.plan, &mut self.buffers)?
        {
            index = landed.index;
            (self.passes, self.shown, self.counters) =
                (landed.passes, landed.shown, landed.counters);
        }
        Ok(Frame { frame_loop: self, index, counters: self.counters, passes: &self.passes })
    }

    /// Runs the first `count` of the chosen passes on the CPU.
    fn run_passes(
        &mut self,
        count: usize,
        motion: Option<&Motion>,
        camera: CameraRays,
        index: u32,
    ) -> Counters {
        let mut counters = Counters::default();
        for &at in &self.chosen[..count] {
            let pass = &self.plan.passes[at];
            let begin = Instant::now();
            let (world, previous, shot) = (&*self.world, self.previous.as_deref(), self.shot);
            let technique = &*self.technique;
            let work = cpu::run_pass(
                pass,
                &self.plan,
                (&shot, index),
                &mut self.buffers,
                |buffers, band| {
                    let inputs = FrameInputs {
                        world,
                        previous,
                        shot,
                        plan: &self.plan,
                        camera,
                        motion,
                        frame: index,
                        buffers,
                    };
                    match pass.kernel {
                        Kernel::PrimaryHits => primary_hits(&inputs, band),
                        Kernel::Technique(kernel) => technique.run(kernel, &inputs, band),
                    }
                },
            );
            counters = counters + work;
            add_pass(&mut self.passes, pass.name, begin.elapsed().as_secs_f64() * 1e3);
        }
        counters
    }
}

/// Rounds of one pass are one line.
fn add_pass(passes: &mut Vec<(&'static str, f64)>, name: &'static str, ms: f64) {
    match passes.last_mut() {
        Some((last, sum)) if *last == name => *sum += ms,
        _ => passes.push((name, ms)),
    }
}
