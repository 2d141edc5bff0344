//! `inspect`: one pixel, from its surface to its single estimates.

use std::fmt::Write as _;

use clap::Args;
use glam::{Vec2, Vec3};

use super::args::{FilterArg, PictureArgs, parse_pixel};
use super::engine::{self, Engine};
use super::progress::Progress;
use super::seeds::{Part, seed};
use super::{Status, print};
use crate::accel::Ray;
use crate::math::luminance;
use crate::report::figure;
use crate::stats::Moments;
use crate::world::World;
use crate::{Error, Result};

/// Lights that are shown.
const MOST_LIGHTS: usize = 12;

/// Look at one pixel: surface, material, lights, and a technique's estimates one by one
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
    surface(&mut text, frozen.stage.first_world(), args.pixel, engine.shot.size);

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
    for index in 0..args.samples {
        frames.restart(seed(args.picture.seed, Part::Restart, 0, index));
        for _ in 1..args.frames {
            engine::next(&mut frames)?;
        }
        let value = engine::next(&mut frames)?.picture().at(x, y);
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
    print(&text)?;
    Ok(Status::Done)
}

/// The surface in the pixel's centre and the lights as it sees them.
fn surface(text: &mut String, world: &World, pixel: [u32; 2], size: [u32; 2]) {
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
        return;
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
