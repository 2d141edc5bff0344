//! Textures: small graphs over images, evaluated at texture coordinates.

use glam::{Affine2, Vec2, Vec3, Vec4, Vec4Swizzles};

use super::{ImageId, Scene, TextureId};

/// A colour of a material or an emitter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Color {
    /// The same everywhere.
    Constant(Vec3),
    /// RGB of a texture.
    Texture(TextureId),
}

/// A number of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scalar {
    /// The same everywhere.
    Constant(f32),
    /// One channel of a texture.
    Texture(TextureId, Channel),
}

/// What of a texture a [`Scalar`] reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// The first.
    Red,
    /// The second (glTF roughness).
    Green,
    /// The third (glTF metallic).
    Blue,
    /// Coverage.
    Alpha,
    /// Arithmetic mean of red, green, blue (pbrt float textures).
    Mean,
}

/// A texture with the map from surface coordinates to its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texture {
    /// What it shows.
    pub kind: TextureKind,
    /// Surface (u, v) to texture (s, t); the image's first row is at t = 1.
    pub mapping: Affine2,
}

/// The kinds of [`Texture`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TextureKind {
    /// The same everywhere.
    Constant(Vec4),
    /// A picture, bilinear.
    Image {
        /// Which.
        image: ImageId,
        /// Outside the unit square.
        wrap: Wrap,
        /// Factor on RGB.
        scale: f32,
        /// Whether RGB is replaced by max(1 − RGB, 0), after `scale`.
        invert: bool,
    },
    /// Unit squares of the mapped plane in turn: `first` where ⌊s⌋ + ⌊t⌋ is even.
    Checkerboard {
        /// On even squares.
        first: Color,
        /// On odd squares.
        second: Color,
    },
    /// The product of two textures, channel by channel; both read the surface's (u, v).
    Product {
        /// An earlier texture.
        first: TextureId,
        /// Another earlier texture.
        second: TextureId,
    },
    /// 1 in all channels where a value reaches a limit, else 0 (glTF's alpha mask).
    Threshold {
        /// Of an earlier texture; reads the surface's (u, v).
        value: Scalar,
        /// The least value that gives 1.
        cutoff: f32,
    },
}

/// What a picture shows outside of [0, 1)².
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Itself again.
    Repeat,
    /// Its border.
    Clamp,
    /// Nothing: 0 in all channels.
    Black,
    /// Itself, mirrored at every border.
    Mirror,
}

impl Texture {
    /// A picture that repeats.
    #[must_use]
    pub fn image(image: ImageId) -> Self {
        let kind = TextureKind::Image { image, wrap: Wrap::Repeat, scale: 1.0, invert: false };
        Self { kind, mapping: Affine2::IDENTITY }
    }
}

impl Scene {
    /// RGBA of a texture at surface coordinates.
    #[must_use]
    pub fn texture(&self, id: TextureId, uv: Vec2) -> Vec4 {
        let texture = &self.textures[id.index()];
        let st = texture.mapping.transform_point2(uv);
        match texture.kind {
            TextureKind::Constant(value) => value,
            TextureKind::Image { image, wrap, scale, invert } => {
                let value = self.images[image.index()].bilinear(Vec2::new(st.x, 1.0 - st.y), wrap);
                let rgb = value.xyz() * scale;
                let rgb = if invert { (Vec3::ONE - rgb).max(Vec3::ZERO) } else { rgb };
                rgb.extend(value.w)
            }
            TextureKind::Checkerboard { first, second } => {
                // rem_euclid keeps the parity right for negative squares and exact for large ones.
                let even = (st.x.floor() + st.y.floor()).rem_euclid(2.0) < 1.0;
                self.color(if even { first } else { second }, uv).extend(1.0)
            }
            TextureKind::Product { first, second } => {
                self.texture(first, uv) * self.texture(second, uv)
            }
            TextureKind::Threshold { value, cutoff } => {
                Vec4::splat(if self.scalar(value, uv) >= cutoff { 1.0 } else { 0.0 })
            }
        }
    }

    /// A colour at surface coordinates.
    #[inline]
    #[must_use]
    pub fn color(&self, color: Color, uv: Vec2) -> Vec3 {
        match color {
            Color::Constant(value) => value,
            Color::Texture(id) => self.texture(id, uv).xyz(),
        }
    }

    /// A number at surface coordinates.
    #[inline]
    #[must_use]
    pub fn scalar(&self, scalar: Scalar, uv: Vec2) -> f32 {
        match scalar {
            Scalar::Constant(value) => value,
            Scalar::Texture(id, channel) => {
                let rgba = self.texture(id, uv);
                match channel {
                    Channel::Red => rgba.x,
                    Channel::Green => rgba.y,
                    Channel::Blue => rgba.z,
                    Channel::Alpha => rgba.w,
                    Channel::Mean => (rgba.x + rgba.y + rgba.z) / 3.0,
                }
            }
        }
    }
}
