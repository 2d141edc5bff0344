//! Paths from the camera: the walk that every technique without reuse is made of, and that others
//! take their candidates from.
//!
//! | here | meaning |
//! |---|---|
//! | vertex 0 | the primary hit |
//! | segment | an edge of the path; the primary ray is the first, so direct light has two |
//! | `depth` | most segments a path may have |
//! | p̂ ℓ, `p_b` | density per unit solid angle of light sampling and of BSDF sampling, choices included |
//!
//! Numbers come from [`crate::math::rng::draw4`] with the path's seed by (vertex, block), so none
//! depends on an earlier branch.

mod walk;

use glam::Vec3;

pub use walk::{
    Ending, LightSample, Steps, Sum, Total, Vertex, Visitor, survival, walk, walk_from,
};

use crate::accel::{Hit, HitFilter, HitPoint, Ray};
use crate::counters::Counters;
use crate::light::NO_LIGHT;
use crate::math::luminance;
use crate::surface::SurfacePoint;
use crate::world::World;

/// Which lights a vertex samples; kernels are compiled for one.
pub mod sampled {
    /// None: BSDF sampling alone.
    pub const NONE: u8 = 0;
    /// One, by power.
    pub const ONE: u8 = 1;
    /// Each of them once.
    pub const ALL: u8 = 2;
}

/// When a path ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most segments a path may have.
    pub depth: u32,
    /// Scatterings before Russian roulette may end a path.
    pub roulette_after: u32,
}

/// Share of technique `a` by the power heuristic with exponent 2 (Veach 1997, eq. 9.13): a² / (a² +
/// b²), for a > 0 and b ≥ 0.
#[inline]
#[must_use]
pub fn power_heuristic(a: f32, b: f32) -> f32 {
    // By the ratio: squares of densities overflow.
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}

/// Emitted radiance at a hit towards where the ray came from.
#[inline]
#[must_use]
pub fn emitted(world: &World, point: &HitPoint, direction: Vec3) -> Vec3 {
    match world.lights.of_surface(point.shape, point.element) {
        NO_LIGHT => Vec3::ZERO,
        light => world.lights.emitted(
            &world.scene,
            light,
            point.uv,
            -direction.dot(point.geometric_normal),
        ),
    }
}

/// Light reflected or transmitted towards the camera at a primary hit: one unbiased estimate of all
/// paths with 2 to `limits.depth` segments.
///
/// `LIGHTS` (of [`sampled`]) are sampled at every vertex with a non-delta lobe, combined with BSDF
/// sampling by the power heuristic. The primary ray's direction is of unit length.
#[inline]
#[must_use]
pub fn scattered_radiance<const LIGHTS: u8, F: HitFilter>(
    world: &World,
    filter: &F,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    counters: &mut Counters,
) -> Vec3 {
    let mut sum = Sum::default();
    let steps = Steps::<LIGHTS, F> { world, filter };
    walk::<LIGHTS, true, F>(&steps, seed, primary, limits, &mut sum, counters);
    sum.0
}

/// As [`scattered_radiance`] with light sampling, without the light that comes straight to the
/// primary hit and leaves it by a lobe that is not a delta: what remains for the path tracer where
/// another technique estimates that part.
#[inline]
#[must_use]
pub fn indirect_radiance<F: HitFilter>(
    world: &World,
    filter: &F,
    seed: u64,
    primary: (Vec3, &Hit),
    limits: Limits,
    counters: &mut Counters,
) -> Vec3 {
    let mut sum = Sum::default();
    let steps = Steps::<{ sampled::ONE }, F> { world, filter };
    walk::<{ sampled::ONE }, false, F>(&steps, seed, primary, limits, &mut sum, counters);
    sum.0
}

/// The ray that asks whether a light point is seen from a surface; it ends before the light's own
/// surface.
#[inline]
#[must_use]
pub fn shadow_ray(surface: &SurfacePoint, direction: Vec3, end: Option<Vec3>) -> Ray {
    let origin = surface.origin(direction);
    match end {
        Some(end) => Ray { origin, direction: end - origin, t_max: 1.0 },
        None => Ray { origin, direction, t_max: f32::INFINITY },
    }
}

/// `radiance`, or black and counted where it is not finite.
#[inline]
#[must_use]
pub fn finite_or_counted(radiance: Vec3, counters: &mut Counters) -> Vec3 {
    debug_assert!(radiance.is_finite(), "an estimate is {radiance}");
    if luminance(radiance).is_finite() && radiance.is_finite() {
        radiance
    } else {
        counters.non_finite += 1;
        Vec3::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::AcceptAll;
    use crate::scene::{Color, Geometry, Material, Scene, Shape};

    /// What stands in front of a lamp hides it, however near to it; what stands behind does not.
    #[test]
    fn shadow_rays_reach_as_far_as_the_lamp() {
        for (height, hidden) in [(0.9995, true), (1.0005, false)] {
            let mut scene = Scene::new("shadow");
            let reflectance = Color::Constant(Vec3::ONE);
            let white = scene.add_material(Material::Diffuse { reflectance });
            for y in [0.0, height] {
                let center = Vec3::Y * y;
                let disk = Geometry::Disk { center, normal: Vec3::Y, radius: 1.0 };
                scene.add_shape(Shape::new(disk, white));
            }
            let world = World::new(scene, &Default::default()).unwrap();
            let down = Ray { origin: 0.5 * Vec3::Y, direction: -Vec3::Y, t_max: f32::INFINITY };
            let floor = world.surface(&world.closest_hit(&down).unwrap());
            let ray = shadow_ray(&floor, Vec3::Y, Some(Vec3::Y));
            assert_eq!(world.accel.occluded(&ray, &AcceptAll), hidden, "{height}");
        }
    }
}
