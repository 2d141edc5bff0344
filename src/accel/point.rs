//! The geometry at a hit: position with its error bound, normals, tangent, texture coordinates.
//!
//! Positions are sums of vertices by barycentric weights in f64, rounded once, so they lie in the surface to half a unit in the last
//! place: |error_i| ≤ 2⁻²⁴ |p_i|, plus what the weights' and the transform's own f64 roundings and the f64 inverse can cost when a ray
//! comes back into an instance's space, 2⁻⁴⁰ times the sum of the magnitudes added (bound met for transforms of condition < 2⁻⁴⁰/2⁻⁵² = 4096
//! relative to that sum; beyond, the offset loses its guarantee gradually).

use glam::{Affine3A, DVec3, Vec2, Vec3};

use super::quadric::{disk_tangents, sphere_decode};
use super::triangle::Kind;
use super::{Accel, Bottom, Hit, Placement};
use crate::math::Frame;
use crate::scene::{Geometry, Mesh};

/// The surface at a [`Hit`], in world space.
#[derive(Clone, Copy, Debug)]
pub struct HitPoint {
    /// On the surface, to within `error`.
    pub position: Vec3,
    /// Bound on |position − true position|, per component: what [`crate::math::offset_origin`] takes.
    pub error: Vec3,
    /// Unit normal of the face. Its side is decided per triangle by [`triangle_orientation`], is outward for spheres, and turned around by
    /// `reverse_orientation`.
    pub geometric_normal: Vec3,
    /// Unit interpolated normal; the geometric one where there is none, where it vanishes or points to the other side.
    pub shading_normal: Vec3,
    /// Derivative of position along the first texture coordinate; never zero, for an image without area any tangent.
    pub dpdu: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Running number of the shape: over the instances in order, then over each one's object's shapes in order.
    pub shape: u32,
    /// The triangle's number in its mesh, else 0.
    pub element: u32,
    /// The instance's number in the scene.
    pub instance: u32,
}

/// Which way a triangle's geometric normal points, relative to (p₁ − p₀) × (p₂ − p₀) in object space: the side of the sum of its vertex
/// normals if the mesh has them, turned around if `reverse`. Everything about one triangle (emission above all) uses this one sign.
///
/// In world space the cross product of transformed edges changes side under a mirroring transform, a normal does not: multiply by the sign
/// of the transform's determinant to compare with that.
#[must_use]
pub fn triangle_orientation(mesh: &Mesh, triangle: usize, reverse: bool) -> f32 {
    let sign = if reverse { -1.0 } else { 1.0 };
    if mesh.normals.is_empty() {
        return sign;
    }
    let corners = mesh.triangles[triangle].map(|i| i as usize);
    let p = corners.map(|i| mesh.positions[i].as_dvec3());
    let sum: DVec3 = corners.iter().map(|&i| mesh.normals[i].as_dvec3()).sum();
    if (p[1] - p[0]).cross(p[2] - p[0]).dot(sum) < 0.0 { -sign } else { sign }
}

const ROUNDING: f64 = 1.0 / (1_u64 << 24) as f64;
const RESIDUE: f64 = 1.0 / (1_u64 << 40) as f64;

/// A point before the common last steps; all in the world.
struct Surface {
    position: DVec3,
    /// Sum of the magnitudes added to make `position`.
    magnitude: DVec3,
    normal: DVec3,
    shading: DVec3,
    dpdu: DVec3,
    uv: Vec2,
}

impl Accel {
    /// The geometry of a hit that this structure returned.
    #[must_use]
    pub fn point(&self, hit: &Hit) -> HitPoint {
        let bottom = self.bottom(hit.instance);
        let cold = &bottom.cold[hit.primitive as usize];
        let placement = &self.placements[hit.instance as usize];
        let local = &bottom.shapes[cold.shape as usize];
        let shape =
            if self.top.is_some() { placement.first_shape + cold.shape } else { cold.shape };
        let sign = if local.reverse { -1.0 } else { 1.0 };
        let surface = match &local.geometry {
            Geometry::Mesh(mesh) => {
                self.triangle_point(bottom, placement, mesh, cold.element, local.reverse, hit)
            }
            Geometry::Sphere { center, radius } => {
                sphere_point(placement, center.as_dvec3(), f64::from(*radius), sign, hit)
            }
            Geometry::Disk { center, normal, radius } => {
                let (center, normal) = (center.as_dvec3(), normal.as_dvec3().normalize());
                disk_point(placement, center, normal, f64::from(*radius), sign, hit)
            }
        };
        let position = surface.position.as_vec3();
        let error = (surface.position.abs() * ROUNDING + surface.magnitude * RESIDUE).as_vec3();
        let geometric_normal = surface.normal.normalize().as_vec3();
        let shading_normal = match surface.shading.try_normalize() {
            Some(shading) if shading.dot(surface.normal) > 0.0 => shading.as_vec3(),
            _ => geometric_normal,
        };
        let dpdu = surface.dpdu.as_vec3();
        let dpdu = if dpdu.is_finite() && dpdu.length_squared() > 0.0 {
            dpdu
        } else {
            Frame::from_normal(geometric_normal).tangent
        };
        HitPoint {
            position,
            // Never zero, whatever f32 flushes.
            error: error + f32::MIN_POSITIVE,
            geometric_normal,
            shading_normal,
            dpdu,
            uv: surface.uv,
            shape,
            element: cold.element,
            instance: hit.instance,
        }
    }

    /// Where the surface point of `hit` would be if its instance stood at `to_world`; for motion vectors.
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

    fn triangle_point(
        &self,
        bottom: &Bottom,
        placement: &Placement,
        mesh: &Mesh,
        element: u32,
        reverse: bool,
        hit: &Hit,
    ) -> Surface {
        let slot = &bottom.slots[hit.primitive as usize];
        debug_assert_eq!(slot.kind(), Kind::Triangle);
        let weights =
            [1.0 - f64::from(hit.u) - f64::from(hit.v), f64::from(hit.u), f64::from(hit.v)];
        let p: [DVec3; 3] = std::array::from_fn(|i| slot.column(i));
        let position = p[0] * weights[0] + p[1] * weights[1] + p[2] * weights[2];
        let sum = p[0].abs() * weights[0].abs() + p[1].abs() * weights[1] + p[2].abs() * weights[2];
        let corners = mesh.triangles[element as usize].map(|i| i as usize);
        let mut sign = f64::from(triangle_orientation(mesh, element as usize, reverse));
        let shading = if mesh.normals.is_empty() {
            DVec3::ZERO
        } else {
            let n = corners.map(|i| mesh.normals[i].as_dvec3());
            let n = n[0] * weights[0] + n[1] * weights[1] + n[2] * weights[2];
            placement.normal_to_world(if reverse { -n } else { n })
        };
        let uvs = if mesh.uvs.is_empty() {
            [Vec2::ZERO, Vec2::X, Vec2::ONE]
        } else {
            corners.map(|i| mesh.uvs[i])
        };
        let uv = uvs[0] * weights[0] as f32 + uvs[1] * hit.u + uvs[2] * hit.v;
        let (e1, e2) = (p[1] - p[0], p[2] - p[0]);
        let (d1, d2) = ((uvs[1] - uvs[0]).as_dvec2(), (uvs[2] - uvs[0]).as_dvec2());
        // By the sign alone: the length is divided out where it is not, and it may be tiny.
        let dpdu = (e1 * d2.y - e2 * d1.y) / d1.perp_dot(d2);
        let normal = e1.cross(e2);
        if self.top.is_some() {
            Surface {
                position: placement.to_world64.transform_point3(position),
                magnitude: placement.magnitude(sum),
                normal: placement.normal_to_world(normal * sign),
                shading,
                dpdu: placement.to_world64.transform_vector3(dpdu),
                uv,
            }
        } else {
            if placement.mirrored {
                sign = -sign;
            }
            Surface { position, magnitude: sum, normal: normal * sign, shading, dpdu, uv }
        }
    }
}

fn sphere_point(
    placement: &Placement,
    center: DVec3,
    radius: f64,
    sign: f64,
    hit: &Hit,
) -> Surface {
    let n = sphere_decode(Vec2::new(hit.u, hit.v));
    let at = n * radius;
    let phi = n.y.atan2(n.x);
    let phi = if phi < 0.0 { phi + std::f64::consts::TAU } else { phi };
    let v = 1.0 - n.z.clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
    let normal = placement.normal_to_world(n * sign);
    Surface {
        position: placement.to_world64.transform_point3(center + at),
        magnitude: placement.magnitude(center.abs() + at.abs()),
        normal,
        shading: normal,
        dpdu: placement
            .to_world64
            .transform_vector3(DVec3::new(-at.y, at.x, 0.0) * std::f64::consts::TAU),
        uv: Vec2::new((phi / std::f64::consts::TAU) as f32, v as f32),
    }
}

fn disk_point(
    placement: &Placement,
    center: DVec3,
    normal: DVec3,
    radius: f64,
    sign: f64,
    hit: &Hit,
) -> Surface {
    let (s, t) = disk_tangents(normal);
    let (u, v) = (f64::from(hit.u), f64::from(hit.v));
    let at = (s * u + t * v) * radius;
    let phi = v.atan2(u);
    let phi = if phi < 0.0 { phi + std::f64::consts::TAU } else { phi };
    let world_normal = placement.normal_to_world(normal * sign);
    Surface {
        position: placement.to_world64.transform_point3(center + at),
        magnitude: placement.magnitude(center.abs() + at.abs()),
        normal: world_normal,
        shading: world_normal,
        dpdu: placement
            .to_world64
            .transform_vector3((t * u - s * v) * (radius * std::f64::consts::TAU)),
        uv: Vec2::new((phi / std::f64::consts::TAU) as f32, (1.0 - u.hypot(v)) as f32),
    }
}
