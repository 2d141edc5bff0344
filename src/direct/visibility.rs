//! What is done with the outcomes of shadow rays, apart from how light points are chosen.
//!
//! | policy | rays a pixel and frame | shown |
//! |---|---|---|
//! | [`Visibility::Trace`] | 1 at shading | f(Y) V(Y) W |
//! | [`Visibility::InTarget`] | 1 initial, one in every evaluation of a target | f(Y) W, V(Y) being in W |
//! | [`Visibility::Bitterli`] | 1 initial, 1 at shading | f(Y) V(Y) W; occluded initial samples are dropped |
//! | [`Visibility::Reuse`] | 1 initial, 1 for samples whose visibility is too old or comes from too far | f(Y) V(Y) W with a stored V |
//! | [`Visibility::Wis`] | 1 initial, 1 a neighbour | f(Y) V̄ W, V̄ averaged along the chain |
//! | [`Visibility::WisControlVariate`] | 1 initial, 1 a neighbour, 1 for the history where anything moves | Σ mᵢ Fᵢ + Σ aᵢ (C̄ᵢ − F̃ᵢ) |
//!
//! Papers: Bitterli et al. (2020); Wyman and Panteleev (2021), *Rearchitecting Spatiotemporal Resampling for Production*; Tokuyoshi (2024).

use super::record::{pack_share, unpack_share};

/// Limits of [`Visibility::Reuse`] in production (the defaults of RTXDI, after Wyman and Panteleev 2021): frames, pixels.
pub const REUSE_AGE: u32 = 4;
/// See [`REUSE_AGE`].
pub const REUSE_DISTANCE: u32 = 16;

/// A visibility policy; see the module's table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// One ray at shading; targets know no visibility.
    Trace,
    /// Visibility is part of every target: the best samples, many rays.
    #[default]
    InTarget,
    /// Initial visibility is folded into W: fewer black samples, biased where pixels see different lights.
    Bitterli,
    /// A stored outcome is used again while it is fresh.
    Reuse,
    /// Outcomes are averaged under the distribution that the sample is drawn from.
    Wis,
    /// Outcomes correct an estimate that is kept beside the reservoir: unbiased for any weights and under motion.
    WisControlVariate,
}

impl Visibility {
    /// All, in the order of the module's table.
    pub const ALL: [Self; 6] = [
        Self::Trace,
        Self::InTarget,
        Self::Bitterli,
        Self::Reuse,
        Self::Wis,
        Self::WisControlVariate,
    ];

    /// As in a SPEC.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::InTarget => "in-target",
            Self::Bitterli => "bitterli",
            Self::Reuse => "reuse",
            Self::Wis => "wis",
            Self::WisControlVariate => "wis-cv",
        }
    }
}

/// An outcome that may be used again: 1 bit visible, 7 bits distance in pixels, 8 bits age in frames, both saturating.
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

/// An average visibility as a record keeps it.
#[inline]
pub(crate) fn pack_average(visibility: f32) -> u16 {
    pack_share(visibility)
}

/// Inverse of [`pack_average`].
#[inline]
pub(crate) fn unpack_average(bits: u16) -> f32 {
    unpack_share(bits)
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
