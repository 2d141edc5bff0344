//! Do loaders survive arbitrary bytes? Every outcome must be a valid result or a typed error, in
//! bounded memory; a panic fails.

use std::io::Write;
use std::path::Path;

use afterimage::scene::load::{
    Encoding, gltf_from_bytes, image_from_bytes, pbrt_from_bytes, ply_from_bytes,
};
use afterimage::scene::{ImageData, Mesh};
use proptest::prelude::*;

/// Every directive and most parameter types, so that a few changed bytes reach deep into the
/// loader.
const SCENE: &str = r#"
Film "rgb" "integer xresolution" [ 64 ] "integer yresolution" 32
Integrator "path" "integer maxdepth" 4
TransformTimes 0 2
LookAt 0 0 -5  0 0 0  0 1 0
Camera "perspective" "float fov" 45
WorldBegin
Texture "c" "spectrum" "checkerboard" "rgb tex1" [ 1 0 0 ] "float uscale" 2
Texture "s" "spectrum" "scale" "texture tex" "c" "float scale" .5
MakeNamedMaterial "m" "string type" "conductor" "spectrum eta" "metal-Cu-eta" "float uroughness" .2 "bool remaproughness" false
MakeNamedMaterial "d" "string type" "diffuse" "texture reflectance" "s"
Material "mix" "string materials" [ "m" "d" ] "float amount" .25
AttributeBegin
  AreaLightSource "diffuse" "blackbody L" 3000 "bool twosided" true
  Translate 0 1.5 0 Rotate 30 0 1 0 Scale 1 -2 1
  Shape "trianglemesh" "point3 P" [ 0 0 0 1 0 0 0 1 0 1 1 0 ] "integer indices" [ 0 1 2 1 3 2 ] "point2 uv" [ 0 0 1 0 0 1 1 1 ]
    "normal N" [ 0 0 1 0 0 1 0 0 1 0 0 1 ]
AttributeEnd
ObjectBegin "o" Shape "disk" "float radius" 2 ActiveTransform EndTime Translate 1 0 0 Shape "sphere" ObjectEnd
ConcatTransform [ 1 0 0 0 0 1 0 0 0 0 1 0 0 0 3 1 ]
ObjectInstance "o"
LightSource "infinite" "spectrum L" [ 400 1 700 2 ]
LightSource "spot" "point3 from" [ 0 4 0 ] "float coneangle" 20
"#;

fn ascii_ply() -> String {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 4\n");
    for name in ["x", "y", "z", "u", "v"] {
        text.push_str(&format!("property float {name}\n"));
    }
    text.push_str("element face 2\nproperty list uchar int vertex_indices\nend_header\n");
    text.push_str("0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n3 0 1 2\n");
    text
}

fn binary_ply(little: bool) -> Vec<u8> {
    let order = if little { "little" } else { "big" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
         element face 1\nproperty list uchar int vertex_index\nend_header\n"
    )
    .into_bytes();
    for value in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(if little { value.to_le_bytes() } else { value.to_be_bytes() });
    }
    bytes.push(3);
    for value in [0_i32, 1, 2] {
        bytes.extend(if little { value.to_le_bytes() } else { value.to_be_bytes() });
    }
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn encoded(format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    if format == image::ImageFormat::Hdr {
        let pixels =
            image::Rgb32FImage::from_fn(9, 7, |x, y| image::Rgb([x as f32, y as f32, 2.5]));
        image::DynamicImage::from(pixels).write_to(&mut bytes, format).unwrap();
    } else {
        let pixels =
            image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 5]));
        image::DynamicImage::from(pixels).write_to(&mut bytes, format).unwrap();
    }
    bytes.into_inner()
}

fn exr_file() -> Vec<u8> {
    use exr::prelude::{Image, SpecificChannels, Vec2, WritableImage};
    let channels = SpecificChannels::rgb(|p: Vec2<usize>| (p.x() as f32, p.y() as f32, 0.5_f32));
    let mut bytes = std::io::Cursor::new(Vec::new());
    Image::from_channels((9, 7), channels).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn check_mesh(mesh: &Mesh) {
    let vertices = mesh.positions.len();
    assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < vertices));
    assert!(mesh.normals.is_empty() || mesh.normals.len() == vertices);
    assert!(mesh.uvs.is_empty() || mesh.uvs.len() == vertices);
    assert!(mesh.positions.iter().all(|p| p.is_finite()));
}

/// Every loader on the same bytes.
fn try_all(bytes: &[u8]) {
    let path = Path::new("no-such-folder/scene");
    for loaded in [pbrt_from_bytes(bytes, path), gltf_from_bytes(bytes, path)].into_iter().flatten()
    {
        loaded.scene.validate().expect("a loader returns valid scenes only");
    }
    if let Ok(mesh) = ply_from_bytes(bytes) {
        check_mesh(&mesh);
    }
    if let Ok(image) = image_from_bytes(bytes, Encoding::Srgb) {
        let pixels = match &image.data {
            ImageData::Srgb8(data) | ImageData::Linear8(data) => data.len(),
            ImageData::Float(data) => data.len(),
        };
        assert_eq!(pixels, image.width as usize * image.height as usize);
    }
}

/// Changes, cuts or repeats parts of `bytes`.
fn mutate(bytes: &[u8], edits: &[(usize, u8, u8)]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (at, value, what) in edits {
        if bytes.is_empty() {
            break;
        }
        let at = at % bytes.len();
        match what % 5 {
            0 => bytes[at] = *value,
            1 => bytes[at] ^= 1 << (value % 8),
            2 => bytes.truncate(at),
            3 => {
                bytes.remove(at);
            }
            _ => {
                let end = (at + usize::from(*value) % 16).min(bytes.len());
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
        }
    }
    bytes
}

fn edits() -> impl Strategy<Value = Vec<(usize, u8, u8)>> {
    proptest::collection::vec((any::<usize>(), any::<u8>(), any::<u8>()), 1..6)
}

#[test]
fn the_seeds_themselves_load() {
    let scene = pbrt_from_bytes(SCENE.as_bytes(), Path::new("scene.pbrt")).expect("loads").scene;
    assert_eq!((scene.instances.len(), scene.lights.len(), scene.film), (3, 2, [64, 32]));
    for ply in [binary_ply(true), binary_ply(false), gzip(&binary_ply(false))] {
        let mesh = ply_from_bytes(&ply).expect("loads");
        assert_eq!((mesh.triangles.len(), mesh.positions[1].x, mesh.uvs.len()), (1, 1.0, 0));
    }
    let mesh = ply_from_bytes(ascii_ply().as_bytes()).expect("loads");
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]], "polygons become fans");
    assert_eq!(mesh.uvs.len(), 4);
    for format in [image::ImageFormat::Png, image::ImageFormat::Jpeg, image::ImageFormat::Hdr] {
        let image = image_from_bytes(&encoded(format), Encoding::Linear).expect("loads");
        assert_eq!((image.width, image.height), (9, 7), "{format:?}");
    }
    let image = image_from_bytes(&exr_file(), Encoding::Linear).expect("loads");
    assert_eq!(image.pixel(3, 2).to_array(), [3.0, 2.0, 0.5, 1.0]);
}

#[test]
fn lying_ply_headers_cost_no_memory() {
    for count in ["99", "4294967295", "18446744073709551615", "99999999999999999999999"] {
        for (from, to) in
            [("vertex 4", format!("vertex {count}")), ("face 2", format!("face {count}"))]
        {
            assert!(ply_from_bytes(ascii_ply().replace(from, &to).as_bytes()).is_err(), "{to}");
            let binary = binary_ply(true);
            let header = binary.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            let text = String::from_utf8(binary[..header].to_vec()).unwrap();
            let lie = text.replace("vertex 3", &to).replace("face 1", &to);
            assert!(ply_from_bytes(&[lie.as_bytes(), &binary[header..]].concat()).is_err(), "{to}");
        }
    }
    let empty = "ply\nformat binary_little_endian 1.0\nelement thing 1000000000000\nend_header\n";
    assert!(ply_from_bytes(empty.as_bytes()).is_err(), "elements without properties take no bytes");
    let long = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
        property list uint int vertex_indices\nend_header\n0 0 0\n4000000000 0\n";
    assert!(ply_from_bytes(long.as_bytes()).is_err());
    let mut long = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uchar x\nproperty uchar y\nproperty uchar z\nelement face 1\n\
        property list uint int vertex_indices\nend_header\n\0\0\0"
        .to_vec();
    long.extend([0xff; 8]);
    assert!(ply_from_bytes(&long).is_err());
}

#[test]
fn truncated_pictures_are_errors() {
    let mut files = vec![exr_file()];
    files.extend([image::ImageFormat::Png, image::ImageFormat::Hdr].map(encoded));
    for file in files {
        for keep in 0..file.len() - 4 {
            // A cut in the last bytes may leave the pixels whole.
            let result = image_from_bytes(&file[..keep], Encoding::Srgb);
            assert!(result.is_err() || keep > file.len() / 2, "{keep} of {} bytes", file.len());
        }
    }
    // A PNG that claims 100,000 pixels a side.
    let mut png = encoded(image::ImageFormat::Png);
    png[16..24].copy_from_slice(&[0, 1, 0x86, 0xa0, 0, 1, 0x86, 0xa0]);
    assert!(image_from_bytes(&png, Encoding::Srgb).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..256)) {
        try_all(&bytes);
    }

    #[test]
    fn mutated_scenes(edits in edits()) {
        try_all(&mutate(SCENE.as_bytes(), &edits));
    }

    #[test]
    fn shuffled_words(words in proptest::collection::vec(0_usize..400, 1..60)) {
        let all: Vec<&str> = SCENE.split_whitespace().collect();
        let text: Vec<&str> = words.iter().map(|w| all[w % all.len()]).collect();
        try_all(format!("WorldBegin {}", text.join(" ")).as_bytes());
    }

    #[test]
    fn mutated_meshes(edits in edits(), kind in 0_usize..4) {
        let seed = match kind {
            0 => ascii_ply().into_bytes(),
            1 => binary_ply(true),
            2 => binary_ply(false),
            _ => gzip(ascii_ply().as_bytes()),
        };
        try_all(&mutate(&seed, &edits));
    }

    #[test]
    fn mutated_pictures(edits in edits(), kind in 0_usize..4) {
        let seed = match kind {
            0 => encoded(image::ImageFormat::Png),
            1 => encoded(image::ImageFormat::Jpeg),
            2 => encoded(image::ImageFormat::Hdr),
            _ => exr_file(),
        };
        try_all(&mutate(&seed, &edits));
    }
}
