//! A host's own scene in the frame loop: geometry made in code, a lamp that the host moves from
//! frame to frame.
//!
//! ```sh
//! cargo run --release --example host_scene
//! ```

use std::sync::Arc;

use afterimage::Result;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{Camera, Color, Geometry, Material, Mesh, Object, Scene, Shape, Transform};
use afterimage::techniques;
use glam::{Affine3A, Quat, Vec3};

/// A square of half width `half` around the origin; its normal is +y.
fn square(half: f32) -> Geometry {
    let corner = |x: f32, z: f32| half * Vec3::new(x, 0.0, z);
    let positions =
        vec![corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    Geometry::Mesh(Arc::new(Mesh {
        positions,
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }))
}

fn scene() -> Scene {
    let mut scene = Scene::new("host");
    let grey =
        scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.6)) });
    let floor = scene
        .add_object(Object { name: "floor".into(), shapes: vec![Shape::new(square(3.0), grey)] });
    let lamp = scene.add_object(Object {
        name: "lamp".into(),
        shapes: vec![Shape::new(square(0.4), grey).emitting(Vec3::splat(8.0))],
    });
    // Keys name things over frames: the lamp stays the lamp wherever it is.
    scene.add_instance(floor, Transform::IDENTITY, 1);
    scene.add_instance(lamp, lamp_at(0.0), 2);
    let tilt = Quat::from_rotation_x(0.5);
    let to_world = Affine3A::from_rotation_translation(tilt, Vec3::new(0.0, 2.5, -4.0));
    scene.camera = Camera { to_world: Transform::Fixed(to_world), fov: 0.8 };
    scene
}

/// Two units above the floor, looking down, on a circle.
fn lamp_at(angle: f32) -> Transform {
    let place = Vec3::new(angle.cos(), 2.0, angle.sin());
    Transform::Fixed(Affine3A::from_rotation_translation(
        Quat::from_rotation_x(std::f32::consts::PI),
        place,
    ))
}

fn main() -> Result<()> {
    let mut scene = scene();
    let stage = Stage::moving(scene.clone())?;
    let shot =
        Shot { size: [160, 90], depth: 3, filter: Filter::Point, run: 1, effort: 4.0, fps: 30 };
    let mut frames = FrameLoop::new(Arc::from(techniques::parse("nee")?), &stage, shot)?;
    print!("{}", frames.plan());
    for step in 0..8_u8 {
        scene.instances[1].to_world = lamp_at(f32::from(step) * 0.3);
        let frame = frames.render_scene(scene.clone())?;
        println!(
            "frame {}: mean luminance {:.4}, {:.1} ms, {} shadow rays",
            frame.index,
            frame.picture().mean_luminance(),
            frame.milliseconds(),
            frame.counters.shadow_rays
        );
    }
    Ok(())
}
