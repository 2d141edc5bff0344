//! The loop over frames: the scene's time, buffers and their history, the order of passes. It knows no technique.
//!
//! ```text
//! Stage (scene, facts, first world) ──► FrameLoop::new(technique, stage, shot) ──► render() ──► Frame (picture, layers, counters, times)
//! ```
//!
//! A pass writes only its own pixels, tiles or items and reads only what earlier passes wrote, so the result has the same bits for any number
//! of threads. Threads are those of the rayon pool that the caller installs.

mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
#[cfg(all(test, feature = "gpu"))]
mod gpu_tests;
mod guides;

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

pub use guides::Guides;

use crate::accel::{BuildOptions, HitFilter, Ray};
use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Band, Buffer, FrameInputs, PrimaryHit};
use crate::path::emitted;
use crate::picture::Picture;
use crate::plan::{BufferId, Elements, Kernel, Plan, Runs, SceneFacts, Shot};
use crate::scene::{CameraRays, Scene};
use crate::techniques::Technique;
use crate::world::Motion;
use crate::world::{WithFilter, World};

/// A scene ready for any number of runs: its facts and its first frame's world, built once.
#[derive(Clone, Debug)]
pub struct Stage {
    scene: Arc<Scene>,
    facts: SceneFacts,
    first: Arc<World>,
}

impl Stage {
    /// Prepares a scene, which may move.
    ///
    /// # Errors
    /// Whatever [`Scene::validate`] refuses, and geometry that no acceleration structure can be built for.
    pub fn new(scene: Scene) -> Result<Self> {
        Self::with_options(scene, &BuildOptions::default())
    }

    /// Prepares a scene that the host will move from frame to frame ([`FrameLoop::render_scene`]): everything counts as moving, and lights as
    /// coloured, since they may become so.
    ///
    /// # Errors
    /// As [`Stage::new`].
    pub fn moving(scene: Scene) -> Result<Self> {
        let mut stage = Self::with_options(
            scene,
            &BuildOptions { two_level: Some(true), ..BuildOptions::default() },
        )?;
        let facts = &mut stage.facts;
        (facts.moving_camera, facts.moving_lights, facts.moving_geometry) = (true, true, true);
        facts.grey_lights = false;
        Ok(stage)
    }

    /// As [`Stage::new`], with a choice of acceleration structure.
    ///
    /// # Errors
    /// As [`Stage::new`].
    pub fn with_options(scene: Scene, options: &BuildOptions) -> Result<Self> {
        scene.validate()?;
        // What moves must have a tree of its own, which later frames share.
        let moving = scene.instances.iter().any(|instance| instance.to_world.moves());
        let two_level = options.two_level.or(moving.then_some(true));
        let first = World::new(scene.at(scene.time[0]), &BuildOptions { two_level, ..*options })?;
        let facts = SceneFacts::new(&scene, first.lights.counts());
        Ok(Self { scene: Arc::new(scene), facts, first: Arc::new(first) })
    }

    /// The scene, with its motion.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What the scene contains.
    #[must_use]
    pub fn facts(&self) -> &SceneFacts {
        &self.facts
    }

    /// The world of the first frame.
    #[must_use]
    pub fn first_world(&self) -> &Arc<World> {
        &self.first
    }
}

/// What runs a loop's passes. State has the same bytes on both.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub enum Backend {
    /// The threads of the rayon pool that the caller installs.
    #[default]
    Cpu,
    /// A graphics processor. A technique without kernels for one runs on the CPU ([`FrameLoop::runs_on`]).
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
    #[cfg(feature = "gpu")]
    device: Option<Device>,
}

/// The part of a loop that a graphics processor runs.
#[cfg(feature = "gpu")]
#[derive(Debug)]
struct Device {
    runner: gpu::Runner,
    twins: Vec<crate::techniques::Twin>,
    /// So many of a frame's passes stay on the CPU.
    on_cpu: usize,
    /// So many of a frame's passes run at all.
    #[cfg(test)]
    stop_after: usize,
    /// State is to be cleared before the next frame.
    restarted: bool,
    /// Frames under way, the oldest first.
    flights: std::collections::VecDeque<Flight>,
    /// Buffers of the last frame that were asked for.
    read: Vec<std::sync::OnceLock<Vec<u32>>>,
}

/// A frame that a graphics processor works on.
#[cfg(feature = "gpu")]
#[derive(Debug)]
struct Flight {
    index: u32,
    /// Of what ran on the CPU.
    counters: Counters,
    passes: Vec<(&'static str, f64)>,
    submitted: gpu::Submitted,
    world: Arc<World>,
    previous: Option<Arc<World>>,
}

/// One rendered frame, borrowed from the loop.
#[derive(Debug)]
pub struct Frame<'a> {
    frame_loop: &'a FrameLoop,
    /// From 0 after every restart.
    pub index: u32,
    /// Work done in this frame.
    pub counters: Counters,
    /// Milliseconds of each pass that ran, in order; the scene's update comes first where anything moves.
    pub passes: &'a [(&'static str, f64)],
}

impl FrameLoop {
    /// A loop before its first frame, on the CPU.
    ///
    /// # Errors
    /// A picture without pixels or with 2³¹ or more, a depth of 0, an effort below 1 or, for chains of
    /// reservoirs, one that is not whole; no frames a second;
    /// parameters that [`Technique::validate`] refuses.
    pub fn new(technique: Arc<dyn Technique>, stage: &Stage, shot: Shot) -> Result<Self> {
        Self::with_backend(technique, stage, shot, &Backend::Cpu)
    }

    /// A loop before its first frame.
    ///
    /// # Errors
    /// As [`FrameLoop::new`]; on a graphics processor whatever it has not enough of, by name ([`Error::is_gpu`]).
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
        // Here, so that loops made one after another and run side by side share the tree instead of building one each.
        if plan.emitters {
            world.prepare_emitters()?;
        }
        #[cfg(not(feature = "gpu"))]
        let Backend::Cpu = backend;
        #[cfg(feature = "gpu")]
        let device = Device::new(backend, &*technique, &plan, &world, (shot, stage.facts.moves()))?;
        #[cfg(feature = "gpu")]
        let on_device = device.is_some();
        #[cfg(not(feature = "gpu"))]
        let on_device = false;
        let buffers = plan
            .buffers
            .iter()
            .filter(|_| !on_device)
            .map(|buffer| {
                let elements = match buffer.elements {
                    Elements::Pixels => pixels,
                    Elements::Items(n) => n as usize,
                };
                let words = vec![0; elements * buffer.bytes as usize / 4];
                Buffer {
                    previous: if buffer.history { words.clone() } else { Vec::new() },
                    current: words,
                }
            })
            .collect();
        let buffers = if on_device { vec![Buffer::default(); plan.buffers.len()] } else { buffers };
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
            #[cfg(feature = "gpu")]
            device,
        })
    }

    /// The graphics processor that runs the passes, by name; `None`: the CPU does.
    #[must_use]
    pub fn runs_on(&self) -> Option<String> {
        #[cfg(feature = "gpu")]
        return self.device.as_ref().map(|device| device.runner.gpu().info().to_string());
        #[cfg(not(feature = "gpu"))]
        None
    }

    /// Bytes that the scene takes on the graphics processor; 0 on the CPU.
    #[must_use]
    pub fn scene_bytes(&self) -> u64 {
        #[cfg(feature = "gpu")]
        return self.device.as_ref().map_or(0, |device| device.runner.scene_bytes());
        #[cfg(not(feature = "gpu"))]
        0
    }

    /// Lets the CPU run the first `passes` passes of every frame, from the same bytes: how the pass that two backends disagree in is
    /// found. Without a graphics processor all run there anyway.
    pub fn run_on_cpu(&mut self, passes: usize) {
        #[cfg(feature = "gpu")]
        if let Some(device) = &mut self.device {
            device.on_cpu = passes;
        }
        #[cfg(not(feature = "gpu"))]
        let _ = passes;
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

    /// Forgets all history and begins again at the first frame, with the random numbers of another run.
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
        #[cfg(feature = "gpu")]
        if let Some(device) = &mut self.device {
            device.restarted = true;
            device.flights.clear();
        }
    }

    /// Renders the next frame at its own time: start + index / fps, clamped at the scene's end.
    ///
    /// # Errors
    /// Geometry of a moving scene that no acceleration structure can be built for; a graphics processor that failed; frames that were
    /// [submitted](FrameLoop::submit) and not finished.
    pub fn render(&mut self) -> Result<Frame<'_>> {
        self.refuse_frames_under_way()?;
        self.advance()?;
        self.collect()
    }

    /// Frames that may be [submitted](FrameLoop::submit) and not finished.
    pub const MOST_UNDER_WAY: u32 = 2;

    /// Starts the next frame without waiting for it: a graphics processor works on it while the host prepares the one after. On the CPU it is rendered when
    /// it is [finished](FrameLoop::finish).
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
        #[cfg(feature = "gpu")]
        return self.device.is_some();
        #[cfg(not(feature = "gpu"))]
        false
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

    /// Renders the next frame of a scene that the host moves: `scene` is as it stands now, with fixed transforms. Things may come, go and change,
    /// but only be of kinds that the stage's scene had.
    ///
    /// # Errors
    /// A stage that is not [`Stage::moving`], whose plan may have left out what motion needs; a kind of light or surface that the stage's scene had
    /// not ([`SceneFacts::lacks`]), which the plan may have left out; whatever [`Scene::validate`] refuses.
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
        #[cfg(feature = "gpu")]
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
            // With the emitters' tree and the tables of what moved; in the first frame they belong to loading, as the scene's own tree.
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
        #[cfg(feature = "gpu")]
        if let Some(mut device) = self.device.take() {
            let outcome = self.run_on(&mut device, motion.as_ref(), camera, index);
            self.device = Some(device);
            if outcome.is_err() {
                // The loop is where it was: a frame that was refused has never been.
                (self.world, self.previous) = before;
                self.next_frame = index;
            }
            return outcome;
        }
        for (buffer, plan) in self.buffers.iter_mut().zip(&self.plan.buffers) {
            if plan.history && !first {
                std::mem::swap(&mut buffer.current, &mut buffer.previous);
            }
        }
        self.counters = self.run_passes(self.chosen.len(), motion.as_ref(), camera, index);
        self.shown = (self.world.clone(), self.previous.clone());
        Ok(())
    }

    /// The frame that was begun first, once it is done.
    fn collect(&mut self) -> Result<Frame<'_>> {
        #[cfg(feature = "gpu")]
        if let Some(device) = &mut self.device
            && let Some(flight) = device.flights.pop_front()
        {
            let Flight { index, counters, mut passes, submitted, world, previous } = flight;
            let work =
                device.runner.collect(submitted, &self.plan, &mut self.buffers, &mut passes)?;
            (self.passes, self.shown) = (passes, (world, previous));
            let counters = counters + work;
            return Ok(Frame { frame_loop: self, index, counters, passes: &self.passes });
        }
        let (index, counters) = (self.next_frame.wrapping_sub(1), self.counters);
        Ok(Frame { frame_loop: self, index, counters, passes: &self.passes })
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

    /// Starts the chosen passes on the graphics processor, after those that the CPU was asked to run.
    #[cfg(feature = "gpu")]
    fn run_on(
        &mut self,
        device: &mut Device,
        motion: Option<&Motion>,
        camera: CameraRays,
        index: u32,
    ) -> Result<()> {
        #[cfg(test)]
        self.chosen.truncate(device.stop_after);
        let Device { runner, twins, on_cpu, restarted, flights, read, .. } = device;
        read.iter_mut().for_each(|buffer| drop(buffer.take()));
        if *restarted {
            runner.restart(&self.world, (twins, &self.plan, self.shot))?;
            *restarted = false;
        }
        let state = gpu::FrameState {
            world: &self.world,
            previous: self.previous.as_deref(),
            camera: &camera,
            motion,
            shot: self.shot,
            index,
        };
        let begin = Instant::now();
        runner.begin(&state, (twins, &self.plan))?;
        if let Some((_, ms)) = self.passes.first_mut() {
            // What moved has to be sent, too.
            *ms += begin.elapsed().as_secs_f64() * 1e3;
        }
        let here = self.chosen.len().min(*on_cpu);
        let mut counters = Counters::default();
        if here > 0 {
            runner.download(&mut self.buffers)?;
            counters = self.run_passes(here, motion, camera, index);
            runner.upload(&self.buffers);
        }
        flights.push_back(Flight {
            index,
            counters,
            passes: std::mem::take(&mut self.passes),
            submitted: runner.submit(&self.chosen[here..], &self.plan),
            world: self.world.clone(),
            previous: self.previous.clone(),
        });
        Ok(())
    }

    fn picture(&self, id: BufferId) -> Picture {
        let values: &[[f32; 3]] = bytemuck::cast_slice(&self.buffers[id.0].current);
        let [width, height] = self.shot.size;
        Picture::new(width, height, values.iter().map(|rgb| Vec3::from_array(*rgb)).collect())
    }
}

impl Frame<'_> {
    /// The frame's estimate: all light but what is emitted directly towards the camera.
    #[must_use]
    pub fn picture(&self) -> Picture {
        self.frame_loop.picture(Plan::RADIANCE)
    }

    /// Directly visible emission and sky: part of the picture, left out of every metric.
    #[must_use]
    pub fn emission(&self) -> Picture {
        self.frame_loop.picture(Plan::EMISSION)
    }

    /// What this frame left in the plan's buffer `name`, such as `reservoirs`; `None` where the plan has no such buffer, or one whose elements
    /// are no whole number of `T`, and while later frames are under way.
    #[must_use]
    pub fn buffer<T: bytemuck::Pod>(&self, name: &str) -> Option<&[T]> {
        let id = self.frame_loop.plan.buffer(name)?;
        #[cfg(feature = "gpu")]
        if let Some(device) = &self.frame_loop.device {
            if self.frame_loop.under_way > 0 {
                return None;
            }
            let copy = &device.read[id.0];
            if copy.get().is_none() {
                let words = device.runner.read(id.0);
                // The next frame says why.
                let words = words.map_err(|e| device.runner.gpu().failed(&e.to_string())).ok()?;
                let _ = copy.set(words);
            }
            return bytemuck::try_cast_slice(copy.get()?).ok();
        }
        bytemuck::try_cast_slice(&self.frame_loop.buffers[id.0].current).ok()
    }

    /// Albedo, normal, depth and motion through pixel centres. Traced here, in no pass's time.
    #[must_use]
    pub fn guides(&self) -> Guides {
        let FrameLoop { shown: (world, previous), shot, .. } = self.frame_loop;
        Guides::new(world, previous.as_deref(), shot.size)
    }

    /// Milliseconds of all passes.
    #[must_use]
    pub fn milliseconds(&self) -> f64 {
        self.passes.iter().map(|(_, ms)| ms).sum()
    }
}

#[cfg(feature = "gpu")]
impl Device {
    /// `None`: the CPU runs all.
    fn new(
        backend: &Backend,
        technique: &dyn Technique,
        plan: &Plan,
        world: &Arc<World>,
        how: (Shot, bool),
    ) -> Result<Option<Self>> {
        let Backend::Gpu(device) = backend else { return Ok(None) };
        let Some(twins) = gpu::twins(technique, plan) else { return Ok(None) };
        let runner = gpu::Runner::new(device.clone(), &twins, plan, world, how)?;
        let read = plan.buffers.iter().map(|_| std::sync::OnceLock::new()).collect();
        Ok(Some(Self {
            runner,
            twins,
            on_cpu: 0,
            #[cfg(test)]
            stop_after: usize::MAX,
            restarted: false,
            flights: std::collections::VecDeque::new(),
            read,
        }))
    }
}

/// Rounds of one pass are one line.
fn add_pass(passes: &mut Vec<(&'static str, f64)>, name: &'static str, ms: f64) {
    match passes.last_mut() {
        Some((last, sum)) if *last == name => *sum += ms,
        _ => passes.push((name, ms)),
    }
}

/// Traces primary rays through pixel centres and writes hits and directly visible emission.
fn primary_hits(inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
    struct Hits<'a, 'b, 'c>(&'a FrameInputs<'b>, &'a mut Band<'c>);
    impl WithFilter for Hits<'_, '_, '_> {
        type Output = Counters;

        fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
            let Self(inputs, band) = self;
            let world = inputs.world;
            let hits: &mut [PrimaryHit] = band.take(Plan::HITS);
            let emission: &mut [[f32; 3]] = band.take(Plan::EMISSION);
            let first = band.range.start * band.width;
            for (local, (out, seen)) in hits.iter_mut().zip(emission).enumerate() {
                let pixel = first + local as u32;
                let ray = inputs.camera.ray(inputs.sample_position(
                    pixel % band.width,
                    pixel / band.width,
                    0,
                ));
                let hit = world.accel.closest_hit(
                    &Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY },
                    &filter,
                );
                *seen = match &hit {
                    Some(hit) => emitted(world, &world.accel.point(hit), ray.direction),
                    None => world.escaped_radiance(ray.direction),
                }
                .to_array();
                *out = hit.into();
            }
            Counters {
                primary_rays: u64::from(band.range.end - band.range.start) * u64::from(band.width),
                ..Counters::default()
            }
        }
    }
    inputs.world.with_filter(Hits(inputs, band))
}
