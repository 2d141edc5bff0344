//! What a scene needs ([`SceneFacts`]) and what a technique will therefore run ([`Plan`]): plain
//! data, made once, printed by `afterimage plan`.

mod builder;
mod facts;
mod shot;

use std::fmt;
use std::marker::PhantomData;

pub use builder::{Builder, NewPass};
pub use facts::SceneFacts;
pub use shot::{Filter, Shot};

use crate::math::rng::{Purpose, RandomSource, Stream};
pub use crate::resampling::Claim;

/// A per-pixel or per-item buffer of the frame loop, by its place in [`Plan::buffers`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferId(pub usize);

/// A buffer by its name, with the type of its elements. A technique declares a constant for each of
/// its buffers, makes the buffer by it ([`Builder::buffer`]) and finds it by it ([`Plan::id`]), so
/// neither a name nor a type is written twice.
pub struct BufferKey<T> {
    /// The buffer's name, for people and for hosts ([`Plan::buffer`]).
    pub name: &'static str,
    element: PhantomData<fn() -> T>,
}

impl<T> BufferKey<T> {
    /// The key of the buffer `name`.
    #[must_use]
    pub const fn new(name: &'static str) -> Self {
        Self { name, element: PhantomData }
    }
}

impl<T> Clone for BufferKey<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for BufferKey<T> {}

impl<T> fmt::Debug for BufferKey<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("BufferKey").field(&self.name).finish()
    }
}

/// Untyped state, the same bytes on every backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferPlan {
    /// For people and for bisecting.
    pub name: &'static str,
    /// Bytes an element; a multiple of 4.
    pub bytes: u32,
    /// Number of elements.
    pub elements: Elements,
    /// Whether last frame's contents are kept beside this frame's.
    pub history: bool,
}

/// How many elements a buffer has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elements {
    /// One a pixel.
    Pixels,
    /// A fixed number.
    Items(u32),
}

/// What one run of a pass's kernel owns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// One pixel.
    Pixels,
    /// A tile of pixels whose lanes may exchange state.
    Tiles {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Where the grid of tiles begins.
        grid: Grid,
    },
    /// One of n items.
    Items(u32),
}

/// Where a grid of tiles begins: at −origin, so that origin (0, 0) begins it at the upper left
/// pixel. Tiles at the picture's edges are partial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grid {
    /// At the same origin in all frames.
    Fixed([u32; 2]),
    /// At an origin that is drawn anew in each frame, uniformly over a tile's pixels, from the
    /// stream (run, 0, frame, purpose, 0).
    PerFrame(Purpose),
}

impl Grid {
    /// The origin in a frame of a run, below `tile` in both coordinates.
    #[must_use]
    pub fn origin(self, tile: [u32; 2], run: u64, frame: u32) -> [u32; 2] {
        match self {
            Self::Fixed(origin) => [origin[0] % tile[0], origin[1] % tile[1]],
            Self::PerFrame(purpose) => {
                let mut random = Stream::new(run, 0, frame, purpose, 0);
                tile.map(|side| random.index(side))
            }
        }
    }
}

/// Who runs a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// The frame loop: primary hits.
    PrimaryHits,
    /// The technique, by a number of its own.
    Technique(u32),
}

/// One pass over a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pass {
    /// For people and timings.
    pub name: &'static str,
    /// Who runs it.
    pub kernel: Kernel,
    /// What one run owns.
    pub domain: Domain,
    /// Buffers of which it writes its own elements.
    pub writes: Vec<BufferId>,
    /// When it runs.
    pub runs: Runs,
    /// Most rays a pixel, by kind: see [`Plan::RAY_KINDS`].
    pub rays: [u64; 4],
}

/// In which frames a pass runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Runs {
    /// In all.
    #[default]
    Always,
    /// In the first only, because its result never changes.
    Once,
    /// In all but the first, which has no history.
    WithHistory,
}

/// Something that a scene does not need.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skip {
    /// What is left out.
    pub what: &'static str,
    /// The fact that allows it.
    pub because: &'static str,
}

/// What a technique will run for a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The technique's SPEC.
    pub technique: String,
    /// In order.
    pub passes: Vec<Pass>,
    /// All state; the first three are always [`Plan::HITS`], [`Plan::RADIANCE`],
    /// [`Plan::EMISSION`].
    pub buffers: Vec<BufferPlan>,
    /// What is left out, and why.
    pub skipped: Vec<Skip>,
    /// What kernels are specialised on: fixed for all frames, so that no ray asks.
    pub constants: Vec<(&'static str, u32)>,
    /// Whether every frame has the same receivers, lights and occluders: nothing moves, and the
    /// filter is a point.
    pub still: bool,
    /// Whether the effort counts chains of reservoirs, so that it must be whole.
    pub chains: bool,
    /// Whether kernels ask which emitters a ray meets ([`crate::world::World::emitters`]).
    pub emitters: bool,
    /// Whether the answer is exact in the mean.
    pub claim: Claim,
}

impl Plan {
    /// Primary hits: [`crate::accel::Hit`] as 20 bytes.
    pub const HITS: BufferId = BufferId(0);
    /// The frame's result without directly visible emission: 3 floats.
    pub const RADIANCE: BufferId = BufferId(1);
    /// Directly visible emission and sky: 3 floats.
    pub const EMISSION: BufferId = BufferId(2);

    /// Names of the kinds of rays.
    pub const RAY_KINDS: [&'static str; 4] = ["primary", "bounce", "shadow", "emitter"];

    /// A buffer by its name.
    #[must_use]
    pub fn buffer(&self, name: &str) -> Option<BufferId> {
        self.buffers.iter().position(|buffer| buffer.name == name).map(BufferId)
    }

    /// The buffer of a key; `None` where the plan leaves it out.
    #[must_use]
    pub fn id<T>(&self, key: BufferKey<T>) -> Option<BufferId> {
        self.buffer(key.name)
    }

    /// A constant by its name; `None` where the plan has none of that name.
    #[must_use]
    pub fn constant(&self, name: &str) -> Option<u32> {
        self.constants.iter().find(|(known, _)| *known == name).map(|(_, value)| *value)
    }

    /// Most rays a pixel and frame, by kind: see [`Plan::RAY_KINDS`].
    #[must_use]
    pub fn rays_per_pixel(&self) -> [u64; 4] {
        self.passes.iter().fold([0; 4], |sum, pass| {
            std::array::from_fn(|kind| sum[kind].saturating_add(pass.rays[kind]))
        })
    }

    /// Whether what was in earlier frames changes later ones.
    #[must_use]
    pub fn keeps_history(&self) -> bool {
        self.buffers.iter().any(|buffer| buffer.history)
            || self.passes.iter().any(|pass| pass.runs == Runs::WithHistory)
    }

    /// The buffers that every plan begins with.
    #[must_use]
    pub fn standard_buffers() -> Vec<BufferPlan> {
        let pixels =
            |name, bytes| BufferPlan { name, bytes, elements: Elements::Pixels, history: false };
        vec![pixels("hits", 20), pixels("radiance", 12), pixels("emission", 12)]
    }

    /// Bytes a pixel of all buffers, history counted twice, for a picture of `pixels` pixels.
    #[must_use]
    pub fn bytes_per_pixel(&self, pixels: usize) -> f64 {
        self.buffers
            .iter()
            .map(|buffer| {
                let copies = if buffer.history { 2.0 } else { 1.0 };
                let share = match buffer.elements {
                    Elements::Pixels => 1.0,
                    Elements::Items(n) => f64::from(n) / pixels as f64,
                };
                f64::from(buffer.bytes) * copies * share
            })
            .sum()
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "technique  {}", self.technique)?;
        writeln!(f, "claim      {}", self.claim)?;
        let rays: Vec<String> = Self::RAY_KINDS
            .iter()
            .zip(self.rays_per_pixel())
            .map(|(kind, most)| format!("{most} {kind}"))
            .collect();
        writeln!(f, "rays       at most {} a pixel and frame", rays.join(", "))?;
        writeln!(f, "passes")?;
        for pass in &self.passes {
            let domain = match pass.domain {
                Domain::Pixels => "pixels".to_string(),
                Domain::Tiles { width, height, .. } => format!("tiles of {width} x {height}"),
                Domain::Items(n) => format!("{n} items"),
            };
            let writes: Vec<&str> = pass.writes.iter().map(|id| self.buffers[id.0].name).collect();
            let runs = match pass.runs {
                Runs::Always => "",
                Runs::Once => ", first frame only",
                Runs::WithHistory => ", not in the first frame",
            };
            writeln!(f, "  {:<12} {domain}{runs}; writes {}", pass.name, writes.join(", "))?;
        }
        writeln!(f, "state")?;
        for buffer in &self.buffers {
            let per = match buffer.elements {
                Elements::Pixels => "a pixel".to_string(),
                Elements::Items(n) => format!("an item, {n} items"),
            };
            let history = if buffer.history { ", two frames" } else { "" };
            writeln!(f, "  {:<12} {} bytes {per}{history}", buffer.name, buffer.bytes)?;
        }
        if !self.constants.is_empty() {
            let constants: Vec<String> =
                self.constants.iter().map(|(name, value)| format!("{name} {value}")).collect();
            writeln!(f, "fixed\n  {}", constants.join(", "))?;
        }
        writeln!(f, "left out")?;
        for skip in &self.skipped {
            writeln!(f, "  {} (because {})", skip.what, skip.because)?;
        }
        if self.skipped.is_empty() {
            writeln!(f, "  nothing")?;
        }
        Ok(())
    }
}
