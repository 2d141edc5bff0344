//! A hit with everything that scattering there needs.

use glam::{Vec2, Vec3};

use super::ShapeInfo;
use super::bsdf::Bsdf;
use super::material::evaluate_material;
use crate::accel::{Accel, Hit, HitPoint};
use crate::math::{Frame, offset_origin};
use crate::scene::Scene;

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
    /// Looks up the material at a hit, whose geometry is `point`.
    #[inline]
    #[must_use]
    pub fn new(
        scene: &Scene,
        shapes: &[ShapeInfo],
        accel: &Accel,
        hit: &Hit,
        point: &HitPoint,
    ) -> Self {
        let shape = &shapes[point.shape as usize];
        let frame = if shape.anisotropic {
            Frame::from_normal_and_tangent(point.shading_normal, accel.tangent(hit))
        } else {
            Frame::from_normal(point.shading_normal)
        };
        Self {
            position: point.position,
            error: point.error,
            geometric_normal: point.geometric_normal,
            frame,
            uv: point.uv,
            shape: point.shape,
            element: point.element,
            bsdf: evaluate_material(scene, shape.material, point.uv),
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
