//! Which of the two backends runs a loop's passes.

use std::sync::Arc;

use super::{Backend, gpu};
use crate::error::Result;
use crate::plan::{Plan, Shot};
use crate::techniques::Technique;
use crate::world::World;

/// What runs a loop's passes.
#[derive(Debug)]
pub(super) enum Runner {
    /// The threads of the caller's pool; the loop's buffers hold the state.
    Cpu,
    /// A graphics processor, which holds the state. Without the feature `gpu` there is no such
    /// value.
    Gpu(Box<gpu::Device>),
}

impl Runner {
    /// A technique that lacks kernels for a device runs on the CPU. `how` is the shot, and whether
    /// anything moves.
    pub(super) fn new(
        backend: &Backend,
        technique: &dyn Technique,
        plan: &Plan,
        world: &Arc<World>,
        how: (Shot, bool),
    ) -> Result<Self> {
        let device = gpu::Device::new(backend, technique, plan, world, how)?;
        Ok(device.map_or(Self::Cpu, |device| Self::Gpu(Box::new(device))))
    }
}
