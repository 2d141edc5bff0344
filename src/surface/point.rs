//! A hit with everything that scattering there needs.

use glam::{Vec2, Vec3};

use super::ShapeInfo;
use super::bsdf::Bsdf;
use super::material::evaluate_material;
use crate::accel::HitPoint;
use crate::math::{Frame, offset_origin};
use crate::scene::{Material, Scene};

/// A surface point ready for shading.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// World position.
    pub position: Vec3,
    /// Absolute bound on its rounding error, per component.
    pub error: Vec3,
    /// Unit; decides the side a ray leaves to, and emission.
    pub geometric_normal: Vec3,
    /// Shading frame; cosines and sidedness of scattering.
    pub frame: Frame,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Running shape number.
    pub shape: u32,
    /// Element of the shape.
    pub element: u32,
    /// Scattering, in `frame`.
    pub bsdf: Bsdf,
}

impl SurfacePoint {
    /// Looks up the material at a hit.
    #[inline]
    #[must_use]
    pub fn new(scene: &Scene, shapes: &[ShapeInfo], hit: &HitPoint) -> Self {
        let material = shapes[hit.shape as usize].material;
        // Only anisotropic lobes see the tangents.
        let frame = match scene.materials[material.index()] {
            Material::Diffuse { .. } => Frame::from_normal(hit.shading_normal),
            _ => Frame::from_normal_and_tangent(hit.shading_normal, hit.dpdu),
        };
        Self {
            position: hit.position,
            error: hit.error,
            geometric_normal: hit.geometric_normal,
            frame,
            uv: hit.uv,
            shape: hit.shape,
            element: hit.element,
            bsdf: evaluate_material(scene, material, hit.uv),
        }
    }

    /// Where a ray towards `direction` starts, off the surface on the side that it leaves to.
    #[inline]
    #[must_use]
    pub fn origin(&self, direction: Vec3) -> Vec3 {
        let side = 1.0_f32.copysign(direction.dot(self.geometric_normal));
        offset_origin(self.position, self.geometric_normal * side, self.error)
    }
}
