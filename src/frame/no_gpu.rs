//! Without the feature `gpu` no device is ever opened: [`Device`] has no value, and what would need
//! one is never run.

use std::sync::Arc;

use super::{Backend, FrameLoop};
use crate::counters::Counters;
use crate::error::Result;
use crate::pass::Buffer;
use crate::plan::{BufferId, Plan, Shot};
use crate::scene::CameraRays;
use crate::techniques::Technique;
use crate::world::{Motion, World};

/// The part of a loop that a graphics processor would run.
#[derive(Debug)]
pub(crate) enum Device {}

/// A frame that is done.
pub(super) struct Landed {
    pub(super) index: u32,
    pub(super) counters: Counters,
    pub(super) passes: Vec<(&'static str, f64)>,
    pub(super) shown: (Arc<World>, Option<Arc<World>>),
}

impl Device {
    pub(super) fn new(
        backend: &Backend,
        _: &dyn Technique,
        _: &Plan,
        _: &Arc<World>,
        _: (Shot, bool),
    ) -> Result<Option<Self>> {
        let Backend::Cpu = backend;
        Ok(None)
    }

    pub(super) fn name(&self) -> String {
        match *self {}
    }

    pub(super) fn scene_bytes(&self) -> u64 {
        match *self {}
    }

    pub(super) fn sent_bytes(&self) -> u64 {
        match *self {}
    }

    pub(super) fn run_on_cpu(&mut self, _: usize) {
        match *self {}
    }

    pub(super) fn restart(&mut self) {
        match *self {}
    }

    pub(super) fn begin(
        &mut self,
        _: &mut FrameLoop,
        _: Option<&Motion>,
        _: &CameraRays,
        _: u32,
    ) -> Result<usize> {
        match *self {}
    }

    pub(super) fn download(&self, _: &mut [Buffer]) -> Result<()> {
        match *self {}
    }

    pub(super) fn upload(&self, _: &[Buffer]) {
        match *self {}
    }

    pub(super) fn submit(&mut self, _: &mut FrameLoop, _: usize, _: Counters, _: u32) {
        match *self {}
    }

    pub(super) fn collect(&mut self, _: &Plan, _: &mut [Buffer]) -> Result<Option<Landed>> {
        match *self {}
    }

    pub(super) fn buffer(&self, _: BufferId) -> Option<&Vec<u32>> {
        match *self {}
    }
}
