//! What a technique's kernel is given: the frame's inputs to read, and a band of its own elements
//! to write.
//!
//! A pass over pixels or items walks over its band. A pass over tiles walks over [`Band::tiles`]:
//! a tile lies in one band and is worked on by one thread, so its lanes exchange state through
//! local arrays of the kernel, one step after another. Tiles at the picture's edges are partial:
//! lanes outside of it have no pixel, and take part in the exchange all the same.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use crate::accel::Hit;
use crate::math::rng::{PathSeeds, Purpose, RandomSource, Stream};
use crate::plan::{BufferId, BufferKey, Filter, Plan, Shot};
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

    /// The buffer of a key.
    ///
    /// # Panics
    /// Where the plan has no such buffer: a technique reads what its own plan made.
    #[inline]
    #[must_use]
    pub fn id<T>(&self, key: BufferKey<T>) -> BufferId {
        self.plan.id(key).unwrap_or_else(|| {
            panic!("the plan of `{}` has no buffer `{}`", self.plan.technique, key.name)
        })
    }

    /// A buffer that an earlier pass of this frame wrote, by its key.
    ///
    /// # Panics
    /// As [`FrameInputs::id`].
    #[inline]
    #[must_use]
    pub fn at<T: Pod>(&self, key: BufferKey<T>) -> &[T] {
        self.read(self.id(key))
    }

    /// A buffer as the previous frame left it, by its key; empty in the first frame.
    ///
    /// # Panics
    /// As [`FrameInputs::id`].
    #[inline]
    #[must_use]
    pub fn at_previous<T: Pod>(&self, key: BufferKey<T>) -> &[T] {
        self.read_previous(self.id(key))
    }

    /// As [`FrameInputs::at`]; nothing where the plan leaves the buffer out.
    #[inline]
    #[must_use]
    pub fn some<T: Pod>(&self, key: BufferKey<T>) -> &[T] {
        self.plan.id(key).map_or(&[], |id| self.read(id))
    }

    /// How many independent estimates a pixel gets in this frame: ⌊effort⌋, or one more where the
    /// pixel's number in a lattice, shifted anew in each frame, is below the effort's fraction.
    ///
    /// The shift is uniform, so every pixel has one more with a probability of just the fraction,
    /// and independently of all estimates: their mean over a frame's own number is unbiased pixel
    /// by pixel. The lattice spreads the pixels that have one more evenly over the picture (the
    /// additive recurrence R₂ of Roberts 2018, *The Unreasonable Effectiveness of Quasirandom
    /// Sequences*).
    #[inline]
    #[must_use]
    pub fn estimates(&self, pixel: Pixel) -> u32 {
        let [fewest, most] = self.shot.estimates();
        if fewest == most {
            return fewest;
        }
        // 2³² / φ₂ and 2³² / φ₂², with φ₂ = 1.3247… the real root of x³ = x + 1.
        let place =
            pixel.x.wrapping_mul(3_242_174_889).wrapping_add(pixel.y.wrapping_mul(2_447_445_414));
        let shift = self.stream(0, Purpose::Effort, 0).word();
        fewest + u32::from(place.wrapping_add(shift) < self.shot.extra_share())
    }

    /// Unit direction of a pixel's first primary ray.
    #[inline]
    #[must_use]
    pub fn primary_direction(&self, pixel: Pixel) -> Vec3 {
        self.camera.ray(self.sample_position(pixel.x, pixel.y, 0)).direction
    }

    /// The same in the previous frame; `None` in the first, and where nothing moves.
    #[inline]
    #[must_use]
    pub fn primary_direction_before(&self, pixel: Pixel) -> Option<Vec3> {
        let frame = self.frame.wrapping_sub(1);
        let position = self.sample_position_in(frame, pixel.x, pixel.y, 0);
        Some(self.motion?.camera.ray(position).direction)
    }

    /// The path seeds of a pixel in this frame: the only place that makes them.
    #[inline]
    #[must_use]
    pub fn seeds(&self, pixel: u32) -> PathSeeds {
        PathSeeds::new(self.shot.run, pixel, self.frame)
    }

    /// The numbers of a cell (a pixel, tile or item) in this frame for one purpose and round.
    #[inline]
    #[must_use]
    pub fn stream(&self, cell: u32, purpose: Purpose, round: u32) -> Stream {
        Stream::new(self.shot.run, cell, self.frame, purpose, round)
    }

    /// Where the surface point of a hit of this frame was in the previous frame; `None` in the
    /// first frame, without motion between the frames, and where the surface was not there.
    #[inline]
    #[must_use]
    pub fn position_before(&self, hit: &Hit) -> Option<Vec3> {
        self.motion?.position(self.previous?, self.world, hit)
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

/// A pixel of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pixel {
    /// Its place in the picture's buffers, row by row.
    pub index: u32,
    /// Its column.
    pub x: u32,
    /// Its row.
    pub y: u32,
}

/// The grid of a pass over tiles in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    /// Pixels across and down a tile.
    pub size: [u32; 2],
    /// The grid begins at −origin; below `size`.
    pub origin: [u32; 2],
}

/// One tile of a grid; its lanes are numbered row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// The tile's number in its grid, row by row.
    pub index: u32,
    corner: [i64; 2],
    size: [u32; 2],
    picture: [u32; 2],
}

impl Tile {
    /// Lanes of a whole tile.
    #[inline]
    #[must_use]
    pub fn lanes(&self) -> u32 {
        self.size[0] * self.size[1]
    }

    /// The pixel of a lane; `None` outside of the picture.
    #[inline]
    #[must_use]
    pub fn pixel(&self, lane: u32) -> Option<Pixel> {
        let x = self.corner[0] + i64::from(lane % self.size[0]);
        let y = self.corner[1] + i64::from(lane / self.size[0]);
        let [width, height] = self.picture.map(i64::from);
        ((0..width).contains(&x) && (0..height).contains(&y)).then(|| {
            let (x, y) = (x as u32, y as u32);
            Pixel { index: y * self.picture[0] + x, x, y }
        })
    }
}

/// The elements that one task of a pass owns: whole rows of the picture, or a range of items.
#[derive(Debug)]
pub struct Band<'a> {
    /// Rows of pixels, or items.
    pub range: Range<u32>,
    /// Elements a row: the picture's width, or 1 for items.
    pub width: u32,
    grid: Option<TileGrid>,
    writes: [BufferId; MAX_WRITES],
    slots: [&'a mut [u32]; MAX_WRITES],
}

impl<'a> Band<'a> {
    /// A band with its part of each of the buffers `writes`, in their order.
    #[must_use]
    pub fn new(
        range: Range<u32>,
        width: u32,
        writes: &[BufferId],
        slots: [&'a mut [u32]; MAX_WRITES],
    ) -> Self {
        let none = BufferId(usize::MAX);
        let writes = std::array::from_fn(|slot| writes.get(slot).copied().unwrap_or(none));
        Self { range, width, grid: None, writes, slots }
    }

    /// The same band of a pass over tiles; its rows begin and end where tiles do, or where the
    /// picture does.
    #[must_use]
    pub fn with_tiles(self, grid: TileGrid) -> Self {
        Self { grid: Some(grid), ..self }
    }

    /// The band's elements of a buffer that the pass writes, row by row; each can be taken once.
    ///
    /// # Panics
    /// Where the pass does not write the buffer, or it was taken already.
    #[inline]
    #[must_use]
    pub fn take<T: Pod>(&mut self, id: BufferId) -> &'a mut [T] {
        let slot = self.writes.iter().position(|written| *written == id);
        let slot = slot.unwrap_or_else(|| panic!("the pass does not write buffer {}", id.0));
        self.writes[slot] = BufferId(usize::MAX);
        bytemuck::cast_slice_mut(std::mem::take(&mut self.slots[slot]))
    }

    /// As [`Band::take`]; nothing for a buffer that the plan leaves out.
    #[inline]
    #[must_use]
    pub fn take_some<T: Pod>(&mut self, id: Option<BufferId>) -> &'a mut [T] {
        id.map_or(&mut [], |id| self.take(id))
    }

    /// The band's pixels, row by row.
    #[inline]
    pub fn pixels(&self) -> impl Iterator<Item = Pixel> + use<> {
        let (rows, width) = (self.range.clone(), self.width);
        rows.flat_map(move |y| (0..width).map(move |x| Pixel { index: y * width + x, x, y }))
    }

    /// Where a pixel of the band lies in what [`Band::take`] gives.
    #[inline]
    #[must_use]
    pub fn local(&self, pixel: Pixel) -> usize {
        (pixel.index - self.range.start * self.width) as usize
    }

    /// The band's tiles in a picture of `size` pixels, row by row.
    ///
    /// # Panics
    /// Where the pass has another domain.
    pub fn tiles(&self, size: [u32; 2]) -> impl Iterator<Item = Tile> + use<> {
        let TileGrid { size: tile, origin } = self.grid.expect("a pass over tiles");
        let columns = (size[0] + origin[0]).div_ceil(tile[0]);
        let first = (self.range.start + origin[1]) / tile[1];
        let end = (self.range.end + origin[1]).div_ceil(tile[1]);
        (first..end).flat_map(move |row| {
            (0..columns).map(move |column| {
                let corner = |at: u32, axis: usize| {
                    i64::from(at) * i64::from(tile[axis]) - i64::from(origin[axis])
                };
                Tile {
                    index: row * columns + column,
                    corner: [corner(column, 0), corner(row, 1)],
                    size: tile,
                    picture: size,
                }
            })
        })
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
