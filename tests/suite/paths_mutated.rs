//! Mutations of paths: kernels that keep their target, for everything that can follow `x_r`.

use std::sync::Arc;

use afterimage::accel::AcceptAll;
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::luminance;
use afterimage::math::rng::{RandomSource, Stream, path_seed};
use afterimage::path::Vertex;
use afterimage::resampling::{
    Chain, ContributionWeight, Finished, Gaussian, Kelemen, Mutator, PrimarySample, Proposal,
    SmallStep, metropolis, mutated_weight,
};
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{
    Anchor, Ending, NO_LOBE, PathMutator, PathReceiver, PathSample, PathShift, PathState, Place,
};
use afterimage::scene::{Color, Material, Scene, Texture, TextureKind};
use afterimage::stats::{Moments, t_test};
use afterimage::techniques::{Technique, parse};
use afterimage::world::World;
use glam::{Affine2, Vec2, Vec3};

use crate::paths::{CONNECTS, drawn_by, receivers_at, rooms};
use crate::paths_exact::{matt, mirrors, textured};
use crate::support::shot;

type Path = Finished<PathSample, PrimarySample>;

/// What a path's `x_r` is, and what follows it.
const KINDS: [&str; 9] = [
    "a vertex that scatters on",
    "a vertex that samples a light",
    "an emitter follows",
    "a sky follows",
    "a light is sampled there",
    "is an emitter",
    "is a sky",
    "is a point on a light",
    "is a light point of the primary hit",
];

fn kind(sample: &PathSample) -> Option<usize> {
    let kept = sample.reconnection?;
    Some(match (kept.anchor, kept.next.place()) {
        (Anchor::Point(_), _) if sample.ending == Ending::Direct => 8,
        (Anchor::Point(_), _) => 7,
        (Anchor::Sky { .. }, _) => 6,
        (Anchor::Surface(_), _) if kept.vertex > sample.last => 5,
        (Anchor::Surface(_), Some(Place::Light(_))) => 4,
        (Anchor::Surface(_), Some(Place::Sky)) => 3,
        (Anchor::Surface(_), _) if kept.vertex == sample.last => 2,
        (Anchor::Surface(_), _) if kept.next.lobe() == NO_LOBE => 1,
        _ => 0,
    })
}

/// What a receiver draws that mutations may move: a path of a walk, or a light point.
fn fresh<'a>(at: &PathReceiver<'a>, seed: u64, direct: bool, random: &mut Stream) -> Path {
    if !direct {
        return drawn_by::<true>(at.world, at, seed, random, CONNECTS);
    }
    let lights = &at.world.lights;
    let light = lights.choose(random.index(u32::MAX), random.index(u32::MAX));
    let point = lights.point_with(light, Vec2::new(random.uniform(), random.uniform()));
    let weight = 1.0 / lights.uniform_density(point);
    let there = *at;
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let sample = PathSample::direct(point, Vec3::ONE);
    match shift.try_shift(&sample, at, &there) {
        Ok(seen) => Finished {
            sample: Some(seen.sample),
            weight: ContributionWeight::new(weight),
            confidence: 1.0,
        },
        Err(_) => Finished::empty(1.0),
    }
}

/// A kernel with a planted bug in its acceptance, which knows the path and both states.
struct Bugged<M>(M, PathSample, fn(&PathSample, &PathState, &PathState) -> f32);

impl<M: Mutator<State = PathState>> Mutator for Bugged<M> {
    type State = PathState;

    fn propose(
        &mut self,
        state: &PathState,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<PathState>> {
        let Proposal { state: next, .. } = self.0.propose(state, random)?;
        let acceptance = (self.2)(&self.1, state, &next).min(1.0);
        Some(Proposal { state: next, acceptance })
    }
}

fn right(_: &PathSample, state: &PathState, next: &PathState) -> f32 {
    next.flow() / state.flow()
}

/// The path that a chain makes of one, by a rule that commits its state.
fn moved<'a, K: SmallStep>(
    shift: &mut PathShift<'a, AcceptAll>,
    at: &PathReceiver<'a>,
    path: &Path,
    (steps, random): (u32, &mut Stream),
    acceptance: fn(&PathSample, &PathState, &PathState) -> f32,
    commits: bool,
) -> Option<Moved> {
    let sample = path.sample?;
    let (mutator, state) = PathMutator::<_, K>::new(shift, at, &sample)?;
    let mut mutator = Bugged(mutator, sample, acceptance);
    let chain = if commits {
        metropolis(&mut mutator, state, steps, random)
    } else {
        let so_far = metropolis(&mut mutator, state, steps - 1, random).state;
        let Chain { state: end, accepted } = metropolis(&mut mutator, so_far, 1, random);
        Chain { state: if accepted > 0 { end } else { state }, accepted }
    };
    let end = chain.state.sample(&sample);
    let flow = (f64::from(chain.state.flow()) / f64::from(state.flow())).ln();
    let target = (f64::from(end.target()) / f64::from(state.sample(&sample).target())).ln();
    if chain.accepted == 0 {
        return Some(Moved { path: *path, flow, worth: flow - target });
    }
    let weight = mutated_weight(path.weight.get(), sample.target(), end.target());
    let weight = ContributionWeight::new(weight);
    let path = Finished { sample: Some(end), weight, confidence: path.confidence };
    Some(Moved { path, flow, worth: flow - target })
}

/// A path that a chain has moved, ln A'/A, and ln M'/M.
struct Moved {
    path: Path,
    flow: f64,
    worth: f64,
}

/// What a receiver draws and two mutations make of it.
pub(crate) fn drawn_and_moved(
    _: &World,
    at: &PathReceiver<'_>,
    seed: u64,
    random: &mut Stream,
) -> Path {
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let path = fresh(at, seed, false, random);
    let moved = moved::<Anywhere>(&mut shift, at, &path, (2, random), right, true);
    moved.map_or(path, |moved| moved.path)
}

/// A step anywhere.
struct Anywhere;

impl SmallStep for Anywhere {
    fn step(_: Vec2, random: &mut impl RandomSource) -> Vec2 {
        Vec2::new(random.uniform(), random.uniform())
    }
}

/// No step at all.
struct Nowhere;

impl SmallStep for Nowhere {
    fn step(u: Vec2, _: &mut impl RandomSource) -> Vec2 {
        u
    }
}

/// In which of four parts of its domain `x_r` is.
fn part(world: &World, sample: &PathSample) -> usize {
    let halves = |a: bool, b: bool| usize::from(a) + 2 * usize::from(b);
    let kept = sample.reconnection.unwrap();
    match kept.anchor {
        Anchor::Surface(hit) => {
            let at = world.accel.point(&hit).position;
            halves(at.x > 0.1, at.y > 0.8)
        }
        Anchor::Point(point) => halves(point.uv.x > 0.5, point.uv.y > 0.4),
        Anchor::Sky { .. } => halves(kept.direction.x > 0.0, kept.direction.y > 0.3),
    }
}

/// The scene with large surfaces in fine red and green squares, so that colours tell places apart.
fn coloured(mut scene: Scene) -> Scene {
    let [first, second] = [Vec3::new(0.8, 0.1, 0.1), Vec3::new(0.1, 0.8, 0.2)].map(Color::Constant);
    let kind = TextureKind::Checkerboard { first, second };
    let mapping = Affine2::from_scale(Vec2::splat(17.0));
    let reflectance = Color::Texture(scene.add_texture(Texture { kind, mapping }));
    let squares = scene.add_material(Material::Diffuse { reflectance });
    for object in &mut scene.objects[..3] {
        Arc::make_mut(object).shapes[0].material = squares;
    }
    scene
}

/// What is the same after mutations as before in the mean, all with p̂ W, which stays: F/p̂ in
/// three channels, in which of four parts `x_r` is, ln A and ln M (whose other factors stay). The
/// largest t statistic by kind, and how many paths moved.
fn drift<K: SmallStep>(
    scene: &Scene,
    (steps, walks): (u32, u32),
    acceptance: fn(&PathSample, &PathState, &PathState) -> f32,
    commits: bool,
) -> [(f64, u32); 9] {
    let stage = Stage::new(scene.clone()).unwrap();
    let world = stage.first_world();
    let mut tallies: [[Moments; 9]; 9] = Default::default();
    let mut counts = [0; 9];
    let mut random = Stream::from_key(41);
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    for (pixel, at) in receivers_at(world, Time::Now).iter().enumerate() {
        for walk in 0..walks {
            let seed = path_seed(41, pixel as u32, 0, walk);
            let path = fresh(at, seed, walk % 8 == 7, &mut random);
            let Some(sample) = path.sample else { continue };
            let Some(kind) = kind(&sample) else { continue };
            let numbers = (steps, &mut random);
            let Some(after) = moved::<K>(&mut shift, at, &path, numbers, acceptance, commits)
            else {
                continue;
            };
            let Moved { path: after, flow, worth } = after;
            let there = after.sample.unwrap();
            let light = |path: &Path, sample: &PathSample| sample.integrand * path.weight.get();
            let colour = light(&after, &there) - light(&path, &sample);
            let mass = f64::from(sample.target() * path.weight.get());
            let own = luminance(light(&after, &there));
            assert!((f64::from(own) / mass - 1.0).abs() < 1e-5, "{path:?} {after:?}");
            let (from, to) = (part(world, &sample), part(world, &there));
            let tally = &mut tallies[kind];
            for (tally, change) in tally.iter_mut().zip(colour.to_array()) {
                // Rounding has a sign of its own.
                let change = f64::from(change);
                tally.push(if change.abs() > 1e-5 * mass { change } else { 0.0 });
            }
            tally[7].push(mass * flow);
            tally[8].push(mass * worth);
            for (at, tally) in tally[3..7].iter_mut().enumerate() {
                let inside = |part| f64::from(u8::from(part == at));
                tally.push(mass * (inside(to) - inside(from)));
            }
            counts[kind] += u32::from(there != sample);
        }
    }
    std::array::from_fn(|kind| {
        let statistics = tallies[kind].iter().filter(|tally| tally.count() > 1);
        let worst =
            statistics.map(|tally| t_test(tally, 0.0).statistic.abs()).filter(|t| t.is_finite());
        (worst.fold(0.0, f64::max), counts[kind])
    })
}

/// Chains of one, two and five mutations leave all integrals of all kinds of paths as they were,
/// whatever the steps. Controls: F'/F for A'/A, and the commit rule of Fickel's pseudo-code.
#[test]
fn kernels_leave_the_target() {
    const LIMIT: f64 = 4.9; // α = 10⁻⁶ a statistic; some 1,300 are asked.
    let mut met = [0; 9];
    let mut caught = [0.0_f64; 9];
    let mut commit = 0.0_f64;
    let sky = coloured(rooms()[1].clone());
    for (name, scene) in [("matt", coloured(matt())), ("sky", sky), ("textured", textured())] {
        for (kernel, drifts) in [
            ("anywhere, 1", drift::<Anywhere>(&scene, (1, 200), right, true)),
            ("anywhere, 2", drift::<Anywhere>(&scene, (2, 200), right, true)),
            ("kelemen, 5", drift::<Kelemen>(&scene, (5, 100), right, true)),
            ("gaussian, 5", drift::<Gaussian>(&scene, (5, 100), right, true)),
        ] {
            println!("{name}, {kernel}: {drifts:.1?}");
            for (kind, (t, count)) in drifts.into_iter().enumerate() {
                assert!(t < LIMIT, "{name}, {kernel}, {}: t {t}", KINDS[kind]);
                met[kind] += count;
            }
        }
        let without: fn(&PathSample, &PathState, &PathState) -> f32 =
            |path, state, next| next.sample(path).target() / state.sample(path).target();
        let control = drift::<Anywhere>(&scene, (2, 2000), without, true);
        println!("{name}, without M: {control:.1?}");
        for (caught, (t, _)) in caught.iter_mut().zip(control) {
            *caught = caught.max(t);
        }
        let control = drift::<Anywhere>(&scene, (5, 1000), right, false);
        println!("{name}, the last acceptance decides: {control:.1?}");
        commit = control.into_iter().fold(commit, |most, (t, _)| most.max(t));
    }
    assert!(met.iter().all(|count| *count > 200), "{met:?}");
    // M is 1 where x_r is an emitter or a sky, and a light's area for direct light.
    for kind in [0, 1, 2, 3, 4, 7] {
        assert!(caught[kind] > LIMIT, "the control must fail where {}: {caught:?}", KINDS[kind]);
    }
    assert!(commit > LIMIT, "the control must fail: {commit}");
}

/// M by its definition, in double precision, from the densities of the numbers that T changes: for
/// paths whose `v_{r−1}` is the primary hit.
fn worth(at: &PathReceiver<'_>, sample: &PathSample) -> Option<f64> {
    let world = at.world;
    let kept = sample.reconnection?;
    let Anchor::Surface(hit) = kept.anchor else {
        let Anchor::Point(point) = kept.anchor else { return Some(1.0) };
        let from = world.surface(&at.hit).position;
        let area = f64::from(world.lights.measure(point));
        if sample.ending == Ending::Direct {
            return Some(area);
        }
        let emitter = world.lights.emitter(&world.scene, point)?;
        let geometry = emitter.towards(&world.lights, from)?.geometry;
        return Some(area * f64::from(world.lights.density_towards(point, from, geometry)));
    };
    if kept.vertex > sample.last {
        return Some(1.0);
    }
    let position = |hit: &afterimage::accel::Hit| world.accel.point(hit).position.as_dvec3();
    let here = world.accel.point(&hit);
    let into = position(&hit) - position(&at.hit);
    let vertex = Vertex::new(world, &hit, &here, into.normalize().as_vec3())?;
    let joint = |vertex: &Vertex, lobe: u8, direction: Vec3| {
        let wi = vertex.surface.frame.to_local(direction);
        f64::from(vertex.surface.bsdf.evaluate_lobe(lobe.into(), vertex.outgoing, wi).pdf)
    };
    let next = match kept.next.place()? {
        Place::Light(point) => {
            let from = vertex.surface.position;
            let emitter = world.lights.emitter(&world.scene, point)?;
            let geometry = emitter.towards(&world.lights, from)?.geometry;
            return Some(f64::from(world.lights.density_towards(point, from, geometry)));
        }
        Place::Sky => return Some(joint(&vertex, kept.lobes[1], kept.direction)),
        Place::Surface(next) => next,
    };
    let there = world.accel.point(&next);
    let way = position(&next) - position(&hit);
    let cosine = way.normalize().dot(there.geometric_normal.as_dvec3()).abs();
    let mut worth =
        joint(&vertex, kept.lobes[1], way.normalize().as_vec3()) * cosine / way.length_squared();
    if kept.vertex < sample.last && kept.next.lobe() != NO_LOBE {
        let vertex = Vertex::new(world, &next, &there, way.normalize().as_vec3())?;
        worth *= joint(&vertex, kept.next.lobe(), kept.next.direction());
    }
    Some(worth)
}

/// The ratio that steps are accepted by is the long one, p̂'/p̂ |∂T|, with densities of light
/// sampling where a light is sampled, for everything that can follow `x_r`.
#[test]
fn short_is_long() {
    let mut met = [0; 9];
    let (mut worst, mut plain) = (0.0_f64, 0);
    for scene in [matt(), rooms()[1].clone(), textured()] {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(42);
        let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
        for (pixel, at) in receivers_at(world, Time::Now).iter().enumerate() {
            for walk in 0..100 {
                let seed = path_seed(42, pixel as u32, 0, walk);
                let path = fresh(at, seed, walk % 8 == 7, &mut random);
                let Some(sample) = path.sample else { continue };
                let Some(kind) = kind(&sample) else { continue };
                if sample.reconnection.is_none_or(|kept| kept.vertex != 1) {
                    continue;
                }
                let begun = PathMutator::<_, Anywhere>::new(&mut shift, at, &sample);
                let Some((mut mutator, state)) = begun else { continue };
                let Some(Proposal { state: next, .. }) = mutator.propose(&state, &mut random)
                else {
                    continue;
                };
                let short = f64::from(next.flow()) / f64::from(state.flow());
                let [from, to] = [&state, &next].map(|state| state.sample(&sample));
                let [before, after] = [&from, &to].map(|path| worth(at, path).unwrap());
                let plainly = f64::from(to.target()) / f64::from(from.target());
                let long = plainly * after / before;
                let error = (short / long - 1.0).abs();
                worst = worst.max(error);
                // F and M are products of some twenty numbers of 24 bits.
                assert!(error < 2e-5, "{}: {short} and {long}, {sample:?}", KINDS[kind]);
                plain += u32::from((plainly / long - 1.0).abs() > 0.1);
                met[kind] += 1;
            }
        }
    }
    println!("worst {worst:e}, {met:?}; F alone differs {plain} times");
    assert!(met.iter().all(|count| *count > 50), "{met:?}");
    assert!(plain > 1000, "{plain}");
}

/// Whatever steps and surfaces, chains have no state that is no number, and what cannot move stays:
/// a path without `x_r`, a path whose p̂ is 0 here, a lamp of one point.
#[test]
fn chains_meet_only_numbers() {
    let mut stays = 0;
    let mut accepted = 0;
    for scene in [mirrors(), textured(), rooms()[2].clone()] {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(43);
        let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
        let all = receivers_at(world, Time::Now);
        for (pixel, at) in all.iter().enumerate() {
            for walk in 0..24 {
                let seed = path_seed(43, pixel as u32, 0, walk);
                let path = fresh(at, seed, walk % 8 == 7, &mut random);
                // A path of another pixel may have no light here.
                let there = if walk % 3 == 0 { &all[(pixel + 50) % all.len()] } else { at };
                let numbers = &mut random;
                let after = [
                    moved::<Anywhere>(&mut shift, there, &path, (4, numbers), right, true),
                    moved::<Nowhere>(&mut shift, there, &path, (4, numbers), right, true),
                    moved::<Kelemen>(&mut shift, there, &path, (4, numbers), right, true),
                    moved::<Gaussian>(&mut shift, there, &path, (4, numbers), right, true),
                ];
                for after in after {
                    stays += u32::from(after.is_none());
                    let after = after.map(|after| after.path);
                    if let Some(Finished { sample: Some(sample), weight, .. }) = after {
                        assert!(sample.integrand.is_finite() && sample.target() > 0.0);
                        assert!(weight.get() > 0.0 && weight.get().is_finite());
                        accepted += u32::from(Some(sample) != path.sample);
                    }
                }
            }
        }
    }
    assert!(stays > 1000 && accepted > 1000, "{stays} stay, {accepted} move");
}

/// A path that was moved is one that a walk could have found: a shift to where it is gives the same
/// F and |∂T| = 1, and its `x_r` is left by a lobe that is rough there.
#[test]
fn moved_paths_are_paths() {
    let (mut all, mut off, mut smooth) = (0, 0, 0);
    for scene in [matt(), rooms()[1].clone(), textured()] {
        let stage = Stage::new(scene).unwrap();
        let world = stage.first_world();
        let mut random = Stream::from_key(44);
        let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
        for (pixel, at) in receivers_at(world, Time::Now).iter().enumerate() {
            for walk in 0..48 {
                let seed = path_seed(44, pixel as u32, 0, walk);
                let path = fresh(at, seed, walk % 8 == 7, &mut random);
                let moved = moved::<Anywhere>(&mut shift, at, &path, (2, &mut random), right, true);
                let Some(after) = moved.and_then(|moved| moved.path.sample) else { continue };
                if Some(after) == path.sample {
                    continue;
                }
                all += 1;
                let again = shift.try_shift(&after, at, &at.clone());
                let same = again.is_ok_and(|again| {
                    (again.sample.target() / after.target() - 1.0).abs() < 1e-3
                        && (again.jacobian - 1.0).abs() < 1e-3
                });
                off += u32::from(!same);
                let kept = after.reconnection.unwrap();
                if let Anchor::Surface(hit) = kept.anchor
                    && kept.vertex <= after.last
                {
                    let bsdf = world.surface(&hit).bsdf;
                    let lobes = 0..bsdf.lobe_count();
                    let rough = |lobe: u32| bsdf.lobe_roughness(lobe) >= CONNECTS.roughness;
                    let taken = u32::from(kept.lobes[1]);
                    let one = if kept.lobes[1] == NO_LOBE {
                        lobes.clone().any(rough)
                    } else {
                        rough(taken)
                    };
                    assert!(one, "x_r is not rough: {after:?}");
                    smooth += u32::from(lobes.into_iter().any(|lobe| !rough(lobe)));
                }
            }
        }
    }
    println!("{all} moved, {off} are other paths to rounding, {smooth} beside a smooth lobe");
    // Rounding turns few of them over a threshold.
    assert!(all > 10_000 && f64::from(off) < 0.002 * f64::from(all), "{off} of {all}");
}

fn frames(scene: &Scene, spec: &str, count: u32) -> (Vec<Vec3>, Counters) {
    let stage = Stage::new(scene.clone()).unwrap();
    let technique: Arc<dyn Technique> = Arc::from(parse(spec).unwrap());
    let mut frames = FrameLoop::new(technique, &stage, shot([24, 16], 6, 3)).unwrap();
    let mut work = Counters::default();
    for _ in 1..count {
        work = work + frames.render().unwrap().counters;
    }
    let frame = frames.render().unwrap();
    (frame.picture().pixels, work + frame.counters)
}

/// A mutation changes nothing of its own pixel's luminance, in single frames and with the history
/// of a still pixel; only its colour.
#[test]
fn luminance_stays() {
    let scene = coloured(rooms()[1].clone());
    for keys in ["cap=0", "cap=20"] {
        let of = |mutations: u32| {
            let spec =
                format!("restir-pt:neighbours=0,shade=selected,{keys},mutations={mutations}");
            frames(&scene, &spec, 4)
        };
        let (plain, work) = of(0);
        assert_eq!((work.mutations, work.mutations_accepted), (0, 0));
        for steps in [1, 5] {
            let (mutated, work) = of(steps);
            let mut others = 0;
            for (a, b) in plain.iter().zip(&mutated) {
                let error = (luminance(*a) - luminance(*b)).abs();
                assert!(error <= 2e-6 * luminance(*a), "{keys}, {steps}: {a} {b}");
                others += u32::from((*a - *b).abs().max_element() > 1e-5 * a.max_element());
            }
            println!("{keys}, {steps}: {others} colours differ, {work:?}");
            assert!(others > 0, "{keys}, {steps}: no colour differs");
            let counts = (work.mutations, work.mutations_accepted);
            assert!(counts.1 * 4 > counts.0 && counts.1 < counts.0, "{counts:?}");
        }
    }
}

/// Without mutations nothing is kept for them: records have 80 bytes, with them 40 more, and only
/// then is there a pass.
#[test]
fn without_mutations_nothing_is_kept_for_them() {
    let stage = Stage::new(rooms()[0].clone()).unwrap();
    for (keys, bytes) in [("", 80), (":mutations=1", 120), (":mutations=5,mutate-share=0.1", 120)] {
        let technique = parse(&format!("restir-pt{keys}")).unwrap();
        let plan = technique.plan(stage.facts(), &shot([24, 16], 6, 1));
        let mutates = plan.passes.iter().any(|pass| pass.name == "mutate");
        assert_eq!(mutates, bytes > 80, "{keys}");
        let records = ["reservoirs", "history"];
        let found = plan.buffers.iter().filter(|buffer| records.contains(&buffer.name));
        let sizes: Vec<u32> = found.map(|buffer| buffer.bytes).collect();
        assert_eq!(sizes, [bytes; 2], "{keys}");
    }
    let share = |keys: &str| {
        let (_, work) = frames(&rooms()[0], &format!("restir-pt:mutations=4{keys}"), 3);
        work.mutations as f64
    };
    let part = share(",mutate-share=0.25") / share("");
    assert!((0.2..0.3).contains(&part), "{part} of all are mutated");
}
