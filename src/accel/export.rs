//! Trees and primitives as words for a graphics processor: `gpu/wgsl/accel.wgsl` reads what is
//! written here.

use std::sync::Arc;

use glam::{DAffine3, Vec3};

use super::build::{Nodes, Tree};
use super::triangle::Kind;
use super::{Accel, Bottom};
use crate::error::{Error, Result};
use crate::scene::Geometry;

/// Four words: what an arena of nodes or geometry is made of.
pub(crate) type Quad = [u32; 4];

/// Words under construction whose first one will lie at `base`.
#[derive(Debug, Default)]
pub(crate) struct Words {
    pub(crate) base: u32,
    pub(crate) data: Vec<u32>,
}

impl Words {
    /// Where the next word will lie.
    pub(crate) fn at(&self) -> u32 {
        self.base + self.data.len() as u32
    }

    /// Appends words; returns where they begin.
    pub(crate) fn put(&mut self, words: impl IntoIterator<Item = u32>) -> u32 {
        let at = self.at();
        self.data.extend(words);
        at
    }
}

/// No tree.
pub(crate) const NO_TREE: u32 = u32::MAX;
/// Quads of a primitive's cold part.
const COLD: usize = 6;
/// Quads of a placement.
const PLACEMENT: usize = 8;
const MIXED: u32 = 1;
const FLAT: u32 = 2;
const IDENTITY: u32 = 4;

/// Where a tree over primitives lies: first quads of its nodes, slots and cold parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placed {
    pub(crate) nodes: u32,
    pub(crate) slots: u32,
    pub(crate) cold: u32,
    pub(crate) flags: u32,
    pub(crate) reach: f32,
}

/// Two arenas under construction.
#[derive(Debug, Default)]
pub(crate) struct TreeArenas {
    pub(crate) nodes: Vec<Quad>,
    pub(crate) geometry: Vec<Quad>,
}

/// Trees over primitives that were written, of any number of scenes, and where each lies.
#[derive(Debug, Default)]
pub(crate) struct Written(Vec<(Arc<Bottom>, Placed)>);

impl Written {
    fn find(&self, bottom: &Arc<Bottom>) -> Option<Placed> {
        self.0.iter().find(|(known, _)| Arc::ptr_eq(known, bottom)).map(|(_, placed)| *placed)
    }

    /// Where the trees of `accel` lie, in its order; `None` if one was not written.
    pub(crate) fn of(&self, accel: &Accel) -> Option<Vec<Placed>> {
        // Mostly all are the same, in the same order.
        let same = self.0.len() >= accel.bottoms.len()
            && self.0.iter().zip(&accel.bottoms).all(|((a, _), b)| Arc::ptr_eq(a, b));
        if same {
            return Some(self.0[..accel.bottoms.len()].iter().map(|(_, placed)| *placed).collect());
        }
        accel.bottoms.iter().map(|bottom| self.find(bottom)).collect()
    }

    /// Writes those trees of `accel` that were not yet.
    ///
    /// # Errors
    /// A tree of another layout than [`super::Layout::Cwbvh`].
    pub(crate) fn add(&mut self, accel: &Accel, to: &mut TreeArenas) -> Result<()> {
        for bottom in &accel.bottoms {
            if self.find(bottom).is_none() {
                let placed = to.bottom(bottom)?;
                self.0.push((bottom.clone(), placed));
            }
        }
        Ok(())
    }
}

fn bits(v: Vec3) -> [u32; 3] {
    v.to_array().map(f32::to_bits)
}

/// The three rows of an affine map, rounded to f32.
fn rows(m: &DAffine3) -> [Quad; 3] {
    let t = m.matrix3.transpose();
    let row = |r: glam::DVec3, d: f64| [r.x, r.y, r.z, d].map(|v| (v as f32).to_bits());
    [row(t.x_axis, m.translation.x), row(t.y_axis, m.translation.y), row(t.z_axis, m.translation.z)]
}

impl TreeArenas {
    fn tree(&mut self, tree: &Tree) -> Result<u32> {
        let Nodes::Cwbvh(nodes) = &tree.nodes else {
            return Err(Error::usage(
                "the graphics processor traverses `Layout::Cwbvh` only, but the scene was built with `Layout::Bvh2`",
            ));
        };
        if nodes.is_empty() {
            return Ok(NO_TREE);
        }
        let first = self.nodes.len() as u32;
        self.nodes.extend_from_slice(bytemuck::cast_slice(nodes));
        Ok(first)
    }

    fn bottom(&mut self, bottom: &Bottom) -> Result<Placed> {
        let nodes = self.tree(&bottom.tree)?;
        let slots = self.geometry.len() as u32;
        self.geometry.extend_from_slice(bytemuck::cast_slice(&bottom.slots));
        let cold = self.geometry.len() as u32;
        self.geometry.reserve(bottom.cold.len() * COLD);
        for (slot, part) in bottom.slots.iter().zip(&bottom.cold) {
            let kind = slot.kind();
            let reverse = matches!(kind, Kind::Sphere | Kind::Disk)
                && bottom.shapes[part.shape as usize].reverse;
            let flags = u32::from(part.smooth) | u32::from(reverse) << 1;
            let mut words = [0; 4 * COLD];
            words[..4].copy_from_slice(&[part.shape, part.element, part.instance, flags]);
            words[4..7].copy_from_slice(&bits(part.normal));
            for (at, normal) in part.normals.iter().enumerate() {
                words[7 + 3 * at..10 + 3 * at].copy_from_slice(&bits(*normal));
            }
            for (at, uv) in part.uvs.iter().enumerate() {
                words[16 + 2 * at..18 + 2 * at].copy_from_slice(&uv.to_array().map(f32::to_bits));
            }
            self.geometry.extend_from_slice(bytemuck::cast_slice(&words));
        }
        let flag = |holds: bool, bit: u32| if holds { bit } else { 0 };
        let flags = flag(bottom.mixed, MIXED) | flag(bottom.flat, FLAT);
        Ok(Placed { nodes, slots, cold, flags, reach: bottom.tree.reach() })
    }
}

impl Accel {
    /// Writes the trees over primitives.
    ///
    /// # Errors
    /// A tree of another layout than [`super::Layout::Cwbvh`].
    pub(crate) fn export_bottoms(&self, to: &mut TreeArenas) -> Result<Vec<Placed>> {
        self.bottoms.iter().map(|bottom| to.bottom(bottom)).collect()
    }

    /// Writes the placements of all instances; returns where they begin.
    pub(crate) fn export_placements(&self, bottoms: &[Placed], to: &mut Vec<Quad>) -> u32 {
        let first = to.len() as u32;
        for placement in &self.placements {
            let at = to.len();
            to.extend(rows(&placement.to_object64));
            to.extend(rows(&placement.to_world64));
            let bottom = bottoms[if self.top.is_some() { placement.bottom as usize } else { 0 }];
            to.push([placement.first_shape, bottom.nodes, bottom.slots, bottom.cold]);
            let flags = bottom.flags | if placement.identity { IDENTITY } else { 0 };
            to.push([flags, bottom.reach.to_bits(), 0, 0]);
            debug_assert_eq!(to.len() - at, PLACEMENT);
        }
        first
    }

    /// Writes the tree over instances: its first quad, its leaves' instances, its reach.
    /// [`NO_TREE`] without one.
    ///
    /// # Errors
    /// As [`Accel::export_bottoms`].
    pub(crate) fn export_top(&self, to: &mut Vec<Quad>) -> Result<(u32, &[u32], f32)> {
        let Some(top) = &self.top else { return Ok((NO_TREE, &[], 0.0)) };
        let mut arenas = TreeArenas { nodes: std::mem::take(to), geometry: Vec::new() };
        let first = arenas.tree(&top.tree);
        *to = arenas.nodes;
        Ok((first?, &top.order, top.tree.reach()))
    }

    /// Whether rays meet a tree over instances first.
    pub(crate) fn is_two_level(&self) -> bool {
        self.top.is_some()
    }

    /// Whether there is anything but triangles.
    pub(crate) fn has_quadrics(&self) -> bool {
        self.bottoms.iter().any(|bottom| {
            bottom.mixed || bottom.shapes.iter().any(|s| !matches!(s.geometry, Geometry::Mesh(_)))
        })
    }

    /// Entries that a traversal's stack may hold: 7 a level and the root, of both levels.
    pub(crate) fn stack_entries(&self) -> usize {
        let deepest = self.bottoms.iter().map(|bottom| bottom.tree.depth).max().unwrap_or(0);
        let top = self.top.as_ref().map_or(0, |top| 7 * top.tree.depth + 1);
        top + 7 * deepest + 1
    }
}
