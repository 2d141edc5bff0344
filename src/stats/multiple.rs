//! Many tests at once: corrections, two stages, whole distributions, and how many samples a test
//! needs.

use statrs::distribution::{ContinuousCDF, Normal};

/// Which hypotheses to reject so that the probability of any false rejection is at most `alpha`,
/// under any dependence (Holm 1979).
///
/// The smallest p is compared with α/m, the next with α/(m − 1), and so on until one is not
/// smaller. A p that is NaN counts as 0.
#[must_use]
pub fn holm(p: &[f64], alpha: f64) -> Vec<bool> {
    let mut rejected = vec![false; p.len()];
    for (rank, &i) in ascending(p).iter().enumerate() {
        if p[i] > alpha / (p.len() - rank) as f64 {
            break;
        }
        rejected[i] = true;
    }
    rejected
}

/// Which hypotheses to reject so that at most a share `q` of the rejections is false on average
/// (Benjamini and Hochberg 1995).
///
/// For maps that a person looks at; gates use [`holm`].
#[must_use]
pub fn benjamini_hochberg(p: &[f64], q: f64) -> Vec<bool> {
    let order = ascending(p);
    let m = p.len() as f64;
    let last =
        (0..p.len()).rev().find(|&rank| zero_if_nan(p[order[rank]]) <= q * (rank + 1) as f64 / m);
    let mut rejected = vec![false; p.len()];
    for &i in last.map_or(&order[..0], |rank| &order[..=rank]) {
        rejected[i] = true;
    }
    rejected
}

fn ascending(p: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| zero_if_nan(p[a]).total_cmp(&zero_if_nan(p[b])));
    order
}

/// An undefined p must not count as agreement.
fn zero_if_nan(p: f64) -> f64 {
    if p.is_nan() { 0.0 } else { p }
}

/// The level of each of `m` independent tests whose family has level `alpha`: 1 − (1 − α)^(1/m)
/// (Šidák 1967).
#[must_use]
pub fn sidak(alpha: f64, m: usize) -> f64 {
    -((-alpha).ln_1p() / m as f64).exp_m1()
}

/// The p of the smallest of `m` independent p-values: 1 − (1 − p)^m, the inverse of [`sidak`].
#[must_use]
pub fn sidak_p(min_p: f64, m: usize) -> f64 {
    -((-min_p).ln_1p() * m as f64).exp_m1()
}

/// The result of a [`two_stage`] test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoStage {
    /// p of the first stage.
    pub p1: f64,
    /// p of the second stage, if it was needed.
    pub p2: Option<f64>,
    /// Whether both stages rejected.
    pub rejected: bool,
}

/// A test of level `alpha` that pays for few samples mostly: a cheap first stage of level `alpha1`,
/// and only where that rejects a second one, of level α/α₁, with fresh seeds and about four times
/// the samples.
///
/// The stages must be independent; then the false-alarm rate is α₁ · α/α₁ = α. The argument of
/// `stage` is 1 or 2.
///
/// # Panics
///
/// If not 0 < `alpha` <= `alpha1` <= 1.
#[must_use]
pub fn two_stage(alpha: f64, alpha1: f64, mut stage: impl FnMut(u32) -> f64) -> TwoStage {
    assert!(0.0 < alpha && alpha <= alpha1 && alpha1 <= 1.0, "0 < alpha <= alpha1 <= 1");
    let p1 = stage(1);
    if p1 > alpha1 {
        return TwoStage { p1, p2: None, rejected: false };
    }
    let p2 = stage(2);
    TwoStage { p1, p2: Some(p2), rejected: zero_if_nan(p2) <= alpha / alpha1 }
}

/// The result of a Kolmogorov–Smirnov test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KolmogorovSmirnov {
    /// D: the largest distance of the two distribution functions.
    pub statistic: f64,
    /// Probability of a D at least this large under the same distribution.
    pub p: f64,
}

/// Whether values follow the uniform distribution on [0, 1]: the test for a set of p-values, which
/// a wrong variance estimate bends.
///
/// Law of Kolmogorov with Stephens' (1970) argument (√n + 0.12 + 0.11/√n) D: for p > 10⁻⁴ within
/// 3 % of the exact p from n = 50, 17 % at n = 20. Values that are not finite give p = 0, no values
/// p = 1.
#[must_use]
pub fn ks_uniform(values: &[f64]) -> KolmogorovSmirnov {
    if values.iter().any(|v| !v.is_finite()) {
        return KolmogorovSmirnov { statistic: 1.0, p: 0.0 };
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let statistic = sorted
        .iter()
        .enumerate()
        .map(|(i, &v)| {
            let cdf = v.clamp(0.0, 1.0);
            (cdf - i as f64 / n).max((i + 1) as f64 / n - cdf)
        })
        .fold(0.0, f64::max);
    kolmogorov(statistic, n)
}

/// Whether two samples come from the same distribution (Smirnov 1939), for example a streaming and
/// a batch form of one sampler.
///
/// The law is for continuous distributions; with ties the test is conservative. Values that are not
/// finite give p = 0, an empty sample p = 1.
#[must_use]
pub fn ks_two_sample(a: &[f64], b: &[f64]) -> KolmogorovSmirnov {
    if a.iter().chain(b).any(|v| !v.is_finite()) {
        return KolmogorovSmirnov { statistic: 1.0, p: 0.0 };
    }
    let sorted = |v: &[f64]| {
        let mut v = v.to_vec();
        v.sort_by(f64::total_cmp);
        v
    };
    let (a, b) = (sorted(a), sorted(b));
    let (n, m) = (a.len() as f64, b.len() as f64);
    let (mut i, mut j) = (0, 0);
    let mut statistic: f64 = 0.0;
    while i < a.len() && j < b.len() {
        let x = a[i].min(b[j]);
        // Both steps over all equal values first: between ties the distance means nothing.
        while i < a.len() && a[i] <= x {
            i += 1;
        }
        while j < b.len() && b[j] <= x {
            j += 1;
        }
        statistic = statistic.max((i as f64 / n - j as f64 / m).abs());
    }
    kolmogorov(statistic, n * m / (n + m))
}

fn kolmogorov(statistic: f64, n: f64) -> KolmogorovSmirnov {
    if n.is_nan() || n == 0.0 {
        return KolmogorovSmirnov { statistic: 0.0, p: 1.0 };
    }
    let root = n.sqrt();
    KolmogorovSmirnov { statistic, p: kolmogorov_sf((root + 0.12 + 0.11 / root) * statistic) }
}

/// Survival function of Kolmogorov's distribution.
fn kolmogorov_sf(x: f64) -> f64 {
    use core::f64::consts::PI;
    if x < 1.0 {
        // Jacobi's transformed series: the direct one needs many terms here.
        if x < 0.04 {
            return 1.0;
        }
        let t = (-PI * PI / (8.0 * x * x)).exp();
        1.0 - (2.0 * PI).sqrt() / x * (t + t.powi(9) + t.powi(25) + t.powi(49))
    } else {
        let e = |j: f64| (-2.0 * j * j * x * x).exp();
        2.0 * (e(1.0) - e(2.0) + e(3.0) - e(4.0))
    }
}

/// Samples that find a relative bias `b` with probability `power` at two-sided level `alpha`: n =
/// ((z(1 − α/2) + z(power)) c / b)², with c = σ/μ of one sample. Twice that where the reference is
/// as noisy a second run.
#[must_use]
pub fn samples_for_bias(bias: f64, variation: f64, alpha: f64, power: f64) -> f64 {
    (z_sum(alpha, power) * variation / bias).powi(2)
}

/// The relative bias that `n` samples find with probability `power` at two-sided level `alpha`: the
/// inverse of [`samples_for_bias`].
#[must_use]
pub fn detectable_bias(n: f64, variation: f64, alpha: f64, power: f64) -> f64 {
    z_sum(alpha, power) * variation / n.sqrt()
}

fn z_sum(alpha: f64, power: f64) -> f64 {
    let normal = Normal::standard();
    normal.inverse_cdf(power) - normal.inverse_cdf(0.5 * alpha)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    #[test]
    fn holm_and_benjamini_hochberg_by_hand() {
        // Holm at 0.05, m = 4: 0.01 <= 0.0125, 0.016 <= 0.0167, 0.03 > 0.025 stops.
        let p = [0.03, 0.01, 0.2, 0.016];
        assert_eq!(holm(&p, 0.05), [false, true, false, true]);
        // Benjamini-Hochberg at 0.05: 0.03 <= 0.0375 accepts the three smallest.
        assert_eq!(benjamini_hochberg(&p, 0.05), [true, true, false, true]);
        assert_eq!(holm(&[f64::NAN, 0.9], 0.05), [true, false]);
        assert!(holm(&[], 0.05).is_empty() && benjamini_hochberg(&[], 0.05).is_empty());
    }

    #[test]
    fn holm_keeps_its_family_level_where_no_correction_does_not() {
        // 2000 families of 20 uniform p at alpha 0.05: at most 100 + 4.5 * 9.7 families with a
        // rejection; uncorrected 64 %.
        let mut stream = Stream::from_key(31);
        let (mut corrected, mut raw) = (0, 0);
        for _ in 0..2000 {
            let p: Vec<f64> = (0..20).map(|_| f64::from(stream.uniform())).collect();
            corrected += i32::from(holm(&p, 0.05).contains(&true));
            raw += i32::from(p.iter().any(|&p| p < 0.05));
        }
        assert!((50..=144).contains(&corrected), "{corrected}");
        assert!(raw > 1100, "{raw}");
    }

    #[test]
    fn sidak_inverts() {
        // 40-digit decimal arithmetic: 1 - (1 - 1e-4)^(1/300).
        assert!((sidak(1e-4, 300) - 3.333_499_455_500_89e-7).abs() < 1e-18);
        assert!((sidak_p(sidak(0.01, 65_536), 65_536) - 0.01).abs() < 1e-13);
    }

    #[test]
    fn second_stage_runs_only_on_rejection() {
        let mut calls = 0;
        let accepted = two_stage(1e-4, 1e-2, |_| {
            calls += 1;
            0.02
        });
        assert!(!accepted.rejected && accepted.p2.is_none() && calls == 1);
        let p = [0.0, 0.009, 0.02];
        assert!(!two_stage(1e-4, 1e-2, |stage| p[stage as usize]).rejected);
        assert!(two_stage(1e-4, 1e-2, |stage| 0.01 / f64::from(stage)).rejected);
        assert!(two_stage(1e-4, 1e-2, |_| f64::NAN).rejected);
    }

    #[test]
    fn kolmogorov_matches_scipy() {
        // SciPy 1.17: scipy.stats.kstwobign.sf([0.4, 0.9, 1.1, 2.5]).
        for (x, p) in [
            (0.4, 0.997_192_326_777_298_3),
            (0.9, 0.392_730_707_940_654_3),
            (1.1, 0.177_718_192_606_401_2),
            (2.5, 7.453_306_344_157_342e-06),
        ] {
            assert!((kolmogorov_sf(x) / p - 1.0).abs() < 1e-9, "{x}");
        }
        // scipy.stats.ks_2samp([.1, .4, .7, .7], [.2, .5, .7, .9, 1.1]).statistic = 0.4;
        // kstest([.1, .4, .7], "uniform") = 0.3.
        let two = ks_two_sample(&[0.1, 0.4, 0.7, 0.7], &[0.2, 0.5, 0.7, 0.9, 1.1]);
        assert!((two.statistic - 0.4).abs() < 1e-12, "{two:?}");
        assert!((ks_uniform(&[0.1, 0.4, 0.7]).statistic - 0.3).abs() < 1e-12);
    }

    #[test]
    fn uniform_values_pass_and_bent_ones_fail() {
        let mut stream = Stream::from_key(32);
        let even: Vec<f64> = (0..500).map(|_| f64::from(stream.uniform())).collect();
        // The p-values of a variance that is 1.5 times too small pile up at 0 like this.
        let bent: Vec<f64> = even.iter().map(|p| p.powf(1.5)).collect();
        assert!(ks_uniform(&even).p > 1e-4);
        assert!(ks_uniform(&bent).p < 1e-6);
        let other: Vec<f64> = (0..700).map(|_| f64::from(stream.uniform())).collect();
        assert!(ks_two_sample(&even, &other).p > 1e-4);
        assert!(ks_two_sample(&bent, &other).p < 1e-6);
        assert_eq!(ks_uniform(&[f64::NAN]).p, 0.0);
        assert_eq!(ks_uniform(&[]).p, 1.0);
        assert_eq!(ks_two_sample(&[], &[1.0]).p, 1.0);
    }

    #[test]
    fn power_matches_scipy() {
        // SciPy 1.17: ((norm.isf(.5e-4) + norm.isf(.01)) / .005)**2
        let n = samples_for_bias(0.005, 1.0, 1e-4, 0.99);
        assert!((n / 1_546_013.599_404_521 - 1.0).abs() < 1e-9, "{n}");
        assert!((detectable_bias(n, 1.0, 1e-4, 0.99) - 0.005).abs() < 1e-12);
    }
}
