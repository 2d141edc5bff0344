//! `LightSource` and `AreaLightSource`.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::params::{Params, Type};
use super::spectrum::{self, Role};
use super::{Builder, Encoding, shorten};
use crate::error::{Result, suggest};
use crate::math::luminance;
use crate::scene::load::black::is_black;
use crate::scene::{
    Color, Emission, EnvironmentMapping, Image, ImageData, Light, LightKind, Scene, SpotFalloff,
    Texture,
};

const KINDS: [&str; 4] = ["infinite", "distant", "point", "spot"];

/// The types of an emitted colour.
const COLOR: [Type; 3] = [Type::Rgb, Type::Spectrum, Type::Blackbody];

impl Builder {
    pub(super) fn make_light(&mut self, kind: &str, params: &Params) -> Result<()> {
        let scale = params.float_or("scale", 1.0)?;
        if scale < 0.0 {
            return params
                .param_place("scale")
                .invalid(format!("`scale` is {scale}; allowed: 0 or more"));
        }
        let (kind, local) = match kind {
            "point" => {
                let intensity = emitted(params, "I")?;
                let factor = match params.float("power")? {
                    Some(power) => power / (4.0 * PI),
                    None => 1.0,
                };
                let from = params.point_or("from", DVec3::ZERO)?;
                (
                    LightKind::Point { intensity: times(intensity, scale * factor) },
                    DAffine3::from_translation(from),
                )
            }
            "spot" => self.spot(params, scale)?,
            "distant" => {
                let mut radiance = emitted(params, "L")?;
                if let Some(illuminance) = params.float("illuminance")? {
                    radiance = times(radiance, illuminance);
                }
                let (_, frame) = aim(params)?;
                (
                    LightKind::Distant { irradiance: times(radiance, scale) },
                    DAffine3::from_mat3(frame),
                )
            }
            "infinite" => (self.environment(params, scale)?, DAffine3::IDENTITY),
            other => {
                return params.place.unsupported(format!(
                    "LightSource \"{}\"; {}",
                    shorten(other),
                    suggest(&shorten(other), &KINDS)
                ));
            }
        };
        let ctm = self.state.ctm.then(local);
        let to_world = self.placement(ctm, &params.place)?;
        let key = self.scene.lights.len() as u64;
        self.scene.lights.push(Light { to_world, kind, key });
        Ok(())
    }

    fn spot(&mut self, params: &Params, scale: f64) -> Result<(LightKind, DAffine3)> {
        let intensity = emitted(params, "I")?;
        let angle = params.float_or("coneangle", 30.0)?;
        let delta = params.float_or("conedeltaangle", 5.0)?;
        if !(angle > 0.0 && angle <= 180.0) {
            return params
                .param_place("coneangle")
                .invalid(format!("`coneangle` is {angle}; allowed: degrees above 0, at most 180"));
        }
        if !(0.0..=angle).contains(&delta) {
            let message = format!(
                "`conedeltaangle` is {delta}; allowed: degrees from 0 to `coneangle`, {angle}"
            );
            return params.param_place("conedeltaangle").invalid(message);
        }
        let (outer, inner) = (angle.to_radians().cos(), (angle - delta).to_radians().cos());
        // pbrt's integral of its falloff: half of the ring between the two cones.
        let factor = match params.float("power")? {
            Some(power) => power / (2.0 * PI * ((1.0 - inner) + 0.5 * (inner - outer))),
            None => 1.0,
        };
        let (from, frame) = aim(params)?;
        let kind = LightKind::Spot {
            intensity: times(intensity, scale * factor),
            cos_inner: inner as f32,
            cos_outer: outer as f32,
            falloff: SpotFalloff::Smoothstep,
        };
        Ok((kind, DAffine3::from_mat3_translation(frame, from)))
    }

    fn environment(&mut self, params: &Params, scale: f64) -> Result<LightKind> {
        if params.has("portal") {
            return params
                .param_place("portal")
                .unsupported("`portal` of an infinite light; allowed: none");
        }
        let illuminance = params.float("illuminance")?;
        let Some(name) = params.string("filename")? else {
            let factor = illuminance.map_or(1.0, |e| e / PI);
            let radiance = times(emitted(params, "L")?, scale * factor);
            return Ok(LightKind::Environment { radiance, image: None });
        };
        let place = params.param_place("filename").clone();
        if params.has("L") {
            return place.invalid("both `L` and `filename`; allowed: one of them");
        }
        if illuminance.is_some() {
            return params
                .param_place("illuminance")
                .unsupported("`illuminance` beside `filename`; allowed: `scale`");
        }
        let name = name.to_string();
        let id = self.image(&name, &place, Encoding::Srgb, false)?;
        let image = &self.scene.images[id.index()];
        let mapping = if image.width == image.height {
            EnvironmentMapping::EqualAreaOctahedral
        } else if image.width == 2 * image.height {
            EnvironmentMapping::LatitudeLongitude
        } else {
            let message = format!(
                "\"{}\" is {} x {} pixels; allowed: square (equal-area octahedral) or twice as wide as high (latitude-longitude)",
                shorten(&name),
                image.width,
                image.height
            );
            return place.unsupported(message);
        };
        if let Some(cleaned) = without_negatives(image) {
            self.warnings.add(format!(
                "{place}: \"{}\" has negative pixels; they are taken as 0",
                shorten(&name)
            ));
            self.scene.images[id.index()] = std::sync::Arc::new(cleaned);
        }
        Ok(LightKind::Environment {
            radiance: Vec3::splat(scale as f32),
            image: Some((id, mapping)),
        })
    }

    /// Refuses what [`Builder::emission`] cannot use, at the directive instead of at the first
    /// shape.
    pub(super) fn check_area_light(&mut self, params: &Params) -> Result<()> {
        if params.has("power") {
            return params
                .param_place("power")
                .unsupported("`power` of an area light; allowed: `L` and `scale`");
        }
        self.emission(params).map(|_| ())
    }

    /// What the shapes to come emit.
    pub(super) fn emission(&mut self, params: &Params) -> Result<Emission> {
        let scale = params.float_or("scale", 1.0)?;
        if scale < 0.0 {
            return params
                .param_place("scale")
                .invalid(format!("`scale` is {scale}; allowed: 0 or more"));
        }
        let two_sided = params.bool_or("twosided", false)?;
        let radiance = match params.string("filename")?.map(str::to_string) {
            Some(name) => {
                let place = params.param_place("filename").clone();
                if params.has("L") {
                    return place.invalid("both `L` and `filename`; allowed: one of them");
                }
                let image = self.image(&name, &place, Encoding::Srgb, false)?;
                Color::Texture(self.scene.add_texture(Texture::image(image)))
            }
            None => Color::Constant(emitted(params, "L")?),
        };
        Ok(Emission { radiance, scale: scale as f32, two_sided })
    }
}

/// A colour that defaults to white.
fn emitted(params: &Params, name: &'static str) -> Result<Vec3> {
    match params.typed(name, &COLOR)? {
        Some(param) => spectrum::rgb(param, Role::Emission),
        None => Ok(Vec3::ONE),
    }
}

fn times(color: Vec3, factor: f64) -> Vec3 {
    (color.as_dvec3() * factor).as_vec3()
}

/// `from` and a frame whose +z points to `to`.
fn aim(params: &Params) -> Result<(DVec3, DMat3)> {
    let from = params.point_or("from", DVec3::ZERO)?;
    let to = params.point_or("to", DVec3::Z)?;
    let Some(z) = (to - from).try_normalize() else {
        return params
            .param_place("to")
            .invalid(format!("`from` and `to` are both {from}; allowed: two points"));
    };
    let x = z.any_orthonormal_vector();
    Ok((from, DMat3::from_cols(x, z.cross(x), z)))
}

/// The image with negative values replaced, if it has any.
fn without_negatives(image: &Image) -> Option<Image> {
    match &image.data {
        ImageData::Float(data) if data.iter().any(|p| p.iter().any(|v| *v < 0.0)) => {
            let data = data.iter().map(|p| p.map(|v| v.max(0.0))).collect();
            Some(Image { width: image.width, height: image.height, data: ImageData::Float(data) })
        }
        _ => None,
    }
}

/// Whether an emission is above zero anywhere.
pub(super) fn emits(scene: &Scene, emission: &Emission) -> bool {
    let dark = match emission.radiance {
        Color::Constant(radiance) => luminance(radiance) == 0.0,
        textured => is_black(scene, textured),
    };
    !dark && emission.scale > 0.0
}
