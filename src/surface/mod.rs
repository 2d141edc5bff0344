//! Surfaces: how they scatter.

pub mod bsdf;
pub mod material;
