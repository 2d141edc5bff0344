//! What lies in the buffers is true: for every pixel, in every buffer of records that a frame
//! leaves, each stored value is compared with the value itself, found again from the scene.
//!
//! The control looks from the next pixel, where nearly nothing of it holds.

use std::sync::Arc;

use afterimage::accel::{AcceptAll, BuildOptions};
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::luminance;
use afterimage::pass::PrimaryHit;
use afterimage::plan::Shot;
use afterimage::reuse::light_points::{Receiver, Record, Time};
use afterimage::reuse::{Control, Reused};
use afterimage::techniques::parse;
use afterimage::world::World;
use glam::Vec2;

use crate::course::Course;
use crate::matrix::courses;
use crate::support::shot;

/// Buffers of records.
const PLACES: [&str; 4] = ["reservoirs", "bounce", "second bounce", "history"];

/// The buffer of estimates that belongs to one of records. Rounds before the last update the
/// estimates in place, where their own buffer is the records' no more.
fn estimates_of(place: &str, keys: &str) -> Option<&'static str> {
    let (rounds, shown_only) = (keys.contains("rounds="), keys.contains("spatial=display"));
    match place {
        "reservoirs" => (!rounds || shown_only).then_some("controls"),
        "bounce" => Some(if shown_only { "bounce controls" } else { "controls" }),
        "history" => Some("history controls"),
        _ => None,
    }
}

/// A receiver that is looked at through a pixel.
fn receiver<'w>(
    world: &'w World,
    hits: &[PrimaryHit],
    shot: Shot,
    at: usize,
) -> Option<Receiver<'w>> {
    let [width, _] = shot.size;
    let pixel = Vec2::new((at as u32 % width) as f32, (at as u32 / width) as f32);
    let ray = world.scene.camera.rays(shot.size).ray(pixel + 0.5);
    Some(Receiver::new(world, hits[at].get()?, ray.direction, Time::Now))
}

/// p̂ without visibility and V of a record's sample, as a receiver sees it.
fn seen(receiver: &Receiver<'_>, record: &Record) -> (f32, bool) {
    let Some(sample) = record.finished().sample else { return (0.0, false) };
    match receiver.look(sample) {
        None => (0.0, false),
        Some((sight, emitter)) => {
            let direction = sight.arrival.direction;
            let seen = receiver.sees(direction, &emitter, &AcceptAll, &mut Counters::default());
            (luminance(sight.integrand), seen)
        }
    }
}

/// What is found while records are looked at.
#[derive(Debug, Default)]
struct Found {
    records: u32,
    /// Records whose stored visibility was compared with a ray, and how many of them were hidden.
    compared: u32,
    hidden: u32,
    /// Records whose target would be right at the next pixel, too.
    elsewhere: u32,
}

/// Compares all records of a technique's frames 0 to 3 of a course.
fn check(keys: &str, course: &Course, stage: &Stage, effort: u32) -> Found {
    let shot = shot([22, 11], 2, effort);
    let spec = format!("restir-di:candidates=4,radius=4,mature=0,{keys}");
    let policy = keys.split(',').next().unwrap().trim_start_matches("visibility=");
    let alone = keys.contains("cap=0") && keys.contains("neighbours=0");
    let mut frames = FrameLoop::new(Arc::from(parse(&spec).unwrap()), stage, shot).unwrap();
    let chains = effort as usize;
    let mut found = Found::default();
    for index in 0..4 {
        let scene = course.frame(index);
        // With a tree for each object, as the loop has, so that hits have the same numbers.
        let options = BuildOptions { two_level: Some(true), ..BuildOptions::default() };
        let world = World::new(scene.clone(), &options).unwrap();
        let frame = frames.render_scene(scene).unwrap();
        let hits: &[PrimaryHit] = frame.buffer("hits").unwrap();
        for place in PLACES {
            let Some(records) = frame.buffer::<Record>(place) else { continue };
            let controls = estimates_of(place, keys).and_then(|name| frame.buffer::<Control>(name));
            for (at, record) in records.iter().enumerate() {
                let pixel = at / chains;
                let Some(receiver) = receiver(&world, hits, shot, pixel) else { continue };
                assert!(record.age() <= index, "{spec}: a sample of {} frames", record.age());
                if record.finished().sample.is_none() {
                    assert_eq!(record.target, 0.0, "{spec}: a target of no sample");
                    continue;
                }
                let (target, visible) = seen(&receiver, record);
                let what = format!("{spec}, {place} of chain {at} in frame {index}: {record:?}");
                let error = (record.target - target).abs() / target;
                assert!(error < 1e-5, "{what} has a target of {target} here");
                found.records += 1;
                let next = (pixel + 1) % shot.pixels();
                if let Some(other) = self::receiver(&world, hits, shot, next) {
                    let there = seen(&other, record).0;
                    found.elsewhere += u32::from((record.target - there).abs() < 1e-5 * target);
                }
                let stored = match policy {
                    "in-target" => Some(true),
                    "bitterli" if alone => Some(true),
                    "reuse" => {
                        let stored = Reused::unpack(record.policy_bits());
                        (stored.age == 0 && stored.distance == 0).then_some(stored.visible)
                    }
                    "wis-cv" => controls.map(|controls| controls[at].visible()),
                    _ => None,
                };
                if let Some(stored) = stored {
                    assert_eq!(stored, visible, "{what}: its visibility is not what a ray says");
                    found.compared += 1;
                    found.hidden += u32::from(!visible);
                }
            }
        }
    }
    found
}

#[test]
fn targets_and_visibility_in_every_record_are_those_of_its_pixel() {
    let [still, .., all] = courses();
    for (name, course) in [still, all] {
        let stage = course.stage();
        for policy in ["trace", "in-target", "bitterli", "reuse", "wis", "wis-cv"] {
            for more in [
                "cap=0,neighbours=0",
                "neighbours=0",
                "cap=0,neighbours=2",
                "neighbours=2",
                "neighbours=2,mutations=2",
                "rounds=2,neighbours=2,taps=random",
                "rounds=4,spatial=display",
                "decoupled=true,neighbours=3",
            ] {
                if policy == "wis" && more.contains("decoupled") {
                    continue;
                }
                let keys = format!("visibility={policy},{more}");
                let effort = if more == "neighbours=2" { 3 } else { 1 };
                let found = check(&keys, &course, &stage, effort);
                println!("{name} {keys} {found:?}");
                assert!(found.records > 300, "{keys}: {found:?}");
                assert!(found.elsewhere < found.records / 10, "the control must fail: {found:?}");
                match policy {
                    "reuse" | "wis-cv" => assert!(found.hidden > 5, "{keys}: {found:?}"),
                    "in-target" => assert!(found.compared == found.records),
                    _ => {}
                }
            }
        }
    }
}

/// Confidence counts frames up to the cap, and the sample of this frame; a sample grows older by
/// one a frame, up to the oldest that is allowed, and to no more. Where nothing is taken from
/// neighbours both are known exactly.
#[test]
fn confidences_and_ages_are_what_was_asked_for() {
    let [still, ..] = courses();
    let (_, course) = still;
    let stage = Stage::new(course.base.clone()).unwrap();
    let shot = shot([22, 11], 2, 1);
    let frames = 8;
    for cap in [0_u32, 1, 3, 20] {
        for max_age in [0_u32, 1, 2, 5] {
            let spec = format!("restir-di:neighbours=0,cap={cap},max-age={max_age}");
            let mut frame_loop =
                FrameLoop::new(Arc::from(parse(&spec).unwrap()), &stage, shot).unwrap();
            let mut oldest = 0;
            for index in 0..frames {
                let frame = frame_loop.render().unwrap();
                let records: &[Record] = frame.buffer("reservoirs").unwrap();
                let confidence = 1 + index.min(cap);
                for record in records.iter().filter(|record| record.confidence() > 0.0) {
                    assert_eq!(record.confidence(), confidence as f32, "{spec}, frame {index}");
                    oldest = oldest.max(record.age());
                }
            }
            let expected = match (cap, max_age) {
                (0, _) => 0,
                (_, 0) => frames - 1,
                (_, age) => age,
            };
            assert_eq!(oldest, expected, "{spec}");
        }
    }
}
