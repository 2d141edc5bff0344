//! `render`: one picture as a multilayer EXR, with a PNG beside it.

use std::path::PathBuf;

use clap::Args;

use super::args::{FilterArg, PictureArgs, SceneArgs};
use super::{Status, note};
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::{Mean, Session, file_name, guide_layers, sum, technique};
use crate::frame::{FrameLoop, Guides};
use crate::picture::Picture;
use crate::report::{Layer, Tile, ToneMap, write_exr, write_png};
use crate::techniques::Technique;
use crate::{Error, Result};

/// Most estimates of one frame where `--spp` may be spread over frames, so that progress shows and
/// Ctrl-C is heard.
const CHUNK: u32 = 8;

/// Render one picture: EXR with albedo, normal, depth, motion and emission layers, and a PNG beside
/// it
///
/// The layer `color` is the picture; `emission` is the part of it that is seen directly; with
/// --frames, layers `kept.…` show what the technique keeps of every pixel, such as the confidence
/// of its reservoir. --frames shows frame N as a real-time technique would, after N-1 frames of
/// history; --spp averages N complete estimates a pixel. Ctrl-C writes what is done.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  afterimage render scenes/cornell.pbrt --spp 256 --out cornell.exr
        256 estimates a pixel with `nee`
  afterimage render scenes/moving.pbrt --technique nee --frames 30 --out frame30.exr
        the 30th frame of an animation
  afterimage render scenes/cornell.pbrt --motion camera:0.01 --frames 10 --out slid.exr
        the tenth frame of a camera that slides to its right
  afterimage render scenes/cornell.pbrt --look-at 0,1,-4,0,1,0,0,1,0 --spp 64
        another camera: eye, target, up vector
  afterimage render model.glb --frames 64 --accumulate --size 640x360 --out model.exr
        the mean of 64 frames")]
pub(super) struct RenderArgs {
    /// A pbrt or glTF file, or a generator such as many-lights:1000
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A technique's specification; see `afterimage list techniques`
    #[arg(long, value_name = "SPEC", default_value = "nee")]
    technique: String,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    changes: SceneArgs,
    /// Positions of primary rays
    #[arg(long, value_enum, default_value_t = FilterArg::Box)]
    filter: FilterArg,
    /// Show this frame after a cold start [default: 16]
    #[arg(long, value_name = "N", conflicts_with = "spp", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: Option<u32>,
    /// Complete independent estimates a pixel
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: Option<u32>,
    /// Show the mean of all frames instead of the last
    #[arg(long)]
    accumulate: bool,
    /// The file to write [default: SCENE.exr]
    #[arg(long, value_name = "FILE.exr")]
    out: Option<PathBuf>,
}

/// Sums of what is shown.
struct Shown {
    picture: Picture,
    emission: Picture,
    guides: Guides,
    /// Layers of what the technique keeps of every pixel.
    kept: Vec<(&'static str, Vec<f32>)>,
}

pub(super) fn run(args: &RenderArgs) -> Result<Status> {
    let technique = technique(&args.technique)?;
    if let Some(out) = &args.out
        && out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("exr"))
    {
        return Err(Error::usage("--out must name a file that ends in .exr").with_path(out));
    }
    let session = args.picture.open_changed(&args.scene, &args.changes, args.filter, None)?;
    let run = seed(args.picture.seed, SeedUse::Restart, 0, 0);
    let spread = !session.plan(&*technique).keeps_history() && !session.stage.facts().moves();
    let (shown, interrupted) = match args.spp {
        Some(spp) if spread => {
            // Frames without history are independent estimates, so frames of a smaller effort are
            // the same mean.
            let whole = spp / CHUNK;
            let rest = spp % CHUNK;
            let mut frames = session.start(&technique, CHUNK.min(spp) as f32, run)?;
            let last = if rest > 0 && whole > 0 {
                Some((
                    session.start(
                        &technique,
                        rest as f32,
                        seed(args.picture.seed, SeedUse::Restart, 0, 1),
                    )?,
                    rest,
                ))
            } else {
                None
            };
            let run = Frames { count: whole.max(1), effort: CHUNK.min(spp), last };
            accumulate(&session, &mut frames, run)?
        }
        Some(spp) => {
            let mut frames = session.start(&technique, spp as f32, run)?;
            accumulate(&session, &mut frames, Frames { count: 1, effort: spp, last: None })?
        }
        None => {
            let count = args.frames.unwrap_or(16);
            let mut frames = session.start(&technique, 1.0, run)?;
            if args.accumulate {
                accumulate(&session, &mut frames, Frames { count, effort: 1, last: None })?
            } else {
                if args.frames.is_none() {
                    note("showing frame 16 as in real time; --spp 256 gives a smoother picture");
                }
                (last_frame(&session, &*technique, &mut frames, count)?, false)
            }
        }
    };
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("{}.exr", file_name(&session.name))));
    let all = sum(&shown.picture, Some(&shown.emission));
    if all.non_finite() > 0 {
        // Single estimates are finite: sums of them are not.
        note(&format!(
            "warning: {} pixels are brighter than f32 can hold, 3.4e38",
            all.non_finite()
        ));
    }
    let mut layers = vec![Layer::rgb("color", &all)];
    layers.extend(guide_layers(&shown.guides));
    let kept = shown.kept.into_iter();
    layers.extend(kept.map(|(name, values)| Layer::scalar(format!("kept.{name}"), "Y", values)));
    layers.push(Layer::rgb("emission", &shown.emission));
    write_exr(&out, session.shot.size, &layers)?;
    let png = out.with_extension("png");
    write_png(&png, &Tile::new(&all, ToneMap::for_reference(&shown.picture)))?;
    note(&format!("wrote {} and {}", out.display(), png.display()));
    Ok(if interrupted { Status::Interrupted } else { Status::Done })
}

/// The frame numbered `count`, from 1.
fn last_frame(
    session: &Session,
    technique: &dyn Technique,
    frames: &mut FrameLoop,
    count: u32,
) -> Result<Shown> {
    let plan = frames.plan().clone();
    let progress = session.host().begin("frames", u64::from(count));
    for _ in 1..count {
        session.next(frames)?;
        progress.step();
    }
    let frame = session.next(frames)?;
    warn(frame.counters.non_finite);
    let kept = technique.layers(&plan, session.shot.size, &|name| frame.buffer(name));
    let (picture, emission, guides) = (frame.picture(), frame.emission(), frame.guides());
    Ok(Shown { picture, emission, guides, kept })
}

/// Frames whose mean is shown.
struct Frames {
    count: u32,
    /// Estimates of each.
    effort: u32,
    /// One more frame of fewer estimates, and their number.
    last: Option<(FrameLoop, u32)>,
}

/// The mean of frames by their numbers of estimates, and whether the user stopped it early.
fn accumulate(
    session: &Session,
    frames: &mut FrameLoop,
    Frames { count, effort, last }: Frames,
) -> Result<(Shown, bool)> {
    let size = frames.shot().size;
    let progress = session.host().begin("frames", u64::from(count));
    let (mut picture, mut emission) = (Mean::new(size), Mean::new(size));
    let (mut guides, mut non_finite) = (None, 0);
    let mut interrupted = false;
    for _ in 0..count {
        if guides.is_some() && session.host().stopped() {
            interrupted = true;
            break;
        }
        let frame = session.next(frames)?;
        picture.add(&frame.picture(), effort);
        emission.add(&frame.emission(), effort);
        non_finite += frame.counters.non_finite;
        if guides.is_none() {
            guides = Some(frame.guides());
        }
        progress.step();
    }
    if let Some((mut frames, effort)) = last
        && !interrupted
    {
        let frame = session.next(&mut frames)?;
        picture.add(&frame.picture(), effort);
        emission.add(&frame.emission(), effort);
        non_finite += frame.counters.non_finite;
    }
    warn(non_finite);
    let guides = guides.ok_or_else(|| Error::usage("no frame was asked for"))?;
    let (picture, emission) = (picture.picture(), emission.picture());
    Ok((Shown { picture, emission, guides, kept: Vec::new() }, interrupted))
}

fn warn(non_finite: u64) {
    if non_finite > 0 {
        note(&format!("warning: {non_finite} estimates are not finite; they are black"));
    }
}
