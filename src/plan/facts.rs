//! What a scene needs: the facts that allow a plan to leave something out.

use crate::light::LightCounts;
use crate::math::luminance;
use crate::scene::{Color, LightKind, Material, MaterialId, Scalar, Scene};
use crate::surface::material::evaluate_material;

/// What a scene contains, as far as it decides what can be left out.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFacts {
    /// Lights by kind; black ones apart.
    pub lights: LightCounts,
    /// Whether all emission is grey: a scalar visibility then loses no colour.
    pub grey_lights: bool,
    /// Whether any surface's emission is textured.
    pub textured_emission: bool,
    /// Whether some material has a perfectly specular lobe.
    pub delta_lobes: bool,
    /// Whether some material is glossy: neither diffuse nor perfectly specular.
    pub glossy_lobes: bool,
    /// Whether some material transmits.
    pub transmission: bool,
    /// Whether coverage lets rays through somewhere.
    pub alpha: bool,
    /// Whether the camera moves.
    pub moving_camera: bool,
    /// Whether a light without a surface, or an emitting instance, moves.
    pub moving_lights: bool,
    /// Whether an instance moves.
    pub moving_geometry: bool,
    /// Number of triangles, spheres and disks as placed.
    pub primitives: u64,
    /// Path segments that the file asks for.
    pub depth: u32,
    /// Diagonal of the bounds of all shapes in the first frame, in scene units; 0 of facts that no
    /// [`Stage`](crate::frame::Stage) made.
    pub diagonal: f32,
}

impl SceneFacts {
    /// Reads the facts off a scene, which may move, and its light table's counts.
    #[must_use]
    pub fn new(scene: &Scene, lights: LightCounts) -> Self {
        let mut facts = Self {
            lights,
            grey_lights: true,
            textured_emission: false,
            delta_lobes: false,
            glossy_lobes: false,
            transmission: false,
            alpha: false,
            moving_camera: scene.camera.to_world.moves(),
            moving_lights: scene.lights.iter().any(|light| light.to_world.moves()),
            moving_geometry: false,
            primitives: 0,
            depth: scene.depth,
            diagonal: 0.0,
        };
        let grey =
            |rgb: glam::Vec3| (rgb - luminance(rgb)).abs().max_element() <= 1e-6 * luminance(rgb);
        for instance in &scene.instances {
            let moves = instance.to_world.moves();
            facts.moving_geometry |= moves;
            for shape in &scene.objects[instance.object.index()].shapes {
                facts.primitives += match &shape.geometry {
                    crate::scene::Geometry::Mesh(mesh) => mesh.triangles.len() as u64,
                    _ => 1,
                };
                facts.alpha |= shape
                    .alpha
                    .is_some_and(|alpha| !matches!(alpha, Scalar::Constant(a) if a >= 1.0));
                facts.add_material(scene, shape.material);
                if let Some(emission) = shape.emission {
                    facts.moving_lights |= moves;
                    match emission.radiance {
                        Color::Constant(rgb) => facts.grey_lights &= grey(rgb),
                        Color::Texture(_) => {
                            facts.textured_emission = true;
                            facts.grey_lights = false;
                        }
                    }
                }
            }
        }
        for light in &scene.lights {
            facts.grey_lights &= match light.kind {
                LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => {
                    grey(intensity)
                }
                LightKind::Distant { irradiance } => grey(irradiance),
                LightKind::Environment { radiance, image } => image.is_none() && grey(radiance),
            };
        }
        facts
    }

    fn add_material(&mut self, scene: &Scene, id: MaterialId) {
        let textured = |scalar: &Scalar| !matches!(scalar, Scalar::Constant(_));
        let (rough, varies) = match &scene.materials[id.index()] {
            Material::Mix { first, second, .. } => {
                // Parts of a mix are not mixes, as validation has checked.
                self.add_material(scene, *first);
                return self.add_material(scene, *second);
            }
            Material::Diffuse { .. } => (false, false),
            Material::DiffuseTransmission { .. } => {
                self.transmission = true;
                (false, false)
            }
            Material::Conductor { roughness, .. } | Material::CoatedDiffuse { roughness, .. } => {
                (true, textured(&roughness.u) || textured(&roughness.v))
            }
            Material::Dielectric { roughness, .. } => {
                self.transmission = true;
                (true, textured(&roughness.u) || textured(&roughness.v))
            }
            Material::ThinDielectric { .. } => {
                self.transmission = true;
                (false, false)
            }
            Material::MetallicRoughness { roughness, transmission, .. } => {
                self.transmission |= !matches!(transmission, Scalar::Constant(0.0));
                self.glossy_lobes = true;
                (true, textured(roughness))
            }
        };
        // What is smooth enough for a delta is the lobes' own business; only roughness decides it,
        // so any texture coordinates do.
        let bsdf = evaluate_material(scene, id, glam::Vec2::splat(0.5));
        self.delta_lobes |= varies || (0..bsdf.lobe_count()).any(|lobe| bsdf.is_delta(lobe));
        self.glossy_lobes |= rough && (varies || !bsdf.is_delta(0));
    }

    /// What another scene has that a plan made for this one may have left out; `None` if nothing.
    #[must_use]
    pub fn lacks(&self, other: &Self) -> Option<&'static str> {
        let (here, there) = (&self.lights, &other.lights);
        let surfaces = |counts: &LightCounts| counts.triangles + counts.quadrics;
        [
            (surfaces(here) == 0 && surfaces(there) > 0, "an emitting surface"),
            (here.delta == 0 && there.delta > 0, "a point, spot or distant light"),
            (here.environments == 0 && there.environments > 0, "an environment"),
            (!self.delta_lobes && other.delta_lobes, "a perfectly specular surface"),
            (!self.alpha && other.alpha, "a surface with coverage"),
        ]
        .into_iter()
        .find_map(|(lacks, what)| lacks.then_some(what))
    }

    /// Number of lights that can be drawn.
    #[must_use]
    pub fn light_count(&self) -> u32 {
        let LightCounts { triangles, quadrics, delta, environments, black: _ } = self.lights;
        triangles + quadrics + delta + environments
    }

    /// Whether any two frames can differ.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.moving_camera || self.moving_lights || self.moving_geometry
    }

    /// Names and values, for people.
    #[must_use]
    pub fn entries(&self) -> Vec<(&'static str, String)> {
        let LightCounts { triangles, quadrics, delta, environments, black } = self.lights;
        vec![
            ("primitives", self.primitives.to_string()),
            ("emitting triangles", triangles.to_string()),
            ("emitting spheres and disks", quadrics.to_string()),
            ("point, spot and distant lights", delta.to_string()),
            ("environments", environments.to_string()),
            ("black lights", black.to_string()),
            ("grey lights only", self.grey_lights.to_string()),
            ("textured emission", self.textured_emission.to_string()),
            ("delta lobes", self.delta_lobes.to_string()),
            ("glossy lobes", self.glossy_lobes.to_string()),
            ("transmission", self.transmission.to_string()),
            ("coverage masks", self.alpha.to_string()),
            ("moving camera", self.moving_camera.to_string()),
            ("moving lights", self.moving_lights.to_string()),
            ("moving geometry", self.moving_geometry.to_string()),
            ("depth", self.depth.to_string()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Curve, Geometry, Interpolation, Material, Shape, Track, Transform};

    /// A lamp that is carried is a moving light and moving geometry, another thing that is carried
    /// only the latter.
    #[test]
    fn lamps_that_are_carried_move() {
        for lit in [false, true] {
            let mut scene = Scene::new("carried");
            let reflectance = Color::Constant(glam::Vec3::ONE);
            let white = scene.add_material(Material::Diffuse { reflectance });
            let ball = Geometry::Sphere { center: glam::Vec3::ZERO, radius: 1.0 };
            let shape = Shape::new(ball, white);
            scene.add_shape(if lit { shape.emitting(glam::Vec3::ONE) } else { shape });
            let facts = SceneFacts::new(&scene, LightCounts::default());
            assert_eq!((facts.moving_lights, facts.moving_geometry), (false, false));
            let still = glam::Vec3::ZERO;
            let track = Track::Trs {
                translation: Curve {
                    keys: vec![(0.0, still), (1.0, glam::Vec3::X)],
                    interpolation: Interpolation::Linear,
                },
                rotation: Curve::constant(glam::Quat::IDENTITY),
                scale: Curve::constant(glam::Vec3::ONE),
            };
            scene.instances[0].to_world = Transform::Chain(vec![track]);
            let facts = SceneFacts::new(&scene, LightCounts::default());
            assert_eq!((facts.moving_lights, facts.moving_geometry), (lit, true));
        }
    }
}
