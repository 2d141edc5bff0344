//! Do small inputs that once failed give the picture that is right? The inputs stand here as text
//! or are built in code; the files of `../shared/cases` are rendered where they are there.
//!
//! Unless said otherwise the scene is a floor of albedo 0.5 under a lamp of 1 × 1 and radiance 10
//! at height 1, 2 m aside, seen at one point: ρ/π · 10 · ∫ (1 + x² + z²)⁻² dA = 0.0696.
//! What is loaded from each input is tested beside the loaders.

use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::luminance;
use afterimage::plan::{Claim, Shot};
use afterimage::scene::{
    Channel, Color, Image, ImageData, Material, MaterialId, Scalar, Scene, Shape, Texture,
    load::{self, pbrt_from_bytes},
};
use afterimage::techniques::parse;
use glam::{Affine3A, Vec3};

use crate::references::shared;
use crate::support::{
    assert_mean, assert_means, diffuse, look_at, mean_red, picture, polygon, shot,
};

/// A rectangle at height y, facing down or up.
fn plate(x: [f32; 2], y: f32, z: [f32; 2], up: bool) -> afterimage::scene::Geometry {
    let c = |i: usize, j: usize| Vec3::new(x[i], y, z[j]);
    let down = [c(0, 0), c(1, 0), c(1, 1), c(0, 1)];
    let [a, b, c, d] = down;
    if up { polygon(&[d, c, b, a]) } else { polygon(&down) }
}

/// Where a lamp is: from and to in x, and in z.
type Lamp = [[f32; 2]; 2];

/// That of the files.
const SMALL: Lamp = [[1.5, 2.5], [-0.5, 0.5]];

/// One that rays meet by chance often enough, so that `bsdf` has its say.
const LARGE: Lamp = [[-0.5, 3.5], [-2.0, 2.0]];

/// ∫ (1 + x² + z²)⁻² dA over the lamp, times ρ L / π.
fn truth([x, z]: Lamp) -> f64 {
    const N: usize = 400;
    let at = |[from, to]: [f32; 2], i: usize| {
        f64::from(from) + f64::from(to - from) * (i as f64 + 0.5) / N as f64
    };
    let term = |i: usize| (1.0 + at(x, i % N).powi(2) + at(z, i / N).powi(2)).powi(-2);
    let mean: f64 = (0..N * N).map(term).sum::<f64>() / (N * N) as f64;
    0.5 * 10.0 / std::f64::consts::PI * mean * f64::from((x[1] - x[0]) * (z[1] - z[0]))
}

/// Mean luminance in the first frames of four runs, with what is seen of emitters themselves.
fn mean(stage: &Stage, spec: &str, shot: Shot) -> f64 {
    let technique = Arc::from(parse(spec).unwrap());
    let mut frame_loop = FrameLoop::new(technique, stage, shot).unwrap();
    let mut sum = 0.0;
    for run in 0..4 {
        frame_loop.restart(run);
        let frame = frame_loop.render().unwrap();
        assert_eq!(frame.counters.non_finite, 0, "{spec}");
        let pictures = [frame.picture(), frame.emission()];
        let pixels = pictures.iter().flat_map(|picture| &picture.pixels);
        let total: f64 = pixels.map(|p| f64::from(luminance(*p))).sum();
        sum += total / shot.pixels() as f64;
    }
    sum / 4.0
}

/// The floor and its lamp, seen from aside, under the lamp; `change` may change it.
fn floor_and_lamp([x, z]: Lamp, change: impl Fn(&mut Shape)) -> Scene {
    let mut scene = Scene::new("floor and lamp");
    let grey = diffuse(&mut scene, 0.5);
    let black = diffuse(&mut scene, 0.0);
    scene.add_shape(Shape::new(plate([-5.0, 5.0], 0.0, [-5.0, 5.0], true), grey));
    let mut lamp = Shape::new(plate(x, 1.0, z, false), black).emitting(Vec3::splat(10.0));
    change(&mut lamp);
    scene.add_shape(lamp);
    scene.camera = look_at(Vec3::new(-3.0, 0.5, 0.0), Vec3::ZERO, 1e-4);
    scene
}

/// glTF's surface without any reflection.
fn black_one_sided(scene: &mut Scene, double_sided: bool) -> MaterialId {
    scene.add_material(Material::MetallicRoughness {
        base_color: Color::Constant(Vec3::ZERO),
        metallic: Scalar::Constant(0.0),
        roughness: Scalar::Constant(1.0),
        ior: 1.5,
        specular: Scalar::Constant(0.0),
        specular_color: Color::Constant(Vec3::ZERO),
        transmission: Scalar::Constant(0.0),
        double_sided,
    })
}

#[test]
fn the_truth_is_that_of_the_files() {
    assert!((truth(SMALL) - 0.0696).abs() < 5e-5, "{}", truth(SMALL));
}

/// An emitter with alpha 0 is met by no ray and still emits: what samples lights finds it, what
/// does not says so.
#[test]
fn an_emitter_that_no_ray_meets_still_emits() {
    for two_sided in [false, true] {
        let scene = floor_and_lamp(LARGE, |lamp| {
            lamp.alpha = Some(Scalar::Constant(0.0));
            lamp.emission.as_mut().unwrap().two_sided = two_sided;
        });
        let stage = Stage::new(scene.clone()).unwrap();
        let counts = stage.facts().lights;
        assert_eq!((counts.delta, counts.triangles, counts.black), (2, 0, 0));
        let shot = shot([4, 4], 2, 1);
        let claim = parse("bsdf").unwrap().plan(stage.facts(), &shot).claim;
        assert!(matches!(claim, Claim::Biased(_)), "{claim:?}");
        assert_means(scene, shot, truth(LARGE));
        // Seen from below it is not there either.
        let mut below = floor_and_lamp(SMALL, |lamp| lamp.alpha = Some(Scalar::Constant(0.0)));
        below.camera = look_at(Vec3::new(2.0, 0.5, 0.0), Vec3::new(2.0, 1.0, 0.0), 0.1);
        let black = picture(&Stage::new(below).unwrap(), "nee", shot);
        assert!(black.pixels.iter().all(|p| *p == Vec3::ZERO));
    }
}

/// A sphere without coverage is drawn by area, from inside and outside.
#[test]
fn a_sphere_that_no_ray_meets_lights_like_a_small_lamp() {
    let mut scene = floor_and_lamp(SMALL, |lamp| lamp.emission = None);
    let (center, radius) = (Vec3::new(0.0, 1.0, 0.0), 0.25);
    let sphere = afterimage::scene::Geometry::Sphere { center, radius };
    let mut lamp = Shape::new(sphere, MaterialId(1)).emitting(Vec3::splat(10.0));
    lamp.alpha = Some(Scalar::Constant(0.0));
    scene.add_shape(lamp);
    // A sphere right above: π L (r / d)² of irradiance.
    assert_means(scene, shot([4, 4], 2, 1), 0.5 * 10.0 * 0.0625);
}

/// Camera rays pass the backs of one-sided surfaces, which no other ray of this scene meets.
#[test]
fn backs_of_one_sided_surfaces_are_not_seen() {
    // Upright between the camera and what it looks at, facing either of them.
    let screen = |x: f32, to_camera: bool| {
        let c = |y: f32, z: f32| Vec3::new(x, y, z);
        let corners = [c(0.1, -0.2), c(0.1, 0.2), c(0.4, 0.2), c(0.4, -0.2)];
        let [a, b, c, d] = corners;
        if to_camera { polygon(&corners) } else { polygon(&[d, c, b, a]) }
    };
    let behind = |double_sided: bool, to_camera: bool| {
        let mut scene = floor_and_lamp(LARGE, |_| ());
        let material = black_one_sided(&mut scene, double_sided);
        scene.add_shape(Shape::new(screen(-1.5, to_camera), material));
        scene
    };
    let shot = shot([4, 4], 2, 1);
    assert_means(behind(false, false), shot, truth(LARGE));
    for (double_sided, to_camera) in [(false, true), (true, true), (true, false)] {
        let stage = Stage::new(behind(double_sided, to_camera)).unwrap();
        for technique in ["nee", "bsdf", "ris", "restir-di"] {
            assert_eq!(mean(&stage, technique, shot), 0.0, "{technique}");
        }
    }
    // Two backs behind each other, and one with holes: coverage is asked for as well.
    let mut scene = behind(false, false);
    let shape = scene.objects[2].shapes[0].clone();
    for (x, alpha) in [(-1.6, None), (-1.4, Some(Scalar::Constant(0.5)))] {
        let geometry = screen(x, false);
        scene.add_shape(Shape { geometry, alpha, ..shape.clone() });
    }
    assert_mean(&Stage::new(scene).unwrap(), "nee", shot, truth(LARGE));
}

/// All other rays meet them: they shade, in every technique, and are black.
#[test]
fn backs_of_one_sided_surfaces_shade() {
    for up in [false, true] {
        let mut scene = floor_and_lamp(LARGE, |_| ());
        let material = black_one_sided(&mut scene, false);
        // Between the point that is seen and the lamp; its back is up or down.
        scene.add_shape(Shape::new(plate([-0.5, 2.0], 0.5, [-1.5, 1.5], up), material));
        let stage = Stage::new(scene).unwrap();
        for technique in ["nee", "nee:lights=all", "bsdf", "ris", "restir-di"] {
            let found = mean(&stage, technique, shot([4, 4], 3, 16));
            assert_eq!(found, 0.0, "{technique}, {up}");
        }
    }
}

/// A lamp in a mirrored instance shines to where its front is, for light sampling as for rays that
/// meet it; half of them would be missed if one of the two were turned around.
#[test]
fn a_lamp_in_a_mirrored_instance_shines_to_its_front() {
    for (mirror, smooth) in [(Vec3::new(-1.0, 1.0, 1.0), false), (Vec3::new(1.0, 1.0, -1.0), true)]
    {
        let mut scene = floor_and_lamp(LARGE, |lamp| {
            if smooth && let afterimage::scene::Geometry::Mesh(mesh) = &mut lamp.geometry {
                Arc::make_mut(mesh).normals = vec![Vec3::NEG_Y; 4];
            }
        });
        // Mirrored about its own middle, in place.
        let middle = Affine3A::from_translation(Vec3::new(1.5, 1.0, 0.0));
        let to_world = middle * Affine3A::from_scale(mirror) * middle.inverse();
        scene.instances[1].to_world = afterimage::scene::Transform::Fixed(to_world);
        assert_means(scene, shot([4, 4], 2, 1), truth(LARGE));
    }
}

/// `emissiveStrength` times a texture: the strength counts where there is a texture, too.
#[test]
fn textured_emission_is_as_bright_as_its_strength_says() {
    let mut scene = floor_and_lamp(LARGE, |_| ());
    let pixels = vec![[5.0, 5.0, 5.0, 1.0]; 4];
    let image = scene.add_image(Image { width: 2, height: 2, data: ImageData::Float(pixels) });
    let texture = scene.add_texture(Texture::image(image));
    let lamp = &mut Arc::make_mut(&mut scene.objects[1]).shapes[0];
    let emission = lamp.emission.as_mut().unwrap();
    (emission.radiance, emission.scale) = (Color::Texture(texture), 2.0);
    lamp.alpha = Some(Scalar::Texture(texture, Channel::Alpha));
    assert_means(scene, shot([4, 4], 2, 1), truth(LARGE));
}

/// What is inside of a ball that emits 0.1 and reflects 0.9 is 1 − 0.9ⁿ with n segments: a file's
/// 63 bounces are 64 segments.
#[test]
fn as_many_bounces_as_the_file_asks_for() {
    let text = "Camera \"perspective\" \"float fov\" 60\nIntegrator \"path\" \"integer maxdepth\" 63\nWorldBegin\n\
        ReverseOrientation AreaLightSource \"diffuse\" \"rgb L\" [ .1 .1 .1 ]\n\
        Material \"diffuse\" \"rgb reflectance\" [ .9 .9 .9 ] Shape \"sphere\"";
    let scene = pbrt_from_bytes(text.as_bytes(), "ball.pbrt".as_ref()).unwrap().scene;
    assert_eq!(scene.depth, 64);
    let stage = Stage::new(scene).unwrap();
    for segments in [8, 64] {
        // Without roulette nothing is random.
        let found = mean(&stage, "bsdf:roulette=1000", shot([8, 8], segments, 1));
        let truth = 1.0 - 0.9_f64.powi(segments as i32);
        assert!((found / truth - 1.0).abs() < 1e-5, "{found} instead of {truth}");
    }
}

/// A glass ball of any index in a white sky is white.
#[test]
fn a_ball_of_glass_with_an_rgb_index_keeps_a_white_sky_white() {
    let text = "LookAt 0 0 -5  0 0 0  0 1 0 Camera \"perspective\" \"float fov\" 14\nIntegrator \"path\" \"integer maxdepth\" 60\nWorldBegin\n\
        LightSource \"infinite\" Material \"dielectric\" \"rgb eta\" [ 1.5 1.5 1.5 ] Shape \"sphere\"";
    let loaded = pbrt_from_bytes(text.as_bytes(), "ball.pbrt".as_ref()).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let stage = Stage::new(loaded.scene).unwrap();
    let found = mean(&stage, "nee:roulette=1000", shot([16, 16], 61, 1));
    assert!((found - 1.0).abs() < 1e-4, "{found}");
}

/// The files of the collection, where they are there: means over the picture's pixels.
#[test]
fn files_of_the_collection() {
    // File, depth in place of its own, mean, warnings.
    let cases: [(&str, u32, f64, &[&str]); 15] = [
        ("gltf_custom_attribute.gltf", 2, 0.0693, &[]),
        ("gltf_extras_number.gltf", 2, 0.0693, &[]),
        ("gltf_back_face_culled.gltf", 2, 0.0693, &[]),
        ("gltf_black_emissive_texture.gltf", 2, 0.498, &["a white sky"]),
        ("gltf_scale_zero_step.gltf", 2, 0.0693, &[]),
        ("pbrt_maxdepth_cap.pbrt", 64, 0.9988, &[]),
        (
            "ply_asc_one_nan_n.pbrt",
            2,
            0.0696,
            &["\"ply_asc_one_nan_n.ply\": the normal of vertex 0"],
        ),
        ("pbrt_tga.pbrt", 2, 0.0700, &[]),
        ("pbrt_pfm.pbrt", 2, 0.0696, &[]),
        ("pbrt_furnace_rgb_eta.pbrt", 61, 1.0, &[]),
        // 17³ balls and a lamp; nothing below them, so that the picture is black.
        ("pbrt_many_includes.pbrt", 2, f64::NAN, &[]),
        ("pbrt_invisible_emitter.pbrt", 2, 0.0696, &[]),
        ("pbrt_all_normals.pbrt", 2, f64::NAN, &[]),
        ("pbrt_spd.pbrt", 2, 0.00696, &[]),
        ("pbrt_annulus.pbrt", 2, f64::NAN, &["the disk has a hole"]),
    ];
    for (file, depth, truth, warnings) in cases {
        let Some(path) = shared(&format!("cases/{file}")) else { return };
        let loaded = load::load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(loaded.warnings.len(), warnings.len(), "{file}: {:?}", loaded.warnings);
        for (found, expected) in loaded.warnings.iter().zip(warnings) {
            assert!(found.contains(file) && found.contains(expected), "{found}");
        }
        let mut shot = shot([16, 16], depth, 16);
        let stage = Stage::new(loaded.scene.clone()).unwrap();
        let found = mean(&stage, "nee:roulette=1000", shot);
        println!("{file}: {found:.4}");
        if file.contains("includes") {
            assert_eq!(loaded.scene.objects[0].shapes.len(), 17 * 17 * 17 + 1);
        }
        if truth.is_finite() {
            assert!((found / truth - 1.0).abs() < 0.01, "{file}: {found} instead of {truth}");
        }
        if file.contains("scale_zero") {
            // 2 frames a second: hidden in the second one.
            shot.fps = 2;
            let hidden = crate::support::last_frame(&stage, "nee", shot, 2).0;
            assert!(hidden.pixels.iter().all(|p| *p == Vec3::ZERO));
            let again = crate::support::last_frame(&stage, "nee", shot, 3).0;
            assert!((mean_red(&again) / truth - 1.0).abs() < 0.02);
        }
    }
    // One normal of length 0 changes nothing outside of the triangles at its vertex.
    let [all, one] = ["pbrt_all_normals.pbrt", "pbrt_one_zero_normal.pbrt"].map(|file| {
        let path = shared(&format!("cases/{file}")).expect("the others are there");
        let stage = Stage::new(load::load(&path).unwrap().scene).unwrap();
        picture(&stage, "nee", shot([32, 32], 2, 1))
    });
    let differ = all.pixels.iter().zip(&one.pixels).filter(|(a, b)| a != b).count();
    println!("{differ} of 1024 pixels differ");
    assert!((1..200).contains(&differ), "{differ}");
}
