//! What is rendered, besides the scene and the technique.

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
    /// others it may have a fraction: with 2.4 each pixel gets two estimates, and 40 % of the pixels,
    /// others in each frame, a third.
    pub effort: f32,
    /// Frames a second of scene time.
    pub fps: u32,
}

impl Shot {
    /// Largest effort.
    pub const MOST_EFFORT: f32 = 1_048_576.0;

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
