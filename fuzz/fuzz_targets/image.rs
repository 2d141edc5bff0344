//! Any bytes as a picture: as many pixels as its sides say, or a typed error.
#![no_main]

use afterimage::scene::ImageData;
use afterimage::scene::load::{Encoding, image_from_bytes};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(image) = image_from_bytes(bytes, Encoding::Srgb) {
        let pixels = match &image.data {
            ImageData::Srgb8(data) | ImageData::Linear8(data) => data.len(),
            ImageData::Float(data) => data.len(),
        };
        assert_eq!(pixels, image.width as usize * image.height as usize);
    }
});
