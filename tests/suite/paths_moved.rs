//! Paths between two frames whose lights and surfaces have moved.

use std::sync::Arc;

use afterimage::accel::AcceptAll;
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::rng::{Stream, path_seed};
use afterimage::path::Vertex;
use afterimage::plan::{Filter, Shot};
use afterimage::resampling::{Family, ShiftMap, Shifted};
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{
    Anchor, Failure, NO_LOBE, PathReceiver, PathSample, PathShift, Place,
};
use afterimage::scene::{LightKind, Scene, Transform};
use afterimage::techniques::{Technique, parse};
use afterimage::world::{Motion, World};
use glam::{Affine3A, Quat, Vec3};

use crate::course::{Course, Look, assert_unbiased};
use crate::paths::{Bugged, CONNECTS, Draw, drawn, merged_against_traced, receivers_at, rooms};
use crate::paths_mutated::drawn_and_moved;
use crate::support::{light, look_at, shot};

const SIZE: [u32; 2] = [24, 16];

/// The numbers of `room`'s instances; the walls before this one are the floor and the ceiling.
const BACK_WALL: usize = 2;
const GLOSSY_BALL: usize = 5;
const LAMP: usize = 8;
const LAMP_BALL: usize = 9;

fn place(scene: &mut Scene, instance: usize, to_world: Affine3A) {
    scene.instances[instance].to_world = Transform::Fixed(to_world);
}

/// The next frame of a room: surfaces have moved, turned and grown, one is gone and one has come,
/// a light stands before the others in the table, and others are brighter.
fn moved(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    place(&mut scene, GLOSSY_BALL, Affine3A::from_translation(Vec3::new(0.05, 0.0, -0.1)));
    let turn = Quat::from_rotation_z(0.05);
    let grow = Affine3A::from_scale_rotation_translation(
        Vec3::new(1.4, 1.0, 1.2),
        turn,
        Vec3::new(0.1, -0.05, 0.0),
    );
    place(&mut scene, LAMP, grow);
    let wall = Affine3A::from_scale_rotation_translation(
        Vec3::new(1.3, 1.2, 1.0),
        Quat::IDENTITY,
        Vec3::new(0.0, -0.1, -0.05),
    );
    place(&mut scene, BACK_WALL, wall);
    // Gone under its key.
    scene.instances[LAMP_BALL].key = 1 << 40;
    scene
}

/// Both frames' worlds of a room, and what leads from one to the other.
fn frames(before: &Scene, now: &Scene) -> (Stage, Stage, Motion) {
    let stages = [before, now].map(|scene| Stage::new(scene.clone()).unwrap());
    let [before, now] = stages;
    let motion = Motion::new(before.first_world(), now.first_world(), SIZE);
    (before, now, motion)
}

fn pairs() -> Vec<(Scene, Scene)> {
    rooms()
        .into_iter()
        .map(|scene| {
            let mut now = moved(&scene);
            let place = Affine3A::from_translation(Vec3::new(-0.5, 1.0, -0.8));
            light(&mut now, LightKind::Point { intensity: Vec3::splat(0.2) }, place);
            // The new light comes first, so every other one has another number.
            let last = now.lights.len() - 1;
            now.lights.swap(0, last);
            (scene, now)
        })
        .collect()
}

/// Where nothing has moved, what is traced again is what was kept, to the bit; of paths that were
/// mutated, to rounding.
#[test]
fn what_is_traced_again_in_the_same_world_is_the_same() {
    let (mut same, mut behind, mut worst) = (0, 0, 0.0_f32);
    for (scene, mutable) in
        rooms().into_iter().flat_map(|scene| [(scene.clone(), false), (scene, true)])
    {
        let draw: Draw = if mutable { drawn_and_moved } else { drawn };
        let (before, now, motion) = frames(&scene, &scene);
        let [before, now] = [&before, &now].map(|stage| stage.first_world());
        let sources = receivers_at(before, Time::Before);
        let all = receivers_at(now, Time::Now);
        let mut random = Stream::from_key(21);
        let make = |again| {
            let map = PathShift::new(&AcceptAll, CONNECTS, Some(&motion));
            map.retracing(again).mutable(mutable)
        };
        let [mut copies, mut traces] = [make(false), make(true)];
        for (pixel, from) in sources.iter().enumerate() {
            for walk in 0..16 {
                let seed = path_seed(21, pixel as u32, 0, walk);
                let Some(sample) = draw(before, from, seed, &mut random).sample else { continue };
                let to = &all[(pixel + walk as usize % 3) % all.len()];
                let [copied, traced] =
                    [&mut copies, &mut traces].map(|map| map.try_shift(&sample, from, to));
                let (Ok(copied), Ok(traced)) = (copied, traced) else {
                    // What fails for several reasons says the one that is asked first.
                    assert_eq!(copied.is_err(), traced.is_err(), "{sample:?}");
                    continue;
                };
                if mutable {
                    // Directions that lead to a vertex again differ by rounding.
                    let error = copied.integrand / traced.integrand - 1.0;
                    worst = worst.max(error.abs().max_element());
                    worst = worst.max((copied.jacobian / traced.jacobian - 1.0).abs());
                } else {
                    assert_eq!(copied.sample, traced.sample);
                    assert_eq!(copied.jacobian.to_bits(), traced.jacobian.to_bits());
                }
                same += 1;
                let kept = sample.reconnection;
                behind += u32::from(kept.is_some_and(|kept| kept.vertex <= sample.last));
            }
        }
        let rays = [copies, traces].map(|map| map.counters.bounce_rays);
        assert!(rays[1] > rays[0], "{rays:?}");
    }
    println!("mutated paths: {worst:e}");
    assert!(same > 6000 && behind > 2000, "{same} shifts, {behind} with something behind");
    assert!(worst < 1e-3, "{worst}");
}

/// T and its inverse between the frames.
#[test]
fn round_trips_between_frames() {
    let mut work = Counters::default();
    let (mut defined, mut lost, mut grown, mut worst) = (0, 0, 0, 0.0_f32);
    let pairs = pairs().into_iter().flat_map(|pair| [(pair.clone(), false), (pair, true)]);
    for ((before, now), mutable) in pairs {
        let draw: Draw = if mutable { drawn_and_moved } else { drawn };
        let (before, now, motion) = frames(&before, &now);
        let worlds = [&before, &now].map(|stage| stage.first_world());
        let times = [Time::Before, Time::Now];
        let all = [0, 1].map(|at| receivers_at(worlds[at], times[at]));
        let mut random = Stream::from_key(22);
        let mut shift =
            PathShift::new(&AcceptAll, CONNECTS, Some(&motion)).retracing(true).mutable(mutable);
        for (source, there) in [(0, 1), (1, 0)] {
            for (pixel, from) in all[source].iter().enumerate() {
                for walk in 0..24 {
                    let seed = path_seed(22, pixel as u32, 0, walk);
                    let drawn = draw(worlds[source], from, seed, &mut random);
                    let Some(sample) = drawn.sample else { continue };
                    let Ok(own) = shift.try_shift(&sample, from, from) else { continue };
                    let to =
                        &all[there][(pixel + [0, 1, 24][walk as usize % 3]) % all[there].len()];
                    let Some(shifted) = shift.shift(&own.sample, from, to) else { continue };
                    defined += 1;
                    assert_eq!(shift.stratum(&shifted.sample), shift.stratum(&sample));
                    let Some(back) = shift.shift(&shifted.sample, to, from) else {
                        lost += 1;
                        continue;
                    };
                    let product = (back.jacobian * shifted.jacobian - 1.0).abs();
                    worst = worst.max(product);
                    // Of a mutated path a ray finds the next vertex again, to rounding.
                    let exact = if mutable { 100.0 } else { 1.0 };
                    assert!(product < 1e-4 * exact, "{product}: {own:?} {shifted:?} {back:?}");
                    let error = (back.integrand - own.integrand).abs().max_element();
                    let most = own.integrand.max_element() * exact;
                    assert!(error <= 1e-5 * most, "{own:?} {shifted:?} {back:?}");
                    grown += u32::from((shifted.jacobian - 1.0).abs() > 0.1);
                }
            }
        }
        work = work + shift.counters;
    }
    println!("{defined} defined, {lost} lost, worst {worst:e}, {grown} grown, {work:?}");
    assert_eq!(lost, 0);
    assert!(defined > 3000 && grown > 300, "{defined} defined, {grown} grown");
    for reason in [Failure::ObjectGone, Failure::LightGone, Failure::Length, Failure::Occluded] {
        assert!(*reason.counter(&mut work) > 0, "{reason:?}: {work:?}");
    }
}

/// What the direction that a mutable path keeps at `v_{r+1}`, or the point on a light that it keeps
/// at `v_r`, is worth: its density there. 1 where nothing of the kind is kept.
fn worth(world: &World, sample: &PathSample) -> f64 {
    let kept = sample.reconnection.unwrap();
    let Anchor::Surface(hit) = kept.anchor else { return 1.0 };
    match kept.next.place() {
        Some(Place::Light(point)) => {
            let from = world.surface(&hit).position;
            let emitter = world.lights.emitter(&world.scene, point).unwrap();
            let geometry = emitter.towards(&world.lights, from).unwrap().geometry;
            f64::from(world.lights.density_towards(point, from, geometry))
                * f64::from(world.lights.measure(point))
        }
        Some(Place::Surface(next)) if kept.vertex < sample.last && kept.next.lobe() != NO_LOBE => {
            let point = world.accel.point(&next);
            let vertex = Vertex::new(world, &next, &point, kept.direction).unwrap();
            let lobe = u32::from(kept.next.lobe());
            if vertex.surface.bsdf.lobe_roughness(lobe) < CONNECTS.roughness {
                return 1.0;
            }
            let wi = vertex.surface.frame.to_local(kept.next.direction());
            f64::from(vertex.surface.bsdf.evaluate_lobe(lobe, vertex.outgoing, wi).pdf)
        }
        _ => 1.0,
    }
}

/// What a path keeps behind `x_r` where paths are mutated enters |∂T| with the ratio of its
/// densities, whether the path was mutated or not.
#[test]
fn what_is_kept_counts_by_its_density() {
    let (mut lights, mut turns, mut worst) = (0, 0, 0.0_f64);
    for (before, now) in pairs() {
        let (before, now, motion) = frames(&before, &now);
        let worlds = [&before, &now].map(|stage| stage.first_world());
        let (sources, all) =
            (receivers_at(worlds[0], Time::Before), receivers_at(worlds[1], Time::Now));
        let mut random = Stream::from_key(23);
        let mut shift =
            PathShift::new(&AcceptAll, CONNECTS, Some(&motion)).retracing(true).mutable(true);
        for (pixel, from) in sources.iter().enumerate() {
            for walk in 0..48 {
                let seed = path_seed(23, pixel as u32, 0, walk);
                let drawn = drawn_and_moved(worlds[0], from, seed, &mut random);
                let Some(sample) = drawn.sample else { continue };
                let to = &all[(pixel + [0, 1, 24][walk as usize % 3]) % all.len()];
                let Some(shifted) = shift.shift(&sample, from, to) else { continue };
                let kept = sample.reconnection.filter(|kept| kept.vertex <= sample.last);
                let Some(kept) = kept else { continue };
                let Anchor::Surface(hit) = kept.anchor else { continue };
                // The ratio of areas is another test's.
                let there = motion.current_instance(hit.instance).unwrap();
                let placed =
                    |world: &World, at: u32| world.scene.instances[at as usize].to_world.fixed();
                if placed(worlds[0], hit.instance) != placed(worlds[1], there) {
                    continue;
                }
                let densities = shifted.sample.reconnection.unwrap().density / kept.density;
                let found = f64::from(shifted.jacobian) / f64::from(densities);
                let ratio = worth(worlds[1], &shifted.sample) / worth(worlds[0], &sample);
                worst = worst.max((found / ratio - 1.0).abs());
                assert!((found / ratio - 1.0).abs() < 1e-3, "{found}, {ratio}: {sample:?}");
                let by_light = matches!(kept.next.place(), Some(Place::Light(_)));
                let counts = if by_light { &mut lights } else { &mut turns };
                *counts += u32::from((ratio - 1.0).abs() > 0.01);
            }
        }
    }
    println!("{lights} points and {turns} directions whose density changes, worst {worst:e}");
    assert!(lights > 50 && turns > 50, "{lights} points, {turns} directions");
}

/// What a pixel shows that merges the path of the previous frame is what its own paths show: with
/// another world's light behind the connection, or without the ratio of areas, it is not.
#[test]
fn merges_with_the_previous_frame_are_unbiased() {
    let (before, now) = pairs().swap_remove(0);
    let mut stretched = before.clone();
    let wide = Affine3A::from_scale(Vec3::new(2.5, 1.0, 1.0));
    (0..=BACK_WALL).for_each(|wall| place(&mut stretched, wall, wide));
    type Bug = fn(&mut Shifted<PathSample, Vec3>, &PathReceiver<'_>);
    let run_with = |before: &Scene, now: &Scene, again, bug: Bug, draw: Draw, mutable| {
        let (before, now, motion) = frames(before, now);
        let map = PathShift::new(&AcceptAll, CONNECTS, Some(&motion));
        let map = map.retracing(again).mutable(mutable);
        let worlds = [&before, &now].map(|stage| stage.first_world());
        let here: Vec<_> = receivers_at(worlds[1], Time::Now).into_iter().step_by(7).collect();
        let there = receivers_at(worlds[0], Time::Before);
        // Nearby.
        let past: Vec<_> = (0..here.len()).map(|at| there[(7 * at + 1) % there.len()]).collect();
        let both = (here.as_slice(), past.as_slice());
        merged_against_traced(&mut Bugged(map, bug), both, Family::Balance, 2400, draw)
    };
    let run = |before: &Scene, now: &Scene, again, bug: Bug| {
        run_with(before, now, again, bug, drawn, false)
    };
    for (name, other) in [("moved", &now), ("stretched", &stretched)] {
        let (t, bias) = run(&before, other, true, |_, _| ());
        println!("{name}: t {t:.2}, bias {:.3} %", 100.0 * bias);
        assert!(t.abs() < 4.5, "{name}: t {t}, bias {bias}");
        let (t, bias) = run_with(&before, other, true, |_, _| (), drawn_and_moved, true);
        println!("{name}, mutated: t {t:.2}, bias {:.3} %", 100.0 * bias);
        assert!(t.abs() < 4.5, "{name}, mutated: t {t}, bias {bias}");
    }
    let (t, bias) = run(&before, &now, false, |_, _| ());
    println!("light of the other world: t {t:.2}, bias {:.3} %", 100.0 * bias);
    assert!(t.abs() > 4.5, "the control must fail: t {t}, bias {bias}");
    let (t, bias) = run(&before, &stretched, true, |shifted, to| {
        let anchor = shifted.sample.reconnection.map(|kept| kept.anchor);
        if let Some(Anchor::Surface(hit)) = anchor
            && hit.instance as usize <= BACK_WALL
        {
            shifted.jacobian /= if to.time == Time::Now { 2.5 } else { 1.0 / 2.5 };
        }
    });
    println!("without the ratio of areas: t {t:.2}, bias {:.3} %", 100.0 * bias);
    assert!(t.abs() > 4.5, "the control must fail: t {t}, bias {bias}");
}

/// What moves in a course.
fn camera(scene: &mut Scene, i: u32) {
    let t = 0.08 * i as f32;
    scene.camera = look_at(Vec3::new(t, 1.0 + 0.5 * t, -3.0), Vec3::new(0.5 * t, 1.0, 0.0), 0.75);
}

fn lamps(scene: &mut Scene, i: u32) {
    let t = 0.06 * i as f32;
    let grow = Vec3::new(1.0 + 2.0 * t, 1.0, 1.0 + t);
    let by = Vec3::new(t, -0.5 * t, 0.0);
    place(scene, LAMP, Affine3A::from_scale_rotation_translation(grow, Quat::IDENTITY, by));
    place(scene, LAMP_BALL, Affine3A::from_translation(Vec3::new(-2.0 * t, 0.0, -t)));
}

fn surfaces(scene: &mut Scene, i: u32) {
    let t = 0.08 * i as f32;
    place(scene, GLOSSY_BALL, Affine3A::from_translation(Vec3::new(t, 0.5 * t, -t)));
    let turn = Quat::from_rotation_x(0.2 * t);
    let wide = Vec3::new(1.0 + t, 1.0, 1.0);
    let by = Vec3::new(0.0, 0.0, -t);
    place(scene, BACK_WALL, Affine3A::from_scale_rotation_translation(wide, turn, by));
}

/// All paths of a room with glossy, smooth and clear things in it, while the camera, lamps or
/// surfaces move and grow: the whole and both halves of the picture, in later frames, by every kind
/// of shading and of direct light.
#[test]
fn paths_are_unbiased_while_anything_moves() {
    let all: fn(&mut Scene, u32) = |scene, i| {
        camera(scene, i);
        lamps(scene, i);
        surfaces(scene, i);
    };
    let near = "neighbours=2,radius=4,taps=random";
    let tree = "direct=tree,shade=selected,trees=2";
    let separate = "direct=separate,taps=pairs,neighbours=2,radius=4";
    let mutated = "mutations=5,neighbours=2,radius=4";
    type Row<'a> = (&'a str, fn(&mut Scene, u32), Filter, &'a [&'a str]);
    let plan: [Row<'_>; 5] = [
        ("camera", camera, Filter::Point, &[near, tree]),
        ("camera, box", camera, Filter::Box, &["", separate, "mutations=1"]),
        ("lamps", lamps, Filter::Point, &["neighbours=0"]),
        ("surfaces", surfaces, Filter::Point, &["neighbours=0,direct=tree,shade=selected"]),
        (
            "all",
            all,
            Filter::Point,
            &["", near, tree, "shade=decoupled,mis=balance,shift=reconnection", mutated],
        ),
    ];
    const DELTA: f64 = 0.03;
    for (name, at, filter, specs) in plan {
        let course = Course { base: rooms()[2].clone(), at };
        let shot = Shot { filter, ..shot([18, 12], 4, 1) };
        let stage = course.stage();
        let looks: Vec<Look> = [1, 3].iter().flat_map(|age| halves(&course, shot, *age)).collect();
        for keys in specs {
            let technique: Arc<dyn Technique> =
                Arc::from(parse(&format!("restir-pt:{keys}")).unwrap());
            println!("{name}");
            assert_unbiased((&course, &stage), &technique, shot, &looks, DELTA);
        }
    }
}

/// The whole picture of a frame and its halves, by `nee`.
pub(crate) fn halves(course: &Course, shot: Shot, age: u32) -> Vec<Look> {
    let stage = Stage::new(course.frame(age)).unwrap();
    let technique: Arc<dyn Technique> = Arc::from(parse("nee").unwrap());
    let shot = Shot { effort: 6_000.0, run: 1 << 50, ..shot };
    let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
    let truth = frames.render().unwrap().picture().pixels;
    let inside: [fn(u32) -> bool; 3] = [|_| true, |x| x < 9, |x| x >= 9];
    inside
        .map(|inside| {
            let region = (0..shot.pixels() as u32).map(|at| inside(at % shot.size[0])).collect();
            Look { age, region, truth: truth.clone() }
        })
        .into()
}
