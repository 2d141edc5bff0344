//! Spectra to linear RGB (Rec. 709 primaries, D65 white). `docs/scenes.md` states what each
//! conversion keeps.
//!
//! Colour matching functions: the multi-lobe fit of Wyman, Sloan and Shirley 2013, equation 4 (CIE
//! 1931, 2°), summed every nanometre from 360 to 830 nm. Metals: Mitsuba 3.9.1's RGB values of the
//! same measured data, so that both renderers see the same metal.

use glam::{DMat3, DVec3, Vec3};

use super::lexer::shorten;
use super::params::{Param, Type, Values};
use crate::error::{Result, suggest};

/// What a spectrum describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Emission: an RGB triple is kept, any other spectrum gets luminance 1 (as in pbrt-v4).
    Emission,
    /// A share of light in [0, 1]; zero outside of the listed wavelengths.
    Albedo,
    /// A refractive or absorption index, not negative; the end values go on outside.
    Index,
}

/// Names of metals with η and k in RGB.
const METALS: [(&str, [f32; 3], [f32; 3]); 6] = [
    ("Ag", [0.155, 0.117, 0.138], [4.83, 3.12, 2.15]),
    ("Al", [1.6575, 0.880_405, 0.521_244], [9.22381, 6.2695, 4.837]),
    ("Au", [0.143_036, 0.375_307, 1.44205], [3.983, 2.38556, 1.60336]),
    ("Cu", [0.201_005, 0.92375, 1.10222], [3.91326, 2.45305, 2.14209]),
    ("MgO", [2.08958, 1.65072, 1.59488], [0.0, 0.0, 0.0]),
    ("TiO2", [3.45661, 2.80174, 2.90517], [0.000_105_265, 0.0, 0.000_652_887]),
];

/// Names of glasses with their index at 587.6 nm, interpolated in pbrt-v4's tables (of
/// refractiveindex.info).
const GLASSES: [(&str, f64); 7] = [
    ("glass-BK7", 1.516_801),
    ("glass-BAF10", 1.669_999),
    ("glass-FK51A", 1.486_558),
    ("glass-LASF9", 1.850_263),
    ("glass-F5", 1.672_718),
    ("glass-F10", 1.728_279),
    ("glass-F11", 1.784_737),
];

/// Names of all spectra that are known, for messages.
fn known(role: Role) -> Vec<String> {
    match role {
        Role::Emission => vec!["stdillum-D65".into(), "stdillum-A".into()],
        Role::Albedo => Vec::new(),
        Role::Index => METALS
            .iter()
            .flat_map(|(m, ..)| [format!("metal-{m}-eta"), format!("metal-{m}-k")])
            .collect(),
    }
}

/// η and k of copper, pbrt's default metal.
pub(super) fn copper() -> (Vec3, Vec3) {
    let (_, eta, k) = METALS[3];
    (eta.into(), k.into())
}

/// The RGB value of an `rgb`, `spectrum`, `blackbody` or `float` parameter.
pub(super) fn rgb(param: &Param, role: Role) -> Result<Vec3> {
    let value = match (param.kind, &param.values) {
        (Type::Rgb, _) => DVec3::from_slice(param.single()?.numbers()),
        (Type::Float, _) => DVec3::splat(param.single()?.numbers()[0]),
        (Type::Blackbody, _) => {
            let kelvin = param.single()?.numbers()[0];
            if kelvin <= 0.0 {
                return param
                    .place
                    .invalid(format!("`{}` is {kelvin} kelvin; allowed: more than 0", param.name));
            }
            if role != Role::Emission {
                let message =
                    format!("`{}` is a blackbody; allowed: rgb, spectrum, texture", param.name);
                return param.place.unsupported(message);
            }
            emission_rgb(|nm| blackbody(nm, kelvin))
        }
        (Type::Spectrum, Values::Strings(_)) => return named(param, role),
        (Type::Spectrum, _) => from_list(param, role)?,
        _ => {
            let message = format!(
                "`{}` is a `{}`; allowed: rgb, spectrum, blackbody",
                param.name,
                param.kind.name()
            );
            return param.place.invalid(message);
        }
    };
    let (allowed, fits) = match role {
        Role::Albedo => ("0 to 1", value.min_element() >= 0.0 && value.max_element() <= 1.0),
        Role::Emission | Role::Index => ("0 or more", value.min_element() >= 0.0),
    };
    let value = value.as_vec3();
    if fits && value.is_finite() {
        return Ok(value);
    }
    param.place.invalid(format!("`{}` is {value}; allowed in each channel: {allowed}", param.name))
}

/// An index of refraction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Index {
    /// At the sodium line's neighbour d (587.6 nm), where glass makers state it.
    pub(super) at_d: f64,
    /// Whether other wavelengths have another one.
    pub(super) varies: bool,
}

/// The index of refraction that an `rgb` or `spectrum` parameter stands for.
pub(super) fn index_at_d(param: &Param) -> Result<Index> {
    let of_rgb = |rgb: Vec3| Index {
        // Red and green as the primaries' wavelengths, 611 and 549 nm, lie around 587.6 nm.
        at_d: f64::from(rgb.x) + (587.6 - 611.0) / (549.0 - 611.0) * f64::from(rgb.y - rgb.x),
        varies: rgb != Vec3::splat(rgb.x),
    };
    if param.kind == Type::Rgb {
        return Ok(of_rgb(rgb(param, Role::Index)?));
    }
    match &param.values {
        Values::Numbers(_) => {
            let list = List::new(param)?;
            let varies = list.0.chunks_exact(2).any(|pair| pair[1] != list.0[1]);
            Ok(Index { at_d: list.at(587.6, true), varies })
        }
        _ => {
            let name = param.text()?;
            if let Some((_, eta)) = GLASSES.iter().find(|(glass, _)| *glass == name) {
                return Ok(Index { at_d: *eta, varies: true });
            }
            if name.starts_with("metal-") {
                return Ok(of_rgb(named(param, Role::Index)?));
            }
            let known = suggest(&shorten(name), &GLASSES.map(|(glass, _)| glass));
            param.place.unsupported(format!(
                "`{}` names the spectrum \"{}\"; {known}",
                param.name,
                shorten(name)
            ))
        }
    }
}

fn named(param: &Param, role: Role) -> Result<Vec3> {
    let name = param.text()?;
    match (role, name) {
        (Role::Emission, "stdillum-D65") => return Ok(Vec3::ONE),
        (Role::Emission, "stdillum-A") => {
            return Ok(emission_rgb(|nm| blackbody(nm, 2856.0)).as_vec3());
        }
        _ => {}
    }
    if role == Role::Index
        && let Some(rest) = name.strip_prefix("metal-")
        && let Some((metal, part)) = rest.rsplit_once('-')
        && let Some((_, eta, k)) = METALS.iter().find(|(m, ..)| *m == metal)
    {
        match part {
            "eta" => return Ok((*eta).into()),
            "k" => return Ok((*k).into()),
            _ => {}
        }
    }
    let known = known(role);
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let known = if known.is_empty() {
        "allowed: an rgb, a list of wavelengths and values, a texture".to_string()
    } else {
        suggest(&shorten(name), &known)
    };
    param.place.unsupported(format!(
        "`{}` names the spectrum \"{}\"; {known}",
        param.name,
        shorten(name)
    ))
}

fn from_list(param: &Param, role: Role) -> Result<DVec3> {
    let list = List::new(param)?;
    Ok(match role {
        Role::Emission => emission_rgb(|nm| list.at(nm, false)),
        Role::Albedo => weighted_rgb(|nm| list.at(nm, false)).clamp(DVec3::ZERO, DVec3::ONE),
        Role::Index => weighted_rgb(|nm| list.at(nm, true)).max(DVec3::ZERO),
    })
}

/// Wavelengths in nanometres with values, linear between them.
struct List<'p>(&'p [f64]);

impl<'p> List<'p> {
    fn new(param: &'p Param) -> Result<Self> {
        let list = param.numbers();
        let increasing =
            list.chunks_exact(2).zip(list.chunks_exact(2).skip(1)).all(|(a, b)| a[0] < b[0]);
        let positive = list.chunks_exact(2).all(|pair| pair[1] >= 0.0);
        if list.is_empty() || list.len() % 2 == 1 || !increasing || !positive {
            let message = format!(
                "`{}` is no list of wavelengths with values; allowed: pairs of increasing nanometres and values of 0 or more",
                param.name
            );
            return param.place.invalid(message);
        }
        Ok(Self(list))
    }

    fn at(&self, nm: f64, extend: bool) -> f64 {
        let count = self.0.len() / 2;
        let pair = |i: usize| (self.0[2 * i], self.0[2 * i + 1]);
        let next = self.0.chunks_exact(2).take_while(|pair| pair[0] <= nm).count();
        if next == 0 {
            return if extend { pair(0).1 } else { 0.0 };
        }
        let (x0, y0) = pair(next - 1);
        if next == count {
            return if extend || x0 == nm { y0 } else { 0.0 };
        }
        let (x1, y1) = pair(next);
        y0 + (y1 - y0) * (nm - x0) / (x1 - x0)
    }
}

/// CIE 1931 x̄, ȳ, z̄ at a wavelength in nanometres (Wyman et al. 2013, equation 4).
fn matching(nm: f64) -> DVec3 {
    let lobe = |height: f64, centre: f64, below: f64, above: f64| {
        let t = (nm - centre) / if nm < centre { below } else { above };
        height * (-0.5 * t * t).exp()
    };
    DVec3::new(
        lobe(1.056, 599.8, 37.9, 31.0)
            + lobe(0.362, 442.0, 16.0, 26.7)
            + lobe(-0.065, 501.1, 20.4, 26.2),
        lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
        lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
    )
}

/// XYZ to linear Rec. 709 (IEC 61966-2-1).
const XYZ_TO_RGB: DMat3 = DMat3::from_cols(
    DVec3::new(3.240_625_5, -0.968_930_7, 0.055_710_1),
    DVec3::new(-1.537_208, 1.875_756_1, -0.204_021_1),
    DVec3::new(-0.498_628_6, 0.041_517_5, 1.056_995_9),
);

fn integrate(spectrum: impl Fn(f64) -> f64) -> DVec3 {
    (360..=830).map(|nm| matching(f64::from(nm)) * spectrum(f64::from(nm))).sum()
}

/// Chromaticity of an emission at luminance 1; colours outside the gamut lose their negative part.
fn emission_rgb(spectrum: impl Fn(f64) -> f64) -> DVec3 {
    let xyz = integrate(spectrum);
    if xyz.y > 0.0 && xyz.is_finite() {
        (XYZ_TO_RGB * (xyz / xyz.y)).max(DVec3::ZERO)
    } else {
        DVec3::ZERO
    }
}

/// Seen under a blackbody of 6504 K (close to D65) relative to a white surface: a flat spectrum
/// stays flat.
fn weighted_rgb(spectrum: impl Fn(f64) -> f64) -> DVec3 {
    let light = |nm: f64| blackbody(nm, 6504.0);
    let white = XYZ_TO_RGB * integrate(light);
    XYZ_TO_RGB * integrate(|nm| light(nm) * spectrum(nm)) / white
}

/// Planck's law relative to its value at 560 nm.
fn blackbody(nm: f64, kelvin: f64) -> f64 {
    // h c / k_B in nm K (CODATA 2018, exact).
    const SECOND_RADIATION: f64 = 1.438_776_877e7;
    let exponent = |nm: f64| SECOND_RADIATION / (nm * kelvin);
    // exp(a) − 1 over exp(b) − 1 without overflow for low temperatures.
    let ratio = (exponent(560.0) - exponent(nm)).exp() * (-exponent(560.0)).exp_m1()
        / (-exponent(nm)).exp_m1();
    (560.0 / nm).powi(5) * ratio
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blackbody_chromaticities() {
        // CIE 1931 chromaticity of Planckian radiators: 2856 K is (0.4476, 0.4074), 6500 K (0.3135,
        // 0.3237) (CIE 15).
        for (kelvin, x, y) in [(2856.0, 0.4476, 0.4074), (6500.0, 0.3135, 0.3237)] {
            let xyz = integrate(|nm| blackbody(nm, kelvin));
            let sum = xyz.x + xyz.y + xyz.z;
            assert!(
                (xyz.x / sum - x).abs() < 4e-3 && (xyz.y / sum - y).abs() < 4e-3,
                "{kelvin}: {}",
                xyz / sum
            );
        }
        let warm = emission_rgb(|nm| blackbody(nm, 2700.0));
        assert!(warm.x > warm.y && warm.y > warm.z, "{warm}");
        assert!((warm.dot(DVec3::new(0.2126, 0.7152, 0.0722)) - 1.0).abs() < 1e-3, "{warm}");
        assert!(emission_rgb(|nm| blackbody(nm, 1.0)).is_finite());
    }

    #[test]
    fn flat_stays_flat() {
        assert!((weighted_rgb(|_| 0.7) - 0.7).abs().max_element() < 1e-12);
        let red = weighted_rgb(|nm| if nm > 600.0 { 1.0 } else { 0.0 });
        assert!(red.x > 0.7 && red.y < 0.1 && red.z.abs() < 0.05, "{red}");
    }
}
