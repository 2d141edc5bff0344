//! Paths as samples: does the tree of one walk hold what its path tracer shows?

use afterimage::accel::{AcceptAll, Ray};
use afterimage::counters::Counters;
use afterimage::frame::Stage;
use afterimage::light::LightPoint;
use afterimage::math::luminance;
use afterimage::math::rng::{Stream, path_seed};
use afterimage::path::{Limits, Steps, sampled, scattered_radiance, walk};
use afterimage::resampling::{
    Family, Finished, Input, Plain, PrimarySample, Reservoir, ShiftMap, Shifted, merge,
};
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{
    Anchor, Connects, Ending, Failure, NO_LOBE, PathReceiver, PathSample, PathShift, Predicate,
    ShiftKind, Tree,
};
use afterimage::scene::{LightKind, Scene};
use afterimage::stats::{Moments, t_test};
use afterimage::world::World;
use glam::{Affine3A, Vec2, Vec3};

use afterimage::plan::Shot;

use crate::support::{bits, environment, light, own_scenes, picture, room, shot};

const SIZE: [u32; 2] = [24, 16];

/// Rooms with a sky, a point light, or neither.
pub(crate) fn rooms() -> [Scene; 3] {
    let mut sky = room();
    environment(&mut sky, Vec3::new(0.3, 0.4, 0.5));
    let mut point = room();
    let place = Affine3A::from_translation(Vec3::new(0.2, 1.5, -0.4));
    light(&mut point, LightKind::Point { intensity: Vec3::splat(0.5) }, place);
    [room(), sky, point]
}

/// Calls `each` with the walk's seed and the primary hit of every pixel.
fn pixels(world: &World, mut each: impl FnMut(u64, (Vec3, &afterimage::accel::Hit))) {
    let rays = world.scene.camera.rays(SIZE);
    for pixel in 0..SIZE[0] * SIZE[1] {
        let at = Vec2::new((pixel % SIZE[0]) as f32, (pixel / SIZE[0]) as f32) + 0.5;
        let ray = rays.ray(at);
        let (origin, direction) = (ray.origin, ray.direction);
        if let Some(hit) = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }) {
            for walk in 0..4 {
                each(path_seed(11, pixel, 0, walk), (direction, &hit));
            }
        }
    }
}

/// The tree's sum is what the path tracer shows of the same seed, bit for bit, with roulette at
/// once or never; what the reservoir selected shows its luminance to rounding.
#[test]
fn the_tree_sums_to_nee() {
    for scene in rooms() {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        for roulette_after in [0, 5] {
            let limits = Limits { depth: 9, roulette_after };
            let mut random = Stream::from_key(5);
            let (mut lit, mut dark) = (0, 0);
            pixels(world, |seed, primary| {
                let mut counters = [Counters::default(); 2];
                let shown = scattered_radiance::<{ sampled::ONE }, _>(
                    world,
                    &AcceptAll,
                    seed,
                    primary,
                    limits,
                    &mut counters[0],
                );
                let mut reservoir = Plain::default();
                let connects = Connects::of_diagonal(4.0);
                let how = (seed, 1);
                let mut tree =
                    Tree::<_, false>::new(world, connects, how, &mut reservoir, &mut random);
                let steps = Steps::<{ sampled::ONE }, _> { world, filter: &AcceptAll };
                walk::<_, true, _>(&steps, seed, primary, limits, &mut tree, &mut counters[1]);
                assert_eq!(
                    tree.sum.to_array().map(f32::to_bits),
                    shown.to_array().map(f32::to_bits)
                );
                assert_eq!(counters[0], counters[1]);
                let target = reservoir.selected().map_or(0.0, |sample: PathSample| sample.target());
                let finished = reservoir.finish::<PrimarySample>(target, 1.0);
                let estimate = target * finished.weight.get();
                assert!((estimate - luminance(shown)).abs() <= 1e-5 * luminance(shown));
                if finished.sample.is_some() { lit += 1 } else { dark += 1 }
            });
            assert!(lit > 500 && dark > 0, "{lit} walks found light, {dark} none");
        }
    }
}

/// Without reuse the technique shows the sum of its walks, which is `nee` of the same seeds, up to
/// the rounding of estimates to 15 bits. The control, other numbers, is another picture.
#[test]
fn without_reuse_it_is_nee() {
    let stage = Stage::new(rooms()[1].clone()).unwrap();
    let keys = "cap=0,neighbours=0,direct=tree";
    for shot in [shot([24, 16], 6, 1), shot([16, 20], 4, 3)] {
        for roulette in [0, 5] {
            let nee = picture(&stage, &format!("nee:roulette={roulette}"), shot);
            let paths = picture(&stage, &format!("restir-pt:{keys},roulette={roulette}"), shot);
            assert!(nee.mean_luminance() > 0.0);
            for (nee, paths) in nee.pixels.iter().zip(&paths.pixels) {
                let error = (*nee - *paths).abs().max_element();
                assert!(error <= nee.max_element() / 32768.0, "{nee} {paths}");
            }
            let other = Shot { run: shot.run + 1, ..shot };
            let other = picture(&stage, &format!("restir-pt:{keys},roulette={roulette}"), other);
            assert_ne!(bits(&other), bits(&paths));
        }
    }
}

/// A path's numbers give the path again at its own receiver: the same F to the bit, ending and
/// length, in every scene of the repository; where the point of a light sample is kept in place of
/// its numbers, F to rounding. The control, numbers of another block, gives another path.
#[test]
fn replay_gives_the_path_again() {
    let connects = Connects { kind: ShiftKind::Replay, ..CONNECTS };
    let (mut same, mut near, mut other) = (0_u32, 0_u32, 0_u32);
    let mut scenes = own_scenes();
    scenes.extend(rooms().map(|room| ("a room".to_string(), room)));
    for (name, scene) in scenes {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(21);
        let mut shift = PathShift::new(&AcceptAll, connects, None);
        for (pixel, at) in receivers(world).iter().enumerate() {
            for walk in 0..4 {
                let seed = path_seed(22, pixel as u32, 0, walk);
                let drawn = drawn_by::<false>(world, at, seed, &mut random, connects);
                let Some(sample) = drawn.sample else { continue };
                let again = shift.try_shift(&sample, at, at);
                let Ok(Shifted { sample: again, jacobian, .. }) = again else {
                    panic!("{name}: {sample:?} {again:?}")
                };
                assert_eq!((again.last, jacobian), (sample.last, 1.0), "{name}: {sample:?}");
                assert_eq!(again.ending, sample.ending);
                if sample.reconnection.is_none() {
                    assert_eq!(again, sample, "{name}");
                    same += 1;
                } else {
                    let error = (again.integrand - sample.integrand).abs().max_element();
                    assert!(error <= 1e-3 * sample.integrand.max_element(), "{name}: {sample:?}");
                    near += 1;
                }
                let wrong = PathSample { seed: seed ^ 1 << 40, ..sample };
                let wrong = shift.try_shift(&wrong, at, at);
                let differs = wrong.is_ok_and(|wrong| wrong.sample.integrand == sample.integrand);
                other += u32::from(differs && sample.reconnection.is_none());
            }
        }
    }
    assert!(same > 1000 && near > 3000, "{same} to the bit, {near} to rounding");
    // Those that meet nothing but mirrors and glass have one way at each.
    assert!(other < same / 4, "{other} of {same} are the same by other numbers");
}

/// A path's reconnection is what its own vertices say: never the primary hit, no lobe behind a
/// light sample or an end, an anchor of the end's kind; every kind of ending and of anchor is met.
#[test]
fn reconnections_are_of_the_path_they_belong_to() {
    let mut met = [0; 8];
    for scene in rooms() {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(6);
        pixels(world, |seed, primary| {
            let limits = Limits { depth: 9, roulette_after: 5 };
            let mut reservoir = Plain::default();
            let connects = Connects::of_diagonal(4.0);
            let mut tree =
                Tree::<_, false>::new(world, connects, (seed, 1), &mut reservoir, &mut random);
            let steps = Steps::<{ sampled::ONE }, _> { world, filter: &AcceptAll };
            walk::<_, true, _>(&steps, seed, primary, limits, &mut tree, &mut Counters::default());
            let Some(sample): Option<PathSample> = reservoir.selected() else { return };
            assert!(sample.target() > 0.0 && sample.seed == seed && sample.last < 8);
            let Some(kept) = sample.reconnection else {
                assert!(!matches!(sample.ending, Ending::Light { .. }), "{sample:?}");
                met[7] += 1;
                return;
            };
            assert!(kept.vertex >= 1 && kept.vertex <= sample.last + 1);
            assert!(kept.density > 0.0);
            let (end, last) = (kept.vertex == sample.last + 1, kept.vertex == sample.last);
            // Towards a place that is the end, direction and light are others elsewhere.
            let kept_onward = !end || matches!(kept.anchor, Anchor::Sky { .. });
            assert_eq!(kept.radiance.max_element() > 0.0, kept_onward, "{sample:?}");
            let length = if kept_onward { 1.0 } else { 0.0 };
            assert!((kept.direction.length() - length).abs() < 1e-5);
            let kind = match (sample.ending, kept.anchor) {
                (_, Anchor::Surface(hit)) if !end => {
                    assert!(hit.t == 0.0 && (hit.instance as usize) < world.scene.instances.len());
                    let by_light = matches!(sample.ending, Ending::Light { .. });
                    assert_eq!(kept.lobes[1] == NO_LOBE, by_light && last);
                    assert_ne!(kept.lobes[0], NO_LOBE);
                    assert_eq!(kept.light_density > 0.0, last, "{sample:?}");
                    match (last, by_light) {
                        (false, _) => 0,
                        (true, true) => 1,
                        (true, false) => 2,
                    }
                }
                (Ending::Emitter, Anchor::Surface(hit)) => {
                    let at = world.accel.point(&hit);
                    assert!(world.lights.of_surface(at.shape, at.element) < 99, "{hit:?}");
                    3
                }
                (Ending::Sky { .. }, Anchor::Sky { light }) => {
                    assert!(world.lights.environments().any(|(sky, _)| sky == light));
                    4
                }
                (Ending::Light { delta }, Anchor::Point(LightPoint { light, .. })) => {
                    assert!((light as usize) < world.lights.len());
                    assert_eq!(kept.lobes, [NO_LOBE; 2]);
                    5 + usize::from(delta)
                }
                other => panic!("{other:?}"),
            };
            met[kind] += 1;
        });
    }
    assert!(met.iter().all(|count| *count > 10), "{met:?}");
}

/// What the tree of a seed selects at a primary hit, with W.
pub(crate) fn drawn(
    world: &World,
    receiver: &PathReceiver<'_>,
    seed: u64,
    random: &mut Stream,
) -> Finished<PathSample, PrimarySample> {
    drawn_by::<false>(world, receiver, seed, random, CONNECTS)
}

/// The same, by a rule of one's own, and with what mutations need if they are to come.
pub(crate) fn drawn_by<const MUTABLE: bool>(
    world: &World,
    receiver: &PathReceiver<'_>,
    seed: u64,
    random: &mut Stream,
    connects: Connects,
) -> Finished<PathSample, PrimarySample> {
    let mut reservoir = Plain::default();
    let mut tree = Tree::<_, MUTABLE>::new(world, connects, (seed, 1), &mut reservoir, random);
    let steps = Steps::<{ sampled::ONE }, _> { world, filter: &AcceptAll };
    let primary = (receiver.direction, &receiver.hit);
    let limits = Limits { depth: 7, roulette_after: 5 };
    walk::<_, true, _>(&steps, seed, primary, limits, &mut tree, &mut Counters::default());
    let target = reservoir.selected().map_or(0.0, |sample: PathSample| sample.target());
    reservoir.finish(target, 1.0)
}

pub(crate) const CONNECTS: Connects = Connects {
    distance: 0.05,
    roughness: Connects::ROUGHNESS,
    kind: ShiftKind::Hybrid,
    predicate: Predicate::Distance,
};

/// The receivers of all pixels that see a surface which scatters.
pub(crate) fn receivers(world: &World) -> Vec<PathReceiver<'_>> {
    receivers_at(world, Time::Now)
}

/// The same of one of two frames.
pub(crate) fn receivers_at(world: &World, time: Time) -> Vec<PathReceiver<'_>> {
    let rays = world.scene.camera.rays(SIZE);
    (0..SIZE[0] * SIZE[1])
        .filter_map(|pixel| {
            let at = Vec2::new((pixel % SIZE[0]) as f32, (pixel / SIZE[0]) as f32) + 0.5;
            let ray = rays.ray(at);
            let (origin, direction) = (ray.origin, ray.direction);
            let hit = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY })?;
            Some(PathReceiver { world, time, direction, hit })
        })
        .collect()
}

/// T to the same pixel is the path itself: to rounding of its directions for a fresh path, to the
/// bit for one that was shifted before.
#[test]
fn a_shift_to_itself() {
    let (mut off, mut all) = (0, 0);
    for scene in rooms() {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(8);
        let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
        for (pixel, at) in receivers(world).iter().enumerate() {
            for walk in 0..8 {
                let seed = path_seed(12, pixel as u32, 0, walk);
                let Some(sample) = drawn(world, at, seed, &mut random).sample else { continue };
                all += 1;
                let Ok(once) = shift.try_shift(&sample, at, at) else {
                    off += 1;
                    continue;
                };
                let error = (once.sample.target() / sample.target() - 1.0).abs();
                off += u32::from(error > 1e-3 || (once.jacobian - 1.0).abs() > 1e-3);
                let again = shift.try_shift(&once.sample, at, at).unwrap();
                assert_eq!(again.sample, once.sample);
                assert_eq!(again.jacobian, 1.0);
            }
        }
    }
    assert!(all > 5000 && f64::from(off) < 0.01 * f64::from(all), "{off} of {all} differ");
}

/// T and its inverse: where one is defined so is the other, the Jacobians multiply to 1, the path
/// is the path again, and its stratum stays. Every kind of anchor, of ending, and of failure that
/// stills scenes know is met.
#[test]
fn round_trips() {
    let mut met = [0_u32; 6];
    let mut work = Counters::default();
    let (mut defined, mut lost, mut worst) = (0, 0, 0.0_f32);
    for scene in rooms() {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(9);
        let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
        let all = receivers(world);
        for (pixel, from) in all.iter().enumerate() {
            for walk in 0..24 {
                let seed = path_seed(13, pixel as u32, 0, walk);
                let Some(sample) = drawn(world, from, seed, &mut random).sample else { continue };
                // Its own directions first, so that rounding is no part of what follows.
                let Ok(own) = shift.try_shift(&sample, from, from) else { continue };
                let step = [1, 2, 24, 25, 70][walk as usize % 5];
                let to = &all[(pixel + step) % all.len()];
                let Some(there) = shift.shift(&own.sample, from, to) else { continue };
                defined += 1;
                assert_eq!(shift.stratum(&there.sample), shift.stratum(&sample));
                assert_eq!(there.integrand, there.sample.integrand);
                let Some(back) = shift.shift(&there.sample, to, from) else {
                    lost += 1;
                    continue;
                };
                let product = (back.jacobian * there.jacobian - 1.0).abs();
                worst = worst.max(product);
                assert!(product < 1e-4, "{product}: {own:?} {there:?} {back:?}");
                let error = (back.integrand - own.integrand).abs().max_element();
                assert!(error <= 1e-5 * own.integrand.max_element(), "{own:?} {back:?}");
                let kind = match (sample.ending, sample.reconnection) {
                    (_, None) => 0,
                    (_, Some(kept)) if kept.vertex < sample.last => 1,
                    (Ending::Light { .. }, Some(kept)) if kept.vertex == sample.last => 2,
                    (_, Some(kept)) if kept.vertex == sample.last => 3,
                    (Ending::Light { .. }, _) => 4,
                    _ => 5,
                };
                met[kind] += 1;
            }
        }
        work = work + shift.counters;
    }
    println!("{defined} defined, {lost} lost, worst {worst:e}, kinds {met:?}, failures {work:?}");
    assert_eq!(lost, 0);
    assert!(met.iter().all(|count| *count > 10), "{met:?}");
    let still = [Failure::Replay, Failure::Earlier, Failure::Length, Failure::Lobe, Failure::Near];
    let more = [Failure::Back, Failure::Occluded];
    for reason in still.into_iter().chain(more) {
        assert!(*reason.counter(&mut work) > 0, "{reason:?}: {work:?}");
    }
}

/// A shift map with a planted bug, which knows the destination.
pub(crate) struct Bugged<'a>(
    pub(crate) PathShift<'a, AcceptAll>,
    pub(crate) fn(&mut Shifted<PathSample, Vec3>, &PathReceiver<'_>),
);

impl<'a> ShiftMap for Bugged<'a> {
    type Sample = PathSample;
    type Domain = PathReceiver<'a>;
    type Integrand = Vec3;
    type Stratum = ();

    fn shift(
        &mut self,
        sample: &PathSample,
        from: &PathReceiver<'a>,
        to: &PathReceiver<'a>,
    ) -> Option<Shifted<PathSample, Vec3>> {
        let mut shifted = self.0.shift(sample, from, to)?;
        (self.1)(&mut shifted, to);
        Some(shifted)
    }

    fn stratum(&self, _: &PathSample) {}
}

/// How a receiver draws a path, with W.
pub(crate) type Draw =
    fn(&World, &PathReceiver<'_>, u64, &mut Stream) -> Finished<PathSample, PrimarySample>;

/// Mean luminance of receivers that merge the paths of others, the i-th that of number i, into
/// their own, minus what the path tracer shows of their own: its t statistic over seeds, and the
/// relative difference.
pub(crate) fn merged_against_traced<'a>(
    shift: &mut Bugged<'a>,
    (own, others): (&[PathReceiver<'a>], &[PathReceiver<'a>]),
    family: Family,
    runs: u64,
    draw: Draw,
) -> (f64, f64) {
    let mut random = Stream::from_key(10);
    let (mut differences, mut means) = (Moments::default(), Moments::default());
    for run in 0..runs {
        let (mut difference, mut mean) = (0.0, 0.0);
        for (at, (here, there)) in (0..).zip(own.iter().zip(others)) {
            let mut fresh = |at: u32, receiver: &PathReceiver<'_>| {
                draw(receiver.world, receiver, path_seed(run, at, 0, 0), &mut random)
            };
            let (fresh, other) = (fresh(2 * at, here), fresh(2 * at + 1, there));
            let canonical = input(fresh, here);
            let past = [input(other, there)];
            let mut reservoir = Plain::default();
            let merged = merge(
                shift,
                family,
                &canonical,
                past.as_slice(),
                &mut reservoir,
                &mut random,
                |_| (),
            );
            let shown = f64::from(merged.target * merged.finished.weight.get());
            let traced = f64::from(canonical.target * fresh.weight.get());
            difference += shown - traced;
            mean += traced;
        }
        differences.push(difference);
        means.push(mean);
    }
    let test = t_test(&differences, 0.0);
    (test.statistic, test.difference / means.mean())
}

fn input<'r, 'w>(
    finished: Finished<PathSample, PrimarySample>,
    domain: &'r PathReceiver<'w>,
) -> Input<'r, PathSample, PathReceiver<'w>, PrimarySample> {
    let target = finished.sample.map_or(0.0, |sample| sample.target());
    Input { finished, target, domain }
}

/// Merges with paths of a neighbour show what the pixel's own paths show in the mean, by any
/// family; without |∂T|, or with the density of one end only, they do not.
#[test]
fn merges_of_paths_are_unbiased() {
    let stage = Stage::new(rooms()[0].clone()).unwrap();
    let all = receivers(stage.first_world());
    let some: Vec<_> = all.iter().copied().step_by(7).collect();
    // Far enough away that densities differ.
    let far: Vec<_> = (0..all.len()).step_by(7).map(|at| all[(at + 29) % all.len()]).collect();
    let run = |bug: fn(&mut Shifted<PathSample, Vec3>, &PathReceiver<'_>), family| {
        let mut shift = Bugged(PathShift::new(&AcceptAll, CONNECTS, None), bug);
        merged_against_traced(&mut shift, (&some, &far), family, 2400, drawn)
    };
    for family in [Family::Balance, Family::DefensivePairwise] {
        let (t, bias) = run(|_, _| (), family);
        println!("{family:?}: t {t:.2}, bias {:.3} %", 100.0 * bias);
        assert!(t.abs() < 4.5, "{family:?}: t {t}, bias {bias}");
    }
    let (t, bias) = run(|shifted, _| shifted.jacobian = 1.0, Family::Balance);
    println!("without the Jacobian: t {t:.2}, bias {:.3} %", 100.0 * bias);
    assert!(t.abs() > 4.5, "the control must fail: t {t}, bias {bias}");
}
