//! How surfaces scatter light, as a scene file says it.

use super::{Color, MaterialId, Scalar};

/// A surface's scattering, before textures are looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Material {
    /// Lambert reflection on the side the light comes from, on both sides of the surface.
    Diffuse {
        /// Albedo in [0, 1].
        reflectance: Color,
    },
    /// Lambert reflection and transmission.
    DiffuseTransmission {
        /// Albedo of reflection.
        reflectance: Color,
        /// Albedo of transmission; per channel their sum is at most 1.
        transmittance: Color,
    },
    /// A metal: GGX microfacets (Smith, height-correlated) with the exact conductor Fresnel term;
    /// both sides.
    Conductor {
        /// Its colour.
        color: ConductorColor,
        /// Of its microfacets.
        roughness: Roughness,
    },
    /// Glass: reflection and refraction by GGX microfacets; a delta where smooth. The inside is
    /// where the normal does not point.
    Dielectric {
        /// Index of refraction, inside over outside; positive.
        eta: f32,
        /// Of its microfacets.
        roughness: Roughness,
    },
    /// A thin pane: straight through or mirrored, with all inner reflections summed.
    ThinDielectric {
        /// Index of refraction of the pane.
        eta: f32,
    },
    /// Lambert under a dielectric coat (an analytic plastic; deviates from pbrt's layered walk, see
    /// `docs/`).
    CoatedDiffuse {
        /// Albedo of the base.
        reflectance: Color,
        /// Index of refraction of the coat, over 1.
        eta: f32,
        /// Of the coat's microfacets.
        roughness: Roughness,
    },
    /// glTF 2.0's metallic-roughness surface with `KHR_materials_ior`, `_specular`,
    /// `_transmission`.
    MetallicRoughness {
        /// Albedo of the dielectric part, F₀ of the metallic part.
        base_color: Color,
        /// 0 dielectric, 1 metal.
        metallic: Scalar,
        /// Perceptual: α = roughness².
        roughness: Scalar,
        /// Index of refraction of the dielectric part.
        ior: f32,
        /// Strength of the dielectric's specular reflection.
        specular: Scalar,
        /// Tint of the dielectric's F₀.
        specular_color: Color,
        /// Share of the dielectric's diffuse part that goes straight through (thin-walled).
        transmission: Scalar,
        /// Whether the back reflects too. If not, it is black, and camera rays pass it: light is
        /// stopped by it, pictures are not.
        double_sided: bool,
    },
    /// The weighted union of two materials' lobes; neither may be a mix.
    Mix {
        /// Weight 1 − amount.
        first: MaterialId,
        /// Weight amount.
        second: MaterialId,
        /// In [0, 1].
        amount: Scalar,
    },
}

/// The Fresnel colour of a conductor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ConductorColor {
    /// Complex index of refraction η + i k, per channel.
    Complex {
        /// Real part.
        eta: Color,
        /// Imaginary part.
        k: Color,
    },
    /// Reflectance at normal incidence: η = 1, k = 2 √r / √(1 − r), as pbrt-v4 defines it.
    Reflectance(Color),
}

/// Roughness of a microfacet surface along both tangents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roughness {
    /// Along u; 0 is a perfect mirror.
    pub u: Scalar,
    /// Along v.
    pub v: Scalar,
    /// Whether α = √roughness (pbrt's remapping) instead of α = roughness.
    pub remap: bool,
}

impl Roughness {
    /// A perfectly smooth surface.
    pub const SMOOTH: Self =
        Self { u: Scalar::Constant(0.0), v: Scalar::Constant(0.0), remap: false };

    /// The same α in both directions.
    #[must_use]
    pub const fn isotropic(alpha: f32) -> Self {
        Self { u: Scalar::Constant(alpha), v: Scalar::Constant(alpha), remap: false }
    }
}
