//! Pictures from files: PNG, JPEG, TGA, Radiance HDR (crate `image`), OpenEXR (crate `exr`), PFM,
//! recognised by their leading bytes.
//!
//! Sizes are checked in the header, before anything is decoded, so that a small file cannot ask for
//! much memory.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use glam::Vec4;

use crate::error::{Error, Result};
use crate::scene::{Image, ImageData};

/// Pixels a side.
const MAX_SIDE: u64 = 32_768;

/// Decoded bytes: 1 GiB.
const MAX_BYTES: u64 = 1 << 30;

/// What is read, for messages.
const FORMATS: &str = "PNG, JPEG, TGA, HDR (Radiance), PFM, EXR";

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
        let message =
            format!("pixel ({x}, {y}) is {}; allowed: finite numbers", Vec4::from(data[at]));
        return Err(Error::invalid(message));
    }
    Ok(image)
}

fn decode(bytes: &[u8], encoding: Encoding) -> Result<Image> {
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return decode_exr(bytes);
    }
    if bytes.starts_with(b"PF") || bytes.starts_with(b"Pf") {
        return decode_pfm(bytes);
    }
    let known = [
        (ImageFormat::Png, "PNG"),
        (ImageFormat::Jpeg, "JPEG"),
        (ImageFormat::Hdr, "HDR"),
        (ImageFormat::Tga, "TGA"),
    ];
    // TGA begins with nothing of its own: what nothing else claims and fits its header.
    let guessed = ::image::guess_format(bytes).ok();
    let guessed = guessed.or_else(|| is_tga(bytes).then_some(ImageFormat::Tga));
    let Some(&(format, name)) = known.iter().find(|(format, _)| Some(*format) == guessed) else {
        return Err(Error::unsupported(format!("not a picture that is read; allowed: {FORMATS}")));
    };
    let damaged = |e: ::image::ImageError| damaged(name, &e);
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

/// What a decoder stumbled over, in words: its own may hold the names of its types.
fn damaged(format: &str, error: &::image::ImageError) -> Error {
    use ::image::ImageError as E;
    let what = match error {
        E::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => "it ends too early",
        E::IoError(_) => "its bytes cannot be read",
        E::Limits(_) => "it is larger than is allowed",
        E::Unsupported(_) => "it is of a kind that is not read",
        E::Decoding(_) | E::Encoding(_) | E::Parameter(_) => "its bytes are not of that format",
    };
    Error::syntax(format!("damaged {format} picture: {what}"))
}

/// Whether a TGA header (Truevision 1991) stands at the front: colour map type, image type, sides
/// above 0, bits a pixel, and no interleaving.
fn is_tga(bytes: &[u8]) -> bool {
    let Some(header) = bytes.get(..18) else { return false };
    let mapped = matches!(header[2], 1 | 9);
    matches!(header[2], 1 | 2 | 3 | 9 | 10 | 11)
        && (header[1] == 1 || (header[1] == 0 && !mapped))
        && (header[12], header[13]) != (0, 0)
        && (header[14], header[15]) != (0, 0)
        && matches!(header[16], 8 | 15 | 16 | 24 | 32)
        && header[17] >> 6 == 0
}

/// A portable float map: `PF` (colours) or `Pf` (grey), width, height and a scale as text, each
/// with one white space behind it, then rows of f32 from the bottom up. A negative scale says
/// little-endian; its magnitude is a factor.
fn decode_pfm(bytes: &[u8]) -> Result<Image> {
    let damaged = |what: &str| Error::syntax(format!("damaged PFM picture: {what}"));
    let channels = if bytes.starts_with(b"PF") { 3 } else { 1 };
    let mut rest = &bytes[2..];
    let mut word = || -> Option<&str> {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let length = rest[start..].iter().position(u8::is_ascii_whitespace)?;
        let word = std::str::from_utf8(&rest[start..start + length]).ok()?;
        rest = &rest[start + length + 1..];
        Some(word)
    };
    let mut side = || word().and_then(|word| word.parse::<u32>().ok());
    let (Some(width), Some(height)) = (side(), side()) else {
        return Err(damaged("its header has no width and height"));
    };
    let scale = word().and_then(|word| word.parse::<f32>().ok());
    let Some(scale) = scale.filter(|scale| scale.is_finite() && *scale != 0.0) else {
        return Err(damaged("its header has no scale; allowed: any number but 0"));
    };
    check_size(width.into(), height.into(), 16)?;
    let row = 4 * channels * width as usize;
    if rest.len() < row * height as usize {
        return Err(damaged("it ends too early"));
    }
    let number = |b: &[u8]| {
        let b = [b[0], b[1], b[2], b[3]];
        let value = if scale < 0.0 { f32::from_le_bytes(b) } else { f32::from_be_bytes(b) };
        value * scale.abs()
    };
    let rows = rest[..row * height as usize].chunks_exact(row).rev();
    let pixels = rows.flat_map(|row| row.chunks_exact(4 * channels)).map(|pixel| {
        let [r, g, b] = [0, 1, 2].map(|c| number(&pixel[4 * (c % channels)..]));
        [r, g, b, 1.0]
    });
    Ok(Image { width, height, data: ImageData::Float(pixels.collect()) })
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

    let damaged = |e: exr::error::Error| {
        let what = match e {
            exr::error::Error::NotSupported(_) => "it is of a kind that is not read",
            exr::error::Error::Io(_) => "it ends too early",
            _ => "its bytes are not of that format",
        };
        Error::syntax(format!("damaged EXR picture: {what}"))
    };
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
