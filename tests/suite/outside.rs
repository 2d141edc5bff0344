//! A technique that is not registered, made of public items only: can all that is done with
//! registered ones be done with it?

use std::sync::Arc;

use afterimage::Result;
use afterimage::accel::Ray;
use afterimage::counters::Counters;
use afterimage::experiment::{
    Ages, Comparison, Inspection, Ladder, LadderOutcome, LadderScenes, ReferenceSettings, Session,
    SessionSettings, Spending, Trial, technique,
};
use afterimage::math::rng::draw4;
use afterimage::pass::{Band, FrameInputs, PrimaryHit};
use afterimage::path::{emitted, finite_or_counted};
use afterimage::plan::{
    BufferKey, BufferPlan, Builder, Claim, Elements, Filter, NewPass, Plan, SceneFacts, Shot,
};
use afterimage::spec::{self, Field, Row};
use afterimage::stats::Verdict;
use afterimage::techniques::{Entry, Moving, Rung, Technique};
use glam::Vec3;

use crate::support::{room, shot};
use crate::{determinism, laws, matrix};

/// How many segments the last path of each pixel had.
const SEGMENTS: BufferKey<u32> = BufferKey::new("segments");

/// Paths by BSDF sampling, several of them a pixel and estimate.
#[derive(Clone, Debug, PartialEq)]
struct Walks {
    name: &'static str,
    /// Paths a pixel and estimate, in [1, 4].
    walks: u32,
    /// What each path is multiplied by: 1, or a planted bug.
    gain: f32,
}

const RIGHT: Walks = Walks { name: "walks", walks: 1, gain: 1.0 };
const DIM: Walks = Walks { name: "dim-walks", walks: 1, gain: 0.9 };

fn rows() -> [Row<Walks>; 1] {
    [Row {
        key: "walks",
        about: "paths a pixel and estimate",
        field: Field::Integer(1..=4, |walks| &mut walks.walks),
    }]
}

const WALKS: Entry = Entry {
    name: RIGHT.name,
    about: "paths by BSDF sampling, from outside of the crate",
    parameters: || spec::describe(&rows(), &RIGHT),
    build: |values| Ok(Box::new(spec::build(RIGHT, &rows(), values)?)),
    direct: false,
    rungs: &[
        Rung::new("one walk", "", Moving::Still),
        Rung::new("two walks", "walks=2", Moving::Still),
        Rung::new("moving lights", "walks=2", Moving::Light),
    ],
    variants: || vec!["walks=2".to_string()],
};

/// The control: a tenth of the light is lost, and it claims to be unbiased all the same.
const DIM_WALKS: Entry = Entry {
    name: DIM.name,
    about: "walks with a bug",
    parameters: || spec::describe(&rows(), &DIM),
    build: |values| Ok(Box::new(spec::build(DIM, &rows(), values)?)),
    rungs: &[],
    ..WALKS
};

impl Walks {
    /// One path from a primary hit, and how many segments it has.
    fn walk(
        &self,
        inputs: &FrameInputs<'_>,
        seed: u64,
        primary: (Vec3, afterimage::accel::Hit),
        counters: &mut Counters,
    ) -> (Vec3, u32) {
        let world = inputs.world;
        let (mut direction, mut hit) = primary;
        let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        counters.paths += 1;
        for vertex in 0..inputs.shot.depth.saturating_sub(1) {
            let surface = world.surface(&hit);
            let outgoing = surface.frame.to_local(-direction);
            let Some(sample) = surface.bsdf.sample(outgoing, draw4(seed, vertex, 0)) else {
                return (radiance, vertex + 1);
            };
            throughput *= sample.value / sample.pdf;
            direction = surface.frame.to_world(sample.wi).normalize();
            let ray = Ray { origin: surface.origin(direction), direction, t_max: f32::INFINITY };
            counters.bounce_rays += 1;
            let Some(next) = world.closest_hit(&ray) else {
                radiance += throughput * world.escaped_radiance(direction);
                return (radiance, vertex + 2);
            };
            radiance += throughput * emitted(world, &world.accel.point(&next), direction);
            hit = next;
        }
        (radiance, inputs.shot.depth)
    }
}

impl Technique for Walks {
    fn spec(&self) -> String {
        spec::write(self.name, &Self { walks: 1, ..self.clone() }, &rows(), self)
    }

    fn validate(&self) -> Result<()> {
        spec::check(&rows(), self)
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut plan = Builder::new(self.spec(), facts, shot);
        let segments = plan.buffer(SEGMENTS, Elements::Pixels, false);
        let estimates = u64::from(shot.most_estimates());
        let bounces = u64::from(shot.depth.saturating_sub(1)) * u64::from(self.walks) * estimates;
        let mut writes = vec![Plan::RADIANCE, segments];
        if shot.filter == Filter::Point {
            plan.primary_hits();
        } else {
            writes.push(Plan::EMISSION);
        }
        let mut pass = NewPass::pixels("walks", 0, writes).rays(bounces, 0, 0);
        if shot.filter == Filter::Box {
            pass.rays[0] = estimates;
        }
        plan.pass(pass);
        plan.finish(if facts.lights.delta > 0 {
            Claim::Biased("no walk finds point, spot and distant lights".to_string())
        } else {
            Claim::Unbiased
        })
    }

    fn run(&self, _kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let world = inputs.world;
        let boxed = inputs.shot.filter == Filter::Box;
        let pixels = band.pixels();
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        let segments: &mut [u32] = band.take(inputs.id(SEGMENTS));
        let emission: &mut [[f32; 3]] = band.take_some(boxed.then_some(Plan::EMISSION));
        let hits: &[PrimaryHit] = if boxed { &[] } else { inputs.read(Plan::HITS) };
        for (local, pixel) in pixels.enumerate() {
            let (mut sum, mut seen) = (Vec3::ZERO, Vec3::ZERO);
            let estimates = inputs.estimates(pixel);
            let share = 1.0 / estimates as f32;
            for estimate in 0..estimates {
                let at = inputs.sample_position(pixel.x, pixel.y, estimate);
                let ray = inputs.camera.ray(at);
                let hit = if boxed {
                    counters.primary_rays += 1;
                    let t_max = f32::INFINITY;
                    world.closest_hit(&Ray { origin: ray.origin, direction: ray.direction, t_max })
                } else {
                    hits[pixel.index as usize].get()
                };
                let Some(hit) = hit else {
                    seen += world.escaped_radiance(ray.direction);
                    continue;
                };
                seen += emitted(world, &world.accel.point(&hit), ray.direction);
                for walk in 0..self.walks {
                    let seed = inputs.seeds(pixel.index).seed(estimate * self.walks + walk);
                    let primary = (ray.direction, hit);
                    let (path, length) = self.walk(inputs, seed, primary, &mut counters);
                    let gain = self.gain / self.walks as f32;
                    sum += finite_or_counted(gain * path, &mut counters);
                    segments[local] = length;
                }
            }
            radiance[local] = (share * sum).to_array();
            if boxed {
                emission[local] = (share * seen).to_array();
            }
        }
        counters
    }

    fn describe(&self, buffer: &BufferPlan, element: &[u32]) -> Vec<(&'static str, String)> {
        let known = buffer.name == SEGMENTS.name;
        if known { vec![("segments", element[0].to_string())] } else { Vec::new() }
    }
}

fn session() -> Session {
    let settings =
        SessionSettings { size: Some([16, 16]), depth: Some(2), ..SessionSettings::default() };
    Session::new(room(), &settings).unwrap()
}

/// References in a folder of the test's own.
fn reference(test: &str) -> ReferenceSettings {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("outside-{test}"));
    ReferenceSettings { seconds: 10.0, cache: Some(folder), ..ReferenceSettings::default() }
}

fn ladder(entry: &Entry, test: &str) -> LadderOutcome {
    let trial = Trial {
        ages: Ages::Given(vec![1, 2]),
        effort: 4.0,
        delta: 0.04,
        reference: reference(test),
        ..Trial::quick()
    };
    let sessions = [session()];
    let scenes = LadderScenes { still: &sessions, moving: &sessions };
    let mut seen = 0;
    let ladder = Ladder { minutes: Some(1.0), trial, ..Ladder::default() };
    let outcome = ladder.run(entry, "", scenes, |_| seen += 1).unwrap();
    assert_eq!((seen, outcome.interrupted), (outcome.rows.len(), false));
    outcome
}

#[test]
fn it_keeps_the_laws() {
    let entries = [WALKS];
    laws::check_specs(&entries);
    laws::check_entries(&entries);
    laws::check_counters(&entries);
    laws::check_bands(&entries, &["walks:walks=3"]);
    matrix::check_strips(&entries, &matrix::moving(), shot([24, 12], 2, 1));
    determinism::check_threads(&entries);
    determinism::check_seeds(&entries);
}

#[test]
fn its_own_rungs_pass_and_those_of_one_with_a_bug_fail() {
    let right = ladder(&WALKS, "ladder");
    let rungs: Vec<(&str, &str)> =
        right.rows.iter().map(|row| (row.rung, row.technique.as_str())).collect();
    assert_eq!(
        rungs,
        [("one walk", "walks"), ("two walks", "walks:walks=2"), ("moving lights", "walks:walks=2")]
    );
    for row in &right.rows {
        assert_eq!((row.verdict, row.failed()), (Verdict::Pass, false), "{row:?}");
    }
    // Without rungs of its own it has those that all have.
    let dim = ladder(&DIM_WALKS, "control");
    assert_eq!(dim.rows.len(), Rung::DEFAULT.len());
    for row in &dim.rows {
        assert!(row.failed(), "{row:?}");
    }
}

#[test]
fn inspection_shows_its_buffers() {
    let walks: Arc<dyn Technique> = Arc::from(WALKS.parse("walks=2").unwrap());
    let inspection = Inspection { pixel: [8, 8], frame: 2, samples: 5 };
    let found = inspection.run(&session(), &walks).unwrap();
    assert_eq!(found.estimates.len(), 5);
    assert!(found.surface.is_ok() && found.plan.technique == "walks:walks=2");
    assert_eq!(found.state.len(), 1, "the other buffers say nothing: {:?}", found.state);
    assert_eq!(found.state[0].buffer, "segments");
    let [(name, value)] = &found.state[0].fields[..] else { panic!("{:?}", found.state) };
    assert_eq!((*name, value.as_str()), ("segments", "2"));

    // A registered one describes its reservoirs by the same way.
    let reuse = technique("restir-di").unwrap();
    let found = inspection.run(&session(), &reuse).unwrap();
    let buffers: Vec<&str> = found.state.iter().map(|state| state.buffer).collect();
    assert_eq!(buffers, ["reservoirs", "history"]);
    assert!(found.state[1].fields.iter().any(|(name, _)| *name == "confidence"));
}

#[test]
fn it_is_compared_with_registered_ones() {
    let walks: Arc<dyn Technique> = Arc::from(WALKS.parse("walks=4").unwrap());
    let comparison = Comparison {
        spending: Spending::Estimates(2),
        frames: 2,
        restarts: 4,
        curve_restarts: 2,
        reference: reference("compare"),
        ..Comparison::default()
    };
    let compared = comparison.run(&session(), &[walks, technique("nee").unwrap()]).unwrap();
    let [walks, nee] = &compared.results.rows[..] else { panic!("two techniques, two rows") };
    assert_eq!((walks.technique.as_str(), nee.technique.as_str()), ("walks:walks=4", "nee"));
    assert!(walks.rays_per_pixel["bounce"] > nee.rays_per_pixel["bounce"]);
    assert!(walks.metrics["relmse"].mean > 0.0 && compared.results.curves.len() == 2);
}

#[test]
fn comparisons_without_an_answer_are_refused() {
    let nee = technique("nee").unwrap();
    let default = || Comparison { reference: reference("refused"), ..Comparison::default() };
    let session = session();
    for (comparison, techniques, why) in [
        (default(), vec![], "no technique"),
        (Comparison { frames: 0, ..default() }, vec![nee.clone()], "frames"),
        (Comparison { restarts: 0, ..default() }, vec![nee.clone()], "restarts"),
        (
            Comparison { spending: Spending::Milliseconds(f64::NAN), ..default() },
            vec![nee.clone()],
            "ms",
        ),
        (
            Comparison { spending: Spending::Estimates(0), ..default() },
            vec![nee.clone()],
            "effort is 0",
        ),
    ] {
        let error = comparison.run(&session, &techniques).unwrap_err();
        assert!(error.is_usage() && error.to_string().contains(why), "{error}");
    }
    let settings = SessionSettings { fps: 0, ..SessionSettings::default() };
    assert!(Session::new(room(), &settings).unwrap_err().is_usage());
}
