//! A lobe follows the light that it was born of from frame to frame.

use super::LobeState;
use crate::light::{LightRemap, Lights, NO_LIGHT};
use crate::resampling::{ShiftMap, Shifted};
use crate::reuse::light_points::Time;

/// The lights of a frame.
#[derive(Clone, Copy, Debug)]
pub struct LightsAt<'a> {
    /// Its table.
    pub lights: &'a Lights,
    /// Which frame's.
    pub time: Time,
}

/// T(ȳ) = ȳ + (the light's centre there − here): the target moves with its light, by a translation,
/// so |∂T| = 1. Undefined where the light is not there. A sky's direction stays.
///
/// T keeps all else of a lobe, which is its stratum.
#[derive(Clone, Copy, Debug)]
pub struct LobeFollow<'a> {
    /// Where lights of the other frame are; `None`: at the same place in the table.
    pub remap: Option<&'a LightRemap>,
}

impl<'a> ShiftMap for LobeFollow<'a> {
    type Sample = LobeState;
    type Domain = LightsAt<'a>;
    /// The score: what lobes are chosen by.
    type Integrand = f32;
    type Stratum = [u32; 4];

    #[inline]
    fn shift(
        &mut self,
        sample: &LobeState,
        from: &LightsAt<'a>,
        to: &LightsAt<'a>,
    ) -> Option<Shifted<LobeState, f32>> {
        let (integrand, jacobian) = (sample.score, 1.0);
        if from.time == to.time {
            return Some(Shifted { sample: *sample, integrand, jacobian });
        }
        let light = match (self.remap, to.time) {
            (None, _) => sample.light,
            (Some(remap), Time::Now) => remap.to_current(sample.light)?,
            (Some(remap), Time::Before) => remap.to_previous(sample.light)?,
        };
        let mut moved = *sample;
        moved.light = light;
        if !sample.is_sky() {
            let way = to.lights.center(light)? - from.lights.center(sample.light)?;
            for (at, by) in moved.target.iter_mut().zip(way.to_array()) {
                *at += by;
            }
        }
        Some(Shifted { sample: moved, integrand, jacobian })
    }

    fn stratum(&self, sample: &LobeState) -> [u32; 4] {
        let LobeState { spread, weight, score, .. } = *sample;
        [spread.to_bits(), weight.to_bits(), score.to_bits(), sample.count()]
    }
}

const _: () = assert!(NO_LIGHT == u32::MAX, "no table has a light of that number");

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Vec3};

    use super::*;
    use crate::resampling::laws::check_shift;
    use crate::scene::{Color, Geometry, Material, Scene, Shape, Transform};

    fn lights(places: &[(u64, Vec3)]) -> Lights {
        let mut scene = Scene::new("lamps");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        for (key, place) in places {
            let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 0.5 };
            scene.add_shape(Shape::new(ball, black).emitting(Vec3::ONE));
            let instance = scene.instances.last_mut().unwrap();
            instance.key = *key;
            instance.to_world = Transform::Fixed(Affine3A::from_translation(*place));
        }
        Lights::build(&scene, [Vec3::splat(-9.0), Vec3::splat(9.0)])
    }

    /// All laws of a shift, for lights that move, come, go and change their places in the table;
    /// the way is the light's.
    #[test]
    fn lobes_follow_their_lights() {
        let then = lights(&[(7, Vec3::X), (3, Vec3::Y), (9, Vec3::Z)]);
        let now = lights(&[(9, Vec3::Z), (5, -Vec3::X), (7, 3.0 * Vec3::X)]);
        let remap = LightRemap::new(&then, &now).unwrap();
        let domains = [
            LightsAt { lights: &then, time: Time::Before },
            LightsAt { lights: &now, time: Time::Now },
        ];
        let mut map = LobeFollow { remap: Some(&remap) };
        let lobe = |light, target: Vec3| {
            let mut lobe = LobeState::NONE;
            (lobe.light, lobe.target) = (light, target.to_array());
            (lobe.weight, lobe.score) = (1.0, 2.0);
            lobe
        };
        let near = |a: &LobeState, b: &LobeState| {
            a.light == b.light && Vec3::from(a.target).distance(b.target.into()) < 1e-6
        };
        let lobes: Vec<LobeState> = (0..3).map(|light| lobe(light, Vec3::ONE)).collect();
        check_shift(&mut map, &lobes, &domains, 0.0, near);
        let moved = map.shift(&lobes[0], &domains[0], &domains[1]).unwrap();
        assert_eq!((moved.sample.light, moved.sample.target), (2, [3.0, 1.0, 1.0]));
        assert!(map.shift(&lobes[1], &domains[0], &domains[1]).is_none(), "its light is gone");
    }
}
