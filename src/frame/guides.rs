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
                let hit = world.camera_hit(&Ray {
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
