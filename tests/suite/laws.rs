//! The laws in the documentation of `Technique`, for every entry of the registry. Each is a
//! function of any entries, so that `outside` holds a technique to them that is not registered.
//!
//! The third, that means agree with claims, is what `oracles` tests for unbiased ones; here a
//! biased one must be what it says.

use std::sync::Arc;

use afterimage::accel::Ray;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::pass::{Band, Buffer, FrameInputs, MAX_WRITES, PrimaryHit, TileGrid};
use afterimage::plan::{BufferPlan, Claim, Domain, Elements, Filter, Kernel, Plan, Runs, Shot};
use afterimage::scene::{LightKind, Scalar, Scene};
use afterimage::techniques::{Entry, REGISTRY, Technique, find, parse};
use glam::{Affine3A, Vec3};

use crate::support::{bits, environment, light, room, shot};

/// Whether a technique has this effort on a stage: chains of reservoirs are whole.
fn has_effort(technique: &dyn Technique, stage: &Stage, shot: Shot) -> bool {
    !technique.plan(stage.facts(), &shot).chains || shot.effort.fract() == 0.0
}

/// Scenes that differ in what they need.
fn scenes() -> Vec<Scene> {
    let mut dark = room();
    dark.name = "no lights".into();
    for object in &mut dark.objects {
        Arc::make_mut(object).shapes[0].emission = None;
    }
    let mut points = dark.clone();
    points.name = "point lights".into();
    let kind = LightKind::Point { intensity: Vec3::splat(0.5) };
    light(&mut points, kind, Affine3A::from_translation(Vec3::Y));
    let mut sky = dark.clone();
    sky.name = "sky".into();
    environment(&mut sky, Vec3::splat(0.5));
    let mut leaky = room();
    leaky.name = "coverage".into();
    Arc::make_mut(&mut leaky.objects[2]).shapes[0].alpha = Some(Scalar::Constant(0.5));
    environment(&mut leaky, Vec3::splat(0.5));
    let mut empty = Scene::new("empty");
    environment(&mut empty, Vec3::ONE);
    vec![room(), dark, points, sky, leaky, empty]
}

fn shots() -> Vec<Shot> {
    let mut all = Vec::new();
    for filter in [Filter::Point, Filter::Box] {
        for (depth, effort) in [(1, 1.0), (2, 1.0), (6, 1.0), (6, 3.0), (6, 2.4)] {
            all.push(Shot { filter, depth, effort, ..shot([19, 13], 1, 1) });
        }
    }
    all
}

/// The technique that a SPEC names, of some entries.
fn made(entries: &[Entry], spec: &str) -> afterimage::Result<Arc<dyn Technique>> {
    let (entry, pairs) = find(entries, spec)?;
    entry.parse(pairs).map(Arc::from)
}

#[test]
fn a_spec_gives_the_same_technique_again() {
    check_specs(REGISTRY);
}

/// Every SPEC gives a technique whose own SPEC gives the same.
pub(crate) fn check_specs(entries: &[Entry]) {
    for entry in entries {
        let mut specs = vec![entry.name.to_string()];
        for parameter in (entry.parameters)() {
            for value in ["0", "1", "2", "3", "7", "0.5", "true", "false", &parameter.default] {
                specs.push(format!("{}:{}={value}", entry.name, parameter.key));
            }
        }
        let mut known = 0;
        for spec in specs {
            let Ok(technique) = made(entries, &spec) else { continue };
            known += 1;
            let again = made(entries, &technique.spec()).unwrap();
            assert_eq!(again.spec(), technique.spec());
            assert_eq!(format!("{again:?}"), format!("{technique:?}"), "{spec}");
        }
        assert!(
            known > 2 * (entry.parameters)().len(),
            "hardly any value of `{}` was tried",
            entry.name
        );
    }
}

#[test]
fn names_are_unique_and_parameters_described() {
    check_entries(REGISTRY);
}

/// Names are told apart, texts are there, variants and rungs parse.
pub(crate) fn check_entries(entries: &[Entry]) {
    for (i, entry) in entries.iter().enumerate() {
        assert!(entries[..i].iter().all(|other| other.name != entry.name));
        assert!(!entry.about.is_empty());
        for parameter in (entry.parameters)() {
            assert!(!parameter.about.is_empty() && !parameter.default.is_empty());
        }
        for keys in (entry.variants)() {
            entry.parse(&keys).unwrap();
        }
        for rung in entry.ladder() {
            entry.parse(rung.keys).unwrap();
        }
    }
}

#[test]
fn counters_stay_within_the_plan_and_buffers_within_reason() {
    check_counters(REGISTRY);
}

/// No frame uses more rays than the plan says, rejects a weight or makes an estimate that is not
/// finite.
pub(crate) fn check_counters(entries: &[Entry]) {
    for scene in scenes() {
        let stage = Stage::new(scene).unwrap();
        for entry in entries {
            for shot in shots() {
                let technique = made(entries, entry.name).unwrap();
                let known = has_effort(&*technique, &stage, shot);
                let frame_loop = FrameLoop::new(technique, &stage, shot);
                assert_eq!(frame_loop.is_ok(), known, "{} at {shot:?}", entry.name);
                let Ok(mut frame_loop) = frame_loop else { continue };
                let plan = frame_loop.plan().clone();
                assert_eq!(plan.technique, entry.name);
                let standard = Plan::standard_buffers();
                let same = |(a, b): (&BufferPlan, &BufferPlan)| {
                    (a.name, a.bytes, a.elements) == (b.name, b.bytes, b.elements)
                };
                assert!(plan.buffers.iter().zip(&standard).all(same));
                for pass in &plan.passes {
                    assert!(pass.writes.len() <= MAX_WRITES);
                    assert!(pass.writes.iter().all(|id| id.0 < plan.buffers.len()));
                }
                for frame in 0..3 {
                    let work = frame_loop.render().unwrap().counters;
                    let at = format!(
                        "{} on {} in frame {frame}: {work:?}",
                        entry.name,
                        stage.scene().name
                    );
                    let most = plan.rays_per_pixel().map(|rays| rays * shot.pixels() as u64);
                    assert!(work.primary_rays <= most[0], "{at}");
                    assert!(work.bounce_rays <= most[1], "{at}");
                    assert!(work.shadow_rays <= most[2], "{at}");
                    assert!(work.emitter_rays <= most[3], "{at}");
                    assert_eq!(work.weights_rejected, 0, "{at}");
                    assert_eq!(work.non_finite, 0, "{at}");
                }
            }
        }
    }
}

/// Rows or items at which a domain may be cut, about `rows` apart: anywhere, but for tiles only
/// where one begins.
fn cuts(domain: Domain, shot: Shot, rows: u32) -> (Vec<u32>, Option<TileGrid>) {
    let height = shot.size[1];
    match domain {
        Domain::Pixels => ((0..height).step_by(rows as usize).collect(), None),
        Domain::Items(n) => ((0..n).step_by(7 * rows as usize).collect(), None),
        Domain::Tiles { width, height: down, grid } => {
            let size = [width, down];
            let origin = grid.origin(size, shot.run, 0);
            let step = down * rows.div_ceil(down);
            let starts = (0..height).filter(|&row| row == 0 || (row + origin[1]) % step == 0);
            (starts.collect(), Some(TileGrid { size, origin }))
        }
    }
}

/// Runs a plan's passes in bands of about `rows` rows, in reverse order, without the frame loop.
fn in_bands(technique: &dyn Technique, stage: &Stage, shot: Shot, rows: u32) -> Vec<[u32; 3]> {
    let world = stage.first_world();
    let plan = technique.plan(stage.facts(), &shot);
    let [width, height] = shot.size;
    let mut buffers: Vec<Buffer> = plan
        .buffers
        .iter()
        .map(|buffer| {
            let elements = match buffer.elements {
                Elements::Pixels => shot.pixels(),
                Elements::Items(n) => n as usize,
            };
            let words = vec![0; elements * buffer.bytes as usize / 4];
            Buffer { previous: Vec::new(), current: words }
        })
        .collect();
    let camera = world.scene.camera.rays(shot.size);
    if plan.emitters {
        world.prepare_emitters().unwrap();
    }
    for pass in plan.passes.iter().filter(|pass| pass.runs != Runs::WithHistory) {
        let mut owned: Vec<Vec<u32>> =
            pass.writes.iter().map(|id| std::mem::take(&mut buffers[id.0].current)).collect();
        let inputs = FrameInputs {
            world,
            previous: None,
            shot,
            plan: &plan,
            camera,
            motion: None,
            frame: 0,
            buffers: &buffers,
        };
        match pass.kernel {
            Kernel::PrimaryHits => {
                let hits: &mut [PrimaryHit] = bytemuck::cast_slice_mut(&mut owned[0]);
                for (pixel, hit) in hits.iter_mut().enumerate() {
                    let at = inputs.sample_position(pixel as u32 % width, pixel as u32 / width, 0);
                    let ray = camera.ray(at);
                    let ray =
                        Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
                    *hit = world.closest_hit(&ray).into();
                }
            }
            Kernel::Technique(kernel) => {
                let (starts, tiles) = cuts(pass.domain, shot, rows);
                let (end, across) = match pass.domain {
                    Domain::Items(n) => (n, 1),
                    _ => (height, width),
                };
                for (at, &start) in starts.iter().enumerate().rev() {
                    let range = start..starts.get(at + 1).copied().unwrap_or(end);
                    let mut slots: [&mut [u32]; MAX_WRITES] = Default::default();
                    for ((slot, words), id) in slots.iter_mut().zip(&mut owned).zip(&pass.writes) {
                        let row = across as usize * plan.buffers[id.0].bytes as usize / 4;
                        *slot = &mut words[range.start as usize * row..range.end as usize * row];
                    }
                    let mut band = Band::new(range, across, &pass.writes, slots);
                    if let Some(tiles) = tiles {
                        band = band.with_tiles(tiles);
                    }
                    technique.run(kernel, &inputs, &mut band);
                }
            }
        }
        for (id, words) in pass.writes.iter().zip(owned) {
            buffers[id.0].current = words;
        }
    }
    let radiance: &[[u32; 3]] = bytemuck::cast_slice(&buffers[Plan::RADIANCE.0].current);
    radiance.to_vec()
}

#[test]
fn how_the_picture_is_cut_into_bands_changes_no_bit() {
    // With light points made ahead and a pass over tiles of pixels, too.
    check_bands(REGISTRY, &["restir-di:tiles=on,boiling=0.5"]);
}

/// Bands of any height, in any order, give the same picture; `more` are SPECs beside the entries'
/// names.
pub(crate) fn check_bands(entries: &[Entry], more: &[&str]) {
    for scene in scenes() {
        let stage = Stage::new(scene).unwrap();
        let specs = entries.iter().map(|entry| entry.name);
        for spec in specs.chain(more.iter().copied()) {
            for shot in shots() {
                let technique = made(entries, spec).unwrap();
                if !has_effort(&*technique, &stage, shot) {
                    continue;
                }
                let mut frame_loop = FrameLoop::new(technique.clone(), &stage, shot).unwrap();
                let whole = bits(&frame_loop.render().unwrap().picture());
                for rows in [1, 5, 13] {
                    assert_eq!(whole, in_bands(&*technique, &stage, shot, rows), "{spec}");
                }
            }
        }
    }
}

#[test]
fn claims_say_what_a_technique_cannot_see() {
    let shot = shot([16, 16], 4, 4);
    for scene in scenes() {
        let stage = Stage::new(scene).unwrap();
        let mean = |spec: &str| {
            let technique = Arc::from(parse(spec).unwrap());
            let mut frame_loop = FrameLoop::new(technique, &stage, shot).unwrap();
            let claim = frame_loop.plan().claim.clone();
            (frame_loop.render().unwrap().picture().mean_luminance(), claim)
        };
        let (reference, claim) = mean("nee");
        assert_eq!(claim, Claim::Unbiased);
        let (bsdf, claim) = mean("bsdf");
        if stage.facts().lights.delta > 0 {
            let Claim::Biased(why) = claim else { panic!("{claim}") };
            assert!(why.contains("never finds point"), "{why}");
            assert!(bsdf == 0.0 && reference > 0.0);
        } else {
            assert_eq!(claim, Claim::Unbiased);
            assert_eq!(bsdf > 0.0, reference > 0.0);
        }
    }
}

/// With an effort of 2.4 a pixel shows just what it shows with an effort of 2 or of 3, so its mean
/// over its own number of estimates is as unbiased as theirs. Over frames each pixel has the third
/// estimate with probability 0.4, and within a frame 40 % of the pixels have it, evenly spread.
#[test]
fn a_fraction_of_effort_gives_some_pixels_one_estimate_more() {
    let stage = Stage::new(room()).unwrap();
    let size = [24, 16];
    let pixels = (size[0] * size[1]) as usize;
    for spec in ["nee", "bsdf", "ris"] {
        let picture = |effort: f32, run: u64| {
            let shot = Shot { effort, run, ..shot(size, 3, 1) };
            let technique = Arc::from(parse(spec).unwrap());
            let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
            bits(&frames.render().unwrap().picture())
        };
        let runs = 60;
        let mut thirds = vec![0_u32; pixels];
        let (mut control, mut told) = (0, 0_u32);
        for run in 0..runs {
            let [some, two, three] = [2.4, 2.0, 3.0].map(|effort| picture(effort, run));
            let mut frame = [0_u32; 4];
            let mut differ = [0_u32; 4];
            for pixel in 0..pixels {
                let (same2, same3) = (some[pixel] == two[pixel], some[pixel] == three[pixel]);
                assert!(same2 || same3, "{spec}: pixel {pixel} of run {run} shows neither");
                if two[pixel] == three[pixel] {
                    continue;
                }
                let quarter = pixel / (pixels / 4);
                differ[quarter] += 1;
                told += 1;
                frame[quarter] += u32::from(same3);
                thirds[pixel] += u32::from(same3);
                // The planted bug: a mean over the effort in place of the pixel's own number.
                let wrong = f32::from_bits(three[pixel][0]) * 3.0 / 2.4;
                control += u32::from([two[pixel][0], three[pixel][0]].contains(&wrong.to_bits()));
            }
            for (count, all) in frame.into_iter().zip(differ).filter(|(_, all)| *all > 80) {
                let share = f64::from(count) / f64::from(all);
                assert!((share - 0.4).abs() < 0.06, "{spec}: {share} of a quarter in run {run}");
            }
        }
        assert!(control < 40, "{spec}: a wrong mean is not told from a right one {control} times");
        // A binomial of 60 with p = 0.4 has a standard deviation of 3.8: beyond 5 of them lies
        // 10⁻⁶.
        let often: Vec<u32> = thirds.iter().copied().filter(|count| *count > 0).collect();
        assert!(often.len() > pixels / 2, "{spec}: hardly any pixel tells two from three");
        assert!(often.iter().all(|count| *count <= 24 + 19), "{spec}: {often:?}");
        let share = f64::from(thirds.iter().sum::<u32>()) / f64::from(told);
        let error = 5.0 * (0.24 / f64::from(told)).sqrt();
        assert!((share - 0.4).abs() < error, "{spec}: a third estimate in a share of {share}");
    }
}
