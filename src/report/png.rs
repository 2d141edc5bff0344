//! Pictures to look at.
//!
//! Exposure: the factor that brings the median luminance of the reference's lit pixels' luminances
//! to 0.18 (the photographic middle grey); the same factor for every picture of a comparison. Then
//! each channel is clipped to [0, 1] and encoded as sRGB (IEC 61966-2-1). Clipping, not a filmic
//! curve, so that equal pixels mean equal radiance up to the clip.
//!
//! Error maps show the signed relative luminance error (x − r) / (r + 0.01 r̄), r̄ the reference's
//! mean, on a fixed scale: blue −1 (too dark) over white 0 to red +1 (too bright).

use std::path::Path;

use glam::Vec3;

use super::write_atomic;
use crate::math::luminance;
use crate::picture::Picture;
use crate::{Error, Result};

/// Scene-linear to display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMap {
    /// Factor before clipping.
    pub exposure: f32,
}

impl ToneMap {
    /// Exposes so that the median luminance of `reference` becomes 0.18. Black pixels do not count,
    /// so that a picture that is mostly black keeps a sensible exposure; an all-black one gets 1.
    #[must_use]
    pub fn for_reference(reference: &Picture) -> Self {
        let mut values: Vec<f32> = reference
            .pixels
            .iter()
            .map(|p| luminance(*p))
            .filter(|l| *l > 0.0 && l.is_finite())
            .collect();
        if values.is_empty() {
            return Self { exposure: 1.0 };
        }
        let middle = values.len() / 2;
        let (_, median, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
        // A median so small that its reciprocal overflows cannot be exposed for.
        let exposure = 0.18 / *median;
        Self { exposure: if exposure.is_finite() { exposure } else { 1.0 } }
    }

    /// Three sRGB bytes of a pixel.
    #[must_use]
    pub fn encode(self, pixel: Vec3) -> [u8; 3] {
        (pixel * self.exposure).to_array().map(srgb_byte)
    }
}

/// The sRGB byte of a linear value; NaN is shown as 0.
fn srgb_byte(value: f32) -> u8 {
    let v = value.clamp(0.0, 1.0);
    let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    // `as` saturates and takes NaN to 0.
    (255.0 * encoded + 0.5) as u8
}

/// A picture ready for display, one of a [`contact_sheet`].
#[derive(Clone, Debug)]
pub struct Tile {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB, row by row from the top.
    pub pixels: Vec<[u8; 3]>,
}

impl Tile {
    /// A picture under a tone map.
    #[must_use]
    pub fn new(picture: &Picture, tone: ToneMap) -> Self {
        let pixels = picture.pixels.iter().map(|p| tone.encode(*p)).collect();
        Self { width: picture.width, height: picture.height, pixels }
    }
}

/// The signed relative luminance error of `picture` (see the module's head).
#[must_use]
pub fn error_map(picture: &Picture, reference: &Picture) -> Tile {
    let sum: f64 = reference.pixels.iter().map(|p| f64::from(luminance(*p))).sum();
    let floor = (0.01 * sum / reference.pixels.len().max(1) as f64) as f32;
    let pixels = picture
        .pixels
        .iter()
        .zip(&reference.pixels)
        .map(|(x, r)| {
            let (x, r) = (luminance(*x), luminance(*r));
            let scale = r + floor;
            diverging(if scale > 0.0 { (x - r) / scale } else { 0.0 })
        })
        .collect();
    Tile { width: picture.width, height: picture.height, pixels }
}

/// Blue at −1, white at 0, red at 1.
fn diverging(value: f32) -> [u8; 3] {
    const BLUE: Vec3 = Vec3::new(0.13, 0.30, 0.75);
    const RED: Vec3 = Vec3::new(0.75, 0.10, 0.15);
    let v = value.clamp(-1.0, 1.0);
    let end = if v < 0.0 { BLUE } else { RED };
    Vec3::ONE.lerp(end, v.abs()).to_array().map(|c| (255.0 * c + 0.5) as u8)
}

/// Rows of tiles on a grey ground, a gap of 4 pixels between them; rows may be of unequal length,
/// and start at the left.
#[must_use]
pub fn contact_sheet(rows: &[Vec<Option<Tile>>]) -> Tile {
    const GAP: u32 = 4;
    const GROUND: [u8; 3] = [64; 3];
    let tiles = || rows.iter().flatten().flatten();
    let cell_width = tiles().map(|t| t.width).max().unwrap_or(0);
    let cell_height = tiles().map(|t| t.height).max().unwrap_or(0);
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let width = columns * (cell_width + GAP) + GAP;
    let height = rows.len() as u32 * (cell_height + GAP) + GAP;
    let mut pixels = vec![GROUND; width as usize * height as usize];
    for (row, tiles) in rows.iter().enumerate() {
        for (column, tile) in tiles.iter().enumerate() {
            let Some(tile) = tile else { continue };
            let left = GAP + column as u32 * (cell_width + GAP);
            let top = GAP + row as u32 * (cell_height + GAP);
            for y in 0..tile.height {
                let from = (y * tile.width) as usize;
                let to = (top + y) as usize * width as usize + left as usize;
                let count = tile.width as usize;
                pixels[to..to + count].copy_from_slice(&tile.pixels[from..from + count]);
            }
        }
    }
    Tile { width, height, pixels }
}

/// Writes 8-bit sRGB.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_png(path: &Path, tile: &Tile) -> Result<()> {
    use image::ImageEncoder as _;
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(
            tile.pixels.as_flattened(),
            tile.width,
            tile.height,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|e| Error::invalid(format!("cannot encode a PNG: {e}")).with_path(path))?;
    write_atomic(path, |writer| std::io::Write::write_all(writer, &bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(value: f32) -> Picture {
        Picture { width: 2, height: 2, pixels: vec![Vec3::splat(value); 4] }
    }

    #[test]
    fn the_median_becomes_middle_grey() {
        let tone = ToneMap::for_reference(&flat(7.0));
        // sRGB encodes 0.18 as 0.4614, 117.7 of 255.
        assert_eq!(tone.encode(Vec3::splat(7.0)), [118; 3]);
        assert_eq!(ToneMap::for_reference(&flat(0.0)).exposure, 1.0);
        assert_eq!(tone.encode(Vec3::new(f32::NAN, f32::INFINITY, -1.0)), [0, 255, 0]);
    }

    #[test]
    fn error_maps_are_white_where_equal_and_signed_elsewhere() {
        assert_eq!(error_map(&flat(1.0), &flat(1.0)).pixels[0], [255; 3]);
        let bright = error_map(&flat(3.0), &flat(1.0)).pixels[0];
        let dark = error_map(&flat(0.0), &flat(1.0)).pixels[0];
        assert!(bright[0] > bright[2] && dark[2] > dark[0], "{bright:?} {dark:?}");
        assert_eq!(error_map(&flat(0.0), &flat(0.0)).pixels[0], [255; 3]);
    }

    #[test]
    fn a_sheet_places_its_tiles() {
        let tile = Tile { width: 2, height: 1, pixels: vec![[1; 3], [2; 3]] };
        let sheet = contact_sheet(&[vec![Some(tile.clone()), None], vec![None, Some(tile)]]);
        assert_eq!([sheet.width, sheet.height], [16, 14]);
        assert_eq!(sheet.pixels[4 * 16 + 5], [2; 3]);
        assert_eq!(sheet.pixels[9 * 16 + 10], [1; 3]);
        assert_eq!(sheet.pixels[4 * 16 + 10], [64; 3]);
        assert_eq!(contact_sheet(&[]).width, 4);
    }
}
