//! Planted bugs, each caught by the cheapest test that can see it; `docs/planted_bugs.md` holds the
//! table that [`table`] prints.
//!
//! A check is a function of what it checks (a density, a lobe, a weight, a walk), so that a wrong
//! one can be handed to it. [`walk`] is the walk of `path` written once more, with switches for
//! bugs; without one it gives the renderer's pictures bit for bit.

use std::hint::black_box;
use std::time::Instant;

use afterimage::accel::{AcceptAll, BuildOptions, Hit, Ray};
use afterimage::frame::Stage;
use afterimage::light::NO_LIGHT;
use afterimage::math::rng::{
    BLOCK_LIGHT, BLOCK_SCATTER, RandomSource, Stream, draw4, path_seed, unit_float,
};
use afterimage::path::power_heuristic;
use afterimage::picture::Picture;
use afterimage::plan::Shot;
use afterimage::scene::{Geometry, LightKind, Scene, Shape};
use afterimage::stats::{Moments, Verdict};
use afterimage::surface::SurfacePoint;
use afterimage::surface::bsdf::{Bsdf, Evaluation};
use afterimage::techniques::REGISTRY;
use afterimage::world::World;
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::metamorphic::scaled;
use crate::support::{
    against, along, bits, diffuse, last_frame, light, look_at, mean_red, picture, polygon,
    receiver, room, shot, sphere,
};

/// What the walk does wrong, with its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Bug {
    /// Nothing.
    None,
    /// Light densities are this factor off, wherever they are used.
    LightPdf(f32),
    /// Lobes that are not deltas lack their cosine.
    NoCosine,
    /// Light sampling's share is this factor off.
    LightShare(f32),
    /// Every vertex scatters by the first one's numbers.
    SeedReused,
    /// Point lights shine through everything.
    PointLightsUnshadowed,
    /// Rays start at this distance from a surface, whatever its size.
    AbsoluteOffset(f32),
    /// All reflected light is this factor off.
    Reflected(f32),
}

/// One path estimate with light sampling and MIS, without Russian roulette.
fn walk(world: &World, bug: Bug, seed: u64, first: (Vec3, &Hit), depth: u32) -> Vec3 {
    let lights = &world.lights;
    let density = |pdf: f32| if let Bug::LightPdf(factor) = bug { pdf * factor } else { pdf };
    let cosine =
        |value: Vec3, wi: Vec3| if bug == Bug::NoCosine { value / wi.z.abs() } else { value };
    let origin = |surface: &SurfacePoint, direction: Vec3| match bug {
        Bug::AbsoluteOffset(distance) => {
            let normal = surface.geometric_normal;
            surface.position + normal * distance.copysign(direction.dot(normal))
        }
        _ => surface.origin(direction),
    };
    let (mut direction, mut hit) = (first.0, *first.1);
    let (mut sum, mut throughput) = (Vec3::ZERO, Vec3::ONE);
    for vertex in 0..depth - 1 {
        let surface = world.surface(&hit);
        let outgoing = surface.frame.to_local(-direction);
        if surface.bsdf.is_black() {
            break;
        }
        if surface.bsdf.has_non_delta() && !lights.is_empty() {
            let [index, fraction, u, v] = draw4(seed, vertex, BLOCK_LIGHT);
            let chosen = lights.choose(index, fraction);
            let u = Vec2::new(unit_float(u), unit_float(v));
            if let Some(light) = lights.sample_towards(&world.scene, chosen, surface.position, u) {
                let local = surface.frame.to_local(light.direction);
                let Evaluation { value, pdf } = surface.bsdf.evaluate(outgoing, local);
                let start = origin(&surface, light.direction);
                let ray = match light.end {
                    Some(end) => Ray { origin: start, direction: end - start, t_max: 1.0 },
                    None => Ray { origin: start, direction: light.direction, t_max: f32::INFINITY },
                };
                let is_point = light.delta && light.end.is_some();
                let unshadowed = is_point && bug == Bug::PointLightsUnshadowed;
                if value != Vec3::ZERO && (unshadowed || !world.accel.occluded(&ray, &AcceptAll)) {
                    let p = lights.choice_probability(chosen) * density(light.pdf);
                    let mut share = if light.delta { 1.0 } else { power_heuristic(p, pdf) };
                    if let Bug::LightShare(factor) = bug {
                        share *= factor;
                    }
                    sum += throughput * (light.radiance * cosine(value, local) * (share / p));
                }
            }
        }
        let at = if bug == Bug::SeedReused { 0 } else { vertex };
        let Some(next) = surface.bsdf.sample(outgoing, draw4(seed, at, BLOCK_SCATTER)) else {
            break;
        };
        let value = if next.delta { next.value } else { cosine(next.value, next.wi) };
        throughput *= value / next.pdf;
        if throughput == Vec3::ZERO {
            break;
        }
        direction = surface.frame.to_world(next.wi).normalize();
        let share = |choice: f32, pdf: f32| {
            if next.delta { 1.0 } else { power_heuristic(next.pdf, choice * density(pdf)) }
        };
        let ray = Ray { origin: origin(&surface, direction), direction, t_max: f32::INFINITY };
        let Some(found) = world.accel.closest_hit(&ray, &AcceptAll) else {
            for (light, sky) in lights.environments() {
                let share = share(lights.choice_probability(light), sky.pdf(direction));
                sum += throughput * sky.radiance(direction) * share;
            }
            break;
        };
        hit = found;
        let point = world.accel.point(&hit);
        let light = lights.of_surface(point.shape, point.element);
        if light != NO_LIGHT {
            let cosine = -direction.dot(point.geometric_normal);
            let emission = lights.emitted(&world.scene, light, point.uv, cosine);
            if emission != Vec3::ZERO {
                let pdf = lights.pdf_towards(light, surface.position, point.position, cosine);
                sum += throughput * emission * share(lights.choice_probability(light), pdf);
            }
        }
    }
    if let Bug::Reflected(factor) = bug { sum * factor } else { sum }
}

/// The first frame of a shot with the point filter, by [`walk`].
fn walked(world: &World, bug: Bug, shot: Shot) -> Picture {
    let [width, height] = shot.size;
    let rays = world.scene.camera.rays(shot.size);
    let pixels = (0..width * height)
        .into_par_iter()
        .map(|pixel| {
            let at = Vec2::new((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
            let ray = rays.ray(at);
            let ray = Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
            let Some(hit) = world.closest_hit(&ray) else { return Vec3::ZERO };
            let paths = (0..shot.most_estimates()).map(|sample| {
                let seed = path_seed(shot.run, pixel, 0, sample);
                walk(world, bug, seed, (ray.direction, &hit), shot.depth)
            });
            let sum = paths.fold(Vec3::ZERO, |sum, path| sum + path);
            sum * (1.0 / shot.effort)
        })
        .collect();
    Picture::new(width, height, pixels)
}

fn world(scene: Scene) -> World {
    World::new(scene, &BuildOptions::default()).unwrap()
}

/// A room with a point light and a sky in addition.
fn full_room() -> Scene {
    let mut scene = room();
    let place = along(Vec3::new(0.25, 1.25, -0.75), Vec3::Y);
    light(&mut scene, LightKind::Point { intensity: Vec3::splat(0.5) }, place);
    let radiance = Vec3::splat(0.25);
    light(&mut scene, LightKind::Environment { radiance, image: None }, place);
    scene
}

#[test]
fn the_walk_without_a_bug_is_the_renderer_bit_for_bit() {
    let shot = shot([48, 32], 6, 3);
    steps_are_the_walk_in("a room", full_room(), shot);
}

fn steps_are_the_walk_in(name: &str, scene: Scene, shot: Shot) {
    let stage = Stage::new(scene).unwrap();
    assert!(!stage.first_world().has_alpha, "the copy knows no coverage");
    let rendered = picture(&stage, "nee:roulette=1000", shot);
    let copy = walked(stage.first_world(), Bug::None, shot);
    assert_eq!(bits(&rendered), bits(&copy), "{name}");
    assert!(copy.mean_luminance() > 0.0, "{name} is black");
}

/// The walk in steps, which paths, their replays and their suffixes share with `nee`, is the walk
/// written at one go, in every scene of the repository. (One sample a pixel: it is about bits.)
#[test]
fn steps_are_the_walk() {
    let scenes = crate::support::own_scenes();
    assert!(scenes.len() >= 8);
    for (name, scene) in scenes {
        steps_are_the_walk_in(&name, scene, shot([32, 24], 9, 1));
    }
}

/// Whether light densities are what the geometry says: the largest relative error over 10⁴ sampled
/// points of a triangle, a sphere, a disk and a constant sky, of both the density that comes with a
/// sample and the one that is asked for.
fn density_error(factor: f32) -> f64 {
    let mut scene = Scene::new("densities");
    let black = diffuse(&mut scene, 0.0);
    let emitting = |geometry| Shape::new(geometry, black).emitting(Vec3::ONE);
    let triangle = [Vec3::new(0.0, 2.0, 0.0), Vec3::new(1.0, 2.5, 0.0), Vec3::new(0.5, 2.0, 1.0)];
    let centers = [Vec3::new(-2.0, 1.5, 0.5), Vec3::new(2.0, 1.0, -1.0)];
    let normal = Vec3::new(-0.8, -0.6, 0.0);
    scene.add_shape(emitting(polygon(&triangle)));
    scene.add_shape(emitting(Geometry::Sphere { center: centers[0], radius: 0.75 }));
    scene.add_shape(emitting(Geometry::Disk { center: centers[1], normal, radius: 0.5 }));
    light(
        &mut scene,
        LightKind::Environment { radiance: Vec3::ONE, image: None },
        along(Vec3::ZERO, Vec3::Z),
    );
    for shape in 0..3 {
        let object = std::sync::Arc::make_mut(&mut scene.objects[shape]);
        object.shapes[0].emission.as_mut().unwrap().two_sided = true;
    }
    let world = world(scene);
    let lights = &world.lights;
    let pi = std::f64::consts::PI;
    // Density of uniform area at a point of a plane along a direction.
    let flat = |from: DVec3, d: DVec3, on: DVec3, n: DVec3, area: f64| {
        let t = (on - from).dot(n) / d.dot(n);
        (from + d * t, n, t * t / (area * d.dot(n).abs()))
    };
    let mut stream = Stream::from_key(4);
    let mut worst: f64 = 0.0;
    for sample in 0..10_000 {
        let light = sample % 4;
        let from = Vec3::new(stream.uniform(), stream.uniform(), stream.uniform()) * 0.5;
        let u = Vec2::new(stream.uniform(), stream.uniform());
        let Some(incident) = lights.sample_towards(&world.scene, light, from, u) else { continue };
        let (o, d) = (from.as_dvec3(), incident.direction.as_dvec3());
        let (at, n, pdf) = match light {
            0 => {
                let [a, b, c] = triangle.map(|p| p.as_dvec3());
                let cross = (b - a).cross(c - a);
                flat(o, d, a, cross.normalize(), 0.5 * cross.length())
            }
            1 => {
                let center = centers[0].as_dvec3();
                let sin2 = 0.5625 / (center - o).length_squared();
                let pdf = 1.0 / (2.0 * pi * (1.0 - (1.0 - sin2).sqrt()));
                let b = (center - o).dot(d);
                let t = b - (b * b - (center - o).length_squared() + 0.5625).max(0.0).sqrt();
                let at = o + d * t;
                (at, (at - center).normalize(), pdf)
            }
            2 => flat(o, d, centers[1].as_dvec3(), normal.as_dvec3(), 0.25 * pi),
            _ => (o, d, 0.25 / pi),
        };
        let asked = match light {
            3 => lights.environments().next().unwrap().1.pdf(incident.direction),
            _ => lights.pdf_towards(light, from, at.as_vec3(), -d.dot(n) as f32),
        };
        for found in [incident.pdf * factor, asked * factor] {
            // A grazing direction in single precision says little of where it meets the plane.
            let tolerated = d.dot(n).abs().max(0.01) / 0.01;
            worst = worst.max((f64::from(found) / pdf - 1.0).abs() * tolerated.min(1.0));
        }
    }
    worst
}

const DENSITY_TOLERANCE: f64 = 5e-5;

#[test]
fn a_light_density_one_percent_off() {
    assert!(density_error(1.0) < DENSITY_TOLERANCE, "{}", density_error(1.0));
    assert!(density_error(1.01) > DENSITY_TOLERANCE);
}

/// Largest relative violation of f(o, i) = f(i, o) by any lobe, over 10⁴ pairs of directions; all
/// lobes are of one medium.
fn reciprocity_error(evaluate: impl Fn(&Bsdf, u32, Vec3, Vec3) -> Vec3) -> f64 {
    let glossy = Bsdf::metal(Vec3::new(0.9, 0.5, 0.2), Vec2::new(0.4, 0.3));
    let lambert = Bsdf::diffuse(Vec3::new(0.7, 0.2, 0.4));
    let leaf = Bsdf::diffuse_transmission(Vec3::splat(0.5), Vec3::splat(0.25));
    let mixed = Bsdf::mix(&lambert, &glossy, 0.25).unwrap();
    let mut stream = Stream::from_key(5);
    let mut direction = || {
        let z = stream.uniform() * 1.9 - 0.95;
        let (s, c) = (stream.uniform() * 6.25).sin_cos();
        Vec3::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z).normalize()
    };
    let mut worst: f64 = 0.0;
    for _ in 0..10_000 {
        let (o, i) = (direction(), direction());
        for bsdf in [&lambert, &glossy, &leaf, &mixed] {
            for lobe in 0..bsdf.lobe_count() {
                let there = evaluate(bsdf, lobe, o, i) / i.z.abs();
                let back = evaluate(bsdf, lobe, i, o) / o.z.abs();
                let size = there.max_element().max(back.max_element());
                if size > 0.0 {
                    worst = worst.max(f64::from((there - back).abs().max_element() / size));
                }
            }
        }
    }
    worst
}

const RECIPROCITY_TOLERANCE: f64 = 2e-5;

#[test]
fn a_cosine_missing_in_one_lobe() {
    let right = |bsdf: &Bsdf, lobe, o, i| bsdf.evaluate_lobe(lobe, o, i).value;
    assert!(reciprocity_error(right) < RECIPROCITY_TOLERANCE, "{}", reciprocity_error(right));
    for planted in 0..2 {
        let wrong = |bsdf: &Bsdf, lobe, o, i: Vec3| {
            right(bsdf, lobe, o, i) / if lobe == planted { i.z.abs() } else { 1.0 }
        };
        assert!(reciprocity_error(wrong) > RECIPROCITY_TOLERANCE, "lobe {planted}");
    }
}

/// Largest distance of the shares of two techniques from a sum of 1, over 10⁵ pairs of densities
/// from 10⁻¹⁵ to 10¹⁵.
fn partition_error(light_share: impl Fn(f32, f32) -> f32) -> f64 {
    let mut stream = Stream::from_key(6);
    let mut density = || 10_f32.powf(30.0 * stream.uniform() - 15.0);
    (0..100_000).fold(0.0, |worst: f64, i| {
        let a = density();
        let b = if i % 2 == 0 { density() } else { a * 2.0_f32.powi(i % 7 - 3) };
        let sum = f64::from(light_share(a, b)) + f64::from(power_heuristic(b, a));
        worst.max((sum - 1.0).abs())
    })
}

/// Two shares of at most 1, each within three roundings.
const PARTITION_TOLERANCE: f64 = 4.0 / 16_777_216.0;

#[test]
fn one_side_of_mis_is_three_in_a_thousand_off() {
    assert!(
        partition_error(power_heuristic) < PARTITION_TOLERANCE,
        "{}",
        partition_error(power_heuristic)
    );
    assert!(partition_error(|a, b| 1.003 * power_heuristic(a, b)) > PARTITION_TOLERANCE);
    assert_eq!(power_heuristic(1.0, 0.0), 1.0);
    assert_eq!(power_heuristic(1e-30, 1e30), 0.0);
}

/// Two scatterings in a white sphere, a fifth of which shines: wherever a path is, a fifth of its
/// directions ends there, unless the second direction follows from the first. Verdict, relative
/// bias, and c of a path.
fn two_bounces(bug: Bug) -> (Verdict, f64, f64) {
    let mut scene = Scene::new("cap");
    let white = diffuse(&mut scene, 1.0);
    let black = diffuse(&mut scene, 0.0);
    scene.add_shape(sphere(1.0, white));
    // The disk cuts off a cap of height 1 − 0.6, a fifth of the sphere; from the rest of it both
    // fill the same directions.
    let disk = Geometry::Disk { center: Vec3::X * 0.6, normal: -Vec3::X, radius: 0.8 };
    scene.add_shape(Shape::new(disk, black).emitting(Vec3::ONE));
    scene.camera = look_at(Vec3::new(-0.25, 0.25, 0.0), Vec3::new(-0.6, 0.8, 0.0), 1e-4);
    let world = world(scene);
    let shot = shot([32, 32], 3, 8);
    let sample: Moments = (0..64)
        .map(|run| mean_red(&walked(&world, bug, Shot { run: 900 + run, ..shot })))
        .collect();
    // 0.2 directly; 0.8 of the directions meet the white part, from which again 0.2 shines.
    let truth = 0.2 + 0.8 * 0.2;
    let result = against(&sample, truth);
    let c = sample.variance().sqrt() / sample.mean() * f64::from(32 * 32 * 8_u32).sqrt();
    (result.verdict, result.test.difference / truth, c)
}

#[test]
fn the_seed_reused_at_two_vertices() {
    let (right, wrong) = (two_bounces(Bug::None), two_bounces(Bug::SeedReused));
    assert_eq!(right.0, Verdict::Pass, "{right:?}");
    assert_eq!(wrong.0, Verdict::Fail, "{wrong:?}");
}

/// Lights of every kind, each outside of a black shell around everything that is seen.
fn shells() -> Vec<(&'static str, Scene)> {
    let above = Vec3::new(0.5, 3.0, 0.25);
    let base = |name: &'static str| {
        let mut scene = Scene::new(name);
        let white = diffuse(&mut scene, 1.0);
        let black = diffuse(&mut scene, 0.0);
        receiver(&mut scene, Vec3::ZERO, Vec3::Y, 0.96, white);
        scene.add_shape(sphere(1.0, black));
        (name, scene)
    };
    let mut all: Vec<(&str, Scene)> =
        ["triangle", "sphere", "disk", "point", "spot", "distant", "environment"].map(base).into();
    for (name, scene) in &mut all {
        let black = diffuse(scene, 0.0);
        let intensity = Vec3::ONE;
        let down = along(above, -Vec3::Y);
        let mut lamp = |geometry| scene.add_shape(Shape::new(geometry, black).emitting(Vec3::ONE));
        match *name {
            "triangle" => {
                lamp(polygon(&[
                    above,
                    above + Vec3::new(1.0, 0.0, 0.0),
                    above + Vec3::new(1.0, 0.0, 1.0),
                ]));
            }
            "sphere" => lamp(Geometry::Sphere { center: above, radius: 0.5 }),
            "disk" => lamp(Geometry::Disk { center: above, normal: -Vec3::Y, radius: 0.5 }),
            "point" => light(scene, LightKind::Point { intensity }, down),
            "distant" => light(scene, LightKind::Distant { irradiance: intensity }, down),
            "environment" => {
                light(scene, LightKind::Environment { radiance: intensity, image: None }, down);
            }
            _ => {
                let falloff = afterimage::scene::SpotFalloff::Quadratic;
                let kind = LightKind::Spot { intensity, cos_inner: 0.9, cos_outer: 0.5, falloff };
                light(scene, kind, down);
            }
        }
    }
    all
}

#[test]
fn a_light_kind_without_its_visibility_ray() {
    let shot = shot([8, 8], 4, 4);
    for (name, mut scene) in shells() {
        let stage = Stage::new(scene.clone()).unwrap();
        for entry in REGISTRY {
            let (picture, counters) = last_frame(&stage, entry.name, shot, 1);
            assert!(picture.pixels.iter().all(|p| *p == Vec3::ZERO), "{}: {name}", entry.name);
            assert!(entry.name != "nee" || counters.shadow_rays > 0, "{name} was not even asked");
        }
        let wrong = mean_red(&walked(&world(scene.clone()), Bug::PointLightsUnshadowed, shot));
        assert_eq!(wrong > 0.0, matches!(name, "point" | "spot"), "{name}");
        // Without the shell each light is seen.
        scene.instances.remove(1);
        assert!(mean_red(&picture(&Stage::new(scene).unwrap(), "nee", shot)) > 0.0, "{name}");
    }
}

/// Whether a walk gives other bits in a room 2^±8 times as large.
fn sees_scale(bug: Bug) -> bool {
    let shot = shot([24, 16], 4, 1);
    let image = |k: i32| bits(&walked(&world(scaled(&room(), 2.0_f32.powi(k))), bug, shot));
    let original = image(0);
    [-8, 8].into_iter().any(|k| image(k) != original)
}

#[test]
fn an_absolute_epsilon() {
    assert!(!sees_scale(Bug::None));
    assert!(sees_scale(Bug::AbsoluteOffset(1e-4)));
}

/// Relative error of one point light on white Lambert: an answer without noise.
fn noiseless_error(bug: Bug) -> f64 {
    let mut scene = Scene::new("noiseless");
    let white = diffuse(&mut scene, 1.0);
    receiver(&mut scene, Vec3::ZERO, Vec3::Y, 0.96, white);
    let place = along(Vec3::new(1.5, 2.0, 0.0), Vec3::Y);
    light(&mut scene, LightKind::Point { intensity: Vec3::splat(2.0) }, place);
    let truth = 2.0 * 0.8 / 6.25 / std::f64::consts::PI;
    mean_red(&walked(&world(scene), bug, shot([4, 4], 2, 1))) / truth - 1.0
}

const NOISELESS_TOLERANCE: f64 = 1e-6;

#[test]
fn all_reflected_light_one_percent_off() {
    assert!(
        noiseless_error(Bug::None).abs() < NOISELESS_TOLERANCE,
        "{}",
        noiseless_error(Bug::None)
    );
    assert!(noiseless_error(Bug::Reflected(1.01)).abs() > NOISELESS_TOLERANCE);
}

/// Prints the rows of `docs/planted_bugs.md`: what each bug does to a picture, the smallest size
/// its test finds, the test's time.
#[test]
#[ignore = "slow: prints the table of docs/planted_bugs.md"]
fn table() {
    /// The last of 2⁻¹, 2⁻², … that is found.
    fn smallest(found: impl Fn(f32) -> bool) -> f32 {
        let mut size = 0.5_f32;
        while found(0.5 * size) && size > 1e-12 {
            size *= 0.5;
        }
        size
    }
    let clean = world(full_room());
    let shot = shot([48, 48], 5, 64);
    let right = walked(&clean, Bug::None, shot);
    let row = |name: &str, bug: Bug, test: &dyn Fn(), size: f32| {
        let wrong = walked(&clean, bug, shot);
        let shift = 100.0 * (mean_red(&wrong) / mean_red(&right) - 1.0);
        let begin = Instant::now();
        test();
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        println!("{name} | picture {shift:+.3} % | smallest {size:.1e} | {ms:.1} ms");
    };
    row(
        "light density x 1.01",
        Bug::LightPdf(1.01),
        &|| _ = black_box(density_error(1.0)),
        smallest(|e| density_error(1.0 + e) > DENSITY_TOLERANCE),
    );
    let power = |e: f32| {
        reciprocity_error(|bsdf, lobe, o, i| {
            bsdf.evaluate_lobe(lobe, o, i).value * i.z.abs().powf(-e)
        })
    };
    row(
        "a cosine (to the power of the size) missing",
        Bug::NoCosine,
        &|| _ = black_box(power(0.0)),
        smallest(|e| power(e) > RECIPROCITY_TOLERANCE),
    );
    row(
        "light share x 1.003",
        Bug::LightShare(1.003),
        &|| _ = black_box(partition_error(power_heuristic)),
        smallest(|e| {
            partition_error(|a, b| (1.0 + e) * power_heuristic(a, b)) > PARTITION_TOLERANCE
        }),
    );
    println!(
        "seed reused: {:?}, without: {:?}",
        two_bounces(Bug::SeedReused),
        two_bounces(Bug::None)
    );
    row("seed reused", Bug::SeedReused, &|| _ = black_box(two_bounces(Bug::None)), f32::NAN);
    row(
        "point lights unshadowed",
        Bug::PointLightsUnshadowed,
        &|| a_light_kind_without_its_visibility_ray(),
        f32::NAN,
    );
    row(
        "offset 1e-4",
        Bug::AbsoluteOffset(1e-4),
        &|| _ = black_box(sees_scale(Bug::None)),
        smallest(|e| sees_scale(Bug::AbsoluteOffset(e))),
    );
    row(
        "reflected light x 1.01",
        Bug::Reflected(1.01),
        &|| _ = black_box(noiseless_error(Bug::None)),
        smallest(|e| noiseless_error(Bug::Reflected(1.0 + e)).abs() > NOISELESS_TOLERANCE),
    );
}
