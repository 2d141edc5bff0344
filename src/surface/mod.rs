//! Surfaces: what is placed where, and how it scatters.

pub mod bsdf;
pub mod material;
mod point;
mod shapes;

pub use point::SurfacePoint;
pub use shapes::{AlphaMask, ShapeInfo, placed_shapes};
