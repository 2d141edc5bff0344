//! A stored outcome is used again while it is fresh (Wyman and Panteleev 2021).

use super::Policy;

/// Limits of [`super::Visibility::Reuse`] in production (the defaults of RTXDI, after Wyman and
/// Panteleev 2021): frames, pixels.
pub const REUSE_AGE: u32 = 4;
/// See [`REUSE_AGE`].
pub const REUSE_DISTANCE: u32 = 16;

/// [`super::Visibility::Reuse`] with its limits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StoredOutcome {
    /// Frames that an outcome may be old; 255: any number.
    pub(crate) max_age: u32,
    /// Pixels that a sample may have come from since; 0: its own pixel only.
    pub(crate) max_distance: u32,
}

impl Policy for StoredOutcome {
    const SHADES_BY_RAY: bool = true;
    const KEEPS_OUTCOME: bool = true;

    fn traced(self, _bits: u16, seen: bool) -> u16 {
        Reused::fresh(seen).pack()
    }

    fn a_frame_later(self, bits: u16) -> u16 {
        Reused::unpack(bits).moved(1, 0).pack()
    }

    fn pixels_away(self, bits: u16, pixels: u32) -> u16 {
        Reused::unpack(bits).moved(0, pixels).pack()
    }

    fn outcome(self, bits: u16) -> Option<bool> {
        let stored = Reused::unpack(bits);
        stored.usable(self.max_age, self.max_distance).then_some(stored.visible)
    }
}

/// An outcome that may be used again: 1 bit visible, 7 bits distance in pixels, 8 bits age in
/// frames, both saturating.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reused {
    /// What the ray said.
    pub visible: bool,
    /// Pixels between where the ray was and where the sample is now.
    pub distance: u32,
    /// Frames since the ray.
    pub age: u32,
}

impl Reused {
    /// An outcome of this frame and pixel.
    #[must_use]
    pub const fn fresh(visible: bool) -> Self {
        Self { visible, distance: 0, age: 0 }
    }

    /// 16 bits.
    #[inline]
    #[must_use]
    pub fn pack(self) -> u16 {
        let visible = u32::from(self.visible) << 15;
        (visible | self.distance.min(127) << 8 | self.age.min(255)) as u16
    }

    /// Inverse of [`Reused::pack`].
    #[inline]
    #[must_use]
    pub fn unpack(bits: u16) -> Self {
        let bits = u32::from(bits);
        Self { visible: bits >> 15 != 0, distance: bits >> 8 & 127, age: bits & 255 }
    }

    /// Moved by a frame or by pixels.
    #[inline]
    #[must_use]
    pub fn moved(self, frames: u32, pixels: u32) -> Self {
        Self { age: self.age + frames, distance: self.distance + pixels, ..self }
    }

    /// Whether it may be used; an age of 255 allows any.
    #[inline]
    #[must_use]
    pub fn usable(self, max_age: u32, max_distance: u32) -> bool {
        (self.age <= max_age || max_age >= 255) && self.distance <= max_distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_come_back_and_saturate() {
        for outcome in [
            Reused::fresh(true),
            Reused { visible: false, distance: 100, age: 200 },
            Reused { visible: true, distance: 127, age: 255 },
        ] {
            assert_eq!(Reused::unpack(outcome.pack()), outcome);
        }
        let far = Reused { visible: true, distance: 500, age: 900 };
        assert_eq!(Reused::unpack(far.pack()), Reused { distance: 127, age: 255, ..far });
        assert!(Reused::fresh(true).moved(4, 16).usable(4, 16));
        assert!(!Reused::fresh(true).moved(5, 16).usable(4, 16));
        assert!(!Reused::fresh(true).moved(4, 17).usable(4, 16));
        assert!(Reused::fresh(true).moved(1000, 0).usable(255, 0));
    }
}
