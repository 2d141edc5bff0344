//! Statistics for testing samplers and pictures; users may test their own samplers with it.
//!
//! | question | here |
//! |---|---|
//! | do samples follow their pdf? | [`check_sphere`], [`check_square`], [`chi_square`] |
//! | is a mean right? | [`t_test`], [`welch`], [`equivalence`] with its three-way [`Verdict`] |
//! | many tests at once? | [`holm`], [`sidak`], [`benjamini_hochberg`], [`two_stage`] |
//! | same distribution? | [`ks_uniform`], [`ks_two_sample`] |
//! | is a picture right? | [`Restarts::compare`] with a [`Truth`]: image, tiles, pixels |
//! | is it surely right in every part and age? | [`Restarts::parts`] judged by [`agreement`]: intersection-union and Holm |
//! | is an expectation exactly right? | [`enumerate`], [`expectation`]: every outcome, exact probabilities; [`enumerate_f64`] for weights in `f32` |
//! | how many samples? | [`samples_for_bias`], [`detectable_bias`] |
//!
//! All sums are f64; all tail probabilities are survival functions, never 1 − cdf.

mod agreement;
mod chi_square;
mod enumerate;
mod mean;
mod moments;
mod multiple;
mod picture;

pub use agreement::{Agreement, Part, Place, Quantity, Tolerance, agreement};
pub use chi_square::{ChiSquare, DensityCheck, Grid, check_sphere, check_square, chi_square};
pub use enumerate::{
    Enumerator, Outcome, Probability, Rational, enumerate, enumerate_f64, enumerate_stratified,
    expectation,
};
pub use mean::{Equivalence, Estimate, Margin, MeanTest, Verdict, equivalence, t_test, welch};
pub use moments::{Moments, batch_means};
pub use multiple::{
    KolmogorovSmirnov, TwoStage, benjamini_hochberg, detectable_bias, holm, ks_two_sample,
    ks_uniform, samples_for_bias, sidak, sidak_p, two_stage,
};
pub use picture::{Criteria, PictureTest, Restarts, TileTest, Truth};
