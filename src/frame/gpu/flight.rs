//! A loop's part that a graphics processor runs: frames under way, from submission to reading back.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use super::runner::{DeviceRunner, FrameState, Submitted, twins};
use crate::counters::Counters;
use crate::error::Result;
use crate::frame::{Backend, FrameLoop};
use crate::pass::Buffer;
use crate::plan::{BufferId, Plan, Shot};
use crate::scene::CameraRays;
use crate::techniques::Technique;
use crate::twin::Twin;
use crate::world::{Motion, World};

/// The part of a loop that a graphics processor runs.
#[derive(Debug)]
pub(crate) struct Device {
    runner: DeviceRunner,
    twins: Vec<Twin>,
    /// Number of a frame's passes that stay on the CPU.
    on_cpu: usize,
    /// Number of a frame's passes that run at all.
    #[cfg(test)]
    pub(in crate::frame) stop_after: usize,
    /// Whether the state is to be cleared before the next frame.
    restarted: bool,
    /// Frames under way, the oldest first.
    flights: VecDeque<Flight>,
    /// Buffers of the newest frame that were read back.
    read: Vec<OnceLock<Vec<u32>>>,
}

/// A frame that the graphics processor works on.
#[derive(Debug)]
struct Flight {
    index: u32,
    /// Work of the passes that ran on the CPU.
    counters: Counters,
    passes: Vec<(&'static str, f64)>,
    submitted: Submitted,
    shown: (Arc<World>, Option<Arc<World>>),
}

/// A frame that is done; its pictures lie in the loop's buffers.
#[derive(Debug)]
pub(in crate::frame) struct Landed {
    pub(in crate::frame) index: u32,
    pub(in crate::frame) counters: Counters,
    pub(in crate::frame) passes: Vec<(&'static str, f64)>,
    /// The worlds of the frame and of the one before.
    pub(in crate::frame) shown: (Arc<World>, Option<Arc<World>>),
}

impl Device {
    /// `None`: the backend is the CPU, or the technique lacks twins.
    pub(in crate::frame) fn new(
        backend: &Backend,
        technique: &dyn Technique,
        plan: &Plan,
        world: &Arc<World>,
        how: (Shot, bool),
    ) -> Result<Option<Self>> {
        let Backend::Gpu(gpu) = backend else { return Ok(None) };
        let Some(twins) = twins(technique, plan) else { return Ok(None) };
        let runner = DeviceRunner::new(gpu.clone(), &twins, plan, world, how)?;
        let read = plan.buffers.iter().map(|_| OnceLock::new()).collect();
        Ok(Some(Self {
            runner,
            twins,
            on_cpu: 0,
            #[cfg(test)]
            stop_after: usize::MAX,
            restarted: false,
            flights: VecDeque::new(),
            read,
        }))
    }

    /// The device's name.
    pub(in crate::frame) fn name(&self) -> String {
        self.runner.gpu().info().to_string()
    }

    /// Bytes of the scene on the device.
    pub(in crate::frame) fn scene_bytes(&self) -> u64 {
        self.runner.scene_bytes()
    }

    /// Bytes of the scene that were sent for the frame that was begun last.
    pub(in crate::frame) fn sent_bytes(&self) -> u64 {
        self.runner.sent_bytes()
    }

    /// The first `passes` passes of a frame stay on the CPU.
    pub(in crate::frame) fn run_on_cpu(&mut self, passes: usize) {
        self.on_cpu = passes;
    }

    /// All state is cleared before the next frame; frames under way are forgotten.
    pub(in crate::frame) fn restart(&mut self) {
        self.restarted = true;
        self.flights.clear();
    }

    /// Prepares a frame; how many of its chosen passes the CPU is to run.
    pub(in crate::frame) fn begin(
        &mut self,
        frames: &mut FrameLoop,
        motion: Option<&Motion>,
        camera: &CameraRays,
        index: u32,
    ) -> Result<usize> {
        #[cfg(test)]
        frames.chosen.truncate(self.stop_after);
        let Self { runner, twins, on_cpu, restarted, read, .. } = self;
        read.iter_mut().for_each(|buffer| drop(buffer.take()));
        if *restarted {
            runner.restart(&frames.world, (twins, &frames.plan, frames.shot))?;
            *restarted = false;
        }
        let state = FrameState {
            world: &frames.world,
            previous: frames.previous.as_deref(),
            camera,
            motion,
            shot: frames.shot,
            index,
        };
        let begin = Instant::now();
        runner.begin(&state, (twins, &frames.plan))?;
        if let Some((_, ms)) = frames.passes.first_mut() {
            // What moved has to be sent, too.
            *ms += begin.elapsed().as_secs_f64() * 1e3;
        }
        Ok(frames.chosen.len().min(*on_cpu))
    }

    /// Brings all state to the CPU.
    pub(in crate::frame) fn download(&self, buffers: &mut [Buffer]) -> Result<()> {
        self.runner.download(buffers)
    }

    /// Brings all state from the CPU.
    pub(in crate::frame) fn upload(&self, buffers: &[Buffer]) {
        self.runner.upload(buffers);
    }

    /// Starts the chosen passes from number `first` on; `counters` are the work of those before.
    pub(in crate::frame) fn submit(
        &mut self,
        frames: &mut FrameLoop,
        first: usize,
        counters: Counters,
        index: u32,
    ) {
        self.flights.push_back(Flight {
            index,
            counters,
            passes: std::mem::take(&mut frames.passes),
            submitted: self.runner.submit(&frames.chosen[first..], &frames.plan),
            shown: (frames.world.clone(), frames.previous.clone()),
        });
    }

    /// Waits for the oldest frame under way; `None` where there is none.
    pub(in crate::frame) fn collect(
        &mut self,
        plan: &Plan,
        buffers: &mut [Buffer],
    ) -> Result<Option<Landed>> {
        let Some(flight) = self.flights.pop_front() else { return Ok(None) };
        let Flight { index, counters, mut passes, submitted, shown } = flight;
        let work = self.runner.collect(submitted, plan, buffers, &mut passes)?;
        Ok(Some(Landed { index, counters: counters + work, passes, shown }))
    }

    /// The words of a buffer as the newest frame left them; `None` where reading back failed, which
    /// the next frame reports.
    pub(in crate::frame) fn buffer(&self, id: BufferId) -> Option<&Vec<u32>> {
        let copy = &self.read[id.0];
        if copy.get().is_none() {
            let words = self.runner.read(id.0);
            let words = words.map_err(|e| self.runner.gpu().failed(&e.to_string())).ok()?;
            let _ = copy.set(words);
        }
        copy.get()
    }
}
