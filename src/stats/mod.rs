//! Statistics for testing samplers and pictures; users may test their own samplers with it.
//!
//! | question | here |
//! |---|---|
//! | do samples follow their pdf? | [`check_sphere`], [`check_square`], [`chi_square`] |
//!
//! All sums are f64; all tail probabilities are survival functions, never 1 − cdf.

mod chi_square;

pub use chi_square::{ChiSquare, DensityCheck, Grid, check_sphere, check_square, chi_square};
