//! The control variate's state: an earlier estimate C̄ and whether the selected sample is seen, in
//! 8 bytes.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// C̄ in RGB, signed, with one exponent for all channels, and V of the selected sample.
///
/// Three 16-bit mantissas and an exponent of 15 bits: the largest channel keeps 15 bits, and a
/// picture twice as bright has the same mantissas. Halves (f16) would overflow at 65,504 and lose
/// dim scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Control {
    mantissas: [i16; 3],
    /// Bit 15: visible. Bits 0 to 14: exponent + 2¹⁴.
    flags: u16,
}

const BIAS: i32 = 1 << 14;

impl Control {
    /// Rounds to nearest. The estimate must be finite ([`crate::path::finite_or_counted`]).
    #[inline]
    #[must_use]
    pub fn new(estimate: Vec3, visible: bool) -> Self {
        debug_assert!(estimate.is_finite(), "an estimate to be kept is {estimate}");
        let largest = estimate.abs().max_element();
        let visible = u16::from(visible) << 15;
        if largest == 0.0 {
            return Self { mantissas: [0; 3], flags: visible | BIAS as u16 };
        }
        // largest < 2^exponent, so mantissas are below 2^15, or round to it, which does not fit.
        let exponent = exponent_above(largest);
        let scale = power_of_two(15 - exponent);
        let mantissas = estimate
            .to_array()
            .map(|v| (f64::from(v) * scale).round().clamp(-32767.0, 32767.0) as i16);
        Self { mantissas, flags: visible | (exponent + BIAS) as u16 }
    }

    /// C̄.
    #[inline]
    #[must_use]
    pub fn estimate(self) -> Vec3 {
        let exponent = i32::from(self.flags & 0x7FFF) - BIAS;
        let scale = power_of_two(exponent - 15);
        Vec3::from(self.mantissas.map(|m| (f64::from(m) * scale) as f32))
    }

    /// Whether the selected sample is seen from where the record is.
    #[inline]
    #[must_use]
    pub fn visible(self) -> bool {
        self.flags >> 15 != 0
    }
}

/// 2^e for normal results; below, as for a record of zeros, the least normal number.
#[inline]
fn power_of_two(e: i32) -> f64 {
    f64::from_bits(((e.max(-1022) + 1023) as u64) << 52)
}

/// The smallest e with |x| < 2^e, for positive finite x.
#[inline]
fn exponent_above(x: f32) -> i32 {
    let bits = x.to_bits();
    match bits >> 23 & 0xFF {
        0 => 32 - bits.leading_zeros() as i32 - 149,
        exponent => exponent as i32 - 126,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_come_back_to_2_to_the_minus_15_at_any_scale() {
        assert_eq!(size_of::<Control>(), 8);
        for k in (-140..=126).step_by(7) {
            let scale = f64::from(k).exp2() as f32;
            let estimate = Vec3::new(1.5, -0.3, 0.001) * scale;
            let back = Control::new(estimate, true);
            assert!(back.visible());
            let error = (back.estimate() - estimate).abs().max_element();
            assert!(error <= 1.5 * scale / 32768.0, "2^{k}: {estimate} as {}", back.estimate());
        }
        assert_eq!(Control::new(Vec3::ZERO, false).estimate(), Vec3::ZERO);
        assert!(!Control::new(Vec3::ONE, false).visible());
        assert_eq!(Control::zeroed().estimate().max_element(), 0.0);
        assert!(Control::new(Vec3::splat(f32::MAX), true).estimate().is_finite());
    }

    #[test]
    fn a_power_of_two_changes_no_mantissa() {
        let a = Control::new(Vec3::new(0.7, 0.2, -0.9), true);
        let b = Control::new(Vec3::new(0.7, 0.2, -0.9) * 1024.0, true);
        assert_eq!(a.mantissas, b.mantissas);
        assert_eq!(b.estimate(), a.estimate() * 1024.0);
    }
}
