//! What a technique's kernel is given: the frame's inputs to read, and a band of its own elements to write.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::Vec2;

use crate::accel::Hit;
use crate::math::rng::{Purpose, RandomSource, Stream};
use crate::plan::{BufferId, Filter, Plan, Shot};
use crate::scene::CameraRays;
use crate::world::{Motion, World};

/// Most buffers that one pass may write.
pub const MAX_WRITES: usize = 6;

/// One buffer of the loop: this frame's words and, with history, last frame's.
#[derive(Clone, Debug, Default)]
pub struct Buffer {
    /// This frame's; empty while a pass writes it.
    pub current: Vec<u32>,
    /// Last frame's; empty without history and in the first frame.
    pub previous: Vec<u32>,
}

/// Everything a kernel may read.
#[derive(Clone, Copy, Debug)]
pub struct FrameInputs<'a> {
    /// The scene now.
    pub world: &'a World,
    /// The scene in the previous frame; `None` in the first.
    pub previous: Option<&'a World>,
    /// What is rendered.
    pub shot: Shot,
    /// What runs, with its constants.
    pub plan: &'a Plan,
    /// Primary rays now.
    pub camera: CameraRays,
    /// What leads from the previous frame to this one; `None` in the first.
    pub motion: Option<&'a Motion>,
    /// From 0 after every restart.
    pub frame: u32,
    /// The loop's buffers by [`BufferId`].
    pub buffers: &'a [Buffer],
}

impl FrameInputs<'_> {
    /// A buffer that an earlier pass of this frame wrote.
    #[inline]
    #[must_use]
    pub fn read<T: Pod>(&self, id: BufferId) -> &[T] {
        bytemuck::cast_slice(&self.buffers[id.0].current)
    }

    /// A buffer as the previous frame left it; empty in the first frame.
    #[inline]
    #[must_use]
    pub fn read_previous<T: Pod>(&self, id: BufferId) -> &[T] {
        bytemuck::cast_slice(&self.buffers[id.0].previous)
    }

    /// Where sample `sample` of a pixel lies, in pixels from the upper left corner.
    #[inline]
    #[must_use]
    pub fn sample_position(&self, x: u32, y: u32, sample: u32) -> Vec2 {
        self.sample_position_in(self.frame, x, y, sample)
    }

    /// As [`sample_position`](Self::sample_position), in another frame of the same run.
    #[inline]
    #[must_use]
    pub fn sample_position_in(&self, frame: u32, x: u32, y: u32, sample: u32) -> Vec2 {
        let corner = Vec2::new(x as f32, y as f32);
        match self.shot.filter {
            Filter::Point => corner + 0.5,
            Filter::Box => {
                let pixel = y * self.shot.size[0] + x;
                let mut jitter = Stream::new(self.shot.run, pixel, frame, Purpose::Jitter, sample);
                corner + Vec2::new(jitter.uniform(), jitter.uniform())
            }
        }
    }
}

/// The elements that one task of a pass owns: whole rows of the picture, or a range of items.
#[derive(Debug)]
pub struct Band<'a> {
    /// Rows of pixels, or items.
    pub range: Range<u32>,
    /// Elements a row: the picture's width, or 1 for items.
    pub width: u32,
    slots: [&'a mut [u32]; MAX_WRITES],
}

impl<'a> Band<'a> {
    /// A band with its part of each written buffer, in the order of the pass's list.
    #[must_use]
    pub fn new(range: Range<u32>, width: u32, slots: [&'a mut [u32]; MAX_WRITES]) -> Self {
        Self { range, width, slots }
    }

    /// The band's elements of the pass's written buffer number `slot`, row by row. Each slot can be taken once.
    #[inline]
    #[must_use]
    pub fn take<T: Pod>(&mut self, slot: usize) -> &'a mut [T] {
        bytemuck::cast_slice_mut(std::mem::take(&mut self.slots[slot]))
    }
}

/// A primary hit as it lies in the loop's buffer: 20 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PrimaryHit {
    t: f32,
    u: f32,
    v: f32,
    primitive: u32,
    instance: u32,
}

impl PrimaryHit {
    /// Distance from the camera; +∞ where the ray left the scene.
    #[inline]
    #[must_use]
    pub fn distance(&self) -> f32 {
        self.t
    }

    /// The hit, or `None` where the ray left the scene.
    #[inline]
    #[must_use]
    pub fn get(&self) -> Option<Hit> {
        let Self { t, u, v, primitive, instance } = *self;
        (primitive != u32::MAX).then_some(Hit { t, u, v, primitive, instance })
    }
}

impl From<Option<Hit>> for PrimaryHit {
    #[inline]
    fn from(hit: Option<Hit>) -> Self {
        match hit {
            Some(Hit { t, u, v, primitive, instance }) => Self { t, u, v, primitive, instance },
            None => {
                Self { t: f32::INFINITY, u: 0.0, v: 0.0, primitive: u32::MAX, instance: u32::MAX }
            }
        }
    }
}
