//! From a scene's materials and textures to lobes at a point.

use glam::{Vec2, Vec3};

use super::bsdf::{Bsdf, MetallicRoughness};
use crate::scene::{Color, ConductorColor, Material, MaterialId, Roughness, Scalar, Scene};

/// The lobes of a material at texture coordinates.
///
/// Textures are cut to what a material allows: albedos to [0, 1] (and their sum to 1), roughness to
/// at least 0, mixing weights to [0, 1].
///
/// # Panics
/// If `id` is not one of `scene`'s, which a valid scene never contains.
#[inline]
#[must_use]
pub fn evaluate_material(scene: &Scene, id: MaterialId, uv: Vec2) -> Bsdf {
    match &scene.materials[id.index()] {
        Material::Diffuse { reflectance } => Bsdf::diffuse(albedo(scene, *reflectance, uv)),
        Material::Mix { first, second, amount } => {
            let (first, second) =
                (&scene.materials[first.index()], &scene.materials[second.index()]);
            let (first, second) = (unmixed(scene, first, uv), unmixed(scene, second, uv));
            let mixed = Bsdf::mix(&first, &second, scene.scalar(*amount, uv));
            // Validation refuses a mix of mixes.
            debug_assert!(mixed.is_some());
            mixed.unwrap_or_else(|| Bsdf::diffuse(Vec3::ZERO))
        }
        material => unmixed(scene, material, uv),
    }
}

fn unmixed(scene: &Scene, material: &Material, uv: Vec2) -> Bsdf {
    match *material {
        Material::Diffuse { reflectance } => Bsdf::diffuse(albedo(scene, reflectance, uv)),
        Material::DiffuseTransmission { reflectance, transmittance } => {
            let reflectance = albedo(scene, reflectance, uv);
            let transmittance = albedo(scene, transmittance, uv).min(Vec3::ONE - reflectance);
            Bsdf::diffuse_transmission(reflectance, transmittance)
        }
        Material::Conductor { color, roughness } => {
            let alpha = alpha(scene, roughness, uv);
            match color {
                ConductorColor::Complex { eta, k } => {
                    let (eta, k) = (scene.color(eta, uv), scene.color(k, uv));
                    Bsdf::conductor(eta.max(Vec3::ZERO), k.max(Vec3::ZERO), alpha)
                }
                ConductorColor::Reflectance(color) => Bsdf::metal(albedo(scene, color, uv), alpha),
            }
        }
        Material::Dielectric { eta, roughness } => {
            Bsdf::dielectric(eta, alpha(scene, roughness, uv))
        }
        Material::ThinDielectric { eta } => Bsdf::thin_dielectric(eta),
        Material::CoatedDiffuse { reflectance, eta, roughness } => {
            Bsdf::coated_diffuse(albedo(scene, reflectance, uv), eta, alpha(scene, roughness, uv))
        }
        Material::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            ior,
            specular,
            specular_color,
            transmission,
            double_sided,
        } => Bsdf::metallic_roughness(&MetallicRoughness {
            base_color: albedo(scene, base_color, uv),
            metallic: share(scene, metallic, uv),
            roughness: share(scene, roughness, uv),
            ior,
            specular: share(scene, specular, uv),
            specular_color: scene.color(specular_color, uv).max(Vec3::ZERO),
            transmission: share(scene, transmission, uv),
            double_sided,
        }),
        // Validation refuses a mix of mixes.
        Material::Mix { .. } => Bsdf::diffuse(Vec3::ZERO),
    }
}

#[inline]
fn albedo(scene: &Scene, color: Color, uv: Vec2) -> Vec3 {
    scene.color(color, uv).clamp(Vec3::ZERO, Vec3::ONE)
}

/// A number in [0, 1].
#[inline]
fn share(scene: &Scene, scalar: Scalar, uv: Vec2) -> f32 {
    scene.scalar(scalar, uv).clamp(0.0, 1.0)
}

/// α along both tangents.
#[inline]
fn alpha(scene: &Scene, roughness: Roughness, uv: Vec2) -> Vec2 {
    let raw = Vec2::new(scene.scalar(roughness.u, uv), scene.scalar(roughness.v, uv));
    let raw = raw.max(Vec2::ZERO);
    if roughness.remap { raw.map(f32::sqrt) } else { raw }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Roughness along u is along the lobe's first tangent, along v along the second, and `remap`
    /// takes the root of both.
    #[test]
    fn roughness_belongs_to_its_tangent() {
        let (eta, k) = (Vec3::splat(0.2), Vec3::splat(3.0));
        for (remap, alpha) in [(false, Vec2::new(0.09, 0.49)), (true, Vec2::new(0.3, 0.7))] {
            let mut scene = Scene::new("brushed");
            let [u, v] = [0.09, 0.49].map(Scalar::Constant);
            let material = scene.add_material(Material::Conductor {
                color: ConductorColor::Complex { eta: Color::Constant(eta), k: Color::Constant(k) },
                roughness: Roughness { u, v, remap },
            });
            let found = evaluate_material(&scene, material, Vec2::ZERO);
            let expected = Bsdf::conductor(eta, k, alpha);
            let turned = Bsdf::conductor(eta, k, Vec2::new(alpha.y, alpha.x));
            let wo = Vec3::new(0.3, 0.1, 0.9).normalize();
            let wi = Vec3::new(0.2, -0.3, 0.8).normalize();
            let values = [found, expected, turned].map(|bsdf| bsdf.evaluate(wo, wi).value);
            assert!((values[0] - values[1]).length() < 1e-6 * values[1].length(), "{values:?}");
            assert!((values[2] - values[1]).length() > 0.1 * values[1].length(), "{values:?}");
        }
    }
}
