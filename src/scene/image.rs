//! Pictures in memory.

use glam::{Vec2, Vec4};

use super::Wrap;

/// A picture; row 0 is the top.
#[derive(Clone, Debug)]
pub struct Image {
    /// Pixels a row; positive.
    pub width: u32,
    /// Rows; positive.
    pub height: u32,
    /// `width · height` pixels, row by row.
    pub data: ImageData,
}

/// The pixels of an [`Image`].
#[derive(Clone, Debug)]
pub enum ImageData {
    /// sRGB-encoded colour, linear alpha: decoded before filtering.
    Srgb8(Vec<[u8; 4]>),
    /// Linear bytes (roughness, alpha and other data): value / 255.
    Linear8(Vec<[u8; 4]>),
    /// Linear floats.
    Float(Vec<[f32; 4]>),
}

impl Image {
    /// A pixel, linear RGBA.
    #[inline]
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> Vec4 {
        let at = (y * self.width + x) as usize;
        match &self.data {
            ImageData::Srgb8(data) => {
                let [r, g, b, a] = data[at];
                let table = srgb_table();
                Vec4::new(
                    table[r as usize],
                    table[g as usize],
                    table[b as usize],
                    f32::from(a) * (1.0 / 255.0),
                )
            }
            ImageData::Linear8(data) => {
                Vec4::from_array(data[at].map(|byte| f32::from(byte) * (1.0 / 255.0)))
            }
            ImageData::Float(data) => Vec4::from_array(data[at]),
        }
    }

    /// Bilinear value at `at`, with (0, 0) the upper left corner, (1, 1) the lower right one, pixel
    /// centres at half pixels.
    #[must_use]
    pub fn bilinear(&self, at: Vec2, wrap: Wrap) -> Vec4 {
        if !at.is_finite() {
            return Vec4::ZERO;
        }
        let x = Axis::new(at.x, self.width, wrap);
        let y = Axis::new(at.y, self.height, wrap);
        let fetch = |x: Option<u32>, y: Option<u32>| match (x, y) {
            (Some(x), Some(y)) => self.pixel(x, y),
            _ => Vec4::ZERO,
        };
        let top = fetch(x.low, y.low).lerp(fetch(x.high, y.low), x.fraction);
        let bottom = fetch(x.low, y.high).lerp(fetch(x.high, y.high), x.fraction);
        top.lerp(bottom, y.fraction)
    }
}

/// The two pixels that a coordinate lies between; `None` is outside.
struct Axis {
    low: Option<u32>,
    high: Option<u32>,
    fraction: f32,
}

impl Axis {
    fn new(at: f32, size: u32, wrap: Wrap) -> Self {
        // Repeat before scaling, so that the position inside the image keeps its precision far away
        // from it.
        let at = if wrap == Wrap::Repeat { at - at.floor() } else { at };
        let position = at * size as f32 - 0.5;
        let low = position.floor();
        let fraction = position - low;
        // Saturates for coordinates beyond i64, which only Clamp, Black and Mirror can see.
        let low = low as i64;
        let place = |i: i64| -> Option<u32> {
            let n = i64::from(size);
            match wrap {
                Wrap::Repeat => Some(i.rem_euclid(n) as u32),
                Wrap::Clamp => Some(i.clamp(0, n - 1) as u32),
                Wrap::Black => (0..n).contains(&i).then_some(i as u32),
                Wrap::Mirror => {
                    let m = i.rem_euclid(2 * n);
                    Some(if m < n { m } else { 2 * n - 1 - m } as u32)
                }
            }
        };
        Self { low: place(low), high: place(low.saturating_add(1)), fraction }
    }
}

/// sRGB electro-optical transfer function (IEC 61966-2-1) of all bytes.
pub(crate) fn srgb_table() -> &'static [f32; 256] {
    static TABLE: std::sync::LazyLock<[f32; 256]> = std::sync::LazyLock::new(|| {
        std::array::from_fn(|byte| {
            let value = byte as f64 / 255.0;
            (if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) })
                as f32
        })
    });
    &TABLE
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Image {
        Image { width: 2, height: 1, data: ImageData::Float(vec![[0.0; 4], [1.0; 4]]) }
    }

    /// Half-way over each edge lies the mean of the border and of what the mode puts beyond it.
    #[test]
    fn every_mode_at_every_edge() {
        let pixels = [1.0, 2.0, 4.0, 8.0].map(|v| [v; 4]);
        let image = Image { width: 2, height: 2, data: ImageData::Float(pixels.to_vec()) };
        // Left, right, upper and lower edge, at the centre of the first row or column.
        let edges = [[0.0, 0.25], [1.0, 0.25], [0.25, 0.0], [0.25, 1.0]].map(Vec2::from);
        for (wrap, expected) in [
            (Wrap::Repeat, [1.5, 1.5, 2.5, 2.5]),
            (Wrap::Clamp, [1.0, 2.0, 1.0, 4.0]),
            (Wrap::Mirror, [1.0, 2.0, 1.0, 4.0]),
            (Wrap::Black, [0.5, 1.0, 0.5, 2.0]),
        ] {
            // A little inside and, where what is beyond does not jump, outside.
            for inside in [0.999_999, 1.0, 1.000_001] {
                let middle = Vec2::splat(0.5);
                let found = edges.map(|at| image.bilinear(middle + (at - middle) * inside, wrap).x);
                for (found, expected) in found.into_iter().zip(expected) {
                    assert!((found - expected).abs() < 1e-4, "{wrap:?}: {found} {expected}");
                }
            }
        }
    }

    #[test]
    fn pixel_centres_are_exact_and_wrap_modes_differ_outside() {
        let image = ramp();
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Black, Wrap::Mirror] {
            assert_eq!(image.bilinear(Vec2::new(0.25, 0.5), wrap).x, 0.0);
            assert_eq!(image.bilinear(Vec2::new(0.75, 0.5), wrap).x, 1.0);
            assert_eq!(image.bilinear(Vec2::new(0.5, 0.5), wrap).x, 0.5);
        }
        let outside = Vec2::new(1.25, 0.5);
        assert_eq!(image.bilinear(outside, Wrap::Repeat).x, 0.0);
        assert_eq!(image.bilinear(outside, Wrap::Clamp).x, 1.0);
        assert_eq!(image.bilinear(outside, Wrap::Black).x, 0.0);
        assert_eq!(image.bilinear(outside, Wrap::Mirror).x, 1.0);
    }

    #[test]
    fn far_and_non_finite_coordinates_do_not_panic() {
        let image = ramp();
        for at in [1e30, -1e30, f32::INFINITY, f32::NAN] {
            for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Black, Wrap::Mirror] {
                assert!(image.bilinear(Vec2::splat(at), wrap).is_finite());
            }
        }
    }

    #[test]
    fn srgb_middle_grey() {
        assert!((srgb_table()[188] - 0.502_886_5).abs() < 1e-6, "{}", srgb_table()[188]);
    }
}
