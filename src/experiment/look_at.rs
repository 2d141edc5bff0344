//! A camera in place of the scene's.

use glam::{Affine3A, DVec3, Vec3};

use crate::scene::{Camera, Transform};
use crate::{Error, Result};

/// Where a camera stands, what it looks at and which way is up, as in pbrt's `LookAt`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookAt {
    eye: Vec3,
    forward: Vec3,
    up: Vec3,
}

impl LookAt {
    /// A camera at `eye` with `target` in the middle of its picture and `up` pointing upwards
    /// there.
    ///
    /// # Errors
    /// A usage error where a number is not finite, the target is the eye, or `up` has no length or
    /// lies along the direction of view.
    pub fn new(eye: Vec3, target: Vec3, up: Vec3) -> Result<Self> {
        let [from, to, above] = [eye, target, up].map(Vec3::as_dvec3);
        if !(from + to + above).is_finite() {
            return Err(Error::usage("a view of eye, target and up vector needs finite numbers"));
        }
        let Some(forward) = (to - from).try_normalize() else {
            return Err(Error::usage(
                "the view's target is its eye; allowed: a target beside the eye",
            ));
        };
        // An up vector within 10⁻⁴ of the direction would leave the picture's rotation to rounding.
        let upwards = above.try_normalize().map(|up| up - forward * forward.dot(up));
        let Some(up) = upwards.filter(|up| up.length() > 1e-4).and_then(DVec3::try_normalize)
        else {
            return Err(Error::usage(
                "the view's up vector has no length or lies along its direction; allowed: another up",
            ));
        };
        Ok(Self { eye, forward: forward.as_vec3(), up: up.as_vec3() })
    }

    /// The camera, with the angle of another and, so that no picture is mirrored that was not, its
    /// handedness.
    pub(super) fn camera(self, other: &Camera, time: f32) -> Camera {
        let right = self.up.cross(self.forward);
        let mirrored = other.to_world.at(time).matrix3.determinant() < 0.0;
        let right = if mirrored { -right } else { right };
        let Self { eye, forward, up } = self;
        let to_world = Affine3A::from_cols(right.into(), up.into(), forward.into(), eye.into());
        Camera { to_world: Transform::Fixed(to_world), fov: other.fov }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    #[test]
    fn the_target_is_in_the_middle_and_up_is_above_it() {
        let view = LookAt::new(Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 0.0, 5.0), 7.0 * Vec3::Y);
        let view = view.unwrap();
        for mirrored in [false, true] {
            let sign = if mirrored { -1.0 } else { 1.0 };
            let flip = Affine3A::from_scale(Vec3::new(sign, 1.0, 1.0));
            let other = Camera { to_world: Transform::Fixed(flip), fov: 0.7 };
            let camera = view.camera(&other, 0.0);
            assert_eq!(camera.fov, 0.7);
            let see = |p: Vec3| camera.project(p, [200, 100]).unwrap();
            let middle = see(Vec3::new(4.0, 0.0, 5.0));
            assert!((middle - Vec2::new(100.0, 50.0)).length() < 1e-3, "{middle}");
            let above = see(Vec3::new(4.0, 0.1, 5.0));
            assert!((above.x - 100.0).abs() < 1e-3 && above.y < 50.0, "{above}");
            // Where the file's camera is mirrored, so is this one.
            let matrix = camera.to_world.fixed().matrix3;
            assert!((matrix.determinant() - sign).abs() < 1e-5);
        }
    }

    #[test]
    fn views_that_are_none_are_refused() {
        let one = Vec3::ONE;
        for (eye, target, up, why) in [
            (one, one, Vec3::Y, "target"),
            (Vec3::ZERO, Vec3::Y, Vec3::Y, "up vector"),
            (Vec3::ZERO, Vec3::Y, Vec3::NEG_Y, "up vector"),
            (Vec3::ZERO, one, Vec3::ZERO, "up vector"),
            (Vec3::NAN, one, Vec3::Y, "finite"),
            (Vec3::ZERO, Vec3::splat(f32::INFINITY), Vec3::Y, "finite"),
        ] {
            let error = LookAt::new(eye, target, up).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains(why), "{error}");
        }
    }
}
