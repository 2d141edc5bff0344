//! Lights without a surface.

use glam::Vec3;

use super::{ImageId, Transform};

/// A point, spot, distant or environment light.
#[derive(Clone, Debug)]
pub struct Light {
    /// Light space to world.
    pub to_world: Transform,
    /// What it emits, in light space.
    pub kind: LightKind,
    /// Stable identity over frames; unique among the scene's lights.
    pub key: u64,
}

/// The kinds of [`Light`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// At the origin of light space.
    Point {
        /// Radiant intensity in W·sr⁻¹.
        intensity: Vec3,
    },
    /// At the origin, along +z.
    Spot {
        /// On the axis, in W·sr⁻¹.
        intensity: Vec3,
        /// Cosine of the angle where the falloff begins; at least `cos_outer`.
        cos_inner: f32,
        /// Cosine of the angle beyond which nothing is emitted.
        cos_outer: f32,
        /// Between the two.
        falloff: SpotFalloff,
    },
    /// Parallel light that travels along +z of light space.
    Distant {
        /// On a surface that faces the light, in W·m⁻².
        irradiance: Vec3,
    },
    /// From everywhere at infinity.
    Environment {
        /// Radiance, or the factor on the image.
        radiance: Vec3,
        /// Over the whole sphere; `None`: constant.
        image: Option<(ImageId, EnvironmentMapping)>,
    },
}

/// How a spot light fades between its inner and outer cone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpotFalloff {
    /// `3 s² − 2 s³` of the cosine's position s between the two (pbrt-v4).
    Smoothstep,
    /// `s²` (glTF `KHR_lights_punctual`).
    Quadratic,
}

/// How an environment image covers the sphere, in light space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnvironmentMapping {
    /// Rows are polar angle from +z, columns azimuth from +x towards +y. Pixel (u, v): φ = 2π u,
    /// θ = π v.
    LatitudeLongitude,
    /// Square, equal-area octahedral (Clarberg 2008; pbrt-v4).
    EqualAreaOctahedral,
}
