//! A steady frame of a still scene allocates nothing: every buffer is the loop's, made when the loop is.
//!
//! A test program of its own, because it counts what the whole process allocates.

use std::alloc::System;
use std::sync::Arc;

use afterimage::frame::{Frame, FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::generate;
use afterimage::techniques;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Frames until every buffer has its history, and frames that are watched.
const WARM_UP: usize = 4;
const WATCHED: usize = 8;

/// Windows of frames: a queue of the thread pool may grow late, but not every time.
const WINDOWS: usize = 3;

/// The fewest allocations that a window of frames of a still scene makes; `look` gets every frame.
fn allocations(spec: &str, size: [u32; 2], look: impl Fn(&Frame<'_>)) -> usize {
    // Enough lights for tiles of them.
    let stage = Stage::new(generate("many-lights:1200").unwrap()).unwrap();
    let shot = Shot { size, depth: 3, filter: Filter::Point, run: 1, effort: 2, fps: 30 };
    let technique = Arc::from(techniques::parse(spec).unwrap());
    let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
    for _ in 0..WARM_UP {
        frames.render().unwrap();
    }
    let window = |_| {
        let region = Region::new(ALLOCATOR);
        for _ in 0..WATCHED {
            look(&frames.render().unwrap());
        }
        let change = region.change();
        change.allocations + change.reallocations
    };
    (0..WINDOWS).map(window).min().unwrap_or_default()
}

#[test]
fn steady_frames_allocate_nothing_and_a_picture_is_seen_to() {
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for spec in
            ["nee", "ris", "restir-di", "restir-di:visibility=wis-cv,mutations=1,boiling=0.5"]
        {
            for size in [[32, 24], [128, 96]] {
                let found = pool.install(|| allocations(spec, size, |_| ()));
                assert_eq!(found, 0, "`{spec}` with {threads} threads at {size:?}");
            }
        }
    }
    // The control: whoever asks for a picture gets one of his own.
    let found = allocations("nee", [32, 24], |frame| drop(frame.picture()));
    assert!(found >= WATCHED, "{found}");
}
