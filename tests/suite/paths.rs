//! Paths as samples: does the tree of one walk hold what its path tracer shows?

use afterimage::accel::{AcceptAll, Ray};
use afterimage::counters::Counters;
use afterimage::frame::Stage;
use afterimage::light::LightPoint;
use afterimage::math::luminance;
use afterimage::math::rng::{Stream, path_seed};
use afterimage::path::{Limits, Steps, sampled, scattered_radiance, walk};
use afterimage::resampling::{Plain, Reservoir};
use afterimage::reuse::paths::{Anchor, Connects, Ending, NO_LOBE, PathSample, Tree};
use afterimage::scene::{LightKind, Scene};
use afterimage::world::World;
use glam::{Affine3A, Vec2, Vec3};

use crate::support::{environment, light, room};

const SIZE: [u32; 2] = [24, 16];

/// Rooms with a sky, a point light, or neither.
fn rooms() -> [Scene; 3] {
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
                let mut tree = Tree::new(&world.lights, connects, how, &mut reservoir, &mut random);
                let steps = Steps::<{ sampled::ONE }, _> { world, filter: &AcceptAll };
                walk::<_, true, _>(&steps, seed, primary, limits, &mut tree, &mut counters[1]);
                assert_eq!(
                    tree.sum.to_array().map(f32::to_bits),
                    shown.to_array().map(f32::to_bits)
                );
                assert_eq!(counters[0], counters[1]);
                let target = reservoir.selected().map_or(0.0, |sample: PathSample| sample.target());
                let finished =
                    reservoir.finish::<afterimage::resampling::PrimarySample>(target, 1.0);
                let estimate = target * finished.weight.get();
                assert!((estimate - luminance(shown)).abs() <= 1e-5 * luminance(shown));
                if finished.sample.is_some() { lit += 1 } else { dark += 1 }
            });
            assert!(lit > 500 && dark > 0, "{lit} walks found light, {dark} none");
        }
    }
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
                Tree::new(&world.lights, connects, (seed, 1), &mut reservoir, &mut random);
            let steps = Steps::<{ sampled::ONE }, _> { world, filter: &AcceptAll };
            walk::<_, true, _>(&steps, seed, primary, limits, &mut tree, &mut Counters::default());
            let Some(sample): Option<PathSample> = reservoir.selected() else { return };
            assert!(sample.target() > 0.0 && sample.seed == seed && sample.last < 8);
            let Some(kept) = sample.reconnection else {
                // Light samples always have something to keep.
                assert!(!matches!(sample.ending, Ending::Light { .. }));
                met[7] += 1;
                return;
            };
            assert!(kept.vertex >= 1 && kept.vertex <= sample.last + 1);
            assert!(kept.density > 0.0 && kept.radiance.max_element() > 0.0, "{sample:?}");
            assert!((kept.direction.length() - 1.0).abs() < 1e-5);
            let (end, last) = (kept.vertex == sample.last + 1, kept.vertex == sample.last);
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
                (Ending::Sky, Anchor::Sky { light }) => {
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
