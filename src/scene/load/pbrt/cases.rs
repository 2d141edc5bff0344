//! Texts that pbrt-v4 reads and that once failed here: each with what is right. Then every decoded
//! value of texts that hold one of each, all different from each other.

use glam::{Affine2, DAffine3, Quat, Vec2, Vec3};

use super::tests::{DARK, Folder, TRIANGLE, load_text, mesh, quiet, refusal, world};
use super::*;
use crate::scene::{
    Color, ConductorColor, EnvironmentMapping, Geometry, ImageData, LightKind, Material, Mesh,
    Roughness, Scalar, SpotFalloff, TextureKind, Wrap,
};

fn close(found: Vec3, expected: Vec3) {
    assert!((found - expected).abs().max_element() < 1e-5, "{found} instead of {expected}");
}

#[test]
fn what_is_dark_or_of_another_version_is_said() {
    let (_, dark) = ("", load_text(&format!("Camera \"perspective\" WorldBegin {TRIANGLE}")));
    assert_eq!(dark.unwrap().warnings, [DARK]);
    let lit = format!("Camera \"perspective\" WorldBegin LightSource \"point\" {TRIANGLE}");
    assert!(load_text(&lit).unwrap().warnings.is_empty());

    let old = "Film \"image\" \"integer xresolution\" 8\nCamera \"perspective\"\nWorldBegin\nLightSource \"point\"";
    assert_eq!(
        load_text(old).unwrap().warnings,
        [
            "scene.pbrt:1:1: Film \"image\" is pbrt-v3; allowed: pbrt-v4 (pbrt-v4's `pbrt --upgrade` translates \
          files); what follows may mean something else"
        ]
    );
    for kind in ["matte", "plastic", "uber", "glass", "mirror", "metal"] {
        assert_eq!(
            refusal(&format!("\nMaterial \"{kind}\" \"rgb Kd\" [ 1 1 1 ]")),
            format!(
                "scene.pbrt:2:1: material \"{kind}\" is pbrt-v3; allowed: pbrt-v4 (pbrt-v4's `pbrt --upgrade` translates files)"
            )
        );
    }
}

#[test]
fn an_index_of_refraction_may_be_any_unbounded_spectrum() {
    let eta = |material: &str| match quiet(&format!("Material {material}")).materials[0] {
        Material::Dielectric { eta, .. }
        | Material::ThinDielectric { eta }
        | Material::CoatedDiffuse { eta, .. } => eta,
        ref other => panic!("{other:?}"),
    };
    for kind in ["dielectric", "thindielectric", "coateddiffuse"] {
        for (value, expected) in [
            ("\"rgb eta\" [ 1.5 1.5 1.5 ]", 1.5),
            ("\"spectrum eta\" [ 400 1.25 700 1.25 ]", 1.25),
            ("\"float eta\" 1.75", 1.75),
        ] {
            assert_eq!(eta(&format!("\"{kind}\" {value}")), expected, "{kind} {value}");
        }
    }
    // One that varies is said, and taken where glass makers state it: between red and green.
    let (scene, warnings) = world("Material \"dielectric\" \"rgb eta\" [ 1.5 1.6 1.7 ]");
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].starts_with("scene.pbrt:3:23: `eta` is taken as 1.537"), "{warnings:?}");
    let Material::Dielectric { eta, .. } = scene.materials[0] else { panic!() };
    assert!((eta - 1.537_742).abs() < 1e-5, "{eta}");
    let (scene, _) = world("Material \"thindielectric\" \"spectrum eta\" \"metal-TiO2-eta\"");
    assert!(matches!(scene.materials[0], Material::ThinDielectric { eta } if eta > 2.8));
    // Metals take values above 1 as numbers of any kind.
    let scene =
        quiet("Material \"conductor\" \"rgb eta\" [ 0.2 1.3 2.4 ] \"rgb k\" [ 3.5 4.6 5.7 ]");
    let Material::Conductor { color: ConductorColor::Complex { eta, k }, .. } = scene.materials[0]
    else {
        panic!()
    };
    assert!(matches!(eta, Color::Constant(c) if c == Vec3::new(0.2, 1.3, 2.4)));
    assert!(matches!(k, Color::Constant(c) if c == Vec3::new(3.5, 4.6, 5.7)));
    let message = refusal("\nMaterial \"dielectric\" \"rgb eta\" [ 1.5 -1 1.5 ]");
    assert!(message.starts_with("scene.pbrt:2:23: `eta` is [1.5, -1, 1.5]; allowed"), "{message}");
}

#[test]
fn one_normal_without_a_direction_stays_at_its_vertex() {
    let text = |normal: &str, reverse: &str| {
        format!(
            "{reverse} Shape \"trianglemesh\" \"point3 P\" [ 0 0 0  1 0 0  0 1 0  1 1 0  ] \"integer indices\" [ 0 1 2 2 1 3 ] \
             \"normal N\" [ .6 0 .8  .6 0 .8  .6 0 .8 {normal} ]"
        )
    };
    let (scene, warnings) = world(&text("0 0 0", ""));
    assert_eq!(
        warnings,
        [
            "scene.pbrt:3:2: Shape \"trianglemesh\": the normal of vertex 3 has no direction; the triangles there have \
          their faces' own"
        ]
    );
    let one = mesh(&scene.objects[0].shapes[0]);
    assert_eq!(one.triangles, [[0, 1, 2], [4, 5, 6]]);
    let tilted = Vec3::new(0.6, 0.0, 0.8);
    one.normals[..3].iter().for_each(|n| close(*n, tilted));
    assert_eq!(one.normals[4..], [Vec3::Z; 3]);
    let (scene, _) = world(&text("0 0 0", "ReverseOrientation"));
    let other = mesh(&scene.objects[0].shapes[0]);
    close(other.normals[0], -tilted);
    assert_eq!(other.normals[4..], [-Vec3::Z; 3], "on the side of those that are there");
}

fn ply(normals: &str, last: &str) -> String {
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty float u\nproperty float v\nelement face 2\n\
         property list uchar int vertex_indices\nend_header\n-5 0 -5 {normals} 0 0\n5 0 -5 0 1 0 1 0\n5 0 5 0 1 0 1 1\n\
         {last}\n3 0 2 1\n3 0 3 2\n"
    )
}

#[test]
fn a_ply_file_with_a_normal_that_is_none_names_file_and_vertex() {
    let folder = Folder::new("nan");
    let main = folder.write(
        "scene.pbrt",
        b"Camera \"perspective\" WorldBegin LightSource \"point\"\nShape \"plymesh\" \"string filename\" \"a.ply\"",
    );
    folder.write("a.ply", ply("nan nan nan", "-5 0 5 0 1 0 nan 1").as_bytes());
    let loaded = load(&main).unwrap();
    let path = main.display();
    assert_eq!(
        loaded.warnings,
        [
            format!(
                "{path}:2:17: \"a.ply\": vertex 3 has texture coordinates that are not finite; such ones are taken as 0 0"
            ),
            format!(
                "{path}:2:1: Shape \"plymesh\" of \"a.ply\": the normal of vertex 0 has no direction; the triangles \
                 there have their faces' own"
            ),
        ]
    );
    let mesh = mesh(&loaded.scene.objects[0].shapes[0]);
    assert_eq!((mesh.triangles.len(), mesh.normals[4..].to_vec()), (2, vec![Vec3::Y; 6]));
    assert_eq!(mesh.uvs[3], Vec2::ZERO);

    for (last, expected) in [
        (
            "inf 0 5 0 1 0 0 1",
            "\"a.ply\": vertex 3 of the PLY file is at [inf, 0, 5]; allowed: finite numbers",
        ),
        (
            "x 0 5 0 1 0 0 1",
            "\"a.ply\": damaged PLY file: the data behind its header cannot be read, at line 18; allowed: as many numbers \
             of such types as the header says",
        ),
    ] {
        folder.write("a.ply", ply("0 1 0", last).as_bytes());
        let message = load(&main).unwrap_err().to_string();
        assert_eq!(message, format!("{path}:2:17: {expected}"));
    }
    folder.write(
        "a.ply",
        ply("0 1 0", "0 0 5 0 1 0 0 1").replace("element face", "elements").as_bytes(),
    );
    let message = load(&main).unwrap_err().to_string();
    assert!(message.contains("damaged PLY file: its header cannot be read"), "{message}");
    assert!(!message.contains("Error") && !message.contains('\t'), "{message}");
}

#[test]
fn an_emitter_with_alpha_0_is_kept_without_a_word() {
    let scene = quiet(&format!(
        "AreaLightSource \"diffuse\" \"rgb L\" [ 1 2 3 ] Shape \"sphere\" \"float alpha\" 0 {TRIANGLE}"
    ));
    let shapes = &scene.objects[0].shapes;
    assert!(shapes[0].is_unmet() && !shapes[1].is_unmet());
    assert!(shapes.iter().all(|shape| shape.emission.is_some()));
}

#[test]
fn limits_go_by_depth_and_bytes() {
    let folder = Folder::new("many");
    // 5,202 files: three levels of 17, 17 and 18.
    folder.write("leaf.pbrt", b"Translate 1 0 0");
    let include = |name: &str, count: usize| format!("Include \"{name}.pbrt\"\n").repeat(count);
    folder.write("b.pbrt", include("leaf", 17).as_bytes());
    folder.write("a.pbrt", include("b", 17).as_bytes());
    let text = format!("WorldBegin {} Shape \"sphere\"", include("a", 18));
    let main = folder.write("scene.pbrt", text.as_bytes());
    let scene = load(&main).unwrap().scene;
    let Geometry::Sphere { center, .. } = scene.objects[0].shapes[0].geometry else { panic!() };
    assert_eq!(center.x, 18.0 * 17.0 * 17.0);

    // Files inside each other that would go on for ever cost bytes, small ones too.
    let mut builder = Builder::new(&main);
    builder.included_bytes = 100 * INCLUDE_BYTES;
    let error = builder.run(text.as_bytes(), Arc::from(&*main)).unwrap_err().to_string();
    assert!(
        error.contains("b.pbrt:")
            && error.contains("the scene includes more than 8589934592 bytes"),
        "{error}"
    );
    for i in 0..40 {
        folder.write(&format!("{i}.pbrt"), format!("Include \"{}.pbrt\"", i + 1).as_bytes());
    }
    let main = folder.write("deep.pbrt", b"WorldBegin Include \"0.pbrt\"");
    let error = load(&main).unwrap_err().to_string();
    assert!(
        error.ends_with("30.pbrt:1:1: more than 32 files inside each other; allowed: as many"),
        "{error}"
    );
}

#[test]
fn every_value_of_a_material_is_read() {
    let material = |text: &str| quiet(&format!("Material {text}")).materials[0];
    let alphas = |roughness: Roughness| match (roughness.u, roughness.v) {
        (Scalar::Constant(u), Scalar::Constant(v)) => (u, v, roughness.remap),
        other => panic!("{other:?}"),
    };
    let constant = |color: Color| match color {
        Color::Constant(value) => value,
        Color::Texture(id) => panic!("{id:?}"),
    };
    let rough = "\"float uroughness\" .25 \"float vroughness\" .75 \"bool remaproughness\" false";
    let Material::Conductor { color: ConductorColor::Complex { eta, k }, roughness } =
        material(&format!("\"conductor\" \"rgb eta\" [ .1 .2 .3 ] \"rgb k\" [ 4 5 6 ] {rough}"))
    else {
        panic!()
    };
    assert_eq!((constant(eta), constant(k)), (Vec3::new(0.1, 0.2, 0.3), Vec3::new(4.0, 5.0, 6.0)));
    assert_eq!(alphas(roughness), (0.25, 0.75, false));
    let Material::Dielectric { eta, roughness } =
        material(&format!("\"dielectric\" \"float eta\" 1.4 {rough}"))
    else {
        panic!()
    };
    assert_eq!((eta, alphas(roughness)), (1.4, (0.25, 0.75, false)));
    let Material::CoatedDiffuse { reflectance, eta, roughness } = material(
        "\"coateddiffuse\" \"rgb reflectance\" [ .1 .2 .3 ] \"float eta\" 1.6 \"float roughness\" .5 \"float vroughness\" .125",
    ) else {
        panic!()
    };
    assert_eq!((constant(reflectance), eta), (Vec3::new(0.1, 0.2, 0.3), 1.6));
    assert_eq!(alphas(roughness), (0.5, 0.125, true));
    let (scene, _) = world(
        "Material \"coatedconductor\" \"rgb conductor.eta\" [ .1 .2 .3 ] \"rgb conductor.k\" [ 4 5 6 ] \
         \"float conductor.uroughness\" .25 \"float conductor.vroughness\" .5 \"float interface.roughness\" .75",
    );
    let Material::Conductor { color: ConductorColor::Complex { eta, k }, roughness } =
        scene.materials[0]
    else {
        panic!()
    };
    assert_eq!((constant(eta), constant(k)), (Vec3::new(0.1, 0.2, 0.3), Vec3::new(4.0, 5.0, 6.0)));
    assert_eq!(alphas(roughness), (0.25, 0.5, true));
    let Material::DiffuseTransmission { reflectance, transmittance } = material(
        "\"diffusetransmission\" \"rgb reflectance\" [ .1 .2 .3 ] \"rgb transmittance\" [ .4 .5 .6 ] \"float scale\" .5",
    ) else {
        panic!()
    };
    close(constant(reflectance), Vec3::new(0.05, 0.1, 0.15));
    close(constant(transmittance), Vec3::new(0.2, 0.25, 0.3));
    let scene = quiet(
        "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" \"rgb reflectance\" [ .1 .2 .3 ]\n\
         MakeNamedMaterial \"b\" \"string type\" \"thindielectric\" \"float eta\" 1.25\n\
         Material \"mix\" \"string materials\" [ \"b\" \"a\" ] \"float amount\" .75",
    );
    assert!(
        matches!(scene.materials[0], Material::Diffuse { reflectance: Color::Constant(c) } if c == Vec3::new(0.1, 0.2, 0.3))
    );
    assert!(matches!(
        scene.materials[2],
        Material::Mix {
            first: MaterialId(1),
            second: MaterialId(0),
            amount: Scalar::Constant(0.75)
        }
    ));
}

#[test]
fn every_value_of_a_texture_is_read() {
    let folder = Folder::new("values");
    let png = |name: &str, deep: bool| {
        let pixels = [[0.5, 0.25, 1.0], [0.0, 0.75, 0.02]].concat();
        let path = folder.0.join(name);
        if deep {
            let pixels = pixels.iter().map(|v| (v * 65535.0_f64).round() as u16).collect();
            ::image::ImageBuffer::<::image::Rgb<u16>, Vec<u16>>::from_raw(2, 1, pixels)
                .unwrap()
                .save(path)
                .unwrap();
        } else {
            let pixels = pixels.iter().map(|v| (v * 255.0_f64).round() as u8).collect();
            ::image::RgbImage::from_raw(2, 1, pixels).unwrap().save(path).unwrap();
        }
    };
    png("a.png", false);
    png("b.png", true);
    let text = "Camera \"perspective\" WorldBegin LightSource \"point\"\n\
        Texture \"s8\" \"spectrum\" \"imagemap\" \"string filename\" \"a.png\"\n\
        Texture \"l8\" \"spectrum\" \"imagemap\" \"string filename\" \"a.png\" \"string encoding\" \"linear\" \"string wrap\" \"clamp\"\n\
        Texture \"s16\" \"spectrum\" \"imagemap\" \"string filename\" \"b.png\" \"string encoding\" \"sRGB\" \"string wrap\" \"black\"\n\
        Texture \"l16\" \"spectrum\" \"imagemap\" \"string filename\" \"b.png\" \"string encoding\" \"linear\" \"string wrap\" \"repeat\" \
          \"float scale\" .5 \"bool invert\" true \"float uscale\" 2 \"float vscale\" 3 \"float udelta\" .25 \"float vdelta\" .125\n\
        Texture \"n\" \"float\" \"imagemap\" \"string filename\" \"b.png\" \"string encoding\" \"linear\"";
    let loaded = load(&folder.write("scene.pbrt", text.as_bytes())).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let scene = &loaded.scene;
    let kinds: Vec<(Wrap, f32, bool)> = scene
        .textures
        .iter()
        .map(|t| match t.kind {
            TextureKind::Image { wrap, scale, invert, .. } => (wrap, scale, invert),
            other => panic!("{other:?}"),
        })
        .collect();
    let plain = |wrap| (wrap, 1.0, false);
    assert_eq!(
        kinds,
        [
            plain(Wrap::Repeat),
            plain(Wrap::Clamp),
            plain(Wrap::Black),
            (Wrap::Repeat, 0.5, true),
            plain(Wrap::Repeat)
        ]
    );
    assert_eq!(
        scene.textures[3].mapping,
        Affine2::from_scale_angle_translation(Vec2::new(2.0, 3.0), 0.0, Vec2::new(0.25, 0.125))
    );
    // IEC 61966-2-1, in f64.
    let linear =
        |v: f64| (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32;
    let byte = |v: f64| (v * 255.0).round() / 255.0;
    let left = Vec2::new(0.25, 0.5);
    let at = |texture: u32, uv: Vec2| scene.texture(TextureId(texture), uv).truncate();
    let [r, g, b] = [0.5, 0.25, 1.0];
    close(at(0, left), Vec3::new(linear(byte(r)), linear(byte(g)), linear(byte(b))));
    close(at(1, left), Vec3::new(byte(r) as f32, byte(g) as f32, byte(b) as f32));
    close(at(2, left), Vec3::new(linear(r), linear(g), linear(b)));
    // 2 u + 0.25 = 0.75: the second pixel, halved and turned around.
    let second = Vec3::new(0.0, 0.75, 0.02);
    close(at(3, left), Vec3::ONE - 0.5 * second);
    close(at(4, left), Vec3::splat((r + g + b) as f32 / 3.0));
    // The right and the lower edge: what lies beyond is the other side, the border, or nothing.
    let edge = |texture: u32, x: f32| at(texture, Vec2::new(x, 0.0)).y;
    let first = [linear(byte(g)), byte(g) as f32, linear(g)];
    let last = [linear(byte(0.75)), byte(0.75) as f32, linear(0.75)];
    let near = |found: f32, expected: f32| {
        assert!((found - expected).abs() < 1e-5, "{found} instead of {expected}");
    };
    near(edge(0, 0.999_999_9), 0.5 * (first[0] + last[0]));
    near(edge(1, 0.999_999_9), last[1]);
    assert_eq!(at(2, Vec2::new(1.3, 0.5)), Vec3::ZERO);
    assert!(matches!(scene.images[0].data, ImageData::Srgb8(_)));
    assert!(matches!(scene.images[1].data, ImageData::Linear8(_)));
}

#[test]
fn every_value_of_a_light_is_read() {
    let scene = quiet(
        "Translate 10 20 30\n\
         LightSource \"point\" \"rgb I\" [ 1 2 3 ] \"float scale\" 4 \"point3 from\" [ 5 6 7 ]\n\
         LightSource \"spot\" \"rgb I\" [ 2 3 4 ] \"float scale\" .5 \"point3 from\" [ 1 0 0 ] \"point3 to\" [ 1 0 2 ] \
           \"float coneangle\" 50 \"float conedeltaangle\" 20\n\
         LightSource \"spot\" \"float power\" 9 \"float coneangle\" 60 \"float conedeltaangle\" 0\n\
         LightSource \"distant\" \"rgb L\" [ 3 4 5 ] \"float scale\" 2 \"point3 from\" [ 0 0 0 ] \"point3 to\" [ 0 3 0 ]\n\
         LightSource \"distant\" \"float illuminance\" 7\n\
         LightSource \"infinite\" \"rgb L\" [ 4 5 6 ] \"float scale\" .25\n\
         AreaLightSource \"diffuse\" \"rgb L\" [ 5 6 7 ] \"float scale\" 8 \"bool twosided\" true Shape \"sphere\"\n\
         AreaLightSource \"diffuse\" \"rgb L\" [ 6 7 8 ] ReverseOrientation Shape \"disk\" \"float alpha\" .5",
    );
    let place = |i: usize| Vec3::from(scene.lights[i].to_world.fixed().translation);
    let axis = |i: usize| scene.lights[i].to_world.fixed().transform_vector3(Vec3::Z);
    let LightKind::Point { intensity } = scene.lights[0].kind else { panic!() };
    assert_eq!((intensity, place(0)), (Vec3::new(4.0, 8.0, 12.0), Vec3::new(15.0, 26.0, 37.0)));
    let LightKind::Spot { intensity, cos_inner, cos_outer, falloff } = scene.lights[1].kind else {
        panic!()
    };
    assert_eq!((intensity, falloff), (Vec3::new(1.0, 1.5, 2.0), SpotFalloff::Smoothstep));
    close(
        Vec3::new(cos_inner, cos_outer, 0.0),
        Vec3::new(30_f32.to_radians().cos(), 50_f32.to_radians().cos(), 0.0),
    );
    close(place(1), Vec3::new(11.0, 20.0, 30.0));
    close(axis(1), Vec3::Z);
    // A cone of 60 degrees holds π sr.
    let LightKind::Spot { intensity, .. } = scene.lights[2].kind else { panic!() };
    close(intensity, Vec3::splat(9.0 / std::f32::consts::PI));
    let LightKind::Distant { irradiance } = scene.lights[3].kind else { panic!() };
    assert_eq!(irradiance, Vec3::new(6.0, 8.0, 10.0));
    close(axis(3), Vec3::Y);
    assert!(
        matches!(scene.lights[4].kind, LightKind::Distant { irradiance } if irradiance == Vec3::splat(7.0))
    );
    close(axis(4), Vec3::Z);
    let LightKind::Environment { radiance, image: None } = scene.lights[5].kind else { panic!() };
    assert_eq!(radiance, Vec3::new(1.0, 1.25, 1.5));
    let shapes = &scene.objects[0].shapes;
    for (shape, radiance, scale, two_sided, reversed) in [
        (&shapes[0], Vec3::new(5.0, 6.0, 7.0), 8.0, true, false),
        (&shapes[1], Vec3::new(6.0, 7.0, 8.0), 1.0, false, true),
    ] {
        let emission = shape.emission.unwrap();
        assert!(matches!(emission.radiance, Color::Constant(c) if c == radiance));
        assert_eq!(
            (emission.scale, emission.two_sided, shape.reverse_orientation),
            (scale, two_sided, reversed)
        );
    }
    assert!(matches!(shapes[1].alpha, Some(Scalar::Constant(0.5))));
}

#[test]
fn every_value_of_camera_and_motion_is_read() {
    let text = "Film \"rgb\" \"integer xresolution\" 30 \"integer yresolution\" 50\nTransformTimes 2 6\n\
        Translate 1 2 3 ActiveTransform EndTime Rotate 90 0 1 0 ActiveTransform All\nCamera \"perspective\" \"float fov\" 35\nWorldBegin\n\
        ActiveTransform StartTime Translate 4 5 6 ActiveTransform EndTime Translate 7 9 11 Rotate 60 0 0 1 Scale 2 3 4 ActiveTransform All\n\
        Shape \"trianglemesh\" \"point3 P\" [ 0 1 2 3 4 5 6 8 7 ] \"point2 uv\" [ .1 .2 .3 .4 .5 .6 ] LightSource \"point\"";
    let loaded = load_text(text).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let scene = loaded.scene;
    assert_eq!((scene.film, scene.time), ([30, 50], [2.0, 6.0]));
    assert!((scene.camera.fov - 35_f32.to_radians()).abs() < 1e-6);
    close(scene.camera.to_world.at(2.0).translation.into(), Vec3::new(-1.0, -2.0, -3.0));
    let end = DAffine3::from_translation(DVec3::new(1.0, 2.0, 3.0))
        * DAffine3::from_rotation_y(std::f64::consts::FRAC_PI_2);
    close(scene.camera.to_world.at(6.0).translation.into(), end.inverse().translation.as_vec3());
    let Mesh { positions, uvs, .. } = mesh(&scene.objects[0].shapes[0]);
    assert_eq!(positions[..], [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 8.0, 7.0]].map(Vec3::from));
    assert_eq!(uvs[..], [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]].map(Vec2::from));
    let at = |time: f32| scene.instances[0].to_world.at(time).transform_point3(positions[1]);
    close(at(2.0), positions[1] + Vec3::new(4.0, 5.0, 6.0));
    let turn = |degrees: f32| Quat::from_rotation_z(degrees.to_radians());
    close(
        at(6.0),
        Vec3::new(7.0, 9.0, 11.0) + turn(60.0) * (positions[1] * Vec3::new(2.0, 3.0, 4.0)),
    );
    close(
        at(4.0),
        Vec3::new(5.5, 7.0, 8.5) + turn(30.0) * (positions[1] * Vec3::new(1.5, 2.0, 2.5)),
    );
    close(scene.lights[0].to_world.at(4.0).translation.into(), Vec3::new(5.5, 7.0, 8.5));
}

#[test]
fn a_spectrum_may_be_a_file() {
    let folder = Folder::new("spectrum");
    folder.write("a.spd", b"# flat\n300 10\n800 10 # to the end\n");
    let text = |name: &str| {
        format!(
            "Camera \"perspective\" WorldBegin LightSource \"point\" \"spectrum I\" \"{name}\" \"float scale\" 3\n\
             Material \"conductor\" \"spectrum eta\" \"a.spd\""
        )
    };
    let scene = load(&folder.write("scene.pbrt", text("a.spd").as_bytes())).unwrap().scene;
    // An emission has luminance 1, whatever its values; an index keeps them.
    let LightKind::Point { intensity } = scene.lights[0].kind else { panic!() };
    assert!((crate::math::luminance(intensity) - 3.0).abs() < 1e-2, "{intensity}");
    let Material::Conductor { color: ConductorColor::Complex { eta, .. }, .. } = scene.materials[0]
    else {
        panic!()
    };
    assert!(matches!(eta, Color::Constant(c) if (c - 10.0).abs().max_element() < 1e-5));
    folder.write("b.spd", b"300 ten");
    let error = load(&folder.write("scene.pbrt", text("b.spd").as_bytes())).unwrap_err();
    assert!(
        error.to_string().ends_with(
            "scene.pbrt:1:53: \"b.spd\" holds more than numbers; allowed: wavelengths and values, comments after `#`"
        ),
        "{error}"
    );
}

#[test]
fn a_disk_with_a_hole_is_made_of_triangles() {
    let (scene, warnings) =
        world("Shape \"disk\" \"float radius\" 2 \"float innerradius\" 1.5 \"float height\" 3");
    assert_eq!(warnings, ["scene.pbrt:3:31: the disk has a hole: triangles take its place"]);
    let ring = mesh(&scene.objects[0].shapes[0]);
    let areas = ring.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|i| ring.positions[i as usize]);
        let cross = (b - a).cross(c - a);
        assert!(cross.z > 0.0 && a.z == 3.0);
        0.5 * cross.length()
    });
    let area: f32 = areas.sum();
    assert!((area / (std::f32::consts::PI * (4.0 - 2.25)) - 1.0).abs() < 1e-3, "{area}");
}

#[test]
fn maps_of_floats_and_targa_files_are_read() {
    let folder = Folder::new("formats");
    // Rows from the bottom up: the upper one is (1, 2, 3), 4, the lower 0.25 and 0.5.
    let rows = [0.25_f32, 0.25, 0.25, 0.5, 0.5, 0.5, 1.0, 2.0, 3.0, 4.0, 4.0, 4.0];
    let mut map = b"PF\n2 2\n-2.0\n".to_vec();
    map.extend(rows.iter().flat_map(|v| (0.5 * v).to_le_bytes()));
    folder.write("sky.pfm", &map);
    // Uncompressed, 24 bits in the order blue, green, red, rows from the bottom up.
    let mut targa = vec![0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 2, 0, 24, 0];
    targa.extend([10, 20, 30, 40, 50, 188]);
    folder.write("t.tga", &targa);
    let text = "Camera \"perspective\" WorldBegin LightSource \"infinite\" \"string filename\" \"sky.pfm\"\n\
        Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"t.tga\"";
    let loaded = load(&folder.write("scene.pbrt", text.as_bytes())).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let ImageData::Float(data) = &loaded.scene.images[0].data else { panic!() };
    assert_eq!(
        data[..],
        [[1.0, 2.0, 3.0, 1.0], [4.0, 4.0, 4.0, 1.0], [0.25, 0.25, 0.25, 1.0], [0.5, 0.5, 0.5, 1.0]]
    );
    let ImageData::Srgb8(data) = &loaded.scene.images[1].data else { panic!() };
    assert_eq!(data[..], [[188, 50, 40, 255], [30, 20, 10, 255]]);
    assert!(matches!(
        loaded.scene.lights[0].kind,
        LightKind::Environment { image: Some((_, EnvironmentMapping::EqualAreaOctahedral)), .. }
    ));
    // Big-endian and grey.
    let mut map = b"Pf 1 1 1\n".to_vec();
    map.extend(7.5_f32.to_be_bytes());
    let image = crate::scene::load::image_from_bytes(&map, Encoding::Srgb).unwrap();
    assert!(matches!(&image.data, ImageData::Float(data) if data[..] == [[7.5, 7.5, 7.5, 1.0]]));
    for (bytes, expected) in [
        (&map[..10], "damaged PFM picture: it ends too early"),
        (b"PF 1 x 1\n", "damaged PFM picture: its header has no width and height"),
        (b"PF 1 1 0\n", "damaged PFM picture: its header has no scale; allowed: any number but 0"),
        (&targa[..20], "damaged TGA picture: it ends too early"),
    ] {
        let error = crate::scene::load::image_from_bytes(bytes, Encoding::Srgb).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
}
