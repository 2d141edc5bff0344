//! Exponential and logarithm without a call into the system's library, so that results are the same
//! on every platform and side by side in [`Lanes`] as one at a time.
//!
//! | function | for | relative error below |
//! |---|---|---|
//! | [`exp`] | x ≤ 88; below −87 it stays at e⁻⁸⁷ ≈ 1.6·10⁻³⁸, the last normal number | 2.5·10⁻⁷ |
//! | [`exp_m1`] | x ≤ 88 | 4·10⁻⁷ |
//! | [`ln`] | normal x > 0 | 2·10⁻⁷, beside 1 |
//! | [`ln_1p`] | −½ ≤ x ≤ 1 | 2·10⁻⁷ |
//!
//! eˣ = 2ⁿ eʳ with n = ⌊x / ln 2 + ½⌋ and |r| ≤ ½ ln 2; eʳ − 1 by its series. ln m = 2 artanh s
//! with s = (m − 1)/(m + 1), by its series, too.

use std::f32::consts::{LN_2, LOG2_E, SQRT_2};

use super::lanes::Lanes;

/// 1.5 · 2²³: added to a number below 2²² it leaves the nearest whole number in the lowest bits.
const ROUNDING: f32 = 12_582_912.0;
/// ln 2 in two parts: the first has 9 bits, so that its product with a small whole number is exact.
const LN_2_HIGH: f32 = 355.0 / 512.0;
const LN_2_LOW: f32 = -2.121_944_4e-4;
/// Below it 2ⁿ is not a normal number.
const LEAST: f32 = -87.0;

/// (eʳ − 1 − r) / r² for |r| ≤ ½ ln 2; the first dropped term is r⁶/8! < 5·10⁻⁸.
const SERIES: [f32; 6] =
    [1.0 / 5_040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 1.0 / 2.0];

/// 2ⁿ and eʳ − 1.
#[inline(always)]
fn split(x: f32) -> (f32, f32) {
    let x = if x < LEAST { LEAST } else { x };
    let rounded = x * LOG2_E + ROUNDING;
    let n = rounded - ROUNDING;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut sum = SERIES[0];
    for term in &SERIES[1..] {
        sum = sum * r + term;
    }
    let power = f32::from_bits((rounded.to_bits() << 23).wrapping_add(1.0_f32.to_bits()));
    (power, sum * (r * r) + r)
}

/// eˣ.
#[inline]
pub(crate) fn exp(x: f32) -> f32 {
    let (power, rest) = split(x);
    (rest + 1.0) * power
}

/// eˣ − 1.
#[inline]
pub(super) fn exp_m1(x: f32) -> f32 {
    let (power, rest) = split(x);
    power * rest + (power - 1.0)
}

impl Lanes {
    /// [`exp`] of each.
    #[inline(always)]
    pub(crate) fn exp(self) -> Self {
        let (power, rest) = self.split();
        (rest + 1.0) * power
    }

    /// [`exp_m1`] of each.
    #[inline(always)]
    pub(crate) fn exp_m1(self) -> Self {
        let (power, rest) = self.split();
        power * rest + (power - 1.0)
    }

    #[inline(always)]
    fn split(self) -> (Self, Self) {
        let least = Self::splat(LEAST);
        let x = self.below(least).select(least, self);
        let rounded = x * LOG2_E + ROUNDING;
        let n = rounded - ROUNDING;
        let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
        let mut sum = Self::splat(SERIES[0]);
        for term in &SERIES[1..] {
            sum = sum * r + *term;
        }
        let power = Self::of(|i| {
            f32::from_bits((rounded.0[i].to_bits() << 23).wrapping_add(1.0_f32.to_bits()))
        });
        (power, sum * (r * r) + r)
    }
}

/// 2 artanh s for |s| ≤ ⅓; the first dropped term is below 2 s (1/9)⁸/17 < 3·10⁻⁹ s.
#[inline]
fn twice_artanh(s: f32) -> f32 {
    let y = s * s;
    let mut sum = 2.0 / 15.0;
    for odd in [13.0, 11.0, 9.0, 7.0, 5.0, 3.0] {
        sum = sum * y + 2.0 / odd;
    }
    sum * (y * s) + 2.0 * s
}

/// ln x of a normal number.
#[inline]
pub(crate) fn ln(x: f32) -> f32 {
    // x = 2ⁿ m with m in [1/√2, √2).
    let bits = x.to_bits();
    let mut exponent = (bits >> 23) as i32 - 127;
    let mut m = f32::from_bits((bits & 0x007f_ffff) | 1.0_f32.to_bits());
    if m >= SQRT_2 {
        m *= 0.5;
        exponent += 1;
    }
    twice_artanh((m - 1.0) / (m + 1.0)) + exponent as f32 * LN_2
}

/// ln (1 + x) for x in [−½, 1].
#[inline]
pub(super) fn ln_1p(x: f32) -> f32 {
    twice_artanh(x / (2.0 + x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    /// Largest relative error over logarithmically spread arguments between two bounds.
    fn worst(low: f64, high: f64, ours: impl Fn(f32) -> f32, exact: impl Fn(f64) -> f64) -> f64 {
        let mut random = Stream::from_key(1);
        (0..200_000)
            .map(|_| {
                let x = (low * (high / low).powf(f64::from(random.uniform()))) as f32;
                let expected = exact(f64::from(x));
                (f64::from(ours(x)) / expected - 1.0).abs()
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn errors_are_as_said() {
        let exponential = worst(-87.0, -1e-9, exp, f64::exp);
        assert!(exponential < 2.5e-7, "{exponential:e}");
        let above = worst(1e-9, 88.0, exp, f64::exp);
        assert!(above < 2.5e-7, "{above:e}");
        let less_one = worst(-80.0, -1e-30, exp_m1, f64::exp_m1);
        assert!(less_one < 4e-7, "{less_one:e}");
        let more = worst(1e-30, 88.0, exp_m1, f64::exp_m1);
        assert!(more < 4e-7, "{more:e}");
        let near = worst(-0.5, -1e-30, ln_1p, f64::ln_1p).max(worst(1e-30, 1.0, ln_1p, f64::ln_1p));
        assert!(near < 2e-7, "{near:e}");
        let far = worst(1e-37, 0.9, ln, f64::ln).max(worst(1.2, 1e37, ln, f64::ln));
        assert!(far < 3e-7, "{far:e}");
        assert_eq!((exp(0.0), exp_m1(0.0), ln(1.0), ln_1p(0.0)), (1.0, 0.0, 0.0, 0.0));
        assert_eq!(exp_m1(-200.0), -1.0);
        assert!(exp(-1e30) > 0.0 && exp(f32::NEG_INFINITY) < 2e-38);
    }

    #[test]
    fn lanes_have_the_bits_of_numbers() {
        let mut random = Stream::from_key(2);
        for _ in 0..20_000 {
            let x = Lanes::of(|_| -100.0 * random.uniform().powi(8));
            let (all, each) = (x.exp(), x.0.map(exp));
            assert_eq!(all.0.map(f32::to_bits), each.map(f32::to_bits), "{x:?}");
            let (all, each) = (x.exp_m1(), x.0.map(exp_m1));
            assert_eq!(all.0.map(f32::to_bits), each.map(f32::to_bits), "{x:?}");
        }
    }
}
