//! `Texture`, and the look-up of textures by materials.

use glam::{Affine2, Mat2, Vec2, Vec3, Vec4, Vec4Swizzles};

use super::params::{Params, Place, Type};
use super::spectrum::{self, Role};
use super::{Builder, Encoding, File, list, shorten};
use crate::error::{Result, suggest};
use crate::scene::load::picture;
use crate::scene::{Channel, Color, Image, ImageData, ImageId, Scalar, Texture, TextureKind, Wrap};

const KINDS: [&str; 4] = ["imagemap", "checkerboard", "constant", "scale"];

/// The types of a colour.
const COLOR: [Type; 5] = [Type::Rgb, Type::Spectrum, Type::Texture, Type::Float, Type::Blackbody];

/// Whether a texture holds numbers or colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holds {
    Numbers,
    Colors,
}

impl Builder {
    pub(super) fn make_texture(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let name = file.quoted("a texture's name")?;
        let holds = match file.quoted("the texture's type")?.as_str() {
            "float" => Holds::Numbers,
            "spectrum" => Holds::Colors,
            other => {
                return place.syntax(format!(
                    "found the texture type \"{}\"; allowed: float, spectrum",
                    shorten(other)
                ));
            }
        };
        let (kind, params) = file.params("Texture", place, &self.state.defaults.texture)?;
        let texture = match kind.as_str() {
            "imagemap" => self.imagemap(&params, holds)?,
            "checkerboard" => {
                if let Some(dimension) = params.integer("dimension")?.filter(|d| *d != 2) {
                    return params
                        .param_place("dimension")
                        .unsupported(format!("`dimension` is {dimension}; allowed: 2"));
                }
                let first = self.operand(&params, "tex1", Vec3::ONE, holds)?;
                let second = self.operand(&params, "tex2", Vec3::ZERO, holds)?;
                Texture {
                    kind: TextureKind::Checkerboard { first, second },
                    mapping: mapping(&params)?,
                }
            }
            "constant" => match self.operand(&params, "value", Vec3::ONE, holds)? {
                Color::Constant(value) => constant(value),
                Color::Texture(id) => self.scene.textures[id.index()],
            },
            "scale" => {
                let first = self.operand(&params, "tex", Vec3::ONE, holds)?;
                let second = self.operand(&params, "scale", Vec3::ONE, Holds::Numbers)?;
                match (first, second) {
                    (Color::Constant(a), Color::Constant(b)) => constant(a * b),
                    (first, second) => {
                        let [first, second] = [first, second].map(|color| match color {
                            Color::Constant(value) => self.scene.add_texture(constant(value)),
                            Color::Texture(id) => id,
                        });
                        Texture {
                            kind: TextureKind::Product { first, second },
                            mapping: Affine2::IDENTITY,
                        }
                    }
                }
            }
            other => {
                let known = suggest(&shorten(other), &KINDS);
                return place.unsupported(format!("Texture class \"{}\"; {known}", shorten(other)));
            }
        };
        params.finish(&mut self.warnings);
        let id = self.scene.add_texture(texture);
        let table = match holds {
            Holds::Numbers => &mut self.float_textures,
            Holds::Colors => &mut self.color_textures,
        };
        table.insert(name, id);
        Ok(())
    }

    fn imagemap(&mut self, params: &Params, holds: Holds) -> Result<Texture> {
        let place = params.param_place("filename").clone();
        let Some(name) = params.string("filename")?.map(str::to_string) else {
            return place.invalid(
                "an imagemap without `filename`; allowed: the name of a PNG, JPEG, TGA, HDR, PFM or EXR file",
            );
        };
        let encoding = match params.word_or("encoding", "sRGB", &["sRGB", "linear"])? {
            "linear" => Encoding::Linear,
            _ => Encoding::Srgb,
        };
        let wrap = match params.word_or(
            "wrap",
            "repeat",
            &["repeat", "clamp", "black", "octahedralsphere"],
        )? {
            "clamp" => Wrap::Clamp,
            "black" => Wrap::Black,
            "octahedralsphere" => {
                return params
                    .param_place("wrap")
                    .unsupported("`wrap` is octahedralsphere; allowed: repeat, clamp, black");
            }
            _ => Wrap::Repeat,
        };
        let scale = params.float_or("scale", 1.0)?;
        if scale < 0.0 {
            return params
                .param_place("scale")
                .invalid(format!("`scale` is {scale}; allowed: 0 or more"));
        }
        let invert = params.bool_or("invert", false)?;
        // Images are read bilinear: the choice of a filter changes less than a pixel's footprint.
        params.ignore(&["filter", "maxanisotropy"]);
        let mapping = mapping(params)?;
        let image = self.image(&name, &place, encoding, holds == Holds::Numbers)?;
        Ok(Texture {
            kind: TextureKind::Image { image, wrap, scale: scale as f32, invert },
            mapping,
        })
    }

    /// An input of another texture.
    fn operand(
        &mut self,
        params: &Params,
        name: &'static str,
        default: Vec3,
        holds: Holds,
    ) -> Result<Color> {
        match holds {
            Holds::Colors => self.color(params, name, default, Role::Index),
            Holds::Numbers => {
                let scalar = self.scalar(params, name, default.x)?;
                Ok(match scalar {
                    Scalar::Constant(value) => Color::Constant(Vec3::splat(value)),
                    Scalar::Texture(id, _) => Color::Texture(id),
                })
            }
        }
    }

    /// A picture of a file, read once. With `gray`, all channels hold what pbrt reads as a number:
    /// alpha where it is not 1 everywhere, else the mean of red, green and blue.
    pub(super) fn image(
        &mut self,
        name: &str,
        place: &Place,
        encoding: Encoding,
        gray: bool,
    ) -> Result<ImageId> {
        let path = self.resolve(name, place);
        let key = (path, encoding, gray);
        if let Some(id) = self.images.get(&key) {
            return Ok(*id);
        }
        let image =
            picture::load_image(&key.0, encoding).map_err(|e| super::about_file(name, place, e))?;
        let image = if gray { to_gray(image) } else { image };
        let id = self.scene.add_image(image);
        self.images.insert(key, id);
        Ok(id)
    }

    /// A colour parameter, constant or textured.
    pub(super) fn color(
        &mut self,
        params: &Params,
        name: &'static str,
        default: Vec3,
        role: Role,
    ) -> Result<Color> {
        let Some(param) = params.typed(name, &COLOR)? else { return Ok(Color::Constant(default)) };
        if param.kind != Type::Texture {
            return Ok(Color::Constant(spectrum::rgb(param, role)?));
        }
        let name = param.text()?;
        let Some(id) = self.color_textures.get(name).copied() else {
            let known = list(name, self.color_textures.keys().map(String::as_str));
            return param
                .place
                .invalid(format!("no spectrum texture \"{}\"; {known}", shorten(name)));
        };
        match self.scene.textures[id.index()].kind {
            TextureKind::Constant(value) => {
                let value = value.xyz();
                if role == Role::Albedo && value.max_element() > 1.0 {
                    return param.place.invalid(format!(
                        "the texture \"{}\" is {value}; allowed in each channel: 0 to 1",
                        shorten(name)
                    ));
                }
                Ok(Color::Constant(value))
            }
            _ => Ok(Color::Texture(id)),
        }
    }

    /// A number parameter, constant or textured.
    pub(super) fn scalar(
        &mut self,
        params: &Params,
        name: &'static str,
        default: f32,
    ) -> Result<Scalar> {
        let Some(param) = params.typed(name, &[Type::Float, Type::Texture])? else {
            return Ok(Scalar::Constant(default));
        };
        if param.kind == Type::Float {
            return Ok(Scalar::Constant(param.single()?.numbers()[0] as f32));
        }
        let name = param.text()?;
        let Some(id) = self.float_textures.get(name).copied() else {
            let known = list(name, self.float_textures.keys().map(String::as_str));
            return param.place.invalid(format!("no float texture \"{}\"; {known}", shorten(name)));
        };
        Ok(match self.scene.textures[id.index()].kind {
            TextureKind::Constant(value) => Scalar::Constant(value.x),
            _ => Scalar::Texture(id, Channel::Mean),
        })
    }

    /// `color` times a number.
    pub(super) fn scaled(&mut self, color: Color, factor: f32) -> Color {
        match color {
            Color::Constant(value) => Color::Constant(value * factor),
            Color::Texture(id) if factor == 1.0 => Color::Texture(id),
            Color::Texture(first) => {
                let second = self.scene.add_texture(constant(Vec3::splat(factor)));
                let kind = TextureKind::Product { first, second };
                Color::Texture(self.scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY }))
            }
        }
    }
}

fn constant(value: Vec3) -> Texture {
    Texture { kind: TextureKind::Constant(Vec4::from((value, 1.0))), mapping: Affine2::IDENTITY }
}

fn mapping(params: &Params) -> Result<Affine2> {
    params.word_or("mapping", "uv", &["uv"])?;
    let scale =
        Vec2::new(params.float_or("uscale", 1.0)? as f32, params.float_or("vscale", 1.0)? as f32);
    let shift =
        Vec2::new(params.float_or("udelta", 0.0)? as f32, params.float_or("vdelta", 0.0)? as f32);
    Ok(Affine2::from_mat2_translation(Mat2::from_diagonal(scale), shift))
}

/// The picture as numbers in all of red, green and blue, opaque.
fn to_gray(image: Image) -> Image {
    let Image { width, height, data } = image;
    let one = |v: f32| [v, v, v, 1.0];
    let byte = |v: u8| [v, v, v, 255];
    let data = match data {
        ImageData::Srgb8(data) | ImageData::Linear8(data) if data.iter().any(|p| p[3] != 255) => {
            ImageData::Linear8(data.iter().map(|p| byte(p[3])).collect())
        }
        ImageData::Float(data) if data.iter().any(|p| p[3] != 1.0) => {
            ImageData::Float(data.iter().map(|p| one(p[3])).collect())
        }
        ImageData::Float(data) => {
            ImageData::Float(data.iter().map(|p| one((p[0] + p[1] + p[2]) / 3.0)).collect())
        }
        bytes if is_gray(&bytes) => bytes,
        // The mean is taken of decoded values, which bytes cannot hold.
        bytes => {
            let image = Image { width, height, data: bytes };
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            ImageData::Float(
                pixels
                    .map(|(x, y)| image.pixel(x, y))
                    .map(|p| one((p.x + p.y + p.z) / 3.0))
                    .collect(),
            )
        }
    };
    Image { width, height, data }
}

fn is_gray(data: &ImageData) -> bool {
    match data {
        ImageData::Srgb8(data) | ImageData::Linear8(data) => {
            data.iter().all(|p| p[0] == p[1] && p[1] == p[2])
        }
        ImageData::Float(_) => false,
    }
}
