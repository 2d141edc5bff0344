//! Scenes with one thing moving, made in memory from scene files.
//!
//! A scene that moves has all but the wanted motion stopped at its start. A still one is taken apart, an instance a shape, and the
//! wanted thing slides along a line: the camera to its right, lights and occluder along x.

use glam::{Affine3A, Quat, Vec3};

use crate::scene::{
    Curve, Geometry, Instance, Interpolation, Object, Scene, Shape, Track, Transform,
};
use crate::techniques::Moving;
use crate::world::bounds;
use crate::{Error, Result};

/// The path of the camera as a share of the scene's diagonal, and of a thing as a share of its own.
const CAMERA_PATH: f32 = 0.03;
const THING_PATH: f32 = 0.5;

/// `scene` with only the wanted motion in it. Where that has to be made, it takes `seconds`.
pub(super) fn only(scene: &Scene, wanted: Moving, seconds: f32) -> Result<Scene> {
    let start = scene.at(scene.time[0]);
    let emits = |instance: &Instance| emits(scene, instance);
    if scene.moves() {
        let mut made = scene.clone();
        let mut moves = false;
        let mut choose = |keep: bool, to_world: &mut Transform, fixed: &Transform| {
            if keep {
                moves |= to_world.moves();
            } else {
                to_world.clone_from(fixed);
            }
        };
        choose(wanted.has(Moving::Camera), &mut made.camera.to_world, &start.camera.to_world);
        for (instance, fixed) in made.instances.iter_mut().zip(&start.instances) {
            let thing = if emits(instance) { Moving::Light } else { Moving::Occluder };
            choose(wanted.has(thing), &mut instance.to_world, &fixed.to_world);
        }
        for (light, fixed) in made.lights.iter_mut().zip(&start.lights) {
            choose(wanted.has(Moving::Light), &mut light.to_world, &fixed.to_world);
        }
        if moves || wanted == Moving::Still {
            return Ok(made);
        }
    } else if wanted == Moving::Still {
        return Ok(scene.clone());
    }
    slide(apart(&start), wanted, seconds)
}

/// The same surfaces with an instance a shape. All transforms are fixed.
pub(super) fn apart(scene: &Scene) -> Scene {
    let mut made = Scene { objects: Vec::new(), instances: Vec::new(), ..scene.clone() };
    for instance in &scene.instances {
        for shape in &scene.objects[instance.object.index()].shapes {
            let object =
                made.add_object(Object { name: String::new(), shapes: vec![shape.clone()] });
            let key = made.instances.len() as u64;
            made.add_instance(object, instance.to_world.clone(), key);
        }
    }
    made
}

/// The smallest surface that does not emit, of a scene that is taken [apart].
pub(super) fn occluder(scene: &Scene) -> Result<usize> {
    (0..scene.instances.len())
        .filter(|&at| !emits(scene, &scene.instances[at]))
        .min_by(|&a, &b| diagonal(scene, a).total_cmp(&diagonal(scene, b)))
        .ok_or_else(|| Error::usage("the scene has no surface that does not emit, so no occluder"))
}

pub(super) fn emits(scene: &Scene, instance: &Instance) -> bool {
    scene.objects[instance.object.index()].shapes.iter().any(|shape| shape.emission.is_some())
}

fn slide(mut scene: Scene, wanted: Moving, seconds: f32) -> Result<Scene> {
    let [low, high] = bounds(&scene);
    scene.time = [0.0, seconds];
    if wanted.has(Moving::Camera) {
        let right: Vec3 = scene.camera.to_world.fixed().matrix3.x_axis.into();
        move_by(
            &mut scene.camera.to_world,
            CAMERA_PATH * (high - low).length() * right.normalize_or_zero(),
            seconds,
        );
    }
    if wanted.has(Moving::Light) {
        let lamps: Vec<usize> =
            (0..scene.instances.len()).filter(|&at| emits(&scene, &scene.instances[at])).collect();
        if lamps.is_empty() && scene.lights.is_empty() {
            return Err(Error::usage("the scene has no light that could move"));
        }
        // Lamps keep their distances; lights without a surface have no size of their own.
        let size = lamps.iter().map(|&at| diagonal(&scene, at)).reduce(f32::max);
        let path = size
            .map_or(CAMERA_PATH * (high - low).length(), |diagonal| THING_PATH * diagonal)
            * Vec3::X;
        for at in lamps {
            move_by(&mut scene.instances[at].to_world, path, seconds);
        }
        for light in &mut scene.lights {
            move_by(&mut light.to_world, path, seconds);
        }
    }
    if wanted.has(Moving::Occluder) {
        let at = occluder(&scene)?;
        let path = THING_PATH * diagonal(&scene, at) * Vec3::X;
        move_by(&mut scene.instances[at].to_world, path, seconds);
    }
    Ok(scene)
}

fn move_by(to_world: &mut Transform, path: Vec3, seconds: f32) {
    let start = to_world.fixed();
    *to_world = Transform::Chain(vec![
        Track::Trs {
            translation: Curve {
                keys: vec![(0.0, Vec3::ZERO), (seconds, path)],
                interpolation: Interpolation::Linear,
            },
            rotation: Curve::constant(Quat::IDENTITY),
            scale: Curve::constant(Vec3::ONE),
        },
        Track::Fixed(start),
    ]);
}

/// Moved in world space.
pub(super) fn moved(to_world: &Transform, path: Vec3) -> Transform {
    Transform::Fixed(Affine3A::from_translation(path) * to_world.fixed())
}

/// Of the box around an instance that may move already, as it stands at first.
pub(super) fn diagonal(scene: &Scene, instance: usize) -> f32 {
    let to_world = scene.instances[instance].to_world.at(scene.time[0]);
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for Shape { geometry, .. } in &scene.objects[scene.instances[instance].object.index()].shapes {
        let mut add = |p: Vec3| {
            let p = to_world.transform_point3(p);
            (low, high) = (low.min(p), high.max(p));
        };
        match geometry {
            Geometry::Mesh(mesh) => mesh.positions.iter().for_each(|p| add(*p)),
            Geometry::Sphere { center, radius } | Geometry::Disk { center, radius, .. } => {
                for sign in [-1.0, 1.0] {
                    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                        add(*center + sign * *radius * axis);
                    }
                }
            }
        }
    }
    (high - low).max(Vec3::ZERO).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::load::load;

    fn scene(name: &str) -> Scene {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        load(&path).unwrap().scene
    }

    /// Which of camera, lights and other surfaces move.
    fn moving(scene: &Scene) -> [bool; 3] {
        let of = |light: bool| {
            scene.instances.iter().any(|i| i.to_world.moves() && emits(scene, i) == light)
        };
        [scene.camera.to_world.moves(), of(true), of(false)]
    }

    #[test]
    fn only_the_wanted_thing_moves_and_the_first_frame_is_the_files() {
        for name in ["moving.pbrt", "penumbra.pbrt"] {
            let file = scene(name);
            for (wanted, expected) in [
                (Moving::Still, [false; 3]),
                (Moving::Camera, [true, false, false]),
                (Moving::Light, [false, true, false]),
                (Moving::Occluder, [false, false, true]),
                (Moving::All, [true; 3]),
            ] {
                let made = only(&file, wanted, 1.0).unwrap();
                made.validate().unwrap();
                assert_eq!(moving(&made), expected, "{name} {wanted:?}");
                let camera = |scene: &Scene| scene.camera.to_world.at(scene.time[0]);
                assert_eq!(camera(&made), camera(&file), "{name} {wanted:?}");
                assert_eq!(bounds(&made.at(made.time[0])), bounds(&file.at(file.time[0])));
            }
        }
    }

    #[test]
    fn the_occluder_of_penumbra_is_the_board_and_it_slides_half_its_diagonal() {
        let made = only(&scene("penumbra.pbrt"), Moving::Occluder, 2.0).unwrap();
        let slid: Vec<_> = made.instances.iter().filter(|i| i.to_world.moves()).collect();
        assert_eq!(slid.len(), 1);
        let path = slid[0].to_world.at(2.0).translation - slid[0].to_world.at(0.0).translation;
        assert!((Vec3::from(path) - 0.5 * 2.0_f32.sqrt() * Vec3::X).length() < 1e-5, "{path}");
    }

    #[test]
    fn what_is_not_there_cannot_move() {
        let empty = Scene::new("empty");
        assert!(only(&empty, Moving::Light, 1.0).unwrap_err().is_usage());
        assert!(only(&empty, Moving::Occluder, 1.0).unwrap_err().is_usage());
    }
}
