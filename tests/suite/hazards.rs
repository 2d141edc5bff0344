//! What has gone wrong in implementations of reuse of paths, one test each: frames, lights, objects
//! and bounds that change between the frames that share paths.

use std::sync::Arc;

use afterimage::accel::AcceptAll;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::rng::{Stream, path_seed};
use afterimage::plan::Filter;
use afterimage::reuse::light_points::Time;
use afterimage::reuse::paths::{Anchor, PathReceiver, PathShift};
use afterimage::scene::{LightKind, Material, Scene, Shape, Transform};
use afterimage::techniques::{REGISTRY, Technique, parse};
use glam::{Affine3A, Quat, Vec3};

use crate::course::{Course, Look, assert_unbiased};
use crate::paths::{CONNECTS, drawn, receivers_at, rooms};
use crate::paths_moved::halves;
use crate::support::{bits, diffuse, environment, light, look_at, metal, polygon, room, shot};

/// Direct light from candidates, and from the walks, of which the former is shown with all inputs.
const KINDS: [&str; 2] = ["mature=0", "direct=tree,shade=selected,neighbours=2,taps=random"];

/// Asserts that a course is unbiased at some ages, as a whole and in its halves.
#[track_caller]
fn holds(course: &Course, ages: &[u32], kinds: &[&str]) {
    const DELTA: f64 = 0.04;
    let shot = shot([18, 12], 4, 1);
    let stage = course.stage();
    let looks: Vec<Look> = ages.iter().flat_map(|age| halves(course, shot, *age)).collect();
    for keys in kinds {
        let technique: Arc<dyn Technique> = Arc::from(parse(&format!("restir-pt:{keys}")).unwrap());
        assert_unbiased((course, &stage), &technique, shot, &looks, DELTA);
    }
}

fn fixed(affine: Affine3A) -> Transform {
    Transform::Fixed(affine)
}

/// After a restart there is no history: the first frame is that of a fresh loop, for all
/// techniques, and a run with another seed shares no number with it.
#[test]
fn h_history_is_used_once() {
    let stage = Stage::new(room()).unwrap();
    for entry in REGISTRY {
        for filter in [Filter::Point, Filter::Box] {
            let shot = afterimage::plan::Shot { filter, ..shot([16, 12], 4, 1) };
            let technique: Arc<dyn Technique> = Arc::from(parse(entry.name).unwrap());
            let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
            let fresh = bits(&frames.render().unwrap().picture());
            let second = bits(&frames.render().unwrap().picture());
            frames.render().unwrap();
            frames.restart(shot.run);
            assert_eq!(bits(&frames.render().unwrap().picture()), fresh, "{}", entry.name);
            assert_eq!(bits(&frames.render().unwrap().picture()), second, "{}", entry.name);
            frames.restart(shot.run + 1);
            assert_ne!(bits(&frames.render().unwrap().picture()), fresh, "{}", entry.name);
        }
    }
}

/// A mirror that is one of two lobes with a chance of one in a million, and a material whose
/// roughness goes from 0 to 1 inside of a pixel: nothing is lost, and nothing explodes.
#[test]
fn h_rare_lobes_and_textured_roughness() {
    let mut rare = rooms()[1].clone();
    let (grey, mirror) = (diffuse(&mut rare, 0.7), metal(&mut rare, 0.0));
    // The chance of the rare lobe.
    let amount = afterimage::scene::Scalar::Constant(1e-6);
    let mix = rare.add_material(Material::Mix { first: grey, second: mirror, amount });
    for instance in [0, 1, 2] {
        Arc::make_mut(&mut rare.objects[instance]).shapes[0].material = mix;
    }
    for base in [rare, crate::paths_exact::textured()] {
        let at = |scene: &mut Scene, i: u32| {
            let t = 0.05 * i as f32;
            scene.camera = look_at(Vec3::new(t, 1.0, -3.0), Vec3::new(0.0, 1.0, 0.0), 0.75);
        };
        holds(&Course { base, at }, &[3], &KINDS);
    }
}

/// The history is that of the frame before, not of the one before that: a camera that goes faster
/// and faster, so that no two steps are alike.
#[test]
fn h_previous_is_frame_t_minus_1() {
    let at = |scene: &mut Scene, i: u32| {
        let t = 0.06 * (i * i) as f32;
        scene.camera =
            look_at(Vec3::new(t, 1.0, -3.0 + 0.3 * t), Vec3::new(0.3 * t, 1.0, 0.0), 0.75);
    };
    holds(&Course { base: rooms()[0].clone(), at }, &[2, 3], &KINDS[..1]);
}

/// Every light is drawn with another probability in every frame: one is 16 times as bright in every
/// other one.
#[test]
fn h_choice_probability_changes() {
    let mut base = room();
    let place = Affine3A::from_translation(Vec3::new(0.3, 1.4, -0.4));
    light(&mut base, LightKind::Point { intensity: Vec3::splat(0.3) }, place);
    let at = |scene: &mut Scene, i: u32| {
        if i % 2 == 1 {
            scene.lights[0].kind = LightKind::Point { intensity: Vec3::splat(16.0 * 0.3) };
        }
    };
    holds(&Course { base, at }, &[1, 2], &KINDS);
}

/// Lights come and go that stand before all others in the table, which a sky is the last of.
#[test]
fn h_tables_shift() {
    let mut base = room();
    environment(&mut base, Vec3::new(0.3, 0.4, 0.5));
    let place = Affine3A::from_translation(Vec3::new(0.3, 1.4, -0.4));
    light(&mut base, LightKind::Point { intensity: Vec3::splat(0.4) }, place);
    let at = |scene: &mut Scene, i: u32| {
        if i.is_multiple_of(2) {
            scene.lights.pop();
        }
        let last = scene.lights.len() - 1;
        scene.lights.swap(0, last);
        // So do instances.
        let last = scene.instances.len() - 1;
        scene.instances.swap(i as usize, last);
    };
    // The stage must know of all that may come.
    let course = Course { base, at };
    holds(&course, &[1, 2], &KINDS);
}

/// What lies behind a connection is traced again over mirrors and glass that have moved, to ends
/// that only a delta finds.
#[test]
fn h_delta_before_the_end_after_retrace() {
    let at = |scene: &mut Scene, i: u32| {
        let t = 0.07 * i as f32;
        for ball in [6, 7] {
            scene.instances[ball].to_world = fixed(Affine3A::from_translation(Vec3::new(-t, t, t)));
        }
    };
    holds(&Course { base: rooms()[0].clone(), at }, &[1, 2], &KINDS);
}

/// A lamp that shines to one side turns over.
#[test]
fn h_one_sided_light_turns() {
    let at = |scene: &mut Scene, i: u32| {
        let middle = Vec3::new(0.0, 1.5, 0.0);
        let turn = Affine3A::from_translation(middle)
            * Affine3A::from_quat(Quat::from_rotation_x(0.9 * i as f32))
            * Affine3A::from_translation(-middle - Vec3::Y * 0.375);
        scene.instances[8].to_world = fixed(Affine3A::from_translation(Vec3::Y * 0.1) * turn);
    };
    holds(&Course { base: room(), at }, &[1, 3], &KINDS);
}

/// Another object stands under the key of one that is gone, and its primitives have the numbers of
/// the other's.
#[test]
fn h_object_replaced_under_a_key() {
    let mut base = room();
    let white = diffuse(&mut base, 0.8);
    let c = |x: f32, y: f32| Vec3::new(x, y, 0.1);
    let board = polygon(&[c(-0.9, 0.1), c(-0.9, 1.2), c(-0.2, 1.2), c(-0.2, 0.1)]);
    base.add_object(afterimage::scene::Object {
        name: String::new(),
        shapes: vec![Shape::new(board, white)],
    });
    let at = |scene: &mut Scene, i: u32| {
        if i % 2 == 1 {
            // A board for the glossy ball.
            let board = scene.objects.len() as u32 - 1;
            scene.instances[5].object = afterimage::scene::ObjectId(board);
        }
    };
    holds(&Course { base, at }, &[1, 2], &KINDS);
}

/// Where all is smooth no pair of vertices may be connected, so whole paths are replayed.
#[test]
fn h_no_reconnection_vertex() {
    let mut base = room();
    for material in 0..3 {
        let smooth = metal(&mut base, 0.0);
        for object in &mut base.objects {
            for shape in &mut Arc::make_mut(object).shapes {
                if shape.material.index() == material && shape.emission.is_none() {
                    shape.material = smooth;
                }
            }
        }
    }
    let at = |scene: &mut Scene, i: u32| {
        let t = 0.05 * i as f32;
        scene.camera = look_at(Vec3::new(t, 1.0, -3.0), Vec3::new(t, 1.0, 0.0), 0.75);
    };
    holds(&Course { base, at }, &[1], &KINDS[1..]);
}

/// Neighbours whose shifts fail keep their share: a comb of walls before a lamp, so that most paths
/// of a pixel are hidden from the next.
#[test]
fn h_failed_partner_keeps_its_share() {
    let mut base = rooms()[0].clone();
    let grey = diffuse(&mut base, 0.7);
    for tooth in 0..9 {
        let x = -0.8 + 0.2 * tooth as f32;
        let corners = [(0.0, -0.9), (0.5, -0.9), (0.5, 0.9), (0.0, 0.9)];
        let wall = corners.map(|(y, z)| Vec3::new(x, y, z));
        base.add_shape(Shape::new(polygon(&wall), grey));
    }
    for keys in ["cap=0,neighbours=3,taps=random,radius=4", "cap=0,neighbours=3,taps=pairs"] {
        let stage = Stage::new(base.clone()).unwrap();
        let technique = Arc::from(parse(&format!("restir-pt:{keys}")).unwrap());
        let mut frames = FrameLoop::new(technique, &stage, shot([18, 12], 4, 1)).unwrap();
        let counters = frames.render().unwrap().counters;
        assert!(10 * counters.shifts_failed > counters.shifts, "{counters:?}");
        holds(&Course { base: base.clone(), at: |_, _| () }, &[1], &[keys]);
    }
}

/// The surface at the reconnection vertex is asked again as the new path comes to it: F and the
/// density are the products of both surfaces' answers. With its answer to the old path, the
/// control, the density is another where that surface is glossy.
#[test]
fn h_x2_bsdf_reevaluated() {
    let (mut met, mut told) = (0, 0);
    let stage = Stage::new(crate::paths_exact::textured()).unwrap();
    let world = stage.first_world();
    let all = receivers_at(world, Time::Now);
    let mut shift = PathShift::new(&AcceptAll, CONNECTS, None);
    let mut random = Stream::from_key(51);
    for (pixel, from) in all.iter().enumerate() {
        for walk in 0..128 {
            let to = &all[(7 * pixel + 31 * walk as usize) % all.len()];
            let seed = path_seed(52, pixel as u32, 0, walk);
            let Some(sample) = drawn(world, from, seed, &mut random).sample else { continue };
            let Some(kept) = sample.reconnection else { continue };
            let (1, Anchor::Surface(hit), true) = (kept.vertex, kept.anchor, sample.last > 1)
            else {
                continue;
            };
            let Ok(there) = shift.try_shift(&sample, from, to) else { continue };
            // F and density of the receiver towards x_r, and of x_r onward as `seen_from` comes
            // to it.
            let product = |seen_from: &PathReceiver<'_>| {
                let (own, far) = (world.surface(&to.hit), world.surface(&hit));
                let way = far.position - own.position;
                let seen = own.frame.to_local(-to.direction);
                let towards = own.frame.to_local(way.normalize());
                let came = world.surface(&seen_from.hit).position - far.position;
                let came = far.frame.to_local(came.normalize());
                let onward = far.frame.to_local(kept.direction);
                let [near, lobes] =
                    [own.bsdf.evaluate(seen, towards), far.bsdf.evaluate(came, onward)];
                let f = near.value / near.pdf * (lobes.value / lobes.pdf) * kept.radiance;
                let joint = own.bsdf.evaluate_lobe(kept.lobes[0].into(), seen, towards).pdf
                    * far.bsdf.evaluate_lobe(kept.lobes[1].into(), came, onward).pdf;
                let cosine = way.normalize().dot(far.geometric_normal).abs();
                (f, joint * cosine / way.length_squared())
            };
            let density = there.sample.reconnection.unwrap().density;
            let (f, right) = product(to);
            let error = (there.integrand - f).abs().max_element();
            assert!(error < 2e-3 * f.max_element(), "{sample:?} {there:?}: {f}");
            assert!((density / right - 1.0).abs() < 5e-3, "{there:?}: {right}");
            let stale = (density / product(from).1 - 1.0).abs() > 0.02;
            told += u32::from(stale);
            met += 1;
        }
    }
    assert!(met > 300 && told > 30, "{met} paths, {told} tell");
}

/// The previous frame's target belongs to the previous frame's camera: glossy floors, a camera that
/// pans, a picture that is not square, direct light as paths.
#[test]
fn h_previous_camera_glossy() {
    let [_, camera, ..] = crate::matrix::courses();
    let entry = REGISTRY.iter().find(|entry| entry.name == "restir-pt").unwrap();
    crate::matrix::check_spec(entry, "direct=tree,shade=selected", &camera, shot([24, 12], 2, 1));
}

/// The distance that the predicate asks for is that of the stage: it does not grow with the scene.
#[test]
fn h_bounds_grow() {
    let at = |scene: &mut Scene, i: u32| {
        // A black thing far away, a thousand times the room's size and back.
        let far = if i % 2 == 1 { 2000.0 } else { 0.0 };
        scene.instances[6].to_world = fixed(Affine3A::from_translation(Vec3::X * far));
    };
    holds(&Course { base: room(), at }, &[1, 2], &KINDS[1..]);
}

/// Light at the ends of f32: nothing is lost silently, nothing is counted as a bug, and the picture
/// is the scaled one.
#[test]
fn h_products_beyond_f32() {
    for exponent in [-60, -30, 30, 60] {
        let scale = f64::from(exponent).exp2() as f32;
        let picture = |scale: f32| {
            let mut scene = room();
            for object in &mut scene.objects {
                for shape in &mut Arc::make_mut(object).shapes {
                    if let Some(emission) = &mut shape.emission {
                        emission.scale *= scale;
                    }
                }
            }
            let stage = Stage::new(scene).unwrap();
            let technique: Arc<dyn Technique> = Arc::from(parse("restir-pt:mature=0").unwrap());
            let mut frames = FrameLoop::new(technique, &stage, shot([16, 12], 5, 1)).unwrap();
            frames.render().unwrap();
            let frame = frames.render().unwrap();
            let counters = frame.counters;
            assert_eq!((counters.non_finite, counters.weights_rejected), (0, 0), "2^{exponent}");
            frame.picture()
        };
        let (plain, scaled) = (picture(1.0), picture(scale));
        for (plain, scaled) in plain.pixels.iter().zip(&scaled.pixels) {
            assert_eq!(*scaled, *plain * scale, "2^{exponent}");
        }
    }
}
