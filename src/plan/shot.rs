//! What is rendered, besides the scene and the technique.

use crate::error::{Error, Result};

/// Where in a pixel primary rays pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Through its centre, the same in every frame.
    Point,
    /// Anywhere, uniformly; drawn anew for every pixel, frame and sample.
    Box,
}

/// What is rendered, besides the scene and the technique.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Most segments of a path; 1 is directly visible emission only.
    pub depth: u32,
    /// Pixel filter.
    pub filter: Filter,
    /// Key of all random numbers; another run is an independent restart.
    pub run: u64,
    /// Complete independent estimates a pixel and frame, averaged; at least 1.
    ///
    /// A technique that keeps reservoirs has as many chains of them, so its effort is whole. For
    /// others it may have a fraction: with 2.4 each pixel gets two estimates, and 40 % of the
    /// pixels, others in each frame, a third.
    pub effort: f32,
    /// Frames a second of scene time.
    pub fps: u32,
}

impl Shot {
    /// Largest effort.
    pub const MOST_EFFORT: f32 = 1_048_576.0;

    /// Refuses a shot that no loop renders.
    ///
    /// # Errors
    /// A picture without pixels or with 2³¹ or more, a depth of 0, an effort that is not in
    /// [1, [`Shot::MOST_EFFORT`]], no frames a second.
    pub fn validate(&self) -> Result<()> {
        let Self { size: [width, height], depth, filter: _, run: _, effort, fps } = *self;
        let pixels = u64::from(width) * u64::from(height);
        if pixels == 0 || pixels >= 1 << 31 {
            return Err(Error::usage(format!(
                "the picture is {width}x{height}, but must have between 1 and 2^31 - 1 pixels"
            )));
        }
        if depth == 0 || fps == 0 {
            return Err(Error::usage(format!("depth {depth}, fps {fps}: each must be at least 1")));
        }
        if !(1.0..=Self::MOST_EFFORT).contains(&effort) {
            let most = Self::MOST_EFFORT;
            return Err(Error::usage(format!("effort is {effort}, but must be in [1, {most}]")));
        }
        Ok(())
    }

    /// Chains of a pixel, for techniques that keep reservoirs: the effort, which is whole for them.
    #[must_use]
    pub fn chains(&self) -> u32 {
        self.effort as u32
    }

    /// Fewest and most estimates of a pixel in a frame.
    #[must_use]
    pub fn estimates(&self) -> [u32; 2] {
        [self.effort.floor() as u32, self.effort.ceil() as u32]
    }

    /// Most estimates of a pixel in a frame.
    #[must_use]
    pub fn most_estimates(&self) -> u32 {
        self.estimates()[1]
    }

    /// The share of pixels that get one estimate more than others, in 2⁻³² of the picture; 0 where
    /// the effort is whole.
    #[must_use]
    pub fn extra_share(&self) -> u32 {
        // The product is below 2³², and exact: a fraction of an f32 has at most 24 bits.
        (f64::from(self.effort.fract()) * 4_294_967_296.0) as u32
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}
