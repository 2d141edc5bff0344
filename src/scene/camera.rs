//! The perspective camera.

use glam::{Affine3A, Vec2, Vec3};

use super::Transform;

/// A pinhole camera. In camera space x points right, y up, z forward (left-handed, as in pbrt).
#[derive(Clone, Debug)]
pub struct Camera {
    /// Camera space to world; no scale.
    pub to_world: Transform,
    /// Full opening angle in radians across the *shorter* side of the picture, in (0, π).
    pub fov: f32,
}

/// A primary ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraRay {
    /// The pinhole, in world space.
    pub origin: Vec3,
    /// Unit direction into the scene.
    pub direction: Vec3,
}

impl Default for Camera {
    fn default() -> Self {
        Self { to_world: Transform::IDENTITY, fov: std::f32::consts::FRAC_PI_2 }
    }
}

/// All primary rays of one picture, with what they share computed once.
#[derive(Clone, Copy, Debug)]
pub struct CameraRays {
    origin: Vec3,
    corner: Vec3,
    right: Vec3,
    down: Vec3,
}

impl CameraRays {
    /// The ray through `position`, in pixels from the upper left corner (centres at half integers).
    #[inline]
    #[must_use]
    pub fn ray(&self, position: Vec2) -> CameraRay {
        let direction = self.corner + self.right * position.x + self.down * position.y;
        CameraRay { origin: self.origin, direction: direction.normalize() }
    }
}

#[cfg(feature = "gpu")]
impl CameraRays {
    /// Origin, corner of the picture plane, steps to the right and down.
    pub(crate) fn parts(&self) -> [Vec3; 4] {
        [self.origin, self.corner, self.right, self.down]
    }
}

impl Camera {
    /// The rays of a `size` picture. The camera's transform must be fixed (see
    /// [`super::Scene::at`]).
    #[must_use]
    pub fn rays(&self, size: [u32; 2]) -> CameraRays {
        let to_world = self.to_world.fixed();
        let size = Vec2::new(size[0] as f32, size[1] as f32);
        let scale = (0.5 * self.fov).tan() * 2.0 / size.min_element();
        CameraRays {
            origin: to_world.translation.into(),
            corner: to_world.transform_vector3(Vec3::new(
                -0.5 * size.x * scale,
                0.5 * size.y * scale,
                1.0,
            )),
            right: to_world.transform_vector3(Vec3::X) * scale,
            down: to_world.transform_vector3(Vec3::NEG_Y) * scale,
        }
    }

    /// Where world points lie in a `size` picture: inverse of [`Camera::rays`].
    #[must_use]
    pub fn projection(&self, size: [u32; 2]) -> Projection {
        let to_world = self.to_world.fixed();
        let size = Vec2::new(size[0] as f32, size[1] as f32);
        let scale = (0.5 * self.fov).tan() * 2.0 / size.min_element();
        Projection {
            to_camera: to_world.inverse(),
            origin: to_world.translation.into(),
            per_unit: scale.recip(),
            middle: 0.5 * size,
        }
    }

    /// The pixel position that a world point projects to, or `None` at and behind the pinhole.
    /// Inverse of [`CameraRays::ray`].
    #[must_use]
    pub fn project(&self, point: Vec3, size: [u32; 2]) -> Option<Vec2> {
        self.projection(size).project(point)
    }
}

/// World points to pixel positions, with what all share computed once.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    to_camera: Affine3A,
    origin: Vec3,
    per_unit: f32,
    middle: Vec2,
}

impl Projection {
    /// The map to camera space, the pinhole, pixels a unit at distance 1, the picture's middle.
    #[cfg(feature = "gpu")]
    pub(crate) fn parts(&self) -> (Affine3A, Vec3, f32, Vec2) {
        (self.to_camera, self.origin, self.per_unit, self.middle)
    }

    /// The pixel position of a world point, or `None` at and behind the pinhole.
    #[inline]
    #[must_use]
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        let local = self.to_camera.transform_point3(point);
        let position = Vec2::new(local.x, -local.y) * (self.per_unit / local.z) + self.middle;
        (local.z > 0.0 && position.is_finite()).then_some(position)
    }

    /// Distance of a world point from the pinhole.
    #[inline]
    #[must_use]
    pub fn distance(&self, point: Vec3) -> f32 {
        (point - self.origin).length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;

    #[test]
    fn project_inverts_ray() {
        let to_world = Affine3A::from_rotation_translation(
            Quat::from_rotation_y(0.7),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let camera = Camera { to_world: Transform::Fixed(to_world), fov: 0.6 };
        for p in [Vec2::new(0.5, 0.5), Vec2::new(31.5, 7.25), Vec2::new(63.9, 0.1)] {
            let ray = camera.rays([64, 48]).ray(p);
            let back = camera.project(ray.origin + 5.0 * ray.direction, [64, 48]).unwrap();
            assert!((back - p).length() < 1e-3, "{p} -> {back}");
            assert_eq!(camera.project(ray.origin - ray.direction, [64, 48]), None);
        }
    }

    #[test]
    fn fov_spans_the_shorter_side() {
        let camera = Camera { to_world: Transform::IDENTITY, fov: std::f32::consts::FRAC_PI_2 };
        let top = camera.rays([80, 20]).ray(Vec2::new(40.0, 0.0)).direction;
        assert!((top.y / top.z - 1.0).abs() < 1e-6, "{top}");
        let left = camera.rays([20, 80]).ray(Vec2::new(0.0, 40.0)).direction;
        assert!((left.x / left.z + 1.0).abs() < 1e-6, "{left}");
    }
}
