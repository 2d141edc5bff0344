//! Lamps by themselves: where they face, wherever they are placed; how bright they are, however
//! small and far; that no two are taken for one.
//!
//! The expectations are closed forms or the same lamp in its own space, never another part of the
//! crate.

use std::f64::consts::PI;

use afterimage::accel::{BuildOptions, Ray};
use afterimage::light::NO_LIGHT;
use afterimage::math::rng::{RandomSource, Stream};
use afterimage::path::emitted;
use afterimage::scene::{Geometry, LightKind, Object, Scene, Shape, Transform};
use afterimage::world::World;
use glam::{Affine3A, Mat3A, Quat, Vec2, Vec3};

use crate::support::{diffuse, light, polygon};

fn world(scene: &Scene) -> World {
    World::new(scene.clone(), &BuildOptions::default()).unwrap()
}

/// A lamp alone in the world, placed by `to_world`.
fn alone(shape: &Shape, to_world: Affine3A) -> World {
    let mut scene = Scene::new("lamp");
    diffuse(&mut scene, 0.5);
    let object = scene.add_object(Object { name: String::new(), shapes: vec![shape.clone()] });
    scene.add_instance(object, Transform::Fixed(to_world), 1);
    world(&scene)
}

/// What light sampling says that reaches a place from lamp 0, and what a ray along the same
/// direction meets: both radiances; the ray's is `None` where it misses by rounding.
fn seen(world: &World, from: Vec3, u: Vec2) -> (Vec3, Option<Vec3>) {
    let Some(incident) = world.lights.sample_towards(&world.scene, 0, from, u) else {
        return (Vec3::ZERO, None);
    };
    let direction = incident.direction;
    let hit = world.closest_hit(&Ray { origin: from, direction, t_max: f32::INFINITY });
    (incident.radiance, hit.map(|hit| emitted(world, &world.accel.point(&hit), direction)))
}

/// A lamp that is moved, turned, stretched or mirrored shines on what moves with it, and on nothing
/// else: by light sampling and by rays that meet it.
#[test]
fn a_lamp_faces_where_its_object_faces() {
    let radiance = Vec3::new(3.0, 2.0, 1.0);
    let c = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let quad = polygon(&[c(-0.5, -0.4), c(0.6, -0.5), c(0.5, 0.5), c(-0.4, 0.6)]);
    let mut smooth = quad.clone();
    if let Geometry::Mesh(mesh) = &mut smooth {
        // Vertex normals against the winding: they say where the surface faces.
        std::sync::Arc::make_mut(mesh).normals = vec![-Vec3::Z; 4];
    }
    let disk = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Z, radius: 0.5 };
    let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 0.5 };
    let turn = Mat3A::from_quat(Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -0.7));
    let scaled = |x: f32, y: f32, z: f32| Mat3A::from_diagonal(Vec3::new(x, y, z));
    let uniform = [
        Mat3A::IDENTITY,
        turn,
        scaled(-1.0, 1.0, 1.0),
        scaled(1.0, 1.0, -1.0),
        turn * scaled(-2.0, 2.0, 2.0),
        scaled(-1.0, -1.0, -1.0),
    ];
    let stretched = [turn * scaled(2.0, -0.5, 1.0), scaled(-1.0, -3.0, 1.0)];
    for (name, geometry, stretches) in [
        ("quad", quad, true),
        ("smooth quad", smooth, true),
        ("disk", disk, false),
        ("ball", ball, false),
    ] {
        let places = uniform.iter().chain(stretched.iter().filter(|_| stretches));
        for (at, matrix) in places.enumerate() {
            for (two_sided, reverse) in [(false, false), (false, true), (true, false)] {
                let mut shape = Shape::new(geometry.clone(), afterimage::scene::MaterialId(0));
                shape = shape.emitting(radiance);
                shape.reverse_orientation = reverse;
                shape.emission.as_mut().unwrap().two_sided = two_sided;
                let place =
                    Affine3A { matrix3: *matrix, translation: Vec3::new(4.0, -1.0, 2.0).into() };
                let placed = alone(&shape, place);
                // Where the lamp faces in its own space: a mesh with vertex normals to their side,
                // all others to the side of their normal, unless turned around.
                let front = match name {
                    "smooth quad" => -1.0,
                    _ if reverse => -1.0,
                    _ => 1.0,
                };
                let mut random = Stream::from_key(7);
                let mut sides = [0; 2];
                for _ in 0..400 {
                    let mut next = || 2.0 * random.uniform() - 1.0;
                    let from = 2.0 * Vec3::new(next(), next(), next());
                    let away = if name == "ball" { from.length() - 0.5 } else { from.z };
                    if away.abs() < 0.05 {
                        continue;
                    }
                    let u = Vec2::new(random.uniform(), random.uniform());
                    let lit = two_sided || away * front > 0.0;
                    let (sampled, met) = seen(&placed, place.transform_point3(from), u);
                    let what = format!(
                        "{name} {at}, two-sided {two_sided}, reverse {reverse}, from {from}: {sampled} by light sampling, {met:?} by a ray"
                    );
                    let right = if lit { radiance } else { Vec3::ZERO };
                    // A ray from inside of a ball always meets it.
                    assert!((sampled - right).length() < 1e-5, "{what}");
                    if let Some(met) = met {
                        assert!((met - right).length() < 1e-5, "{what}");
                        sides[usize::from(lit)] += 1;
                    }
                }
                assert!(sides[1] > 3, "{name} {at}: {sides:?}");
            }
        }
    }
}

/// Irradiance at a receiver that faces the lamp, from the mean of stratified light samples, in f64.
fn irradiance(world: &World, from: Vec3, normal: Vec3) -> (f64, f64) {
    const STRATA: u32 = 32;
    let (mut sum, mut worst) = (0.0, 0.0_f64);
    for cell in 0..STRATA * STRATA {
        let cell = Vec2::new((cell % STRATA) as f32, (cell / STRATA) as f32);
        let u = (cell + 0.5) / STRATA as f32;
        for light in 0..world.lights.len() as u32 {
            let Some(incident) = world.lights.sample_towards(&world.scene, light, from, u) else {
                continue;
            };
            let cosine = f64::from(incident.direction.dot(normal).max(0.0));
            sum += f64::from(incident.radiance.x) * cosine / f64::from(incident.pdf);
            // The density that a ray along the same direction would be weighted with.
            let direction = incident.direction;
            let ray = Ray { origin: from, direction, t_max: f32::INFINITY };
            if let Some(hit) = world.closest_hit(&ray) {
                let at = world.accel.point(&hit);
                let of = world.lights.of_surface(at.shape, at.element);
                let facing = -at.geometric_normal.dot(direction);
                let pdf = world.lights.pdf_towards(of, from, at.position, facing);
                worst = worst.max((f64::from(pdf) / f64::from(incident.pdf) - 1.0).abs());
            }
        }
    }
    (sum / f64::from(STRATA * STRATA), worst)
}

/// Irradiance of a ball, a disk and a square that face the receiver from a distance of 1, down to a
/// radius of 10⁻⁶: π L sin² θ for the ball and the disk's own form, the area for small squares.
#[test]
fn small_and_far_lamps_are_as_bright_as_they_should_be() {
    let grey = afterimage::scene::MaterialId(0);
    for exponent in 1..=12 {
        let r = 10_f64.powf(-0.5 * f64::from(exponent));
        let radius = r as f32;
        let r = f64::from(radius);
        let ball = Geometry::Sphere { center: Vec3::Z, radius };
        let disk = Geometry::Disk { center: Vec3::Z, normal: -Vec3::Z, radius };
        let c = |x: f32, y: f32| Vec3::new(radius * x, radius * y, 1.0);
        let square = polygon(&[c(-1.0, -1.0), c(-1.0, 1.0), c(1.0, 1.0), c(1.0, -1.0)]);
        // A rectangle from above its middle: four times the corner form (Gershun).
        let side = (1.0 + r * r).sqrt();
        let corner = r / side * (r / side).atan();
        let cases = [
            ("ball", ball, PI * r * r),
            ("disk", disk, PI * r * r / (1.0 + r * r)),
            ("square", square, 4.0 * corner),
        ];
        // Rounding, and what 32² strata leave of lamps that are not small.
        let tolerance = 1e-6 + 3e-3 * r * r;
        for (name, geometry, expected) in cases {
            for distance in [1.0_f32, 1e-3, 1e4] {
                let place = Affine3A::from_scale(Vec3::splat(distance));
                let lamp = alone(&Shape::new(geometry.clone(), grey).emitting(Vec3::ONE), place);
                let (found, worst) = irradiance(&lamp, Vec3::ZERO, Vec3::Z);
                let error = found / expected - 1.0;
                assert!(error.abs() < tolerance, "{name} of {r:e}: {found:e}, not {expected:e}");
                assert!(worst < 1e-5, "{name} of {r:e}: densities differ by {worst}");
            }
        }
    }
}

/// Every emitting triangle, ball and light of every instance has a key of its own, the same in
/// every frame; shapes that emit nothing have none.
#[test]
fn no_two_lamps_are_taken_for_one() {
    let mut scene = Scene::new("keys");
    let grey = diffuse(&mut scene, 0.5);
    let c = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let quad = || polygon(&[c(0.0, 0.0), c(1.0, 0.0), c(1.0, 1.0), c(0.0, 1.0)]);
    let ball = Geometry::Sphere { center: Vec3::Z, radius: 0.2 };
    let lit = |geometry: Geometry| Shape::new(geometry, grey).emitting(Vec3::ONE);
    let shapes =
        vec![lit(quad()), Shape::new(quad(), grey), lit(ball.clone()), lit(quad()), lit(ball)];
    let object = scene.add_object(Object { name: String::new(), shapes });
    for key in 0..3 {
        let place = Affine3A::from_translation(Vec3::new(3.0 * key as f32, 0.0, 0.0));
        scene.add_instance(object, Transform::Fixed(place), key);
    }
    for _ in 0..3 {
        // With keys 0, 1, 2, as the instances have.
        light(&mut scene, LightKind::Point { intensity: Vec3::ONE }, Affine3A::IDENTITY);
    }
    let lights = world(&scene).lights;
    assert_eq!(lights.len(), 3 * 6 + 3);
    let mut keys: Vec<_> = (0..lights.len() as u32).map(|light| lights.key(light)).collect();
    let (before, count) = (keys.clone(), keys.len());
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), count, "{before:?}");
    let of = |shape: u32, element: u32| lights.of_surface(shape, element);
    assert_eq!([of(0, 0), of(0, 1), of(2, 0), of(3, 1), of(4, 0)], [0, 1, 2, 4, 5]);
    assert_eq!([of(5, 0), of(10, 1), of(14, 0)], [6, 13, 17]);
    assert_eq!(of(1, 0), NO_LIGHT);
    // Another order of the instances: the same keys.
    scene.instances.rotate_left(1);
    let turned = world(&scene).lights;
    let mut again: Vec<_> = (0..turned.len() as u32).map(|light| turned.key(light)).collect();
    assert_ne!(again, before);
    again.sort_unstable();
    assert_eq!(again, keys);
}
