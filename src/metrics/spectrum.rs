//! The colour of noise: how an error's power is spread over spatial frequencies.

use core::f64::consts::PI;

/// Power spectrum of an error, such that white noise is 1 at every frequency whatever its variance.
///
/// P(f) = |FFT(w (e − ē))|² / Σ w² (e − ē)², where w is a Hann window over the picture (it is no
/// torus) and 0 where a pixel does not count, and ē the w-weighted mean: a bias is no noise. The
/// picture is padded with zeros to powers of two, which only interpolates P. Frequencies are in
/// cycles per pixel.
#[derive(Clone, Debug)]
pub struct Spectrum {
    width: usize,
    height: usize,
    /// P by row and column of the transform; all 0 for an error of 0.
    power: Vec<f64>,
}

impl Spectrum {
    /// `None` where a pixel does not count.
    pub(super) fn of(width: usize, height: usize, error: &[Option<f64>]) -> Self {
        let hann = |i: usize, n: usize| 0.5 - 0.5 * (2.0 * PI * (i as f64 + 0.5) / n as f64).cos();
        let weight = |i: usize| hann(i % width, width) * hann(i / width, height);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (i, error) in error.iter().enumerate() {
            if let Some(e) = error {
                sum += weight(i) * e;
                weights += weight(i);
            }
        }
        let mean = if weights == 0.0 { 0.0 } else { sum / weights };
        let (columns, rows) = (width.next_power_of_two(), height.next_power_of_two());
        let mut data = vec![Complex::default(); columns * rows];
        let mut energy = 0.0;
        for (i, error) in error.iter().enumerate() {
            if let Some(e) = error {
                let value = weight(i) * (e - mean);
                data[i / width * columns + i % width].re = value;
                energy += value * value;
            }
        }
        transform_2d(&mut data, columns);
        // Rounding in the mean leaves a constant error with 1e-32 of its energy: that is no noise.
        let norm = if energy > 1e-24 * weights * mean * mean { 1.0 / energy } else { 0.0 };
        let power = data.iter().map(|c| (c.re * c.re + c.im * c.im) * norm).collect();
        Self { width: columns, height: rows, power }
    }

    /// (f², P) of every bin but f = 0.
    fn bins(&self) -> impl Iterator<Item = (f64, f64)> {
        let cycles = |i: usize, n: usize| i.min(n - i) as f64 / n as f64;
        self.power.iter().enumerate().skip(1).map(move |(i, &p)| {
            let (x, y) = (cycles(i % self.width, self.width), cycles(i / self.width, self.height));
            (x * x + y * y, p)
        })
    }

    /// Mean P over 0 < f < 1/`period`; 1 for white noise, below for blue. Periods of 32, 16 and 8
    /// pixels tell methods apart.
    #[must_use]
    pub fn low_frequency(&self, period: f64) -> f64 {
        let (sum, count) = self
            .bins()
            .filter(|(f2, _)| f2 * period * period < 1.0)
            .fold((0.0, 0usize), |(sum, count), (_, p)| (sum + p, count + 1));
        if count == 0 { 0.0 } else { sum / count as f64 }
    }

    /// Share of the power at 0 < f < 1/16 in the whole: what survives a denoiser. White noise has
    /// π/256 = 1.2 %; 0 for no error.
    #[must_use]
    pub fn low_frequency_share(&self) -> f64 {
        let (mut low, mut all) = (0.0, 0.0);
        for (f2, p) in self.bins() {
            all += p;
            low += if f2 * 256.0 < 1.0 { p } else { 0.0 };
        }
        if all == 0.0 { 0.0 } else { low / all }
    }

    /// G(s) = Σ P g² / Σ g², g = exp(−2π² s² f²): the mean squared error after a Gaussian of `s`
    /// pixels, relative to white noise of the same mean squared error. White is 1; a blue-noise
    /// mask is below 0.001 at s = 2.1; reuse with feedback is above 1.
    #[must_use]
    pub fn g(&self, s: f64) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (f2, p) in self.bins() {
            let g2 = (-4.0 * PI * PI * s * s * f2).exp();
            sum += p * g2;
            weights += g2;
        }
        if weights == 0.0 { 0.0 } else { sum / weights }
    }

    /// Mean P in `bins` equal rings of f in (0, 1/2]; NaN where a ring is empty.
    #[must_use]
    pub fn radial(&self, bins: usize) -> Vec<f64> {
        let mut rings = vec![(0.0, 0usize); bins];
        for (f2, p) in self.bins() {
            let ring = (2.0 * f2.sqrt() * bins as f64).ceil() as usize;
            if let Some((sum, count)) = rings.get_mut(ring - 1) {
                *sum += p;
                *count += 1;
            }
        }
        rings.into_iter().map(|(sum, count)| sum / count as f64).collect()
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Complex {
    re: f64,
    im: f64,
}

impl Complex {
    fn times(self, o: Self) -> Self {
        Self { re: self.re * o.re - self.im * o.im, im: self.re * o.im + self.im * o.re }
    }
}

fn transform_2d(data: &mut [Complex], columns: usize) {
    let roots = roots_of_unity(columns);
    for row in data.chunks_exact_mut(columns) {
        transform(row, &roots);
    }
    let rows = data.len() / columns;
    let roots = roots_of_unity(rows);
    let mut column = vec![Complex::default(); rows];
    for x in 0..columns {
        for (y, c) in column.iter_mut().enumerate() {
            *c = data[y * columns + x];
        }
        transform(&mut column, &roots);
        for (y, c) in column.iter().enumerate() {
            data[y * columns + x] = *c;
        }
    }
}

/// exp(−2πi k / n) for k < n/2.
fn roots_of_unity(n: usize) -> Vec<Complex> {
    let angle = |k: usize| -2.0 * PI * k as f64 / n as f64;
    (0..n / 2).map(|k| Complex { re: angle(k).cos(), im: angle(k).sin() }).collect()
}

/// The discrete Fourier transform of a power of two of values, in place (Cooley and Tukey 1965).
fn transform(data: &mut [Complex], roots: &[Complex]) {
    let n = data.len();
    if n < 2 {
        return;
    }
    let shift = usize::BITS - n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> shift;
        if i < j {
            data.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        let step = n / (2 * half);
        for block in data.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for (k, (a, b)) in low.iter_mut().zip(high).enumerate() {
                let t = b.times(roots[k * step]);
                *b = Complex { re: a.re - t.re, im: a.im - t.im };
                *a = Complex { re: a.re + t.re, im: a.im + t.im };
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    fn white(width: usize, height: usize, key: u64) -> Vec<Option<f64>> {
        let mut stream = Stream::from_key(key);
        (0..width * height).map(|_| Some(f64::from(stream.uniform()) + 3.0)).collect()
    }

    #[test]
    fn transform_equals_its_definition() {
        let mut stream = Stream::from_key(1);
        let input: Vec<Complex> = (0..16)
            .map(|_| Complex { re: stream.uniform().into(), im: stream.uniform().into() })
            .collect();
        let mut fast = input.clone();
        transform(&mut fast, &roots_of_unity(16));
        for (k, fast) in fast.iter().enumerate() {
            let slow = input.iter().enumerate().fold(Complex::default(), |sum, (j, &v)| {
                let angle = -2.0 * PI * (j * k) as f64 / 16.0;
                let t = v.times(Complex { re: angle.cos(), im: angle.sin() });
                Complex { re: sum.re + t.re, im: sum.im + t.im }
            });
            assert!((fast.re - slow.re).hypot(fast.im - slow.im) < 1e-12);
        }
    }

    #[test]
    fn white_noise_is_one_everywhere_red_above_and_blue_below() {
        // 200 x 120 pixels: the band below 1/8 holds 1200 independent values, a Hann window halves
        // it twice: 6 % deviation; 5 sigma.
        let (width, height) = (200, 120);
        let error = white(width, height, 2);
        let spectrum = Spectrum::of(width, height, &error);
        assert!((spectrum.low_frequency(8.0) - 1.0).abs() < 0.3, "{}", spectrum.low_frequency(8.0));
        assert!((spectrum.g(1.0) - 1.0).abs() < 0.3, "{}", spectrum.g(1.0));
        assert!((spectrum.low_frequency_share() * 256.0 / PI - 1.0).abs() < 0.5);
        assert!(spectrum.radial(8).iter().skip(1).all(|p| (p - 1.0).abs() < 0.3));
        let at = |x: usize, y: usize| error[y.min(height - 1) * width + x.min(width - 1)].unwrap();
        let filtered = |sign: f64| -> Vec<Option<f64>> {
            let value = |i: usize| {
                let (x, y) = (i % width, i / width);
                Some(
                    at(x, y)
                        + sign
                            * 0.25
                            * (at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1) + at(x + 2, y)),
                )
            };
            (0..width * height).map(value).collect()
        };
        let (red, blue) = (filtered(1.0), filtered(-1.0));
        assert!(Spectrum::of(width, height, &red).g(2.1) > 2.0);
        assert!(Spectrum::of(width, height, &blue).g(2.1) < 0.2);
    }

    #[test]
    fn a_wave_is_where_its_frequency_is() {
        let wave: Vec<Option<f64>> =
            (0..64 * 64).map(|i| Some((2.0 * PI * 0.25 * f64::from(i % 64)).cos())).collect();
        let spectrum = Spectrum::of(64, 64, &wave);
        let rings = spectrum.radial(8);
        let loudest = (0..8).max_by(|&a, &b| rings[a].total_cmp(&rings[b])).unwrap();
        // f = 0.25 is the upper end of the fourth ring, the window spreads it into the fifth.
        assert!(loudest == 3 || loudest == 4, "{rings:?}");
        assert!(spectrum.low_frequency_share() < 1e-6);
    }

    #[test]
    fn a_constant_error_has_no_spectrum() {
        let constant = Spectrum::of(20, 12, &[Some(0.3); 240]);
        assert_eq!((constant.g(2.1), constant.low_frequency_share()), (0.0, 0.0));
        let single = Spectrum::of(1, 1, &[Some(1.0)]);
        assert_eq!((single.g(1.0), single.low_frequency(8.0)), (0.0, 0.0));
    }
}
