//! Paths as samples, on one core: `shift/KIND`, a shift to a neighbour by what it connects to;
//! `tree/SCENE`, a walk whose paths are all candidates, against `walk/SCENE`, the same walk that
//! only sums; `merge/FAMILY/K`, merges of a pixel's path with those of K neighbours;
//! `mutation/KIND/N`, the begin of a chain and N steps by what follows the vertex that moves, and
//! `rays/KIND`, the bounce of such a step with its shadow ray.

use std::hint::black_box;
use std::path::Path;

use afterimage::accel::{AcceptAll, Ray};
use afterimage::counters::Counters;
use afterimage::frame::Stage;
use afterimage::math::rng::{Stream, path_seed};
use afterimage::path::{Limits, Steps, sampled, scattered_radiance, walk};
use afterimage::resampling::{
    Family, Finished, Input, Kelemen, Plain, PrimarySample, Reservoir, merge, metropolis,
};
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{
    Anchor, Connects, Ending, NO_LOBE, PathMutator, PathReceiver, PathSample, PathShift, Place,
    ShiftKind, Tree,
};
use afterimage::scene::load;
use afterimage::world::World;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec2, Vec3};

const SIZE: [u32; 2] = [64, 64];
const SCENES: [&str; 4] = ["cornell", "slit", "glass", "plates"];

fn stage(scene: &str) -> Stage {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(scene);
    let loaded = load::load(&path.with_extension("pbrt")).expect("our own scene loads");
    Stage::new(loaded.scene).expect("and builds")
}

/// The primary hits of all pixels that see something, row by row.
fn receivers(world: &World) -> Vec<PathReceiver<'_>> {
    let rays = world.scene.camera.rays(SIZE);
    let pixels = 0..SIZE[0] * SIZE[1];
    let found = pixels.filter_map(|pixel| {
        let at = Vec2::new((pixel % SIZE[0]) as f32, (pixel / SIZE[0]) as f32) + 0.5;
        let ray = rays.ray(at);
        let (origin, direction) = (ray.origin, ray.direction);
        let hit = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY })?;
        Some(PathReceiver { world, time: Time::Now, direction, hit })
    });
    found.collect()
}

const LIMITS: Limits = Limits { depth: 8, roulette_after: 5 };

/// The path of one walk.
fn drawn<const MUTABLE: bool>(
    at: &PathReceiver<'_>,
    connects: Connects,
    seed: u64,
    random: &mut Stream,
) -> Finished<PathSample, PrimarySample> {
    let mut reservoir = Plain::default();
    let mut tree = Tree::<_, MUTABLE>::new(at.world, connects, (seed, 1), &mut reservoir, random);
    let steps = Steps::<{ sampled::ONE }, _> { world: at.world, filter: &AcceptAll };
    let primary = (at.direction, &at.hit);
    walk::<_, true, _>(&steps, seed, primary, LIMITS, &mut tree, &mut Counters::default());
    let target = reservoir.selected().map_or(0.0, |sample: PathSample| sample.target());
    reservoir.finish(target, 1.0)
}

/// Names what a shift connects to.
fn kind(sample: &PathSample) -> &'static str {
    let Some(kept) = &sample.reconnection else { return "replay to the end" };
    let light = matches!(sample.ending, Ending::Light { .. });
    let at_once = kept.vertex == 1;
    match (kept.anchor, kept.vertex.cmp(&sample.last)) {
        (Anchor::Point(_), _) if at_once => "a light point",
        (Anchor::Point(_), _) => "replay to a light point",
        (Anchor::Sky { .. }, _) => "a sky",
        (Anchor::Surface(_), std::cmp::Ordering::Greater) => "an emitter",
        (Anchor::Surface(_), std::cmp::Ordering::Equal) if light => "before a light sample",
        (Anchor::Surface(_), std::cmp::Ordering::Equal) => "before an emitter or a sky",
        (Anchor::Surface(_), _) if at_once && kept.lobes[1] != NO_LOBE => "a surface",
        (Anchor::Surface(_), _) => "replay to a surface",
    }
}

fn shifts(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("shift");
    let stages = SCENES.map(stage);
    // Each sample stands with its own receiver and the one that it is shifted to.
    type Case<'w> = (&'static str, Connects, Vec<(PathSample, [PathReceiver<'w>; 2])>);
    let mut cases: Vec<Case<'_>> = Vec::new();
    for stage in &stages {
        let all = receivers(stage.first_world());
        let mut random = Stream::from_key(3);
        let connects = Connects::of_diagonal(stage.facts().diagonal);
        for (pixel, pair) in all.windows(2).enumerate() {
            let [from, to] = [pair[0], pair[1]];
            let sample =
                drawn::<false>(&from, connects, path_seed(1, pixel as u32, 0, 0), &mut random);
            let Some(sample) = sample.sample else { continue };
            let name = kind(&sample);
            let known = cases.iter().position(|(known, one, _)| *known == name && *one == connects);
            let at = known.unwrap_or_else(|| {
                cases.push((name, connects, Vec::new()));
                cases.len() - 1
            });
            cases[at].2.push((sample, [from, to]));
        }
    }
    // Each kind is measured in the scene that has most of it.
    cases.sort_by_key(|(_, _, samples)| std::cmp::Reverse(samples.len()));
    let mut done: Vec<&str> = Vec::new();
    for (name, connects, samples) in &cases {
        if done.contains(name) || samples.len() < 50 {
            continue;
        }
        done.push(name);
        let samples = &samples[..samples.len().min(500)];
        group.throughput(Throughput::Elements(samples.len() as u64));
        group.bench_function(*name, |bencher| {
            let mut shift = PathShift::new(&AcceptAll, *connects, None);
            bencher.iter(|| {
                for (sample, [from, to]) in samples {
                    black_box(shift.try_shift(black_box(sample), from, to).is_ok());
                }
            });
        });
    }
    group.finish();
}

fn trees(criterion: &mut Criterion) {
    for scene in SCENES {
        let stage = stage(scene);
        let (world, diagonal) = (stage.first_world(), stage.facts().diagonal);
        let all = receivers(world);
        let connects = Connects::of_diagonal(diagonal);
        let seed = |pixel: usize| path_seed(2, pixel as u32, 0, 0);
        let count = Throughput::Elements(all.len() as u64);
        let mut group = criterion.benchmark_group("tree");
        group.throughput(count.clone()).sample_size(20);
        group.bench_function(scene, |bencher| {
            let mut random = Stream::from_key(4);
            bencher.iter(|| {
                for (pixel, at) in all.iter().enumerate() {
                    black_box(drawn::<false>(at, connects, seed(pixel), &mut random));
                }
            });
        });
        group.finish();
        let mut group = criterion.benchmark_group("walk");
        group.throughput(count).sample_size(20);
        group.bench_function(scene, |bencher| {
            let mut counters = Counters::default();
            bencher.iter(|| {
                for (pixel, at) in all.iter().enumerate() {
                    let primary = (at.direction, &at.hit);
                    black_box(scattered_radiance::<{ sampled::ONE }, _>(
                        world,
                        &AcceptAll,
                        seed(pixel),
                        primary,
                        LIMITS,
                        &mut counters,
                    ));
                }
            });
        });
        group.finish();
    }
}

fn merges(criterion: &mut Criterion) {
    let stage = stage("cornell");
    let all = receivers(stage.first_world());
    let connects = Connects::new(0.01 * stage.facts().diagonal, ShiftKind::Hybrid);
    let mut random = Stream::from_key(5);
    let finished: Vec<_> = (0..all.len())
        .map(|pixel| {
            let seed = path_seed(6, pixel as u32, 0, 0);
            drawn::<false>(&all[pixel], connects, seed, &mut random)
        })
        .collect();
    let input = |at: usize| Input {
        finished: finished[at],
        target: finished[at].sample.map_or(0.0, |sample| sample.target()),
        domain: &all[at],
    };
    let pixels: Vec<usize> = (0..all.len() - 8).step_by(7).collect();
    let mut group = criterion.benchmark_group("merge");
    group.throughput(Throughput::Elements(pixels.len() as u64)).sample_size(20);
    for family in [Family::Constant, Family::DefensivePairwise, Family::Balance] {
        for neighbours in [1, 3] {
            group.bench_function(format!("{}/{neighbours}", family.name()), |bencher| {
                let mut shift = PathShift::new(&AcceptAll, connects, None);
                bencher.iter(|| {
                    for &pixel in &pixels {
                        let others: Vec<_> =
                            (1..=neighbours).map(|step| input(pixel + 2 * step)).collect();
                        let (own, others) = (input(pixel), others.as_slice());
                        let mut reservoir = Plain::default();
                        let random = &mut random;
                        let out =
                            merge(&mut shift, family, &own, others, &mut reservoir, random, |_| ());
                        black_box(out.target);
                    }
                });
            });
        }
    }
    group.finish();
}

/// Names what follows the vertex that a mutation moves.
fn follows(sample: &PathSample) -> Option<&'static str> {
    let kept = sample.reconnection?;
    Some(match (kept.anchor, kept.next.place()) {
        (Anchor::Point(_), _) => "a light point",
        (Anchor::Sky { .. }, _) => "a sky",
        (Anchor::Surface(_), _) if kept.vertex > sample.last => "an emitter",
        (Anchor::Surface(_), None) => return None,
        (Anchor::Surface(_), Some(Place::Light(_))) => "before a light sample",
        (Anchor::Surface(_), _) if kept.vertex == sample.last => "before an emitter or a sky",
        (Anchor::Surface(_), _) if kept.next.lobe() == NO_LOBE => {
            "before a vertex that samples a light"
        }
        (Anchor::Surface(_), _) => "before a vertex",
    })
}

fn mutations(criterion: &mut Criterion) {
    let stages = SCENES.map(stage);
    type Case<'w> = (&'static str, Connects, Vec<(PathSample, PathReceiver<'w>)>);
    let mut cases: Vec<Case<'_>> = Vec::new();
    for stage in &stages {
        let mut random = Stream::from_key(7);
        let connects = Connects::of_diagonal(stage.facts().diagonal);
        for (pixel, at) in receivers(stage.first_world()).into_iter().enumerate() {
            let seed = path_seed(7, pixel as u32, 0, 0);
            let sample = drawn::<true>(&at, connects, seed, &mut random).sample;
            let Some(sample) = sample.filter(|s| s.reconnection.is_some_and(|k| k.vertex == 1))
            else {
                continue;
            };
            let Some(name) = follows(&sample) else { continue };
            let known = cases.iter().position(|(known, one, _)| *known == name && *one == connects);
            let place = known.unwrap_or_else(|| {
                cases.push((name, connects, Vec::new()));
                cases.len() - 1
            });
            cases[place].2.push((sample, at));
        }
    }
    // Each kind is measured in the scene that has most of it.
    cases.sort_by_key(|(_, _, samples)| std::cmp::Reverse(samples.len()));
    let mut done: Vec<&str> = Vec::new();
    for (name, connects, samples) in &cases {
        if done.contains(name) || samples.len() < 50 {
            continue;
        }
        done.push(name);
        let samples = &samples[..samples.len().min(500)];
        let mut group = criterion.benchmark_group("mutation");
        group.throughput(Throughput::Elements(samples.len() as u64)).sample_size(20);
        for steps in [0, 1, 5] {
            group.bench_function(format!("{name}/{steps}"), |bencher| {
                let mut shift = PathShift::new(&AcceptAll, *connects, None);
                let mut random = Stream::from_key(8);
                bencher.iter(|| {
                    for (sample, at) in samples {
                        let begun = PathMutator::<_, Kelemen>::new(&mut shift, at, sample);
                        black_box(begun.map(|(mut mutator, state)| {
                            metropolis(&mut mutator, state, steps, &mut random).accepted
                        }));
                    }
                });
            });
        }
        group.finish();
        // The same rays without all else: to the vertex, and from it to a point above.
        let mut group = criterion.benchmark_group("rays");
        group.throughput(Throughput::Elements(samples.len() as u64)).sample_size(20);
        let rays: Vec<[Ray; 2]> = samples
            .iter()
            .filter_map(|(sample, at)| {
                let world = at.world;
                let kept = sample.reconnection?;
                let from = world.surface(&at.hit).position;
                let to = match kept.anchor {
                    Anchor::Surface(hit) => world.accel.point(&hit).position,
                    Anchor::Sky { .. } => from + kept.direction,
                    Anchor::Point(point) => {
                        let emitter = world.lights.emitter(&world.scene, point)?;
                        from + emitter.towards(&world.lights, from)?.direction
                    }
                };
                let there = match kept.next.place() {
                    Some(Place::Surface(hit)) => world.accel.point(&hit).position,
                    _ => to + kept.direction,
                };
                let ray = |origin: Vec3, end: Vec3, t_max| Ray {
                    origin: origin + 1e-3 * (end - origin),
                    direction: (end - origin).normalize_or(Vec3::Y),
                    t_max,
                };
                let length = 0.998 * there.distance(to);
                Some([ray(from, to, f32::INFINITY), ray(to, there, length)])
            })
            .collect();
        let world = samples[0].1.world;
        group.bench_function(*name, |bencher| {
            bencher.iter(|| {
                for [first, second] in &rays {
                    black_box(world.closest_hit(black_box(first)));
                    black_box(world.accel.occluded(black_box(second), &AcceptAll));
                }
            });
        });
        group.finish();
    }
}

criterion_group!(benches, shifts, trees, merges, mutations);
criterion_main!(benches);
