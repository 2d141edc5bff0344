//! `inspect`: one pixel, from its surface over its candidates to its single estimates and what its reservoir keeps.

use std::fmt::Write as _;

use clap::Args;
use glam::{Vec2, Vec3};

use super::args::{FilterArg, PictureArgs, parse_pixel};
use super::engine::{self, Engine};
use super::progress::Progress;
use super::seeds::{Part, seed};
use super::{Status, print};
use crate::accel::Ray;
use crate::counters::Counters;
use crate::frame::Frame;
use crate::light::LightPoint;
use crate::math::luminance;
use crate::math::rng::{RandomSource, Stream};
use crate::path::power_heuristic;
use crate::report::figure;
use crate::reuse::light_points::{Receiver, Record, Time};
use crate::stats::Moments;
use crate::world::World;
use crate::{Error, Result};

/// Lights that are shown.
const MOST_LIGHTS: usize = 12;

/// Look at one pixel: surface, lights, candidates with their weights, a technique's estimates one by one, its reservoir
#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  afterimage inspect scenes/cornell.pbrt --technique nee --pixel 128,150 --samples 16"
)]
pub(super) struct InspectArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A technique's specification; see `afterimage list techniques`
    #[arg(long, value_name = "SPEC")]
    technique: String,
    /// The pixel, from the upper left corner
    #[arg(long, value_name = "X,Y", value_parser = parse_pixel)]
    pixel: [u32; 2],
    #[command(flatten)]
    picture: PictureArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Point)]
    filter: FilterArg,
    /// Which frame after a cold start
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Independent estimates to show
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
}

pub(super) fn run(args: &InspectArgs) -> Result<Status> {
    let technique = engine::technique(&args.technique)?;
    let engine = Engine::open(&args.scene, &args.picture, args.filter, None)?;
    let [x, y] = args.pixel;
    let [width, height] = engine.shot.size;
    if x >= width || y >= height {
        return Err(Error::usage(format!(
            "--pixel is {x},{y}, but must be inside {width}x{height}"
        )));
    }
    let frozen = engine.frozen(args.frames - 1)?;
    let mut text =
        format!("pixel {x},{y} of {} at {width}x{height}, frame {}\n", engine.scene, args.frames);
    if let Some(receiver) =
        surface(&mut text, frozen.stage.first_world(), args.pixel, engine.shot.size)
    {
        let key = seed(args.picture.seed, Part::Pilot, 0, 0);
        candidates(&mut text, &receiver, args.samples, &mut Stream::from_key(key));
    }

    let plan = engine.plan(&*technique);
    let _ = writeln!(text, "\n`{}` claims to be {}", plan.technique, plan.claim);
    let _ = writeln!(
        text,
        "{:>8}  {:>10} {:>10} {:>10} {:>10}",
        "estimate", "red", "green", "blue", "luminance"
    );
    let progress = Progress::new("estimates", u64::from(args.samples));
    let mut frames = engine.start(&technique, 1, 0)?;
    let (mut moments, mut zeros) = (Moments::new(), 0_u32);
    let mut reservoir = None;
    for index in 0..args.samples {
        frames.restart(seed(args.picture.seed, Part::Restart, 0, index));
        for _ in 1..args.frames {
            engine::next(&mut frames)?;
        }
        let frame = engine::next(&mut frames)?;
        let value = frame.picture().at(x, y);
        reservoir = kept(&frame, (y * width + x) as usize);
        let grey = luminance(value);
        moments.push(f64::from(grey));
        zeros += u32::from(value == Vec3::ZERO);
        let [r, g, b] = value.to_array().map(|v| figure(f64::from(v)));
        let _ = writeln!(
            text,
            "{:>8}  {r:>10} {g:>10} {b:>10} {:>10}",
            index + 1,
            figure(f64::from(grey))
        );
        progress.step();
    }
    drop(progress);
    let deviation = moments.variance().sqrt();
    let _ = writeln!(
        text,
        "mean luminance {}, standard deviation {}, skewness {}, {zeros} of {} black",
        figure(moments.mean()),
        figure(deviation),
        figure(moments.skewness()),
        args.samples
    );
    if let Some(record) = reservoir {
        let _ = writeln!(text, "\nreservoir of the last estimate\n{record}");
    }
    print(&text)?;
    Ok(Status::Done)
}

/// What a technique with reservoirs keeps of a pixel.
fn kept(frame: &Frame<'_>, pixel: usize) -> Option<String> {
    let records: &[Record] = frame.buffer("history").or_else(|| frame.buffer("reservoirs"))?;
    let record = records.get(pixel)?;
    let finished = record.finished();
    let (confidence, age) = (record.confidence(), record.age());
    Some(match finished.sample {
        Some(LightPoint { light, uv }) => format!(
            "light {light} at ({}, {}), target {}, W {}, confidence {confidence}, age {age}",
            figure(f64::from(uv.x)),
            figure(f64::from(uv.y)),
            figure(f64::from(record.target)),
            figure(f64::from(finished.weight.get())),
        ),
        None => format!("no sample, W 0, confidence {confidence}"),
    })
}

/// Light samples as the pixel sees them, with what resampling and MIS make of each. Densities are in the light's own measure.
fn candidates(text: &mut String, receiver: &Receiver<'_>, count: u32, random: &mut Stream) {
    let world = receiver.world();
    let lights = &world.lights;
    if lights.is_empty() || !receiver.scatters() {
        return;
    }
    let _ = writeln!(
        text,
        "\n{count} light samples: target p, densities of light and BSDF sampling, share of light sampling (balance; power, as `nee`),\n\
         weight p / density, seen or not\n{:>8}  {:>10} {:>10} {:>10} {:>8} {:>8} {:>10} {:>5}",
        "light", "target", "by light", "by BSDF", "balance", "power", "weight", "seen"
    );
    let position = receiver.surface().0.position;
    let mut work = Counters::default();
    for _ in 0..count {
        let light = lights.choose(random.word(), random.word());
        let u = Vec2::new(random.uniform(), random.uniform());
        let point = lights.point_towards(light, position, u);
        let Some((sight, emitter)) = receiver.look(point) else {
            let _ = writeln!(text, "{light:>8}  {:>10}", 0);
            continue;
        };
        let density = lights.density_towards(point, position, sight.arrival.geometry);
        let seen = receiver.sees(sight.arrival.direction, &emitter, &world.alpha_mask(), &mut work);
        let balance = density / (density + sight.bsdf_density);
        let power = if sight.arrival.geometry > 0.0 {
            power_heuristic(density, sight.bsdf_density)
        } else {
            1.0
        };
        let [target, density, bsdf, balance, power, weight] =
            [sight.target(), density, sight.bsdf_density, balance, power, sight.target() / density]
                .map(|v| figure(f64::from(v)));
        let seen = if seen { "yes" } else { "no" };
        let _ = writeln!(
            text,
            "{light:>8}  {target:>10} {density:>10} {bsdf:>10} {balance:>8} {power:>8} {weight:>10} {seen:>5}"
        );
    }
}

/// The surface in the pixel's centre and the lights as it sees them; a receiver, if a surface is there.
fn surface<'a>(
    text: &mut String,
    world: &'a World,
    pixel: [u32; 2],
    size: [u32; 2],
) -> Option<Receiver<'a>> {
    let at = Vec2::new(pixel[0] as f32 + 0.5, pixel[1] as f32 + 0.5);
    let ray = world.scene.camera.rays(size).ray(at);
    let hit = world.closest_hit(&Ray {
        origin: ray.origin,
        direction: ray.direction,
        t_max: f32::INFINITY,
    });
    let Some(hit) = hit else {
        let _ =
            writeln!(text, "hits nothing; the sky emits {}", world.escaped_radiance(ray.direction));
        return None;
    };
    let point = world.surface(&hit);
    let placed = world.accel.point(&hit);
    let _ = writeln!(text, "distance   {}", figure(f64::from(hit.t)));
    let _ = writeln!(text, "position   {}", ray.origin + hit.t * ray.direction);
    let _ = writeln!(text, "normal     {}", point.frame.normal);
    let _ = writeln!(text, "albedo     {}", point.bsdf.albedo());
    let emitted = crate::path::emitted(world, &placed, ray.direction);
    let _ = writeln!(text, "emits      {emitted}");
    lights(text, world);
    Some(Receiver::new(world, hit, ray.direction, Time::Now))
}

/// The lights by the probability that they are drawn.
fn lights(text: &mut String, world: &World) {
    let count = world.lights.len() as u32;
    let mut order: Vec<u32> = (0..count).collect();
    order.sort_by(|a, b| {
        world.lights.choice_probability(*b).total_cmp(&world.lights.choice_probability(*a))
    });
    let _ = writeln!(text, "\n{count} lights\n{:>8}  {:>12}", "light", "chosen with");
    for light in order.iter().take(MOST_LIGHTS) {
        let _ = writeln!(
            text,
            "{light:>8}  {:>12}",
            figure(f64::from(world.lights.choice_probability(*light)))
        );
    }
    if order.len() > MOST_LIGHTS {
        let _ = writeln!(text, "     ...  {} more", order.len() - MOST_LIGHTS);
    }
}
