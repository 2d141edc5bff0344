//! Scenes with one thing moving, made in memory from scene files.
//!
//! A scene that moves has all but the wanted motion stopped at its start. A still one is taken
//! apart, an instance a shape, and the wanted thing slides along a line: the camera to its right,
//! lights and occluder along x.

use glam::{Affine3A, Quat, Vec3};

use crate::scene::{
    Curve, Geometry, Instance, Interpolation, Object, Scene, Shape, Track, Transform,
};
use crate::techniques::Moving;
use crate::world::bounds;
use crate::{Error, Result};

/// Of rungs, the path of the camera as a share of the scene's diagonal, and of a thing as a share
/// of its own.
const CAMERA_PATH: f32 = 0.03;
const THING_PATH: f32 = 0.5;
/// Frames after which what was made to move stands still. Their number is fixed, so that a frame's
/// scene, and with it the key of its reference, does not depend on how many frames a run has.
const SLIDE_FRAMES: u32 = 1000;

/// How far what has to be made to move slides.
#[derive(Clone, Copy, Debug)]
pub(super) enum Slide {
    /// Within so many seconds a rung's way: the camera three hundredths of the scene's diagonal, a
    /// thing half of its own.
    Rung(f32),
    /// By a share of the scene's diagonal a frame, of so many frames a second.
    Share { share: f32, fps: u32 },
}

impl Slide {
    /// Seconds that it takes.
    fn seconds(self) -> f32 {
        match self {
            Self::Rung(seconds) => seconds,
            Self::Share { fps, .. } => SLIDE_FRAMES as f32 / fps as f32,
        }
    }

    /// How far the camera goes, or a thing of a diagonal of its own, in a scene of diagonal
    /// `scene`.
    fn length(self, scene: f32, thing: Option<f32>) -> f32 {
        match (self, thing) {
            (Self::Share { share, .. }, _) => SLIDE_FRAMES as f32 * share * scene,
            (Self::Rung(_), Some(own)) => THING_PATH * own,
            (Self::Rung(_), None) => CAMERA_PATH * scene,
        }
    }
}

/// What alone moves in a session's scene, and how fast where that has to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneMotion {
    moving: Moving,
    share: Option<f32>,
}

impl SceneMotion {
    /// Share of the scene's diagonal a frame where none is given.
    pub const DEFAULT_SHARE: f32 = 0.001;
    /// The largest share.
    pub const MOST: f32 = 0.1;

    /// Only `moving` moves. What has to be made to move slides by `share` of the scene's diagonal a
    /// frame, for a thousand frames: the camera to its right, lights and occluder along x.
    ///
    /// # Errors
    /// A usage error where the share is not in (0, 0.1].
    pub fn new(moving: Moving, share: Option<f32>) -> Result<Self> {
        if let Some(share) = share.filter(|share| !(*share > 0.0 && *share <= Self::MOST)) {
            return Err(Error::usage(format!(
                "a motion of {share} of the scene's diagonal a frame is not in (0, {}]",
                Self::MOST
            )));
        }
        Ok(Self { moving, share })
    }

    /// The scene with this motion alone; `note` hears of a share that has no use.
    pub(super) fn apply(self, scene: &Scene, fps: u32, note: impl FnOnce(&str)) -> Result<Scene> {
        let share = self.share.unwrap_or(Self::DEFAULT_SHARE);
        if self.share.is_some() && stopped_but(scene, self.moving).is_some() {
            note("the scene has this motion itself, so the share is not used");
        }
        only(scene, self.moving, Slide::Share { share, fps })
    }
}

/// `scene` with only the wanted motion in it, its own where it has any, else one that is made.
pub(super) fn only(scene: &Scene, wanted: Moving, slide: Slide) -> Result<Scene> {
    match stopped_but(scene, wanted) {
        Some(made) => Ok(made),
        None => slid(apart(&scene.at(scene.time[0])), wanted, slide),
    }
}

/// The scene with all but the wanted motion stopped at its start; `None` where the wanted motion is
/// not its own.
fn stopped_but(scene: &Scene, wanted: Moving) -> Option<Scene> {
    if !scene.moves() {
        return (wanted == Moving::Still).then(|| scene.clone());
    }
    let start = scene.at(scene.time[0]);
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
        let thing = if emits(scene, instance) { Moving::Light } else { Moving::Occluder };
        choose(wanted.has(thing), &mut instance.to_world, &fixed.to_world);
    }
    for (light, fixed) in made.lights.iter_mut().zip(&start.lights) {
        choose(wanted.has(Moving::Light), &mut light.to_world, &fixed.to_world);
    }
    (moves || wanted == Moving::Still).then_some(made)
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

/// A scene that is taken [apart], with the wanted things on their way.
fn slid(mut scene: Scene, wanted: Moving, slide: Slide) -> Result<Scene> {
    let [low, high] = bounds(&scene);
    let (whole, seconds) = ((high - low).length(), slide.seconds());
    scene.time = [0.0, seconds];
    if wanted.has(Moving::Camera) {
        let right: Vec3 = scene.camera.to_world.fixed().matrix3.x_axis.into();
        let path = slide.length(whole, None) * right.normalize_or_zero();
        move_by(&mut scene.camera.to_world, path, seconds);
    }
    if wanted.has(Moving::Light) {
        let lamps: Vec<usize> =
            (0..scene.instances.len()).filter(|&at| emits(&scene, &scene.instances[at])).collect();
        if lamps.is_empty() && scene.lights.is_empty() {
            return Err(Error::usage("the scene has no light that could move"));
        }
        // Lamps keep their distances; lights without a surface have no size of their own.
        let largest = lamps.iter().map(|&at| diagonal(&scene, at)).reduce(f32::max);
        let path = slide.length(whole, largest) * Vec3::X;
        for at in lamps {
            move_by(&mut scene.instances[at].to_world, path, seconds);
        }
        for light in &mut scene.lights {
            move_by(&mut light.to_world, path, seconds);
        }
    }
    if wanted.has(Moving::Occluder) {
        let at = occluder(&scene)?;
        let path = slide.length(whole, Some(diagonal(&scene, at))) * Vec3::X;
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
                let made = only(&file, wanted, Slide::Rung(1.0)).unwrap();
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
        let made = only(&scene("penumbra.pbrt"), Moving::Occluder, Slide::Rung(2.0)).unwrap();
        let slid: Vec<_> = made.instances.iter().filter(|i| i.to_world.moves()).collect();
        assert_eq!(slid.len(), 1);
        let path = slid[0].to_world.at(2.0).translation - slid[0].to_world.at(0.0).translation;
        assert!((Vec3::from(path) - 0.5 * 2.0_f32.sqrt() * Vec3::X).length() < 1e-5, "{path}");
    }

    #[test]
    fn what_is_not_there_cannot_move() {
        let empty = Scene::new("empty");
        assert!(only(&empty, Moving::Light, Slide::Rung(1.0)).unwrap_err().is_usage());
        assert!(only(&empty, Moving::Occluder, Slide::Rung(1.0)).unwrap_err().is_usage());
    }

    #[test]
    fn a_share_is_of_the_scenes_diagonal_a_frame_and_the_first_frame_is_the_files() {
        let file = scene("penumbra.pbrt");
        let [low, high] = bounds(&file);
        let diagonal = (high - low).length();
        for (moving, thing) in
            [(Moving::Camera, None), (Moving::Light, Some(true)), (Moving::Occluder, Some(false))]
        {
            let motion = SceneMotion::new(moving, Some(0.01)).unwrap();
            let made = motion.apply(&file, 30, |_| panic!("the file stands still")).unwrap();
            let at = |frame: f32| -> Vec3 {
                let to_world = match thing {
                    None => &made.camera.to_world,
                    Some(light) => {
                        let of = |i: &&Instance| i.to_world.moves() && emits(&made, i) == light;
                        &made.instances.iter().find(of).unwrap().to_world
                    }
                };
                to_world.at(frame / 30.0).translation.into()
            };
            for frame in [1.0, 7.0] {
                let gone = (at(frame) - at(0.0)).length() / (frame * 0.01 * diagonal);
                assert!((gone - 1.0).abs() < 1e-3, "{moving:?} in frame {frame}: {gone}");
            }
        }
    }

    #[test]
    fn shares_have_a_range_and_no_use_where_the_motion_is_the_files() {
        for share in [0.0, -0.1, 0.11, f32::NAN, f32::INFINITY] {
            let error = SceneMotion::new(Moving::Light, Some(share)).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains("(0, 0.1]"), "{error}");
        }
        let file = scene("moving.pbrt");
        let mut notes = 0;
        let motion = SceneMotion::new(Moving::Light, Some(0.1)).unwrap();
        let made = motion.apply(&file, 30, |_| notes += 1).unwrap();
        assert_eq!((moving(&made), notes), ([false, true, false], 1));
        // Without a share there is nothing to say.
        let motion = SceneMotion::new(Moving::Camera, None).unwrap();
        let made = motion.apply(&file, 30, |_| panic!("nothing was given in vain")).unwrap();
        assert_eq!(moving(&made), [true, false, false]);
    }
}
