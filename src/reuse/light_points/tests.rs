//! The laws of the shift, the mutations and the candidates of light points, on small scenes.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::candidates::TILE;
use super::*;
use crate::accel::{AcceptAll, BuildOptions, HitFilter, Ray};
use crate::counters::Counters;
use crate::light::{EmitterPoint, LightPoint, LightRemap, NO_LIGHT};
use crate::math::rng::{
    BLOCK_LIGHT, BLOCK_SCATTER, PathSeeds, RandomSource, Stream, draw4, unit_float,
};
use crate::resampling::laws::check_shift;
use crate::resampling::{
    Finished, Mutator, Plain, Proposal, Reservoir, ShiftMap, Shifted, metropolis, mutated_weight,
};
use crate::scene::{
    Color, ConductorColor, EnvironmentMapping, Geometry, Image, ImageData, Light, LightKind,
    Material, Mesh, Roughness, Scene, Shape, SpotFalloff, Transform,
};
use crate::stats::{Equivalence, Margin, Moments, Verdict, chi_square, equivalence, t_test};
use crate::world::World;

fn mesh(corners: &[Vec3]) -> Geometry {
    let triangles = (2..corners.len() as u32).map(|i| [0, i - 1, i]).collect();
    Geometry::Mesh(Arc::new(Mesh { positions: corners.to_vec(), triangles, ..Mesh::default() }))
}

/// A sky of 8 × 4 texels, brighter where `tilt` says.
fn sky(scene: &mut Scene, tilt: f32, key: u64) {
    let texel = |i: u32| 0.05 + 0.25 * (tilt + 0.7 * i as f32).sin().powi(2);
    let data = (0..32).map(|i| [texel(i), 0.9 * texel(i), 1.1 * texel(i), 1.0]).collect();
    let image = scene.add_image(Image { width: 8, height: 4, data: ImageData::Float(data) });
    scene.lights.push(Light {
        to_world: Transform::Fixed(Affine3A::from_rotation_x(0.3)),
        kind: LightKind::Environment {
            radiance: Vec3::ONE,
            image: Some((image, EnvironmentMapping::LatitudeLongitude)),
        },
        key,
    });
}

/// A floor around the origin under a triangle, a sphere and a disk that shine, two point lights, a
/// spot light, a distant light and a sky. A wall hides what lies at x > 0.4 and z > 0 from the
/// origin.
fn scene(material: Material, wall: bool) -> Scene {
    let mut scene = Scene::new("all lights");
    let floor = scene.add_material(material);
    let black = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) });
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let corners = [c(-3.0, 0.0, -3.0), c(-3.0, 0.0, 3.0), c(3.0, 0.0, 3.0), c(3.0, 0.0, -3.0)];
    scene.add_shape(Shape::new(mesh(&corners), floor));
    let triangle = mesh(&[c(0.8, 1.5, -1.0), c(1.4, 1.6, -0.8), c(1.0, 1.5, 1.2)]);
    let ball = Geometry::Sphere { center: c(1.5, 0.8, 0.1), radius: 0.4 };
    let disk = Geometry::Disk { center: c(0.9, 2.4, 0.1), normal: -Vec3::Y, radius: 0.6 };
    for (geometry, rgb) in [(triangle, [2.0, 1.0, 1.0]), (ball, [1.0, 3.0, 2.0]), (disk, [1.5; 3])]
    {
        scene.add_shape(Shape::new(geometry, black).emitting(rgb.into()));
    }
    if wall {
        let corners = [c(0.4, 0.02, 0.0), c(0.4, 9.0, 0.0), c(0.4, 9.0, 9.0), c(0.4, 0.02, 9.0)];
        scene.add_shape(Shape::new(mesh(&corners), black));
    }
    let falloff = SpotFalloff::Smoothstep;
    let intensity = Vec3::ONE;
    for (key, (kind, at)) in [
        (LightKind::Point { intensity }, c(0.8, 1.0, 0.7)),
        (LightKind::Point { intensity }, c(0.8, 1.0, -0.7)),
        (
            LightKind::Spot { intensity, cos_inner: -0.1, cos_outer: -0.9, falloff },
            c(-0.5, 1.2, 0.3),
        ),
        (LightKind::Distant { irradiance: 0.5 * intensity }, Vec3::ZERO),
    ]
    .into_iter()
    .enumerate()
    {
        let turned = Affine3A::from_rotation_translation(Quat::from_rotation_x(1.2), at);
        scene.lights.push(Light { to_world: Transform::Fixed(turned), kind, key: key as u64 });
    }
    sky(&mut scene, 0.0, 9);
    scene
}

fn lambert() -> Material {
    Material::Diffuse { reflectance: Color::Constant(Vec3::new(0.8, 0.7, 0.5)) }
}

fn glossy() -> Material {
    Material::Conductor {
        color: ConductorColor::Reflectance(Color::Constant(Vec3::new(0.9, 0.8, 0.7))),
        roughness: Roughness::isotropic(0.3),
    }
}

fn world(scene: Scene) -> World {
    let world = World::new(scene, &BuildOptions::default()).unwrap();
    world.prepare_emitters().unwrap();
    world
}

/// What a ray from the left meets at `at`.
fn receiver(world: &World, at: Vec3, time: Time) -> Receiver<'_> {
    let origin = Vec3::new(-1.4, 1.0, -0.1);
    let direction = (at - origin).normalize();
    let hit = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }).unwrap();
    Receiver::new(world, hit, direction, time)
}

fn near(a: &LightPoint, b: &LightPoint) -> bool {
    a == b
}

/// Points on each of `lights` lights.
fn points(world: &World, lights: u32) -> Vec<LightPoint> {
    let mut random = Stream::from_key(3);
    let mut at =
        |light| world.lights.point_with(light, Vec2::new(random.uniform(), random.uniform()));
    (0..lights).flat_map(|light| [light; 20]).map(&mut at).collect()
}

/// The scene one frame later: one light gone, others scaled, moved, recoloured and in another
/// order, the sky changed.
fn later() -> Scene {
    let mut scene = scene(lambert(), true);
    scene.instances.swap(1, 3);
    let place = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.8),
        Quat::from_rotation_y(0.2),
        Vec3::new(0.1, 0.2, 0.0),
    );
    for instance in [1, 2, 3] {
        scene.instances[instance].to_world = Transform::Fixed(place);
    }
    scene.lights.remove(1);
    scene.lights.pop();
    sky(&mut scene, 1.0, 9);
    scene.lights.reverse();
    scene
}

#[test]
fn light_points_keep_the_laws_of_a_shift_in_one_frame() {
    let world = world(scene(glossy(), true));
    let domains: Vec<_> = [Vec3::ZERO, Vec3::new(0.3, 0.0, -0.4), Vec3::new(-0.5, 0.0, 0.2)]
        .map(|at| receiver(&world, at, Time::Now))
        .into();
    let points = points(&world, world.lights.len() as u32);
    check_shift(
        &mut LightPointShift::<_, false>::new(&AcceptAll, None),
        &points,
        &domains,
        0.0,
        near,
    );
    check_shift(
        &mut LightPointShift::<_, true>::new(&AcceptAll, None),
        &points,
        &domains,
        0.0,
        near,
    );
}

#[test]
fn light_points_keep_the_laws_of_a_shift_between_frames() {
    let (then, now) = (world(scene(lambert(), true)), world(later()));
    let remap = LightRemap::new(&then.lights, &now.lights).unwrap();
    let domains = [
        receiver(&then, Vec3::ZERO, Time::Before),
        receiver(&now, Vec3::new(0.05, 0.0, 0.0), Time::Now),
    ];
    let points = points(&then, now.lights.len() as u32);
    let mut map = LightPointShift::<_, false>::new(&AcceptAll, Some(&remap));
    check_shift(&mut map, &points, &domains, 1e-6, near);
    let mut map = LightPointShift::<_, true>::new(&AcceptAll, Some(&remap));
    check_shift(&mut map, &points, &domains, 1e-6, near);
    // What vanished has no image; what came has no origin.
    let gone = LightPoint { light: 4, uv: Vec2::ZERO };
    assert_eq!(then.lights.key(4), [1, u64::MAX]);
    assert!(map.shift(&gone, &domains[0], &domains[1]).is_none());
}

/// The Jacobian as a quotient of two areas: what a small square of (u, v) covers in one frame and
/// in the other.
#[test]
fn the_jacobian_is_the_ratio_of_what_a_square_of_uv_covers() {
    let (then, now) = (world(scene(lambert(), false)), world(later()));
    let remap = LightRemap::new(&then.lights, &now.lights).unwrap();
    let (before, after) =
        (receiver(&then, Vec3::ZERO, Time::Before), receiver(&now, Vec3::ZERO, Time::Now));
    let covered = |world: &World, point: LightPoint| {
        let at = |du: f32, dv: f32| {
            let uv = point.uv + Vec2::new(du, dv);
            let emitter = world.lights.emitter(&world.scene, LightPoint { uv, ..point }).unwrap();
            emitter.place()
        };
        let d = 1e-3;
        (at(d, 0.0) - at(-d, 0.0)).cross(at(0.0, d) - at(0.0, -d)).length()
    };
    let mut map = LightPointShift::<_, false>::new(&AcceptAll, Some(&remap));
    let mut met = vec![0; then.lights.len()];
    let mut omitted = 0.0_f32;
    for mut point in points(&then, then.lights.len() as u32) {
        // Not at the edges of a texel or of the parameter square, where the map has a kink.
        point.uv = point.uv * 0.9 + 0.05;
        let Some(shifted) = map.shift(&point, &before, &after) else { continue };
        let (a, b) = (covered(&then, point), covered(&now, shifted.sample));
        if a == 0.0 && b == 0.0 {
            assert_eq!(shifted.jacobian, 1.0);
            continue;
        }
        // A square over two texels of the sky has no one area.
        let kink = |world: &World, p: LightPoint| {
            let m = |dx: f32, dy: f32| {
                world.lights.measure(LightPoint { uv: p.uv + Vec2::new(dx, dy), ..p })
            };
            let d = 2e-3;
            [m(d, d), m(-d, d), m(d, -d), m(-d, -d)]
                .iter()
                .any(|m| (m / world.lights.measure(p) - 1.0).abs() > 1e-3)
        };
        if kink(&then, point) || kink(&now, shifted.sample) {
            continue;
        }
        met[point.light as usize] += 1;
        let error = shifted.jacobian * a / b - 1.0;
        assert!(error.abs() < 0.01, "{point:?}: {} against {}", shifted.jacobian, b / a);
        omitted = omitted.max((a / b - 1.0).abs());
    }
    // Triangle, sphere, disk and sky; the others are points.
    for light in [0, 1, 2, 7] {
        assert!(met[light] > 3, "{met:?}");
    }
    assert!(omitted > 0.2, "the control, no Jacobian at all, must fail: {omitted}");
}

const CELLS: usize = 4;

fn cell(point: LightPoint) -> usize {
    let at = |u: f32| (u * CELLS as f32) as usize;
    (point.light as usize * CELLS + at(point.uv.y)) * CELLS + at(point.uv.x)
}

/// p̂ times the measure of a unit of (u, v), with visibility if it is in the target.
fn density(receiver: &Receiver<'_>, point: LightPoint, in_target: bool) -> f32 {
    receiver.look(point).map_or(0.0, |(sight, emitter)| {
        let seen = !in_target
            || receiver.sees(
                sight.arrival.direction,
                &emitter,
                &AcceptAll,
                &mut Counters::default(),
            );
        let measure = receiver.world().lights.measure(point);
        if seen { sight.target() * measure } else { 0.0 }
    })
}

/// The mutator without the ratio of measures in its acceptance.
struct WithoutMeasure<M>(M);

impl<F: HitFilter, const IN_TARGET: bool> Mutator
    for WithoutMeasure<LightPointMutator<'_, F, IN_TARGET>>
{
    type State = PointState;

    fn propose(
        &mut self,
        state: &PointState,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<PointState>> {
        let next = self.0.propose(state, random)?.state;
        let lights = &self.0.receiver.world().lights;
        let choice = lights.choice_probability(state.point.light)
            / lights.choice_probability(next.point.light);
        let acceptance = (next.target() / state.target() * choice).min(1.0);
        Some(Proposal { state: next, acceptance })
    }
}

/// The target of each cell by midpoints, and exact samples of it by rejection.
fn exact(receiver: &Receiver<'_>, in_target: bool) -> (Vec<f64>, Vec<LightPoint>) {
    let lights = &receiver.world().lights;
    let count = lights.len() as u32;
    const FINE: usize = 24;
    let mut expected = vec![0.0_f64; count as usize * CELLS * CELLS];
    let mut bound = 0.0_f32;
    let step = 1.0 / (FINE * CELLS) as f32;
    for light in 0..count {
        for (y, x) in (0..FINE * CELLS).flat_map(|y| (0..FINE * CELLS).map(move |x| (y, x))) {
            let uv = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) * step;
            let point = lights.point_with(light, uv);
            let d = density(receiver, point, in_target);
            expected[cell(point)] += f64::from(d);
            if d > 0.0 {
                bound = bound.max(d / lights.choice_probability(light));
            }
        }
    }
    bound *= 1.1;
    let mut random = Stream::from_key(77);
    let mut samples = Vec::new();
    while samples.len() < 40_000 {
        let light = lights.choose(random.word(), random.word());
        let point = lights.point_with(light, Vec2::new(random.uniform(), random.uniform()));
        let d = density(receiver, point, in_target);
        assert!(d <= bound * lights.choice_probability(light), "the bound is too low");
        if random.choose(d, bound * lights.choice_probability(light)) {
            samples.push(point);
        }
    }
    (expected, samples)
}

/// p of the χ² test of where exact samples of p̂ are after `steps` mutations.
fn invariance<const IN_TARGET: bool>(
    receiver: &Receiver<'_>,
    (expected, samples): &(Vec<f64>, Vec<LightPoint>),
    steps: u32,
    planted: bool,
) -> f64 {
    let mut random = Stream::from_key(78 + u64::from(steps));
    let mut observed = vec![0_u64; expected.len()];
    let mut mutator = LightPointMutator::<_, IN_TARGET> {
        receiver,
        filter: &AcceptAll,
        large: 0.3,
        counters: Counters::default(),
    };
    for point in samples {
        let start = mutator.start(*point).unwrap();
        let end = if planted {
            let mut planted = WithoutMeasure(mutator);
            let chain = metropolis(&mut planted, start, steps, &mut random);
            mutator = planted.0;
            chain.state
        } else {
            metropolis(&mut mutator, start, steps, &mut random).state
        };
        // p̂(Y) W' = p̂(X) W.
        let weight = mutated_weight(3.0, start.target(), end.target());
        let kept = weight * end.target() / (3.0 * start.target());
        assert!((kept - 1.0).abs() < 1e-6, "{kept}");
        observed[cell(end.point)] += 1;
    }
    chi_square(&observed, expected).p
}

/// α = 10⁻⁶ a test; the control, a kernel without the ratio of measures, must be rejected.
#[test]
fn mutations_leave_exact_samples_of_the_target_where_they_are() {
    for material in [lambert(), glossy()] {
        let world = world(scene(material, true));
        let receiver = receiver(&world, Vec3::new(0.1, 0.0, -0.05), Time::Now);
        let (open, seen) = (exact(&receiver, false), exact(&receiver, true));
        for steps in [1, 2, 5] {
            let p = invariance::<false>(&receiver, &open, steps, false);
            assert!(p > 1e-6, "{steps} steps: p = {p}");
            let p = invariance::<true>(&receiver, &seen, steps, false);
            assert!(p > 1e-6, "{steps} steps, visibility in the target: p = {p}");
        }
        let p = invariance::<false>(&receiver, &open, 1, true);
        assert!(p < 1e-6, "the control must fail: p = {p}");
    }
}

/// Which emitters a BSDF sample is offered to.
#[derive(Clone, Copy, PartialEq)]
enum Along {
    /// All along its ray.
    All,
    /// The nearest surface only, if it emits: the planted bug.
    Nearest,
}

/// [`candidates`], written once more without vectors, with a choice of what BSDF samples see: the
/// chosen point and Σw.
fn drawn(
    receiver: &Receiver<'_>,
    from: &Candidates<'_>,
    along: Along,
    (seeds, first): (PathSeeds, u32),
    random: &mut Stream,
) -> Option<(LightPoint, f32)> {
    let world = receiver.world();
    let lights = &world.lights;
    let (surface, outgoing) = receiver.surface();
    let mut reservoir = Plain::default();
    // `numbers`: the point's place holds those that it is drawn with.
    let mut offer = |point: LightPoint, emitter: Option<EmitterPoint>, numbers: bool| {
        let Some(sight) = emitter.and_then(|emitter| receiver.sight(&emitter)) else { return };
        let density = match from.tile {
            Some(_) => lights.uniform_density(point),
            None => lights.density_towards(point, surface.position, sight.arrival.geometry),
        };
        let both = from.lights as f32 * density + from.bsdf as f32 * sight.bsdf_density;
        reservoir.stream((point, numbers), sight.target() / both, (), random);
    };
    for i in 0..from.lights {
        if let Some(tile) = from.tile {
            let words = draw4(seeds.seed(first + i / 4 * 4), 0, BLOCK_LIGHT);
            let at = (u64::from(words[i as usize % 4]) * tile.len() as u64) >> 32;
            let TileEntry { emitter, light, uv, .. } = tile[at as usize];
            offer(LightPoint { light, uv: uv.into() }, Some(emitter), false);
        } else {
            let [a, b, u, v] = draw4(seeds.seed(first + i), 0, BLOCK_LIGHT);
            let (light, uv) = (lights.choose(a, b), Vec2::new(unit_float(u), unit_float(v)));
            let emitter = lights.emitter_towards(&world.scene, light, surface.position, uv);
            offer(LightPoint { light, uv }, emitter, true);
        }
    }
    let mut offer = |point: LightPoint| offer(point, lights.emitter(&world.scene, point), false);
    for i in 0..from.bsdf {
        let number = first + from.lights + i;
        let words = draw4(seeds.seed(number), 0, BLOCK_SCATTER);
        let Some(sample) = surface.bsdf.sample(*outgoing, words) else { continue };
        let direction = surface.frame.to_world(sample.wi).normalize();
        let ray = Ray { origin: surface.origin(direction), direction, t_max: f32::INFINITY };
        let hit = world.closest_hit(&ray).filter(|_| along == Along::Nearest);
        if let Some(hit) = hit {
            let point = world.accel.point(&hit);
            let light = lights.of_surface(point.shape, point.element);
            if light != NO_LIGHT {
                offer(lights.point_at(light, &hit, &point));
            }
            continue;
        }
        for (light, environment) in lights.environments() {
            if let Some(uv) = environment.invert(direction) {
                offer(LightPoint { light, uv });
            }
        }
        if along == Along::All {
            world.emitters().unwrap().along(&ray, lights, &mut offer);
        }
    }
    let (point, numbers) = reservoir.selected()?;
    let point = match numbers {
        true => lights.point_towards(point.light, surface.position, point.uv),
        false => point,
    };
    Some((point, reservoir.weight_sum()))
}

/// Sets of light points: those of one light that the receiver sees, and those that it does not.
fn set(receiver: &Receiver<'_>, point: LightPoint) -> Option<usize> {
    let (sight, emitter) = receiver.look(point)?;
    let direction = sight.arrival.direction;
    let seen = receiver.sees(direction, &emitter, &AcceptAll, &mut Counters::default());
    Some(2 * point.light as usize + usize::from(seen))
}

/// E[W g(Y)] against ∫ g for g = p̂ on each set that holds at least 5 % of the light; TOST with δ =
/// 5 %, α = 10⁻³, a fail at 10⁻⁶.
fn contribution_weights(
    receiver: &Receiver<'_>,
    draw: impl Fn(u64) -> Option<(LightPoint, f32)>,
) -> Vec<(usize, Equivalence)> {
    let lights = &receiver.world().lights;
    let mut truth = vec![0.0_f64; 2 * lights.len()];
    const FINE: usize = 250;
    for light in 0..lights.len() as u32 {
        for i in 0..FINE * FINE {
            let uv = Vec2::new((i % FINE) as f32 + 0.5, (i / FINE) as f32 + 0.5) / FINE as f32;
            let point = lights.point_with(light, uv);
            if let Some(set) = set(receiver, point) {
                truth[set] += f64::from(density(receiver, point, false)) / (FINE * FINE) as f64;
            }
        }
    }
    let total: f64 = truth.iter().sum();
    let mut samples = vec![Moments::default(); truth.len()];
    // Means of 200 draws, so that skewness does not matter.
    for batch in 0..2000 {
        let mut sums = vec![0.0; truth.len()];
        for i in 0..200 {
            if let Some((point, shown)) = draw(batch * 200 + i)
                && let Some(set) = set(receiver, point)
            {
                sums[set] += f64::from(shown) / 200.0;
            }
        }
        samples.iter_mut().zip(&sums).for_each(|(sample, sum)| sample.push(*sum));
    }
    (0..truth.len())
        .filter(|&set| truth[set] > 0.05 * total)
        .map(|set| {
            let margin = Margin {
                delta: 0.05 * truth[set],
                equivalence_alpha: 1e-3,
                difference_alpha: 1e-6,
            };
            (set, equivalence(&t_test(&samples[set], truth[set]), &margin))
        })
        .collect()
}

#[test]
fn candidates_have_contribution_weights_on_seen_and_on_occluded_light_points() {
    for (name, material) in [("lambert", lambert()), ("glossy", glossy())] {
        let world = world(scene(material, true));
        let receiver = receiver(&world, Vec3::ZERO, Time::Now);
        let sources = Candidates { lights: 3, bsdf: 2, tile: None, surfaces: true };
        let found = contribution_weights(&receiver, |run| {
            let seeds = PathSeeds::new(run, 0, 0);
            let mut selection = Stream::from_key(run);
            let chosen = candidates(
                &receiver,
                &sources,
                (seeds, 0),
                &mut selection,
                &mut Counters::default(),
            );
            // Σw = W p̂(Y).
            chosen.map(|c| (c.point, c.finish(1.0).weight.get() * c.sight.target()))
        });
        for (set, result) in &found {
            println!("{name} set {set}: {result:?}");
            assert_eq!(result.verdict, Verdict::Pass, "{name}, set {set}: {result:?}");
        }
        let occluded = found.iter().filter(|(set, _)| set % 2 == 0).count();
        assert!(occluded >= 2 && found.len() - occluded >= 3, "{name}: {found:?}");
        // The control: what the BSDF's share of the density promises on occluded points never
        // comes.
        let nearest = contribution_weights(&receiver, |run| {
            let seeds = PathSeeds::new(run, 0, 0);
            drawn(&receiver, &sources, Along::Nearest, (seeds, 0), &mut Stream::from_key(run))
        });
        let lost = |(set, result): &&(usize, Equivalence)| {
            set % 2 == 0 && result.verdict == Verdict::Fail && result.test.difference < 0.0
        };
        // A Lambert surface's share is small here, so only the glossy one is sure to show it.
        let shows = nearest.iter().any(|found| lost(&found));
        assert!(shows || name == "lambert", "{name}, the control: {nearest:?}");
    }
}

/// A map without the Jacobian, or with the inverse one, breaks the law that the product is 1 only
/// where both are wrong alike; what sees them is the integral: Σ over the destination of T's image.
#[test]
fn integrals_see_a_jacobian_left_out_or_inverted() {
    let (then, now) = (world(scene(lambert(), false)), world(later()));
    let remap = LightRemap::new(&then.lights, &now.lights).unwrap();
    let (before, after) =
        (receiver(&then, Vec3::ZERO, Time::Before), receiver(&now, Vec3::ZERO, Time::Now));
    let mut map = LightPointShift::<_, false>::new(&AcceptAll, Some(&remap));
    // Uniform points then have W = measure then; shifted, W |∂T|. E[p̂ W |∂T|] is ∫ p̂ now, by
    // midpoints on both sides.
    for light in [0, 1, 2, 7] {
        let (mut carried, mut left_out, mut inverted, mut truth) = (0.0, 0.0, 0.0, 0.0_f64);
        const FINE: usize = 256;
        for i in 0..FINE * FINE {
            let uv = Vec2::new((i % FINE) as f32 + 0.5, (i / FINE) as f32 + 0.5) / FINE as f32;
            let point = LightPoint { light, uv };
            let Some(Shifted { sample, integrand, jacobian }) = map.shift(&point, &before, &after)
            else {
                continue;
            };
            let weight = f64::from(then.lights.measure(point));
            let shown = f64::from(crate::math::luminance(integrand)) * weight;
            carried += shown * f64::from(jacobian);
            left_out += shown;
            inverted += shown / f64::from(jacobian);
            truth += f64::from(density(&after, sample, false));
        }
        assert!((carried / truth - 1.0).abs() < 1e-5, "light {light}: {}", carried / truth);
        for wrong in [left_out, inverted] {
            assert!((wrong / truth - 1.0).abs() > 0.01, "light {light}: {}", wrong / truth);
        }
    }
}

/// A sphere that shines inward, or both ways: from outside only the near cap can send anything,
/// from inside all of it.
#[test]
fn who_is_outside_a_hollow_light_sees_its_near_cap_alone() {
    for two_sided in [false, true] {
        let mut scene = Scene::new("hollow");
        let grey = scene.add_material(lambert());
        let corners = [[-3.0, -3.0], [-3.0, 3.0], [3.0, 3.0], [3.0, -3.0]];
        let floor = corners.map(|[x, z]| Vec3::new(x, 0.0, z));
        scene.add_shape(Shape::new(mesh(&floor), grey));
        let center = Vec3::new(0.0, 1.0, 0.0);
        let mut ball = Shape::new(Geometry::Sphere { center, radius: 0.5 }, grey);
        ball = ball.emitting(Vec3::ONE);
        ball.reverse_orientation = !two_sided;
        ball.emission.as_mut().unwrap().two_sided = two_sided;
        scene.add_shape(ball);
        let world = world(scene);
        let lights = &world.lights;
        let (outside, inside) = (Vec3::new(0.3, 0.0, 0.2), Vec3::new(0.1, 1.1, -0.2));
        let mut random = Stream::from_key(8);
        let mut near = 0;
        for _ in 0..1000 {
            let uv = Vec2::new(random.uniform(), random.uniform());
            let emitter = lights.emitter(&world.scene, LightPoint { light: 0, uv }).unwrap();
            let place = emitter.place();
            let faces = (outside - place).dot(place - center) > 0.0;
            near += u32::from(faces);
            let arrives = emitter.towards(lights, outside).is_some();
            assert_eq!(arrives, two_sided && faces, "{place}");
            assert!(emitter.towards(lights, inside).is_some(), "{place}");
        }
        assert!((100..900).contains(&near));
    }
}

#[test]
fn candidates_side_by_side_are_those_of_one_at_a_time() {
    let mut scenes = Vec::new();
    for material in [lambert(), glossy()] {
        let mut hollow = scene(material, false);
        for object in &mut hollow.objects {
            for shape in &mut Arc::make_mut(object).shapes {
                if let Some(emission) = &mut shape.emission {
                    emission.two_sided = true;
                }
            }
        }
        scenes.extend([scene(material, false), hollow]);
    }
    let mut chosen = 0;
    for scene in scenes {
        let world = world(scene);
        let mut counters = Counters::default();
        let mut words = Stream::from_key(5);
        let entry = |_| fill_tile(&world, std::array::from_fn(|_| words.word()), &mut counters);
        let tile: Vec<TileEntry> = (0..TILE).map(entry).collect();
        for place in 0..40 {
            let at = Vec3::new(0.07 * place as f32 - 0.9, 0.0, 0.05 * place as f32 - 1.0);
            let receiver = receiver(&world, at, Time::Now);
            let numbers = (PathSeeds::new(1, place, 2), 3);
            for tile in [None, Some(tile.as_slice())] {
                for (lights, bsdf) in [(1, 0), (3, 1), (8, 2), (13, 0), (24, 3), (0, 2)] {
                    let from = Candidates { lights, bsdf, tile, surfaces: true };
                    let stream = Stream::from_key(place.into());
                    let side =
                        candidates(&receiver, &from, numbers, &mut stream.clone(), &mut counters);
                    let one = drawn(&receiver, &from, Along::All, numbers, &mut stream.clone());
                    let one = one.filter(|(point, _)| receiver.look(*point).is_some());
                    assert_eq!(side.is_some(), one.is_some(), "{from:?} at {at}");
                    if let (Some(side), Some((point, sum))) = (side, one) {
                        let target = side.sight.target();
                        let one = Finished::from_sum(Some(point), sum, target, 1.0, 1.0);
                        assert_eq!(side.finish(1.0), one, "{lights}, {bsdf} at {at}");
                        chosen += 1;
                    }
                }
            }
        }
    }
    assert!(chosen > 1000, "{chosen}");
}

#[test]
fn an_entry_whose_density_underflows_is_dark() {
    // 2 · 10³⁵ m², drawn once in 2 · 10¹⁰ times beside strong points: a density of 3 · 10⁻⁴⁶ is 0
    // in f32, the light's target is not.
    let mut scene = Scene::new("vast and faint");
    let floor = scene.add_material(lambert());
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let corners = [c(-3.0, 0.0, -3.0), c(-3.0, 0.0, 3.0), c(3.0, 0.0, 3.0), c(3.0, 0.0, -3.0)];
    scene.add_shape(Shape::new(mesh(&corners), floor));
    let vast = [c(-2e17, 1e17, -2e17), c(4e17, 1e17, -2e17), c(-2e17, 1e17, 4e17)];
    scene.add_shape(Shape::new(mesh(&vast), floor).emitting(Vec3::splat(1e-6)));
    for key in 0..8 {
        let at = Affine3A::from_translation(c(0.0, 10.0, 0.0));
        let kind = LightKind::Point { intensity: Vec3::splat(1e38) };
        scene.lights.push(Light { to_world: Transform::Fixed(at), kind, key });
    }
    let world = world(scene);
    let light = world.lights.of_surface(1, 0);
    // Where each slot of the table begins: its own light, however improbable.
    let bits = (0..9_u128).map(|slot| ((slot << 64) / 9 + 1) as u64);
    let drawn = bits.map(|bits: u64| [(bits >> 32) as u32, bits as u32]);
    let [index, fraction] =
        drawn.into_iter().find(|w| world.lights.choose(w[0], w[1]) == light).unwrap();
    let mut counters = Counters::default();
    let tile = [fill_tile(&world, [index, fraction, 1 << 30, 1 << 30], &mut counters)];
    let receiver = receiver(&world, Vec3::ZERO, Time::Now);
    let point = LightPoint { light, uv: Vec2::splat(0.25) };
    assert_eq!(world.lights.uniform_density(point), 0.0);
    assert!(receiver.look(point).unwrap().0.target() > 0.0);
    let from = Candidates { lights: 8, bsdf: 0, tile: Some(&tile), surfaces: true };
    let numbers = (PathSeeds::new(1, 2, 3), 0);
    let chosen = candidates(&receiver, &from, numbers, &mut Stream::from_key(1), &mut counters);
    assert!(chosen.is_none());
    assert_eq!(counters.weights_rejected, 0);
}
