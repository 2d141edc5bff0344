//! Real-time light-sample reuse behind one set of traits.

pub mod accel;
#[cfg(feature = "cli")]
pub mod cli;
pub mod error;
pub mod frame;
pub mod light;
pub mod math;
pub mod metrics;
pub mod path;
pub mod picture;
pub mod plan;
#[cfg(feature = "cli")]
pub mod report;
pub mod scene;
pub mod stats;
pub mod surface;
pub mod techniques;
pub mod world;

pub use error::{Error, Result};
