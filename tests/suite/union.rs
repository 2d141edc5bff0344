//! Direct light and paths in one reservoir: where one of both is all there is, the technique is the
//! one that has it alone.

use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::picture::Picture;
use afterimage::plan::Shot;
use afterimage::scene::{LightKind, Scene, Shape};
use afterimage::techniques::parse;
use glam::{Affine3A, Vec3};

use crate::support::{bits, diffuse, light, look_at, metal, polygon, shot};

/// A glossy floor, a diffuse wall, two lamps, a point light and a blocker.
pub(crate) fn scene() -> Scene {
    let mut scene = Scene::new("direct");
    let (white, glossy) = (diffuse(&mut scene, 0.7), metal(&mut scene, 0.3));
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let mut quad = |corners: [Vec3; 4], material| {
        scene.add_shape(Shape::new(polygon(&corners), material));
    };
    let floor = [c(-2.0, 0.0, -2.0), c(-2.0, 0.0, 2.0), c(2.0, 0.0, 2.0), c(2.0, 0.0, -2.0)];
    quad(floor, glossy);
    quad([c(-2.0, 0.0, 2.0), c(-2.0, 2.0, 2.0), c(2.0, 2.0, 2.0), c(2.0, 0.0, 2.0)], white);
    quad([c(-0.2, 0.5, 0.0), c(-0.2, 1.0, 0.0), c(0.3, 1.0, 0.2), c(0.3, 0.5, 0.2)], white);
    let lamp = [c(-0.4, 1.8, -0.4), c(0.4, 1.8, -0.4), c(0.4, 1.8, 0.4), c(-0.4, 1.8, 0.4)];
    scene.add_shape(Shape::new(polygon(&lamp), white).emitting(Vec3::new(3.0, 2.0, 1.0)));
    let point = Affine3A::from_translation(Vec3::new(-1.0, 1.0, -0.5));
    light(&mut scene, LightKind::Point { intensity: Vec3::new(0.1, 0.3, 0.5) }, point);
    scene.camera = look_at(c(0.0, 1.2, -3.0), c(0.0, 0.7, 0.0), 0.8);
    scene
}

/// Four frames of a scene whose camera and lamp move, or do not.
pub(crate) fn frames(spec: &str, shot: Shot, moving: bool) -> Vec<Picture> {
    let scene = scene();
    let make = if moving { Stage::moving } else { Stage::new };
    let stage = make(scene.clone()).unwrap();
    let mut frames = FrameLoop::new(Arc::from(parse(spec).unwrap()), &stage, shot).unwrap();
    (0..4_u8)
        .map(|frame| {
            if !moving {
                return frames.render().unwrap().picture();
            }
            let mut now = scene.clone();
            let step = 0.05 * f32::from(frame);
            now.camera = look_at(Vec3::new(step, 1.2, -3.0), Vec3::new(step, 0.7, 0.0), 0.8);
            let lamp = Affine3A::from_translation(Vec3::new(-step, 0.0, step));
            now.instances[3].to_world = afterimage::scene::Transform::Fixed(lamp);
            frames.render_scene(now).unwrap().picture()
        })
        .collect()
}

/// At a depth of 2, where no lobe is a delta, there is direct light alone, and the technique is
/// `restir-di` with visibility in its targets, to the bit: still and moving, whatever the weights.
/// With another number of candidates it is not.
#[test]
fn depth_two_is_restir_di() {
    for moving in [false, true] {
        for (mature, keys) in
            [(8, ""), (0, ",neighbours=3,taps=random"), (1, ",temporal-mis=pairwise,mis=balance")]
        {
            for shot in [shot([25, 16], 2, 1), shot([16, 16], 2, 2)] {
                let [di, pt, other] = [
                    format!("restir-di:candidates=6,mature={mature}{keys}"),
                    format!("restir-pt:candidates=6,mature={mature},shade=selected{keys}"),
                    format!("restir-pt:candidates=7,mature={mature},shade=selected{keys}"),
                ]
                .map(|spec| frames(&spec, shot, moving));
                for (frame, (di, pt)) in di.iter().zip(&pt).enumerate() {
                    assert!(di.mean_luminance() > 0.0);
                    let differ = bits(di).iter().zip(bits(pt)).filter(|(a, b)| **a != *b).count();
                    assert_eq!(differ, 0, "pixels of frame {frame}, moving {moving}, `{keys}`");
                }
                assert_ne!(bits(&di[3]), bits(&other[3]));
            }
        }
    }
}
