//! Which pair of a path's vertices is the first that may be connected: the one rule that trees and
//! shifts share.
//!
//! | predicate | what leaves `v_{r−1}` | what leaves `x_r` |
//! |---|---|---|
//! | distance | α of `ℓ_{r−1}` ≥ 0.04, d ≥ d₀ | α of `ℓ_r` ≥ 0.04 |
//! | footprint | α of `ℓ_{r−1}` ≥ 0.04, d² / (p̄(`ω_{r−1}`) \|cos at `x_r`\|) ≥ s | d² / (p̄(`ω_r`) \|cos at `v_{r−1}`\|) ≥ s, or all is diffuse |
//!
//! s = 2·10⁻⁴ · 4π t² / \|cos\| of the primary ray at v₀: what a pixel sees of the scene's surface
//! by a lobe of all directions. Ends have no second condition.

use glam::Vec3;

use super::{Connects, Predicate, ShiftKind};
use crate::accel::HitPoint;
use crate::path::Vertex;
use crate::surface::bsdf::Bsdf;

/// Share of the primary ray's footprint that a connection's must have (0.02 % in *ReSTIR PT
/// Enhanced*, 2026).
const FOOTPRINT: f32 = 2e-4;

impl Connects {
    /// Whether a vertex that is left by a lobe may be connected to the next one: deltas are never
    /// rough enough, and a replay connects nothing.
    #[inline]
    pub(super) fn is_rough(&self, bsdf: &Bsdf, lobe: u32) -> bool {
        // Where no lobe has a roughness, none is asked.
        self.kind != ShiftKind::Replay
            && (self.roughness == 0.0 || bsdf.lobe_roughness(lobe) >= self.roughness)
    }

    /// Whether a vertex may be left by a lobe, or by a light sample, which takes all: what the
    /// surface says of `x_r`.
    #[inline]
    pub(super) fn second(&self, bsdf: &Bsdf, lobe: Option<u32>) -> bool {
        match (self.predicate, lobe) {
            (Predicate::Distance, Some(lobe)) => self.is_rough(bsdf, lobe),
            // Any is rough enough.
            (Predicate::Distance, None) => {
                (0..bsdf.lobe_count()).any(|lobe| self.is_rough(bsdf, lobe))
            }
            (Predicate::Footprint, Some(lobe)) => !bsdf.is_delta(lobe),
            (Predicate::Footprint, None) => bsdf.has_non_delta(),
        }
    }
}

/// A path as far as it has come: the vertex that it is at, and the pair of it and the one before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trail {
    position: Vec3,
    normal: Vec3,
    /// Least d², or s.
    least: f32,
    /// The lobe that it was left by.
    pub(super) lobe: u8,
    /// Whether that lobe is rough.
    pub(super) rough: bool,
    /// p̄(ω) of leaving.
    total: f32,
    /// p(ω, ℓ) of leaving; 0 where nobody asked.
    pub(super) density: f32,
    /// Whether the pair of the vertex before and this one may be connected, as far as the vertex
    /// before says.
    reachable: bool,
    /// From the vertex before to this one.
    pub(super) way: Way,
}

/// From a vertex to a point.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Way {
    squared: f32,
    /// g = \|cos\| / d² with the cosine at the point, by its geometric normal.
    pub(super) geometry: f32,
    /// The same with the cosine at the vertex.
    back: f32,
}

impl Trail {
    /// The path arrives at vertex `number`; the primary ray has gone `t` to the first.
    #[inline]
    pub(super) fn arrive(
        &mut self,
        connects: &Connects,
        number: u32,
        at: &Vertex,
        (point, t): (&HitPoint, f32),
    ) {
        self.reachable = false;
        if number > 0 {
            self.way = self.way_to(point);
            self.reachable = self.rough && self.leaves_to(connects, &self.way);
        } else {
            let outgoing = at.surface.frame.to_world(at.outgoing);
            self.least = match connects.predicate {
                Predicate::Distance => connects.distance * connects.distance,
                Predicate::Footprint => {
                    let cosine = outgoing.dot(point.geometric_normal).abs();
                    FOOTPRINT * 4.0 * std::f32::consts::PI * t * t / cosine
                }
            };
        }
        (self.position, self.normal) = (at.surface.position, point.geometric_normal);
    }

    /// From the vertex that the path is at to a point.
    #[inline]
    pub(super) fn way_to(&self, to: &HitPoint) -> Way {
        let way = to.position - self.position;
        let squared = way.length_squared();
        let distance = squared.sqrt();
        let cosine = |normal: Vec3| normal.dot(way).abs() / distance;
        Way {
            squared,
            geometry: cosine(to.geometric_normal) / squared,
            back: cosine(self.normal) / squared,
        }
    }

    /// Whether a way is one that may be connected, as far as the vertex that the path is at says,
    /// which leaves along it with p̄ = `total`.
    #[inline]
    pub(super) fn first(&self, connects: &Connects, way: &Way, total: f32) -> bool {
        match connects.predicate {
            Predicate::Distance => way.squared >= self.least,
            Predicate::Footprint => total * way.geometry * self.least <= 1.0,
        }
    }

    /// [`Trail::first`] as the vertex was left.
    #[inline]
    pub(super) fn leaves_to(&self, connects: &Connects, way: &Way) -> bool {
        self.first(connects, way, self.total)
    }

    /// Whether what leaves the far end of a way with p̄ = `total` lets it be connected, as far as
    /// distances say.
    #[inline]
    pub(super) fn onward(&self, connects: &Connects, way: &Way, bsdf: &Bsdf, total: f32) -> bool {
        match connects.predicate {
            Predicate::Distance => true,
            Predicate::Footprint => {
                let diffuse =
                    || (0..bsdf.lobe_count()).all(|lobe| bsdf.lobe_roughness(lobe) >= 1.0);
                total * way.back * self.least <= 1.0 || diffuse()
            }
        }
    }

    /// Whether the pair of the vertex before and this one may be connected if the path leaves this
    /// one by `lobe`, or by a light sample, with p̄ = `total`.
    #[inline]
    pub(super) fn connects(
        &self,
        connects: &Connects,
        bsdf: &Bsdf,
        lobe: Option<u32>,
        total: f32,
    ) -> bool {
        self.reachable
            && connects.second(bsdf, lobe)
            && self.onward(connects, &self.way, bsdf, total)
    }

    /// The path leaves the vertex that it is at by a lobe, with p̄ = `total`, and p(ω, ℓ) where
    /// that is asked for.
    #[inline]
    pub(super) fn leave(&mut self, lobe: u8, rough: bool, total: f32, density: f32) {
        (self.lobe, self.rough, self.total, self.density) = (lobe, rough, total, density);
    }
}
