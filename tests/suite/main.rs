//! The integration tests: one binary, one module a question. Statistical tests state their α and
//! what they can detect; each has a control that must fail.

#[cfg(feature = "cli")]
mod cli;
mod determinism;
mod elision;
#[cfg(feature = "experiment")]
mod figures;
#[cfg(all(feature = "gpu", feature = "load"))]
mod gpu;
#[cfg(feature = "experiment")]
mod kept;
mod laws;
mod layering;
mod learn;
mod loaders;
mod metamorphic;
mod mutations;
mod oracles;
#[cfg(feature = "experiment")]
mod outside;
#[cfg(feature = "cli")]
mod peer;
mod planted;
mod planted_reuse;
mod references;
mod reuse;
mod stress;
mod style;
mod support;
mod tiles;
