//! A rendered frame.

use std::sync::Arc;

use glam::Vec3;

use super::runner::Runner;
use super::{FrameLoop, Guides};
use crate::counters::Counters;
use crate::picture::Picture;
use crate::plan::{BufferId, Plan};
use crate::world::Built;

/// One rendered frame, borrowed from the loop.
#[derive(Debug)]
pub struct Frame<'a> {
    pub(super) frame_loop: &'a FrameLoop,
    /// From 0 after every restart.
    pub index: u32,
    /// Work done in this frame.
    pub counters: Counters,
    /// Milliseconds of each pass that ran, in order; the scene's update comes first where anything
    /// moves.
    pub passes: &'a [(&'static str, f64)],
}

impl Frame<'_> {
    /// The frame's estimate: all light but what is emitted directly towards the camera.
    #[must_use]
    pub fn picture(&self) -> Picture {
        self.picture_of(Plan::RADIANCE)
    }

    /// Directly visible emission and sky: part of the picture, left out of every metric.
    #[must_use]
    pub fn emission(&self) -> Picture {
        self.picture_of(Plan::EMISSION)
    }

    fn picture_of(&self, id: BufferId) -> Picture {
        let FrameLoop { buffers, shot, .. } = self.frame_loop;
        let values: &[[f32; 3]] = bytemuck::cast_slice(&buffers[id.0].current);
        let [width, height] = shot.size;
        Picture::new(width, height, values.iter().map(|rgb| Vec3::from_array(*rgb)).collect())
    }

    /// What this frame left in the plan's buffer `name`, such as `reservoirs`; `None` where the
    /// plan has no such buffer, or one whose elements are no whole number of `T`, and while later
    /// frames are under way.
    #[must_use]
    pub fn buffer<T: bytemuck::Pod>(&self, name: &str) -> Option<&[T]> {
        let FrameLoop { plan, runner, buffers, under_way, .. } = self.frame_loop;
        let id = plan.buffer(name)?;
        let words = match runner {
            Runner::Cpu => &buffers[id.0].current,
            Runner::Gpu(_) if *under_way > 0 => return None,
            Runner::Gpu(device) => device.buffer(id)?,
        };
        bytemuck::try_cast_slice(words).ok()
    }

    /// Albedo, normal, depth and motion through pixel centres. Traced here, in no pass's time.
    #[must_use]
    pub fn guides(&self) -> Guides {
        let FrameLoop { shown: (world, previous), shot, .. } = self.frame_loop;
        Guides::new(world, previous.as_deref(), shot.size)
    }

    /// What had to be made of the scene for this frame: nothing in a first frame, whose world
    /// belongs to loading, nor where nothing moves.
    #[must_use]
    pub fn built(&self) -> Built {
        match &self.frame_loop.shown {
            (now, Some(before)) if !Arc::ptr_eq(now, before) => now.built(),
            _ => Built::default(),
        }
    }

    /// Milliseconds of all passes.
    #[must_use]
    pub fn milliseconds(&self) -> f64 {
        self.passes.iter().map(|(_, ms)| ms).sum()
    }
}
