//! Running moments of a sample.

use super::Estimate;

/// Count, mean, and second and third central sums of a sample, in f64 and in one pass.
///
/// Welford's (1962) update, with Chan, Golub and `LeVeque`'s (1983) merge and its third-order form
/// (Pébay 2008, eq. 2.1). Nothing is trimmed: an outlier belongs to the estimate, and a value that
/// is not finite makes every moment NaN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    count: u64,
    mean: f64,
    m2: f64,
    m3: f64,
}

impl Moments {
    /// No samples yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { count: 0, mean: 0.0, m2: 0.0, m3: 0.0 }
    }

    /// Adds a sample.
    #[inline]
    pub fn push(&mut self, x: f64) {
        self.merge(&Self { count: 1, mean: x, m2: 0.0, m3: 0.0 });
    }

    /// Adds all samples of another set.
    #[inline]
    pub fn merge(&mut self, other: &Self) {
        if other.count == 0 {
            return;
        }
        if self.count == 0 {
            *self = *other;
            return;
        }
        let (a, b) = (self.count as f64, other.count as f64);
        let n = a + b;
        let delta = other.mean - self.mean;
        let cross = delta * delta * a * b / n;
        self.m3 +=
            other.m3 + cross * delta * (a - b) / n + 3.0 * delta * (a * other.m2 - b * self.m2) / n;
        self.m2 += other.m2 + cross;
        self.mean += delta * b / n;
        self.count += other.count;
    }

    /// All of its state, for [`Self::from_state`].
    #[cfg(feature = "experiment")]
    pub(super) fn state(&self) -> [f64; 4] {
        [self.count as f64, self.mean, self.m2, self.m3]
    }

    #[cfg(feature = "experiment")]
    pub(super) fn from_state([count, mean, m2, m3]: [f64; 4]) -> Self {
        Self { count: count as u64, mean, m2, m3 }
    }

    /// Number of samples n.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Sample mean x̄; 0 without samples.
    #[must_use]
    pub const fn mean(&self) -> f64 {
        self.mean
    }

    /// Unbiased variance s² = Σ(x − x̄)² / (n − 1) of one sample; infinite, that is unknown, for
    /// fewer than two.
    #[must_use]
    pub fn variance(&self) -> f64 {
        if self.count < 2 { f64::INFINITY } else { self.m2 / (self.count - 1) as f64 }
    }

    /// Standard error of the mean, s / √n.
    #[must_use]
    pub fn standard_error(&self) -> f64 {
        (self.variance() / self.count.max(1) as f64).sqrt()
    }

    /// Sample skewness γ̂ = √n Σ(x − x̄)³ / (Σ(x − x̄)²)^(3/2); 0 where all samples are equal.
    ///
    /// Of n normal samples its standard deviation is √(6 / n).
    #[must_use]
    pub fn skewness(&self) -> f64 {
        if self.m2 == 0.0 { 0.0 } else { (self.count as f64).sqrt() * self.m3 / self.m2.powf(1.5) }
    }

    /// The mean as an [`Estimate`] with n − 1 degrees of freedom.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let n = self.count.max(1) as f64;
        Estimate {
            mean: self.mean,
            variance: self.variance() / n,
            dof: (n - 1.0).max(1.0),
            skewness: self.skewness() / n.sqrt(),
            skewness_error: 6.0_f64.sqrt() / n,
        }
    }
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(samples: I) -> Self {
        let mut moments = Self::new();
        samples.into_iter().for_each(|x| moments.push(x));
        moments
    }
}

/// The mean of a correlated series, with a variance from means over consecutive batches: σ̂² of a
/// batch mean, divided by the number of batches (Law and Kelton 2000, section 9.5.3).
///
/// Trust it only where a batch is at least 5 to 10 autocorrelation times long: with τ = 41 and 20
/// batches, a nominal false-alarm rate of 10⁻³ is 39 times too high at half a τ and 1.4 times at 5
/// τ. Independent restarts need no such care. A remainder that fills no batch is left out of the
/// variance and the mean.
///
/// # Panics
///
/// If `batches` is below 2 or above the length of the series.
#[must_use]
pub fn batch_means(series: &[f64], batches: usize) -> Estimate {
    assert!(
        (2..=series.len()).contains(&batches),
        "{batches} batches of {} values, but must be in [2, {}]",
        series.len(),
        series.len()
    );
    series
        .chunks_exact(series.len() / batches)
        .take(batches)
        .map(|batch| batch.iter().sum::<f64>() / batch.len() as f64)
        .collect::<Moments>()
        .estimate()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    const SAMPLE: [f64; 7] = [2.0, 8.0, 0.0, 4.0, 1.0, 9.0, 9.0];

    #[test]
    fn matches_scipy() {
        // SciPy 1.17: numpy.var(x, ddof=1), scipy.stats.skew(x), scipy.stats.sem(x).
        let m: Moments = SAMPLE.into_iter().collect();
        assert!((m.mean() - 33.0 / 7.0).abs() < 1e-14);
        assert!((m.variance() - 15.238_095_238_095_239).abs() < 1e-12);
        assert!((m.skewness() - 0.050_028_220_795_632_37).abs() < 1e-12);
        assert!((m.standard_error() - 1.475_422_227_126_635).abs() < 1e-12);
    }

    #[test]
    fn merge_equals_pushing_at_a_large_offset() {
        // The textbook sum of squares loses all digits here; the control shows it.
        let offset = 1e9;
        let mut halves = [Moments::new(), Moments::new()];
        for (i, x) in SAMPLE.into_iter().enumerate() {
            halves[i % 2].push(offset + x);
        }
        let [mut merged, second] = halves;
        merged.merge(&second);
        let direct: Moments = SAMPLE.into_iter().collect();
        assert_eq!(merged.count(), 7);
        assert!((merged.variance() / direct.variance() - 1.0).abs() < 1e-7);
        assert!((merged.skewness() - direct.skewness()).abs() < 1e-6);
        let squares: f64 = SAMPLE.iter().map(|x| (offset + x).powi(2)).sum();
        let sum: f64 = SAMPLE.iter().map(|x| offset + x).sum();
        let naive = (squares - sum * sum / 7.0) / 6.0;
        assert!((naive / direct.variance() - 1.0).abs() > 1e-3);
    }

    #[test]
    fn few_samples_have_unknown_variance() {
        let one: Moments = [3.0].into_iter().collect();
        assert!(one.variance().is_infinite() && one.standard_error().is_infinite());
        assert_eq!([2.0, 2.0].into_iter().collect::<Moments>().skewness(), 0.0);
    }

    #[test]
    fn batch_means_see_the_correlation_that_single_values_hide() {
        // AR(1) with rho = 0.9: the variance of the mean is (1 + rho) / (1 - rho) = 19 times that
        // of independent values.
        let mut stream = Stream::from_key(11);
        let mut ratio = Moments::new();
        for _ in 0..50 {
            let mut x = 0.0;
            let series: Vec<f64> = (0..20_000)
                .map(|_| {
                    x = 0.9 * x + f64::from(stream.uniform()) - 0.5;
                    x
                })
                .collect();
            let naive = series.iter().copied().collect::<Moments>().estimate();
            ratio.push(batch_means(&series, 20).variance / naive.variance);
        }
        // One ratio has relative deviation sqrt(2 / 19); batches of 1000 = 53 tau bias it by 1 %. 4
        // sigma.
        assert!((ratio.mean() / 19.0 - 1.0).abs() < 0.19, "{}", ratio.mean());
    }
}
