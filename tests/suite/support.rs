//! What the tests share: scenes built in code, and estimates with their standard errors.

use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{
    Camera, Color, Geometry, Material, MaterialId, Mesh, Scene, Shape, Transform,
};
use afterimage::stats::{MeanTest, Moments, t_test};
use afterimage::techniques::parse;
use glam::{Affine3A, Vec3};

/// A shot of `size` pixels with the point filter.
pub(crate) fn shot(size: [u32; 2], depth: u32, effort: u32) -> Shot {
    Shot { size, depth, filter: Filter::Point, run: 1, effort, fps: 30 }
}

/// A Lambert material.
pub(crate) fn diffuse(scene: &mut Scene, albedo: f32) -> MaterialId {
    scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(albedo)) })
}

/// A mesh of one planar polygon, as a fan; its normal points to where its corners run counter-clockwise.
pub(crate) fn polygon(corners: &[Vec3]) -> Geometry {
    let triangles = (2..corners.len() as u32).map(|i| [0, i - 1, i]).collect();
    Geometry::Mesh(Arc::new(Mesh { positions: corners.to_vec(), triangles, ..Mesh::default() }))
}

/// A camera at `from` that looks at `to`.
pub(crate) fn look_at(from: Vec3, to: Vec3, fov: f32) -> Camera {
    let forward = (to - from).normalize();
    let up = if forward.y.abs() > 0.99 { Vec3::Z } else { Vec3::Y };
    let right = up.cross(forward).normalize();
    let to_world =
        Affine3A::from_cols(right.into(), forward.cross(right).into(), forward.into(), from.into());
    Camera { to_world: Transform::Fixed(to_world), fov }
}

/// A sphere around the origin, seen from inside.
pub(crate) fn sphere(radius: f32, material: MaterialId) -> Shape {
    Shape {
        reverse_orientation: true,
        ..Shape::new(Geometry::Sphere { center: Vec3::ZERO, radius }, material)
    }
}

/// The mean over the picture of each frame's red channel, one number a frame: independent samples of techniques without history.
pub(crate) fn frame_means(stage: &Stage, spec: &str, shot: Shot, frames: u32) -> Moments {
    let mut moments = Moments::default();
    let mut frame_loop = FrameLoop::new(Arc::from(parse(spec).unwrap()), stage, shot).unwrap();
    for _ in 0..frames {
        let frame = frame_loop.render().unwrap();
        assert_eq!(frame.counters.non_finite, 0, "{spec} gave values that are not finite");
        let picture = frame.picture();
        moments.push(
            picture.pixels.iter().map(|p| f64::from(p.x)).sum::<f64>()
                / picture.pixels.len() as f64,
        );
    }
    moments
}

/// The test of [`frame_means`] against a known value.
pub(crate) fn against(stage: &Stage, spec: &str, shot: Shot, frames: u32, truth: f64) -> MeanTest {
    t_test(&frame_means(stage, spec, shot, frames), truth)
}
