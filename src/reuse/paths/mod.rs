//! Light along paths at a primary hit: the domain whose samples are the random numbers of a path.
//!
//! | here | meaning |
//! |---|---|
//! | v₀ … `v_n` | the vertices that scatter; v₀ is the primary hit, n is [`PathSample::last`] |
//! | end | a light that `v_n` sampled, an emitter or a sky that its direction met |
//! | F | Π f/p̄ · L ω: the integrand in primary sample space, with p̄ the density of the direction over all lobes and ω the share of the end's technique; roulette is no part of it |
//! | p̂ | luminance of F |
//! | W | 1/density of the numbers: 1 for a fresh path ([`crate::resampling::PrimarySample`]) |
//! | `x_r` | the reconnection vertex: what a shift keeps of the path from there on; `v_r`, or the end |
//! | ℓᵢ | the lobe that vᵢ scattered by |
//! | p(ω, ℓ) | joint density of lobe and direction per solid angle |
//!
//! A reservoir may hold *either* such a path *or* a light point of the primary hit
//! ([`Ending::Direct`]): direct light has the candidates and the measure that it has in
//! `restir-di`, all other light is a path. The two parts do not overlap, and no shift leads from
//! one to the other.
//!
//! A path's first connectable pair decides `x_r`: vertices far enough apart, both rough
//! ([`Connects`]). It is found from the path's own vertices and lobes alone: a path that ends with
//! a light sample at `v_n` knows nothing of the direction that the walk takes from there
//! afterwards.
//!
//! Papers: Lin et al. (2022), *Generalized Resampled Importance Sampling*; its numbering has x₁ for
//! our v₀.

mod domain;
mod ends;
mod failure;
mod frames;
mod layers;
mod mutate;
mod next;
mod record;
mod replay;
mod shift;
mod suffix;
mod trail;
mod tree;

use glam::Vec3;

pub(crate) use domain::{Fresh, Paths};
pub use failure::Failure;
pub(crate) use layers::{Kept, layers};
pub use mutate::{PathMutator, PathState};
pub use next::{Next, Place};
pub(crate) use record::Records;
pub use record::{MutableRecord, PathRecord};
pub use shift::{PathReceiver, PathShift};
pub use tree::Tree;

use crate::accel::Hit;
use crate::light::LightPoint;
use crate::math::luminance;
use crate::spec::Choice;

/// Most segments of a path: a record counts its vertices and its end in 8 bits.
pub const MOST_SEGMENTS: u32 = 256;

/// No lobe: a light sample takes all that are not deltas, and an end has none.
pub const NO_LOBE: u8 = 7;

/// How a path ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// By a light that the last vertex sampled.
    Light {
        /// Whether BSDF sampling cannot find it, so that ω is 1.
        delta: bool,
    },
    /// At an emitter that the last vertex's direction met.
    Emitter,
    /// In a sky.
    Sky {
        /// Its number among the skies of its world.
        sky: u32,
    },
    /// At a light point that the primary hit's candidates chose, as in `restir-di`: n is 0, no seed
    /// belongs to it, F = f |cos| L G is in the measure of the light, and so is W.
    Direct,
}

/// What a shift keeps at `x_r`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Anchor {
    /// The surface at a hit (its t is of no use elsewhere, and 0): a vertex that scatters, or an
    /// emitter.
    Surface(Hit),
    /// A point on a light: the end of a path by a light sample.
    Point(LightPoint),
    /// A direction towards the sky that is light number `light`.
    Sky {
        /// In the light table.
        light: u32,
    },
}

/// Where a shifted path meets the path that it is shifted from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reconnection {
    /// r ≥ 1; r = n + 1 is the end.
    pub vertex: u8,
    /// `ℓ_{r−1}` and `ℓ_r`.
    pub lobes: [u8; 2],
    /// What is kept.
    pub anchor: Anchor,
    /// Unit direction from `x_r` onward, or to the sky that is `x_r`; 0 where `x_r` is an emitter
    /// or a point on a light, to which the direction is another one elsewhere.
    pub direction: Vec3,
    /// Where r < n: Π f/p̄ of `v_{r+1}` … `v_n`, times the light and its ω. Where r = n: the light
    /// alone, since ω depends on what comes before `x_r`. For a sky its light; for an emitter or a
    /// point on a light 0, since it depends on the direction.
    pub radiance: Vec3,
    /// The path's part of \|∂T\|: p(`ω_{r−1}`, `ℓ_{r−1}`) g p(`ω_r`, `ℓ_r`), with g = \|cos\|/d² at
    /// `x_r` by its geometric normal. Without the last factor where the light at `v_r` is sampled
    /// or `x_r` is an emitter; p(ω, ℓ) alone for a sky; for a point on a light the density of light
    /// sampling, in the light's measure; 1 for [`Ending::Direct`].
    pub density: f32,
    /// p ℓ of the end at `v_n` per solid angle, where r = n; else 0.
    pub light_density: f32,
    /// What follows `x_r`, where paths are mutated and `x_r` scatters; else nothing.
    pub next: Next,
}

/// A path from a primary hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample {
    /// All of its numbers.
    pub seed: u64,
    /// F.
    pub integrand: Vec3,
    /// n.
    pub last: u8,
    /// How it ends.
    pub ending: Ending,
    /// `None`: a shift replays it to its end.
    pub reconnection: Option<Reconnection>,
}

impl PathSample {
    /// A light point of the primary hit with its F.
    #[inline]
    #[must_use]
    pub fn direct(point: LightPoint, integrand: Vec3) -> Self {
        let reconnection = Reconnection {
            vertex: 1,
            lobes: [NO_LOBE; 2],
            anchor: Anchor::Point(point),
            direction: Vec3::ZERO,
            radiance: Vec3::ZERO,
            density: 1.0,
            light_density: 0.0,
            next: Next::default(),
        };
        let (ending, reconnection) = (Ending::Direct, Some(reconnection));
        Self { seed: 0, integrand, last: 0, ending, reconnection }
    }

    /// p̂.
    #[inline]
    #[must_use]
    pub fn target(&self) -> f32 {
        luminance(self.integrand)
    }
}

/// How paths are shifted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShiftKind {
    /// Replay up to the first pair that may be connected.
    #[default]
    Hybrid,
    /// Paths that may be connected right at the primary hit; others are not shifted.
    Reconnection,
    /// The numbers alone, up to the end; but the point of a light sample is kept.
    Replay,
}

impl Choice for ShiftKind {
    const ALL: &'static [Self] = &[Self::Hybrid, Self::Reconnection, Self::Replay];

    fn name(self) -> &'static str {
        match self {
            Self::Hybrid => "hybrid",
            Self::Reconnection => "reconnection",
            Self::Replay => "replay",
        }
    }
}

/// Which pairs of vertices a shift may connect: both rough, and far enough apart (Lin et al. 2022,
/// section 7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Connects {
    /// Least distance, in scene units.
    pub distance: f32,
    /// Least α of a lobe; 0 where all are Lambert's.
    pub roughness: f32,
    /// Which shift it is for.
    pub kind: ShiftKind,
    /// How far apart is far enough.
    pub predicate: Predicate,
}

/// When vertices are far enough apart to be connected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Predicate {
    /// From a distance on (Lin et al. 2022).
    #[default]
    Distance,
    /// From where both directions, spread as their densities are, cover as much surface as a small
    /// share of what the primary ray's pixel covers: no length of the scene is asked for (*ReSTIR
    /// PT Enhanced*, 2026).
    Footprint,
}

impl Choice for Predicate {
    const ALL: &'static [Self] = &[Self::Distance, Self::Footprint];

    fn name(self) -> &'static str {
        match self {
            Self::Distance => "distance",
            Self::Footprint => "footprint",
        }
    }
}

impl Connects {
    /// α from which on a lobe is rough: the paper's roughness 0.2, squared.
    pub const ROUGHNESS: f32 = 0.04;

    /// For a scene whose bounds have this diagonal: vertices a hundredth of it apart.
    #[must_use]
    pub fn of_diagonal(diagonal: f32) -> Self {
        Self::new(0.01 * diagonal, ShiftKind::Hybrid)
    }

    /// For a shift, with a least distance.
    #[must_use]
    pub fn new(distance: f32, kind: ShiftKind) -> Self {
        Self { distance, roughness: Self::ROUGHNESS, kind, predicate: Predicate::Distance }
    }

    /// The same for surfaces that are all matt, which are not asked how rough they are.
    #[must_use]
    pub fn matt(self, matt: bool) -> Self {
        Self { roughness: if matt { 0.0 } else { self.roughness }, ..self }
    }

    /// The same by another predicate.
    #[must_use]
    pub fn by(self, predicate: Predicate) -> Self {
        Self { predicate, ..self }
    }
}
