//! Colours that are black everywhere: an emitter of such a colour is no light.

use glam::Vec3;

use crate::scene::{Color, ImageData, Scene, TextureId, TextureKind};

/// Whether a colour is 0 at all texture coordinates.
pub(super) fn is_black(scene: &Scene, color: Color) -> bool {
    match color {
        Color::Constant(value) => value == Vec3::ZERO,
        Color::Texture(id) => black_texture(scene, id),
    }
}

fn black_texture(scene: &Scene, id: TextureId) -> bool {
    match scene.textures[id.index()].kind {
        TextureKind::Constant(value) => value.truncate() == Vec3::ZERO,
        TextureKind::Image { image, scale, invert, .. } => {
            !invert && (scale == 0.0 || black_picture(&scene.images[image.index()].data))
        }
        TextureKind::Checkerboard { first, second } => {
            is_black(scene, first) && is_black(scene, second)
        }
        TextureKind::Product { first, second } => {
            black_texture(scene, first) || black_texture(scene, second)
        }
        TextureKind::Threshold { .. } => false,
    }
}

fn black_picture(data: &ImageData) -> bool {
    match data {
        ImageData::Srgb8(data) | ImageData::Linear8(data) => data.iter().all(|p| p[..3] == [0; 3]),
        ImageData::Float(data) => data.iter().all(|p| p[..3] == [0.0; 3]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Image, ImageId, Texture, Wrap};
    use glam::{Affine2, Vec4};

    #[test]
    fn black_textures_of_every_kind() {
        let mut scene = Scene::new("");
        let mut add = |kind| scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
        let black = add(TextureKind::Constant(Vec4::W));
        let grey = add(TextureKind::Constant(Vec4::ONE));
        let product = add(TextureKind::Product { first: grey, second: black });
        let bright = add(TextureKind::Product { first: grey, second: grey });
        let [dark, light] = [Vec3::ZERO, Vec3::X].map(Color::Constant);
        let board = |second| TextureKind::Checkerboard { first: Color::Texture(product), second };
        let (dark_board, light_board) = (add(board(dark)), add(board(light)));
        let picture = |last: u8| Image {
            width: 2,
            height: 1,
            data: ImageData::Srgb8(vec![[0, 0, 0, 255], [0, 0, last, 255]]),
        };
        let (night, star) = (scene.add_image(picture(0)), scene.add_image(picture(1)));
        let mut image = |image, scale, invert| {
            let kind = TextureKind::Image { image, wrap: Wrap::Repeat, scale, invert };
            scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY })
        };
        let night = [image(night, 1.0, false), image(star, 0.0, false)];
        let star = [image(star, 1.0, false), image(ImageId(0), 1.0, true)];
        for id in [black, product, dark_board].into_iter().chain(night) {
            assert!(is_black(&scene, Color::Texture(id)), "{id:?}");
        }
        for id in [grey, bright, light_board].into_iter().chain(star) {
            assert!(!is_black(&scene, Color::Texture(id)), "{id:?}");
        }
    }
}
