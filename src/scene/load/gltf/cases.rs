//! Files that are valid, or nearly so, and once failed: each with what is right. Then every decoded
//! value of a file that holds one of each, all different from each other.

use glam::{Affine3A, Mat3, Quat, Vec2, Vec3, Vec4};

use super::tests::{PNG, data, file, floats, parse};
use super::*;
use crate::scene::{Channel, Color, ImageData, Material, Scalar, Scene, TextureKind, Wrap};

/// A file of `words`, each range of which is a view with an accessor: its kind and type.
fn with_accessors(words: &[Vec<u32>], kinds: &[(u32, &str)], body: &str) -> String {
    let (mut views, mut accessors, mut at) = (Vec::new(), Vec::new(), 0);
    for (part, (component, kind)) in words.iter().zip(kinds) {
        let bytes = 4 * part.len();
        views.push(format!(r#"{{"buffer":0,"byteOffset":{at},"byteLength":{bytes}}}"#));
        let size = match (*component, *kind) {
            (_, "SCALAR") | (5121, _) => 1,
            (_, "VEC2") => 2,
            (_, "VEC3") => 3,
            (_, "MAT4") => 16,
            _ => 4,
        };
        let (view, count) = (views.len() - 1, part.len() / size);
        accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{kind}"}}"#
        ));
        at += bytes;
    }
    let all = words.concat();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{at},"uri":"{}"}}],"bufferViews":[{}],"accessors":[{}],{body}}}"#,
        data(&all),
        views.join(","),
        accessors.join(",")
    )
}

fn mesh(scene: &Scene, object: usize, shape: usize) -> &Mesh {
    match &scene.objects[object].shapes[shape].geometry {
        Geometry::Mesh(mesh) => mesh,
        other => panic!("{other:?} is no mesh"),
    }
}

const FLOAT: u32 = 5126;

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// What loading a whole file is expected to warn of.
#[track_caller]
fn assert_warnings(loaded: &Loaded, expected: &[&str]) {
    let dull = ["cameras: none in the scene", "nothing emits"];
    let others = loaded.warnings.iter().filter(|w| !dull.iter().any(|d| w.contains(d)));
    let others: Vec<&String> = others.collect();
    assert!(others.iter().all(|w| w.starts_with("t.gltf: ")), "{others:?}");
    assert_eq!(others.len(), expected.len(), "{others:?}");
    for (found, expected) in others.iter().zip(expected) {
        assert!(found.contains(expected), "{found}\nexpected {expected}");
    }
}

#[test]
fn attributes_of_applications_are_ignored_and_unknown_ones_said() {
    let good = file(r#"{"mesh":0}"#, r#","materials":[{}]"#);
    let custom = good.replace(r#""TEXCOORD_0":1"#, r#""TEXCOORD_0":1,"_TEMP":0"#);
    assert_ne!(good, custom);
    let loaded = parse(&custom).unwrap();
    assert_warnings(&loaded, &[]);
    assert_eq!(mesh(&loaded.scene, 0, 0).positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    let unknown = custom.replace("_TEMP", "TEMP");
    let expected = "meshes[0].primitives[0].attributes: names that glTF 2.0 does not know";
    assert_warnings(&parse(&unknown).unwrap(), &[expected]);
}

#[test]
fn extras_hold_any_json() {
    for extras in ["0.5", "null", "\"x\"", "[1,{}]", "true", r#"{"a":[0]}"#] {
        let of = format!(r#""extras":{extras}"#);
        let node = format!(r#"{{"mesh":0,{of}}}"#);
        let rest = format!(
            r#","materials":[{{{of},"pbrMetallicRoughness":{{"baseColorFactor":[0.1,0.2,0.3,1],{of}}}}}],{of}"#
        );
        let text = file(&node, &rest)
            .replace(r#""version":"2.0""#, &format!(r#""version":"2.0",{of}"#))
            .replace(r#""material":0"#, &format!(r#""material":0,{of}"#))
            .replace(r#""scenes":[{"#, &format!(r#""scenes":[{{{of},"#));
        let loaded = parse(&text).unwrap_or_else(|e| panic!("{extras}: {e}"));
        assert_warnings(&loaded, &[]);
        let Material::MetallicRoughness { base_color, .. } = loaded.scene.materials[0] else {
            panic!()
        };
        assert!(matches!(base_color, Color::Constant(c) if c == Vec3::new(0.1, 0.2, 0.3)));
    }
}

#[test]
fn what_is_optional_may_be_absent() {
    // No scene, no material, no indices, no names; a primitive without positions; channels without
    // a node; a texture without a picture.
    let positions = floats(&TRIANGLE);
    let body = r#""nodes":[{"mesh":0}],"textures":[{}],
        "materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0},"baseColorFactor":[0.5,0.25,0.125,1]}}],
        "meshes":[{"primitives":[{"attributes":{}},{"attributes":{"POSITION":0},"material":0},{"attributes":{"POSITION":0}}]}],
        "animations":[{"samplers":[],"channels":[{"sampler":0,"target":{"path":"pointer"}}]}]"#;
    let loaded = parse(&with_accessors(&[positions], &[(FLOAT, "VEC3")], body)).unwrap();
    assert_warnings(
        &loaded,
        &[
            "animations[0].channels: some drive no node; they are ignored",
            "meshes[0].primitives[0].attributes.POSITION: missing; the primitive shows nothing",
            "textures[0].source: missing; its picture is an extension's",
        ],
    );
    let scene = &loaded.scene;
    assert_eq!((scene.instances.len(), scene.objects[0].shapes.len()), (1, 2));
    assert_eq!(mesh(scene, 0, 1).triangles, [[0, 1, 2]]);
    let Material::MetallicRoughness { base_color, .. } = scene.materials[0] else { panic!() };
    assert!(matches!(base_color, Color::Constant(c) if c == Vec3::new(0.5, 0.25, 0.125)));
    // glTF's default material: white, metallic 1, roughness 1.
    let Material::MetallicRoughness { base_color, metallic, roughness, double_sided, .. } =
        scene.materials[1]
    else {
        panic!()
    };
    assert!(matches!(base_color, Color::Constant(c) if c == Vec3::ONE) && !double_sided);
    assert!(matches!((metallic, roughness), (Scalar::Constant(1.0), Scalar::Constant(1.0))));
}

#[test]
fn extensions_that_only_add_to_a_look_may_be_required() {
    let rest = r#","materials":[{}],"extensionsUsed":["KHR_materials_clearcoat"],"extensionsRequired":["KHR_materials_clearcoat"]"#;
    let loaded = parse(&file(r#"{"mesh":0}"#, rest)).unwrap();
    assert_warnings(&loaded, &["extensionsUsed[0]: `KHR_materials_clearcoat` is ignored"]);
    // An index of 0 stands for an infinite one: everything is reflected at any angle.
    let rest = r#","materials":[{"extensions":{"KHR_materials_ior":{"ior":0}}}]"#;
    let Material::MetallicRoughness { ior, .. } =
        parse(&file(r#"{"mesh":0}"#, rest)).unwrap().scene.materials[0]
    else {
        panic!()
    };
    assert_eq!(((ior - 1.0) / (ior + 1.0)).powi(2), 1.0);
}

#[test]
fn a_picture_of_another_format_leaves_its_texture_out() {
    let rest = r#","materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0},"baseColorFactor":[0.5,0.25,1,1]}}],
        "textures":[{"source":0}],"images":[{"uri":"data:image/webp;base64,UklGRhoAAABXRUJQVlA4TA0AAAAvAAAAEAcQERGIiP4HAA=="}]"#;
    let loaded = parse(&file(r#"{"mesh":0}"#, rest)).unwrap();
    let expected = "images[0].uri: not a picture that is read; allowed: PNG, JPEG, TGA, HDR (Radiance), PFM, EXR; \
                    the texture is left out";
    assert_warnings(&loaded, &[expected]);
    let Material::MetallicRoughness { base_color, .. } = loaded.scene.materials[0] else {
        panic!()
    };
    assert!(matches!(base_color, Color::Constant(c) if c == Vec3::new(0.5, 0.25, 1.0)));
}

/// A black pixel, as PNG.
const BLACK: &str = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAQAAAAECAIAAAAmkwkpAAAADElEQVR4nGNgIB0AAAA0AAF2Xq7DAAAAAElFTkSuQmCC";

#[test]
fn a_black_emissive_texture_is_no_light() {
    let with = |uri: &str, material: &str| {
        let rest = format!(
            r#","materials":[{{"emissiveFactor":[1,1,1],"emissiveTexture":{{"index":0}}{material}}}],"textures":[{{"source":0}}],"images":[{{"uri":"{uri}"}}]"#
        );
        parse(&file(r#"{"mesh":0}"#, &rest)).unwrap()
    };
    let lit = |loaded: &Loaded| {
        let emission = loaded.scene.objects[0].shapes[0].emission;
        (emission.is_some(), loaded.scene.lights.len())
    };
    // The white sky of files without light stays.
    assert_eq!(lit(&with(BLACK, "")), (false, 1));
    assert_eq!(lit(&with(PNG, "")), (true, 0));
    // What is wholly transparent sends nothing.
    let hidden = r#","alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorFactor":[1,1,1,0]}"#;
    assert_eq!(lit(&with(PNG, hidden)), (false, 1));
}

#[test]
fn a_scale_of_zero_hides_for_as_long_as_it_lasts() {
    let scale = |values: [f32; 9], interpolation: &str, light: bool| {
        let thing = if light {
            r#""extensions":{"KHR_lights_punctual":{"light":0}}"#
        } else {
            r#""mesh":0"#
        };
        let body = format!(
            r#""nodes":[{{"children":[1]}},{{{thing}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"directional"}}]}}}},
            "animations":[{{"samplers":[{{"input":1,"output":2,"interpolation":"{interpolation}"}}],"channels":[{{"sampler":0,"target":{{"node":0,"path":"scale"}}}}]}}]"#
        );
        let words = [floats(&TRIANGLE), floats(&[0.0, 0.5, 1.0]), floats(&values)];
        let kinds = [(FLOAT, "VEC3"), (FLOAT, "SCALAR"), (FLOAT, "VEC3")];
        parse(&with_accessors(&words, &kinds, &body)).unwrap().scene
    };
    let step = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    let shown = |scene: &Scene, time: f32| {
        let now = scene.at(time);
        now.validate().unwrap();
        // The white sky of files without light is not counted.
        now.instances.len() + now.lights.iter().filter(|l| l.key != u64::MAX).count()
    };
    for light in [false, true] {
        let scene = scale(step, "STEP", light);
        assert_eq!([0.0, 0.49, 0.5, 0.99, 1.0].map(|t| shown(&scene, t)), [1, 1, 0, 0, 1]);
        let scene = scale(step, "LINEAR", light);
        assert_eq!([0.25, 0.5, 0.75].map(|t| shown(&scene, t)), [1, 0, 1]);
    }
    // Along one axis alone, and through it to the other side.
    let through = [1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, -1.0, 1.0];
    let scene = scale(through, "LINEAR", false);
    assert_eq!([0.25, 0.5, 0.75].map(|t| shown(&scene, t)), [1, 0, 1]);
    assert_eq!(scene.instances[0].to_world.at(0.75).matrix3.y_axis.y, -0.5);
    // For good, and said.
    let still = file(r#"{"mesh":0,"scale":[1,0,1]}"#, r#","materials":[{}]"#);
    let loaded = parse(&still).unwrap();
    assert!(loaded.scene.instances.is_empty());
    assert_warnings(&loaded, &["nodes[0]: a scale of 0 hides it", "nothing to show"]);
}

#[test]
fn a_camera_or_light_keeps_its_place_whatever_its_own_scale() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let nodes = format!(
        r#"{{"camera":0,"rotation":[0,{half},0,{half}],"translation":[1,2,3],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}"#
    );
    // The scale goes from (0, 0, 0) to (4, 0, 0).
    let rest = r#","cameras":[{"type":"perspective","perspective":{"yfov":1.0,"znear":0.1}}],"materials":[{}],
        "extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","spot":{}}]}},
        "animations":[{"samplers":[{"input":3,"output":4}],"channels":[{"sampler":0,"target":{"node":0,"path":"scale"}}]}]"#;
    let loaded = parse(&file(&nodes, rest)).unwrap();
    assert_warnings(&loaded, &["scenes: nothing to show"]);
    let turn = Mat3::from_quat(Quat::from_xyzw(0.0, half, 0.0, half));
    for time in [1.0, 2.0, 3.0] {
        let now = loaded.scene.at(time);
        now.validate().unwrap();
        for (to_world, forward) in [
            (now.camera.to_world.fixed(), turn * Vec3::NEG_Z),
            (now.lights[0].to_world.fixed(), turn * Vec3::NEG_Z),
        ] {
            assert_eq!(Vec3::from(to_world.translation), Vec3::new(1.0, 2.0, 3.0));
            assert!((to_world.transform_vector3(Vec3::Z) - forward).length() < 1e-6);
        }
    }
}

#[test]
fn morph_targets_and_skins_are_shown_in_their_rest_pose() {
    // Two targets, the second with half its weight; two joints, of which the second is moved by 3
    // along x and bound 1 to the left; the middle vertex hangs on both.
    let words = [
        floats(&TRIANGLE),
        floats(&[9.0; 9]),
        floats(&[0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0]),
        vec![0x0000_0000, 0x0000_0100, 0x0000_0001],
        floats(&[1.0, 0.0, 0.0, 0.0, 0.25, 0.75, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]),
        [Affine3A::IDENTITY, Affine3A::from_translation(Vec3::NEG_X)]
            .iter()
            .flat_map(|m| floats(&glam::Mat4::from(*m).to_cols_array()))
            .collect(),
        floats(&[0.0, 1.0]),
        floats(&[0.0, 0.0, 0.0, 9.0, 9.0, 9.0]),
    ];
    let kinds = [
        (FLOAT, "VEC3"),
        (FLOAT, "VEC3"),
        (FLOAT, "VEC3"),
        (5121, "VEC4"),
        (FLOAT, "VEC4"),
        (FLOAT, "MAT4"),
        (FLOAT, "SCALAR"),
        (FLOAT, "VEC3"),
    ];
    let body = |animations: &str| {
        format!(
            r#""nodes":[{{"mesh":0,"skin":0,"translation":[7,7,7]}},{{"mesh":0,"weights":[0,0]}},{{"children":[3],"translation":[0,0,1]}},{{"translation":[3,0,0]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"JOINTS_0":3,"WEIGHTS_0":4}},"targets":[{{"POSITION":1}},{{"POSITION":2}}]}}],"weights":[0,0.5]}}],
        "skins":[{{"joints":[2,3],"inverseBindMatrices":5}}]{animations}"#
        )
    };
    let still = parse(&with_accessors(&words, &kinds, &body(""))).unwrap();
    assert_warnings(&still, &[]);
    let moving = r#","animations":[{"samplers":[{"input":6,"output":7},{"input":6,"output":6}],
        "channels":[{"sampler":0,"target":{"node":2,"path":"translation"}},{"sampler":1,"target":{"node":1,"path":"weights"}}]}]"#;
    let moved = parse(&with_accessors(&words, &kinds, &body(moving))).unwrap();
    assert_warnings(
        &moved,
        &[
            "animations[0].channels[1].target.path: animated morph targets are not followed",
            "nodes[0].skin: its joints are animated, which is not followed; the mesh keeps its rest pose",
        ],
    );
    for loaded in [still, moved] {
        let scene = &loaded.scene;
        // By the weights of the mesh every vertex is lifted by 1, by its joints by another 1; its
        // node does not place it.
        assert_eq!(scene.instances[0].to_world.at(0.0), Affine3A::IDENTITY);
        let expected =
            [Vec3::new(0.0, 0.0, 2.0), Vec3::new(1.0 + 1.5, 0.0, 2.0), Vec3::new(2.0, 1.0, 2.0)];
        for (found, expected) in mesh(scene, 0, 0).positions.iter().zip(expected) {
            assert!((*found - expected).length() < 1e-6, "{found} {expected}");
        }
        // The second node has weights of its own, and no skin.
        assert_eq!(mesh(scene, 1, 0).positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    }
}

#[test]
fn one_normal_without_a_direction_stays_at_its_vertex() {
    let tilted = Vec3::new(0.6, 0.0, 0.8);
    for bad in [0.0, f32::NAN] {
        let mut normals = [tilted; 4].map(|n| n.to_array()).concat();
        normals[9..].fill(bad);
        let square = [TRIANGLE.to_vec(), vec![1.0, 1.0, 0.0]].concat();
        let words = [floats(&square), floats(&normals), vec![0, 1, 2, 2, 1, 3]];
        let kinds = [(FLOAT, "VEC3"), (FLOAT, "VEC3"), (5125, "SCALAR")];
        let body = r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0,"NORMAL":1},"indices":2}]}]"#;
        let loaded = parse(&with_accessors(&words, &kinds, body)).unwrap();
        assert_warnings(
            &loaded,
            &["meshes[0].primitives[0].attributes.NORMAL: the normal of vertex 3 has no direction"],
        );
        let mesh = mesh(&loaded.scene, 0, 0);
        assert_eq!(mesh.triangles, [[0, 1, 2], [4, 5, 6]]);
        assert_eq!(mesh.normals[..3], [tilted; 3]);
        assert_eq!(mesh.normals[4..], [Vec3::Z; 3]);
    }
}

#[test]
fn messages_are_words_and_name_the_file() {
    let node = r#"{"mesh":0}"#;
    let good = file(node, r#","materials":[{}]"#);
    for (from, to, expected) in [
        (r#""mesh":0"#, r#""mesh":"a""#, "t.gltf:1:"),
        (r#""mesh":0"#, r#""mesh":-1"#, "t.gltf:1:"),
        (r#""primitives""#, r#""primitive""#, "t.gltf:"),
        ("[{}]", "[7]", "t.gltf:"),
        (
            r#","materials""#,
            r#","extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot"}]}},"materials""#,
            "t.gltf: extensions.KHR_lights_punctual.lights[0].spot: is missing",
        ),
        ("}", "", "t.gltf:"),
        (r#""type":"VEC3""#, r#""type":"VEC5""#, "t.gltf: accessors[0].type: "),
        (r#""material":0"#, r#""material":0,"mode":9"#, "t.gltf: meshes[0].primitives[0].mode: "),
        ("base64,", "base64,%", "t.gltf: buffers[0].uri: "),
    ] {
        let bad = good.replacen(from, to, 1);
        let text = parse(&bad).unwrap_err().to_string();
        assert!(text.starts_with(expected), "{text}");
        for word in ["struct", "::", "Vec<", "Option", "u32", "usize", "Error", "at line", "{"] {
            assert!(!text.contains(word), "{text}");
        }
    }
}

/// A red pixel with a second one, as PNG of 16 bits: 2 × 1, (0.5, 0.25, 1) and (0, 1, 0.02).
fn deep_png() -> String {
    let level = |v: f64| (v * 65535.0).round() as u16;
    let pixels = [0.5, 0.25, 1.0, 0.0, 1.0, 0.02].map(level).to_vec();
    let image = ::image::ImageBuffer::<::image::Rgb<u16>, _>::from_raw(2, 1, pixels).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    ::image::DynamicImage::from(image).write_to(&mut bytes, ::image::ImageFormat::Png).unwrap();
    let mut words = bytes.into_inner();
    words.resize(words.len().next_multiple_of(4), 0);
    let words: Vec<u32> =
        words.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    data(&words).replace("application/octet-stream", "image/png")
}

/// IEC 61966-2-1, in f64.
fn linear(v: f64) -> f32 {
    (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32
}

/// Every number of a material arrives where it belongs: all of them differ.
#[test]
fn every_value_of_a_material_is_read() {
    let texture = |index: u32, extra: &str| format!(r#"{{"index":{index}{extra}}}"#);
    let transform = r#","extensions":{"KHR_texture_transform":{"offset":[0.25,0.5],"rotation":0.5,"scale":[2,3]}}"#;
    let rest = format!(
        r#","materials":[{{"emissiveFactor":[0.9,0.8,0.7],"emissiveTexture":{},"alphaMode":"MASK","alphaCutoff":0.35,"doubleSided":true,
        "pbrMetallicRoughness":{{"baseColorFactor":[0.11,0.12,0.13,0.14],"metallicFactor":0.15,"roughnessFactor":0.16,"baseColorTexture":{},"metallicRoughnessTexture":{}}},
        "extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":17}},"KHR_materials_ior":{{"ior":1.18}},
          "KHR_materials_specular":{{"specularFactor":0.19,"specularColorFactor":[0.21,0.22,0.23],"specularTexture":{},"specularColorTexture":{}}},
          "KHR_materials_transmission":{{"transmissionFactor":0.24,"transmissionTexture":{}}}}}}}],
        "samplers":[{{"wrapS":33071,"wrapT":33071}},{{"wrapS":33648,"wrapT":33648}},{{"wrapS":10497,"wrapT":10497}}],
        "textures":[{{"source":0,"sampler":0}},{{"source":0,"sampler":1}},{{"source":0,"sampler":2}},{{"source":0}}],"images":[{{"uri":"{}"}}]"#,
        texture(0, ""),
        texture(1, ""),
        texture(2, transform),
        texture(3, ""),
        texture(0, ""),
        texture(1, ""),
        deep_png(),
    );
    let loaded = parse(&file(r#"{"mesh":0}"#, &rest)).unwrap();
    assert_warnings(&loaded, &[]);
    let scene = &loaded.scene;
    let shape = &scene.objects[0].shapes[0];
    // Centres of the two pixels: 16 bits of sRGB, decoded by the standard's curve and no power.
    let (left, right) = (Vec2::new(0.25, 0.5), Vec2::new(0.75, 0.5));
    let srgb = |rgb: [f64; 3]| Vec3::from_array(rgb.map(linear));
    let (first, second) = (srgb([0.5, 0.25, 1.0]), srgb([0.0, 1.0, 0.02]));
    let close = |found: Vec3, expected: Vec3| {
        assert!((found - expected).abs().max_element() < 2e-5, "{found} instead of {expected}");
    };
    let near = |found: f32, expected: f32| {
        assert!((found - expected).abs() < 2e-5, "{found} instead of {expected}");
    };
    assert!((first.x - 0.5_f32.powf(2.2)).abs() > 1e-3, "a power would be seen");

    let emission = shape.emission.unwrap();
    assert!(emission.scale == 17.0 && emission.two_sided);
    close(scene.color(emission.radiance, left), first * Vec3::new(0.9, 0.8, 0.7));
    close(scene.color(emission.radiance, right), second * Vec3::new(0.9, 0.8, 0.7));

    let Material::MetallicRoughness {
        base_color,
        metallic,
        roughness,
        ior,
        specular,
        specular_color,
        transmission,
        double_sided,
    } = scene.materials[0]
    else {
        panic!()
    };
    close(scene.color(base_color, left), first * Vec3::new(0.11, 0.12, 0.13));
    // Data is linear: green is roughness, blue metallic; (u, v) is turned and stretched first.
    let at = |uv: Vec2| {
        let (sin, cos) = 0.5_f32.sin_cos();
        let p = uv * Vec2::new(2.0, 3.0);
        let st = Vec2::new(cos * p.x + sin * p.y, -sin * p.x + cos * p.y) + Vec2::new(0.25, 0.5);
        // Bilinear between two columns that repeat.
        let x = (st.x * 2.0 - 0.5).rem_euclid(2.0);
        let share = if x < 1.0 { x } else { 2.0 - x };
        Vec3::new(0.5, 0.25, 1.0).lerp(Vec3::new(0.0, 1.0, 0.02), share)
    };
    for uv in [left, right, Vec2::new(0.1, 0.9)] {
        near(scene.scalar(roughness, uv), 0.16 * at(uv).y);
        near(scene.scalar(metallic, uv), 0.15 * at(uv).z);
    }
    assert!(ior == 1.18 && double_sided);
    near(scene.scalar(specular, left), 0.19);
    assert!(matches!(specular, Scalar::Texture(_, Channel::Alpha)));
    close(scene.color(specular_color, right), second * Vec3::new(0.21, 0.22, 0.23));
    near(scene.scalar(transmission, left), 0.24 * 0.5);
    // Alpha is 0.14 everywhere, below the limit.
    let alpha = shape.alpha.unwrap();
    assert_eq!(scene.scalar(alpha, left), 0.0);
    let limits = scene.textures.iter().filter_map(|t| match t.kind {
        TextureKind::Threshold { cutoff, .. } => Some(cutoff),
        _ => None,
    });
    assert_eq!(limits.collect::<Vec<_>>(), [0.35]);
    // The wrap of each texture, in the order that they are read.
    let wraps: Vec<Wrap> = scene
        .textures
        .iter()
        .filter_map(|t| match t.kind {
            TextureKind::Image { wrap, .. } => Some(wrap),
            _ => None,
        })
        .collect();
    assert_eq!(
        wraps,
        [Wrap::Mirror, Wrap::Repeat, Wrap::Repeat, Wrap::Clamp, Wrap::Mirror, Wrap::Clamp]
    );
    // One picture as colours, one as data.
    assert_eq!(scene.images.len(), 2);
    let ImageData::Float(data) = &scene.images[1].data else { panic!() };
    assert!((Vec4::from(data[0]) - Vec4::new(0.5, 0.25, 1.0, 1.0)).abs().max_element() < 1e-5);
}

/// Every number of the nodes, lights and animations arrives where it belongs.
#[test]
fn every_value_of_nodes_lights_and_animations_is_read() {
    let words = [
        floats(&TRIANGLE),
        floats(&[1.0, 2.0, 4.0]),
        floats(&[0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 5.0, 7.0, 11.0]),
        floats(&[0.0, 0.0, 0.0, 1.0, 0.6, 0.0, 0.0, 0.8, 0.0, 0.6, 0.0, 0.8]),
        floats(&[1.0, 1.0, 1.0, 2.0, 3.0, 4.0, 0.5, 0.25, 0.125]),
        // Three a key: tangent in, value, tangent out.
        floats(
            &[
                [9.0; 3], [1.0; 3], [2.0; 3], [4.0; 3], [3.0; 3], [0.0; 3], [0.0; 3], [3.0; 3],
                [9.0; 3],
            ]
            .concat(),
        ),
    ];
    let kinds = [
        (FLOAT, "VEC3"),
        (FLOAT, "SCALAR"),
        (FLOAT, "VEC3"),
        (FLOAT, "VEC4"),
        (FLOAT, "VEC3"),
        (FLOAT, "VEC3"),
    ];
    let body = r#""scene":1,"scenes":[{"nodes":[3]},{"nodes":[0,1,2,4,5,6]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "cameras":[{"type":"perspective","perspective":{"yfov":0.7,"aspectRatio":1.6,"znear":0.1,"zfar":9}}],
        "extensions":{"KHR_lights_punctual":{"lights":[
            {"type":"spot","color":[0.1,0.2,0.3],"intensity":4,"spot":{"innerConeAngle":0.25,"outerConeAngle":0.75}},
            {"type":"point","color":[0.4,0.5,0.6],"intensity":7},{"type":"directional","color":[0.7,0.8,0.9],"intensity":3}]}},
        "nodes":[{"mesh":0,"matrix":[0,2,0,0, -3,0,0,0, 0,0,4,0, 5,6,7,1]},
            {"mesh":0,"translation":[1,2,3],"rotation":[0,0,0.6,0.8],"scale":[4,5,6]},
            {"mesh":0},{"mesh":0},
            {"extensions":{"KHR_lights_punctual":{"light":0}},"translation":[8,9,10]},
            {"extensions":{"KHR_lights_punctual":{"light":1}},"children":[7]},
            {"camera":0,"extensions":{"KHR_lights_punctual":{"light":2}},"translation":[-1,-2,-3]},
            {"mesh":0,"translation":[0,0,1]}],
        "animations":[{"samplers":[{"input":1,"output":2},{"input":1,"output":3},{"input":1,"output":4,"interpolation":"STEP"},{"input":1,"output":5,"interpolation":"CUBICSPLINE"}],
            "channels":[{"sampler":0,"target":{"node":2,"path":"translation"}},{"sampler":1,"target":{"node":2,"path":"rotation"}},
            {"sampler":2,"target":{"node":2,"path":"scale"}},{"sampler":3,"target":{"node":5,"path":"translation"}}]}]"#;
    let loaded = parse(&with_accessors(&words, &kinds, body)).unwrap();
    assert_warnings(&loaded, &["animations[0].samplers[3]: the cubic spline is replaced"]);
    let scene = &loaded.scene;
    assert_eq!((scene.time, scene.film), ([1.0, 4.0], [1280, 800]));
    assert!((scene.camera.fov - 0.7).abs() < 1e-6, "the height is the shorter side");
    let keys: Vec<u64> = scene.instances.iter().map(|i| i.key).collect();
    assert_eq!(keys, [0, 1, 2, 7]);
    let close = |found: Vec3, expected: Vec3| {
        let size = expected.length().max(1.0);
        assert!((found - expected).length() < 1e-6 * size, "{found} instead of {expected}");
    };
    let place =
        |i: usize, time: f32, p: Vec3| scene.instances[i].to_world.at(time).transform_point3(p);
    let probe = Vec3::new(1.0, 10.0, 100.0);
    close(place(0, 1.0, probe), Vec3::new(-30.0 + 5.0, 2.0 + 6.0, 400.0 + 7.0));
    let turned = Quat::from_xyzw(0.0, 0.0, 0.6, 0.8) * (probe * Vec3::new(4.0, 5.0, 6.0));
    close(place(1, 1.0, probe), turned + Vec3::new(1.0, 2.0, 3.0));
    // Between the first two keys: linear translation, great-circle rotation, the first scale; at
    // the last key all have arrived.
    let half = Quat::from_xyzw(0.6, 0.0, 0.0, 0.8).to_axis_angle();
    let middle = Quat::from_axis_angle(half.0, 0.5 * half.1);
    close(place(2, 1.5, probe), middle * probe + Vec3::new(0.5, 1.0, 1.5));
    let last = Quat::from_xyzw(0.0, 0.6, 0.0, 0.8) * (probe * Vec3::new(0.5, 0.25, 0.125));
    close(place(2, 4.0, probe), last + Vec3::new(5.0, 7.0, 11.0));
    close(place(2, 3.9, Vec3::ZERO), Vec3::new(4.8, 6.75, 10.6));
    // The spline at 1.5 of [1, 2], by hand: 0.5 (1 + 3) + (2 − 4) / 8; the child follows.
    for (found, offset) in [
        (scene.lights[1].to_world.at(1.5).translation.into(), Vec3::ZERO),
        (place(3, 1.5, Vec3::ZERO), Vec3::Z),
    ] {
        close(found, Vec3::splat(1.75) + offset);
    }
    let at = |i: usize| scene.lights[i].to_world.at(1.0);
    let LightKind::Spot { intensity, cos_inner, cos_outer, falloff } = scene.lights[0].kind else {
        panic!()
    };
    close(intensity, Vec3::new(0.4, 0.8, 1.2));
    assert_eq!((cos_inner, cos_outer), (0.25_f32.cos(), 0.75_f32.cos()));
    assert_eq!(falloff, SpotFalloff::Quadratic);
    close(at(0).translation.into(), Vec3::new(8.0, 9.0, 10.0));
    close(at(0).transform_vector3(Vec3::Z), Vec3::NEG_Z);
    let LightKind::Point { intensity } = scene.lights[1].kind else { panic!() };
    close(intensity, Vec3::new(2.8, 3.5, 4.2));
    let LightKind::Distant { irradiance } = scene.lights[2].kind else { panic!() };
    close(irradiance, Vec3::new(2.1, 2.4, 2.7));
    close(scene.camera.to_world.at(1.0).translation.into(), Vec3::new(-1.0, -2.0, -3.0));
    let keys: Vec<u64> = scene.lights.iter().map(|l| l.key).collect();
    assert_eq!(keys, [4, 5, 6]);
}
