//! What a scene must satisfy before anything renders it; nothing later checks again.

use std::collections::HashSet;

use glam::{Affine3A, Vec3};

use super::transform::is_regular;
use super::{
    Color, ConductorColor, Emission, Geometry, ImageData, LightKind, Material, Mesh, Roughness,
    Scalar, Scene, Shape, TextureKind, Track, Transform,
};
use crate::error::{Error, Result};

/// Pixels of a film: 2³¹, so that a pixel's index fits 32 bits with room for a sign.
const MAX_PIXELS: u64 = 1 << 31;

/// How far the length of a unit vector may be from 1: text files print six digits, averaged normals
/// carry rounding.
const UNIT_TOLERANCE: f32 = 1e-2;

/// How far rounding may carry a sum of albedos above 1.
const ALBEDO_TOLERANCE: f32 = 4.0 * f32::EPSILON;

impl Scene {
    /// Checks everything that rendering relies on: ids in range, textures and mixes that refer to
    /// earlier ones, finite numbers, albedos and shares in [0, 1], positive radii and indices of
    /// refraction, unit normals, mesh arrays of matching length, unique keys, film, field of view
    /// and placements that can be inverted.
    ///
    /// # Errors
    /// The first violation, with the index of the thing that violates, what it is and what is
    /// allowed.
    pub fn validate(&self) -> Result<()> {
        self.validate_film_and_camera()?;
        self.validate_images()?;
        self.validate_textures()?;
        for (i, material) in self.materials.iter().enumerate() {
            self.validate_material(i, material)
                .map_err(|what| invalid(format!("material {i}"), &what))?;
        }
        for (i, object) in self.objects.iter().enumerate() {
            for (k, shape) in object.shapes.iter().enumerate() {
                let name = if object.name.is_empty() {
                    String::new()
                } else {
                    format!(" (\"{}\")", object.name)
                };
                self.validate_shape(shape)
                    .map_err(|what| invalid(format!("object {i}{name}, shape {k}"), &what))?;
            }
        }
        self.validate_instances()?;
        self.validate_lights()
    }

    fn validate_film_and_camera(&self) -> Result<()> {
        let [width, height] = self.film;
        if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(Error::invalid(format!(
                "the film is {width} x {height}; allowed: 1 to {MAX_PIXELS} pixels"
            )));
        }
        if self.depth == 0 {
            return Err(Error::invalid("the depth is 0; allowed: 1 or more path segments"));
        }
        let [first, last] = self.time;
        if !(first.is_finite() && last.is_finite() && first <= last) {
            return Err(Error::invalid(format!(
                "the time goes from {first} to {last}; allowed: finite, in this order"
            )));
        }
        let fov = self.camera.fov;
        if !(fov > 0.0 && fov < std::f32::consts::PI) {
            return Err(Error::invalid(format!(
                "the camera's field of view is {fov}; allowed: between 0 and π"
            )));
        }
        placement(&self.camera.to_world).map_err(|what| invalid("the camera".into(), &what))
    }

    fn validate_images(&self) -> Result<()> {
        for (i, image) in self.images.iter().enumerate() {
            let (pixels, finite) = match &image.data {
                ImageData::Srgb8(data) | ImageData::Linear8(data) => (data.len(), true),
                ImageData::Float(data) => {
                    (data.len(), data.iter().all(|p| p.iter().all(|v| v.is_finite())))
                }
            };
            let (width, height) = (image.width, image.height);
            if width == 0
                || height == 0
                || u64::from(width) * u64::from(height) != pixels as u64
                || pixels > u32::MAX as usize
            {
                let what = format!(
                    "{width} x {height} with {pixels} pixels; allowed: sides above 0, their product pixels"
                );
                return Err(invalid(format!("image {i}"), &what));
            }
            if !finite {
                return Err(invalid(
                    format!("image {i}"),
                    "a pixel that is not finite; allowed: finite numbers",
                ));
            }
        }
        Ok(())
    }

    fn validate_textures(&self) -> Result<()> {
        for (i, texture) in self.textures.iter().enumerate() {
            let earlier = |id: u32| {
                if (id as usize) < i {
                    Ok(())
                } else {
                    Err(format!(
                        "refers to texture {id}; allowed: earlier ones, 0 to {}",
                        i as i64 - 1
                    ))
                }
            };
            let checked = match texture.kind {
                _ if !texture.mapping.is_finite() => {
                    Err("a mapping that is not finite; allowed: finite numbers".to_string())
                }
                TextureKind::Constant(value) if !value.is_finite() => {
                    Err(format!("{value}; allowed: finite numbers"))
                }
                TextureKind::Constant(_) => Ok(()),
                TextureKind::Image { image, scale, .. } => {
                    index("image", image.0, self.images.len())
                        .and_then(|()| range("scale", scale, 0.0, f32::MAX))
                }
                TextureKind::Checkerboard { first, second } => {
                    [first, second].into_iter().try_for_each(|color| match color {
                        Color::Texture(id) => earlier(id.0),
                        Color::Constant(value) if !value.is_finite() => {
                            Err(format!("{value}; allowed: finite numbers"))
                        }
                        Color::Constant(_) => Ok(()),
                    })
                }
                TextureKind::Threshold { value, cutoff } => match value {
                    _ if !cutoff.is_finite() => {
                        Err(format!("the limit {cutoff}; allowed: finite numbers"))
                    }
                    Scalar::Texture(id, _) => earlier(id.0),
                    Scalar::Constant(value) if !value.is_finite() => {
                        Err(format!("{value}; allowed: finite numbers"))
                    }
                    Scalar::Constant(_) => Ok(()),
                },
                TextureKind::Product { first, second } => {
                    earlier(first.0).and_then(|()| earlier(second.0))
                }
            };
            checked.map_err(|what| invalid(format!("texture {i}"), &what))?;
        }
        Ok(())
    }

    fn validate_material(&self, i: usize, material: &Material) -> std::result::Result<(), String> {
        match *material {
            Material::Diffuse { reflectance } => self.check_color("reflectance", reflectance, 1.0),
            Material::DiffuseTransmission { reflectance, transmittance } => {
                self.check_color("reflectance", reflectance, 1.0)?;
                self.check_color("transmittance", transmittance, 1.0)?;
                match (reflectance, transmittance) {
                    (Color::Constant(r), Color::Constant(t))
                        if (r + t).max_element() > 1.0 + ALBEDO_TOLERANCE =>
                    {
                        Err(format!(
                            "reflectance {r} and transmittance {t}; allowed: a sum of at most 1 in each channel"
                        ))
                    }
                    _ => Ok(()),
                }
            }
            Material::Conductor { color, roughness } => {
                match color {
                    ConductorColor::Complex { eta, k } => {
                        self.check_color("eta", eta, f32::MAX)?;
                        self.check_color("k", k, f32::MAX)?;
                    }
                    ConductorColor::Reflectance(reflectance) => {
                        self.check_color("reflectance", reflectance, 1.0)?;
                    }
                }
                self.check_roughness(roughness)
            }
            Material::Dielectric { eta, roughness } => {
                refraction(eta)?;
                self.check_roughness(roughness)
            }
            Material::ThinDielectric { eta } => refraction(eta),
            Material::CoatedDiffuse { reflectance, eta, roughness } => {
                self.check_color("reflectance", reflectance, 1.0)?;
                refraction(eta)?;
                self.check_roughness(roughness)
            }
            Material::MetallicRoughness {
                base_color,
                metallic,
                roughness,
                ior,
                specular,
                specular_color,
                transmission,
                double_sided: _,
            } => {
                self.check_color("base colour", base_color, 1.0)?;
                // A tint may exceed 1: the reflectance at normal incidence is clamped
                // (KHR_materials_specular).
                self.check_color("specular colour", specular_color, f32::MAX)?;
                for (name, value) in [
                    ("metallic", metallic),
                    ("roughness", roughness),
                    ("specular", specular),
                    ("transmission", transmission),
                ] {
                    self.check_share(name, value)?;
                }
                refraction(ior)
            }
            Material::Mix { first, second, amount } => {
                for id in [first, second] {
                    index("material", id.0, self.materials.len())?;
                    if id.index() == i || matches!(self.materials[id.index()], Material::Mix { .. })
                    {
                        return Err(format!(
                            "mixes material {}, a mix; allowed: any other material",
                            id.0
                        ));
                    }
                }
                self.check_share("amount", amount)
            }
        }
    }

    fn check_roughness(&self, roughness: Roughness) -> std::result::Result<(), String> {
        self.check_share("roughness along u", roughness.u)?;
        self.check_share("roughness along v", roughness.v)
    }

    fn check_color(&self, name: &str, color: Color, most: f32) -> std::result::Result<(), String> {
        match color {
            Color::Texture(id) => index("texture", id.0, self.textures.len()),
            Color::Constant(value) => {
                value.to_array().into_iter().try_for_each(|v| range(name, v, 0.0, most))
            }
        }
    }

    fn check_share(&self, name: &str, scalar: Scalar) -> std::result::Result<(), String> {
        match scalar {
            Scalar::Texture(id, _) => index("texture", id.0, self.textures.len()),
            Scalar::Constant(value) => range(name, value, 0.0, 1.0),
        }
    }

    fn validate_shape(&self, shape: &Shape) -> std::result::Result<(), String> {
        index("material", shape.material.0, self.materials.len())?;
        if let Some(alpha) = shape.alpha {
            self.check_share("alpha", alpha)?;
        }
        if let Some(Emission { radiance, scale, two_sided: _ }) = shape.emission {
            self.check_color("radiance", radiance, f32::MAX)?;
            range("scale of the emission", scale, 0.0, f32::MAX)?;
            if let Color::Constant(radiance) = radiance
                && !(radiance * scale).is_finite()
            {
                return Err(format!(
                    "emission {radiance} times {scale}; allowed: a finite product"
                ));
            }
        }
        match &shape.geometry {
            Geometry::Mesh(mesh) => validate_mesh(mesh),
            Geometry::Sphere { center, radius } => ball(*center, *radius),
            Geometry::Disk { center, normal, radius } => {
                ball(*center, *radius).and_then(|()| unit(*normal))
            }
        }
    }

    fn validate_instances(&self) -> Result<()> {
        let mut keys = HashSet::new();
        for (i, instance) in self.instances.iter().enumerate() {
            let checked = index("object", instance.object.0, self.objects.len())
                .and_then(|()| placement_or_hidden(&instance.to_world, true));
            checked.map_err(|what| invalid(format!("instance {i}"), &what))?;
            if !keys.insert(instance.key) {
                return Err(invalid(
                    format!("instance {i}"),
                    &format!("the key {} of an earlier one; allowed: unique keys", instance.key),
                ));
            }
        }
        Ok(())
    }

    fn validate_lights(&self) -> Result<()> {
        let mut keys = HashSet::new();
        for (i, light) in self.lights.iter().enumerate() {
            let emission = |value: Vec3| {
                value.to_array().into_iter().try_for_each(|v| range("emission", v, 0.0, f32::MAX))
            };
            let checked =
                placement_or_hidden(&light.to_world, true).and_then(|()| match light.kind {
                    LightKind::Point { intensity } => emission(intensity),
                    LightKind::Spot { intensity, cos_inner, cos_outer, falloff: _ } => {
                        emission(intensity)?;
                        range("cos_outer", cos_outer, -1.0, 1.0)?;
                        range("cos_inner", cos_inner, cos_outer, 1.0)
                    }
                    LightKind::Distant { irradiance } => emission(irradiance),
                    LightKind::Environment { radiance, image } => {
                        emission(radiance)?;
                        image.map_or(Ok(()), |(id, _)| index("image", id.0, self.images.len()))
                    }
                });
            checked.map_err(|what| invalid(format!("light {i}"), &what))?;
            if !keys.insert(light.key) {
                return Err(invalid(
                    format!("light {i}"),
                    &format!("the key {} of an earlier one; allowed: unique keys", light.key),
                ));
            }
        }
        Ok(())
    }
}

fn invalid(owner: String, what: &str) -> Error {
    Error::invalid(format!("{owner}: {what}"))
}

fn index(what: &str, id: u32, count: usize) -> std::result::Result<(), String> {
    if (id as usize) < count {
        Ok(())
    } else {
        Err(format!("refers to {what} {id}; allowed: less than {count}"))
    }
}

fn range(name: &str, value: f32, least: f32, most: f32) -> std::result::Result<(), String> {
    // NaN fails both comparisons.
    if value >= least && value <= most {
        return Ok(());
    }
    let most = if most == f32::MAX { "any finite number".to_string() } else { most.to_string() };
    Err(format!("{name} is {value}; allowed: {least} to {most}"))
}

fn refraction(eta: f32) -> std::result::Result<(), String> {
    if eta > 0.0 && eta.is_finite() {
        Ok(())
    } else {
        Err(format!("index of refraction {eta}; allowed: above 0, finite"))
    }
}

fn unit(n: Vec3) -> std::result::Result<(), String> {
    if (n.length() - 1.0).abs() <= UNIT_TOLERANCE {
        Ok(())
    } else {
        Err(format!("the normal {n}; allowed: length 1"))
    }
}

fn ball(center: Vec3, radius: f32) -> std::result::Result<(), String> {
    if center.is_finite() && radius > 0.0 && radius.is_finite() {
        return Ok(());
    }
    Err(format!("centre {center}, radius {radius}; allowed: finite, a radius above 0"))
}

fn validate_mesh(mesh: &Mesh) -> std::result::Result<(), String> {
    let vertices = mesh.positions.len();
    for (name, count) in [("normals", mesh.normals.len()), ("texture coordinates", mesh.uvs.len())]
    {
        if count != 0 && count != vertices {
            return Err(format!(
                "{count} {name} for {vertices} vertices; allowed: none, or one for each"
            ));
        }
    }
    if let Some(i) = mesh.positions.iter().position(|p| !p.is_finite()) {
        return Err(format!("vertex {i} is {}; allowed: finite numbers", mesh.positions[i]));
    }
    if let Some(i) = mesh.uvs.iter().position(|p| !p.is_finite()) {
        return Err(format!("texture coordinate {i} is {}; allowed: finite numbers", mesh.uvs[i]));
    }
    mesh.normals.iter().try_for_each(|n| unit(*n))?;
    match mesh.triangles.iter().position(|t| t.iter().any(|v| *v as usize >= vertices)) {
        Some(i) => Err(format!(
            "triangle {i} is {:?}; allowed: vertices below {vertices}",
            mesh.triangles[i]
        )),
        None => Ok(()),
    }
}

/// Finite and invertible, at the ends and at every key.
fn placement(transform: &Transform) -> std::result::Result<(), String> {
    placement_or_hidden(transform, false)
}

/// As [`placement`]; what moves may be hidden by a scale that is or passes 0.
fn placement_or_hidden(transform: &Transform, hides: bool) -> std::result::Result<(), String> {
    match transform {
        Transform::Fixed(affine) => regular(affine),
        Transform::Chain(tracks) => tracks.iter().try_for_each(|track| match track {
            Track::Fixed(affine) => regular(affine),
            Track::Trs { translation, rotation, scale } => {
                keys("translation", translation.keys.iter().map(|k| (k.0, k.1.is_finite())))?;
                keys(
                    "rotation",
                    rotation
                        .keys
                        .iter()
                        .map(|k| (k.0, (k.1.length() - 1.0).abs() <= UNIT_TOLERANCE)),
                )?;
                let fits = |s: Vec3| s.is_finite() && (hides || s.abs().min_element() > 0.0);
                keys("scale", scale.keys.iter().map(|k| (k.0, fits(k.1))))?;
                let turns = scale
                    .keys
                    .windows(2)
                    .any(|w| (w[0].1.signum() * w[1].1.signum()).min_element() < 0.0);
                if turns && !hides {
                    Err("a scale that changes its sign; allowed: one sign along each axis"
                        .to_string())
                } else {
                    Ok(())
                }
            }
        }),
    }
}

fn keys(name: &str, keys: impl Iterator<Item = (f32, bool)>) -> std::result::Result<(), String> {
    let mut last = None;
    for (time, fits) in keys {
        if !time.is_finite() || last.is_some_and(|last| time <= last) {
            return Err(format!(
                "the {name} has a key at {time}; allowed: finite, increasing times"
            ));
        }
        if !fits {
            return Err(format!(
                "the {name} at time {time} cannot be inverted or is not finite; allowed: any that can, unit rotations"
            ));
        }
        last = Some(time);
    }
    if last.is_some() {
        Ok(())
    } else {
        Err(format!("the {name} has no key; allowed: one or more"))
    }
}

fn regular(affine: &Affine3A) -> std::result::Result<(), String> {
    if is_regular(affine) {
        return Ok(());
    }
    Err(format!(
        "the placement {affine} is singular or not finite; allowed: one that has an inverse"
    ))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Quat, Vec2};

    use super::*;
    use crate::scene::{Curve, Interpolation, MaterialId, Texture, TextureId};

    fn scene() -> Scene {
        let mut scene = Scene::new("test");
        let grey = scene
            .add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5)) });
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: vec![Vec2::ZERO; 3],
            triangles: vec![[0, 1, 2]],
        };
        scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), grey));
        scene.add_shape(Shape::new(Geometry::Sphere { center: Vec3::ONE, radius: 2.0 }, grey));
        scene
    }

    /// The message of a scene that was spoilt.
    fn message(spoil: impl Fn(&mut Scene)) -> String {
        let mut scene = scene();
        assert!(scene.validate().is_ok());
        spoil(&mut scene);
        let error = scene.validate().expect_err("the scene is invalid");
        assert!(error.is_invalid());
        error.to_string()
    }

    fn mesh(scene: &mut Scene) -> &mut Mesh {
        match &mut Arc::make_mut(&mut scene.objects[0]).shapes[0].geometry {
            Geometry::Mesh(mesh) => Arc::make_mut(mesh),
            _ => unreachable!("the first shape is a mesh"),
        }
    }

    #[test]
    fn albedos_outside_of_0_to_1_name_the_material() {
        let with = |value: f32| {
            message(move |s| {
                s.materials[0] =
                    Material::Diffuse { reflectance: Color::Constant(Vec3::new(0.0, value, 1.0)) }
            })
        };
        assert_eq!(with(1.5), "material 0: reflectance is 1.5; allowed: 0 to 1");
        assert_eq!(
            with(1.0_f32.next_up()),
            "material 0: reflectance is 1.0000001; allowed: 0 to 1"
        );
        assert_eq!(with(-0.1), "material 0: reflectance is -0.1; allowed: 0 to 1");
        assert_eq!(with(f32::NAN), "material 0: reflectance is NaN; allowed: 0 to 1");
        for fine in [0.0, 1.0_f32.next_down(), 1.0] {
            let mut scene = scene();
            scene.materials[0] =
                Material::Diffuse { reflectance: Color::Constant(Vec3::splat(fine)) };
            assert!(scene.validate().is_ok(), "{fine}");
        }
    }

    #[test]
    fn meshes() {
        assert_eq!(
            message(|s| mesh(s).triangles[0][2] = 3),
            "object 0, shape 0: triangle 0 is [0, 1, 3]; allowed: vertices below 3"
        );
        assert_eq!(
            message(|s| mesh(s).positions[1].y = f32::INFINITY),
            "object 0, shape 0: vertex 1 is [1, inf, 0]; allowed: finite numbers"
        );
        assert!(message(|s| mesh(s).normals[0] = Vec3::ZERO).contains("the normal [0, 0, 0]"));
        assert!(message(|s| mesh(s).normals.truncate(2)).contains("2 normals for 3 vertices"));
        assert!(
            message(|s| mesh(s).uvs.truncate(1)).contains("1 texture coordinates for 3 vertices")
        );
        assert!(message(|s| mesh(s).uvs[0].x = f32::NAN).contains("texture coordinate 0"));
    }

    #[test]
    fn ids_and_keys() {
        assert!(message(|s| s.instances[1].key = 0).contains("instance 1: the key 0"));
        assert!(
            message(|s| s.instances[1].object.0 = 7)
                .contains("refers to object 7; allowed: less than 2")
        );
        assert!(
            message(|s| Arc::make_mut(&mut s.objects[1]).shapes[0].material = MaterialId(4))
                .contains("refers to material 4")
        );
        let product = |first, second| Texture {
            kind: TextureKind::Product { first: TextureId(first), second: TextureId(second) },
            mapping: glam::Affine2::IDENTITY,
        };
        assert!(
            message(|s| s.textures.push(product(0, 0)))
                .contains("texture 0: refers to texture 0; allowed: earlier")
        );
        assert!(
            message(|s| s.textures.push(Texture::image(crate::scene::ImageId(0))))
                .contains("refers to image 0")
        );
        let mix = Material::Mix {
            first: MaterialId(0),
            second: MaterialId(1),
            amount: Scalar::Constant(0.5),
        };
        assert!(message(|s| s.materials.push(mix)).contains("material 1: mixes material 1"));
    }

    #[test]
    fn sizes_and_placements() {
        assert!(message(|s| s.film = [0, 4]).contains("the film is 0 x 4"));
        assert!(
            message(|s| s.film = [1 << 16, 1 << 16]).contains("allowed: 1 to 2147483648 pixels")
        );
        assert!(message(|s| s.camera.fov = std::f32::consts::PI).contains("field of view"));
        assert!(message(|s| s.camera.fov = f32::NAN).contains("field of view"));
        assert!(message(|s| s.depth = 0).contains("depth"));
        assert!(message(|s| s.time = [1.0, 0.0]).contains("time"));
        let flat = Affine3A::from_scale(Vec3::new(1.0, 1.0, 0.0));
        assert!(
            message(|s| s.instances[0].to_world = Transform::Fixed(flat))
                .contains("instance 0: the placement")
        );
        let curve = |keys| Curve { keys, interpolation: Interpolation::Linear };
        let chain = |scale| {
            Transform::Chain(vec![Track::Trs {
                translation: Curve::constant(Vec3::ZERO),
                rotation: Curve::constant(Quat::IDENTITY),
                scale,
            }])
        };
        let mirrored = curve(vec![(0.0, Vec3::ONE), (1.0, Vec3::NEG_ONE)]);
        assert!(
            message(|s| s.camera.to_world = chain(mirrored.clone())).contains("changes its sign")
        );
        // A scale of 0 hides an instance, and leaves a camera without directions.
        let vanishing = curve(vec![(0.0, Vec3::ONE), (1.0, Vec3::ZERO)]);
        assert!(
            message(|s| s.camera.to_world = chain(vanishing.clone()))
                .contains("cannot be inverted")
        );
        for scale in [mirrored, vanishing] {
            let mut scene = scene();
            scene.time = [0.0, 1.0];
            scene.instances[0].to_world = chain(scale);
            scene.validate().unwrap();
            let shown = [0.0, 0.25, 0.5, 1.0].map(|time| {
                let now = scene.at(time);
                now.validate().unwrap();
                now.instances.len() == scene.instances.len()
            });
            let half = scene.instances[0].to_world.at(0.5).matrix3.x_axis.x;
            assert_eq!(shown, [true, true, half != 0.0, half == 0.0]);
        }
        let backward = curve(vec![(1.0, Vec3::ONE), (0.0, Vec3::ONE)]);
        assert!(
            message(|s| s.instances[0].to_world = chain(backward.clone()))
                .contains("increasing times")
        );
        assert!(message(|s| s.instances[0].to_world = chain(curve(vec![]))).contains("no key"));
    }

    #[test]
    fn every_scale_of_a_scene_passes() {
        for exponent in [-30, -10, 10, 30] {
            let mut scene = scene();
            scene.instances[0].to_world =
                Transform::Fixed(Affine3A::from_scale(Vec3::splat(2.0_f32.powi(exponent))));
            assert!(scene.validate().is_ok(), "2^{exponent}");
        }
    }
}
