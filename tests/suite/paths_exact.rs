//! The shift of paths against derivatives in double precision, and against itself at length.

use std::cmp::Ordering;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use afterimage::accel::AcceptAll;
use afterimage::frame::Stage;
use afterimage::light::LightPoint;
use afterimage::math::rng::{Stream, path_seed};
use afterimage::math::warp::sample_uniform_sphere;
use afterimage::path::power_heuristic;
use afterimage::resampling::ShiftMap;
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{
    Anchor, Connects, Ending, NO_LOBE, PathReceiver, PathSample, PathShift, Predicate,
    Reconnection, ShiftKind,
};
use afterimage::scene::{
    Channel, Color, ConductorColor, Geometry, Material, Roughness, Scalar, Scene, Shape, Texture,
    TextureKind,
};
use afterimage::world::World;
use glam::{Affine2, DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::paths::{CONNECTS, drawn, receivers_at, rooms};
use crate::support::{diffuse, environment, look_at, metal, polygon, room};

/// The ball's shape, and its object.
const BALL: u32 = 4;

/// Lambert surfaces at all angles, a lamp of two triangles, one that is a ball, and a sky.
pub(crate) fn matt() -> Scene {
    let mut scene = Scene::new("matt");
    let white = diffuse(&mut scene, 0.6);
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    for corners in [
        [c(-2.0, 0.0, -2.0), c(-2.0, 0.0, 2.0), c(2.0, 0.0, 2.0), c(2.0, 0.0, -2.0)],
        [c(-2.0, 0.0, 1.5), c(-2.0, 2.0, 2.5), c(2.0, 2.4, 2.0), c(2.0, 0.2, 1.5)],
        [c(-1.6, 0.0, -1.0), c(-2.2, 2.0, -1.0), c(-1.8, 2.0, 1.5), c(-1.6, 0.0, 1.5)],
    ] {
        scene.add_shape(Shape::new(polygon(&corners), white));
    }
    let lamp = [c(-0.4, 1.8, -0.4), c(0.4, 1.9, -0.4), c(0.4, 1.9, 0.4), c(-0.4, 1.8, 0.4)];
    scene.add_shape(Shape::new(polygon(&lamp), white).emitting(Vec3::splat(3.0)));
    let ball = Geometry::Sphere { center: c(1.2, 0.9, 0.3), radius: 0.3 };
    scene.add_shape(Shape::new(ball, white).emitting(Vec3::splat(5.0)));
    environment(&mut scene, Vec3::splat(0.3));
    scene.camera = look_at(c(0.0, 1.0, -3.0), c(0.0, 0.7, 0.0), 0.8);
    scene
}

/// Any orthonormal frame around a normal.
fn frame(normal: DVec3) -> [DVec3; 3] {
    let (s, t) = normal.any_orthonormal_pair();
    [s, t, normal]
}

/// The point of the unit disk below a direction: cosine-weighted directions are uniform there, so
/// it stands for the numbers of a Lambert lobe.
fn disk(frame: &[DVec3; 3], direction: DVec3) -> DVec2 {
    DVec2::new(direction.dot(frame[0]), direction.dot(frame[1]))
}

fn above(frame: &[DVec3; 3], at: DVec2) -> DVec3 {
    frame[0] * at.x + frame[1] * at.y + frame[2] * (1.0 - at.length_squared()).sqrt()
}

/// |∂f/∂u| by central differences.
fn determinant(u: DVec2, f: impl Fn(DVec2) -> DVec2) -> f64 {
    let h = 1e-7;
    let along = |step: DVec2| (f(u + step) - f(u - step)) / (2.0 * h);
    along(DVec2::X * h).perp_dot(along(DVec2::Y * h)).abs()
}

/// A receiver's place and normal.
fn place(receiver: &PathReceiver<'_>) -> (DVec3, DVec3) {
    let surface = receiver.world.surface(&receiver.hit);
    let normal = surface.frame.normal.as_dvec3();
    // The side that is looked at.
    let side = -receiver.direction.as_dvec3().dot(normal).signum();
    (surface.position.as_dvec3(), normal * side)
}

/// |∂u'/∂u| of a path of which x₁ is kept, by geometry alone.
fn numbers(
    world: &World,
    sample: &PathSample,
    from: &PathReceiver<'_>,
    to: &PathReceiver<'_>,
) -> f64 {
    let ((p, n), (q, m)) = (place(from), place(to));
    let (here, there) = (frame(n), frame(m));
    let kept = sample.reconnection.unwrap();
    match kept.anchor {
        Anchor::Surface(hit) => {
            let point = world.accel.point(&hit);
            let (x, normal) = (point.position.as_dvec3(), point.geometric_normal.as_dvec3());
            determinant(disk(&here, (x - p).normalize()), |u| {
                let w = above(&here, u);
                let x = match world.scene.objects[hit.instance as usize].shapes[0].geometry {
                    // A ball is met where it is near.
                    Geometry::Sphere { center, radius } => {
                        let (c, r) = (center.as_dvec3() - p, f64::from(radius));
                        let b = w.dot(c);
                        p + w * (b - (b * b - c.length_squared() + r * r).sqrt())
                    }
                    _ => p + w * ((x - p).dot(normal) / w.dot(normal)),
                };
                disk(&there, (x - q).normalize())
            })
        }
        Anchor::Sky { .. } => {
            let w = kept.direction.as_dvec3();
            determinant(disk(&here, w), |u| disk(&there, above(&here, u)))
        }
        Anchor::Point(LightPoint { light, uv }) => {
            // Lamps of triangles are drawn by area, the sky by direction: all receivers alike.
            if light != world.lights.of_surface(BALL, 0) {
                return 1.0;
            }
            let Geometry::Sphere { center, radius } =
                world.scene.objects[BALL as usize].shapes[0].geometry
            else {
                unreachable!("the ball is a ball")
            };
            let (c, r) = (center.as_dvec3(), f64::from(radius));
            // The ball by (1 − cos θ, φ) in the cone that it fills.
            let cone = |at: DVec3| {
                let axis = c - at;
                let cos = (1.0 - (r / axis.length()).powi(2)).sqrt();
                (frame(axis.normalize()), 1.0 - cos)
            };
            let ((from, size), (to, other)) = (cone(p), cone(q));
            let w = (c + sample_uniform_sphere(uv).as_dvec3() * r - p).normalize();
            let u = DVec2::new(1.0 - w.dot(from[2]), w.dot(from[1]).atan2(w.dot(from[0])));
            let ratio = determinant(u, |u| {
                let (cos, sin) = (1.0 - u.x, (u.x * (2.0 - u.x)).sqrt());
                let w = from[0] * (sin * u.y.cos()) + from[1] * (sin * u.y.sin()) + from[2] * cos;
                let b = w.dot(c - p);
                let x = p + w * (b - (b * b - (c - p).length_squared() + r * r).max(0.0).sqrt());
                let w = (x - q).normalize();
                DVec2::new(1.0 - w.dot(to[2]), w.dot(to[1]).atan2(w.dot(to[0])))
            });
            ratio * size / other
        }
    }
}

/// |∂T| of every kind of connection at the primary hit of Lambert surfaces is the determinant of the
/// numbers' map in double precision. Controls: 1, and the cosine of the wrong end.
#[test]
fn jacobians_are_determinants_of_the_numbers() {
    let stage = Stage::new(matt()).unwrap();
    let world = stage.first_world();
    let all = receivers_at(world, Time::Now);
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let mut random = Stream::from_key(31);
    let mut met = [0_u32; 5];
    let (mut worst, mut ones, mut wrong_ends) = (0.0_f64, 0, 0);
    for (pixel, from) in all.iter().enumerate() {
        for walk in 0..24 {
            let seed = path_seed(31, pixel as u32, 0, walk);
            let Some(sample) = drawn(world, from, seed, &mut random).sample else { continue };
            let Some(kept) = sample.reconnection.filter(|kept| kept.vertex == 1) else { continue };
            let to = &all[(pixel + [1, 3, 24, 77][walk as usize % 4]) % all.len()];
            let Some(there) = shift.shift(&sample, from, to) else { continue };
            let expected = numbers(world, &sample, from, to);
            let jacobian = f64::from(there.jacobian);
            // Derivatives break at the ball's silhouette, where 1 − cos² vanishes.
            if !(0.02..50.0).contains(&expected) {
                continue;
            }
            let error = (jacobian / expected - 1.0).abs();
            let kind = match (kept.anchor, sample.ending) {
                (Anchor::Sky { .. }, _) => 0,
                (Anchor::Point(_), _) => 1,
                (_, Ending::Emitter) if kept.vertex > sample.last => 2,
                (_, Ending::Light { .. }) => 3,
                _ => 4,
            };
            assert!(
                error < 1e-4 * (1.0 + expected.max(1.0 / expected)),
                "{error}: {jacobian} instead of {expected}, {sample:?}"
            );
            worst = worst.max(error);
            met[kind] += 1;
            ones += u32::from((expected - 1.0).abs() > 1e-2);
            if let Anchor::Surface(hit) = kept.anchor {
                let ((p, n), (q, m)) = (place(from), place(to));
                let x = world.accel.point(&hit).position.as_dvec3();
                let g = |at: DVec3, normal: DVec3| {
                    let way = x - at;
                    (normal.dot(way) / way.length()).powi(2) / way.length_squared()
                };
                let wrong = g(q, m) / g(p, n);
                wrong_ends += u32::from((wrong / expected - 1.0).abs() > 1e-2);
            }
        }
    }
    println!("kinds {met:?}, worst {worst:e}, {ones} are not 1");
    assert!(met.iter().all(|count| *count > 50), "{met:?}");
    assert!(ones > 500 && wrong_ends > 500, "{ones} and {wrong_ends} tell the controls apart");
}

/// ω of both techniques for one path sums to 1: what a light sample is worth beside a direction
/// that meets the light, from wherever the path was shifted to.
#[test]
fn both_techniques_sum_to_one() {
    let stage = Stage::new(matt()).unwrap();
    let world = stage.first_world();
    let all = receivers_at(world, Time::Now);
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let mut random = Stream::from_key(32);
    let (mut met, mut stale) = (0, 0);
    for (pixel, from) in all.iter().enumerate() {
        for walk in 0..64 {
            let seed = path_seed(32, pixel as u32, 0, walk);
            let Some(sample) = drawn(world, from, seed, &mut random).sample else { continue };
            let emitter = sample.ending == Ending::Emitter && sample.last == 0;
            let Some(kept) = sample.reconnection.filter(|_| emitter) else { continue };
            let to = &all[(pixel + 40) % all.len()];
            let Ok(there) = shift.try_shift(&sample, from, to) else { continue };
            let Anchor::Surface(hit) = kept.anchor else { unreachable!() };
            // ω of the direction is in F; that of the light sample is made from its own side.
            let share = |receiver: &PathReceiver<'_>, other: &PathReceiver<'_>| {
                let surface = world.surface(&receiver.hit);
                let point = world.accel.point(&hit);
                let way = point.position - surface.position;
                let direction = way.normalize();
                let wo = surface.frame.to_local(-receiver.direction);
                let lobes = surface.bsdf.evaluate(wo, surface.frame.to_local(direction));
                let light = world.lights.of_surface(point.shape, point.element);
                let seen_from = world.surface(&other.hit).position;
                let cosine = -(point.position - seen_from).normalize().dot(point.geometric_normal);
                let density = world.lights.choice_probability(light)
                    * world.lights.pdf_towards(light, seen_from, point.position, cosine);
                let emitted = world.lights.emitted(
                    &world.scene,
                    light,
                    point.uv,
                    -direction.dot(point.geometric_normal),
                );
                let by_direction = there.integrand / (lobes.value / lobes.pdf * emitted);
                by_direction.x + power_heuristic(density, lobes.pdf)
            };
            assert!((share(to, to) - 1.0).abs() < 1e-3, "{}", share(to, to));
            stale += u32::from((share(to, from) - 1.0).abs() > 1e-2);
            met += 1;
        }
    }
    assert!(met > 200 && stale > 100, "{met} paths, {stale} tell a stale density");
}

/// A shifted path has the reconnection vertex that it would have as a path of its own: where the
/// numbers that it shares with a fresh walk of the same seed make an earlier pair that may be
/// connected, the shift is undefined. (Round trips do not see a shift that leaves this out, since
/// both ways leave it out.)
#[test]
fn no_shift_passes_a_pair_that_may_be_connected() {
    let (mut long, mut refused) = (0, 0);
    let stage = Stage::new(mirrors()).unwrap();
    let world = stage.first_world();
    let all = receivers_at(world, Time::Now);
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let mut random = Stream::from_key(34);
    for (pixel, from) in all.iter().enumerate() {
        for walk in 0..200 {
            let seed = path_seed(34, pixel as u32, 0, walk);
            let Some(sample) = drawn(world, from, seed, &mut random).sample else { continue };
            // The vertices that a shift leaves by the path's own numbers.
            let replayed = match sample.reconnection {
                Some(kept) => u32::from(kept.vertex).saturating_sub(1),
                None => u32::from(sample.last) + 1,
            };
            if replayed < 2 {
                continue;
            }
            long += 1;
            for step in [1, 7, 24, 100] {
                let to = &all[(pixel + step) % all.len()];
                // A walk's paths that go on behind its first such pair say where it is.
                let passes = (0..6).any(|_| {
                    let there = drawn(world, to, seed, &mut random).sample;
                    there.is_some_and(|there| {
                        let kept = there.reconnection.filter(|kept| kept.vertex <= there.last);
                        // A light sample at the vertex itself needs no lobe.
                        let own = |kept: &Reconnection| kept.lobes[1] != NO_LOBE;
                        kept.filter(own).is_some_and(|kept| u32::from(kept.vertex) < replayed)
                    })
                });
                if passes {
                    let shifted = shift.try_shift(&sample, from, to);
                    assert!(shifted.is_err(), "{sample:?} passes a pair: {shifted:?}");
                    refused += 1;
                }
            }
        }
    }
    println!("{long} paths are replayed for two vertices and more, {refused} shifts pass a pair");
    assert!(long > 500 && refused > 50, "{long} long paths, {refused} refused");
}

/// A room whose floor and balls are mirrors or glass, so that many vertices are replayed.
pub(crate) fn mirrors() -> Scene {
    let mut scene = room();
    let (mirror, glossy) = (metal(&mut scene, 0.0), metal(&mut scene, 0.15));
    let roughness = Roughness::SMOOTH;
    let glass = scene.add_material(Material::Dielectric { eta: 1.5, roughness });
    for (instance, material) in [(0, mirror), (2, mirror), (3, glossy), (5, glass), (6, mirror)] {
        Arc::make_mut(&mut scene.objects[instance]).shapes[0].material = material;
    }
    scene
}

/// A room whose floor and balls have all roughnesses from 0 to 1 inside of a pixel.
pub(crate) fn textured() -> Scene {
    let mut scene = room();
    let tone = |alpha: f32| Color::Constant(Vec3::splat(alpha));
    let squares = |scene: &mut Scene, first: f32, second: f32, scale: f32| {
        let kind = TextureKind::Checkerboard { first: tone(first), second: tone(second) };
        let mapping = Affine2::from_scale(Vec2::splat(scale));
        Scalar::Texture(scene.add_texture(Texture { kind, mapping }), Channel::Red)
    };
    for (instance, first, second) in [(0, 0.0, 1.0), (5, 0.03, 0.2), (6, 0.5, 0.01)] {
        let u = squares(&mut scene, first, second, 61.0);
        let v = squares(&mut scene, second, first, 47.0);
        let material = scene.add_material(Material::Conductor {
            color: ConductorColor::Reflectance(tone(0.9)),
            roughness: Roughness { u, v, remap: false },
        });
        Arc::make_mut(&mut scene.objects[instance]).shapes[0].material = material;
    }
    scene
}

/// Shifts of `samples` paths of each room to `to` receivers each: all that are defined come back,
/// by Jacobians whose product is 1, as what they were, in the stratum that they were in.
fn trips((kind, predicate): (ShiftKind, Predicate), samples: u32, to: usize) -> [u64; 2] {
    let connects = Connects::new(CONNECTS.distance, kind).by(predicate);
    let mut total = [0, 0];
    for scene in rooms().into_iter().chain([mirrors(), textured()]) {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let all = receivers_at(world, Time::Now);
        let one = |number: u32| {
            let mut random = Stream::from_key(u64::from(number));
            let mut shift = PathShift::new(&AcceptAll, connects, None);
            let (mut found, mut lost) = (0, 0);
            let from = &all[number as usize % all.len()];
            let seed = path_seed(33, number, 0, 0);
            let Some(drawn) =
                crate::paths::drawn_by::<false>(world, from, seed, &mut random, connects).sample
            else {
                return [0, 0];
            };
            let Ok(own) = shift.try_shift(&drawn, from, from) else { return [0, 0] };
            for step in 0..to {
                let to = &all[(number as usize * 7 + step * 5) % all.len()];
                let Some(there) = shift.shift(&own.sample, from, to) else { continue };
                found += 1;
                assert_eq!(shift.stratum(&there.sample), shift.stratum(&drawn));
                match shift.shift(&there.sample, to, from) {
                    None => lost += 1,
                    Some(back) => {
                        let product = (back.jacobian * there.jacobian - 1.0).abs();
                        assert!(product < 1e-4, "{product}: {own:?} {there:?} {back:?}");
                        let error = (back.integrand - own.integrand).abs().max_element();
                        assert!(error <= 1e-5 * own.integrand.max_element(), "{own:?} {back:?}");
                    }
                }
            }
            [found, lost]
        };
        let sum = (0..samples).into_par_iter().map(one);
        let sum = sum.reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        total = [total[0] + sum[0], total[1] + sum[1]];
    }
    total
}

#[test]
fn many_round_trips() {
    for kind in [
        (ShiftKind::Hybrid, Predicate::Distance),
        (ShiftKind::Hybrid, Predicate::Footprint),
        (ShiftKind::Reconnection, Predicate::Distance),
        (ShiftKind::Replay, Predicate::Distance),
    ] {
        let [found, lost] = trips(kind, 6_000, 24);
        println!("{kind:?}: {found} shifts, {lost} lost");
        assert!(found > 20_000 && lost == 0, "{kind:?}: {found} shifts, {lost} lost");
    }
}

/// The cases of a shift, by what the path is connected to.
const CASES: [&str; 9] = [
    "a surface inside, the first vertex behind the primary hit",
    "a surface inside, after a replay",
    "the surface before a light sample",
    "the surface before a direction to an emitter",
    "the surface before a direction to a sky",
    "an emitter that a direction met",
    "a direction to a sky",
    "a point on a light",
    "nothing: all is replayed",
];

/// The place in [`CASES`].
fn case(sample: &PathSample) -> usize {
    let Some(kept) = &sample.reconnection else { return 8 };
    match (kept.vertex.cmp(&sample.last), kept.anchor, sample.ending) {
        (Ordering::Less, ..) => usize::from(kept.vertex > 1),
        (Ordering::Equal, _, Ending::Emitter) => 3,
        (Ordering::Equal, _, Ending::Sky { .. }) => 4,
        (Ordering::Equal, ..) => 2,
        (Ordering::Greater, Anchor::Surface(_), _) => 5,
        (Ordering::Greater, Anchor::Sky { .. }, _) => 6,
        (Ordering::Greater, Anchor::Point(_), _) => 7,
    }
}

/// Ten million shifts of each case by each predicate come back. A shift that is lost where a
/// distance or a roughness lies at a threshold, so that it comes back by thresholds a thousandth
/// higher or lower, is a flip of rounding and counted apart.
#[test]
#[ignore = "takes long; docs/restir_pt.md says what is known"]
fn long_round_trips() {
    const TRIPS: u64 = 10_000_000;
    for predicate in [Predicate::Distance, Predicate::Footprint] {
        let connects = Connects::new(CONNECTS.distance, ShiftKind::Hybrid).by(predicate);
        let counts: [[AtomicU64; 3]; 9] = Default::default();
        let wanted = |case: usize| counts[case][0].load(Relaxed) < TRIPS;
        let scenes = rooms().into_iter().chain([mirrors(), textured(), matt()]);
        let stages: Vec<Stage> = scenes.map(|scene| Stage::new(scene).unwrap()).collect();
        let all: Vec<Vec<PathReceiver<'_>>> =
            stages.iter().map(|stage| receivers_at(stage.first_world(), Time::Now)).collect();
        let one = |number: u32| {
            let all = &all[number as usize % all.len()];
            let from = &all[(number as usize / 7) % all.len()];
            let mut random = Stream::from_key(u64::from(number));
            let mut shift = PathShift::new(&AcceptAll, connects, None);
            let seed = path_seed(35, number, 0, 0);
            let drawn = crate::paths::drawn_by::<false>;
            let sample = drawn(from.world, from, seed, &mut random, connects).sample;
            let Some(sample) = sample.filter(|sample| wanted(case(sample))) else { return };
            let Ok(own) = shift.try_shift(&sample, from, from) else { return };
            let counts = &counts[case(&sample)];
            for to in all {
                let Some(there) = shift.shift(&own.sample, from, to) else { continue };
                counts[0].fetch_add(1, Relaxed);
                assert_eq!(shift.stratum(&there.sample), shift.stratum(&sample));
                let Some(back) = shift.shift(&there.sample, to, from) else {
                    let nudged = [0.999, 1.001].iter().any(|by| {
                        let roughness = connects.roughness * by;
                        let distance = connects.distance * by;
                        let nudged = Connects { distance, roughness, ..connects };
                        let mut shift = PathShift::new(&AcceptAll, nudged, None);
                        shift.shift(&there.sample, to, from).is_some()
                    });
                    counts[1 + usize::from(!nudged)].fetch_add(1, Relaxed);
                    continue;
                };
                let product = (back.jacobian * there.jacobian - 1.0).abs();
                assert!(product < 2e-4, "{product}: {own:?} {there:?} {back:?}");
                let error = (back.integrand - own.integrand).abs().max_element();
                assert!(error <= 1e-5 * own.integrand.max_element(), "{own:?} {back:?}");
            }
        };
        for chunk in 0.. {
            (0..60_000_u32).into_par_iter().for_each(|place| one(chunk * 60_000 + place));
            if !(0..9).any(wanted) {
                break;
            }
        }
        for (name, counts) in CASES.iter().zip(&counts) {
            let [found, flips, lost] = counts.each_ref().map(|count| count.load(Relaxed));
            println!("{predicate:?}, {name}: {found} shifts, {flips} flips, {lost} lost");
            assert!(lost == 0 && flips * 1_000_000 < found, "{name}");
        }
    }
}
