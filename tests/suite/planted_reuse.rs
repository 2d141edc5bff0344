//! Bugs of reuse, planted: two pixels of a small scene, merged over the public traits with one
//! thing wrong.
//!
//! A pixel's truth is a quadrature over all lights. Each bug must shift a mean by more than the
//! test of that mean tolerates: TOST with δ = 1.5 %, α = 10⁻³, a fail at 10⁻⁶; without the bug the
//! same test passes. `docs/planted_bugs.md` holds the figures that [`table`] prints.

use std::time::Instant;

use afterimage::accel::{AcceptAll, BuildOptions, Ray};
use afterimage::counters::Counters;
use afterimage::light::LightPoint;
use afterimage::math::luminance;
use afterimage::math::rng::{BLOCK_LIGHT, PathSeeds, RandomSource, Stream, draw4, unit_float};
use afterimage::path::{Limits, indirect_radiance, sampled, scattered_radiance};
use afterimage::resampling::{
    ContributionWeight, Family, Finished, Input, Plain, ShiftMap, Shifted, WithVisibility, merge,
    metropolis, mutated_weight,
};
use afterimage::reuse::light_points::{
    Candidates, LightMeasure, LightPointMutator, LightPointShift, Receiver, Time, candidates,
};
use afterimage::scene::{
    Color, ConductorColor, Geometry, LightKind, Material, Roughness, Scene, Shape,
};
use afterimage::stats::{Equivalence, Margin, Moments, Verdict, equivalence, t_test};
use afterimage::world::World;
use glam::{Affine3A, Vec2, Vec3};
use rayon::prelude::*;

use crate::support::{light, polygon};

/// What a merge does wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Bug {
    /// Nothing, with visibility in the target.
    None,
    /// The shift from the pixel to its neighbour forgets its shadow ray.
    ReverseUnshadowed,
    /// Weights 1/M where the two do not see the same.
    OneOverM,
    /// A neighbour is left out where its sample does not fit.
    SampleRejected,
    /// The neighbour's target is asked with the pixel's own view.
    WrongView,
    /// Nothing, with three mutations between the candidates and the merge.
    Mutated,
    /// The same, with W left as it was.
    MutatedWeightKept,
    /// Nothing, with averaged visibility and constant weights of one receiver.
    Averaged,
    /// Visibility is averaged and asked for again.
    VisibilityTwice,
    /// Candidates are selected by a number that also places them.
    SelectionIsPath,
    /// Nothing, with a neighbour of the frame before, when the fence was elsewhere.
    Moved,
    /// The same, with its target asked in this frame's world.
    MovedTargetNow,
    /// W is made with the target that the sample had where it came from.
    StaleTarget,
    /// Nothing, in two rounds of merges.
    TwoRounds,
    /// Both rounds select by the same numbers.
    RoundsAlike,
}

/// A glossy floor under two lamps and a point light, with a fence at `x` that hides part of one
/// lamp from one pixel and of the other from the other.
fn scene(x: f32) -> Scene {
    let mut scene = Scene::new("two pixels");
    let glossy = scene.add_material(Material::Conductor {
        color: ConductorColor::Reflectance(Color::Constant(Vec3::ONE)),
        roughness: Roughness::isotropic(0.35),
    });
    let black = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) });
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let floor = [c(-2.0, 0.0, -2.0), c(-2.0, 0.0, 2.0), c(2.0, 0.0, 2.0), c(2.0, 0.0, -2.0)];
    scene.add_shape(Shape::new(polygon(&floor), glossy));
    let fence = [c(x, 0.05, -2.0), c(x, 0.17, -2.0), c(x, 0.17, 2.0), c(x, 0.05, 2.0)];
    scene.add_shape(Shape::new(polygon(&fence), black));
    for (x, power) in [(-0.7, 6.0), (0.8, 8.0)] {
        let ball = Geometry::Sphere { center: c(x, 0.7, 0.4), radius: 0.25 };
        scene.add_shape(Shape::new(ball, black).emitting(Vec3::splat(power)));
    }
    let place = Affine3A::from_translation(c(0.2, 1.6, 0.3));
    light(&mut scene, LightKind::Point { intensity: Vec3::splat(0.6) }, place);
    scene
}

/// Now, and one frame ago.
struct Worlds {
    now: World,
    before: World,
}

fn worlds() -> Worlds {
    let [now, before] =
        [0.0, 0.36].map(|x| World::new(scene(x), &BuildOptions::default()).unwrap());
    Worlds { now, before }
}

/// The pixel and its neighbour, seen from two places; and the neighbour as the pixel's camera would
/// see it.
fn receivers(world: &World, time: Time) -> [Receiver<'_>; 3] {
    let [left, right] = [Vec3::new(-0.25, 0.0, -0.1), Vec3::new(0.2, 0.0, 0.0)];
    let [near, far] = [Vec3::new(-0.4, 0.9, -1.2), Vec3::new(0.9, 0.6, -1.0)];
    let at = |point: Vec3, origin: Vec3| {
        let direction = (point - origin).normalize();
        (world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }).unwrap(), direction)
    };
    let (a, from_near) = at(left, near);
    let (b, from_far) = at(right, far);
    [(a, from_near), (b, from_far), (b, from_near)]
        .map(|(hit, direction)| Receiver::new(world, hit, direction, time))
}

fn sees(receiver: &Receiver<'_>, point: LightPoint) -> Option<(Vec3, bool)> {
    let (sight, emitter) = receiver.look(point)?;
    let direction = sight.arrival.direction;
    let seen = receiver.sees(direction, &emitter, &AcceptAll, &mut Counters::default());
    Some((sight.integrand, seen))
}

/// What is measured: all light, or that of one light alone. A wrong distribution over lights may
/// leave their sum alone.
#[derive(Clone, Copy)]
enum Part {
    All,
    Of(u32),
}

/// 1 where a point belongs to the part.
fn part_of(part: Part, point: LightPoint) -> f32 {
    match part {
        Part::All => 1.0,
        Part::Of(light) => f32::from(u8::from(point.light == light)),
    }
}

fn truth(receiver: &Receiver<'_>, part: Part) -> f64 {
    let lights = &receiver.world().lights;
    const FINE: u32 = 600;
    let mut sum = 0.0;
    for light in 0..lights.len() as u32 {
        for i in 0..FINE * FINE {
            let uv = Vec2::new((i % FINE) as f32 + 0.5, (i / FINE) as f32 + 0.5) / FINE as f32;
            let point = lights.point_with(light, uv);
            if let Some((value, true)) = sees(receiver, point) {
                let share = lights.measure(point) * part_of(part, point);
                sum += f64::from(luminance(value) * share) / f64::from(FINE * FINE);
            }
        }
    }
    sum
}

/// Light points with visibility, in both directions or, planted, only towards the pixel; and with
/// the neighbour's own view or the pixel's.
struct Planted<'a> {
    seen: LightPointShift<'a, AcceptAll, true>,
    unseen: LightPointShift<'a, AcceptAll, false>,
    bug: Bug,
    /// Where the neighbour is asked instead.
    wrong: &'a Receiver<'a>,
    own: *const (),
}

impl<'a> ShiftMap for Planted<'a> {
    type Sample = LightPoint;
    type Domain = Receiver<'a>;
    type Integrand = Vec3;
    type Stratum = [u32; 2];

    fn shift(
        &mut self,
        sample: &LightPoint,
        from: &Receiver<'a>,
        to: &Receiver<'a>,
    ) -> Option<Shifted<LightPoint, Vec3>> {
        let reverse = !std::ptr::addr_eq(to, self.own);
        match self.bug {
            Bug::ReverseUnshadowed if reverse => self.unseen.shift(sample, from, to),
            Bug::WrongView | Bug::MovedTargetNow if reverse => {
                self.seen.shift(sample, from, self.wrong)
            }
            _ => self.seen.shift(sample, from, to),
        }
    }

    fn stratum(&self, sample: &LightPoint) -> [u32; 2] {
        self.seen.stratum(sample)
    }
}

/// A source whose choices are a candidate's own number.
struct Replay {
    seeds: PathSeeds,
    asked: u32,
}

impl RandomSource for Replay {
    fn choose(&mut self, weight: f32, total: f32) -> bool {
        let [word, ..] = draw4(self.seeds.seed(self.asked), 0, BLOCK_LIGHT);
        self.asked += 1;
        unit_float(word) * total < weight
    }

    fn index(&mut self, n: u32) -> u32 {
        n / 2
    }

    fn uniform(&mut self) -> f32 {
        0.5
    }
}

type Kept = (Finished<LightPoint, LightMeasure>, f32);

/// A pixel's candidates, with one shadow ray.
fn initial(receiver: &Receiver<'_>, run: u64, pixel: u32, bug: Bug) -> (Kept, bool) {
    let from = Candidates { lights: 2, bsdf: 0, tile: None, surfaces: true };
    let seeds = PathSeeds::new(run, pixel, 0);
    let counters = &mut Counters::default();
    let chosen = if bug == Bug::SelectionIsPath {
        candidates(receiver, &from, (seeds, 0), &mut Replay { seeds, asked: 0 }, counters)
    } else {
        let mut selection = Stream::from_key(run << 8 | u64::from(pixel) << 4);
        candidates(receiver, &from, (seeds, 0), &mut selection, counters)
    };
    let Some(chosen) = chosen else { return ((Finished::empty(1.0), 0.0), false) };
    let target = chosen.sight.target();
    let seen = sees(receiver, chosen.point).is_some_and(|(_, seen)| seen);
    ((chosen.finish(1.0), target), seen)
}

/// Three mutations; planted: without W' = W p̂(X) / p̂(Y).
fn mutated((kept, target): Kept, receiver: &Receiver<'_>, run: u64, bug: Bug) -> Kept {
    let Some(point) = kept.sample else { return (kept, target) };
    let mut mutator = LightPointMutator::<_, true> {
        receiver,
        filter: &AcceptAll,
        large: 1.0,
        counters: Counters::default(),
    };
    let mut random = Stream::from_key(run ^ 0xABCD_0000_0000);
    let start = mutator.start(point).unwrap();
    let end = metropolis(&mut mutator, start, 3, &mut random).state;
    if bug == Bug::MutatedWeightKept {
        return (Finished { sample: Some(end.point), ..kept }, end.target());
    }
    let weight = mutated_weight(kept.weight.get(), start.target(), end.target());
    let weight = ContributionWeight::new(weight);
    (Finished { sample: Some(end.point), weight, ..kept }, end.target())
}

/// One run's estimate at the pixel.
fn estimate(worlds: &Worlds, run: u64, bug: Bug, part: Part) -> f64 {
    let [own, neighbour, wrong] = receivers(&worlds.now, Time::Now);
    let (neighbour, wrong) = if matches!(bug, Bug::Moved | Bug::MovedTargetNow) {
        let [_, before, _] = receivers(&worlds.before, Time::Before);
        (before, neighbour)
    } else {
        (neighbour, wrong)
    };
    let shown = |kept: &Kept, visibility: f32| {
        let (finished, target) = kept;
        let share = finished.sample.map_or(0.0, |point| part_of(part, point));
        f64::from(target * finished.weight.get() * visibility * share)
    };
    let mut random = Stream::from_key(run << 8 | 0xF);
    if matches!(bug, Bug::Averaged | Bug::VisibilityTwice) {
        // Two frames of one pixel: constant weights, one receiver.
        let [a, b] = [0, 1].map(|frame| initial(&own, run, frame, bug));
        let mut reservoir = WithVisibility::<Plain<LightPoint>>::default();
        let mut map = LightPointShift::<_, false>::new(&AcceptAll, None);
        let visibility = [a.1, b.1].map(|seen| f32::from(u8::from(seen)));
        let inputs = [a.0, b.0].map(|(finished, target)| Input { finished, target, domain: &own });
        let merged = merge(
            &mut map,
            Family::Constant,
            &inputs[0],
            &inputs[1..],
            &mut reservoir,
            &mut random,
            |term| ((), visibility[term.input]),
        );
        let again = match merged.finished.sample {
            Some(point) if bug == Bug::VisibilityTwice => {
                f32::from(u8::from(sees(&own, point).is_some_and(|(_, seen)| seen)))
            }
            _ => 1.0,
        };
        return shown(&(merged.finished, merged.target), reservoir.visibility() * again);
    }
    let [mut a, b] = [(&own, 0), (&neighbour, 1)].map(|(receiver, pixel)| {
        let (kept, seen) = initial(receiver, run, pixel, bug);
        if seen { kept } else { (Finished::empty(1.0), 0.0) }
    });
    if bug == Bug::SelectionIsPath {
        return shown(&a, 1.0);
    }
    if matches!(bug, Bug::Mutated | Bug::MutatedWeightKept) {
        a = mutated(a, &own, run, bug);
        return shown(&a, 1.0);
    }
    let mut map = Planted {
        seen: LightPointShift::new(&AcceptAll, None),
        unseen: LightPointShift::new(&AcceptAll, None),
        bug,
        wrong: &wrong,
        own: std::ptr::from_ref(&own).cast(),
    };
    let other = Input { finished: b.0, target: b.1, domain: &neighbour };
    let fits = b.0.sample.is_some_and(|point| map.shift(&point, &neighbour, &own).is_some());
    let others: &[_] = if bug == Bug::SampleRejected && !fits { &[] } else { &[other] };
    let family = if bug == Bug::OneOverM { Family::Constant } else { Family::Balance };
    let canonical = Input { finished: a.0, target: a.1, domain: &own };
    let mut reservoir = Plain::default();
    let merged = merge(&mut map, family, &canonical, others, &mut reservoir, &mut random, |_| ());
    if bug == Bug::StaleTarget && merged.source > 0 {
        return shown(&(merged.finished, merged.target), merged.target / b.1);
    }
    if matches!(bug, Bug::TwoRounds | Bug::RoundsAlike) {
        // The second round's neighbour has candidates of its own, at the same place.
        let (kept, seen) = initial(&neighbour, run, 2, bug);
        let (finished, target) = if seen { kept } else { (Finished::empty(1.0), 0.0) };
        let other = Input { finished, target, domain: &neighbour };
        let canonical = Input { finished: merged.finished, target: merged.target, domain: &own };
        let key = if bug == Bug::RoundsAlike { run << 8 | 0xF } else { run << 8 | 0xE };
        let random = &mut Stream::from_key(key);
        let mut reservoir = Plain::default();
        let merged =
            merge(&mut map, family, &canonical, &[other][..], &mut reservoir, random, |_| ());
        return shown(&(merged.finished, merged.target), 1.0);
    }
    shown(&(merged.finished, merged.target), 1.0)
}

const DELTA: f64 = 0.015;

/// TOST of the pixel's mean over `200 · batches` runs.
fn tested(bug: Bug, part: Part, batches: u64) -> (Equivalence, f64) {
    let worlds = worlds();
    let [own, ..] = receivers(&worlds.now, Time::Now);
    let truth = truth(&own, part);
    let means: Vec<f64> = (0..batches)
        .into_par_iter()
        .map(|batch| {
            let runs = batch * 200..(batch + 1) * 200;
            runs.map(|run| estimate(&worlds, 1 + run, bug, part)).sum::<f64>() / 200.0
        })
        .collect();
    let sample: Moments = means.into_iter().collect();
    let margin = Margin { delta: DELTA * truth, equivalence_alpha: 1e-3, difference_alpha: 1e-6 };
    (equivalence(&t_test(&sample, truth), &margin), truth)
}

/// A bug, what it is to be compared with, and what to look at.
const CASES: [(Bug, Bug, Part); 10] = [
    (Bug::ReverseUnshadowed, Bug::None, Part::All),
    (Bug::OneOverM, Bug::None, Part::All),
    (Bug::SampleRejected, Bug::None, Part::All),
    (Bug::WrongView, Bug::None, Part::All),
    (Bug::MutatedWeightKept, Bug::Mutated, Part::All),
    (Bug::VisibilityTwice, Bug::Averaged, Part::All),
    (Bug::SelectionIsPath, Bug::None, Part::Of(0)),
    (Bug::MovedTargetNow, Bug::Moved, Part::All),
    (Bug::StaleTarget, Bug::None, Part::All),
    (Bug::RoundsAlike, Bug::TwoRounds, Part::Of(0)),
];

const BATCHES: u64 = 800;

fn caught(case: usize) {
    let (bug, without, part) = CASES[case];
    let (right, _) = tested(without, part, BATCHES);
    assert_eq!(right.verdict, Verdict::Pass, "{without:?}: {right:?}");
    let (wrong, _) = tested(bug, part, BATCHES);
    assert_eq!(wrong.verdict, Verdict::Fail, "{bug:?}: {wrong:?}");
}

#[test]
fn the_shadow_ray_of_the_reverse_shift_left_out() {
    caught(0);
}

#[test]
fn one_over_m_where_pixels_see_different_lights() {
    caught(1);
}

#[test]
fn a_neighbour_rejected_for_its_sample() {
    caught(2);
}

#[test]
fn a_neighbours_target_with_the_own_view() {
    caught(3);
}

#[test]
fn a_mutation_that_keeps_its_weight() {
    caught(4);
}

#[test]
fn visibility_averaged_and_asked_for_again() {
    caught(5);
}

#[test]
fn a_selection_by_the_numbers_that_place_the_candidates() {
    caught(6);
}

#[test]
fn the_last_frames_target_in_this_frames_world() {
    caught(7);
}

#[test]
fn a_target_kept_from_where_the_sample_came_from() {
    caught(8);
}

#[test]
fn two_rounds_that_select_by_the_same_numbers() {
    caught(9);
}

/// What stands beside resampled light has none of it: emission would be counted in both. Without
/// delta lobes nothing is left at depth 2.
#[test]
fn direct_light_counted_beside_resampled_light() {
    let world = worlds().now;
    let origin = Vec3::new(-0.4, 0.9, -1.2);
    let direction = (Vec3::new(-0.25, 0.0, -0.1) - origin).normalize();
    let hit = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }).unwrap();
    let limits = Limits { depth: 2, roulette_after: 5 };
    let counters = &mut Counters::default();
    let (mut rest, mut all) = (Vec3::ZERO, Vec3::ZERO);
    for seed in 0..1000 {
        let primary = (direction, &hit);
        rest += indirect_radiance(&world, &AcceptAll, seed, primary, limits, counters);
        all += scattered_radiance::<{ sampled::ONE }, _>(
            &world, &AcceptAll, seed, primary, limits, counters,
        );
    }
    assert_eq!(rest, Vec3::ZERO);
    assert!(all.x > 0.0, "the planted share has light");
}

/// Largest distance of Σ w / p̂(Y) from what a plain sum in f64 gives, over merges of one receiver.
fn weight_error(factor: f32) -> f64 {
    let worlds = worlds();
    let [own, neighbour, _] = receivers(&worlds.now, Time::Now);
    let mut worst: f64 = 0.0;
    for run in 1..2000 {
        let inputs = [(&own, 0), (&neighbour, 1)].map(|(receiver, pixel)| {
            let ((finished, target), _) = initial(receiver, run, pixel, Bug::None);
            Input { finished, target, domain: receiver }
        });
        let mut map = LightPointShift::<_, false>::new(&AcceptAll, None);
        let mut reservoir = Plain::default();
        let merged = merge(
            &mut map,
            Family::Balance,
            &inputs[0],
            &inputs[1..],
            &mut reservoir,
            &mut Stream::from_key(run),
            |_| (),
        );
        let mut sum = 0.0;
        for (i, input) in inputs.iter().enumerate() {
            let Some(point) = input.finished.sample else { continue };
            let at = |r: &Receiver<'_>| {
                r.look(point).map_or(0.0, |(sight, _)| f64::from(luminance(sight.integrand)))
            };
            let both = [at(&own), at(&neighbour)];
            let weight = f64::from(input.finished.weight.get());
            sum += both[i] / (both[0] + both[1]) * both[0] * weight;
        }
        if sum > 0.0 {
            let found = f64::from(merged.target * merged.finished.weight.get() * factor);
            worst = worst.max((found / sum - 1.0).abs());
        }
    }
    worst
}

#[test]
fn a_weight_three_in_a_thousand_off() {
    assert!(weight_error(1.0) < 1e-5, "{}", weight_error(1.0));
    assert!(weight_error(1.003) > 1e-5);
}

/// Prints the rows of `docs/planted_bugs.md`.
#[test]
#[ignore = "slow: prints rows of docs/planted_bugs.md"]
fn table() {
    for (bug, without, part) in CASES {
        let begin = Instant::now();
        let (right, _) = tested(without, part, BATCHES);
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        let (wrong, truth) = tested(bug, part, BATCHES);
        let c = right.test.standard_error / truth * ((200 * BATCHES) as f64).sqrt();
        println!(
            "{bug:?} | {:+.2} % (z {:.0}) | without {:+.3} % | c {c:.2} | {ms:.0} ms",
            100.0 * wrong.test.difference / truth,
            wrong.test.statistic,
            100.0 * right.test.difference / truth,
        );
    }
    println!("weight: {:.1e}", weight_error(1.0));
}
