//! Any bytes as a mesh: indices in range or a typed error.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(mesh) = afterimage::scene::load::ply_from_bytes(bytes) {
        let vertices = mesh.positions.len();
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < vertices));
    }
});
