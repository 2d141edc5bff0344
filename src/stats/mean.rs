//! Tests of means: is there a difference, and is it surely smaller than a margin?
//!
//! | symbol | meaning |
//! |---|---|
//! | b̂ | difference of two estimated means |
//! | SE, ν | its standard error and degrees of freedom |
//! | δ | margin of equivalence |
//!
//! "Not significant" is not evidence of equality: a test with too few samples is never significant.
//! So [`Equivalence`] has three outcomes. Papers: Welch 1947, Schuirmann 1987 (two one-sided
//! tests).

use core::fmt;

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// An estimated mean, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Variance of `mean` (not of one sample); infinite if unknown, 0 if the mean is exact.
    pub variance: f64,
    /// Degrees of freedom of `variance`; infinite if it is known exactly.
    pub dof: f64,
    /// Skewness of the distribution of `mean`: that of one sample divided by √n.
    pub skewness: f64,
    /// Standard deviation of `skewness` for normal samples, √6 / n.
    pub skewness_error: f64,
}

impl Estimate {
    /// An exactly known value: an analytic answer.
    #[must_use]
    pub const fn exact(mean: f64) -> Self {
        Self::with_variance(mean, 0.0, f64::INFINITY)
    }

    /// A stored mean with the variance of that mean and the variance's degrees of freedom; its
    /// skewness counts as 0.
    #[must_use]
    pub const fn with_variance(mean: f64, variance: f64, dof: f64) -> Self {
        Self { mean, variance, dof, skewness: 0.0, skewness_error: 0.0 }
    }

    /// Student's interval that covers the true mean with probability `confidence`.
    #[must_use]
    pub fn interval(&self, confidence: f64) -> (f64, f64) {
        interval(self.mean, self.variance.sqrt(), self.dof, confidence)
    }
}

/// The difference of two means and its significance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanTest {
    /// b̂: first mean minus second.
    pub difference: f64,
    /// SE: standard error of the difference.
    pub standard_error: f64,
    /// ν: degrees of freedom of the standard error (Welch and Satterthwaite).
    pub dof: f64,
    /// t = b̂ / SE.
    pub statistic: f64,
    /// Two-sided p of t under equal means. 1 where a variance is unknown, 0 where a mean is not
    /// finite.
    pub p: f64,
    /// Skewness of b̂; with equal counts that of two alike samplers cancels.
    pub skewness: f64,
    /// Standard deviation of `skewness` for normal samples.
    pub skewness_error: f64,
}

/// Whether two means differ, with variances that may differ: t = (x̄₁ − x̄₂) / √(v₁ + v₂) with v
/// the variances of the means and ν = (v₁ + v₂)² / (v₁²/ν₁ + v₂²/ν₂) (Welch 1947).
///
/// Serves samples ([`super::Moments::estimate`]), stored references with few degrees of freedom
/// ([`Estimate::with_variance`]) and known answers ([`Estimate::exact`], which makes it the
/// one-sample t test). Prefer equal sample counts for heavy-tailed samples: then the false-alarm
/// rate stays at or below nominal, while the one-sample test's can be a hundred times too high,
/// always towards "too dark".
#[must_use]
pub fn welch(a: &Estimate, b: &Estimate) -> MeanTest {
    let difference = a.mean - b.mean;
    let variance = a.variance + b.variance;
    let standard_error = variance.sqrt();
    let unscaled = a.skewness * a.variance.powf(1.5) - b.skewness * b.variance.powf(1.5);
    let error =
        (a.skewness_error * a.variance.powf(1.5)).hypot(b.skewness_error * b.variance.powf(1.5));
    let mut test = MeanTest {
        difference,
        standard_error,
        dof: f64::INFINITY,
        statistic: difference / standard_error,
        p: 0.0,
        skewness: 0.0,
        skewness_error: 0.0,
    };
    if !difference.is_finite() || variance.is_nan() {
        return test;
    }
    if variance == 0.0 {
        test.statistic = if difference == 0.0 { 0.0 } else { difference.signum() * f64::INFINITY };
        test.p = if difference == 0.0 { 1.0 } else { 0.0 };
    } else if variance.is_infinite() {
        test.dof = 1.0;
        test.p = 1.0;
    } else {
        // Shares, not squares: the square of a subnormal variance would vanish.
        let (share_a, share_b) = (a.variance / variance, b.variance / variance);
        test.dof = 1.0 / (share_a * share_a / a.dof + share_b * share_b / b.dof);
        test.p = 2.0 * t_sf(test.statistic.abs(), test.dof);
        test.skewness = unscaled / variance.powf(1.5);
        test.skewness_error = error / variance.powf(1.5);
    }
    test
}

/// Whether the true mean of a sample is `mean`: Student's t with n − 1 degrees of freedom.
#[must_use]
pub fn t_test(sample: &super::Moments, mean: f64) -> MeanTest {
    welch(&sample.estimate(), &Estimate::exact(mean))
}

impl MeanTest {
    /// Student's interval that covers the true difference with probability `confidence`.
    #[must_use]
    pub fn interval(&self, confidence: f64) -> (f64, f64) {
        interval(self.difference, self.standard_error, self.dof, confidence)
    }

    /// Whether the difference is too skewed for Student's law in its tails.
    ///
    /// An Edgeworth expansion puts the relative error of a tail probability near γ (2z² + 1) z / (6
    /// √n): n samples of skewness γ need n ≥ 400 γ² at α = 10⁻⁴, that is |γ of the mean| ≤ 1/20.
    /// Only what exceeds two standard deviations of the estimated skewness counts, or no set of
    /// fewer than a hundred restarts would ever decide.
    #[must_use]
    pub fn heavy_tailed(&self) -> bool {
        self.skewness.abs() > 0.05 + 2.0 * self.skewness_error
    }
}

/// The outcome of a test that can also fail to decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Shown to be equal within the margin.
    Pass,
    /// Shown to differ.
    Fail,
    /// Too little evidence for either: the test's budget is wrong.
    Inconclusive,
}

impl Verdict {
    /// `Fail` if either fails, else `Inconclusive` if either is.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Fail, _) | (_, Self::Fail) => Self::Fail,
            (Self::Inconclusive, _) | (_, Self::Inconclusive) => Self::Inconclusive,
            (Self::Pass, Self::Pass) => Self::Pass,
        }
    }

    /// `pass`, `fail` or `inconclusive`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::Inconclusive => "inconclusive",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Margin and error rates of an [`Equivalence`] test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// δ > 0, in the unit of the means.
    pub delta: f64,
    /// Probability of a pass at a true difference of ±δ; 0.01 is usual.
    pub equivalence_alpha: f64,
    /// Probability of a fail at equal means, after any correction for the number of tests.
    pub difference_alpha: f64,
}

/// The result of two one-sided tests against ±δ, with a third outcome.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equivalence {
    /// The outcome.
    pub verdict: Verdict,
    /// The difference and its significance.
    pub test: MeanTest,
    /// δ.
    pub delta: f64,
    /// The (1 − 2α) interval of the difference; a pass means that it lies within ±δ.
    pub interval: (f64, f64),
    /// The larger p of the two one-sided tests: the smallest α that would pass.
    pub p: f64,
}

/// Two one-sided t tests of |b| < δ (Schuirmann 1987), with a verdict:
///
/// - fail: b̂ differs from 0 at `difference_alpha`, and |b̂| > δ/2;
/// - pass: the (1 − 2α) interval of b̂ lies within ±δ;
/// - inconclusive: neither, or the difference is [heavy-tailed](MeanTest::heavy_tailed).
///
/// Where both of the first hold (a small but certain difference, beyond half the margin) it is a
/// fail. A mean that is not finite fails.
#[must_use]
pub fn equivalence(test: &MeanTest, margin: &Margin) -> Equivalence {
    let interval = test.interval(1.0 - 2.0 * margin.equivalence_alpha);
    let distance = margin.delta - test.difference.abs();
    let p = if test.difference.is_nan() || test.standard_error.is_nan() {
        1.0
    } else if test.standard_error == 0.0 {
        if distance > 0.0 || test.difference == 0.0 { 0.0 } else { 1.0 }
    } else {
        t_sf(distance / test.standard_error, test.dof)
    };
    let verdict = if !test.difference.is_finite() {
        Verdict::Fail
    } else if test.heavy_tailed() {
        Verdict::Inconclusive
    } else if test.p < margin.difference_alpha && test.difference.abs() > 0.5 * margin.delta {
        Verdict::Fail
    } else if p < margin.equivalence_alpha {
        Verdict::Pass
    } else {
        Verdict::Inconclusive
    };
    Equivalence { verdict, test: *test, delta: margin.delta, interval, p }
}

/// P(T > t) of Student's law; the normal law for infinite `dof`.
pub(crate) fn t_sf(t: f64, dof: f64) -> f64 {
    if t.is_infinite() {
        return if t > 0.0 { 0.0 } else { 1.0 };
    }
    if dof.is_infinite() {
        Normal::standard().sf(t)
    } else {
        StudentsT::new(0.0, 1.0, dof).map_or(f64::NAN, |law| law.sf(t))
    }
}

/// The value that Student's T exceeds with probability `tail` < 0.5.
fn t_quantile(tail: f64, dof: f64) -> f64 {
    // Bisection of the survival function: exact in the far tail, where inverting the cdf at 1 −
    // tail is not.
    let (mut low, mut high) = (0.0, 1.0);
    while t_sf(high, dof) > tail && high < f64::MAX / 4.0 {
        low = high;
        high *= 2.0;
    }
    while high - low > 1e-13 * high {
        let middle = 0.5 * (low + high);
        if t_sf(middle, dof) > tail { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

fn interval(mean: f64, standard_error: f64, dof: f64, confidence: f64) -> (f64, f64) {
    if standard_error == 0.0 || standard_error.is_infinite() {
        return (mean - standard_error, mean + standard_error);
    }
    let half = t_quantile(0.5 * (1.0 - confidence), dof) * standard_error;
    (mean - half, mean + half)
}

#[cfg(test)]
mod tests {
    use super::super::Moments;
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    const A: [f64; 8] = [19.8, 20.4, 19.6, 17.8, 18.5, 18.9, 18.3, 18.9];
    const B: [f64; 6] = [28.2, 26.6, 20.1, 23.3, 25.2, 22.1];

    fn of(samples: &[f64]) -> Estimate {
        samples.iter().copied().collect::<Moments>().estimate()
    }

    #[track_caller]
    fn near(value: f64, expected: f64) {
        assert!((value / expected - 1.0).abs() < 1e-9, "{value} instead of {expected}");
    }

    #[test]
    fn welch_and_student_match_scipy() {
        // SciPy 1.17: r = scipy.stats.ttest_ind(A, B, equal_var=False); r.statistic, r.df,
        // r.pvalue, r.confidence_interval(0.98)
        let test = welch(&of(&A), &of(&B));
        near(test.statistic, -4.150_809_781_272_934);
        near(test.dof, 5.620_522_689_260_925);
        near(test.p, 0.006_920_389_864_933_061);
        near(test.interval(0.98).0, -9.272_052_231_827_152);
        near(test.interval(0.98).1, -1.177_947_768_172_851_2);
        // scipy.stats.ttest_1samp(A, 20)
        let one = t_test(&A.into_iter().collect(), 20.0);
        near(one.statistic, -3.213_544_323_531_525);
        near(one.p, 0.014_785_188_720_593_636);
    }

    #[test]
    fn far_tails_match_scipy() {
        // SciPy 1.17: scipy.stats.t.sf(6.5, 15), t.sf(40, 15), norm.sf(10); t.isf(1e-7, 15),
        // t.isf(0.005, 3.5), norm.isf(1e-12).
        near(t_sf(6.5, 15.0), 5.015_192_559_730_179e-06);
        near(t_sf(40.0, 15.0), 5.845_330_620_433_193e-17);
        near(t_sf(10.0, f64::INFINITY), 7.619_853_024_160_47e-24);
        near(t_quantile(1e-7, 15.0), 8.986_321_108_522_462);
        near(t_quantile(0.005, 3.5), 5.085_702_223_091_258);
        near(t_quantile(1e-12, f64::INFINITY), 7.034_483_825_301_131);
    }

    #[test]
    fn degenerate_inputs_decide_nothing_or_fail() {
        let margin = Margin { delta: 1.0, equivalence_alpha: 0.01, difference_alpha: 1e-3 };
        let verdict = |a: Estimate, b: Estimate| equivalence(&welch(&a, &b), &margin).verdict;
        assert_eq!(verdict(Estimate::exact(1.0), Estimate::exact(1.0)), Verdict::Pass);
        assert_eq!(verdict(Estimate::exact(1.0), Estimate::exact(3.0)), Verdict::Fail);
        assert_eq!(verdict(of(&[1.0]), Estimate::exact(1.0)), Verdict::Inconclusive);
        assert_eq!(verdict(of(&[1.0, f64::NAN]), Estimate::exact(1.0)), Verdict::Fail);
        assert_eq!(verdict(of(&[1.0, f64::INFINITY]), Estimate::exact(1.0)), Verdict::Fail);
    }

    #[test]
    fn two_one_sided_tests_match_scipy() {
        // b = 0.2, SE = 0.1, nu = 15, delta = 0.5: max(p) = scipy.stats.t.sf(3, 15).
        let test = welch(&Estimate::with_variance(1.2, 0.01, 15.0), &Estimate::exact(1.0));
        let margin = Margin { delta: 0.5, equivalence_alpha: 0.01, difference_alpha: 1e-3 };
        let result = equivalence(&test, &margin);
        near(result.p, 0.004_486_368_738_611_663);
        assert_eq!(result.verdict, Verdict::Pass);
        assert!(result.interval.0 > -0.5 && result.interval.1 < 0.5);
        let narrow = equivalence(&test, &Margin { delta: 0.4, ..margin });
        assert_eq!(narrow.verdict, Verdict::Inconclusive);
        let far = welch(&Estimate::with_variance(2.0, 0.01, 15.0), &Estimate::exact(1.0));
        assert_eq!(equivalence(&far, &margin).verdict, Verdict::Fail);
    }

    #[test]
    fn a_certain_difference_beyond_half_the_margin_fails() {
        let margin = Margin { delta: 0.5, equivalence_alpha: 0.01, difference_alpha: 1e-3 };
        let of = |b| {
            let test = welch(&Estimate::with_variance(b, 1e-6, 50.0), &Estimate::exact(0.0));
            equivalence(&test, &margin).verdict
        };
        assert_eq!(of(0.3), Verdict::Fail);
        assert_eq!(of(0.2), Verdict::Pass);
    }

    #[test]
    fn false_alarms_of_welch_are_at_their_nominal_rate() {
        // 4000 tests of equal means, variances 1 : 9, counts 8 : 20, alpha 0.05: 200 +- 13.8, 4.5
        // sigma. The control treats t as normal.
        let mut stream = Stream::from_key(21);
        let mut normal = move || {
            let u = (f64::from(stream.word()) + 0.5) / 4_294_967_296.0;
            let v = f64::from(stream.uniform());
            (-2.0 * u.ln()).sqrt() * (2.0 * core::f64::consts::PI * v).cos()
        };
        let (mut rejected, mut as_normal) = (0, 0);
        for _ in 0..4000 {
            let a: Moments = (0..8).map(|_| 3.0 * normal()).collect();
            let b: Moments = (0..20).map(|_| normal()).collect();
            let test = welch(&a.estimate(), &b.estimate());
            rejected += i32::from(test.p < 0.05);
            as_normal += i32::from(test.statistic.abs() > 1.96);
        }
        assert!((138..=262).contains(&rejected), "{rejected}");
        assert!(as_normal > 262, "{as_normal}");
    }

    #[test]
    fn heavy_tails_are_inconclusive_alone_and_cancel_in_pairs() {
        // Log-normal, sigma = 2, n = 2000: skewness in the hundreds; an exact mean meets it as "too
        // dark" far too often.
        let mut stream = Stream::from_key(22);
        let mut sample = || -> Moments {
            (0..2000)
                .map(|_| {
                    let u = (f64::from(stream.word()) + 0.5) / 4_294_967_296.0;
                    let v = f64::from(stream.uniform());
                    let z = (-2.0 * u.ln()).sqrt() * (2.0 * core::f64::consts::PI * v).cos();
                    (2.0 * z).exp()
                })
                .collect()
        };
        let margin = Margin { delta: 1e9, equivalence_alpha: 0.01, difference_alpha: 1e-3 };
        let (a, b) = (sample(), sample());
        let alone = equivalence(&t_test(&a, 2.0_f64.exp()), &margin);
        assert_eq!(alone.verdict, Verdict::Inconclusive);
        let pair = welch(&a.estimate(), &b.estimate());
        assert!(pair.skewness.abs() < alone.test.skewness.abs());
        let even: Moments = (0..2000).map(|_| f64::from(stream.uniform())).collect();
        assert!(!t_test(&even, 0.5).heavy_tailed());
    }
}
