//! Lights, places on lights, surfaces and skies of a path are found again in another frame's world.

use glam::{DMat3, Mat3A, Vec3};

use super::failure::Failure;
use super::shift::{PathReceiver, PathShift};
use crate::accel::{Hit, HitFilter, HitPoint};
use crate::light::LightPoint;
use crate::reuse::light_points::Time;
use crate::world::World;

impl<F: HitFilter> PathShift<'_, F> {
    /// Whether what lies behind `x_r` must be traced again between two receivers.
    #[inline]
    pub(super) fn retraces_between(&self, from: &PathReceiver<'_>, to: &PathReceiver<'_>) -> bool {
        self.retraces && from.time != to.time
    }

    /// A light's place in the destination's table.
    pub(super) fn light_there(
        &self,
        light: u32,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
    ) -> Result<u32, Failure> {
        if from.time == to.time {
            return Ok(light);
        }
        let remap = self.motion.and_then(|motion| motion.lights.as_ref());
        let there = match (remap, to.time) {
            (None, _) => Some(light),
            (Some(remap), Time::Now) => remap.to_current(light),
            (Some(remap), Time::Before) => remap.to_previous(light),
        };
        there
            .filter(|there| to.world.lights.same_kind(*there, &from.world.lights, light))
            .ok_or(Failure::LightGone)
    }

    /// The same place on the destination's light, and the ratio of measures, which is \|∂T/∂y\|.
    pub(super) fn point_there(
        &self,
        point: LightPoint,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
    ) -> Result<(LightPoint, f32), Failure> {
        if from.time == to.time {
            return Ok((point, 1.0));
        }
        let there = LightPoint { light: self.light_there(point.light, from, to)?, ..point };
        Ok((there, to.world.lights.scaling(there, &from.world.lights, point)))
    }

    /// A sky's number among those of the destination.
    pub(super) fn sky_there(
        &self,
        sky: u32,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
    ) -> Result<u32, Failure> {
        if from.time == to.time {
            return Ok(sky);
        }
        let mut skies = from.world.lights.environments();
        let (light, _) = skies.nth(sky as usize).ok_or(Failure::LightGone)?;
        let light = self.light_there(light, from, to)?;
        let place = to.world.lights.environments().position(|(there, _)| there == light);
        place.map(|place| place as u32).ok_or(Failure::LightGone)
    }

    /// A hit on the destination's instance, and how the area there grew.
    pub(super) fn hit_there(
        &self,
        hit: &Hit,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
    ) -> Result<(Hit, HitPoint, f32), Failure> {
        let place = match (self.motion, to.time) {
            _ if from.time == to.time => Some(hit.instance),
            (None, _) => Some(hit.instance),
            (Some(motion), Time::Now) => motion.current_instance(hit.instance),
            (Some(motion), Time::Before) => motion.previous_instance(hit.instance),
        };
        let there = Hit { instance: place.ok_or(Failure::ObjectGone)?, ..*hit };
        let point = to.world.accel.point(&there);
        let ratio = if from.time == to.time {
            1.0
        } else {
            let placed = |world: &World, hit: &Hit| {
                world.scene.instances[hit.instance as usize].to_world.fixed().matrix3
            };
            area_ratio(placed(from.world, hit), placed(to.world, &there), point.geometric_normal)
        };
        Ok((there, point, ratio))
    }
}

/// dA'/dA of a surface whose instance stood as `was` says and stands as `is` says, where its unit
/// normal is `normal`: 1 for rigid motions, exactly so where nothing moves.
///
/// Under x ↦ Mx an area grows by \|det M\| \|M⁻ᵀ n\| with its unit normal n before, which is
/// \|det M\| / \|Mᵀ n'\| with the unit normal n' after.
pub(super) fn area_ratio(was: Mat3A, is: Mat3A, normal: Vec3) -> f32 {
    if was == is {
        return 1.0;
    }
    let [was, is] = [was, is].map(|m| DMat3::from_cols_array(&m.to_cols_array().map(f64::from)));
    let moved = is * was.inverse();
    (moved.determinant().abs() / (moved.transpose() * normal.as_dvec3()).length()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    /// The ratio is that of a triangle under both placements, mirrored ones too, and its inverse
    /// the other way round.
    #[test]
    fn areas_grow_as_a_triangle_does() {
        let mut random = Stream::from_key(3);
        let mut vector = || Vec3::from([(); 3].map(|()| 2.0 * random.uniform() - 1.0));
        for _ in 0..200 {
            let edges = [vector(), vector()];
            let mut placement =
                || Mat3A::from_cols(vector().into(), vector().into(), vector().into());
            let (was, is) = (placement(), placement());
            let cross = |m: Mat3A| {
                let [a, b] = edges.map(|edge| (m * edge).as_dvec3());
                a.cross(b)
            };
            let (before, after) = (cross(was), cross(is));
            if was.determinant().abs() < 0.05 || is.determinant().abs() < 0.05 {
                continue;
            }
            let expected = (after.length() / before.length()) as f32;
            let ratio = area_ratio(was, is, after.normalize().as_vec3());
            assert!((ratio / expected - 1.0).abs() < 1e-4, "{ratio} instead of {expected}");
            let back = area_ratio(is, was, before.normalize().as_vec3());
            assert!((ratio * back - 1.0).abs() < 1e-4, "{ratio} and {back}");
        }
        assert_eq!(area_ratio(Mat3A::IDENTITY, Mat3A::IDENTITY, Vec3::X), 1.0);
    }
}
