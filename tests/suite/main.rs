//! The integration tests: one binary, one module a question. Statistical tests state their α and what they can detect; each has a
//! control that must fail.

#[cfg(feature = "cli")]
mod cli;
mod layering;
mod loaders;
mod references;
mod stress;
#[expect(dead_code, reason = "used by modules as they land")]
mod support;
