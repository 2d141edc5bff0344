//! Exact expectations: run a random algorithm once for every outcome of its draws, with exact
//! probabilities.

use core::fmt;
use core::ops::{Add, Mul, Neg, Sub};

use crate::math::rng::RandomSource;

/// An exact fraction, always reduced, with a positive denominator.
///
/// Both parts are `i128`. Arithmetic that overflows panics; sums and products of weights that are
/// small integers or dyadic fractions stay far below.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Rational {
    numerator: i128,
    denominator: i128,
}

impl Rational {
    /// 0.
    pub const ZERO: Self = Self { numerator: 0, denominator: 1 };
    /// 1.
    pub const ONE: Self = Self { numerator: 1, denominator: 1 };

    /// `numerator / denominator`.
    ///
    /// # Panics
    ///
    /// If `denominator` is 0.
    #[must_use]
    pub fn new(numerator: i128, denominator: i128) -> Self {
        assert!(denominator != 0, "denominator of a fraction is 0");
        let divisor = gcd(numerator.unsigned_abs(), denominator.unsigned_abs()) as i128;
        let sign = denominator.signum();
        Self { numerator: sign * numerator / divisor, denominator: sign * denominator / divisor }
    }

    /// The exact value of a finite float.
    ///
    /// # Panics
    ///
    /// If `value` is not finite, or its magnitude is outside [2⁻⁷⁴, 2⁷³] and so may not fit.
    #[must_use]
    pub fn from_f64(value: f64) -> Self {
        if value == 0.0 {
            return Self::ZERO;
        }
        assert!(
            (2.0_f64.powi(-74)..=2.0_f64.powi(73)).contains(&value.abs()),
            "{value:e} as an exact fraction, but its magnitude must be in [2^-74, 2^73]"
        );
        // Both scalings are by powers of two and exact: 52 fraction bits below 2^-74 end at 2^-126.
        let mut denominator = 1;
        let mut scaled = value;
        while scaled.fract() != 0.0 {
            scaled *= 2.0;
            denominator *= 2;
        }
        Self::new(scaled as i128, denominator)
    }

    /// The nearest float.
    #[must_use]
    pub fn to_f64(self) -> f64 {
        self.numerator as f64 / self.denominator as f64
    }

    /// The numerator, reduced, with the sign.
    #[must_use]
    pub const fn numerator(self) -> i128 {
        self.numerator
    }

    /// The denominator, reduced, positive.
    #[must_use]
    pub const fn denominator(self) -> i128 {
        self.denominator
    }

    /// 1 / self.
    ///
    /// # Panics
    ///
    /// If `self` is 0.
    #[must_use]
    pub fn recip(self) -> Self {
        Self::new(self.denominator, self.numerator)
    }
}

fn gcd(mut a: u128, mut b: u128) -> u128 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a.max(1)
}

const OVERFLOW: &str =
    "an exact fraction overflows 128 bits: use weights that are small integers or dyadic";

impl Add for Rational {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let divisor = gcd(self.denominator as u128, other.denominator as u128) as i128;
        let (scale, other_scale) = (other.denominator / divisor, self.denominator / divisor);
        let sum = self.numerator.checked_mul(scale).zip(other.numerator.checked_mul(other_scale));
        let numerator = sum.and_then(|(a, b)| a.checked_add(b)).expect(OVERFLOW);
        Self::new(numerator, self.denominator.checked_mul(scale).expect(OVERFLOW))
    }
}

impl Neg for Rational {
    type Output = Self;

    fn neg(self) -> Self {
        Self { numerator: -self.numerator, denominator: self.denominator }
    }
}

impl Sub for Rational {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Rational {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        // Crosswise reduction first keeps the factors small.
        let a = Self::new(self.numerator, other.denominator);
        let b = Self::new(other.numerator, self.denominator);
        Self {
            numerator: a.numerator.checked_mul(b.numerator).expect(OVERFLOW),
            denominator: a.denominator.checked_mul(b.denominator).expect(OVERFLOW),
        }
    }
}

impl From<i32> for Rational {
    fn from(value: i32) -> Self {
        Self { numerator: value.into(), denominator: 1 }
    }
}

impl fmt::Display for Rational {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.denominator == 1 {
            write!(f, "{}", self.numerator)
        } else {
            write!(f, "{}/{}", self.numerator, self.denominator)
        }
    }
}

impl fmt::Debug for Rational {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A number that probabilities are counted in: [`Rational`], exact while it fits, or `f64`, for
/// weights of any size.
pub trait Probability:
    Copy + fmt::Debug + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;

    /// `weight / total`.
    fn ratio(weight: f32, total: f32) -> Self;

    /// `1 / n`.
    fn one_in(n: u32) -> Self;
}

impl Probability for Rational {
    const ZERO: Self = Self::ZERO;
    const ONE: Self = Self::ONE;

    fn ratio(weight: f32, total: f32) -> Self {
        Self::from_f64(weight.into()) * Self::from_f64(total.into()).recip()
    }

    fn one_in(n: u32) -> Self {
        Self::new(1, n.into())
    }
}

impl Probability for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;

    fn ratio(weight: f32, total: f32) -> Self {
        Self::from(weight) / Self::from(total)
    }

    fn one_in(n: u32) -> Self {
        1.0 / Self::from(n)
    }
}

/// One possible outcome of a random algorithm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome<T, P = Rational> {
    /// Its probability; over all outcomes they sum to 1.
    pub probability: P,
    /// What the algorithm returned.
    pub value: T,
}

/// A random source that takes every branch in turn; made by [`enumerate`] and [`enumerate_f64`].
///
/// [`choose`](RandomSource::choose) forks in two unless one side is impossible,
/// [`index`](RandomSource::index) in `n`, [`uniform`](RandomSource::uniform) in the given number of
/// strata.
#[derive(Debug)]
pub struct Enumerator<P = Rational> {
    strata: u32,
    /// Branch taken and number of branches, per fork of this run.
    forks: Vec<(u32, u32)>,
    depth: usize,
    probability: P,
}

impl<P: Probability> Enumerator<P> {
    fn fork(&mut self, branches: u32) -> u32 {
        if self.depth == self.forks.len() {
            self.forks.push((0, branches));
        }
        let (branch, count) = self.forks[self.depth];
        assert_eq!(count, branches, "the algorithm must depend on its random source alone");
        self.depth += 1;
        branch
    }

    /// Moves to the next outcome; false after the last.
    fn advance(&mut self) -> bool {
        while let Some((branch, count)) = self.forks.pop() {
            if branch + 1 < count {
                self.forks.push((branch + 1, count));
                self.depth = 0;
                self.probability = P::ONE;
                return true;
            }
        }
        false
    }
}

impl<P: Probability> RandomSource for Enumerator<P> {
    fn choose(&mut self, weight: f32, total: f32) -> bool {
        assert!(
            total.is_finite() && 0.0 <= weight && weight <= total,
            "choose({weight}, {total}), but 0 <= weight <= total < infinity"
        );
        if weight == 0.0 || weight == total {
            return weight > 0.0;
        }
        let yes = P::ratio(weight, total);
        let chosen = self.fork(2) == 1;
        self.probability = self.probability * if chosen { yes } else { P::ONE - yes };
        chosen
    }

    fn index(&mut self, n: u32) -> u32 {
        assert!(n > 0, "index(0), but there must be something to choose from");
        self.probability = self.probability * P::one_in(n);
        self.fork(n)
    }

    fn uniform(&mut self) -> f32 {
        assert!(
            self.strata > 0,
            "uniform() has no finite set of outcomes: give a number of strata, or use choose() and index()"
        );
        let stratum = self.index(self.strata);
        ((f64::from(stratum) + 0.5) / f64::from(self.strata)) as f32
    }
}

/// Runs `algorithm` once for every outcome of its random draws; returns all with their exact
/// probabilities.
///
/// The algorithm must take all its randomness from the source. The number of runs is the product of
/// the forks along each path: keep domains to a handful of states.
///
/// # Panics
///
/// If a probability overflows [`Rational`], or the algorithm draws
/// [`uniform`](RandomSource::uniform).
///
/// ```
/// use afterimage::math::rng::RandomSource;
/// use afterimage::stats::{Rational, enumerate, expectation};
///
/// // Two dice: the mean of the larger is 161/36.
/// let larger = enumerate(|dice| dice.index(6).max(dice.index(6)) as i32 + 1);
/// assert_eq!(expectation(&larger, |&x| x.into()), Rational::new(161, 36));
/// ```
#[must_use]
pub fn enumerate<T>(algorithm: impl FnMut(&mut Enumerator) -> T) -> Vec<Outcome<T>> {
    enumerate_stratified(0, algorithm)
}

/// As [`enumerate`], where [`uniform`](RandomSource::uniform) returns the midpoints of `strata`
/// equal intervals: exact for what is constant within each interval.
#[must_use]
pub fn enumerate_stratified<T>(
    strata: u32,
    algorithm: impl FnMut(&mut Enumerator) -> T,
) -> Vec<Outcome<T>> {
    run(strata, algorithm)
}

/// As [`enumerate`], with probabilities in `f64`, right to about 10⁻¹⁵ a fork: for algorithms that
/// compute their weights in `f32`, whose exact fractions soon need more than 128 bits.
///
/// ```
/// use afterimage::math::rng::RandomSource;
/// use afterimage::stats::{enumerate_f64, expectation};
///
/// // Three coins of probability 0.1, as near as f32 comes.
/// let heads = enumerate_f64(|coin| (0..3).filter(|_| coin.choose(0.1, 1.0)).count());
/// assert!((expectation(&heads, |&n| n as f64) - 0.3).abs() < 1e-7);
/// ```
#[must_use]
pub fn enumerate_f64<T>(algorithm: impl FnMut(&mut Enumerator<f64>) -> T) -> Vec<Outcome<T, f64>> {
    run(0, algorithm)
}

fn run<T, P: Probability>(
    strata: u32,
    mut algorithm: impl FnMut(&mut Enumerator<P>) -> T,
) -> Vec<Outcome<T, P>> {
    let mut source = Enumerator { strata, forks: Vec::new(), depth: 0, probability: P::ONE };
    let mut outcomes = Vec::new();
    loop {
        let value = algorithm(&mut source);
        outcomes.push(Outcome { probability: source.probability, value });
        if !source.advance() {
            return outcomes;
        }
    }
}

/// The expectation Σ probability · f(value), as exact as the probabilities.
#[must_use]
pub fn expectation<T, P: Probability>(outcomes: &[Outcome<T, P>], f: impl Fn(&T) -> P) -> P {
    outcomes.iter().fold(P::ZERO, |sum, o| sum + o.probability * f(&o.value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ratio(numerator: i128, denominator: i128) -> Rational {
        Rational::new(numerator, denominator)
    }

    #[test]
    fn fractions_reduce_and_floats_convert_exactly() {
        assert_eq!(ratio(6, -4), ratio(-3, 2));
        assert_eq!(ratio(1, 6) + ratio(1, 10), ratio(4, 15));
        assert_eq!(ratio(3, 4) * ratio(2, 9), ratio(1, 6));
        assert_eq!(Rational::from_f64(-0.375), ratio(-3, 8));
        assert_eq!(Rational::from_f64(f64::from(0.1_f32)), ratio(13_421_773, 134_217_728));
        assert_eq!(Rational::from_f64(2.0_f64.powi(-74)).denominator(), 1 << 74);
    }

    #[test]
    #[should_panic(expected = "overflows 128 bits")]
    fn overflow_panics() {
        let small = ratio(1, 1 << 100);
        let _ = small * small;
    }

    #[test]
    #[should_panic(expected = "has no finite set of outcomes")]
    fn uniform_without_strata_panics() {
        let _ = enumerate(|source| source.uniform());
    }

    #[test]
    fn probabilities_sum_to_one_and_impossible_branches_are_not_taken() {
        let outcomes = enumerate_stratified(4, |source| {
            let certain = source.choose(2.0, 2.0);
            let impossible = source.choose(0.0, 2.0) || source.choose(0.0, 0.0);
            // Reading another draw on one branch only: paths of unequal length.
            let more = source.choose(1.0, 3.0) && source.index(3) == 2;
            (certain, impossible, more, source.uniform())
        });
        assert_eq!(outcomes.len(), (1 + 3) * 4);
        assert_eq!(expectation(&outcomes, |_| Rational::ONE), Rational::ONE);
        assert!(outcomes.iter().all(|o| o.value.0 && !o.value.1));
        let more = expectation(&outcomes, |o| i32::from(o.2).into());
        assert_eq!(more, ratio(1, 9));
        let mean = expectation(&outcomes, |o| Rational::from_f64(o.3.into()));
        assert_eq!(mean, ratio(1, 2));
    }

    #[test]
    fn floating_probabilities_agree_with_the_fractions_and_go_on_where_those_overflow() {
        fn toss(coin: &mut impl RandomSource) -> u32 {
            let heads: u32 = (0..4).map(|i| u32::from(coin.choose(1.0, 3.0 + i as f32))).sum();
            heads + coin.index(3)
        }
        let exact = enumerate(toss);
        let floating = enumerate_f64(toss);
        assert_eq!(exact.len(), floating.len());
        for (exact, floating) in exact.iter().zip(&floating) {
            assert_eq!(exact.value, floating.value);
            assert!((exact.probability.to_f64() - floating.probability).abs() < 1e-15);
        }
        // 24-bit weights: the common denominator of nine such draws has more than 200 bits.
        let heads = enumerate_f64(|coin| (0..9).filter(|_| coin.choose(0.1, 0.7)).count());
        assert_eq!(heads.len(), 1 << 9);
        assert!((expectation(&heads, |_| 1.0) - 1.0).abs() < 1e-14);
        let mean = 9.0 * f64::from(0.1_f32) / f64::from(0.7_f32);
        assert!((expectation(&heads, |&n| n as f64) - mean).abs() < 1e-14);
    }

    // The 1/M toy: four states, targets of pixels a and b with different supports, uniform
    // candidates.
    const F_A: [i32; 4] = [4, 1, 0, 2];
    const F_B: [i32; 4] = [1, 3, 5, 0];

    #[derive(Clone, Copy)]
    struct Reservoir {
        state: Option<usize>,
        weight_sum: Rational,
    }

    impl Reservoir {
        const EMPTY: Self = Self { state: None, weight_sum: Rational::ZERO };

        fn update(&mut self, state: usize, weight: Rational, source: &mut Enumerator) {
            self.weight_sum = self.weight_sum + weight;
            // Over the common denominator both are integers, exact in f32.
            let total = self.weight_sum;
            let divisor = gcd(weight.denominator() as u128, total.denominator() as u128) as i128;
            let common = weight.denominator() / divisor * total.denominator();
            let integer = |r: Rational| (r * ratio(common, 1)).numerator();
            assert!(integer(total) < 1 << 24);
            if source.choose(integer(weight) as f32, integer(total) as f32) {
                self.state = Some(state);
            }
        }

        /// W = Σw / p̂(x); 0 if empty.
        fn contribution(&self, target: &[i32; 4]) -> Rational {
            self.state
                .map_or(Rational::ZERO, |x| self.weight_sum * Rational::from(target[x]).recip())
        }
    }

    fn candidates(target: &[i32; 4], count: u32, source: &mut Enumerator) -> Reservoir {
        let mut reservoir = Reservoir::EMPTY;
        for _ in 0..count {
            let x = source.index(4) as usize;
            // p̂ / p / count with p = 1/4.
            reservoir.update(x, ratio(4 * i128::from(target[x]), count.into()), source);
        }
        reservoir
    }

    /// E of h(x) W at pixel a after merging b into it, for MIS weights of technique i at state x.
    fn merged(mis: impl Fn(usize, usize) -> Rational, h: [i32; 4], count: u32) -> Rational {
        let outcomes = enumerate(|source| {
            let inputs =
                [(candidates(&F_A, count, source), F_A), (candidates(&F_B, count, source), F_B)];
            let mut out = Reservoir::EMPTY;
            for (i, (input, target)) in inputs.into_iter().enumerate() {
                if let Some(x) = input.state {
                    let weight = mis(i, x) * Rational::from(F_A[x]) * input.contribution(&target);
                    out.update(x, weight, source);
                }
            }
            out.state.map_or(Rational::ZERO, |x| Rational::from(h[x]) * out.contribution(&F_A))
        });
        assert_eq!(expectation(&outcomes, |_| Rational::ONE), Rational::ONE);
        expectation(&outcomes, |&value| value)
    }

    #[test]
    fn balance_is_exact_and_one_over_m_loses_a_seventh() {
        let balance = |i: usize, x: usize| {
            let targets = [F_A[x], F_B[x]].map(i128::from);
            ratio(targets[i], targets[0] + targets[1])
        };
        let one_over_m = |_, _| ratio(1, 2);
        // h apart from the target tests the choice of the state, not only the sum of weights.
        let other = [1, 5, 0, 3];
        for count in [1, 2] {
            assert_eq!(merged(balance, F_A, count), 7.into());
            assert_eq!(merged(balance, other, count), 9.into());
            assert_eq!(merged(one_over_m, F_A, count), 6.into());
        }
        assert_eq!(ratio(6 - 7, 7), -ratio(1, 7));
    }
}
