//! Finished reservoirs as they lie in the loop's buffers.

use bytemuck::{Pod, Zeroable};
use glam::Vec2;

use super::LightMeasure;
use crate::light::{LightPoint, NO_LIGHT};
use crate::resampling::{ContributionWeight, Finished};

/// A finished reservoir of one pixel: 24 bytes.
///
/// | bytes | field |
/// |---|---|
/// | 4 | light |
/// | 8 | place on it |
/// | 4 | W |
/// | 4 | p̂ of the sample at this pixel |
/// | 1 | confidence, 0 to 255: 0 where the surface scatters nothing, so that nothing is to be reused |
/// | 1 | age of the sample in frames, saturating |
/// | 2 | what the visibility policy keeps |
///
/// All zeros is an empty record without confidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Record {
    light: u32,
    uv: [f32; 2],
    weight: f32,
    /// p̂ of the sample at this pixel, 0 without one.
    pub target: f32,
    packed: u32,
}

/// Largest confidence that a record holds.
pub(crate) const MAX_CONFIDENCE: f32 = 255.0;

impl Record {
    /// A finished reservoir; `target` is p̂ of its sample, `policy_bits` whatever the visibility
    /// policy keeps.
    #[inline]
    #[must_use]
    pub fn new(
        finished: &Finished<LightPoint, LightMeasure>,
        target: f32,
        age: u32,
        policy_bits: u16,
    ) -> Self {
        let confidence = finished.confidence.min(MAX_CONFIDENCE) as u32;
        let packed = confidence | age.min(255) << 8 | u32::from(policy_bits) << 16;
        match finished.sample {
            Some(LightPoint { light, uv }) => {
                Self { light, uv: uv.to_array(), weight: finished.weight.get(), target, packed }
            }
            None => Self { light: NO_LIGHT, uv: [0.0; 2], weight: 0.0, target: 0.0, packed },
        }
    }

    /// The finished reservoir.
    #[inline]
    #[must_use]
    pub fn finished(&self) -> Finished<LightPoint, LightMeasure> {
        let confidence = self.confidence();
        if self.weight > 0.0 {
            let sample = LightPoint { light: self.light, uv: Vec2::from(self.uv) };
            Finished {
                sample: Some(sample),
                weight: ContributionWeight::new(self.weight),
                confidence,
            }
        } else {
            Finished::empty(confidence)
        }
    }

    /// c: 0 where the surface scatters nothing.
    #[inline]
    #[must_use]
    pub fn confidence(&self) -> f32 {
        (self.packed & 0xFF) as f32
    }

    /// Frames since the sample was a fresh candidate.
    #[inline]
    #[must_use]
    pub fn age(&self) -> u32 {
        self.packed >> 8 & 0xFF
    }

    /// The visibility policy's 16 bits.
    #[inline]
    #[must_use]
    pub fn policy_bits(&self) -> u16 {
        (self.packed >> 16) as u16
    }

    /// Its fields for people, as names and values.
    pub(crate) fn describe(&self) -> Vec<(&'static str, String)> {
        let confidence = ("confidence", self.confidence().to_string());
        let Finished { sample: Some(LightPoint { light, uv }), weight, .. } = self.finished()
        else {
            return vec![("sample", "none".to_string()), confidence];
        };
        vec![
            ("light", light.to_string()),
            ("at", format!("({:.3}, {:.3})", uv.x, uv.y)),
            ("target", format!("{:.3e}", self.target)),
            ("W", format!("{:.3e}", weight.get())),
            confidence,
            ("age", self.age().to_string()),
            ("policy bits", format!("{:#06x}", self.policy_bits())),
        ]
    }

    /// The same without its sample; its confidence stays.
    #[inline]
    #[must_use]
    pub fn emptied(&self) -> Self {
        Self { light: NO_LIGHT, uv: [0.0; 2], weight: 0.0, target: 0.0, packed: self.packed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_24_bytes_and_come_back() {
        assert_eq!(size_of::<Record>(), 24);
        let sample = LightPoint { light: 7, uv: Vec2::new(0.25, 0.75) };
        let finished = Finished {
            sample: Some(sample),
            weight: ContributionWeight::new(3.5),
            confidence: 21.0,
        };
        let record = Record::new(&finished, 2.0, 300, 12345);
        assert_eq!(record.finished(), finished);
        assert_eq!((record.target, record.age(), record.policy_bits()), (2.0, 255, 12345));
        assert_eq!(record.emptied().finished(), Finished::empty(21.0));
        let empty = Record::zeroed();
        assert_eq!((empty.confidence(), empty.finished().sample), (0.0, None));
        let many = Finished { confidence: 1e9, ..finished };
        assert_eq!(Record::new(&many, 2.0, 0, 0).confidence(), 255.0);
    }
}
