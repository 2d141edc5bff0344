//! Two renderings whose relation is known although neither answer is. Exact relations compare bits;
//! the others compare means as `oracles` does.

use std::sync::Arc;

use afterimage::frame::Stage;
use afterimage::picture::Picture;
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{
    Color, ConductorColor, Emission, Geometry, LightKind, Material, Mesh, Scene, Shape, Transform,
};
use afterimage::techniques::REGISTRY;
use glam::{Affine3A, Vec3};

use crate::support::{
    along, assert_same_mean, bits, diffuse, environment, last_frame, light, look_at, metal,
    picture, polygon, room, shot, unbiased,
};

/// The same scene, `factor` times as large, camera and lights too; intensities stay.
pub(crate) fn scaled(scene: &Scene, factor: f32) -> Scene {
    let mut scene = scene.clone();
    let move_out = |transform: &mut Transform| {
        let mut affine = transform.fixed();
        affine.translation *= factor;
        *transform = Transform::Fixed(affine);
    };
    move_out(&mut scene.camera.to_world);
    scene.lights.iter_mut().for_each(|light| move_out(&mut light.to_world));
    scene.instances.iter_mut().for_each(|instance| move_out(&mut instance.to_world));
    for object in &mut scene.objects {
        for shape in &mut Arc::make_mut(object).shapes {
            match &mut shape.geometry {
                Geometry::Mesh(mesh) => {
                    let mesh: &mut Mesh = Arc::make_mut(mesh);
                    mesh.positions.iter_mut().for_each(|p| *p *= factor);
                }
                Geometry::Sphere { center, radius } | Geometry::Disk { center, radius, .. } => {
                    *center *= factor;
                    *radius *= factor;
                }
            }
        }
    }
    scene
}

/// The same scene with every emission changed.
fn relit(scene: &Scene, f: impl Fn(Vec3) -> Vec3) -> Scene {
    let mut scene = scene.clone();
    for light in &mut scene.lights {
        match &mut light.kind {
            LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => {
                *intensity = f(*intensity);
            }
            LightKind::Distant { irradiance } => *irradiance = f(*irradiance),
            LightKind::Environment { radiance, .. } => *radiance = f(*radiance),
        }
    }
    for object in &mut scene.objects {
        for shape in &mut Arc::make_mut(object).shapes {
            if let Some(Emission { radiance: Color::Constant(radiance), .. }) = &mut shape.emission
            {
                *radiance = f(*radiance);
            }
        }
    }
    scene
}

/// The same scene with every Lambert and metal colour changed.
fn painted(scene: &Scene, f: impl Fn(Vec3) -> Vec3) -> Scene {
    let mut scene = scene.clone();
    for material in &mut scene.materials {
        match material {
            Material::Diffuse { reflectance: Color::Constant(rgb) }
            | Material::Conductor {
                color: ConductorColor::Reflectance(Color::Constant(rgb)),
                ..
            } => *rgb = f(*rgb),
            Material::Dielectric { .. } => {}
            _ => panic!("{material:?} is not painted"),
        }
    }
    scene
}

/// The room with a point, a spot and a distant light and a sky besides its lamps.
fn full_room() -> Scene {
    let mut scene = room();
    let place = along(Vec3::new(0.25, 1.25, -0.75), Vec3::new(0.0, -0.6, 0.8));
    let grey = Vec3::splat(0.5);
    light(&mut scene, LightKind::Point { intensity: grey }, place);
    let falloff = afterimage::scene::SpotFalloff::Smoothstep;
    let spot = LightKind::Spot { intensity: grey, cos_inner: 0.9, cos_outer: 0.7, falloff };
    light(&mut scene, spot, place);
    light(&mut scene, LightKind::Distant { irradiance: grey }, place);
    environment(&mut scene, Vec3::splat(0.25));
    scene
}

fn shots() -> [Shot; 2] {
    let point = Shot { effort: 2.0, ..shot([32, 24], 5, 1) };
    [point, Shot { filter: Filter::Box, ..point }]
}

/// The picture with its directly visible emission.
fn whole(stage: &Stage, spec: &str, shot: Shot) -> [Picture; 2] {
    let technique = Arc::from(afterimage::techniques::parse(spec).unwrap());
    let mut frame_loop = afterimage::frame::FrameLoop::new(technique, stage, shot).unwrap();
    let frame = frame_loop.render().unwrap();
    assert_eq!(frame.counters.non_finite, 0);
    [frame.picture(), frame.emission()]
}

fn times(picture: &Picture, factor: f32) -> Vec<[u32; 3]> {
    picture.pixels.iter().map(|p| (*p * factor).to_array().map(f32::to_bits)).collect()
}

#[track_caller]
fn assert_lit(picture: &Picture) {
    assert!(picture.mean_luminance() > 1e-3 * f64::from(f32::MIN_POSITIVE), "the picture is black");
}

#[test]
fn emission_times_a_power_of_two_is_the_picture_times_it() {
    let scene = full_room();
    for shot in shots() {
        for entry in REGISTRY {
            let original = whole(&Stage::new(scene.clone()).unwrap(), entry.name, shot);
            assert_lit(&original[0]);
            for k in [-20, -7, -1, 1, 6, 20] {
                let factor = 2.0_f32.powi(k);
                let stage = Stage::new(relit(&scene, |rgb| rgb * factor)).unwrap();
                for (a, b) in whole(&stage, entry.name, shot).iter().zip(&original) {
                    assert!(bits(a) == times(b, factor), "{} at 2^{k}", entry.name);
                }
            }
            let wrong = Stage::new(relit(&scene, |rgb| rgb * 1.01)).unwrap();
            assert!(bits(&whole(&wrong, entry.name, shot)[0]) != times(&original[0], 1.0));
        }
    }
}

#[test]
fn a_room_a_power_of_two_larger_looks_the_same() {
    let scene = room();
    for shot in shots() {
        for entry in REGISTRY {
            let original = whole(&Stage::new(scene.clone()).unwrap(), entry.name, shot);
            assert_lit(&original[0]);
            for k in [-20, -11, -3, -1, 1, 4, 13, 20] {
                let stage = Stage::new(scaled(&scene, 2.0_f32.powi(k))).unwrap();
                for (a, b) in whole(&stage, entry.name, shot).iter().zip(&original) {
                    let differ = bits(a).iter().zip(bits(b)).filter(|(a, b)| *a != b).count();
                    assert_eq!(differ, 0, "pixels of {} at 2^{k}", entry.name);
                }
            }
        }
    }
}

#[test]
fn irradiance_from_point_lights_falls_with_the_square_of_the_scale() {
    let mut scene = room();
    scene.objects.iter_mut().for_each(|object| Arc::make_mut(object).shapes[0].emission = None);
    for x in [-0.5, 0.25] {
        let place = Affine3A::from_translation(Vec3::new(x, 1.5, -0.25));
        light(&mut scene, LightKind::Point { intensity: Vec3::splat(0.75) }, place);
    }
    for shot in shots() {
        let stage = Stage::new(scene.clone()).unwrap();
        for name in unbiased(&stage, &shot) {
            let original = picture(&stage, name, shot);
            assert_lit(&original);
            for k in [-20, -5, 1, 12, 20] {
                let stage = Stage::new(scaled(&scene, 2.0_f32.powi(k))).unwrap();
                let large = picture(&stage, name, shot);
                assert!(bits(&large) == times(&original, 2.0_f32.powi(-2 * k)), "{name} at 2^{k}");
            }
        }
    }
}

#[test]
fn swapping_red_and_blue_swaps_the_channels() {
    let scene = full_room();
    let swap = |rgb: Vec3| Vec3::new(rgb.z, rgb.y, rgb.x);
    for shot in shots() {
        for entry in REGISTRY {
            let original = picture(&Stage::new(scene.clone()).unwrap(), entry.name, shot);
            let swapped = picture(&Stage::new(painted(&scene, swap)).unwrap(), entry.name, shot);
            assert!(bits(&original) != bits(&swapped), "the room has no colours");
            // A sample is chosen by its luminance, which the swap changes: such pictures agree in
            // the mean only (`oracles`).
            if !["ris", "restir-di", "restir-pt"].contains(&entry.name) {
                let back: Vec<[u32; 3]> =
                    bits(&swapped).into_iter().map(|[r, g, b]| [b, g, r]).collect();
                assert!(bits(&original) == back, "{}", entry.name);
            }
        }
    }
}

#[test]
fn without_albedo_only_emission_is_seen() {
    let scene = full_room();
    let mut black = scene.clone();
    let nothing = Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) };
    black.materials.iter_mut().for_each(|material| *material = nothing);
    for shot in shots() {
        for entry in REGISTRY {
            let [reflected, emitted] = whole(&Stage::new(black.clone()).unwrap(), entry.name, shot);
            assert!(reflected.pixels.iter().all(|p| *p == Vec3::ZERO), "{}", entry.name);
            let [_, as_before] = whole(&Stage::new(scene.clone()).unwrap(), entry.name, shot);
            assert_eq!(bits(&emitted), bits(&as_before));
            assert_lit(&emitted);
        }
    }
}

#[test]
fn a_longer_path_only_adds_light() {
    // With the same numbers a path of one segment more is the same path and a term that is not
    // negative.
    let stage = Stage::new(full_room()).unwrap();
    for shot in shots() {
        // Where one path of all lengths is chosen, a longer one may take a shorter one's place.
        for entry in REGISTRY.iter().filter(|entry| entry.name != "restir-pt") {
            let mut last = picture(&stage, entry.name, Shot { depth: 1, ..shot });
            assert!(last.pixels.iter().all(|p| *p == Vec3::ZERO));
            for depth in 2..8 {
                let next = picture(&stage, entry.name, Shot { depth, ..shot });
                assert!(
                    last.pixels.iter().zip(&next.pixels).all(|(a, b)| a.cmple(*b).all()),
                    "{} at depth {depth}",
                    entry.name
                );
                assert!(next.mean_luminance() > last.mean_luminance());
                last = next;
            }
        }
    }
}

#[test]
fn a_light_without_power_changes_no_bit() {
    let scene = full_room();
    let mut more = scene.clone();
    let nothing = Vec3::ZERO;
    environment(&mut more, nothing);
    for kind in
        [LightKind::Point { intensity: nothing }, LightKind::Distant { irradiance: nothing }]
    {
        light(&mut more, kind, Affine3A::from_translation(Vec3::Y));
    }
    let mut shone = false;
    for object in &mut more.objects {
        let shape = &mut Arc::make_mut(object).shapes[0];
        if shape.emission.is_none() {
            *shape = shape.clone().emitting(nothing);
            shone = true;
        }
    }
    assert!(shone);
    for shot in shots() {
        for entry in REGISTRY {
            let (a, work) = last_frame(&Stage::new(scene.clone()).unwrap(), entry.name, shot, 1);
            let (b, same) = last_frame(&Stage::new(more.clone()).unwrap(), entry.name, shot, 1);
            assert!(bits(&a) == bits(&b), "{}", entry.name);
            assert_eq!(work, same);
        }
    }
}

/// A lamp over a floor with a ball between them: c below 1 for all techniques.
fn lamp(parts: &[[Vec3; 4]], radiance: f32) -> Scene {
    let mut scene = Scene::new("lamp");
    let white = diffuse(&mut scene, 0.75);
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let floor = [c(-2.0, 0.0, -2.0), c(-2.0, 0.0, 2.0), c(2.0, 0.0, 2.0), c(2.0, 0.0, -2.0)];
    scene.add_shape(Shape::new(polygon(&floor), white));
    let ball = Geometry::Sphere { center: c(0.5, 0.5, 0.0), radius: 0.25 };
    scene.add_shape(Shape::new(ball, white));
    for part in parts {
        scene.add_shape(Shape::new(polygon(part), white).emitting(Vec3::splat(radiance)));
    }
    scene.camera = look_at(c(0.0, 0.75, -1.0), c(0.0, 0.0, 0.25), 0.75);
    scene
}

fn tile(x0: f32, x1: f32) -> [Vec3; 4] {
    [
        Vec3::new(x0, 1.0, -2.0),
        Vec3::new(x1, 1.0, -2.0),
        Vec3::new(x1, 1.0, 2.0),
        Vec3::new(x0, 1.0, 2.0),
    ]
}

fn statistical() -> Shot {
    shot([16, 16], 3, 1)
}

#[track_caller]
fn assert_alike(a: Scene, b: Scene) {
    let (a, b) = (Stage::new(a).unwrap(), Stage::new(b).unwrap());
    for name in unbiased(&a, &statistical()) {
        assert_same_mean((&a, statistical()), (&b, statistical()), name);
    }
}

#[test]
fn a_lamp_in_two_halves_is_the_lamp() {
    assert_alike(lamp(&[tile(-2.0, 2.0)], 1.0), lamp(&[tile(-2.0, 0.5), tile(0.5, 2.0)], 1.0));
}

#[test]
fn the_order_of_shapes_and_lights_means_nothing() {
    let scene = lamp(&[tile(-2.0, 0.5), tile(0.5, 2.0)], 1.0);
    let mut reversed = scene.clone();
    reversed.instances.reverse();
    assert_alike(scene, reversed);
    // With the lights in their order even the bits stay: no draw depends on other shapes.
    let mut scene = full_room();
    let mut moved = scene.clone();
    let dark = |scene: &Scene, i: usize| {
        scene.objects[scene.instances[i].object.index()].shapes[0].emission.is_none()
    };
    moved.instances = (0..scene.instances.len())
        .rev()
        .filter(|&i| dark(&scene, i))
        .chain((0..scene.instances.len()).filter(|&i| !dark(&scene, i)))
        .map(|i| scene.instances[i].clone())
        .collect();
    // A generic view: no ray passes through an edge that two walls share, where either may be hit.
    let camera = look_at(Vec3::new(0.037, 1.021, -2.97), Vec3::new(0.011, 0.983, 0.0), 0.75);
    (scene.camera, moved.camera) = (camera.clone(), camera);
    for entry in REGISTRY {
        let a = picture(&Stage::new(scene.clone()).unwrap(), entry.name, shots()[0]);
        let b = picture(&Stage::new(moved.clone()).unwrap(), entry.name, shots()[0]);
        let differ: Vec<_> =
            a.pixels.iter().zip(&b.pixels).enumerate().filter(|(_, (a, b))| a != b).collect();
        assert!(differ.is_empty(), "{}: {differ:?}", entry.name);
    }
}

#[test]
fn a_light_that_nothing_sees_adds_nothing() {
    let scene = lamp(&[tile(-2.0, 2.0)], 1.0);
    let mut more = scene.clone();
    let black = diffuse(&mut more, 0.0);
    let below = |y: f32| tile(-2.0, 2.0).map(|p| Vec3::new(p.x, y, p.z));
    let mut hidden = below(-1.0);
    hidden.reverse();
    more.add_shape(Shape::new(polygon(&hidden), black).emitting(Vec3::splat(0.5)));
    assert_alike(scene, more);
}

#[test]
fn a_camera_in_a_mirror_is_a_mirrored_camera() {
    // The mirror is the plane x = 0; its other side is cut off by it. One segment more leads to it
    // and back.
    let build = |mirrored: bool| {
        let mut scene = lamp(&[tile(0.0, 2.0)], 1.0);
        let x = if mirrored { 0.75 } else { -0.75 };
        if mirrored {
            let mirror = metal(&mut scene, 0.0);
            let plane = [(0.0, -2.0), (0.0, 2.0), (1.0, 2.0), (1.0, -2.0)];
            let corners = plane.map(|(y, z)| Vec3::new(0.0, y, z));
            scene.add_shape(Shape::new(polygon(&corners), mirror));
        }
        scene.camera = look_at(Vec3::new(x, 0.5, -1.25), Vec3::new(-x, 0.0, -0.75), 0.25);
        Stage::new(scene).unwrap()
    };
    let (direct, through) = (build(false), build(true));
    let shot = shot([16, 16], 2, 1);
    let longer = Shot { depth: 3, ..shot };
    for name in unbiased(&direct, &shot) {
        assert_same_mean((&direct, shot), (&through, longer), name);
    }
    // Pixel by pixel, without noise: left and right are exchanged.
    let lit = |stage: &Stage| {
        let mut scene = stage.scene().clone();
        scene.objects.iter_mut().for_each(|object| Arc::make_mut(object).shapes[0].emission = None);
        let place = Affine3A::from_translation(Vec3::new(1.0, 1.0, 0.25));
        light(&mut scene, LightKind::Point { intensity: Vec3::ONE }, place);
        Stage::new(scene).unwrap()
    };
    let a = picture(&lit(&direct), "nee", shot);
    let b = picture(&lit(&through), "nee", longer);
    for y in 0..16 {
        for x in 0..16 {
            let (left, right) = (a.at(x, y).x, b.at(15 - x, y).x);
            assert!((left - right).abs() <= 2e-5 * left.max(right), "({x}, {y}): {left} {right}");
        }
    }
    assert_lit(&a);
}

#[test]
fn frames_are_independent_of_how_many_are_rendered() {
    // Without history frame i of a run is the same whether or not others came before, and a long
    // run's mean is that of two short ones.
    let stage = Stage::new(lamp(&[tile(-2.0, 2.0)], 1.0)).unwrap();
    let shot = statistical();
    let independent = |name: &&str| {
        !afterimage::techniques::parse(name).unwrap().plan(stage.facts(), &shot).keeps_history()
    };
    for name in unbiased(&stage, &shot).into_iter().filter(independent) {
        let frames = |run: u64, count: u32| -> Vec<f64> {
            let technique = Arc::from(afterimage::techniques::parse(name).unwrap());
            let shot = Shot { run, effort: 96.0, ..shot };
            let mut frame_loop =
                afterimage::frame::FrameLoop::new(technique, &stage, shot).unwrap();
            (0..count)
                .map(|_| crate::support::mean_red(&frame_loop.render().unwrap().picture()))
                .collect()
        };
        let long = frames(1, 64);
        assert_eq!(frames(1, 32), long[..32]);
        let short = [frames(2, 32), frames(3, 32)].concat();
        assert!(long.iter().zip(&short).all(|(a, b)| a != b), "another run repeats this one");
        let moments = |values: &[f64]| -> afterimage::stats::Estimate {
            values.iter().copied().collect::<afterimage::stats::Moments>().estimate()
        };
        let test = afterimage::stats::welch(&moments(&long), &moments(&short));
        assert!(test.p > 1e-6 && test.standard_error < 0.002 * moments(&long).mean, "{test:?}");
    }
}
