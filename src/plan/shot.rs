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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shot {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Most segments of a path; 1 is directly visible emission only.
    pub depth: u32,
    /// Pixel filter.
    pub filter: Filter,
    /// Key of all random numbers; another run is an independent restart.
    pub run: u64,
    /// Complete independent estimates a frame, averaged.
    pub effort: u32,
    /// Frames a second of scene time.
    pub fps: u32,
}

impl Shot {
    /// Chains of a pixel, for techniques that keep reservoirs: the effort, which is whole for them.
    #[must_use]
    pub fn chains(&self) -> u32 {
        self.effort
    }

    /// Most estimates of a pixel in a frame.
    #[must_use]
    pub fn most_estimates(&self) -> u32 {
        self.effort
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}
