//! OpenEXR pictures: one RGB picture, or a multi-part file with a part (layer) a guide.
//!
//! Layers written by `render`: `color` (R G B, reflected light and emission), `emission` (R G B,
//! directly visible emission and sky), `albedo` (R G B), `normal` (X Y Z, world space), `depth` (Z,
//! distance from the pinhole), `motion` (X Y, pixels since the previous frame).

use std::path::Path;

use exr::error::Error as ExrError;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, ImageAttributes, IntegerBounds,
    LayerAttributes, LineOrder, ReadChannels as _, ReadLayers as _, SmallVec, Text, Vec2,
    WritableImage as _,
};
use glam::Vec3;

use super::write_atomic;
use crate::picture::Picture;
use crate::{Error, Result};

/// A named part of an EXR file.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Empty for the only layer of a plain RGB file.
    pub name: String,
    /// Names and samples, row by row from the top.
    pub channels: Vec<(&'static str, Vec<f32>)>,
}

impl Layer {
    /// A colour picture: R, G, B.
    #[must_use]
    pub fn rgb(name: impl Into<String>, picture: &Picture) -> Self {
        Self::from_vectors(name, ["R", "G", "B"], &picture.pixels)
    }

    /// Directions: X, Y, Z.
    #[must_use]
    pub fn xyz(name: impl Into<String>, vectors: &[Vec3]) -> Self {
        Self::from_vectors(name, ["X", "Y", "Z"], vectors)
    }

    /// One number a pixel.
    #[must_use]
    pub fn scalar(name: impl Into<String>, channel: &'static str, values: Vec<f32>) -> Self {
        Self { name: name.into(), channels: vec![(channel, values)] }
    }

    fn from_vectors(name: impl Into<String>, names: [&'static str; 3], vectors: &[Vec3]) -> Self {
        let channel = |axis: usize| (names[axis], vectors.iter().map(|v| v[axis]).collect());
        Self { name: name.into(), channels: vec![channel(0), channel(1), channel(2)] }
    }
}

/// Writes layers of one size, 32-bit floats, lossless.
///
/// # Errors
/// Where the file cannot be written, there is no layer, or a channel has not `size[0] · size[1]`
/// samples.
pub fn write_exr(path: &Path, size: [u32; 2], layers: &[Layer]) -> Result<()> {
    let count = size[0] as usize * size[1] as usize;
    let dimensions = Vec2(size[0] as usize, size[1] as usize);
    if count == 0 || layers.is_empty() {
        return Err(
            Error::invalid("an EXR picture needs at least a pixel and a layer").with_path(path)
        );
    }
    let mut parts = SmallVec::new();
    for layer in layers {
        let mut list = SmallVec::new();
        for (name, samples) in &layer.channels {
            if samples.len() != count {
                let message = format!(
                    "layer `{}` has {} samples in channel {name}, but must have {count}",
                    layer.name,
                    samples.len()
                );
                return Err(Error::invalid(message).with_path(path));
            }
            list.push(AnyChannel::new(*name, FlatSamples::F32(samples.clone())));
        }
        let attributes = LayerAttributes {
            layer_name: (!layer.name.is_empty()).then(|| Text::from(layer.name.as_str())),
            software_name: Some(Text::from("afterimage")),
            ..LayerAttributes::default()
        };
        parts.push(exr::prelude::Layer::new(
            dimensions,
            attributes,
            // In order, so that equal pictures are equal files.
            Encoding { line_order: LineOrder::Increasing, ..Encoding::SMALL_FAST_LOSSLESS },
            AnyChannels::sort(list),
        ));
    }
    let image =
        Image::from_layers(ImageAttributes::new(IntegerBounds::from_dimensions(dimensions)), parts);
    write_atomic(path, |writer| {
        image.write().to_buffered(writer).map_err(|e| match e {
            ExrError::Io(e) => e,
            other => std::io::Error::other(other.to_string()),
        })
    })
}

/// What [`read_exr`] found.
#[derive(Clone, Debug)]
pub struct ExrPicture {
    /// The first layer with R, G, B (or Y, taken as grey).
    pub picture: Picture,
    /// The layer named `emission`, where there is one: directly visible emission, which metrics
    /// leave out.
    pub emission: Option<Picture>,
}

/// Reads the first RGB or Y layer of any EXR file, as linear floats. Alpha and deep data are
/// ignored; the data window is the picture.
///
/// # Errors
/// Where the file is missing, no EXR, or holds no such layer.
pub fn read_exr(path: &Path) -> Result<ExrPicture> {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_file(path)
        .map_err(|e| match e {
            ExrError::Io(e) => Error::io(path, e),
            ExrError::NotSupported(what) => {
                Error::unsupported(format!("EXR feature: {what}")).with_path(path)
            }
            other => Error::syntax(format!("not a readable EXR file: {other}")).with_path(path),
        })?;
    let mut picture = None;
    let mut emission = None;
    for layer in &image.layer_data {
        let find = |name: &str| {
            layer
                .channel_data
                .list
                .iter()
                .find(|c| c.name.to_string() == name)
                .map(|c| &c.sample_data)
        };
        let rgb = match (find("R"), find("G"), find("B"), find("Y")) {
            (Some(r), Some(g), Some(b), _) => [r, g, b],
            (_, _, _, Some(y)) => [y, y, y],
            _ => continue,
        };
        let Vec2(width, height) = layer.size;
        if rgb.iter().any(|c| c.len() != width * height) {
            let message =
                "its colour channels are subsampled; they must have a sample in every pixel";
            return Err(Error::unsupported(message).with_path(path));
        }
        let pixels = rgb[0]
            .values_as_f32()
            .zip(rgb[1].values_as_f32())
            .zip(rgb[2].values_as_f32())
            .map(|((r, g), b)| Vec3::new(r, g, b))
            .collect();
        let read = Picture { width: width as u32, height: height as u32, pixels };
        let name = layer.attributes.layer_name.as_ref().map(ToString::to_string);
        if name.as_deref() == Some("emission") {
            emission.get_or_insert(read);
        } else {
            picture.get_or_insert(read);
        }
    }
    let picture = picture.ok_or_else(|| {
        let found: Vec<String> = image
            .layer_data
            .iter()
            .flat_map(|l| &l.channel_data.list)
            .map(|c| c.name.to_string())
            .collect();
        Error::unsupported(format!(
            "found the channels {}, but R, G, B or Y are needed",
            found.join(", ")
        ))
        .with_path(path)
    })?;
    Ok(ExrPicture { picture, emission })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> std::path::PathBuf {
        std::env::temp_dir().join(format!("afterimage-exr-{name}-{}", std::process::id()))
    }

    fn gradient(scale: f32) -> Picture {
        let pixels = (0..6).map(|i| Vec3::new(i as f32, 10.0 + i as f32, 1e-20) * scale).collect();
        Picture { width: 3, height: 2, pixels }
    }

    #[test]
    fn rgb_and_layers_come_back_bit_for_bit() {
        let folder = folder("round");
        let plain = folder.join("plain.exr");
        write_exr(&plain, [3, 2], &[Layer::rgb("", &gradient(1.0))]).unwrap();
        let back = read_exr(&plain).unwrap();
        assert_eq!(back.picture.pixels, gradient(1.0).pixels);
        assert_eq!([back.picture.width, back.picture.height], [3, 2]);
        assert!(back.emission.is_none());

        let layered = folder.join("layers.exr");
        let layers = [
            Layer::rgb("color", &gradient(1.0)),
            Layer::rgb("emission", &gradient(0.5)),
            Layer::xyz("normal", &[Vec3::Z; 6]),
            Layer::scalar("depth", "Z", vec![2.0; 6]),
        ];
        write_exr(&layered, [3, 2], &layers).unwrap();
        let back = read_exr(&layered).unwrap();
        assert_eq!(back.picture.pixels, gradient(1.0).pixels);
        assert_eq!(back.emission.unwrap().pixels, gradient(0.5).pixels);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn refusals_are_typed_and_name_the_file() {
        let folder = folder("refuse");
        std::fs::create_dir_all(&folder).unwrap();
        let missing = read_exr(&folder.join("no.exr")).unwrap_err();
        assert!(
            missing.is_io() && missing.to_string().contains("no.exr: no such file"),
            "{missing}"
        );
        let garbage = folder.join("bad.exr");
        std::fs::write(&garbage, b"not an exr at all").unwrap();
        let error = read_exr(&garbage).unwrap_err();
        assert!(error.is_syntax() && error.path().is_some(), "{error}");
        let depth_only = folder.join("depth.exr");
        write_exr(&depth_only, [1, 1], &[Layer::scalar("depth", "Z", vec![1.0])]).unwrap();
        let error = read_exr(&depth_only).unwrap_err();
        assert!(error.is_unsupported() && error.to_string().contains("Z"), "{error}");
        let short =
            write_exr(&folder.join("short.exr"), [2, 2], &[Layer::scalar("depth", "Z", vec![1.0])]);
        assert!(short.unwrap_err().is_invalid());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
