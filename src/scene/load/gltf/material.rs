//! Materials, textures and pictures.
//!
//! glTF puts v = 0 at a picture's top row, [`Texture`] puts t = 1 there: t = 1 − v.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{Affine2, Mat2, Vec2, Vec3, Vec4};
use gltf::json::material::AlphaMode;
use gltf::json::texture::{Info, MagFilter, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, Texture as GivenTexture};

use super::super::{Encoding, Warnings, picture};
use super::bytes::{Buffers, Resource, resolve};
use crate::error::{Error, Result};
use crate::scene::load::black::is_black;
use crate::scene::{
    Channel, Color, Emission, ImageData, ImageId, Material, MaterialId, Roughness, Scalar, Scene,
    Texture, TextureId, TextureKind, Wrap,
};

/// All pictures of a file together may not take more decoded bytes: 4 GiB.
const MAX_PICTURE_BYTES: u64 = 1 << 32;

/// An index of refraction whose reflectance at normal incidence rounds to 1.
const INFINITE_IOR: f32 = 1e9;

/// The source of a texture that names none.
const NO_SOURCE: usize = u32::MAX as usize;

/// What a primitive takes from its material.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub(super) material: MaterialId,
    pub(super) emission: Option<Emission>,
    pub(super) alpha: Option<Scalar>,
    /// The set of texture coordinates that its textures read, if it has textures.
    pub(super) uv_set: Option<u32>,
}

/// Reads materials into a scene.
pub(super) struct Materials<'a> {
    pub(super) root: &'a Root,
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) path: &'a Path,
    /// `None` cannot be read and has been warned of.
    pub(super) pictures: HashMap<(usize, Encoding), Option<ImageId>>,
    pub(super) picture_bytes: u64,
}

impl Materials<'_> {
    /// The surface of material number `index`; `None` is glTF's default material.
    pub(super) fn surface(
        &mut self,
        index: Option<usize>,
        scene: &mut Scene,
        warnings: &mut Warnings,
    ) -> Result<Surface> {
        let fallback = gltf::json::Material::default();
        let given = index.map_or(&fallback, |i| &self.root.materials[i]);
        let place = index.map_or_else(|| "materials".to_string(), |i| format!("materials[{i}]"));
        let at = |field: &str| format!("{place}.{field}");
        let mut uv_set = None;

        let pbr = &given.pbr_metallic_roughness;
        let factor = Vec4::from_array(pbr.base_color_factor.0);
        in_unit(&factor.to_array(), &at("pbrMetallicRoughness.baseColorFactor"))?;
        let base = pbr.base_color_texture.as_ref().map(|info| {
            let place = at("pbrMetallicRoughness.baseColorTexture");
            self.texture(info, Encoding::Srgb, factor, &place, &mut uv_set, scene, warnings)
        });
        let base = base.transpose()?.flatten();
        let base_color = color(base, factor.truncate());

        let metallic = pbr.metallic_factor.0;
        let roughness = pbr.roughness_factor.0;
        in_unit(&[metallic], &at("pbrMetallicRoughness.metallicFactor"))?;
        in_unit(&[roughness], &at("pbrMetallicRoughness.roughnessFactor"))?;
        let both = pbr.metallic_roughness_texture.as_ref().map(|info| {
            let place = at("pbrMetallicRoughness.metallicRoughnessTexture");
            let factor = Vec4::new(1.0, roughness, metallic, 1.0);
            self.texture(info, Encoding::Linear, factor, &place, &mut uv_set, scene, warnings)
        });
        let both = both.transpose()?.flatten();

        let extensions = given.extensions.clone().unwrap_or_default();
        let mut ior = extensions.ior.map_or(1.5, |ior| ior.ior.0);
        if ior == 0.0 {
            // The extension's word for an infinite index: it reflects all at any angle.
            ior = INFINITE_IOR;
        }
        if !(ior.is_finite() && ior >= 1.0) {
            let message = format!("is {ior}; allowed: 0, or at least 1");
            return Err(Error::invalid(message).at_json(at("extensions.KHR_materials_ior.ior")));
        }

        let (mut specular, mut specular_color) =
            (Scalar::Constant(1.0), Color::Constant(Vec3::ONE));
        if let Some(given) = &extensions.specular {
            let at = |field: &str| at(&format!("extensions.KHR_materials_specular.{field}"));
            let strength = given.specular_factor.0;
            in_unit(&[strength], &at("specularFactor"))?;
            let tint = Vec3::from_array(given.specular_color_factor.0);
            not_negative(&tint.to_array(), &at("specularColorFactor"))?;
            let texture = given.specular_texture.as_ref().map(|info| {
                let factor = Vec4::new(1.0, 1.0, 1.0, strength);
                let place = at("specularTexture");
                self.texture(info, Encoding::Linear, factor, &place, &mut uv_set, scene, warnings)
            });
            specular = scalar(texture.transpose()?.flatten(), Channel::Alpha, strength);
            let texture = given.specular_color_texture.as_ref().map(|info| {
                let place = at("specularColorTexture");
                let factor = tint.extend(1.0);
                self.texture(info, Encoding::Srgb, factor, &place, &mut uv_set, scene, warnings)
            });
            specular_color = color(texture.transpose()?.flatten(), tint);
        }

        let mut transmission = Scalar::Constant(0.0);
        if let Some(given) = &extensions.transmission {
            let at = |field: &str| at(&format!("extensions.KHR_materials_transmission.{field}"));
            let share = given.transmission_factor.0;
            in_unit(&[share], &at("transmissionFactor"))?;
            let texture = given.transmission_texture.as_ref().map(|info| {
                let factor = Vec4::new(share, 1.0, 1.0, 1.0);
                let place = at("transmissionTexture");
                self.texture(info, Encoding::Linear, factor, &place, &mut uv_set, scene, warnings)
            });
            transmission = scalar(texture.transpose()?.flatten(), Channel::Red, share);
        }
        let thick = extensions.volume.as_ref().is_some_and(|v| v.thickness_factor.0 > 0.0);
        let clear = matches!(transmission, Scalar::Constant(share) if share == 1.0)
            && metallic == 0.0
            && both.is_none();
        if thick && !clear {
            warnings.add(format!(
                "{}: a volume is read only where transmissionFactor is 1, metallicFactor 0, both without textures; \
                 taken as thin-walled",
                at("extensions.KHR_materials_volume")
            ));
        }
        if let Some(volume) = &extensions.volume
            && (volume.thickness_texture.is_some() || volume.attenuation_color.0 != [1.0; 3])
        {
            warnings.add(format!(
                "{}: thickness textures and attenuation are ignored",
                at("extensions.KHR_materials_volume")
            ));
        }

        for (there, field) in [
            (given.normal_texture.is_some(), "normalTexture"),
            (given.occlusion_texture.is_some(), "occlusionTexture"),
        ] {
            if there {
                warnings.add(format!("{}: not read; ignored", at(field)));
            }
        }

        let emissive = Vec3::from_array(given.emissive_factor.0);
        not_negative(&emissive.to_array(), &at("emissiveFactor"))?;
        let strength = extensions.emissive_strength.map_or(1.0, |s| s.emissive_strength.0);
        not_negative(
            &[strength],
            &at("extensions.KHR_materials_emissive_strength.emissiveStrength"),
        )?;
        let mut emission = None;
        if emissive != Vec3::ZERO && strength > 0.0 {
            let texture = given.emissive_texture.as_ref().map(|info| {
                let place = at("emissiveTexture");
                let factor = emissive.extend(1.0);
                self.texture(info, Encoding::Srgb, factor, &place, &mut uv_set, scene, warnings)
            });
            let radiance = color(texture.transpose()?.flatten(), emissive);
            let emits = !is_black(scene, radiance);
            let two_sided = given.double_sided;
            emission = emits.then_some(Emission { radiance, scale: strength, two_sided });
        }

        let coverage = scalar(base, Channel::Alpha, factor.w);
        let alpha = match given.alpha_mode {
            Checked::Invalid => {
                let message = "allowed: OPAQUE, MASK, BLEND";
                return Err(Error::invalid(message).at_json(at("alphaMode")));
            }
            Checked::Valid(AlphaMode::Opaque) => None,
            Checked::Valid(AlphaMode::Blend) => match coverage {
                Scalar::Constant(1.0) => None,
                other => Some(other),
            },
            Checked::Valid(AlphaMode::Mask) => {
                let cutoff = given.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0);
                not_negative(&[cutoff], &at("alphaCutoff"))?;
                match coverage {
                    Scalar::Constant(value) if value >= cutoff => None,
                    Scalar::Constant(_) => Some(Scalar::Constant(0.0)),
                    Scalar::Texture(..) => {
                        let kind = TextureKind::Threshold { value: coverage, cutoff };
                        let texture =
                            scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
                        Some(Scalar::Texture(texture, Channel::Red))
                    }
                }
            }
        };

        // What is not there sends nothing; an emitter that no ray meets is another thing.
        if matches!(alpha, Some(Scalar::Constant(0.0))) {
            emission = None;
        }

        let material = if thick && clear {
            if factor.truncate() != Vec3::ONE || base.is_some() {
                warnings
                    .add(format!("{}: the colour of glass is ignored", at("pbrMetallicRoughness")));
            }
            Material::Dielectric {
                eta: ior,
                roughness: Roughness::isotropic(roughness * roughness),
            }
        } else {
            Material::MetallicRoughness {
                base_color,
                metallic: scalar(both, Channel::Blue, metallic),
                roughness: scalar(both, Channel::Green, roughness),
                ior,
                specular,
                specular_color,
                transmission,
                double_sided: given.double_sided,
            }
        };
        Ok(Surface { material: scene.add_material(material), emission, alpha, uv_set })
    }

    /// A texture times `factor`; `None` where its picture cannot be read, which is warned of.
    #[expect(clippy::too_many_arguments, reason = "one call's worth of context for one texture")]
    fn texture(
        &mut self,
        info: &Info,
        encoding: Encoding,
        factor: Vec4,
        place: &str,
        uv_set: &mut Option<u32>,
        scene: &mut Scene,
        warnings: &mut Warnings,
    ) -> Result<Option<TextureId>> {
        let given = self.root.get(info.index).ok_or_else(|| {
            let message =
                format!("refers to textures[{}], which does not exist", info.index.value());
            Error::invalid(message).at_json(format!("{place}.index"))
        })?;
        let Some(image) = self.picture(given, info.index, encoding, scene, warnings)? else {
            return Ok(None);
        };
        let transform =
            info.extensions.as_ref().and_then(|e| e.texture_transform.clone()).unwrap_or_default();
        let set = transform.tex_coord.unwrap_or(info.tex_coord);
        let used = *uv_set.get_or_insert(set);
        if used != set {
            warnings.add(format!(
                "{place}.texCoord: is {set}, but other textures of the material read set {used}; taken as {used}"
            ));
        }
        let mapping = uv_to_st(
            Vec2::from_array(transform.offset.0),
            transform.rotation.0,
            Vec2::from_array(transform.scale.0),
        );
        if !mapping.is_finite() {
            let message = "has numbers that are not finite";
            let place = format!("{place}.extensions.KHR_texture_transform");
            return Err(Error::invalid(message).at_json(place));
        }
        let wrap = self.wrap(given, info.index, warnings);
        let kind = TextureKind::Image { image, wrap, scale: 1.0, invert: false };
        let texture = scene.add_texture(Texture { kind, mapping });
        if factor == Vec4::ONE {
            return Ok(Some(texture));
        }
        let kind = TextureKind::Constant(factor);
        let second = scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
        let kind = TextureKind::Product { first: texture, second };
        Ok(Some(scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY })))
    }

    fn wrap(
        &self,
        given: &GivenTexture,
        index: Index<GivenTexture>,
        warnings: &mut Warnings,
    ) -> Wrap {
        let Some(sampler) = given.sampler.and_then(|sampler| self.root.get(sampler)) else {
            return Wrap::Repeat;
        };
        let wrap = |mode: Checked<WrappingMode>| match mode {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
            Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
        };
        let (s, t) = (wrap(sampler.wrap_s), wrap(sampler.wrap_t));
        if s != t {
            let i = index.value();
            warnings.add(format!(
                "textures[{i}].sampler: wrapS and wrapT differ; wrapS is used for both"
            ));
        }
        if sampler.mag_filter == Some(Checked::Valid(MagFilter::Nearest)) {
            let i = index.value();
            warnings.add(format!("textures[{i}].sampler: NEAREST is not read; bilinear is used"));
        }
        s
    }

    fn picture(
        &mut self,
        given: &GivenTexture,
        index: Index<GivenTexture>,
        encoding: Encoding,
        scene: &mut Scene,
        warnings: &mut Warnings,
    ) -> Result<Option<ImageId>> {
        let i = given.source.value();
        if let Some(&id) = self.pictures.get(&(i, encoding)) {
            return Ok(id);
        }
        if i == NO_SOURCE {
            warnings.add(format!(
                "textures[{}].source: missing; its picture is an extension's, which is not read: the texture is left out",
                index.value()
            ));
            return Ok(None);
        }
        let place = format!("images[{i}]");
        let source = self.root.get(given.source).ok_or_else(|| {
            let place = format!("textures[{}].source", index.value());
            Error::invalid(format!("refers to {place}, which does not exist")).at_json(place)
        })?;
        let (place, image) = match (&source.uri, source.buffer_view) {
            (Some(uri), _) => {
                let place = format!("{place}.uri");
                let resource = resolve(uri, self.path).map_err(|e| e.at_json(place.clone()))?;
                let image = match resource {
                    Resource::Inline(bytes) => picture::image_from_bytes(&bytes, encoding),
                    Resource::File(file) => picture::load_image(&file, encoding),
                };
                (place, image)
            }
            (None, Some(view)) => {
                let image = picture::image_from_bytes(self.buffers.view(view)?, encoding);
                (format!("{place}.bufferView"), image)
            }
            (None, None) => {
                let message = "has neither uri nor bufferView; allowed: one of them";
                return Err(Error::invalid(message).at_json(place));
            }
        };
        let image = match image {
            Err(error) if error.is_unsupported() => {
                warnings.add(format!("{place}: {error}; the texture is left out"));
                self.pictures.insert((i, encoding), None);
                return Ok(None);
            }
            other => other.map_err(|e| e.at_json(place.clone()))?,
        };
        let pixel = match &image.data {
            ImageData::Srgb8(_) | ImageData::Linear8(_) => 4,
            ImageData::Float(_) => 16,
        };
        self.picture_bytes += u64::from(image.width) * u64::from(image.height) * pixel;
        if self.picture_bytes > MAX_PICTURE_BYTES {
            let message =
                format!("all pictures together take more than {MAX_PICTURE_BYTES} bytes decoded");
            return Err(Error::invalid(message).at_json(place));
        }
        scene.images.push(Arc::new(image));
        let id = ImageId((scene.images.len() - 1) as u32);
        self.pictures.insert((i, encoding), Some(id));
        Ok(Some(id))
    }
}

/// Surface (u, v) to [`Texture`] coordinates under `KHR_texture_transform`: translation · rotation
/// · scale, then t = 1 − v.
///
/// Positive angles turn (u, v) counter-clockwise as seen with v pointing down. The matrix printed
/// in the extension turns the other way, which its editors call an error (KhronosGroup/glTF issue
/// 1563).
fn uv_to_st(offset: Vec2, rotation: f32, scale: Vec2) -> Affine2 {
    let (sin, cos) = rotation.sin_cos();
    let turn = Mat2::from_cols(Vec2::new(cos, -sin), Vec2::new(sin, cos));
    let flip = Affine2::from_cols(Vec2::X, -Vec2::Y, Vec2::Y);
    flip * Affine2::from_mat2_translation(turn * Mat2::from_diagonal(scale), offset)
}

fn color(texture: Option<TextureId>, otherwise: Vec3) -> Color {
    texture.map_or(Color::Constant(otherwise), Color::Texture)
}

fn scalar(texture: Option<TextureId>, channel: Channel, otherwise: f32) -> Scalar {
    texture.map_or(Scalar::Constant(otherwise), |id| Scalar::Texture(id, channel))
}

fn in_unit(values: &[f32], place: &str) -> Result<()> {
    if values.iter().all(|x| (0.0..=1.0).contains(x)) {
        return Ok(());
    }
    Err(Error::invalid(format!("is {values:?}; allowed: 0 to 1")).at_json(place))
}

pub(super) fn not_negative(values: &[f32], place: &str) -> Result<()> {
    if values.iter().all(|x| x.is_finite() && *x >= 0.0) {
        return Ok(());
    }
    Err(Error::invalid(format!("is {values:?}; allowed: finite numbers from 0 on")).at_json(place))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_coordinates_are_flipped_after_the_transform() {
        let plain = uv_to_st(Vec2::ZERO, 0.0, Vec2::ONE);
        assert_eq!(plain.transform_point2(Vec2::new(0.25, 0.1)), Vec2::new(0.25, 0.9));
        // A quarter turn, counter-clockwise with v pointing down: (1, 0) goes to (0, -1).
        let turned =
            uv_to_st(Vec2::new(0.5, 0.0), std::f32::consts::FRAC_PI_2, Vec2::new(2.0, 1.0));
        let st = turned.transform_point2(Vec2::X);
        assert!((st - Vec2::new(0.5, 3.0)).length() < 1e-6, "{st}");
    }
}
