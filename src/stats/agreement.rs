//! Is a picture right wherever one looks? Every part must be shown to be equivalent; any part may
//! be shown to differ.
//!
//! A [`Part`] is one mean that is compared: a quantity (luminance, red, green, blue) of the image
//! or of a tile, at one age. Two questions are asked of all parts together, and they need different
//! corrections.
//!
//! *Pass* says "all parts lie within their margins". It errs if at least one part does not, and
//! then that part's own test must have erred: P(all tests reject) ≤ P(the test of that one part
//! rejects) ≤ α. This is an intersection-union test (Berger 1982); every part is tested at α
//! itself, under any dependence. Dividing α by the number of parts would only cost power.
//!
//! *Fail* says "some part differs". It errs if any of many tests of equal means rejects, so chances
//! add up: Holm (1979) over all parts, under any dependence.

use super::{Margin, MeanTest, Verdict, equivalence, holm};

/// How far a picture may be from the truth, and how sure a verdict must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// δ of the image scale as a share of the image's mean.
    pub image: f64,
    /// δ of a tile as a share of the tile's mean.
    pub tile: f64,
    /// A tile's mean counts as at least this share of the image's: nobody needs a black tile to 1 %
    /// of its own light.
    pub tile_floor: f64,
    /// Probability to pass a picture of which any part is off by its margin or more.
    pub equivalence_alpha: f64,
    /// Probability to fail an unbiased picture.
    pub difference_alpha: f64,
}

impl Tolerance {
    /// δ for the image, 2 δ for tiles of at least a tenth of the image's mean; passes at 10⁻³,
    /// fails at 10⁻⁴.
    #[must_use]
    pub fn of(delta: f64) -> Self {
        Self {
            image: delta,
            tile: 2.0 * delta,
            tile_floor: 0.1,
            equivalence_alpha: 1e-3,
            difference_alpha: 1e-4,
        }
    }
}

/// Where a part lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The whole picture.
    Image,
    /// A tile, by its left column and upper row.
    Tile {
        /// Left column.
        x: usize,
        /// Upper row.
        y: usize,
    },
}

/// What is averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Rec. 709 luminance.
    Luminance,
}

/// One mean compared with the truth; made by [`super::Restarts::parts`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Where.
    pub place: Place,
    /// Of what.
    pub quantity: Quantity,
    /// The difference from the reference.
    pub test: MeanTest,
    /// What relative figures are shares of; a channel's is at least the luminance's, so that a dark
    /// channel need not be known more accurately than the picture.
    pub scale: f64,
    /// Share of `scale` that the bias may have.
    pub delta: f64,
}

impl Part {
    /// The bias as a share of [`scale`](Self::scale); 0 where both are black.
    #[must_use]
    pub fn relative(&self) -> f64 {
        if self.test.difference == 0.0 { 0.0 } else { self.test.difference / self.scale }
    }

    /// Student's interval of [`relative`](Self::relative).
    #[must_use]
    pub fn relative_interval(&self, confidence: f64) -> (f64, f64) {
        let (low, high) = self.test.interval(confidence);
        let share = |end: f64| if end == 0.0 { 0.0 } else { end / self.scale };
        (share(low), share(high))
    }

    /// How far the interval reaches, in margins: a pass means below 1. The worst part is the one
    /// that reaches farthest.
    #[must_use]
    pub fn reach(&self, confidence: f64) -> f64 {
        let (low, high) = self.relative_interval(confidence);
        let reach = low.abs().max(high.abs()) / self.delta;
        if reach.is_nan() { f64::INFINITY } else { reach }
    }
}

/// The outcome over all parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Fail if any part fails, pass if all pass.
    pub verdict: Verdict,
    /// One a part, in their order.
    pub parts: Vec<Verdict>,
}

/// Judges all parts together; see the module's head. A part
///
/// - fails where it is not finite, or where Holm's procedure finds that it differs and the
///   difference is above half its margin;
/// - passes where both one-sided tests at `equivalence_alpha` place it inside its margin;
/// - is undecided otherwise, and always where it is [too skewed](MeanTest::heavy_tailed) for
///   Student's law.
///
/// No parts at all decide nothing.
#[must_use]
pub fn agreement(parts: &[Part], tolerance: &Tolerance) -> Agreement {
    let p: Vec<f64> = parts.iter().map(|part| part.test.p).collect();
    let differs = holm(&p, tolerance.difference_alpha);
    let parts: Vec<Verdict> = parts
        .iter()
        .zip(differs)
        .map(|(part, differs)| {
            let margin = Margin {
                delta: part.delta * part.scale,
                equivalence_alpha: tolerance.equivalence_alpha,
                // Holm has decided: any p is small enough, or none is.
                difference_alpha: if differs { f64::INFINITY } else { 0.0 },
            };
            equivalence(&part.test, &margin).verdict
        })
        .collect();
    let verdict = parts.iter().copied().reduce(Verdict::and).unwrap_or(Verdict::Inconclusive);
    Agreement { verdict, parts }
}

#[cfg(test)]
mod tests {
    use super::super::{Estimate, Moments, welch};
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    /// A part of mean 1 that is `bias` off, with a standard error of `error`.
    fn part(bias: f64, error: f64) -> Part {
        let test =
            welch(&Estimate::with_variance(1.0 + bias, error * error, 1e6), &Estimate::exact(1.0));
        Part { place: Place::Image, quantity: Quantity::Luminance, test, scale: 1.0, delta: 0.005 }
    }

    fn verdict(parts: &[Part]) -> Verdict {
        agreement(parts, &Tolerance::of(0.005)).verdict
    }

    #[test]
    fn one_undecided_part_spoils_a_pass_and_one_certain_difference_fails() {
        // Normal law: z = 3.09 leaves 10⁻³. 0.5 % / 0.15 % = 3.33 passes, 0.5 % / 0.17 % = 2.94
        // does not.
        let good = part(0.0, 0.0015);
        assert_eq!(verdict(&[good; 100]), Verdict::Pass);
        let mut parts = vec![good; 99];
        parts.push(part(0.0, 0.0017));
        assert_eq!(verdict(&parts), Verdict::Inconclusive);
        parts.push(part(0.01, 0.0015));
        let found = agreement(&parts, &Tolerance::of(0.005));
        assert_eq!(found.verdict, Verdict::Fail);
        assert_eq!(&found.parts[98..], [Verdict::Pass, Verdict::Inconclusive, Verdict::Fail]);
    }

    #[test]
    fn holm_shares_the_level_of_a_fail_among_the_parts() {
        // p = 3·10⁻⁵ (z = 4.17) is certain alone at 10⁻⁴, but not among a hundred.
        let odd = part(4.17 * 0.002, 0.002);
        assert!((2.5e-5..3.5e-5).contains(&odd.test.p), "{}", odd.test.p);
        assert_eq!(verdict(&[odd]), Verdict::Fail);
        let mut parts = vec![part(0.0, 0.0015); 99];
        parts.push(odd);
        assert_eq!(verdict(&parts), Verdict::Inconclusive);
    }

    #[test]
    fn small_but_certain_differences_are_judged_by_the_margin() {
        assert_eq!(verdict(&[part(0.001, 1e-5)]), Verdict::Pass);
        assert_eq!(verdict(&[part(0.003, 1e-5)]), Verdict::Fail);
        assert_eq!(verdict(&[part(0.0, f64::INFINITY)]), Verdict::Inconclusive);
        assert_eq!(verdict(&[part(f64::NAN, 1e-5)]), Verdict::Fail);
        assert_eq!(verdict(&[]), Verdict::Inconclusive);
    }

    #[test]
    fn black_agrees_with_black_and_with_nothing_else() {
        let dark = |mean: f64| Part {
            test: welch(&Estimate::exact(mean), &Estimate::exact(0.0)),
            scale: 0.0,
            ..part(0.0, 0.0)
        };
        assert_eq!(verdict(&[dark(0.0)]), Verdict::Pass);
        assert_eq!(dark(0.0).relative(), 0.0);
        assert_eq!(verdict(&[dark(1e-30)]), Verdict::Fail);
    }

    #[test]
    fn error_rates_of_pass_and_fail_are_at_most_nominal() {
        // 4000 families of 10 parts of 20 normal samples each; 4.5 sigma of 200 of 4000 are 62.
        let mut stream = Stream::from_key(77);
        let mut normal = move || {
            let u = (f64::from(stream.word()) + 0.5) / 4_294_967_296.0;
            let v = f64::from(stream.uniform());
            (-2.0 * u.ln()).sqrt() * (2.0 * core::f64::consts::PI * v).cos()
        };
        let tolerance =
            Tolerance { equivalence_alpha: 0.05, difference_alpha: 0.05, ..Tolerance::of(1.0) };
        // Only the first part is off, by exactly its margin: passing is wrong in 5 % at most. The
        // others' margin is far away.
        let mut family = |bias: f64| {
            let parts: Vec<Part> = (0..10)
                .map(|at| {
                    let off = if at == 0 { bias } else { 0.0 };
                    let sample: Moments = (0..20).map(|_| off + normal()).collect();
                    Part {
                        test: welch(&sample.estimate(), &Estimate::exact(0.0)),
                        scale: 1.0,
                        delta: if at == 0 { 1.0 } else { 3.0 },
                        ..part(0.0, 0.0)
                    }
                })
                .collect();
            agreement(&parts, &tolerance).verdict
        };
        let passed = (0..4000).filter(|_| family(1.0) == Verdict::Pass).count();
        assert!((80..=262).contains(&passed), "{passed}");
        let failed = (0..4000).filter(|_| family(0.0) == Verdict::Fail).count();
        assert!(failed <= 262, "{failed}");
    }

    #[test]
    fn reach_is_in_margins() {
        let sharp = part(0.0025, 0.0);
        assert_eq!(sharp.relative_interval(0.98), (sharp.relative(), sharp.relative()));
        assert!((sharp.reach(0.98) - 0.5).abs() < 1e-12);
        assert!(part(0.0, f64::INFINITY).reach(0.98).is_infinite());
    }
}
