//! Scenes that a host moves, and whether techniques keep their claims on them: shared by `reuse`
//! and `matrix`.
//!
//! Samples are means of one frame over independent restarts. TOST with δ as stated, α = 10⁻³, a
//! fail at 10⁻⁶; the control is the truth × (1 + 2 δ), which must fail.

use std::sync::Arc;

use afterimage::accel::{AcceptAll, BuildOptions, Ray};
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::luminance;
use afterimage::math::rng::{RandomSource, Stream};
use afterimage::plan::{Claim, Shot};
use afterimage::reuse::light_points::{Receiver, Time};
use afterimage::scene::Scene;
use afterimage::stats::{
    Equivalence, Margin, Moments, Verdict, equivalence, samples_for_bias, t_test,
};
use afterimage::techniques::Technique;
use afterimage::world::World;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// A scene that a host moves.
pub(crate) struct Course {
    pub(crate) base: Scene,
    /// Changes the base to how it stands in a frame.
    pub(crate) at: fn(&mut Scene, u32),
}

impl Course {
    pub(crate) fn frame(&self, index: u32) -> Scene {
        let mut scene = self.base.clone();
        (self.at)(&mut scene, index);
        scene
    }

    pub(crate) fn stage(&self) -> Stage {
        Stage::moving(self.base.clone()).unwrap()
    }
}

/// Direct light at every pixel's centre, by one point in each of `strata`² cells of every light.
pub(crate) fn truth(scene: &Scene, shot: Shot, strata: u32) -> Vec<Vec3> {
    let world = World::new(scene.clone(), &BuildOptions::default()).unwrap();
    let rays = world.scene.camera.rays(shot.size);
    let lights = &world.lights;
    let pixel = |index: u32| {
        let at = Vec2::new((index % shot.size[0]) as f32, (index / shot.size[0]) as f32) + 0.5;
        let ray = rays.ray(at);
        let (origin, direction) = (ray.origin, ray.direction);
        let Some(hit) = world.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY }) else {
            return Vec3::ZERO;
        };
        let receiver = Receiver::new(&world, hit, direction, Time::Now);
        let mut random = Stream::from_key(u64::from(index));
        let mut sum = Vec3::ZERO;
        for cell in 0..strata * strata {
            let offset = Vec2::new((cell % strata) as f32, (cell / strata) as f32);
            for light in 0..lights.len() as u32 {
                let uv = offset + Vec2::new(random.uniform(), random.uniform());
                let point = lights.point_with(light, uv / strata as f32);
                if let Some((sight, emitter)) = receiver.look(point)
                    && receiver.sees(
                        sight.arrival.direction,
                        &emitter,
                        &AcceptAll,
                        &mut Counters::default(),
                    )
                {
                    sum += sight.integrand * lights.measure(point);
                }
            }
        }
        sum / (strata * strata) as f32
    };
    (0..shot.pixels() as u32).into_par_iter().map(pixel).collect()
}

/// Luminance and channels of the mean over the pixels of a region.
pub(crate) fn means(pixels: &[Vec3], region: &[bool]) -> [f64; 4] {
    let (mut sum, mut count) = ([0.0; 4], 0.0);
    for (rgb, _) in pixels.iter().zip(region).filter(|(_, inside)| **inside) {
        for (sum, value) in sum.iter_mut().zip([luminance(*rgb), rgb.x, rgb.y, rgb.z]) {
            *sum += f64::from(value);
        }
        count += 1.0;
    }
    assert!(count > 0.0, "the region is empty");
    sum.map(|sum| sum / count)
}

pub(crate) type Sample = [Moments; 4];

/// What is compared in one frame, and where.
pub(crate) struct Look {
    pub(crate) age: u32,
    pub(crate) region: Vec<bool>,
    pub(crate) truth: Vec<Vec3>,
}

impl Look {
    /// Everywhere, at one age.
    pub(crate) fn whole(course: &Course, shot: Shot, age: u32) -> Self {
        Self::finer(course, shot, age, 24)
    }

    /// The same with more strata, for lights of many texels and for regions of few pixels.
    pub(crate) fn finer(course: &Course, shot: Shot, age: u32, strata: u32) -> Self {
        let truth = truth(&course.frame(age), shot, strata);
        Self { age, region: vec![true; truth.len()], truth }
    }
}

/// Renders `runs` restarts and takes the means of each look.
pub(crate) fn restarts(
    (course, stage): (&Course, &Stage),
    technique: &Arc<dyn Technique>,
    shot: Shot,
    looks: &[Look],
    runs: std::ops::Range<u64>,
) -> Vec<Sample> {
    let last = looks.iter().map(|look| look.age).max().unwrap_or(0);
    let scenes: Vec<Scene> = (0..=last).map(|i| course.frame(i)).collect();
    let moving = stage.facts().moves();
    let chunk = |runs: &[u64]| {
        let mut frames = FrameLoop::new(technique.clone(), stage, shot).unwrap();
        let mut samples = vec![Sample::default(); looks.len()];
        for run in runs {
            frames.restart(shot.run + run);
            for scene in &scenes {
                let frame =
                    if moving { frames.render_scene(scene.clone()) } else { frames.render() };
                let frame = frame.unwrap();
                let bad = (frame.counters.non_finite, frame.counters.weights_rejected);
                assert_eq!(bad, (0, 0), "{}", technique.spec());
                for (look, sample) in looks.iter().zip(&mut samples) {
                    if look.age == frame.index {
                        let means = means(&frame.picture().pixels, &look.region);
                        sample.iter_mut().zip(means).for_each(|(s, mean)| s.push(mean));
                    }
                }
            }
        }
        samples
    };
    let runs: Vec<u64> = runs.collect();
    let parts: Vec<Vec<Sample>> = runs.par_chunks(16).map(chunk).collect();
    parts
        .into_iter()
        .reduce(|mut all, part| {
            for (a, b) in all.iter_mut().flatten().zip(part.iter().flatten()) {
                a.merge(b);
            }
            all
        })
        .expect("a run")
}

/// TOST of a sample against a truth, channel by channel.
pub(crate) fn compare(sample: &Sample, truth: [f64; 4], delta: f64) -> [Equivalence; 4] {
    std::array::from_fn(|i| {
        let margin =
            Margin { delta: delta * truth[i], equivalence_alpha: 1e-3, difference_alpha: 1e-6 };
        equivalence(&t_test(&sample[i], truth[i]), &margin)
    })
}

/// Restarts with which all looks pass with a probability of 99.9 % where there is no bias, by a
/// pilot; then these, on seeds of their own.
pub(crate) fn sampled(
    at: (&Course, &Stage),
    technique: &Arc<dyn Technique>,
    shot: Shot,
    looks: &[Look],
    delta: f64,
) -> Vec<Sample> {
    let pilot = restarts(at, technique, Shot { run: 1 << 40, ..shot }, looks, 0..64);
    let c = pilot
        .iter()
        .flatten()
        .map(|channel| channel.variance().sqrt() / channel.mean())
        .fold(0.0, f64::max);
    // The factor is for what the pilot does not know of c.
    let runs = samples_for_bias(delta, 1.15 * c, 2e-3, 0.9995).ceil().clamp(64.0, 4e4);
    restarts(at, technique, shot, looks, 0..runs as u64)
}

/// A pass, or the interval of one where a few bright restarts make the sample too skewed to count
/// as one: weights that are known only after the selection (1/Z) have no bound.
pub(crate) fn passes(result: &Equivalence) -> bool {
    let inside = result.interval.0 > -result.delta && result.interval.1 < result.delta;
    let skewed = result.test.heavy_tailed() && inside && result.test.p > 1e-6;
    result.verdict == Verdict::Pass || skewed
}

pub(crate) fn fails(result: &Equivalence) -> bool {
    result.verdict == Verdict::Fail || (result.test.heavy_tailed() && result.test.p < 1e-6)
}

/// Asserts that a configuration which claims to be unbiased is, at each look, in luminance and
/// every channel.
pub(crate) fn assert_unbiased(
    at: (&Course, &Stage),
    technique: &Arc<dyn Technique>,
    shot: Shot,
    looks: &[Look],
    delta: f64,
) {
    let spec = technique.spec();
    let claim = technique.plan(at.1.facts(), &shot).claim;
    assert_eq!(claim, Claim::Unbiased, "{spec}");
    let samples = sampled(at, technique, shot, looks, delta);
    let mut wrong = Vec::new();
    for (look, sample) in looks.iter().zip(&samples) {
        let truth = means(&look.truth, &look.region);
        let results = compare(sample, truth, delta);
        let found = results.map(|r| 100.0 * r.test.difference / r.delta * delta);
        println!("{spec} | age {} | n {} | bias % {found:+.3?}", look.age, sample[0].count());
        let control = compare(sample, truth.map(|t| t * (1.0 + 2.0 * delta)), delta);
        if !results.iter().all(passes) || !control.iter().all(fails) {
            wrong.push(format!("age {}: bias % {found:+.3?}, {results:?}", look.age));
        }
    }
    assert!(wrong.is_empty(), "{spec}:\n{}", wrong.join("\n"));
}
