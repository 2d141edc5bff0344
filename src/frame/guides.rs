//! What a denoiser or a reader wants to know of a pixel besides its light.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::accel::Ray;
use crate::world::Motion;
use crate::world::World;

/// Layers through pixel centres, row by row.
#[derive(Clone, Debug)]
pub struct Guides {
    /// Width and height.
    pub size: [u32; 2],
    /// Reflectance in [0, 1]; 0 where nothing is hit.
    pub albedo: Vec<Vec3>,
    /// Unit shading normal, in world space; 0 where nothing is hit.
    pub normal: Vec<Vec3>,
    /// Distance from the camera; +∞ where nothing is hit.
    pub depth: Vec<f32>,
    /// Where the surface point was in the previous frame, minus where it is now, in pixels; 0
    /// without a previous frame, for the sky, and where the point was behind the camera.
    pub motion: Vec<Vec2>,
}

impl Guides {
    /// Traces one ray a pixel.
    #[must_use]
    pub fn new(world: &World, previous: Option<&World>, size: [u32; 2]) -> Self {
        let rays = world.scene.camera.rays(size);
        let motion = previous.map(|previous| (previous, Motion::new(previous, world, size)));
        let pixels: Vec<(Vec3, Vec3, f32, Vec2)> = (0..size[0] * size[1])
            .into_par_iter()
            .map(|pixel| {
                let at = Vec2::new((pixel % size[0]) as f32 + 0.5, (pixel / size[0]) as f32 + 0.5);
                let ray = rays.ray(at);
                let hit = world.closest_hit(&Ray {
                    origin: ray.origin,
                    direction: ray.direction,
                    t_max: f32::INFINITY,
                });
                let Some(hit) = hit else {
                    return (Vec3::ZERO, Vec3::ZERO, f32::INFINITY, Vec2::ZERO);
                };
                let surface = world.surface(&hit);
                let moved = motion.as_ref().and_then(|(previous, motion)| {
                    motion.projection.project(motion.position(previous, world, &hit)?)
                });
                let moved = moved.map_or(Vec2::ZERO, |then| then - at);
                (surface.bsdf.albedo(), surface.frame.normal, hit.t, moved)
            })
            .collect();
        Self {
            size,
            albedo: pixels.iter().map(|p| p.0).collect(),
            normal: pixels.iter().map(|p| p.1).collect(),
            depth: pixels.iter().map(|p| p.2).collect(),
            motion: pixels.iter().map(|p| p.3).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::frame::{FrameLoop, Stage};
    use crate::plan::{Filter, Shot};
    use crate::scene::{Curve, Interpolation, Track, Transform, generate};

    /// A camera that slides: depth is that of the frame shown, and a pixel's centre plus its motion
    /// is where its surface was seen in the frame before.
    #[test]
    fn guides_show_the_frame_and_motion_leads_to_the_frame_before() {
        let mut scene = generate("many-lights:3").unwrap();
        let slide = Curve {
            keys: vec![(0.0, Vec3::ZERO), (1.0, Vec3::new(9.0, 0.0, -3.0))],
            interpolation: Interpolation::Linear,
        };
        let (rotation, scale) = (Curve::constant(glam::Quat::IDENTITY), Curve::constant(Vec3::ONE));
        let track = Track::Trs { translation: slide, rotation, scale };
        let start = Track::Fixed(scene.camera.to_world.fixed());
        scene.camera.to_world = Transform::Chain(vec![track, start]);
        scene.time = [0.0, 1.0];
        let size = [24, 15];
        let shot = Shot { size, depth: 1, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
        let stage = Stage::new(scene).unwrap();
        let nee = Arc::from(crate::techniques::parse("nee").unwrap());
        let mut frames = FrameLoop::new(nee, &stage, shot).unwrap();
        for index in 0..3 {
            let guides = frames.render().unwrap().guides();
            let time = |index: i32| stage.scene().at(index as f32 / 30.0).camera;
            let (now, before) = (time(index), time(index - 1));
            let mut seen = 0;
            for pixel in (0..guides.depth.len()).filter(|&pixel| guides.depth[pixel].is_finite()) {
                let at = Vec2::new((pixel % 24) as f32 + 0.5, (pixel / 24) as f32 + 0.5);
                let ray = now.rays(size).ray(at);
                let place = ray.origin + guides.depth[pixel] * ray.direction;
                let ray =
                    Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
                let hit = frames.world().closest_hit(&ray).unwrap();
                assert!((hit.t / guides.depth[pixel] - 1.0).abs() < 1e-5, "{index}, {pixel}");
                let wanted = match before.project(place, size) {
                    Some(there) if index > 0 => there - at,
                    _ => Vec2::ZERO,
                };
                let found = guides.motion[pixel];
                assert!((found - wanted).length() < 1e-3, "{index}, {at}: {found}, not {wanted}");
                seen += 1;
            }
            assert!(seen > 100, "{seen}");
        }
    }
}
