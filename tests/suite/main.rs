//! The integration tests: one binary, one module a question. Statistical tests state their α and
//! what they can detect; each has a control that must fail.

mod cases;
#[cfg(feature = "cli")]
mod cli;
mod course;
mod determinism;
mod elision;
mod exchange;
#[cfg(feature = "experiment")]
mod figures;
#[cfg(all(feature = "gpu", feature = "load"))]
mod gpu;
mod guides;
mod hazards;
#[cfg(feature = "experiment")]
mod kept;
mod lamps;
mod laws;
mod layering;
mod learn;
mod loaders;
mod matrix;
mod metamorphic;
mod mutants;
mod mutations;
mod oracles;
#[cfg(feature = "experiment")]
mod outside;
mod paths;
mod paths_exact;
mod paths_moved;
mod paths_mutated;
#[cfg(feature = "cli")]
mod peer;
mod planted;
mod planted_reuse;
mod references;
mod reuse;
mod statements;
mod stored;
mod stress;
mod style;
mod support;
mod tiles;
mod union;
