//! The same bits for any number of threads and for any repetition; other bits for another run.

use std::sync::Arc;

use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{Curve, Interpolation, LightKind, Scene, Track, Transform};
use afterimage::techniques::{Entry, REGISTRY};
use glam::{Affine3A, Quat, Vec3};
use rayon::ThreadPoolBuilder;

use crate::support::{bits, light, room};

const FRAMES: usize = 3;

fn slide(by: Vec3, base: Affine3A) -> Transform {
    Transform::Chain(vec![
        Track::Trs {
            translation: Curve {
                keys: vec![(0.0, Vec3::ZERO), (1.0, by)],
                interpolation: Interpolation::Linear,
            },
            rotation: Curve::constant(Quat::IDENTITY),
            scale: Curve::constant(Vec3::ONE),
        },
        Track::Fixed(base),
    ])
}

/// The room, still or with a camera, an object, a lamp and a point light that move.
fn scene(moving: bool) -> Scene {
    let mut scene = room();
    let intensity = Vec3::splat(0.5);
    light(&mut scene, LightKind::Point { intensity }, Affine3A::from_translation(Vec3::Y));
    if moving {
        scene.time = [0.0, 1.0];
        scene.camera.to_world = slide(Vec3::X * 0.5, scene.camera.to_world.fixed());
        scene.lights[0].to_world = slide(Vec3::Y * 0.5, scene.lights[0].to_world.fixed());
        // A ball, and the sphere that is a lamp.
        for instance in [5, 9] {
            scene.instances[instance].to_world = slide(Vec3::Z * -0.25, Affine3A::IDENTITY);
        }
    }
    scene
}

type Run = Vec<(Vec<[u32; 3]>, Vec<[u32; 3]>, Counters)>;

fn frames(frame_loop: &mut FrameLoop) -> Run {
    (0..FRAMES)
        .map(|_| {
            let frame = frame_loop.render().unwrap();
            (bits(&frame.picture()), bits(&frame.emission()), frame.counters)
        })
        .collect()
}

fn start(stage: &Stage, entry: &Entry, shot: Shot) -> FrameLoop {
    FrameLoop::new(Arc::from(entry.parse("").unwrap()), stage, shot).unwrap()
}

fn shots() -> Vec<Shot> {
    let mut all = Vec::new();
    for filter in [Filter::Point, Filter::Box] {
        for size in [[1, 1], [17, 23], [64, 64]] {
            for effort in [1, 3] {
                all.push(Shot { size, depth: 4, filter, run: 5, effort: effort as f32, fps: 10 });
            }
        }
    }
    all
}

#[test]
fn one_two_and_64_threads_give_the_same_bits() {
    check_threads(REGISTRY);
}

/// Any number of threads gives the same bits.
pub(crate) fn check_threads(entries: &[Entry]) {
    let pools = [1, 2, 64].map(|n| ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for moving in [false, true] {
        let stage = Stage::new(scene(moving)).unwrap();
        assert_eq!(stage.facts().moves(), moving);
        for entry in entries {
            for shot in shots() {
                let [one, two, many] = pools
                    .each_ref()
                    .map(|pool| pool.install(|| frames(&mut start(&stage, entry, shot))));
                assert!(one == two && one == many, "{} {shot:?}", entry.name);
                let changes = one.windows(2).all(|pair| pair[0].0 != pair[1].0);
                assert!(changes || shot.size == [1, 1], "{} repeats a frame", entry.name);
            }
        }
    }
}

#[test]
fn a_seed_repeats_and_another_does_not() {
    check_seeds(REGISTRY);
}

/// A run repeats bit by bit, and another does not.
pub(crate) fn check_seeds(entries: &[Entry]) {
    for moving in [false, true] {
        let stage = Stage::new(scene(moving)).unwrap();
        for entry in entries {
            for shot in shots() {
                let mut frame_loop = start(&stage, entry, shot);
                let first = frames(&mut frame_loop);
                assert_eq!(first, frames(&mut start(&stage, entry, shot)));
                frame_loop.restart(shot.run + 1);
                let other = frames(&mut frame_loop);
                if shot.size == [64, 64] {
                    // Paths that end at once are black in every run; the others differ.
                    for (a, b) in first.iter().zip(&other) {
                        let same = a.0.iter().zip(&b.0).filter(|(a, b)| a == b).count();
                        let black = a.0.iter().filter(|p| **p == [0; 3]).count();
                        assert!(
                            same <= black,
                            "{}: {same} pixels repeat, {black} black",
                            entry.name
                        );
                    }
                }
                frame_loop.restart(shot.run);
                assert_eq!(first, frames(&mut frame_loop), "after a restart");
            }
        }
    }
}
