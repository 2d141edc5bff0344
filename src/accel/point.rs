//! The geometry at a hit: position with its error bound, normals, texture coordinates.
//!
//! Positions are sums of vertices by barycentric weights in f64, rounded once, so they lie in the
//! surface to half a unit in the last place: |`error_i`| ≤ 2⁻²⁴ |`p_i`|, plus what the weights' and
//! the transform's own f64 roundings and the f64 inverse can cost when a ray comes back into an
//! instance's space, 2⁻⁴⁰ times the sum of the magnitudes added (bound met for transforms of
//! condition < 2⁻⁴⁰/2⁻⁵² = 4096 relative to that sum; beyond, the offset loses its guarantee
//! gradually).

use glam::{Affine3A, DVec3, Vec2, Vec3};

use super::quadric::{disk_tangents, sphere_decode};
use super::triangle::Kind;
use super::{Accel, Bottom, Cold, Hit};
use crate::math::Frame;
use crate::scene::{Geometry, Mesh};

/// The surface at a [`Hit`], in world space.
#[derive(Clone, Copy, Debug)]
pub struct HitPoint {
    /// On the surface, to within `error`.
    pub position: Vec3,
    /// Bound on |position − true position|, per component: what [`crate::math::offset_origin`]
    /// takes.
    pub error: Vec3,
    /// Unit normal of the face. Its side is decided per triangle by [`triangle_orientation`], is
    /// outward for spheres, and turned around by `reverse_orientation`.
    pub geometric_normal: Vec3,
    /// Unit interpolated normal; the geometric one where there is none, where it vanishes or points
    /// to the other side.
    pub shading_normal: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Running number of the shape: over the instances in order, then over each one's object's
    /// shapes in order.
    pub shape: u32,
    /// The triangle's number in its mesh, else 0.
    pub element: u32,
    /// The instance's number in the scene.
    pub instance: u32,
}

/// Which way a triangle's geometric normal points, relative to (p₁ − p₀) × (p₂ − p₀) in object
/// space: the side of the sum of its vertex normals if the mesh has them, else turned around if
/// `reverse`. Everything about one triangle (emission above all) uses this one sign.
///
/// In world space the cross product of transformed edges changes side under a mirroring transform,
/// a normal does not: multiply by the sign of the transform's determinant to compare with that.
#[must_use]
pub fn triangle_orientation(mesh: &Mesh, triangle: usize, reverse: bool) -> f32 {
    if mesh.normals.is_empty() {
        return if reverse { -1.0 } else { 1.0 };
    }
    let corners = mesh.triangles[triangle].map(|i| i as usize);
    let p = corners.map(|i| mesh.positions[i].as_dvec3());
    let sum: DVec3 = corners.iter().map(|&i| mesh.normals[i].as_dvec3()).sum();
    if (p[1] - p[0]).cross(p[2] - p[0]).dot(sum) < 0.0 { -1.0 } else { 1.0 }
}

const ROUNDING: f64 = 1.0 / (1_u64 << 24) as f64;
const RESIDUE: f64 = 1.0 / (1_u64 << 40) as f64;

/// Half a unit in the last place of `position`, and what its sum in f64 may have lost of
/// `magnitude`. Never zero, whatever f32 flushes.
#[inline]
fn error_bound(position: DVec3, magnitude: DVec3) -> Vec3 {
    (position.abs() * ROUNDING + magnitude * RESIDUE).as_vec3() + f32::MIN_POSITIVE
}

impl Accel {
    /// The geometry of a hit that this structure returned.
    #[inline]
    #[must_use]
    pub fn point(&self, hit: &Hit) -> HitPoint {
        let bottom = self.bottom(hit.instance);
        let cold = &bottom.cold[hit.primitive as usize];
        if bottom.mixed && bottom.slots[hit.primitive as usize].kind() != Kind::Triangle {
            return self.quadric_point(bottom, cold, hit);
        }
        let slot = &bottom.slots[hit.primitive as usize];
        let (u, v) = (f64::from(hit.u), f64::from(hit.v));
        let w = 1.0 - u - v;
        let p: [DVec3; 3] = std::array::from_fn(|i| slot.column(i));
        let mut position = p[0] * w + p[1] * u + p[2] * v;
        // Σ|b_i p_i| ≤ Σ|p_i|, as no weight exceeds 1 by more than rounding.
        let mut magnitude = p[0].abs() + p[1].abs() + p[2].abs();
        let mut normal = cold.normal;
        let mut shading = cold.normal;
        if cold.smooth {
            let n = cold.normals[0] * w as f32 + cold.normals[1] * hit.u + cold.normals[2] * hit.v;
            let squared = n.length_squared();
            // NaN and 0 compare false; so does a normal on the face's other side.
            if squared > 0.0 && squared < f32::INFINITY && n.dot(normal) > 0.0 {
                shading = n / squared.sqrt();
            }
        }
        let mut shape = cold.shape;
        if self.top.is_some() {
            let placement = &self.placements[hit.instance as usize];
            magnitude = placement.magnitude(magnitude);
            position = placement.to_world64.transform_point3(position);
            normal = placement.normal_to_world(normal.as_dvec3()).normalize().as_vec3();
            shading = placement.normal_to_world(shading.as_dvec3()).normalize().as_vec3();
            if shading.dot(normal) <= 0.0 {
                shading = normal;
            }
            shape += placement.first_shape;
        }
        HitPoint {
            position: position.as_vec3(),
            error: error_bound(position, magnitude),
            geometric_normal: normal,
            shading_normal: shading,
            uv: cold.uvs[0] * w as f32 + cold.uvs[1] * hit.u + cold.uvs[2] * hit.v,
            shape,
            element: cold.element,
            instance: hit.instance,
        }
    }

    /// Running shape number and element of a hit: all that emission's table asks, without the
    /// geometry.
    #[inline]
    #[must_use]
    pub fn shape_of(&self, hit: &Hit) -> (u32, u32) {
        let cold = &self.bottom(hit.instance).cold[hit.primitive as usize];
        let first =
            if self.top.is_some() { self.placements[hit.instance as usize].first_shape } else { 0 };
        (first + cold.shape, cold.element)
    }

    /// Derivative of position along the first texture coordinate at a hit, in world space: what
    /// turns anisotropic lobes. Never zero; for an image without area any tangent.
    #[must_use]
    pub fn tangent(&self, hit: &Hit) -> Vec3 {
        let bottom = self.bottom(hit.instance);
        let cold = &bottom.cold[hit.primitive as usize];
        let placement = &self.placements[hit.instance as usize];
        let dpdu = match &bottom.shapes[cold.shape as usize].geometry {
            Geometry::Mesh(_) => {
                let slot = &bottom.slots[hit.primitive as usize];
                let (e1, e2) = (slot.column(1) - slot.column(0), slot.column(2) - slot.column(0));
                let (d1, d2) = (
                    (cold.uvs[1] - cold.uvs[0]).as_dvec2(),
                    (cold.uvs[2] - cold.uvs[0]).as_dvec2(),
                );
                let dpdu = (e1 * d2.y - e2 * d1.y) / d1.perp_dot(d2);
                if self.top.is_some() { placement.to_world64.transform_vector3(dpdu) } else { dpdu }
            }
            Geometry::Sphere { radius, .. } => {
                let at = sphere_decode(Vec2::new(hit.u, hit.v)) * f64::from(*radius);
                placement
                    .to_world64
                    .transform_vector3(DVec3::new(-at.y, at.x, 0.0) * std::f64::consts::TAU)
            }
            Geometry::Disk { normal, radius, .. } => {
                let (s, t) = disk_tangents(normal.as_dvec3().normalize());
                let (u, v) = (f64::from(hit.u), f64::from(hit.v));
                placement.to_world64.transform_vector3(
                    (t * u - s * v) * (f64::from(*radius) * std::f64::consts::TAU),
                )
            }
        };
        let dpdu = dpdu.as_vec3();
        if dpdu.is_finite() && dpdu.length_squared() > 0.0 {
            dpdu
        } else {
            Frame::from_normal(self.point(hit).geometric_normal).tangent
        }
    }

    #[inline(never)]
    fn quadric_point(&self, bottom: &Bottom, cold: &Cold, hit: &Hit) -> HitPoint {
        let placement = &self.placements[hit.instance as usize];
        let local = &bottom.shapes[cold.shape as usize];
        let sign = if local.reverse { -1.0 } else { 1.0 };
        let (center, at, normal, uv) = match &local.geometry {
            Geometry::Sphere { center, radius } => {
                let n = sphere_decode(Vec2::new(hit.u, hit.v));
                let v = 1.0 - n.z.clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
                (center.as_dvec3(), n * f64::from(*radius), n, Vec2::new(turns(n.y, n.x), v as f32))
            }
            Geometry::Disk { center, normal, radius } => {
                let normal = normal.as_dvec3().normalize();
                let (s, t) = disk_tangents(normal);
                let (u, v) = (f64::from(hit.u), f64::from(hit.v));
                let at = (s * u + t * v) * f64::from(*radius);
                (center.as_dvec3(), at, normal, Vec2::new(turns(v, u), (1.0 - u.hypot(v)) as f32))
            }
            Geometry::Mesh(_) => unreachable!("a mesh has triangles only"),
        };
        let position = placement.to_world64.transform_point3(center + at);
        let magnitude = placement.magnitude(center.abs() + at.abs());
        let normal = placement.normal_to_world(normal * sign).normalize().as_vec3();
        HitPoint {
            position: position.as_vec3(),
            error: error_bound(position, magnitude),
            geometric_normal: normal,
            shading_normal: normal,
            uv,
            shape: if self.top.is_some() { placement.first_shape } else { 0 } + cold.shape,
            element: cold.element,
            instance: hit.instance,
        }
    }

    /// Where the surface point of `hit` would be if its instance stood at `to_world`; for motion
    /// vectors.
    #[must_use]
    pub fn point_under(&self, hit: &Hit, to_world: Affine3A) -> Vec3 {
        let bottom = self.bottom(hit.instance);
        let cold = &bottom.cold[hit.primitive as usize];
        let (u, v) = (f64::from(hit.u), f64::from(hit.v));
        let local = match &bottom.shapes[cold.shape as usize].geometry {
            Geometry::Mesh(mesh) => {
                let p = mesh.triangles[cold.element as usize]
                    .map(|i| mesh.positions[i as usize].as_dvec3());
                p[0] * (1.0 - u - v) + p[1] * u + p[2] * v
            }
            Geometry::Sphere { center, radius } => {
                center.as_dvec3() + sphere_decode(Vec2::new(hit.u, hit.v)) * f64::from(*radius)
            }
            Geometry::Disk { center, normal, radius } => {
                let (s, t) = disk_tangents(normal.as_dvec3().normalize());
                center.as_dvec3() + (s * u + t * v) * f64::from(*radius)
            }
        };
        to_world.transform_point3(local.as_vec3())
    }
}

/// The azimuth of (x, y) in turns, in [0, 1).
fn turns(y: f64, x: f64) -> f32 {
    let phi = y.atan2(x);
    let phi = if phi < 0.0 { phi + std::f64::consts::TAU } else { phi };
    (phi / std::f64::consts::TAU) as f32
}
