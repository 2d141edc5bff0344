//! A picture of linear RGB values: what the frame loop gives and what metrics read.

use glam::Vec3;

use crate::math::luminance;

/// Linear RGB, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` values.
    pub pixels: Vec<Vec3>,
}

impl Picture {
    /// A picture of the given pixels.
    ///
    /// # Panics
    /// If there are not exactly `width · height` of them.
    #[must_use]
    pub fn new(width: u32, height: u32, pixels: Vec<Vec3>) -> Self {
        assert_eq!(
            pixels.len(),
            width as usize * height as usize,
            "a {width}x{height} picture has {} pixels",
            pixels.len()
        );
        Self { width, height, pixels }
    }

    /// A picture of one colour.
    #[must_use]
    pub fn filled(width: u32, height: u32, value: Vec3) -> Self {
        Self::new(width, height, vec![value; width as usize * height as usize])
    }

    /// The pixel in column `x` of row `y`.
    #[inline]
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> Vec3 {
        self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// Mean luminance, summed in f64.
    #[must_use]
    pub fn mean_luminance(&self) -> f64 {
        self.pixels.iter().map(|p| f64::from(luminance(*p))).sum::<f64>() / self.pixels.len() as f64
    }

    /// Number of pixels with a component that is not finite.
    #[must_use]
    pub fn non_finite(&self) -> usize {
        self.pixels.iter().filter(|p| !p.is_finite()).count()
    }
}
