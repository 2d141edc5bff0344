//! Runs a plan's passes on a graphics processor: state in one buffer, one submission a frame.

use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use glam::{Vec3, Vec4};

use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::gpu::{
    CameraRecord, Gpu, Inputs, Links, MAX_BUFFERS, ProjectionRecord, SceneBuffers, SceneConstants,
    Shader, groups, workgroup,
};
use crate::pass::Buffer;
use crate::plan::{Elements, Filter, Kernel, Plan, Shot};
use crate::scene::CameraRays;
use crate::techniques::Technique;
use crate::twin::{Module, Twin};
use crate::world::Motion;
use crate::world::World;

/// Bytes before the timestamps in what is read back: room for all counters.
const COUNTERS: u64 = 256;
/// Frames that may be under way: one that the device works on, one that waits behind it.
const IN_FLIGHT: usize = 2;
/// Alignment of what queries are written to.
const RESOLVE: u64 = 256;
/// The frame loop's own kernel.
const PRIMARY_HITS: Module = crate::wgsl!("../primary_hits.wgsl");

/// A scene's arenas: shared where nothing moves.
#[derive(Debug)]
enum Arenas {
    Shared(Arc<SceneBuffers>),
    Own(Box<SceneBuffers>),
}

impl Arenas {
    fn get(&self) -> &SceneBuffers {
        match self {
            Self::Shared(scene) => scene,
            Self::Own(scene) => scene,
        }
    }
}

/// A pass, ready to be dispatched.
#[derive(Debug)]
struct Ready {
    pipeline: wgpu::ComputePipeline,
    groups: [u32; 2],
}

/// Where a buffer of the plan lies in the state, in words.
#[derive(Clone, Copy, Debug)]
struct Span {
    first: u32,
    words: u32,
    history: bool,
}

/// One loop's frames on a device.
#[derive(Debug)]
pub(super) struct DeviceRunner {
    gpu: Arc<Gpu>,
    scene: Arenas,
    /// The world that the scene shows.
    shown: Arc<World>,
    /// Bytes of the scene that were sent for the frame that was begun last.
    sent: u64,
    /// What the passes' pipelines know of the scene.
    compiled: SceneConstants,
    passes: Vec<Ready>,
    spans: Vec<Span>,
    /// Whether histories' halves are exchanged.
    exchanged: bool,
    state: wgpu::Buffer,
    inputs: wgpu::Buffer,
    counters: wgpu::Buffer,
    /// What is read back; frames under way take turns.
    staging: [wgpu::Buffer; IN_FLIGHT],
    /// Whose turn it is.
    turn: usize,
    queries: Option<(wgpu::QuerySet, wgpu::Buffer)>,
    bindings: wgpu::BindGroup,
}

/// A frame under way.
#[derive(Debug)]
pub(super) struct Submitted {
    staging: usize,
    passes: Vec<usize>,
    index: wgpu::SubmissionIndex,
    begin: Instant,
}

/// Where the pictures begin in what is read back, in bytes.
fn pictures(plan: &Plan) -> u64 {
    COUNTERS + (2 * plan.passes.len() as u64 * 8).next_multiple_of(RESOLVE)
}

/// What of a frame the kernels are told.
pub(super) struct FrameState<'a> {
    pub(super) world: &'a Arc<World>,
    pub(super) previous: Option<&'a World>,
    pub(super) camera: &'a CameraRays,
    pub(super) motion: Option<&'a Motion>,
    pub(super) shot: Shot,
    pub(super) index: u32,
}

/// The twins of all passes; `None` where the technique lacks one.
pub(crate) fn twins(technique: &dyn Technique, plan: &Plan) -> Option<Vec<Twin>> {
    let own = || Twin { kernel: "primary_hits", modules: vec![PRIMARY_HITS], ..Twin::default() };
    plan.passes
        .iter()
        .map(|pass| match pass.kernel {
            Kernel::PrimaryHits => Some(own()),
            Kernel::Technique(kernel) => technique.twin(kernel, plan),
        })
        .collect()
}

impl DeviceRunner {
    pub(super) fn new(
        gpu: Arc<Gpu>,
        twins: &[Twin],
        plan: &Plan,
        world: &Arc<World>,
        (shot, moves): (Shot, bool),
    ) -> Result<Self> {
        gpu.check()?;
        if plan.buffers.len() > MAX_BUFFERS {
            return Err(Error::gpu(format!(
                "the plan has {} buffers, kernels address {MAX_BUFFERS}",
                plan.buffers.len()
            )));
        }
        let mut spans = Vec::new();
        let mut total = 0_u64;
        for buffer in &plan.buffers {
            let elements = match buffer.elements {
                Elements::Pixels => shot.pixels() as u64,
                Elements::Items(n) => u64::from(n),
            };
            let words = elements * u64::from(buffer.bytes / 4);
            spans.push((total, words, buffer.history));
            total += words * if buffer.history { 2 } else { 1 };
        }
        if total > u64::from(u32::MAX) {
            return Err(Error::gpu(format!(
                "the state takes {total} words, at most 2^32 are addressed"
            )));
        }
        let spans = spans
            .into_iter()
            .map(|(first, words, history)| Span {
                first: first as u32,
                words: words as u32,
                history,
            })
            .collect::<Vec<_>>();
        use wgpu::BufferUsages as Usage;
        let copied = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
        let state = gpu.buffer("the frame loop's state", 4 * total, copied)?;
        let counters = gpu.buffer("counters", COUNTERS, copied)?;
        let inputs = gpu.buffer(
            "a frame's inputs",
            size_of::<Inputs>() as u64,
            Usage::UNIFORM | Usage::COPY_DST,
        )?;
        let stamps = 2 * plan.passes.len() as u64 * 8;
        let picture = 12 * shot.pixels() as u64;
        let read = COUNTERS + stamps.next_multiple_of(RESOLVE) + 2 * picture;
        let staging = |_| gpu.buffer("what is read back", read, Usage::MAP_READ | Usage::COPY_DST);
        let staging = [staging(0)?, staging(1)?];
        let queries = if gpu.has_timestamps() && !plan.passes.is_empty() {
            let set = gpu.device().create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("passes"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * plan.passes.len() as u32,
            });
            let resolved =
                gpu.buffer("timestamps", stamps, Usage::QUERY_RESOLVE | Usage::COPY_SRC)?;
            Some((set, resolved))
        } else {
            None
        };
        let scene = if moves {
            let links = Links::default();
            Arenas::Own(Box::new(SceneBuffers::new(&gpu, (world, Some(world)), &links, None)?))
        } else {
            Arenas::Shared(gpu.scene(world, plan.emitters)?)
        };
        let compiled = *scene.get().constants();
        let passes = compile(&gpu, twins, plan, shot, &compiled)?;
        let bindings = gpu
            .guarded("a loop's buffers", || bind(&gpu, scene.get(), &inputs, &state, &counters))?;
        Ok(Self {
            gpu,
            scene,
            shown: world.clone(),
            sent: 0,
            compiled,
            passes,
            spans,
            exchanged: false,
            state,
            inputs,
            counters,
            staging,
            turn: 0,
            queries,
            bindings,
        })
    }

    pub(super) fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Bytes of the scene on the device.
    pub(super) fn scene_bytes(&self) -> u64 {
        self.scene.get().bytes()
    }

    /// Bytes of the scene that were sent for the frame that was begun last.
    pub(super) fn sent_bytes(&self) -> u64 {
        self.sent
    }

    /// All state is zero again, and `world` is both this frame's and the previous one's.
    pub(super) fn restart(
        &mut self,
        world: &Arc<World>,
        (twins, plan, shot): (&[Twin], &Plan, Shot),
    ) -> Result<()> {
        self.gpu.check()?;
        if let Arenas::Own(scene) = &mut self.scene
            && !scene.reset(&self.gpu, world)?
        {
            let known = self.compiled;
            let links = Links::default();
            let next = SceneBuffers::new(&self.gpu, (world, Some(world)), &links, Some(&known))?;
            self.show(next, (twins, plan, shot))?;
        }
        self.shown = world.clone();
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.state, 0, None);
        self.gpu.queue().submit([encoder.finish()]);
        self.exchanged = false;
        self.gpu.check()
    }

    /// Other arenas, and kernels that know what is in them. Nothing has changed where this fails.
    fn show(
        &mut self,
        scene: SceneBuffers,
        (twins, plan, shot): (&[Twin], &Plan, Shot),
    ) -> Result<()> {
        let constants = *scene.constants();
        if constants != self.compiled {
            self.passes = compile(&self.gpu, twins, plan, shot, &constants)?;
            self.compiled = constants;
        }
        self.bindings = bind(&self.gpu, &scene, &self.inputs, &self.state, &self.counters);
        self.scene = Arenas::Own(Box::new(scene));
        Ok(())
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Prepares the next frame: its world takes its turn, histories are exchanged. Nothing has
    /// changed where this fails.
    pub(super) fn begin(
        &mut self,
        frame: &FrameState<'_>,
        (twins, plan): (&[Twin], &Plan),
    ) -> Result<()> {
        self.gpu.check()?;
        self.sent = 0;
        if let Arenas::Own(scene) = &mut self.scene
            && !Arc::ptr_eq(&self.shown, frame.world)
        {
            let how = (twins, plan, frame.shot);
            let motion = frame.motion;
            let links = Links {
                lights: motion.and_then(|m| m.lights.as_ref()).map(|remap| remap.tables()),
                instances: motion
                    .and_then(|m| m.instances.as_ref())
                    .map(|remap| remap.previous_places()),
            };
            if frame.index == 0 {
                // A host's first scene is not the stage's.
                self.restart(frame.world, how)?;
            } else if !scene.advance(&self.gpu, frame.world, &links)? {
                let previous = frame.previous.unwrap_or(frame.world);
                let worlds = (&**frame.world, Some(previous));
                let known = self.compiled;
                let next = SceneBuffers::new(&self.gpu, worlds, &links, Some(&known))?;
                self.show(next, how)?;
            }
            self.sent = self.scene.get().sent();
            self.shown = frame.world.clone();
        }
        if frame.index > 0 {
            self.exchanged = !self.exchanged;
        }
        self.write_inputs(frame);
        Ok(())
    }

    fn write_inputs(&self, frame: &FrameState<'_>) {
        let shot = frame.shot;
        let mut inputs = Inputs {
            run: [shot.run as u32, (shot.run >> 32) as u32],
            frame: frame.index,
            effort: shot.estimates()[0],
            extra_share: shot.extra_share(),
            size: shot.size,
            depth: shot.depth,
            box_filter: u32::from(shot.filter == Filter::Box),
            camera: camera(frame.camera),
            ..Inputs::default()
        };
        self.scene.get().describe(&mut inputs);
        inputs.instances[1] = u32::from(frame.motion.is_some());
        if let Some(motion) = frame.motion {
            inputs.camera_before = camera(&motion.camera);
            let (map, origin, per_unit, middle) = motion.projection.parts();
            let row = |at: usize| {
                let m = map.matrix3;
                let row = [m.x_axis[at], m.y_axis[at], m.z_axis[at]];
                [row[0], row[1], row[2], map.translation[at]]
            };
            inputs.projection = ProjectionRecord {
                row_x: row(0),
                row_y: row(1),
                row_z: row(2),
                origin: origin.extend(0.0).to_array(),
                scale: Vec4::new(per_unit, middle.x, middle.y, 0.0).to_array(),
            };
        }
        for (at, span) in inputs.buffers.iter_mut().zip(&self.spans) {
            let (now, before) = self.halves(span);
            *at = [now, before, 0, 0];
        }
        self.gpu.queue().write_buffer(&self.inputs, 0, bytemuck::bytes_of(&inputs));
    }

    /// Where a buffer's words of this frame and of the previous one begin.
    fn halves(&self, span: &Span) -> (u32, u32) {
        match (span.history, self.exchanged) {
            (false, _) => (span.first, span.first),
            (true, false) => (span.first, span.first + span.words),
            (true, true) => (span.first + span.words, span.first),
        }
    }

    /// Starts those of the plan's passes that `chosen` lists, and the copies of what is read back.
    pub(super) fn submit(&mut self, chosen: &[usize], plan: &Plan) -> Submitted {
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.counters, 0, None);
        for (number, &at) in chosen.iter().enumerate() {
            let Ready { pipeline, groups } = &self.passes[at];
            let timestamp_writes =
                self.queries.as_ref().map(|(set, _)| wgpu::ComputePassTimestampWrites {
                    query_set: set,
                    beginning_of_pass_write_index: Some(2 * number as u32),
                    end_of_pass_write_index: Some(2 * number as u32 + 1),
                });
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(plan.passes[at].name),
                timestamp_writes,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups(groups[0], groups[1], 1);
        }
        let staging = &self.staging[self.turn];
        encoder.copy_buffer_to_buffer(&self.counters, 0, staging, 0, Some(COUNTERS));
        if let Some((set, resolved)) = self.queries.as_ref().filter(|_| !chosen.is_empty()) {
            let count = 2 * chosen.len() as u32;
            encoder.resolve_query_set(set, 0..count, resolved, 0);
            let bytes = u64::from(count) * 8;
            encoder.copy_buffer_to_buffer(resolved, 0, staging, COUNTERS, Some(bytes));
        }
        let mut to = pictures(plan);
        for id in [Plan::RADIANCE, Plan::EMISSION] {
            let span = self.spans[id.0];
            let (now, _) = self.halves(&span);
            let (first, bytes) = (4 * u64::from(now), 4 * u64::from(span.words));
            encoder.copy_buffer_to_buffer(&self.state, first, staging, to, Some(bytes));
            to += bytes;
        }
        let index = self.gpu.queue().submit([encoder.finish()]);
        let submitted =
            Submitted { staging: self.turn, passes: chosen.to_vec(), index, begin: Instant::now() };
        self.turn = (self.turn + 1) % IN_FLIGHT;
        submitted
    }

    /// Waits for a frame, and takes its counters, times and pictures.
    pub(super) fn collect(
        &self,
        submitted: Submitted,
        plan: &Plan,
        buffers: &mut [Buffer],
        passes: &mut Vec<(&'static str, f64)>,
    ) -> Result<Counters> {
        let Submitted { staging, passes: ran, index, begin } = submitted;
        let spans = [Plan::RADIANCE, Plan::EMISSION].map(|id| self.spans[id.0].words);
        let first = pictures(plan) as usize;
        let total = first as u64 + spans.map(|words| 4 * u64::from(words)).iter().sum::<u64>();
        let bytes = self.mapped(&self.staging[staging], total, Some(index))?;
        let counters = Counters::from_words(bytemuck::cast_slice(&bytes[..COUNTERS as usize]));
        if self.queries.is_some() {
            let stamps = &bytes[COUNTERS as usize..first];
            let period = f64::from(self.gpu.queue().get_timestamp_period());
            for (number, &at) in ran.iter().enumerate() {
                let stamp = |i: usize| {
                    let at = 8 * (2 * number + i);
                    u64::from_le_bytes(stamps[at..at + 8].try_into().unwrap_or_default())
                };
                let ms = stamp(1).saturating_sub(stamp(0)) as f64 * period * 1e-6;
                crate::frame::add_pass(passes, plan.passes[at].name, ms);
            }
        } else if !ran.is_empty() {
            passes.push(("all passes", begin.elapsed().as_secs_f64() * 1e3));
        }
        let mut at = first;
        for (id, words) in [Plan::RADIANCE, Plan::EMISSION].into_iter().zip(spans) {
            let end = at + 4 * words as usize;
            let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            let to = &mut buffers[id.0].current;
            to.clear();
            to.extend(bytes[at..end].chunks_exact(4).map(word));
            at = end;
        }
        Ok(counters)
    }

    /// The first bytes of a buffer that can be mapped, once the submission is done; `None`: the
    /// newest one.
    fn mapped(
        &self,
        buffer: &wgpu::Buffer,
        bytes: u64,
        submission: Option<wgpu::SubmissionIndex>,
    ) -> Result<Vec<u8>> {
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, ..bytes, move |outcome| {
            // Nobody waits any more where an error came first.
            let _ = sender.send(outcome);
        });
        let failed =
            |why: &dyn std::fmt::Display| self.gpu.failed(&format!("reading back failed: {why}"));
        loop {
            let wait = wgpu::PollType::Wait { submission_index: submission.clone(), timeout: None };
            let waited = self.gpu.device().poll(wait);
            self.gpu.check()?;
            waited.map_err(|error| failed(&error))?;
            // Another thread's poll may be about to call back for this one.
            match receiver.recv_timeout(Duration::from_millis(20)) {
                Ok(Ok(())) => break,
                Ok(Err(error)) => return Err(failed(&error)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(error) => return Err(failed(&error)),
            }
        }
        let copy = {
            let view = buffer.get_mapped_range(..bytes).map_err(|error| failed(&error))?;
            view.to_vec()
        };
        buffer.unmap();
        Ok(copy)
    }

    /// This frame's words of a buffer.
    pub(super) fn read(&self, buffer: usize) -> Result<Vec<u32>> {
        let span = self.spans[buffer];
        let (now, _) = self.halves(&span);
        self.read_words(now, span.words)
    }

    fn read_words(&self, first: u32, words: u32) -> Result<Vec<u32>> {
        let bytes = 4 * u64::from(words);
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let staging = self.gpu.buffer("a copy to be read", bytes, usage)?;
        let mut encoder = self.encoder();
        let from = 4 * u64::from(first);
        encoder.copy_buffer_to_buffer(&self.state, from, &staging, 0, Some(bytes));
        self.gpu.queue().submit([encoder.finish()]);
        let bytes = self.mapped(&staging, bytes, None)?;
        let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        Ok(bytes.chunks_exact(4).map(word).collect())
    }

    /// Brings all state to the CPU.
    pub(super) fn download(&self, buffers: &mut [Buffer]) -> Result<()> {
        for (span, buffer) in self.spans.iter().zip(buffers) {
            let (now, before) = self.halves(span);
            buffer.current = self.read_words(now, span.words)?;
            if span.history {
                buffer.previous = self.read_words(before, span.words)?;
            }
        }
        Ok(())
    }

    /// Brings all state from the CPU.
    pub(super) fn upload(&self, buffers: &[Buffer]) {
        let queue = self.gpu.queue();
        for (span, buffer) in self.spans.iter().zip(buffers) {
            let (now, before) = self.halves(span);
            let at = |first: u32| 4 * u64::from(first);
            queue.write_buffer(&self.state, at(now), bytemuck::cast_slice(&buffer.current));
            if span.history {
                queue.write_buffer(&self.state, at(before), bytemuck::cast_slice(&buffer.previous));
            }
        }
    }
}

/// The pipelines of a plan's passes.
fn compile(
    gpu: &Gpu,
    twins: &[Twin],
    plan: &Plan,
    shot: Shot,
    scene: &SceneConstants,
) -> Result<Vec<Ready>> {
    let most = gpu.device().limits().max_compute_workgroups_per_dimension;
    let passes = plan.passes.iter().zip(twins);
    passes
        .map(|(pass, twin)| {
            let [width, height] = workgroup(pass.domain);
            let invocations = gpu.device().limits().max_compute_invocations_per_workgroup;
            if width * height > invocations {
                return Err(Error::gpu(format!(
                    "pass `{}` has tiles of {width} x {height}, but {} runs at most {invocations} pixels a tile",
                    pass.name,
                    gpu.info()
                )));
            }
            let shader = Shader::new(twin, pass.domain, scene);
            let groups = groups(pass.domain, shot.size);
            if groups[0].max(groups[1]) > most {
                return Err(Error::gpu(format!(
                    "pass `{}` takes {} x {} workgroups, but {} runs at most {most} a dimension",
                    pass.name,
                    groups[0],
                    groups[1],
                    gpu.info()
                )));
            }
            Ok(Ready { pipeline: gpu.pipeline(&shader)?, groups })
        })
        .collect()
}

fn camera(rays: &CameraRays) -> CameraRecord {
    let [origin, corner, right, down] = rays.parts().map(|v: Vec3| v.extend(0.0).to_array());
    CameraRecord { origin, corner, right, down }
}

pub(crate) fn bind(
    gpu: &Gpu,
    scene: &SceneBuffers,
    inputs: &wgpu::Buffer,
    state: &wgpu::Buffer,
    counters: &wgpu::Buffer,
) -> wgpu::BindGroup {
    let [nodes, geometry, words, texels] = scene.buffers();
    let all = [inputs, nodes, geometry, words, texels, state, counters];
    let entries: Vec<wgpu::BindGroupEntry<'_>> = all
        .iter()
        .enumerate()
        .map(|(binding, buffer)| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: buffer.as_entire_binding(),
        })
        .collect();
    gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("a loop's buffers"),
        layout: gpu.layout(),
        entries: &entries,
    })
}
