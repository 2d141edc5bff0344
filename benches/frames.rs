//! One steady frame of every technique, 128 × 128 pixels: `frames/SCENE/TECHNIQUE`, in pixels a
//! second; and what leaving things out gains: `skips/WHAT/with` against `skips/WHAT/without`, the
//! same picture by the general plan and by the one that the scene allows; `gpu-skips` is the same
//! on a graphics processor, by the milliseconds that the device itself reports, where there is one.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use afterimage::frame::{Backend, FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{
    Channel, Color, ConductorColor, Curve, Geometry, Interpolation, Light, LightKind, Material,
    Roughness, Scalar, Scene, Shape, Texture, TextureKind, Track, Transform, generate, load,
};
use afterimage::techniques::{REGISTRY, parse};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{Affine2, Affine3A, Quat, Vec3};

const SIZE: [u32; 2] = [128, 128];

fn frames(criterion: &mut Criterion) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for scene in ["cornell", "many_lights", "plates", "glass"] {
        let path = root.join("scenes").join(scene).with_extension("pbrt");
        let stage =
            Stage::new(load::load(&path).expect("our own scene loads").scene).expect("and builds");
        let mut group = criterion.benchmark_group(format!("frames/{scene}"));
        group.throughput(Throughput::Elements(u64::from(SIZE[0] * SIZE[1]))).sample_size(20);
        for entry in REGISTRY {
            let technique = Arc::from(parse(entry.name).expect("a registered name"));
            let depth = stage.facts().depth.min(8);
            let shot =
                Shot { size: SIZE, depth, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
            let mut frames = FrameLoop::new(technique, &stage, shot).expect("a valid shot");
            let first = frames.render().expect("a frame");
            assert_eq!((first.counters.non_finite, first.picture().non_finite()), (0, 0));
            group.bench_function(entry.name, |bencher| {
                bencher.iter(|| frames.render().expect("a frame").counters);
            });
        }
        group.finish();
    }
}

/// The general plan and the specialised one give the same picture (`tests/suite/elision.rs`); here
/// is what it costs.
fn skips(criterion: &mut Criterion) {
    skips_on(criterion, "skips", &Backend::Cpu);
    #[cfg(feature = "gpu")]
    match afterimage::gpu::Gpu::open(None) {
        Ok(gpu) => skips_on(criterion, "gpu-skips", &Backend::Gpu(gpu)),
        Err(error) => eprintln!("gpu-skips are left out: {error}"),
    }
}

fn skips_on(criterion: &mut Criterion, name: &str, backend: &Backend) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let cornell =
        || load::load(&root.join("scenes/cornell.pbrt")).expect("our own scene loads").scene;
    let many = || generate("many-lights:20000").expect("a generator");
    // A scene of one light, for which there is nothing to resample.
    let lamp = || {
        let mut scene = cornell();
        for object in &mut scene.objects {
            Arc::make_mut(object).shapes.iter_mut().for_each(|shape| shape.emission = None);
        }
        let kind = LightKind::Point { intensity: Vec3::splat(5.0) };
        let to_world = Transform::Fixed(Affine3A::from_translation(Vec3::new(0.0, 1.5, 0.0)));
        scene.lights.push(Light { to_world, kind, key: 1 });
        scene
    };
    let two_lamps = || {
        let mut scene = lamp();
        let second = Light { key: 2, ..scene.lights[0].clone() };
        scene.lights.push(second);
        scene
    };
    // Far behind the camera, in every material that kernels could leave out.
    let everything = || {
        let mut scene = cornell();
        let grey = Color::Constant(Vec3::splat(0.5));
        let texture = scene.add_texture(Texture {
            kind: TextureKind::Checkerboard { first: grey, second: grey },
            mapping: Affine2::IDENTITY,
        });
        let roughness = Roughness::isotropic(0.3);
        let materials = [
            Material::Diffuse { reflectance: Color::Texture(texture) },
            Material::Conductor { color: ConductorColor::Reflectance(grey), roughness },
            Material::Dielectric { eta: 1.5, roughness },
            Material::CoatedDiffuse { reflectance: grey, eta: 1.5, roughness },
        ];
        for (at, material) in materials.into_iter().enumerate() {
            let material = scene.add_material(material);
            let center = Vec3::new(3.0 * at as f32, 0.0, 100.0);
            let mut shape = Shape::new(Geometry::Sphere { center, radius: 1.0 }, material);
            shape.alpha = Some(Scalar::Texture(texture, Channel::Red));
            scene.add_shape(shape);
        }
        scene
    };
    // A camera that slides, and a ball out of sight that says it moves.
    let along = |from: Vec3, to: Vec3| {
        let translation =
            Curve { keys: vec![(0.0, from), (1000.0, to)], interpolation: Interpolation::Linear };
        Track::Trs {
            translation,
            rotation: Curve::constant(Quat::IDENTITY),
            scale: Curve::constant(Vec3::ONE),
        }
    };
    let slides = || {
        let mut scene = cornell();
        let place = Track::Fixed(scene.camera.to_world.fixed());
        let track = along(Vec3::ZERO, Vec3::new(30.0, 0.0, 0.0));
        scene.camera.to_world = Transform::Chain(vec![track, place]);
        scene.time = [0.0, 1000.0];
        scene
    };
    let with_ball = |mut scene: Scene, material: Material, moves: bool| {
        let material = scene.add_material(material);
        let ball = Geometry::Sphere { center: Vec3::new(0.0, 0.0, 100.0), radius: 1.0 };
        scene.add_shape(Shape::new(ball, material));
        if moves {
            let last = scene.instances.len() - 1;
            scene.instances[last].to_world = Transform::Chain(vec![along(Vec3::ZERO, Vec3::ZERO)]);
        }
        scene
    };
    let grey = || Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5)) };
    let rough = || Material::Conductor {
        color: ConductorColor::Reflectance(Color::Constant(Vec3::splat(0.5))),
        roughness: Roughness::isotropic(0.3),
    };
    // What is measured, its stage, SPEC and depth: as the scene allows, then in general.
    let pairs = [
        (
            "motion",
            [(Stage::new(cornell()), "restir-di", 2), (Stage::moving(cornell()), "restir-di", 2)],
        ),
        (
            "light-tiles",
            [
                (Stage::new(many()), "restir-di:tiles=off", 2),
                (Stage::new(many()), "restir-di:tiles=on", 2),
            ],
        ),
        (
            "one-light",
            [(Stage::new(lamp()), "restir-di", 2), (Stage::new(two_lamps()), "restir-di", 2)],
        ),
        (
            "other-light",
            [(Stage::new(cornell()), "restir-di", 2), (Stage::new(cornell()), "restir-di", 3)],
        ),
        (
            "paths-again",
            [
                (Stage::new(with_ball(slides(), grey(), false)), "restir-pt", 6),
                (Stage::new(with_ball(slides(), grey(), true)), "restir-pt", 6),
            ],
        ),
        (
            "paths-roughness",
            [
                (Stage::new(with_ball(slides(), grey(), false)), "restir-pt", 6),
                (Stage::new(with_ball(slides(), rough(), false)), "restir-pt", 6),
            ],
        ),
        (
            "paths-shared",
            [
                (Stage::new(slides()), "restir-pt", 6),
                (Stage::new(slides()), "restir-pt:shared=false", 6),
            ],
        ),
        // Kernels for diffuse triangles against such for all materials, spheres, textures, coverage
        // and skies: one sphere of each, out of sight.
        (
            "scene",
            [(Stage::new(cornell()), "restir-di", 2), (Stage::new(everything()), "restir-di", 2)],
        ),
    ];
    for (what, sides) in pairs {
        // Paths have no twin on a graphics processor yet.
        if what.starts_with("paths") && name == "gpu-skips" {
            continue;
        }
        let mut group = criterion.benchmark_group(format!("{name}/{what}"));
        group.throughput(Throughput::Elements(u64::from(SIZE[0] * SIZE[1]))).sample_size(20);
        for (name, (stage, spec, depth)) in ["without", "with"].into_iter().zip(sides) {
            let technique = Arc::from(parse(spec).expect("a specification"));
            let shot =
                Shot { size: SIZE, depth, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
            let stage = stage.expect("a stage");
            let mut frames = FrameLoop::with_backend(technique, &stage, shot, backend)
                .expect("a valid shot on this backend");
            frames.render().expect("a frame");
            group.bench_function(name, |bencher| {
                bencher.iter_custom(|count| {
                    let ms = (0..count).map(|_| frames.render().expect("a frame").milliseconds());
                    Duration::from_secs_f64(1e-3 * ms.sum::<f64>())
                });
            });
        }
        group.finish();
    }
}

criterion_group!(benches, frames, skips);
criterion_main!(benches);
