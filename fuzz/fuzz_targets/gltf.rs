//! Any bytes as a scene: a valid scene or a typed error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(loaded) = afterimage::scene::load::gltf_from_bytes(bytes, Path::new("no-such-folder/scene.gltf")) {
        loaded.scene.validate().expect("a loader returns valid scenes only");
    }
});
