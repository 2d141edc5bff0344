//! Which pair of a path's vertices is the first that may be connected: the one rule that trees and
//! shifts share.

use glam::Vec3;

use super::Connects;
use crate::accel::HitPoint;
use crate::path::Vertex;
use crate::surface::bsdf::Bsdf;

impl Connects {
    /// Whether a lobe is rough enough, which deltas never are.
    #[inline]
    pub(super) fn is_rough(&self, bsdf: &Bsdf, lobe: u32) -> bool {
        bsdf.lobe_roughness(lobe) >= self.roughness
    }

    /// Whether a light sample leaves by a lobe that is rough enough: any, since it takes all.
    #[inline]
    pub(super) fn any_is_rough(&self, bsdf: &Bsdf) -> bool {
        (0..bsdf.lobe_count()).any(|lobe| self.is_rough(bsdf, lobe))
    }
}

/// A path as far as it has come: the vertex that it is at, and the pair of it and the one before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trail {
    position: Vec3,
    /// The lobe that it was left by.
    pub(super) lobe: u8,
    /// Whether that lobe is rough.
    pub(super) rough: bool,
    /// p(ω, ℓ) of leaving; 0 where nobody asked.
    pub(super) density: f32,
    /// Whether the pair of the vertex before and this one may be connected, as far as the vertex
    /// before and the distance say: what is missing is a rough lobe here.
    pub(super) reachable: bool,
    /// g from the vertex before, by this one's geometric normal.
    pub(super) geometry: f32,
}

impl Trail {
    /// The path arrives at vertex `number`.
    #[inline]
    pub(super) fn arrive(
        &mut self,
        connects: &Connects,
        number: u32,
        at: &Vertex,
        point: &HitPoint,
    ) {
        (self.reachable, self.geometry) = (false, 0.0);
        if number > 0 {
            let (geometry, far) = self.reach(connects, point);
            (self.reachable, self.geometry) = (far && self.rough, geometry);
        }
        self.position = at.surface.position;
    }

    /// g from the vertex that the path is at to a point, and whether that is far enough away.
    #[inline]
    pub(super) fn reach(&self, connects: &Connects, to: &HitPoint) -> (f32, bool) {
        let way = to.position - self.position;
        let squared = way.length_squared();
        let cosine = to.geometric_normal.dot(way).abs() / squared.sqrt();
        (cosine / squared, squared >= connects.distance * connects.distance)
    }

    /// The path leaves the vertex that it is at.
    #[inline]
    pub(super) fn leave(&mut self, lobe: u8, rough: bool, density: f32) {
        (self.lobe, self.rough, self.density) = (lobe, rough, density);
    }
}
