//! Geometry with its material, emission and placement.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::{Color, MaterialId, ObjectId, Scalar, Transform};

/// Triangles in object space.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals for shading; empty: the face's own.
    pub normals: Vec<Vec3>,
    /// Texture coordinates; empty: (0,0), (1,0), (1,1) at a triangle's three corners.
    pub uvs: Vec<Vec2>,
    /// Three vertices a triangle; the face's normal is (p₁ − p₀) × (p₂ − p₀).
    pub triangles: Vec<[u32; 3]>,
}

/// The surface of a [`Shape`], in its object's space.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Triangles.
    Mesh(Arc<Mesh>),
    /// A full sphere; its normal points outward.
    Sphere {
        /// The centre.
        center: Vec3,
        /// Positive.
        radius: f32,
    },
    /// A full disk.
    Disk {
        /// The centre.
        center: Vec3,
        /// Unit normal.
        normal: Vec3,
        /// Positive.
        radius: f32,
    },
}

/// Diffuse emission of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Emission {
    /// Radiance in W·sr⁻¹·m⁻², may be textured.
    pub radiance: Color,
    /// Factor on `radiance`.
    pub scale: f32,
    /// Whether the back emits too; the front is where the geometric normal points.
    pub two_sided: bool,
}

/// A surface.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Where it is.
    pub geometry: Geometry,
    /// How it scatters.
    pub material: MaterialId,
    /// What it emits.
    pub emission: Option<Emission>,
    /// Coverage in [0, 1]; `None` is 1. A ray passes with probability 1 − alpha, and an emitter
    /// sends alpha times its radiance; but where it is the number 0 all of it: such an emitter
    /// lights and is never seen (as in pbrt-v4).
    pub alpha: Option<Scalar>,
    /// Whether the geometric normal is turned around (pbrt's `ReverseOrientation`). Of no effect on
    /// a mesh with vertex normals: there the geometric normal points to their side.
    pub reverse_orientation: bool,
}

impl Shape {
    /// An opaque shape that does not emit.
    #[must_use]
    pub fn new(geometry: Geometry, material: MaterialId) -> Self {
        Self { geometry, material, emission: None, alpha: None, reverse_orientation: false }
    }

    /// Whether no ray ever meets it: its coverage is the number 0.
    #[inline]
    #[must_use]
    pub fn is_unmet(&self) -> bool {
        matches!(self.alpha, Some(Scalar::Constant(alpha)) if alpha <= 0.0)
    }

    /// The same shape as a one-sided emitter.
    #[must_use]
    pub fn emitting(mut self, radiance: Vec3) -> Self {
        self.emission =
            Some(Emission { radiance: Color::Constant(radiance), scale: 1.0, two_sided: false });
        self
    }
}

/// Shapes that are placed together.
#[derive(Clone, Debug, Default)]
pub struct Object {
    /// For messages; may be empty.
    pub name: String,
    /// In the object's space.
    pub shapes: Vec<Shape>,
}

/// A placed object.
#[derive(Clone, Debug)]
pub struct Instance {
    /// What is placed.
    pub object: ObjectId,
    /// Where.
    pub to_world: Transform,
    /// Stable identity over frames; unique in the scene.
    pub key: u64,
}
