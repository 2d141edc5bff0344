//! Pictures from files: PNG, JPEG, Radiance HDR (crate `image`) and OpenEXR (crate `exr`),
//! recognised by their leading bytes.
//!
//! Sizes are checked in the header, before anything is decoded, so that a small file cannot ask for
//! much memory.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use crate::error::{Error, Result};
use crate::scene::{Image, ImageData};

/// Pixels a side.
const MAX_SIDE: u64 = 32_768;

/// Decoded bytes: 1 GiB.
const MAX_BYTES: u64 = 1 << 30;

/// What the numbers of an 8- or 16-bit picture mean. Float pictures are always linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// sRGB-encoded colour with linear alpha.
    Srgb,
    /// Linear data.
    Linear,
}

/// Reads a picture.
pub(super) fn load_image(path: &Path, encoding: Encoding) -> Result<Image> {
    image_from_bytes(&super::read(path)?, encoding).map_err(|e| e.with_path(path))
}

/// Decodes a picture. Errors carry no path.
pub(super) fn image_from_bytes(bytes: &[u8], encoding: Encoding) -> Result<Image> {
    // The decoders are other people's; a panic in one of them is an error of the file, not of the
    // program.
    let decoded = catch_unwind(AssertUnwindSafe(|| decode(bytes, encoding)));
    let image =
        decoded.unwrap_or_else(|_| Err(Error::syntax("damaged picture: its decoder failed")))?;
    if let ImageData::Float(data) = &image.data
        && let Some(at) = data.iter().position(|p| p.iter().any(|v| !v.is_finite()))
    {
        let (x, y) = (at as u32 % image.width, at as u32 / image.width);
        let message = format!("pixel ({x}, {y}) is {:?}; allowed: finite numbers", data[at]);
        return Err(Error::invalid(message));
    }
    Ok(image)
}

fn decode(bytes: &[u8], encoding: Encoding) -> Result<Image> {
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return decode_exr(bytes);
    }
    let format = ::image::guess_format(bytes).ok();
    let format =
        format.filter(|f| matches!(f, ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Hdr));
    let Some(format) = format else {
        return Err(Error::unsupported(
            "not a picture that is read; allowed: PNG, JPEG, HDR (Radiance), EXR",
        ));
    };
    let damaged =
        |e: ::image::ImageError| Error::syntax(format!("damaged {format:?} picture: {e}"));
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = ::image::Limits::default();
    limits.max_alloc = Some(2 * MAX_BYTES);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    let eight_bit = color.bytes_per_pixel() == color.channel_count();
    check_size(width.into(), height.into(), if eight_bit { 4 } else { 16 })?;
    let orientation = decoder.orientation().ok();
    let mut picture = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    if let Some(orientation) = orientation {
        picture.apply_orientation(orientation);
    }
    let (width, height) = (picture.width(), picture.height());
    let data = if eight_bit {
        let pixels = picture.into_rgba8().into_raw();
        let pixels = pixels.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect();
        match encoding {
            Encoding::Srgb => ImageData::Srgb8(pixels),
            Encoding::Linear => ImageData::Linear8(pixels),
        }
    } else {
        let linear = encoding == Encoding::Linear || format == ImageFormat::Hdr;
        let pixels = picture.into_rgba32f().into_raw();
        let decode = |v: f32| if linear { v } else { srgb_to_linear(v) };
        let pixels =
            pixels.chunks_exact(4).map(|p| [decode(p[0]), decode(p[1]), decode(p[2]), p[3]]);
        ImageData::Float(pixels.collect())
    };
    Ok(Image { width, height, data })
}

/// The sRGB electro-optical transfer function (IEC 61966-2-1).
fn srgb_to_linear(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

fn check_size(width: u64, height: u64, bytes_per_pixel: u64) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::invalid(format!(
            "the picture is {width} x {height} pixels; allowed: at least 1 x 1"
        )));
    }
    // Sides first, so that the product below cannot overflow.
    if width > MAX_SIDE || height > MAX_SIDE || width * height * bytes_per_pixel > MAX_BYTES {
        let message = format!(
            "the picture is {width} x {height} pixels; allowed: at most {MAX_SIDE} a side and {MAX_BYTES} bytes decoded"
        );
        return Err(Error::invalid(message));
    }
    Ok(())
}

/// The first flat layer: its channels R, G, B, A, or Y, or else its only one as grey.
fn decode_exr(bytes: &[u8]) -> Result<Image> {
    use exr::prelude::{ReadChannels, ReadLayers, Text, read};

    let damaged = |e: exr::error::Error| Error::syntax(format!("damaged EXR picture: {e}"));
    let about =
        exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    for header in &about.headers {
        let size = header.layer_size;
        let channels = header.channels.list.len().max(4) as u64;
        check_size(size.width() as u64, size.height() as u64, 4 * channels)?;
        if let exr::meta::BlockDescription::Tiles(tiles) = &header.blocks {
            check_size(
                tiles.tile_size.width() as u64,
                tiles.tile_size.height() as u64,
                4 * channels,
            )?;
        }
    }
    let reader = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes();
    let picture = reader.non_parallel().from_buffered(Cursor::new(bytes)).map_err(damaged)?;
    let layer = picture.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let list = &layer.channel_data.list;
    let names: Vec<String> = list.iter().map(|c| Text::to_string(&c.name)).collect();
    let prefix =
        names.iter().find_map(|n| n.strip_suffix('R').filter(|p| p.is_empty() || p.ends_with('.')));
    let find = |channel: &str| {
        let wanted = format!("{}{channel}", prefix.unwrap_or(""));
        names.iter().position(|n| {
            *n == names.iter().find(|m| **m == channel).map_or(wanted.clone(), String::clone)
        })
    };
    let grey = find("Y").or((list.len() == 1).then_some(0));
    let source = match (find("R"), find("G"), find("B"), grey) {
        (Some(r), Some(g), Some(b), _) => [Some(r), Some(g), Some(b), find("A")],
        (_, _, _, Some(y)) => [Some(y), Some(y), Some(y), find("A").filter(|a| *a != y)],
        _ => {
            let message = format!(
                "the EXR picture has the channels {}; allowed: R G B [A], Y [A], or a single one",
                names.join(", ")
            );
            return Err(Error::unsupported(message));
        }
    };
    let mut pixels = vec![[0.0, 0.0, 0.0, 1.0]; width * height];
    for (k, channel) in source.iter().enumerate() {
        let Some(channel) = channel else { continue };
        let samples = &list[*channel].sample_data;
        // Subsampled channels hold fewer values than there are pixels.
        if samples.len() != pixels.len() {
            return Err(Error::unsupported(
                "the EXR picture has subsampled channels; allowed: one value a pixel",
            ));
        }
        for (pixel, value) in pixels.iter_mut().zip(samples.values_as_f32()) {
            pixel[k] = value;
        }
    }
    Ok(Image { width: width as u32, height: height as u32, data: ImageData::Float(pixels) })
}
