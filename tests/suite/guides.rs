//! The layers beside the picture, by value: distance, normal, albedo and motion of a wall whose
//! every point is known in closed form.

use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::scene::{Color, Material, Scene, Shape, Transform};
use afterimage::techniques::parse;
use glam::{Affine3A, Quat, Vec2, Vec3};

use crate::support::{polygon, shot};

const SIZE: [u32; 2] = [24, 16];
const FOV: f32 = 0.8;
/// Of the wall z = `DISTANCE`, seen from the origin along +z.
const DISTANCE: f32 = 5.0;

/// Pixels a unit of the plane z = 1: the field of view is that of the shorter side.
fn pixels_per_unit() -> f32 {
    0.5 * SIZE[1] as f32 / (0.5 * FOV).tan()
}

fn wall() -> Scene {
    let mut scene = Scene::new("wall");
    let reflectance = Color::Constant(Vec3::new(0.2, 0.5, 0.8));
    let paint = scene.add_material(Material::Diffuse { reflectance });
    let c = |x: f32, y: f32| Vec3::new(x, y, DISTANCE);
    let corners = [c(-9.0, -9.0), c(-9.0, 9.0), c(9.0, 9.0), c(9.0, -9.0)];
    scene.add_shape(Shape::new(polygon(&corners), paint));
    scene.camera.fov = FOV;
    scene
}

/// Column and row of a pixel's centre, from the picture's middle.
fn centre(pixel: usize) -> Vec2 {
    let [width, height] = SIZE;
    let at = Vec2::new((pixel as u32 % width) as f32, (pixel as u32 / width) as f32) + 0.5;
    at - 0.5 * Vec2::new(width as f32, height as f32)
}

/// The layers of the second frame, where the scene moves from one to the other in between.
fn guides(first: &Scene, second: &Scene) -> afterimage::frame::Guides {
    let stage = Stage::moving(first.clone()).unwrap();
    let technique = Arc::from(parse("nee").unwrap());
    let mut frames = FrameLoop::new(technique, &stage, shot(SIZE, 2, 1)).unwrap();
    frames.render_scene(first.clone()).unwrap();
    frames.render_scene(second.clone()).unwrap().guides()
}

#[test]
fn distance_normal_and_albedo_are_those_of_the_wall() {
    let scene = wall();
    let found = guides(&scene, &scene);
    for pixel in 0..(SIZE[0] * SIZE[1]) as usize {
        let at = centre(pixel) / pixels_per_unit();
        let distance = DISTANCE * (1.0 + at.length_squared()).sqrt();
        assert!((found.depth[pixel] / distance - 1.0).abs() < 1e-5, "pixel {pixel}");
        assert!((found.normal[pixel].z.abs() - 1.0).abs() < 1e-6, "pixel {pixel}");
        assert!((found.albedo[pixel] - Vec3::new(0.2, 0.5, 0.8)).length() < 1e-6);
        assert!(found.motion[pixel].length() < 1e-5, "nothing moves");
    }
}

/// A wall that slides by (a, b) moves every pixel by the same, and motion points back to where it
/// was.
#[test]
fn motion_is_where_the_point_was_minus_where_it_is() {
    let still = wall();
    let mut slid = still.clone();
    let by = Vec3::new(0.3, -0.2, 0.0);
    slid.instances[0].to_world = Transform::Fixed(Affine3A::from_translation(by));
    let found = guides(&still, &slid);
    // +x of the scene is to one side of the picture; which one a still camera says below.
    let scale = pixels_per_unit() / DISTANCE;
    let expected = to_picture(-Vec2::new(by.x, by.y) * scale);
    for (pixel, motion) in found.motion.iter().enumerate() {
        assert!((*motion - expected).length() < 1e-3, "pixel {pixel}: {motion}, not {expected}");
    }
}

/// A camera that turns about +y by φ: the direction (x, y, 1) of now was that turned by φ before.
#[test]
fn motion_of_a_turning_camera_is_the_turn() {
    let still = wall();
    let mut turned = still.clone();
    let turn = Quat::from_rotation_y(0.05);
    turned.camera.to_world = Transform::Fixed(Affine3A::from_quat(turn));
    let found = guides(&still, &turned);
    for (pixel, motion) in found.motion.iter().enumerate() {
        let here = centre(pixel);
        let plane = to_scene(here) / pixels_per_unit();
        // The direction now, in the scene, which the earlier camera saw as its own.
        let there = turn * Vec3::new(plane.x, plane.y, 1.0);
        let before = to_picture(Vec2::new(there.x, there.y) / there.z * pixels_per_unit());
        let expected = before - here;
        assert!((*motion - expected).length() < 2e-3, "pixel {pixel}: {motion}, not {expected}");
        assert!(motion.length() > 0.5, "the control: half a pixel would be seen");
    }
}

/// Offsets in the scene's x and y as columns and rows: rows run downwards.
fn to_picture(offset: Vec2) -> Vec2 {
    Vec2::new(offset.x, -offset.y)
}

fn to_scene(offset: Vec2) -> Vec2 {
    Vec2::new(offset.x, -offset.y)
}
