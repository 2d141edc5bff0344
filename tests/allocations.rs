//! A steady frame of a still scene allocates nothing: every buffer is the loop's, made when the
//! loop is. And what is made is given back (Z4, Z8 of `docs/testing.md`).
//!
//! A test program of its own, because it counts what the whole process allocates; its tests take
//! turns.

use std::alloc::System;
use std::sync::{Arc, Mutex};

use afterimage::frame::{Frame, FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::generate;
use afterimage::techniques;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

static TURN: Mutex<()> = Mutex::new(());

/// Frames until every buffer has its history, and frames that are watched.
const WARM_UP: usize = 4;
const WATCHED: usize = 8;

/// Windows of frames: a queue of the thread pool may grow late, but not every time.
const WINDOWS: usize = 3;

/// The fewest allocations that a window of frames of a still scene makes; `look` gets every frame.
fn allocations(spec: &str, size: [u32; 2], look: impl Fn(&Frame<'_>)) -> usize {
    // Enough lights for tiles of them.
    let stage = Stage::new(generate("many-lights:1200").unwrap()).unwrap();
    let shot = Shot { size, depth: 3, filter: Filter::Point, run: 1, effort: 2.0, fps: 30 };
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
    let _turn = TURN.lock().unwrap();
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

/// Scenes, stages and loops that come and go leave nothing behind; the control keeps one.
#[test]
fn what_is_made_is_given_back() {
    let _turn = TURN.lock().unwrap();
    let make = |run: u64| {
        let stage = Stage::new(generate("many-lights:8").unwrap()).unwrap();
        let shot = Shot { size: [8, 6], depth: 3, filter: Filter::Box, run, effort: 1.0, fps: 30 };
        let specs = ["nee", "restir-di", "restir-di:visibility=wis-cv,rounds=2"];
        let spec = specs[run as usize % specs.len()];
        let technique = Arc::from(techniques::parse(spec).unwrap());
        let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
        for _ in 0..3 {
            frames.render().unwrap();
        }
        frames
    };
    let kept = |count: u64, keep: bool| -> i64 {
        let region = Region::new(ALLOCATOR);
        let mut last = None;
        for run in 0..count {
            let frames = make(run);
            last = keep.then_some(frames);
        }
        let change = region.change();
        drop(last);
        // What a reallocation adds or frees is in both already.
        change.bytes_allocated as i64 - change.bytes_deallocated as i64
    };
    // Pools, tables and queues that stay are made by the first.
    kept(50, false);
    let few = kept(100, false);
    let many = kept(2000, false);
    assert!(many - few < 4096, "{few} bytes after 100, {many} after 2000");
    assert!(kept(10, true) > 4096, "the control keeps a loop");
}
