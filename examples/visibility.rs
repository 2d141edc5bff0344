//! Shadow noise of `restir-di` by visibility policy: the RMSPE inside penumbrae at steady state,
//! with shadow rays and bias beside it.
//!
//! ```sh
//! cargo run --release --example visibility                      # scenes/penumbra.pbrt and a shared scene, 64x64
//! cargo run --release --example visibility -- SCENE 96x54
//! # one policy, 30 frames, nothing measured: for a profiler that counts instructions
//! cargo run --release --example visibility -- SCENE 64x64 restir-di:visibility=wis
//! ```
//!
//! | here | meaning |
//! |---|---|
//! | V | shadowed over unshadowed direct light of a pixel, both from 4096 light samples with a ray each |
//! | mask | pixels with 0.02 < V < 0.98 whose surface has no delta lobe |
//! | RMSPE | of frame 30 inside the mask; a mean over 24 restarts with its 95 % interval |
//! | ratio | RMSPE over that of the first policy, restart by restart |
//! | bias | of the mask's mean over frames 21 to 30 |

use std::path::Path;
use std::sync::Arc;

use afterimage::accel::{AcceptAll, HitFilter, Ray};
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::luminance;
use afterimage::math::rng::{PathSeeds, Stream};
use afterimage::metrics::{Comparison, Picture};
use afterimage::plan::{Filter, Shot};
use afterimage::reuse::light_points::{Candidates, Receiver, Time, candidates};
use afterimage::scene::load::load;
use afterimage::stats::{Moments, t_test};
use afterimage::world::World;
use afterimage::{Result, techniques};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

const FRAMES: u32 = 30;
/// Of these, the last ones enter the bias.
const MEANT: u32 = 10;
const RESTARTS: u64 = 24;
const SAMPLES: u32 = 4096;

/// The first is what the others are compared with: stored outcomes of any age, but only for the
/// pixel that they were found at.
const POLICIES: &[&str] = &[
    "restir-di:mis=constant,visibility=reuse,visibility-age=255,visibility-distance=0",
    "restir-di:mis=constant,visibility=wis",
    "restir-di:mis=constant,visibility=wis-cv",
    "restir-di:mis=constant,visibility=reuse,visibility-age=255,visibility-distance=0,decoupled=true",
    "restir-di:mis=defensive,visibility=reuse,visibility-age=255,visibility-distance=0",
    "restir-di:mis=defensive,visibility=wis",
    "restir-di:mis=defensive,visibility=wis-cv",
    "restir-di:mis=defensive,visibility=trace",
    "restir-di:mis=defensive,visibility=in-target",
];

/// Direct light, shadowed and not, of one pixel.
#[derive(Clone, Copy, Default)]
struct Lit {
    shadowed: Vec3,
    unshadowed: Vec3,
    delta: bool,
}

fn lit(
    world: &World,
    filter: &impl HitFilter,
    (pixel, position): (u32, Vec2),
    size: [u32; 2],
) -> Lit {
    let ray = world.scene.camera.rays(size).ray(position);
    let primary = Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
    let Some(hit) = world.camera_hit_with(&primary, filter) else { return Lit::default() };
    let receiver = Receiver::new(world, hit, ray.direction, Time::Now);
    let bsdf = &receiver.surface().0.bsdf;
    let delta = (0..bsdf.lobe_count()).any(|lobe| bsdf.is_delta(lobe));
    let sources = Candidates { lights: 1, bsdf: 0, tile: None, surfaces: false };
    let seeds = PathSeeds::new(u64::MAX, pixel, 0);
    let mut selection = Stream::from_key(u64::from(pixel));
    let mut counters = Counters::default();
    let mut sums = [glam::DVec3::ZERO; 2];
    for sample in 0..SAMPLES {
        let chosen =
            candidates(&receiver, &sources, (seeds, sample), &mut selection, &mut counters);
        let Some(chosen) = chosen else { continue };
        let light = (chosen.integrand() * chosen.finish(1.0).weight.get()).as_dvec3();
        sums[1] += light;
        let direction = chosen.sight.arrival.direction;
        if receiver.sees(direction, &chosen.emitter, filter, &mut counters) {
            sums[0] += light;
        }
    }
    let [shadowed, unshadowed] = sums.map(|sum| (sum / f64::from(SAMPLES)).as_vec3());
    Lit { shadowed, unshadowed, delta }
}

/// The shadowed picture, and where penumbrae are.
fn reference(world: &World, size: [u32; 2]) -> (Picture, Vec<bool>) {
    let pixel = |at: u32| {
        let position = Vec2::new((at % size[0]) as f32 + 0.5, (at / size[0]) as f32 + 0.5);
        if world.has_alpha {
            lit(world, &world.alpha_mask(), (at, position), size)
        } else {
            lit(world, &AcceptAll, (at, position), size)
        }
    };
    let pixels: Vec<Lit> = (0..size[0] * size[1]).into_par_iter().map(pixel).collect();
    let in_penumbra = |lit: &Lit| {
        let seen = luminance(lit.shadowed) / luminance(lit.unshadowed);
        !lit.delta && seen > 0.02 && seen < 0.98
    };
    let mask = pixels.iter().map(in_penumbra).collect();
    (Picture::new(size[0], size[1], pixels.iter().map(|lit| lit.shadowed).collect()), mask)
}

/// Mean luminance inside the mask.
fn mean(picture: &Picture, mask: &[bool]) -> f64 {
    let inside = picture.pixels.iter().zip(mask).filter(|(_, inside)| **inside);
    inside.map(|(rgb, _)| f64::from(luminance(*rgb))).sum()
}

fn shot(size: [u32; 2]) -> Shot {
    Shot { size, depth: 2, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 }
}

fn figure(moments: &Moments, scale: f64) -> String {
    let (low, high) = moments.estimate().interval(0.95);
    format!("{:.3} ±{:.3}", scale * moments.mean(), scale * 0.5 * (high - low))
}

fn measure(stage: &Stage, size: [u32; 2]) -> Result<()> {
    let (reference, mask) = reference(stage.first_world(), size);
    let inside = mask.iter().filter(|inside| **inside).count();
    println!("{} of {} pixels in penumbrae", inside, mask.len());
    if inside == 0 {
        return Ok(());
    }
    println!(
        "{:>16} {:>16} {:>18} {:>10} {:>9}",
        "RMSPE %", "ratio", "bias %", "shadow/px", "all/px"
    );
    let mut first: Vec<f64> = Vec::new();
    for policy in POLICIES {
        let technique = Arc::from(techniques::parse(policy)?);
        let mut frames = FrameLoop::new(technique, stage, shot(size))?;
        let [mut rmspe, mut ratio, mut bias] = [Moments::new(); 3];
        let (mut shadow, mut all) = (0, 0);
        for restart in 0..RESTARTS {
            frames.restart(1000 + restart);
            let mut shown = 0.0;
            for at in 1..=FRAMES {
                let frame = frames.render()?;
                if at > FRAMES - MEANT {
                    shown += mean(&frame.picture(), &mask) / f64::from(MEANT);
                }
                if at == FRAMES {
                    let counters = frame.counters;
                    shadow += counters.shadow_rays;
                    all += counters.shadow_rays + counters.bounce_rays + counters.emitter_rays;
                    let picture = frame.picture();
                    let found = Comparison::new(&picture, &reference, Some(&mask))?.rmspe().value;
                    rmspe.push(found);
                    if first.len() <= restart as usize {
                        first.push(found);
                    }
                    ratio.push(found / first[restart as usize]);
                }
            }
            bias.push(shown / mean(&reference, &mask) - 1.0);
        }
        let per_pixel = |rays: u64| rays as f64 / (RESTARTS as usize * mask.len()) as f64;
        let sure = if t_test(&bias, 0.0).p < 1e-4 { "!" } else { " " };
        println!(
            "{:>16} {:>16} {:>17}{sure} {:>10.2} {:>9.2}  {policy}",
            figure(&rmspe, 100.0),
            figure(&ratio, 1.0),
            figure(&bias, 100.0),
            per_pixel(shadow),
            per_pixel(all)
        );
    }
    Ok(())
}

/// Only the frames of one policy.
fn run(stage: &Stage, size: [u32; 2], policy: &str) -> Result<()> {
    let technique = Arc::from(techniques::parse(policy)?);
    let mut frames = FrameLoop::new(technique, stage, shot(size))?;
    let mut light = 0.0;
    for _ in 0..FRAMES {
        light = frames.render()?.picture().mean_luminance();
    }
    println!("{policy}: mean luminance {light:.4} in frame {FRAMES}");
    Ok(())
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let home = Path::new(env!("CARGO_MANIFEST_DIR"));
    let scenes = match arguments.first() {
        Some(scene) => vec![Path::new(scene).to_path_buf()],
        None => ["scenes/penumbra.pbrt", "../shared/scenes/cornell-box/scene.pbrt"]
            .map(|scene| home.join(scene))
            .to_vec(),
    };
    let size = match arguments.get(1) {
        Some(text) => text
            .split_once('x')
            .and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]))
            .ok_or_else(|| format!("the size is `{text}`, but must be like 96x54"))?,
        None => [64, 64],
    };
    for scene in scenes {
        if arguments.is_empty() && !scene.exists() {
            println!("skipped {}: there is no such file", scene.display());
            continue;
        }
        let stage = Stage::new(load(&scene)?.scene)?;
        println!("{} at {}x{}", stage.scene().name, size[0], size[1]);
        match arguments.get(2) {
            Some(policy) => run(&stage, size, policy)?,
            None => measure(&stage, size)?,
        }
    }
    Ok(())
}
