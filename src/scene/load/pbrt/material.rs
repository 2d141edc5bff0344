//! `Material`, `MakeNamedMaterial`, `NamedMaterial`.

use glam::Vec3;

use super::params::{Params, Place, Type};
use super::spectrum::{self, Index, Role};
use super::{Builder, File, Surface, list, shorten};
use crate::error::{Result, suggest};
use crate::scene::{Color, ConductorColor, Material, MaterialId, Roughness, Scalar};

const KINDS: [&str; 9] = [
    "diffuse",
    "diffusetransmission",
    "conductor",
    "dielectric",
    "thindielectric",
    "coateddiffuse",
    "coatedconductor",
    "mix",
    "interface",
];

/// Materials of pbrt-v3 that pbrt-v4 does not have.
const KINDS_OF_VERSION_3: [&str; 11] = [
    "disney",
    "fourier",
    "glass",
    "kdsubsurface",
    "matte",
    "metal",
    "mirror",
    "plastic",
    "substrate",
    "translucent",
    "uber",
];

/// Details of the surface that no material here has.
const RELIEF: [&str; 3] = ["displacement", "bumpmap", "normalmap"];

impl Builder {
    pub(super) fn make_named_material(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let (name, params) =
            file.params("MakeNamedMaterial", place, &self.state.defaults.material)?;
        let Some(kind) = params.string("type")?.map(str::to_string) else {
            let message =
                format!("material \"{}\" has no `type`; {}", shorten(&name), suggest("", &KINDS));
            return place.invalid(message);
        };
        let surface = self.make_material(&kind, &params)?;
        params.finish(&mut self.warnings);
        if self.materials.insert(name.clone(), surface).is_some() {
            self.warnings.add(format!(
                "{place}: material \"{}\" is defined again: the new one holds from here",
                shorten(&name)
            ));
        }
        Ok(())
    }

    pub(super) fn named_material(&self, name: &str, place: &Place) -> Result<Surface> {
        match self.materials.get(name) {
            Some(surface) => Ok(*surface),
            None => {
                let known = list(name, self.materials.keys().map(String::as_str));
                place.invalid(format!("no material \"{}\" so far; {known}", shorten(name)))
            }
        }
    }

    /// The material of shapes without one: pbrt's grey.
    pub(super) fn default_material(&mut self) -> MaterialId {
        let grey = Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5)) };
        match self.default_material {
            Some(id) => id,
            None => *self.default_material.insert(self.scene.add_material(grey)),
        }
    }

    pub(super) fn make_material(&mut self, kind: &str, params: &Params) -> Result<Surface> {
        params.ignore_with(&RELIEF, "the surface stays smooth", &mut self.warnings);
        let material = match kind {
            "diffuse" => Material::Diffuse {
                reflectance: self.color(params, "reflectance", Vec3::splat(0.5), Role::Albedo)?,
            },
            "diffusetransmission" => self.diffuse_transmission(params)?,
            "conductor" => Material::Conductor {
                color: self.conductor_color(params, ["eta", "k"])?,
                roughness: self.roughness(params, "")?,
            },
            "coatedconductor" => {
                let warning = format!(
                    "{}: the coat of coatedconductor is ignored: the bare metal remains",
                    params.place
                );
                self.warnings.add(warning);
                params.ignore(&[
                    "interface.roughness",
                    "interface.uroughness",
                    "interface.vroughness",
                    "interface.eta",
                    "thickness",
                    "g",
                    "albedo",
                    "maxdepth",
                    "nsamples",
                ]);
                let color = self.conductor_color(params, ["conductor.eta", "conductor.k"])?;
                Material::Conductor { color, roughness: self.roughness(params, "conductor.")? }
            }
            "dielectric" => Material::Dielectric {
                eta: self.index(params)?,
                roughness: self.roughness(params, "")?,
            },
            "thindielectric" => Material::ThinDielectric { eta: self.index(params)? },
            "coateddiffuse" => {
                params.ignore(&["maxdepth", "nsamples"]);
                params.ignore_with(
                    &["thickness", "g", "albedo"],
                    "the coat is thin and clear",
                    &mut self.warnings,
                );
                Material::CoatedDiffuse {
                    reflectance: self.color(
                        params,
                        "reflectance",
                        Vec3::splat(0.5),
                        Role::Albedo,
                    )?,
                    eta: self.index(params)?,
                    roughness: self.roughness(params, "")?,
                }
            }
            "mix" => self.mix(params)?,
            "interface" | "" => return Ok(Surface::Interface),
            other if KINDS_OF_VERSION_3.contains(&other) => {
                let found = format!("material \"{other}\"");
                return params.place.unsupported(super::of_version_3(found));
            }
            other => {
                return params.place.unsupported(format!(
                    "material \"{}\"; {}",
                    shorten(other),
                    suggest(&shorten(other), &KINDS)
                ));
            }
        };
        Ok(Surface::Material(self.scene.add_material(material)))
    }

    fn diffuse_transmission(&mut self, params: &Params) -> Result<Material> {
        let scale = params.float_or("scale", 1.0)?;
        if scale < 0.0 {
            return params
                .param_place("scale")
                .invalid(format!("`scale` is {scale}; allowed: 0 or more"));
        }
        let quarter = Vec3::splat(0.25);
        let reflectance = self.color(params, "reflectance", quarter, Role::Albedo)?;
        let transmittance = self.color(params, "transmittance", quarter, Role::Albedo)?;
        let reflectance = self.scaled(reflectance, scale as f32);
        let transmittance = self.scaled(transmittance, scale as f32);
        if let (Color::Constant(r), Color::Constant(t)) = (reflectance, transmittance)
            && (r + t).max_element() > 1.0
        {
            let message = format!(
                "`reflectance` {r} and `transmittance` {t} (with `scale`); allowed: a sum of at most 1 in each channel"
            );
            return params.place.invalid(message);
        }
        Ok(Material::DiffuseTransmission { reflectance, transmittance })
    }

    fn conductor_color(
        &mut self,
        params: &Params,
        [eta, k]: [&'static str; 2],
    ) -> Result<ConductorColor> {
        if params.has("reflectance") {
            if params.has(eta) || params.has(k) {
                return params.param_place("reflectance").invalid(format!(
                    "both `reflectance` and `{eta}` or `{k}`; allowed: one of the two ways"
                ));
            }
            return Ok(ConductorColor::Reflectance(self.color(
                params,
                "reflectance",
                Vec3::ONE,
                Role::Albedo,
            )?));
        }
        let (copper_eta, copper_k) = spectrum::copper();
        let eta = self.color(params, eta, copper_eta, Role::Index)?;
        Ok(ConductorColor::Complex { eta, k: self.color(params, k, copper_k, Role::Index)? })
    }

    fn roughness(&mut self, params: &Params, prefix: &str) -> Result<Roughness> {
        let [both, u, v] = match prefix {
            "" => ["roughness", "uroughness", "vroughness"],
            _ => ["conductor.roughness", "conductor.uroughness", "conductor.vroughness"],
        };
        let mut read = |name: &'static str, default: Scalar| -> Result<Scalar> {
            if !params.has(name) {
                return Ok(default);
            }
            let scalar = self.scalar(params, name, 0.0)?;
            match scalar {
                Scalar::Constant(value) if !(0.0..=1.0).contains(&value) => params
                    .param_place(name)
                    .invalid(format!("`{name}` is {value}; allowed: 0 to 1")),
                scalar => Ok(scalar),
            }
        };
        let both = read(both, Scalar::Constant(0.0))?;
        let (u, v) = (read(u, both)?, read(v, both)?);
        Ok(Roughness { u, v, remap: params.bool_or("remaproughness", true)? })
    }

    /// One index of refraction: any number or unbounded spectrum.
    fn index(&mut self, params: &Params) -> Result<f32> {
        let eta = match params.typed("eta", &[Type::Float, Type::Rgb, Type::Spectrum])? {
            None => 1.5,
            Some(param) if param.kind == Type::Float => param.single()?.numbers()[0],
            Some(param) => {
                let Index { at_d, varies } = spectrum::index_at_d(param)?;
                if varies {
                    self.warnings.add(format!(
                        "{}: `eta` is taken as {at_d}, its value at 587.6 nm: there is no dispersion",
                        param.place
                    ));
                }
                at_d
            }
        };
        if eta > 0.0 {
            Ok(eta as f32)
        } else {
            params.param_place("eta").invalid(format!("`eta` is {eta}; allowed: more than 0"))
        }
    }

    fn mix(&mut self, params: &Params) -> Result<Material> {
        let place = params.param_place("materials").clone();
        let names = match params.typed("materials", &[Type::String])?.map(|p| &p.values) {
            Some(super::params::Values::Strings(names)) if names.len() == 2 => names.clone(),
            _ => return place.invalid("mix without two `materials`; allowed: \"string materials\" [ \"first\" \"second\" ]"),
        };
        let mut ids = [MaterialId(0); 2];
        for (id, name) in ids.iter_mut().zip(&names) {
            *id = match self.named_material(name, &place)? {
                Surface::Material(id)
                    if matches!(self.scene.materials[id.index()], Material::Mix { .. }) =>
                {
                    return place.unsupported(format!(
                        "\"{}\" is itself a mix; allowed: any other material",
                        shorten(name)
                    ));
                }
                Surface::Material(id) => id,
                Surface::Default => self.default_material(),
                Surface::Interface => {
                    return place.unsupported(format!(
                        "\"{}\" is an interface; allowed: a material that scatters",
                        shorten(name)
                    ));
                }
            };
        }
        let amount = self.scalar(params, "amount", 0.5)?;
        if let Scalar::Constant(value) = amount
            && !(0.0..=1.0).contains(&value)
        {
            return params
                .param_place("amount")
                .invalid(format!("`amount` is {value}; allowed: 0 to 1"));
        }
        Ok(Material::Mix { first: ids[0], second: ids[1], amount })
    }
}
