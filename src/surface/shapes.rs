//! Every placed shape by its running number: over instances in order, then over the shapes of the
//! instance's object.

use crate::accel::{Accel, Hit, HitFilter, Ray};
use crate::math::rng::pcg4d;
use crate::scene::{Material, MaterialId, Scalar, Scene};

/// What rendering needs of a placed shape besides its geometry.
#[derive(Clone, Copy, Debug)]
pub struct ShapeInfo {
    /// How it scatters.
    pub material: MaterialId,
    /// Coverage, where it is not 1.
    pub alpha: Option<Scalar>,
    /// Whether it emits.
    pub emits: bool,
    /// Whether its scattering depends on the direction of its texture's axes.
    pub anisotropic: bool,
    /// Whether camera rays pass its back.
    pub one_sided: bool,
}

/// The scene's shapes by running number.
#[must_use]
pub fn placed_shapes(scene: &Scene) -> Vec<ShapeInfo> {
    let objects = scene.instances.iter().map(|instance| &scene.objects[instance.object.index()]);
    objects
        .flat_map(|object| &object.shapes)
        .map(|shape| ShapeInfo {
            material: shape.material,
            alpha: shape.alpha.filter(|alpha| !matches!(alpha, Scalar::Constant(a) if *a >= 1.0)),
            emits: shape.emission.is_some(),
            anisotropic: anisotropic(scene, &scene.materials[shape.material.index()]),
            one_sided: scene.is_one_sided(shape.material),
        })
        .collect()
}

/// Whether a material's lobes have two different roughnesses.
fn anisotropic(scene: &Scene, material: &Material) -> bool {
    match material {
        Material::Conductor { roughness, .. }
        | Material::Dielectric { roughness, .. }
        | Material::CoatedDiffuse { roughness, .. } => match (roughness.u, roughness.v) {
            (Scalar::Constant(u), Scalar::Constant(v)) => u != v,
            (Scalar::Texture(u, from_u), Scalar::Texture(v, from_v)) => (u, from_u) != (v, from_v),
            _ => true,
        },
        Material::Mix { first, second, .. } => {
            // Parts of a mix are not mixes, as validation has checked.
            [first, second].iter().any(|part| anisotropic(scene, &scene.materials[part.index()]))
        }
        _ => false,
    }
}

/// Lets a ray pass where a shape's coverage says so.
///
/// A hit is kept with probability alpha. The coin is a hash of the ray and the hit's parameters, so
/// a ray that is traced again, or only asked for occlusion, decides the same.
#[derive(Clone, Copy, Debug)]
pub struct AlphaMask<'a> {
    /// Textures.
    pub scene: &'a Scene,
    /// Where hits are.
    pub accel: &'a Accel,
    /// By running number.
    pub shapes: &'a [ShapeInfo],
}

impl HitFilter for AlphaMask<'_> {
    #[inline]
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
        let point = self.accel.point(hit);
        let Some(alpha) = self.shapes[point.shape as usize].alpha else { return true };
        let alpha = self.scene.scalar(alpha, point.uv);
        if alpha >= 1.0 {
            return true;
        }
        if alpha <= 0.0 {
            return false;
        }
        let d = ray.direction.to_array().map(f32::to_bits);
        let [word, ..] = pcg4d([
            d[0] ^ ray.origin.x.to_bits(),
            d[1] ^ ray.origin.y.to_bits(),
            d[2],
            hit.t.to_bits() ^ hit.primitive,
        ]);
        crate::math::rng::unit_float(word) < alpha
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::scene::{Color, Geometry, Shape};
    use crate::world::World;

    /// A coverage of a quarter stops a quarter of the rays, not three of them.
    #[test]
    fn coverage_is_the_share_of_rays_that_meet() {
        for coverage in [0.25, 0.6] {
            let mut scene = Scene::new("mask");
            let reflectance = Color::Constant(Vec3::ZERO);
            let black = scene.add_material(Material::Diffuse { reflectance });
            let disk = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Z, radius: 2.0 };
            let mut shape = Shape::new(disk, black);
            shape.alpha = Some(Scalar::Constant(coverage));
            scene.add_shape(shape);
            let world = World::new(scene, &Default::default()).unwrap();
            let mut random = Stream::from_key(1);
            let n = 10_000;
            let met = (0..n).filter(|_| {
                let origin = Vec3::new(random.uniform(), random.uniform(), 1.0);
                let direction = -Vec3::Z + 0.1 * Vec3::new(random.uniform(), random.uniform(), 0.0);
                world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }).is_some()
            });
            // 5 standard errors.
            let share = met.count() as f32 / n as f32;
            assert!((share - coverage).abs() < 0.025, "{coverage}: {share}");
        }
    }

    /// A constant coverage of 1 is none, so that no hit asks for it.
    #[test]
    fn a_whole_surface_has_no_mask() {
        let mut scene = Scene::new("whole");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        for alpha in [None, Some(1.0), Some(0.5)] {
            let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 1.0 };
            let mut shape = Shape::new(ball, black);
            shape.alpha = alpha.map(Scalar::Constant);
            scene.add_shape(shape);
        }
        let masks: Vec<bool> = placed_shapes(&scene).iter().map(|s| s.alpha.is_some()).collect();
        assert_eq!(masks, [false, false, true]);
    }
}
