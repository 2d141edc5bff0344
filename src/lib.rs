//! Light transport with reused light samples: real-time methods behind one set of traits, run in
//! one frame loop, and measured against each other and against path tracing.
//!
//! A scene file or a host's own data becomes a [`scene::Scene`]; [`frame::Stage`] makes it ready
//! for rays; [`frame::FrameLoop`] renders it frame after frame with any [`techniques::Technique`]:
//! `nee` (path tracing with light sampling, the reference), `bsdf`, `ris` and `restir-di` (direct
//! light by resampling, without and with reuse).
//!
//! | module | holds |
//! |---|---|
//! | [`scene`] | shapes, materials, textures, lights, camera, motion; validation; loaders of pbrt-v4 and glTF (feature `load`); generated scenes |
//! | [`accel`] | which surface a ray meets: builders, traversal, primitive tests |
//! | [`surface`] | what a surface does with light: lobes with value, density, sample, inverse |
//! | [`light`] | emitters in one table: choice, points on them, densities |
//! | [`world`] | a scene at one time, ready for rays |
//! | [`path`] | the walk from the camera, multiple importance sampling, counters |
//! | [`reuse`] | the passes of reuse for any kind of sample, with visibility policies; light points as the first |
//! | [`resampling`] | the core of reuse, for any renderer: reservoirs, shift maps, MIS weights, merges, mutations, estimators |
//! | [`plan`] | what a scene contains, and what a technique will therefore run and leave out |
//! | [`twin`] | kernels for graphics processors as plain data |
//! | [`techniques`] | the methods under comparison and their registry |
//! | [`frame`] | the loop: time, buffers, history, passes; guides (albedo, normal, depth, motion) |
//! | `gpu` | a graphics processor: adapters, kernels, the scene in its memory (feature `gpu`, on by default) |
//! | [`stats`] | is a mean right? Tests with stated α and power, for any sampler |
//! | [`metrics`] | how large is the error? Of one picture against another |
//! | [`math`] | warps, random numbers, frames |
//! | [`picture`], [`error`] | a picture of radiance; the one error type |
//! | `experiment` | comparison at equal time, tests of means, ladders, lag, without a command line (feature `experiment`) |
//! | `report` | files, tables, plots, references on disk (feature `experiment`) |
//! | `cli` | the `afterimage` command (feature `cli`, on by default) |
//!
//! Without default features the crate is the library alone: no loaders, no command.
//!
//! # Example
//!
//! ```
//! use std::sync::Arc;
//!
//! use afterimage::frame::{FrameLoop, Stage};
//! use afterimage::plan::{Filter, Shot};
//! use afterimage::scene::{Camera, Color, Geometry, Material, Scene, Shape, Transform};
//! use afterimage::techniques::parse;
//! use glam::{Affine3A, Vec3};
//!
//! // A grey disk as floor, and a ball lamp two metres above it.
//! let mut scene = Scene::new("lamp");
//! let grey = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5)) });
//! let floor = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Y, radius: 2.0 };
//! let lamp = Geometry::Sphere { center: Vec3::new(0.0, 2.0, 0.0), radius: 0.1 };
//! scene.add_shape(Shape::new(floor, grey));
//! scene.add_shape(Shape::new(lamp, grey).emitting(Vec3::splat(100.0)));
//!
//! // One metre above the floor, looking straight down (camera space: x right, y up, z forward).
//! let down = Affine3A::from_cols(Vec3::X.into(), Vec3::Z.into(), Vec3::NEG_Y.into(), Vec3::Y.into());
//! scene.camera = Camera { to_world: Transform::Fixed(down), fov: 0.2 };
//!
//! // The scene made ready for rays, a technique by name, and the loop that runs it.
//! let stage = Stage::new(scene)?;
//! let shot = Shot { size: [32, 32], depth: 2, filter: Filter::Box, run: 1, effort: 4.0, fps: 30 };
//! let mut frames = FrameLoop::new(Arc::from(parse("nee")?), &stage, shot)?;
//! let mut mean = 0.0;
//! for _ in 0..8 {
//!     let frame = frames.render()?;
//!     mean += frame.picture().mean_luminance() / 8.0;
//! }
//!
//! // A ball of radius r and radiance L at distance d gives π L (r / d)² = 0.785; the floor reflects 0.5 / π of it.
//! assert!((mean / 0.125 - 1.0).abs() < 0.02, "mean luminance {mean}");
//! # Ok::<(), afterimage::Error>(())
//! ```
//!
//! The pages in `docs/` say more: architecture, notation, scenes, the path tracer, resampling,
//! restir-di, visibility, metrics, results, testing.

pub mod accel;
#[cfg(feature = "cli")]
pub mod cli;
pub mod counters;
pub mod error;
#[cfg(feature = "experiment")]
pub mod experiment;
pub mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod light;
pub mod math;
pub mod metrics;
pub mod pass;
pub mod path;
pub mod picture;
pub mod plan;
#[cfg(feature = "experiment")]
pub mod report;
pub mod resampling;
pub mod reuse;
pub mod scene;
pub mod spec;
pub mod stats;
pub mod surface;
pub mod techniques;
pub mod twin;
pub mod world;

pub use error::{Error, Result};

/// The README's examples, as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
