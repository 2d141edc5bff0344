//! Ray queries: closest hit and occlusion over a scene's triangles, spheres and disks, without an
//! epsilon.
//!
//! | file | holds |
//! |---|---|
//! | `build` | obvhs' trees, guarded |
//! | `node`, `triangle`, `quadric` | the tests and why they are conservative |
//! | `traverse` | the loops over both layouts |
//! | `point` | the geometry at a hit |
//!
//! A still scene is one tree over world-space primitives (vertices as `to_world.transform_point3`
//! rounds them). A scene that moves or places an object more than once has one tree for each object
//! and one over the instances; rays are brought into an object's space in f64 and t is shared, as
//! the direction is not normalised. Quadrics are always tested in their object's space.

mod build;
#[cfg(feature = "gpu")]
pub(crate) mod export;
mod node;
mod point;
mod quadric;
mod query;
#[cfg(test)]
mod tests;
mod traverse;
mod triangle;

use std::sync::Arc;

use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec2, Vec3, Vec3A};
use obvhs::aabb::Aabb;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

use crate::error::{Error, Result};
use crate::scene::{Geometry, Object, Scene};
use build::{Tree, build_tree, group};
use triangle::Slot;

pub use point::{HitPoint, triangle_orientation};

/// Coordinates beyond this are dropped from scenes, and rays that start beyond it miss (products of
/// two stay finite in f32).
pub const MAX_COORDINATE: f32 = 1e18;

/// A half line or a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts; offset from a surface by [`crate::math::offset_origin`].
    pub origin: Vec3,
    /// Of any length but 0; t counts in its units.
    pub direction: Vec3,
    /// Hits have t in (0, `t_max`).
    pub t_max: f32,
}

/// Where a ray meets a primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Weight of a triangle's vertex 1; spheres and disks: their own parameters, for
    /// [`Accel::point`].
    pub u: f32,
    /// Weight of a triangle's vertex 2; vertex 0 has 1 − u − v.
    pub v: f32,
    /// Number of the primitive inside its structure.
    pub primitive: u32,
    /// Number of the instance in the scene.
    pub instance: u32,
}

/// A decision about each hit before it counts, such as an alpha mask.
pub trait HitFilter {
    /// Whether every hit is accepted, so that [`HitFilter::accept`] is never called.
    const ALL: bool = false;
    /// Whether `hit` stops `ray`. Must not depend on the order of calls.
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool;
}

/// Every hit counts.
#[derive(Clone, Copy, Debug)]
pub struct AcceptAll;

impl HitFilter for AcceptAll {
    const ALL: bool = true;

    #[inline(always)]
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}

/// The kind of tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// Eight children a node, planes in 8 bits (Ylitie, Karras, Laine 2017): fastest here,
    /// smallest.
    #[default]
    Cwbvh,
    /// Two children a node, planes in f32.
    Bvh2,
}

/// How much time goes into a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// For trees that live for a few frames.
    Fast,
    /// A few microseconds a primitive.
    #[default]
    Medium,
    /// Several times slower to build, some percent faster to traverse.
    High,
}

/// Options of [`Accel::build`].
#[derive(Clone, Copy, Debug, Default)]
pub struct BuildOptions {
    /// The kind of tree.
    pub layout: Layout,
    /// Whether each object has a tree of its own, so that [`Accel::rebuild`] shares them; pass
    /// `Some(true)` for a scene that moves. `None`: only if an object is placed more than once.
    pub two_level: Option<bool>,
    /// How much time goes into a tree.
    pub quality: Quality,
    /// Whether the plain tests are used even where the processor has AVX2; for tests of equality
    /// and measurements.
    pub portable: bool,
}

/// What [`Accel::build`] made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BuildReport {
    /// Primitives that can be hit; an object's own count once if there are two levels.
    pub primitives: usize,
    /// Primitives left out: coordinates not finite or beyond ±10¹⁸, or no area.
    pub dropped: usize,
    /// Nodes of all trees.
    pub nodes: usize,
    /// Levels of the deepest tree.
    pub depth: usize,
    /// Memory of trees and primitives, without the scene's own.
    pub bytes: usize,
    /// Whether there is a tree over instances.
    pub two_level: bool,
    /// Trees of primitives that were built now, those that [`Accel::rebuild`] shares left out.
    pub built: usize,
}

/// What [`Accel::point`] needs beside the slot, in the tree's space: one place in memory a hit,
/// whatever the mesh looks like.
#[derive(Clone, Copy, Debug, Default)]
struct Cold {
    /// Into [`Bottom::shapes`].
    shape: u32,
    element: u32,
    /// 0 in a tree of one object.
    instance: u32,
    /// Whether `normals` are there.
    smooth: bool,
    /// Unit geometric normal of a triangle.
    normal: Vec3,
    /// Shading normals of a triangle's corners, of any length.
    normals: [Vec3; 3],
    uvs: [Vec2; 3],
}

impl Cold {
    /// A triangle of a mesh. `to_tree` transforms normals (the inverse transpose).
    fn triangle(
        mesh: &crate::scene::Mesh,
        element: usize,
        reverse: bool,
        to_tree: Option<&DMat3>,
    ) -> Self {
        let corners = mesh.triangles[element].map(|i| i as usize);
        let to_tree = |n: DVec3| to_tree.map_or(n, |m| *m * n);
        let p = corners.map(|i| mesh.positions[i].as_dvec3());
        let side = f64::from(triangle_orientation(mesh, element, reverse));
        let normal = to_tree((p[1] - p[0]).cross(p[2] - p[0]) * side).normalize_or_zero().as_vec3();
        let smooth = !mesh.normals.is_empty();
        let normals = if smooth {
            corners.map(|i| to_tree(mesh.normals[i].as_dvec3()).as_vec3())
        } else {
            [normal; 3]
        };
        let uvs = if mesh.uvs.is_empty() {
            [Vec2::ZERO, Vec2::X, Vec2::ONE]
        } else {
            corners.map(|i| mesh.uvs[i])
        };
        Self { shape: 0, element: element as u32, instance: 0, smooth, normal, normals, uvs }
    }
}

#[derive(Clone, Debug)]
struct LocalShape {
    geometry: Geometry,
    reverse: bool,
}

/// A tree over primitives.
#[derive(Clone, Debug)]
struct Bottom {
    tree: Tree,
    slots: Vec<Slot>,
    cold: Vec<Cold>,
    shapes: Vec<LocalShape>,
    /// Whether there is anything but triangles.
    mixed: bool,
    /// Whether the tree's space is the world, so that quadrics have yet to be placed.
    flat: bool,
    dropped: usize,
    /// Of a tree of one object.
    object: Option<Arc<Object>>,
}

/// An instance's transforms.
#[derive(Clone, Debug)]
struct Placement {
    to_world64: DAffine3,
    to_object64: DAffine3,
    identity: bool,
    first_shape: u32,
    /// Into [`Accel::bottoms`].
    bottom: u32,
}

impl Placement {
    fn normal_to_world(&self, n: DVec3) -> DVec3 {
        self.to_object64.matrix3.transpose() * n
    }

    /// Sum of the magnitudes that a point with component magnitudes `p` is transformed with.
    fn magnitude(&self, p: DVec3) -> DVec3 {
        let m = self.to_world64.matrix3;
        DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs()) * p
            + self.to_world64.translation.abs()
    }
}

/// The tree over instances.
#[derive(Clone, Debug)]
struct Top {
    tree: Tree,
    order: Vec<u32>,
}

/// A scene's geometry, ready for rays.
#[derive(Clone, Debug)]
pub struct Accel {
    bottoms: Vec<Arc<Bottom>>,
    placements: Vec<Placement>,
    top: Option<Top>,
    #[cfg(target_arch = "x86_64")]
    simd: Option<V3>,
    options: BuildOptions,
    report: BuildReport,
}

impl Accel {
    /// Builds over a scene whose transforms are fixed (see [`Scene::at`]).
    ///
    /// Coincident, degenerate and non-finite primitives are no errors: the latter two are dropped
    /// and counted.
    ///
    /// # Errors
    /// A singular or non-finite instance transform; more than 2²⁹ primitives.
    pub fn build(scene: &Scene, options: &BuildOptions) -> Result<Self> {
        Self::build_from(scene, options, &[])
    }

    /// The structure of the next frame: trees of objects that both scenes share are shared, the
    /// rest is built.
    ///
    /// # Errors
    /// As [`Accel::build`].
    pub fn rebuild(&self, scene: &Scene) -> Result<Self> {
        Self::build_from(scene, &self.options, &self.bottoms)
    }

    /// What was built.
    #[must_use]
    pub fn report(&self) -> &BuildReport {
        &self.report
    }

    fn build_from(scene: &Scene, options: &BuildOptions, old: &[Arc<Bottom>]) -> Result<Self> {
        let mut placements = placements(scene)?;
        let shared = || {
            let mut placed = vec![false; scene.objects.len()];
            scene.instances.iter().any(|i| std::mem::replace(&mut placed[i.object.index()], true))
        };
        let two_level = options.two_level.unwrap_or_else(shared);
        let mut built = 0;
        let (bottoms, top) = if two_level {
            let mut numbers = vec![None; scene.objects.len()];
            let mut bottoms: Vec<Arc<Bottom>> = Vec::new();
            for (instance, placement) in scene.instances.iter().zip(&mut placements) {
                let object = &scene.objects[instance.object.index()];
                let known = &mut numbers[instance.object.index()];
                let number = match *known {
                    Some(number) => number,
                    None => {
                        let same = |b: &&Arc<Bottom>| {
                            b.object.as_ref().is_some_and(|o| Arc::ptr_eq(o, object))
                        };
                        let bottom = match old.iter().find(same) {
                            Some(bottom) => bottom.clone(),
                            None => {
                                built += 1;
                                Arc::new(bottom_of_object(object, options)?)
                            }
                        };
                        bottoms.push(bottom);
                        *known.insert(bottoms.len() as u32 - 1)
                    }
                };
                placement.bottom = number;
            }
            let top = top(&bottoms, &placements, options);
            (bottoms, Some(top))
        } else {
            built += 1;
            (vec![Arc::new(bottom_of_scene(scene, &placements, options)?)], None)
        };
        let trees = || bottoms.iter().map(|b| &b.tree).chain(top.iter().map(|t| &t.tree));
        let report = BuildReport {
            primitives: bottoms
                .iter()
                .map(|b| b.slots.iter().filter(|s| s.kind() != triangle::Kind::Group).count())
                .sum(),
            dropped: bottoms.iter().map(|b| b.dropped).sum(),
            nodes: trees().map(Tree::node_count).sum(),
            depth: trees().map(|t| t.depth).max().unwrap_or(0),
            bytes: trees().map(Tree::bytes).sum::<usize>()
                + bottoms
                    .iter()
                    .map(|b| b.slots.len() * (size_of::<Slot>() + size_of::<Cold>()))
                    .sum::<usize>(),
            two_level,
            built,
        };
        Ok(Self {
            bottoms,
            placements,
            top,
            #[cfg(target_arch = "x86_64")]
            simd: if options.portable { None } else { V3::try_new() },
            options: *options,
            report,
        })
    }

    #[inline(always)]
    fn bottom(&self, instance: u32) -> &Bottom {
        match self.top {
            Some(_) => &self.bottoms[self.placements[instance as usize].bottom as usize],
            None => &self.bottoms[0],
        }
    }
}

fn placements(scene: &Scene) -> Result<Vec<Placement>> {
    let mut first_shape = 0;
    let mut all = Vec::with_capacity(scene.instances.len());
    for (number, instance) in scene.instances.iter().enumerate() {
        let to_world = instance.to_world.fixed();
        let to_world64 = DAffine3 {
            matrix3: to_world.matrix3.as_dmat3(),
            translation: to_world.translation.as_dvec3(),
        };
        let to_object64 = to_world64.inverse();
        let determinant = to_world64.matrix3.determinant();
        if !(to_world64.is_finite() && to_object64.is_finite() && determinant != 0.0) {
            return Err(Error::invalid(format!(
                "the transform of instance {number} is singular or not finite, it must be invertible"
            )));
        }
        all.push(Placement {
            to_world64,
            to_object64,
            identity: to_world == Affine3A::IDENTITY,
            first_shape,
            bottom: 0,
        });
        first_shape += scene.objects[instance.object.index()].shapes.len() as u32;
    }
    Ok(all)
}

/// Primitives while they are gathered.
#[derive(Default)]
struct Gather {
    slots: Vec<Slot>,
    cold: Vec<Cold>,
    boxes: Vec<Aabb>,
    shapes: Vec<LocalShape>,
    dropped: usize,
    mixed: bool,
}

impl Gather {
    /// Adds an object's shapes. `vertices`: to the tree's space; `quadrics`: the same for the boxes
    /// of spheres and disks.
    fn add(
        &mut self,
        object: &Object,
        vertices: Option<Affine3A>,
        quadrics: Option<&DAffine3>,
        instance: u32,
    ) {
        for shape in &object.shapes {
            let number = self.shapes.len() as u32;
            self.shapes.push(LocalShape {
                geometry: shape.geometry.clone(),
                reverse: shape.reverse_orientation,
            });
            // A singular transform has been refused.
            let normals = vertices.map(|m| m.matrix3.as_dmat3().inverse().transpose());
            match &shape.geometry {
                Geometry::Mesh(mesh) => {
                    for (element, corners) in mesh.triangles.iter().enumerate() {
                        let p = corners.map(|i| {
                            let p = mesh.positions[i as usize];
                            vertices.map_or(p, |m| m.transform_point3(p))
                        });
                        let area = {
                            let p = p.map(|p| p.as_dvec3());
                            (p[1] - p[0]).cross(p[2] - p[0]).length_squared()
                        };
                        let [a, b, c] = p.map(Vec3A::from);
                        let bounds = Aabb::new(a.min(b).min(c), a.max(b).max(c));
                        let mut cold = Cold { shape: number, instance, ..Cold::default() };
                        if area > 0.0 {
                            let reverse = shape.reverse_orientation;
                            cold = Cold {
                                shape: number,
                                instance,
                                ..Cold::triangle(mesh, element, reverse, normals.as_ref())
                            };
                        }
                        self.push(Slot::triangle(p), cold, bounds, area > 0.0);
                    }
                }
                Geometry::Sphere { center, radius } => {
                    self.mixed = true;
                    let bounds = transformed_box(center.as_dvec3(), quadrics, |row| {
                        row.length() * f64::from(*radius)
                    });
                    let cold = Cold { shape: number, instance, ..Cold::default() };
                    self.push(Slot::sphere(*center, *radius), cold, bounds, *radius > 0.0);
                }
                Geometry::Disk { center, normal, radius } => {
                    self.mixed = true;
                    let unit = normal.as_dvec3().normalize();
                    let bounds = transformed_box(center.as_dvec3(), quadrics, |row| {
                        row.cross(unit).length() * f64::from(*radius)
                    });
                    let cold = Cold { shape: number, instance, ..Cold::default() };
                    let valid = *radius > 0.0 && unit.is_finite();
                    self.push(Slot::disk(*center, *normal, *radius), cold, bounds, valid);
                }
            }
        }
    }

    fn push(&mut self, slot: Slot, cold: Cold, bounds: Aabb, valid: bool) {
        let limit = Vec3A::splat(MAX_COORDINATE);
        // NaN compares false.
        let inside = bounds.min.cmpge(-limit).all() && bounds.max.cmple(limit).all();
        if valid && inside {
            self.slots.push(slot);
            self.cold.push(cold);
            self.boxes.push(bounds);
        } else {
            self.dropped += 1;
        }
    }

    fn finish(
        self,
        options: &BuildOptions,
        flat: bool,
        object: Option<Arc<Object>>,
    ) -> Result<Bottom> {
        if self.slots.len() >= traverse::MAX_SLOTS / 2 {
            return Err(Error::invalid(format!(
                "{} primitives, at most {} are allowed",
                self.slots.len(),
                traverse::MAX_SLOTS / 2
            )));
        }
        let grouped = group(&self.boxes);
        let (tree, order) = build_tree(&grouped, options);
        let (mut slots, mut cold) =
            (Vec::with_capacity(order.len()), Vec::with_capacity(order.len()));
        let mut mixed = self.mixed;
        let mut after = order.len() as u32;
        let mut groups = Vec::new();
        for &entry in &order {
            let (start, count) = grouped.ranges[entry as usize];
            let members = &grouped.members[start as usize..(start + count) as usize];
            if let &[only] = members {
                slots.push(self.slots[only as usize]);
                cold.push(self.cold[only as usize]);
            } else {
                mixed = true;
                slots.push(Slot::group(after, count));
                cold.push(Cold::default());
                after += count;
                groups.push(members);
            }
        }
        for &member in groups.into_iter().flatten() {
            slots.push(self.slots[member as usize]);
            cold.push(self.cold[member as usize]);
        }
        Ok(Bottom {
            tree,
            slots,
            cold,
            shapes: self.shapes,
            mixed,
            flat,
            dropped: self.dropped,
            object,
        })
    }
}

/// The box around a centre with half extents given by each row of the transform, rounded outward.
fn transformed_box(center: DVec3, to_tree: Option<&DAffine3>, half: impl Fn(DVec3) -> f64) -> Aabb {
    let rows = to_tree.map_or(DMat3::IDENTITY, |m| m.matrix3).transpose();
    let center = to_tree.map_or(center, |m| m.transform_point3(center));
    let half = DVec3::new(half(rows.x_axis), half(rows.y_axis), half(rows.z_axis));
    outward(center - half, center + half)
}

/// f32 bounds around f64 ones, and at least one unit in the last place of room for their own
/// rounding.
fn outward(min: DVec3, max: DVec3) -> Aabb {
    let down = |v: f64| (v as f32).next_down();
    let up = |v: f64| (v as f32).next_up();
    Aabb::new(
        Vec3A::new(down(min.x), down(min.y), down(min.z)),
        Vec3A::new(up(max.x), up(max.y), up(max.z)),
    )
}

fn bottom_of_object(object: &Arc<Object>, options: &BuildOptions) -> Result<Bottom> {
    let mut gather = Gather::default();
    gather.add(object, None, None, 0);
    gather.finish(options, false, Some(object.clone()))
}

fn bottom_of_scene(
    scene: &Scene,
    placements: &[Placement],
    options: &BuildOptions,
) -> Result<Bottom> {
    let mut gather = Gather::default();
    for (number, (instance, placement)) in scene.instances.iter().zip(placements).enumerate() {
        let vertices = (!placement.identity).then(|| instance.to_world.fixed());
        let quadrics = (!placement.identity).then_some(&placement.to_world64);
        gather.add(&scene.objects[instance.object.index()], vertices, quadrics, number as u32);
    }
    gather.finish(options, true, None)
}

fn top(bottoms: &[Arc<Bottom>], placements: &[Placement], options: &BuildOptions) -> Top {
    let (mut boxes, mut numbers) = (Vec::new(), Vec::new());
    for (number, placement) in placements.iter().enumerate() {
        let tree = &bottoms[placement.bottom as usize].tree;
        if tree.is_empty() {
            continue;
        }
        let (min, max) = (tree.bounds.min.as_dvec3(), tree.bounds.max.as_dvec3());
        let half = (max - min) * 0.5;
        let bounds = transformed_box((min + max) * 0.5, Some(&placement.to_world64), |row| {
            row.abs().dot(half)
        });
        boxes.push(bounds);
        numbers.push(number as u32);
    }
    let (tree, order) = build_tree(&build::alone(boxes), options);
    Top { tree, order: order.into_iter().map(|i| numbers[i as usize]).collect() }
}
