//! Awkward scenes and inputs: every technique gives finite pictures, typed errors, and the stated
//! answer.
//!
//! Rays and lobes have their own corners tested where they live (`src/accel`, `src/surface/bsdf`);
//! here whole frames are rendered. Ids are those of the table in `docs/testing.md`.

use std::sync::Arc;

use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::picture::Picture;
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{
    Camera, Channel, Color, ConductorColor, EnvironmentMapping, Geometry, Image, ImageData, Light,
    LightKind, Material, Mesh, Roughness, Scalar, Scene, Shape, SpotFalloff, Texture, TextureKind,
    Transform, Wrap, many_lights,
};
use afterimage::stats::{Estimate, Moments, welch};
use afterimage::techniques::{REGISTRY, parse};
use glam::{Affine2, Affine3A, Vec2, Vec3};
use proptest::prelude::*;

use crate::support::{diffuse, look_at, polygon, shot, sphere};

/// Renders two frames of every technique with both filters and of all variants; all of them must be
/// finite, and not below 0 where the technique says so. The last technique's picture and its work.
fn survives(id: &str, scene: Scene) -> (Picture, Counters) {
    let stage = Stage::new(scene).unwrap_or_else(|e| panic!("{id}: {e}"));
    for entry in REGISTRY {
        for keys in (entry.variants)() {
            let technique = entry.parse(&keys).unwrap();
            let signed = technique.signed();
            let mut frames =
                FrameLoop::new(Arc::from(technique), &stage, shot([16, 16], 6, 1)).unwrap();
            frames.render().unwrap();
            let frame = frames.render().unwrap();
            let picture = frame.picture();
            let lost = (frame.counters.non_finite, picture.non_finite());
            assert_eq!(lost, (0, 0), "{id} {}:{keys}", entry.name);
            let least = least(&picture);
            assert!(signed || least >= 0.0, "{id} {}:{keys}: light of {least:e}", entry.name);
        }
    }
    defaults_survive(id, &stage)
}

/// [`survives`] without variants.
fn defaults_survive(id: &str, stage: &Stage) -> (Picture, Counters) {
    let mut last = None;
    for entry in REGISTRY {
        for filter in [Filter::Box, Filter::Point] {
            let shot = Shot { filter, ..shot([16, 16], 6, 2) };
            let technique = parse(entry.name).unwrap();
            let signed = technique.signed();
            let mut frames = FrameLoop::new(Arc::from(technique), stage, shot).unwrap();
            frames.render().unwrap();
            let frame = frames.render().unwrap();
            let picture = frame.picture();
            assert_eq!(frame.counters.non_finite, 0, "{id} {} {filter:?}", entry.name);
            assert_eq!(
                picture.non_finite() + frame.emission().non_finite(),
                0,
                "{id} {} {filter:?}",
                entry.name
            );
            let least = least(&picture);
            assert!(signed || least >= 0.0, "{id} {} {filter:?}: light of {least:e}", entry.name);
            last = Some((picture, frame.counters));
        }
    }
    last.expect("a technique")
}

fn least(picture: &Picture) -> f32 {
    picture.pixels.iter().map(|p| p.min_element()).fold(f32::MAX, f32::min)
}

/// A floor around the origin and a camera above it.
fn floor(material: impl FnOnce(&mut Scene) -> Material) -> Scene {
    let mut scene = Scene::new("floor");
    let material = material(&mut scene);
    let material = scene.add_material(material);
    let corner = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    let corners = [corner(-2.0, -2.0), corner(-2.0, 2.0), corner(2.0, 2.0), corner(2.0, -2.0)];
    scene.add_shape(Shape::new(polygon(&corners), material));
    scene.camera = look_at(Vec3::new(0.0, 2.0, -3.0), Vec3::ZERO, 0.9);
    scene
}

fn lambert(albedo: f32) -> impl FnOnce(&mut Scene) -> Material {
    move |_| Material::Diffuse { reflectance: Color::Constant(Vec3::splat(albedo)) }
}

fn lamp(scene: &mut Scene, center: Vec3, half: f32, radiance: f32) {
    let black = diffuse(scene, 0.0);
    let corner = |x: f32, z: f32| center + half * Vec3::new(x, 0.0, z);
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    scene.add_shape(Shape::new(polygon(&corners), black).emitting(Vec3::splat(radiance)));
}

fn light(scene: &mut Scene, kind: LightKind, to_world: Affine3A) {
    let key = scene.lights.len() as u64;
    scene.lights.push(Light { to_world: Transform::Fixed(to_world), kind, key });
}

fn sky(scene: &mut Scene, radiance: f32) {
    let kind = LightKind::Environment { radiance: Vec3::splat(radiance), image: None };
    light(scene, kind, Affine3A::IDENTITY);
}

fn mean(picture: &Picture) -> f64 {
    picture.mean_luminance()
}

/// Mean luminance of `frames` frames of `nee`, as independent samples.
fn estimate(scene: Scene, shot: Shot, frames: u32) -> Estimate {
    let stage = Stage::new(scene).unwrap();
    let mut moments = Moments::default();
    let mut frame_loop = FrameLoop::new(Arc::from(parse("nee").unwrap()), &stage, shot).unwrap();
    for _ in 0..frames {
        moments.push(mean(&frame_loop.render().unwrap().picture()));
    }
    moments.estimate()
}

#[test]
fn g6_points_on_beside_and_behind_a_light() {
    for (id, height) in [("on", 0.0), ("just above", 1e-6), ("behind", -1e-6)] {
        let mut scene = floor(lambert(0.5));
        lamp(&mut scene, Vec3::new(0.0, height, 0.0), 0.5, 10.0);
        survives(&format!("G6 {id}"), scene);
    }
    let mut edge_on = floor(lambert(0.5));
    let black = diffuse(&mut edge_on, 0.0);
    let corners = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0)];
    edge_on.add_shape(Shape::new(polygon(&corners), black).emitting(Vec3::ONE));
    survives("G6 edge-on", edge_on);
}

#[test]
fn g10_nothing_one_triangle_and_degenerate_triangles() {
    let (picture, counters) = survives("G10 empty", Scene::new("empty"));
    assert_eq!((mean(&picture), counters.shadow_rays + counters.bounce_rays), (0.0, 0));
    let mut needle = floor(lambert(0.5));
    let black = diffuse(&mut needle, 0.0);
    for corners in [
        [Vec3::Y, Vec3::Y, Vec3::Y],
        [Vec3::Y, 2.0 * Vec3::Y, 3.0 * Vec3::Y],
        [Vec3::Y, Vec3::Y + 1e-7 * Vec3::X, Vec3::Y + 10.0 * Vec3::Z],
    ] {
        needle.add_shape(Shape::new(polygon(&corners), black).emitting(Vec3::ONE));
    }
    survives("G1 degenerate emitters", needle);
}

#[test]
fn g12_shading_normals_that_disagree() {
    for normals in [
        vec![-Vec3::Y; 3],
        vec![Vec3::X; 3],
        vec![Vec3::Y, -Vec3::Y, Vec3::Y],
        vec![Vec3::new(0.9, 0.43, 0.0); 3],
    ] {
        let mut scene = floor(lambert(0.5));
        let grey = diffuse(&mut scene, 0.5);
        let mesh = Mesh {
            positions: vec![
                Vec3::new(-1.0, 0.2, -1.0),
                Vec3::new(0.0, 0.2, 1.0),
                Vec3::new(1.0, 0.2, -1.0),
            ],
            normals: normals.iter().map(|n| n.normalize()).collect(),
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), grey));
        sky(&mut scene, 1.0);
        lamp(&mut scene, Vec3::new(0.0, 3.0, 0.0), 0.3, 20.0);
        survives("G12", scene);
    }
}

/// The sun stands under the floor, and a second floor lies 10⁻⁵ below the first: no light may come
/// through, at any scale.
#[test]
fn g13_a_thin_wall_does_not_leak() {
    for scale in [1e-3_f32, 1.0, 1e3] {
        let mut scene = floor(lambert(0.8));
        let grey = diffuse(&mut scene, 0.8);
        let corner = |x: f32, z: f32| Vec3::new(x, -1e-5, z);
        scene.add_shape(Shape::new(
            polygon(&[corner(-2.0, -2.0), corner(-2.0, 2.0), corner(2.0, 2.0), corner(2.0, -2.0)]),
            grey,
        ));
        let up = Affine3A::from_cols(
            Vec3::X.into(),
            Vec3::NEG_Z.into(),
            Vec3::Y.into(),
            Vec3::ZERO.into(),
        );
        light(&mut scene, LightKind::Distant { irradiance: Vec3::splat(1e3) }, up);
        let grow = Affine3A::from_scale(Vec3::splat(scale));
        for instance in &mut scene.instances {
            instance.to_world = Transform::Fixed(grow);
        }
        scene.camera = look_at(scale * Vec3::new(0.0, 2.0, -3.0), Vec3::ZERO, 0.6);
        let (picture, _) = survives("G13", scene);
        assert_eq!(mean(&picture), 0.0, "light came through at scale {scale}");
    }
}

#[test]
fn m1_roughness_crosses_the_smooth_limit_without_a_jump() {
    let metal = |alpha: f32| {
        let mut scene = floor(move |_| Material::Conductor {
            color: ConductorColor::Reflectance(Color::Constant(Vec3::splat(0.9))),
            roughness: Roughness::isotropic(alpha),
        });
        sky(&mut scene, 1.0);
        survives("M1", scene).0
    };
    // The floor mirrors a constant sky: 0.9 plus a little at grazing angles, whatever the
    // roughness.
    let smooth = mean(&metal(0.0));
    for alpha in [1e-6, 1e-4, 9.99e-4, 1.001e-3, 2e-3] {
        let rough = mean(&metal(alpha));
        assert!((rough / smooth - 1.0).abs() < 0.01, "α = {alpha}: {rough} against {smooth}");
    }
}

#[test]
fn m8_m11_textured_roughness_and_one_sided_surfaces() {
    let mut scene = floor(|scene| {
        let texels = (0..64_u8).map(|i| [i * 4, i * 4, i * 4, 255]).collect();
        let image =
            scene.add_image(Image { width: 8, height: 8, data: ImageData::Linear8(texels) });
        let kind = TextureKind::Image { image, wrap: Wrap::Repeat, scale: 1.0, invert: false };
        let texture =
            scene.add_texture(Texture { kind, mapping: Affine2::from_scale(Vec2::splat(100.0)) });
        let alpha = Scalar::Texture(texture, Channel::Red);
        Material::Conductor {
            color: ConductorColor::Reflectance(Color::Constant(Vec3::splat(0.9))),
            roughness: Roughness { u: alpha, v: alpha, remap: false },
        }
    });
    lamp(&mut scene, Vec3::new(0.0, 1.0, 1.0), 0.2, 50.0);
    survives("M8", scene);

    let one_sided = |double_sided| {
        let mut scene = floor(move |_| Material::MetallicRoughness {
            base_color: Color::Constant(Vec3::splat(0.8)),
            metallic: Scalar::Constant(0.0),
            roughness: Scalar::Constant(0.5),
            ior: 1.5,
            specular: Scalar::Constant(1.0),
            specular_color: Color::Constant(Vec3::ONE),
            transmission: Scalar::Constant(0.0),
            double_sided,
        });
        sky(&mut scene, 1.0);
        scene.camera = look_at(Vec3::new(0.0, -2.0, -3.0), Vec3::ZERO, 0.3);
        mean(&survives("M11", scene).0)
    };
    assert!(one_sided(true) > 0.5, "the back of a double-sided surface reflects");
    assert_eq!(one_sided(false), 0.0, "the back of a one-sided one does not");
}

#[test]
fn m9_black_surfaces_ask_no_light() {
    let mut scene = floor(lambert(0.0));
    lamp(&mut scene, Vec3::new(0.0, 2.0, 0.0), 0.5, 10.0);
    let (picture, counters) = survives("M9", scene);
    assert_eq!((mean(&picture), counters.shadow_rays, counters.bounce_rays), (0.0, 0, 0));
}

#[test]
fn m12_tiny_throughput_and_albedo_just_below_one() {
    for albedo in [1e-7, 1.0 - f32::EPSILON / 2.0, 1.0] {
        let mut scene = Scene::new("closed");
        let material = diffuse(&mut scene, albedo);
        scene.add_shape(sphere(1.0, material).emitting(Vec3::ONE));
        scene.camera = look_at(0.2 * Vec3::X, Vec3::Z, 1.0);
        survives("M12", scene);
    }
}

#[test]
fn l1_no_light_or_only_black_ones() {
    for radiance in [None, Some(0.0)] {
        let mut scene = floor(lambert(0.5));
        if let Some(radiance) = radiance {
            lamp(&mut scene, Vec3::new(0.0, 2.0, 0.0), 0.5, radiance);
            sky(&mut scene, radiance);
        }
        let (picture, counters) = survives("L1", scene);
        assert_eq!((mean(&picture), counters.shadow_rays), (0.0, 0));
    }
}

/// Powers of 10⁻²⁰ and 10²⁰ together: the picture is that of the strong one, to rounding.
#[test]
fn l2_powers_forty_decades_apart() {
    let scene = |weak: bool, strong: bool| {
        let mut scene = floor(lambert(0.5));
        if weak {
            lamp(&mut scene, Vec3::new(1.0, 2.0, 0.0), 0.5, 1e-20);
        }
        if strong {
            lamp(&mut scene, Vec3::new(-1.0, 2.0, 0.0), 0.5, 1e20);
        }
        scene
    };
    let both = mean(&survives("L2", scene(true, true)).0);
    let strong = mean(&survives("L2", scene(false, true)).0);
    assert!((both / strong - 1.0).abs() < 0.05, "{both} {strong}");
    assert!(mean(&survives("L2", scene(true, false)).0) > 0.0);
}

#[test]
fn l3_a_million_lights() {
    let (picture, _) = survives("L3", many_lights(100_000, 3));
    assert!(mean(&picture) > 0.0);
}

#[test]
#[ignore = "slow: builds a million lights"]
fn l3_slow_a_full_million() {
    let stage = Stage::new(many_lights(1_000_000, 3)).unwrap();
    assert!(mean(&defaults_survive("L3", &stage).0) > 0.0);
}

/// From a speck to half the sphere of directions: the irradiance of a small lamp is L A cos cos /
/// d².
#[test]
fn l4_lights_of_every_size() {
    for half in [1e-14_f32, 1e-6, 1e-3, 0.1, 10.0, 1e3, 1e11] {
        let mut scene = floor(lambert(0.5));
        let radiance = if half < 1.0 { 1.0 / (4.0 * half * half) } else { 1.0 };
        lamp(&mut scene, Vec3::new(0.0, 1.0, 0.0), half, radiance);
        scene.camera = look_at(Vec3::new(0.0, 0.9, -0.01), Vec3::ZERO, 0.01);
        let value = mean(&survives("L4", scene).0);
        // Under the lamp: E = 1 for the small ones (radiant intensity 1 at distance 1), π for an
        // infinite ceiling.
        let truth =
            0.5 / std::f64::consts::PI * if half < 1.0 { 1.0 } else { std::f64::consts::PI };
        assert!((value / truth - 1.0).abs() < 0.05, "half width {half}: {value} against {truth}");
    }
}

/// Emitters too far or too large to be hit are dark: the picture is, bit for bit, that without
/// them.
#[test]
fn l4_lights_beyond_every_size() {
    let scene = |wild: bool| {
        let mut scene = floor(lambert(0.5));
        if wild {
            lamp(&mut scene, Vec3::new(0.0, 1.0, 0.0), 3e19, 1.0);
            let black = diffuse(&mut scene, 0.0);
            scene.add_shape(sphere(1e19, black).emitting(Vec3::ONE));
            let far = polygon(&[Vec3::splat(1e30), Vec3::X, Vec3::Y]);
            scene.add_shape(Shape::new(far, black).emitting(Vec3::ONE));
        }
        lamp(&mut scene, Vec3::new(0.0, 2.0, 0.0), 0.5, 10.0);
        sky(&mut scene, 0.1);
        scene
    };
    let (with, without) = (survives("L4", scene(true)).0, survives("L4", scene(false)).0);
    assert!(mean(&without) > 0.0);
    assert_eq!(with.pixels, without.pixels);
}

#[test]
fn l5_environments_with_a_sun_in_one_texel_and_odd_sizes() {
    for mapping in [EnvironmentMapping::LatitudeLongitude, EnvironmentMapping::EqualAreaOctahedral]
    {
        for [width, height] in [[1, 1], [64, 64], [16, 1]] {
            if mapping == EnvironmentMapping::EqualAreaOctahedral && width != height {
                continue;
            }
            let mut texels = vec![[0.01_f32, 0.02, 0.03, 1.0]; (width * height) as usize];
            texels[(width * height / 3) as usize] = [1e6, 1e6, 1e6, 1.0];
            let mut scene = floor(lambert(0.5));
            let image = scene.add_image(Image { width, height, data: ImageData::Float(texels) });
            let kind =
                LightKind::Environment { radiance: Vec3::ONE, image: Some((image, mapping)) };
            light(&mut scene, kind, Affine3A::IDENTITY);
            survives("L5", scene);
        }
    }
}

#[test]
fn l6_point_and_spot_lights_almost_on_the_surface() {
    for height in [1e-6, 1e-3, 1.0] {
        let mut scene = floor(lambert(0.5));
        let at = Affine3A::from_translation(Vec3::new(0.0, height, 0.0));
        light(&mut scene, LightKind::Point { intensity: Vec3::ONE }, at);
        let down =
            Affine3A::from_cols(Vec3::X.into(), Vec3::Z.into(), Vec3::NEG_Y.into(), at.translation);
        for falloff in [SpotFalloff::Smoothstep, SpotFalloff::Quadratic] {
            light(
                &mut scene,
                LightKind::Spot { intensity: Vec3::ONE, cos_inner: 0.9, cos_outer: 0.9, falloff },
                down,
            );
            light(
                &mut scene,
                LightKind::Spot { intensity: Vec3::ONE, cos_inner: 1.0, cos_outer: 0.5, falloff },
                down,
            );
        }
        survives("L6", scene);
    }
}

/// Light adds up: a scene with four kinds of light is the sum of four scenes. α = 10⁻⁴, 64 × 256
/// pixels see about 1 %.
#[test]
fn l7_superposition() {
    let kinds: [fn(&mut Scene); 4] = [
        |scene| lamp(scene, Vec3::new(0.0, 2.0, 0.0), 0.5, 4.0),
        |scene| sky(scene, 0.5),
        |scene| {
            let at = Affine3A::from_translation(Vec3::new(1.0, 1.0, 0.0));
            light(scene, LightKind::Point { intensity: Vec3::ONE }, at);
        },
        |scene| {
            let down = Affine3A::from_cols(
                Vec3::X.into(),
                Vec3::Z.into(),
                Vec3::NEG_Y.into(),
                Vec3::ZERO.into(),
            );
            light(scene, LightKind::Distant { irradiance: Vec3::splat(0.7) }, down);
        },
    ];
    let render = |chosen: &[usize]| {
        let mut scene = floor(lambert(0.5));
        if !chosen.contains(&0) {
            // Unlit it still stands in the way of the others.
            lamp(&mut scene, Vec3::new(0.0, 2.0, 0.0), 0.5, 0.0);
        }
        chosen.iter().for_each(|i| kinds[*i](&mut scene));
        estimate(scene, shot([16, 16], 4, 4), 64)
    };
    let all = render(&[0, 1, 2, 3]);
    let parts: Vec<Estimate> = (0..4).map(|i| render(&[i])).collect();
    let sum = Estimate::with_variance(
        parts.iter().map(|e| e.mean).sum(),
        parts.iter().map(|e| e.variance).sum(),
        63.0,
    );
    let test = welch(&all, &sum);
    assert!(test.p > 1e-4, "{test:?}");
    assert!(test.standard_error < 0.01 * all.mean, "the test cannot see 3 %: {test:?}");
    let short = Estimate::with_variance(sum.mean - parts[2].mean, sum.variance, 63.0);
    assert!(welch(&all, &short).p < 1e-4, "the control without the point light must fail");
}

#[test]
fn l10_one_sided_emitters_from_behind_are_dark() {
    let mut scene = floor(lambert(0.5));
    let grey = diffuse(&mut scene, 0.5);
    // Its normal points up, away from the floor.
    let corner = |x: f32, z: f32| Vec3::new(x, 1.0, z);
    let corners = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    scene.add_shape(Shape::new(polygon(&corners), grey).emitting(Vec3::ONE));
    scene.camera = look_at(Vec3::new(0.0, 0.5, -0.6), Vec3::ZERO, 0.5);
    assert_eq!(mean(&survives("L10", scene).0), 0.0);
}

/// One texel in a thousand shines. Its light must arrive: within 5 % of the area's share of a plain
/// lamp.
#[test]
fn l12_an_emitter_that_is_almost_black() {
    let build = |textured: bool| {
        let mut scene = floor(lambert(0.5));
        let black = diffuse(&mut scene, 0.0);
        let mut shape = Shape::new(
            Geometry::Mesh(Arc::new(Mesh {
                positions: vec![
                    Vec3::new(-1.0, 3.0, -1.0),
                    Vec3::new(1.0, 3.0, -1.0),
                    Vec3::new(1.0, 3.0, 1.0),
                    Vec3::new(-1.0, 3.0, 1.0),
                ],
                normals: Vec::new(),
                uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
            })),
            black,
        )
        .emitting(Vec3::ONE);
        if textured {
            let mut texels = vec![[0.0, 0.0, 0.0, 1.0]; 1024];
            texels[17 * 32 + 15] = [1024.0, 1024.0, 1024.0, 1.0];
            let image =
                scene.add_image(Image { width: 32, height: 32, data: ImageData::Float(texels) });
            let texture = scene.add_texture(Texture::image(image));
            shape.emission.as_mut().expect("it emits").radiance = Color::Texture(texture);
        }
        scene.add_shape(shape);
        scene.camera = look_at(Vec3::new(0.0, 2.0, -1.0), Vec3::ZERO, 0.2);
        scene
    };
    survives("L12", build(true));
    let textured = estimate(build(true), shot([16, 16], 2, 64), 32);
    let plain = estimate(build(false), shot([16, 16], 2, 4), 32);
    assert!(
        (textured.mean / plain.mean - 1.0).abs()
            < 0.05 + 4.0 * textured.variance.sqrt() / plain.mean,
        "{textured:?} {plain:?}"
    );
}

#[test]
fn c1_cameras_in_odd_places() {
    for (id, camera) in [
        ("inside the floor", look_at(Vec3::ZERO, Vec3::X, 1.0)),
        ("at the lamp", look_at(Vec3::new(0.0, 2.0, 0.0), Vec3::ZERO, 1.0)),
        ("narrow", look_at(Vec3::new(0.0, 2.0, -3.0), Vec3::ZERO, 0.01_f32.to_radians())),
        ("wide", look_at(Vec3::new(0.0, 2.0, -3.0), Vec3::ZERO, 179_f32.to_radians())),
        ("far away", look_at(Vec3::new(0.0, 1e6, -1e6), Vec3::ZERO, 1e-6)),
    ] {
        let mut scene = floor(lambert(0.5));
        lamp(&mut scene, Vec3::new(0.0, 2.0, 0.0), 0.5, 10.0);
        scene.camera = camera;
        survives(&format!("C1 {id}"), scene);
    }
}

#[test]
fn i1_i2_i3_bad_shots_and_bad_scenes_are_typed_errors() {
    let stage = Stage::new(floor(lambert(0.5))).unwrap();
    let technique = || Arc::from(parse("nee").unwrap());
    for bad in [
        shot([0, 16], 4, 1),
        shot([16, 0], 4, 1),
        shot([1 << 16, 1 << 15], 4, 1),
        shot([16, 16], 0, 1),
        shot([16, 16], 4, 0),
        Shot { fps: 0, ..shot([16, 16], 4, 1) },
    ] {
        assert!(FrameLoop::new(technique(), &stage, bad).unwrap_err().is_usage(), "{bad:?}");
    }
    let mut scenes: Vec<(&str, Scene)> = Vec::new();
    let mut add = |name, change: fn(&mut Scene)| {
        let mut scene = floor(lambert(0.5));
        lamp(&mut scene, Vec3::Y, 0.5, 1.0);
        change(&mut scene);
        scenes.push((name, scene));
    };
    add("albedo above 1", |s| {
        s.materials[0] = Material::Diffuse { reflectance: Color::Constant(Vec3::splat(1.5)) }
    });
    add("NaN albedo", |s| {
        s.materials[0] = Material::Diffuse { reflectance: Color::Constant(Vec3::splat(f32::NAN)) }
    });
    add("material that is not there", |s| {
        let mut object = (*s.objects[0]).clone();
        object.shapes[0].material = afterimage::scene::MaterialId(99);
        s.objects[0] = Arc::new(object);
    });
    add("object that is not there", |s| s.instances[0].object = afterimage::scene::ObjectId(99));
    add("singular transform", |s| {
        s.instances[0].to_world = Transform::Fixed(Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0)));
    });
    add("NaN transform", |s| {
        s.instances[0].to_world = Transform::Fixed(Affine3A::from_translation(Vec3::NAN));
    });
    add("camera without an angle", |s| s.camera = Camera { fov: 0.0, ..s.camera.clone() });
    add("negative light", |s| {
        let kind = LightKind::Point { intensity: Vec3::splat(-1.0) };
        s.lights.push(Light { to_world: Transform::IDENTITY, kind, key: 0 });
    });
    add("two things with one key", |s| s.instances[1].key = s.instances[0].key);
    for (name, scene) in scenes {
        let error = Stage::new(scene).err().unwrap_or_else(|| panic!("{name} was accepted"));
        assert!(error.is_invalid(), "{name}: {error}");
    }
}

/// A host that moves the scene: only a stage made for it may be moved, and each frame shows the
/// scene as it stands.
#[test]
fn a_host_moves_its_scene() {
    let lit = |x: f32| {
        let mut scene = floor(lambert(0.5));
        lamp(&mut scene, Vec3::new(x, 1.0, 0.0), 0.5, 10.0);
        scene
    };
    let technique = || Arc::from(parse("nee").unwrap());
    let still = Stage::new(lit(0.0)).unwrap();
    let mut frames = FrameLoop::new(technique(), &still, shot([16, 16], 3, 1)).unwrap();
    assert!(frames.render_scene(lit(0.5)).unwrap_err().is_usage());

    let stage = Stage::moving(lit(0.0)).unwrap();
    let mut frames = FrameLoop::new(technique(), &stage, shot([16, 16], 3, 4)).unwrap();
    frames.render_scene(lit(0.0)).unwrap();
    let mut other = lit(0.0);
    other.lights.push(Light {
        to_world: Transform::IDENTITY,
        kind: LightKind::Environment { radiance: Vec3::ONE, image: None },
        key: 5,
    });
    let error = frames.render_scene(other).unwrap_err();
    assert!(error.is_usage() && error.to_string().contains("an environment"), "{error}");
    let moved = frames.render_scene(lit(1.5)).unwrap().picture();
    let mut alone =
        FrameLoop::new(technique(), &Stage::moving(lit(1.5)).unwrap(), shot([16, 16], 3, 4))
            .unwrap();
    alone.render_scene(lit(1.5)).unwrap();
    let direct = alone.render_scene(lit(1.5)).unwrap().picture();
    assert_eq!(
        moved.pixels, direct.pixels,
        "frame 1 of the moved scene is frame 1 of the scene as it stands"
    );
}

/// What a host may do with a loop.
#[derive(Clone, Copy, Debug)]
enum Call {
    Render,
    /// The scene as the host moved it.
    RenderScene(u32),
    Restart(u64),
    Look,
    /// Another technique, size and depth on the same stage.
    Replace(usize, u32),
}

fn call() -> impl Strategy<Value = Call> {
    prop_oneof![
        4 => Just(Call::Render),
        2 => (0..40_u32).prop_map(Call::RenderScene),
        1 => any::<u64>().prop_map(Call::Restart),
        1 => Just(Call::Look),
        1 => (any::<usize>(), any::<u32>()).prop_map(|(a, b)| Call::Replace(a, b)),
    ]
}

const SPECS: [&str; 7] = [
    "nee",
    "nee:lights=all",
    "bsdf",
    "ris:tiles=on",
    "restir-di:rounds=2,neighbours=3,mutations=2",
    "restir-di:visibility=wis-cv,boiling=0.5,max-age=3",
    "restir-di:visibility=reuse,boiling=0.2,max-age=60,decoupled=true",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any calls in any order: frames count up from 0, have the size asked for, and are finite.
    #[test]
    fn z7_any_calls_in_any_order(calls in proptest::collection::vec(call(), 1..40)) {
        let mut scene = many_lights(6, 3);
        scene.lights.push(Light {
            to_world: Transform::Fixed(Affine3A::from_translation(Vec3::Y)),
            kind: LightKind::Point { intensity: Vec3::ONE },
            key: 77,
        });
        let stage = Stage::moving(scene.clone()).unwrap();
        let begin = |which: usize, how: u32| {
            let shot = Shot {
                size: [1 + how % 9, 1 + how / 9 % 7],
                depth: 1 + how / 63 % 4,
                filter: if how.is_multiple_of(2) { Filter::Point } else { Filter::Box },
                run: u64::from(how),
                effort: (1 + how / 252 % 3) as f32,
                fps: 30,
            };
            let technique = Arc::from(parse(SPECS[which % SPECS.len()]).unwrap());
            FrameLoop::new(technique, &stage, shot).unwrap()
        };
        let mut frames = begin(4, 100);
        let mut next = 0;
        for call in calls {
            match call {
                Call::Restart(run) => {
                    frames.restart(run);
                    next = 0;
                    continue;
                }
                Call::Replace(which, how) => {
                    frames = begin(which, how);
                    next = 0;
                    continue;
                }
                _ => {}
            }
            let [width, height] = frames.shot().size;
            let frame = if let Call::RenderScene(step) = call {
                let mut moved = scene.clone();
                let slid = Affine3A::from_translation(0.05 * step as f32 * Vec3::X);
                for instance in moved.instances.iter_mut().skip(1).step_by(2) {
                    instance.to_world = Transform::Fixed(slid);
                }
                if step.is_multiple_of(5) {
                    // The host's own light goes and comes.
                    moved.lights.clear();
                }
                frames.render_scene(moved).unwrap()
            } else {
                frames.render().unwrap()
            };
            prop_assert_eq!(frame.index, next);
            prop_assert_eq!((frame.counters.non_finite, frame.counters.weights_rejected), (0, 0));
            let picture = frame.picture();
            prop_assert_eq!([picture.width, picture.height], [width, height]);
            prop_assert_eq!(picture.non_finite() + frame.emission().non_finite(), 0);
            if matches!(call, Call::Look) {
                prop_assert_eq!(frame.guides().albedo.len(), (width * height) as usize);
            }
            next += 1;
        }
    }
}
