//! What a scene does not need costs nothing (counters are 0) and changes nothing (bits are those of
//! the scene without it).

use std::sync::Arc;

use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{
    Channel, Color, ConductorColor, Curve, Geometry, Interpolation, LightKind, Material,
    MaterialId, Roughness, Scalar, Scene, Shape, Texture, TextureKind, Track, Transform,
};
use afterimage::techniques::{REGISTRY, parse};
use afterimage::world::Built;
use glam::{Affine2, Affine3A, Vec3, Vec4};

use crate::support::{bits, diffuse, environment, last_frame, light, look_at, polygon, room, shot};

fn shots() -> [Shot; 2] {
    let point = shot([24, 16], 5, 2);
    [point, Shot { filter: Filter::Box, ..point }]
}

fn skips(stage: &Stage, name: &str, shot: &Shot, what: &str) -> bool {
    let plan = parse(name).unwrap().plan(stage.facts(), shot);
    plan.skipped.iter().any(|skip| skip.what == what)
}

fn work(stage: &Stage, name: &str, shot: Shot, frames: u32) -> Vec<Counters> {
    let technique = Arc::from(parse(name).unwrap());
    let mut frame_loop = FrameLoop::new(technique, stage, shot).unwrap();
    (0..frames).map(|_| frame_loop.render().unwrap().counters).collect()
}

/// Asserts that two scenes give the same bits by the same work.
#[track_caller]
fn assert_same(a: &Scene, b: &Scene) {
    let stages = [a, b].map(|scene| Stage::new(scene.clone()).unwrap());
    for shot in shots() {
        for entry in REGISTRY {
            let [x, y] = stages.each_ref().map(|stage| last_frame(stage, entry.name, shot, 2));
            assert!(x.0.mean_luminance() > 0.0, "nothing is seen");
            assert!(bits(&x.0) == bits(&y.0), "{} gives other bits", entry.name);
            assert_eq!(x.1, y.1, "{} does other work", entry.name);
        }
    }
}

/// Surfaces that are mirrors without a roughness of 0: too smooth for a density, a square below
/// that, a texture that may be.
#[test]
fn light_in_surfaces_that_are_nearly_smooth_is_not_left_out() {
    let metal = |scene: &mut Scene, roughness: Roughness| {
        let color = ConductorColor::Reflectance(Color::Constant(Vec3::splat(0.9)));
        scene.add_material(Material::Conductor { color, roughness })
    };
    let makers: [fn(&mut Scene) -> MaterialId; 3] = [
        |scene| scene.add_material(gltf_metal(0.0)),
        |scene| scene.add_material(gltf_metal(0.03)),
        |scene| {
            let kind = TextureKind::Constant(Vec4::ZERO);
            let texture = scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
            scene.add_material(Material::Conductor {
                color: ConductorColor::Reflectance(Color::Constant(Vec3::splat(0.9))),
                roughness: Roughness {
                    u: Scalar::Texture(texture, Channel::Red),
                    v: Scalar::Texture(texture, Channel::Red),
                    remap: false,
                },
            })
        },
    ];
    let nearly = |scene: &mut Scene| metal(scene, Roughness::isotropic(5e-4));
    let glossy = |scene: &mut Scene| metal(scene, Roughness::isotropic(2e-3));
    let stage = |make: &dyn Fn(&mut Scene) -> MaterialId| {
        let mut scene = Scene::new("mirror");
        let mirror = make(&mut scene);
        let c = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let floor = [c(-2.0, -2.0), c(-2.0, 2.0), c(2.0, 2.0), c(2.0, -2.0)];
        scene.add_shape(Shape::new(polygon(&floor), mirror));
        for x in [-0.4, 0.4] {
            let ball = Geometry::Sphere { center: Vec3::new(x, 1.0, 0.5), radius: 0.3 };
            scene.add_shape(Shape::new(ball, mirror).emitting(Vec3::splat(2.0)));
        }
        scene.camera = look_at(Vec3::new(0.0, 1.0, -1.5), Vec3::ZERO, 1.0);
        Stage::new(scene).unwrap()
    };
    let shot = shot([24, 16], 2, 1);
    let mut stages: Vec<Stage> = makers.iter().map(|make| stage(make)).collect();
    stages.push(stage(&nearly));
    for stage in stages {
        assert!(stage.facts().delta_lobes);
        // Reflections in mirrors have no noise.
        let truth = last_frame(&stage, "nee", shot, 1).0;
        assert!(truth.mean_luminance() > 0.05, "{}", truth.mean_luminance());
        for spec in ["ris", "restir-di"] {
            let found = last_frame(&stage, spec, shot, 2).0;
            for (a, b) in found.pixels.iter().zip(&truth.pixels) {
                assert!((*a - *b).abs().max_element() < 1e-5, "{spec}: {a} instead of {b}");
            }
        }
    }
    assert!(!stage(&glossy).facts().delta_lobes, "the control has a density");
}

fn gltf_metal(roughness: f32) -> Material {
    Material::MetallicRoughness {
        base_color: Color::Constant(Vec3::splat(0.9)),
        metallic: Scalar::Constant(1.0),
        roughness: Scalar::Constant(roughness),
        ior: 1.5,
        specular: Scalar::Constant(1.0),
        specular_color: Color::Constant(Vec3::ONE),
        transmission: Scalar::Constant(0.0),
        double_sided: true,
    }
}

fn without_lights() -> Scene {
    let mut scene = room();
    for object in &mut scene.objects {
        Arc::make_mut(object).shapes[0].emission = None;
    }
    scene
}

#[test]
fn no_light_no_shadow_ray() {
    let stage = Stage::new(without_lights()).unwrap();
    for shot in shots() {
        for entry in REGISTRY {
            assert!(entry.name == "bsdf" || skips(&stage, entry.name, &shot, "light sampling"));
            for counters in work(&stage, entry.name, shot, 2) {
                assert_eq!((counters.shadow_rays, counters.shadow_rays_saved), (0, 0));
            }
        }
    }
    // The control: with lights there are some.
    assert!(work(&Stage::new(room()).unwrap(), "nee", shots()[0], 1)[0].shadow_rays > 0);
}

#[test]
fn bsdf_sampling_alone_asks_for_no_shadow() {
    for counters in work(&Stage::new(room()).unwrap(), "bsdf", shots()[0], 2) {
        assert_eq!((counters.shadow_rays, counters.shadow_rays_saved), (0, 0));
    }
}

#[test]
fn a_depth_of_one_scatters_nothing() {
    let stage = Stage::new(room()).unwrap();
    for shot in shots() {
        for entry in REGISTRY {
            for counters in work(&stage, entry.name, Shot { depth: 1, ..shot }, 2) {
                assert_eq!((counters.bounce_rays, counters.shadow_rays), (0, 0));
            }
        }
    }
}

#[test]
fn mirrors_only_need_no_light_sample() {
    let mut scene = room();
    let mirror = crate::support::metal(&mut scene, 0.0);
    let material = scene.materials[mirror.index()];
    scene.materials.iter_mut().for_each(|m| *m = material);
    let stage = Stage::new(scene).unwrap();
    for counters in work(&stage, "nee", shots()[0], 1) {
        assert_eq!((counters.shadow_rays, counters.shadow_rays_saved), (0, 0));
        assert!(counters.bounce_rays > 0);
    }
}

#[test]
fn black_surfaces_end_paths_without_a_ray() {
    let mut scene = room();
    let nothing = Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) };
    scene.materials.iter_mut().for_each(|material| *material = nothing);
    let stage = Stage::new(scene).unwrap();
    for entry in REGISTRY {
        for counters in work(&stage, entry.name, shots()[0], 1) {
            assert_eq!((counters.bounce_rays, counters.shadow_rays), (0, 0));
        }
    }
}

#[test]
fn primary_rays_of_a_still_scene_are_traced_once() {
    let mut moving = room();
    moving.time = [0.0, 1.0];
    let camera = moving.camera.to_world.fixed();
    let mut end = camera;
    end.translation.x += 0.25;
    let at = |affine: Affine3A| affine.translation.into();
    let (_, rotation, _) = camera.to_scale_rotation_translation();
    moving.camera.to_world = Transform::Chain(vec![Track::Trs {
        translation: Curve {
            keys: vec![(0.0, at(camera)), (1.0, at(end))],
            interpolation: Interpolation::Linear,
        },
        rotation: Curve::constant(rotation),
        scale: Curve::constant(Vec3::ONE),
    }]);
    let (still, moving) = (Stage::new(room()).unwrap(), Stage::new(moving).unwrap());
    let pixels = 24 * 16;
    let [point, boxed] = shots();
    for entry in REGISTRY {
        let primary = |stage: &Stage, shot: Shot| -> Vec<u64> {
            work(stage, entry.name, shot, 3).iter().map(|c| c.primary_rays).collect()
        };
        let what = "primary rays after the first frame";
        assert!(
            skips(&still, entry.name, &point, what) && !skips(&moving, entry.name, &point, what)
        );
        assert_eq!(primary(&still, point), [pixels, 0, 0]);
        assert_eq!(primary(&moving, point), [pixels; 3]);
        // Each of a pixel's two samples has a ray of its own, unless a pixel's reservoir or lobe
        // belongs to one surface.
        let each = parse(entry.name).unwrap().plan(still.facts(), &boxed).rays_per_pixel()[0];
        let of_surfaces = ["ris", "restir-di", "restir-pt", "mcmm"].contains(&entry.name);
        assert_eq!(each, if of_surfaces { 1 } else { 2 });
        assert_eq!(primary(&still, boxed), [each * pixels; 3]);
    }
}

#[test]
fn an_opaque_coverage_mask_is_none() {
    let scene = room();
    let with = |scene: &Scene, alpha: Scalar| {
        let mut scene = scene.clone();
        for object in &mut scene.objects {
            Arc::make_mut(object).shapes[0].alpha = Some(alpha);
        }
        scene
    };
    assert_same(&scene, &with(&scene, Scalar::Constant(1.0)));
    // The same through a texture: the mask is looked up at every hit and always says yes.
    let mut textured = scene.clone();
    let kind = TextureKind::Constant(Vec4::ONE);
    let texture = textured.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
    let textured = with(&textured, Scalar::Texture(texture, Channel::Alpha));
    let shot = &shots()[0];
    let coverage = "coverage lookups at every hit";
    assert!(skips(&Stage::new(scene.clone()).unwrap(), "nee", shot, coverage));
    assert!(!skips(&Stage::new(textured.clone()).unwrap(), "nee", shot, coverage));
    assert_same(&scene, &textured);
}

#[test]
fn a_surface_without_coverage_is_not_there() {
    let mut scene = room();
    let white = diffuse(&mut scene, 0.5);
    let mut more = scene.clone();
    let corners = [(-1.0, 0.5), (1.0, 0.5), (1.0, 1.5), (-1.0, 1.5)];
    let veil = polygon(&corners.map(|(x, y)| Vec3::new(x, y, -0.875)));
    let mut shape = Shape::new(veil, white);
    shape.alpha = Some(Scalar::Constant(0.0));
    more.add_shape(shape);
    assert_same(&scene, &more);
}

#[test]
fn black_lights_are_none() {
    let mut scene = room();
    scene.lights.clear();
    let mut sky = scene.clone();
    environment(&mut sky, Vec3::ZERO);
    assert!(skips(&Stage::new(sky.clone()).unwrap(), "nee", &shots()[0], "environment lookups"));
    assert_same(&scene, &sky);
    let mut point = scene.clone();
    light(&mut point, LightKind::Point { intensity: Vec3::ZERO }, Affine3A::IDENTITY);
    assert_same(&scene, &point);
}

#[test]
fn a_texture_of_one_colour_is_the_colour() {
    let scene = room();
    let mut textured = scene.clone();
    for i in 0..textured.materials.len() {
        if let Material::Diffuse { reflectance: Color::Constant(rgb) } = textured.materials[i] {
            let kind = TextureKind::Constant(rgb.extend(1.0));
            let texture = textured.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
            textured.materials[i] = Material::Diffuse { reflectance: Color::Texture(texture) };
        }
    }
    assert_same(&scene, &textured);
}

#[test]
fn a_chain_that_does_not_move_is_still() {
    let scene = room();
    let mut chained = scene.clone();
    let chain = |transform: &mut Transform| {
        *transform = Transform::Chain(vec![Track::Fixed(transform.fixed())]);
    };
    chain(&mut chained.camera.to_world);
    chained.instances.iter_mut().for_each(|instance| chain(&mut instance.to_world));
    chained.time = [0.0, 1.0];
    assert!(!Stage::new(chained.clone()).unwrap().facts().moves());
    assert_same(&scene, &chained);
}

/// A scene, and how it stands in the next frame.
type Change = fn(&mut Scene);

/// What of a scene is made anew for a frame is what has changed, for each kind of change by itself;
/// the picture is that of a loop that knows no earlier frame.
#[test]
fn what_has_not_changed_is_not_built_again() {
    // Of `room`: five walls, three balls, three lamps.
    const BALL: usize = 5;
    const LAMP: usize = 8;
    fn moved(scene: &mut Scene, instance: usize) {
        let place = Affine3A::from_translation(Vec3::new(0.01, 0.0, 0.0));
        scene.instances[instance].to_world = Transform::Fixed(place);
    }
    let nothing = Built::default();
    let tree = Built { instance_trees: 1, ..nothing };
    let table = Built { light_tables: 1, ..nothing };
    let all = Built { emitter_trees: 1, light_tables: 1, ..tree };
    let changes: [(&str, Change, Built); 8] = [
        ("nothing", |_| {}, nothing),
        (
            "camera",
            |scene| scene.camera = look_at(Vec3::new(0.1, 1.0, -3.0), Vec3::Y, 0.75),
            nothing,
        ),
        (
            "material",
            |scene| {
                let reflectance = Color::Constant(Vec3::splat(0.3));
                scene.materials[0] = Material::Diffuse { reflectance };
            },
            nothing,
        ),
        ("occluder", |scene| moved(scene, BALL), tree),
        ("lamp", |scene| moved(scene, LAMP), all),
        (
            "brightness of a point light",
            |scene| scene.lights[0].kind = LightKind::Point { intensity: Vec3::splat(0.7) },
            table,
        ),
        (
            "another shape",
            |scene| {
                let ball = Geometry::Sphere { center: Vec3::new(0.2, 1.5, 0.0), radius: 0.1 };
                Arc::make_mut(&mut scene.objects[BALL]).shapes[0].geometry = ball;
            },
            Built { trees: 1, ..all },
        ),
        ("key of a lamp", |scene| scene.instances[LAMP].key = 77, table),
    ];
    let mut scene = room();
    light(&mut scene, LightKind::Point { intensity: Vec3::splat(0.5) }, Affine3A::IDENTITY);
    let stage = Stage::moving(scene.clone()).unwrap();
    let shot = shot([8, 6], 3, 1);
    for entry in REGISTRY {
        for (name, change, expected) in changes {
            let technique = || Arc::from(parse(entry.name).unwrap());
            let mut frames = FrameLoop::new(technique(), &stage, shot).unwrap();
            let first = frames.render_scene(scene.clone()).unwrap().built();
            assert_eq!(first, nothing, "loading is no part of a frame");
            let mut changed = scene.clone();
            change(&mut changed);
            let emitters = frames.plan().emitters;
            let frame = frames.render_scene(changed.clone()).unwrap();
            let built = frame.built();
            let mut expected = expected;
            expected.emitter_trees *= u32::from(emitters);
            assert_eq!(built, expected, "{}: {name}", entry.name);
            let picture = bits(&frame.picture());
            let again = frames.render_scene(changed.clone()).unwrap().built();
            assert_eq!(again, nothing, "{}: {name}, and then nothing", entry.name);
            // A technique without history sees each frame as if it were the first.
            if !frames.plan().keeps_history() {
                let stage = Stage::moving(changed).unwrap();
                let mut alone = FrameLoop::new(technique(), &stage, shot).unwrap();
                alone.render().unwrap();
                let fresh = bits(&alone.render().unwrap().picture());
                assert!(picture == fresh, "{}: {name} is shown as it was", entry.name);
            }
        }
    }
}

/// Light points and paths a pixel grow with the effort, and with nothing else.
#[test]
fn work_grows_with_the_effort() {
    let stage = Stage::new(room()).unwrap();
    // The third frame, where histories are there.
    let third = |spec: &str, effort: u32| work(&stage, spec, shot([12, 8], 2, effort), 3)[2];
    for spec in ["nee", "bsdf", "ris", "ris:candidates=3", "restir-di", "restir-di:candidates=5"] {
        let one = third(spec, 1);
        assert!(one.paths > 0 || one.candidates > 0, "{spec}: {one:?}");
        for effort in [2, 3, 7] {
            let many = third(spec, effort);
            let times = u64::from(effort);
            assert_eq!(many.candidates, times * one.candidates, "{spec}, effort {effort}");
            assert_eq!(many.paths, times * one.paths, "{spec}, effort {effort}");
            assert_eq!(many.temporal_merges, times * one.temporal_merges, "{spec}");
            assert_eq!(many.primary_rays, one.primary_rays, "{spec}");
        }
    }
}

/// Where a surface turns its back on the only light, no shadow ray is traced, and that is counted.
#[test]
fn no_shadow_ray_is_traced_to_what_nothing_reflects() {
    let mut scene = Scene::new("backs");
    let white = diffuse(&mut scene, 0.5);
    let c = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    let floor = [c(-9.0, -9.0), c(-9.0, 9.0), c(9.0, 9.0), c(9.0, -9.0)];
    scene.add_shape(Shape::new(polygon(&floor), white));
    let below = Affine3A::from_translation(Vec3::new(0.0, -1.0, 0.0));
    light(&mut scene, LightKind::Point { intensity: Vec3::ONE }, below);
    scene.camera = look_at(Vec3::new(0.0, 1.0, -1.0), Vec3::ZERO, 0.5);
    let stage = Stage::new(scene).unwrap();
    let counters = work(&stage, "nee", shot([8, 8], 2, 1), 1)[0];
    assert_eq!((counters.shadow_rays, counters.shadow_rays_saved), (0, 64));
}

/// With direct light from reservoirs and a depth of 2, a path goes on from mirrors and glass only.
#[test]
fn at_depth_two_only_deltas_are_followed() {
    let stage = Stage::new(room()).unwrap();
    let shot = shot([24, 16], 2, 1);
    let world = stage.first_world();
    let rays = world.scene.camera.rays(shot.size);
    let deltas = (0..24 * 16).filter(|at| {
        let place = glam::Vec2::new((at % 24) as f32 + 0.5, (at / 24) as f32 + 0.5);
        let ray = rays.ray(place);
        let (origin, direction, t_max) = (ray.origin, ray.direction, f32::INFINITY);
        let hit = world.closest_hit(&afterimage::accel::Ray { origin, direction, t_max });
        hit.is_some_and(|hit| {
            let bsdf = &world.surface(&hit).bsdf;
            !bsdf.is_black() && !bsdf.has_non_delta()
        })
    });
    let deltas = deltas.count() as u64;
    assert!(deltas > 20, "{deltas} pixels see a delta");
    assert_eq!(work(&stage, "ris", shot, 1)[0].bounce_rays, deltas);
}

/// A technique that keeps history, and is told what moved only where something does.
#[derive(Debug)]
struct Told;

impl afterimage::techniques::Technique for Told {
    fn spec(&self) -> String {
        "told".into()
    }

    fn validate(&self) -> afterimage::Result<()> {
        Ok(())
    }

    fn plan(&self, facts: &afterimage::plan::SceneFacts, shot: &Shot) -> afterimage::plan::Plan {
        use afterimage::plan::{BufferKey, Builder, Claim, Elements, NewPass, Plan};
        let mut plan = Builder::new(self.spec(), facts, shot);
        let kept: BufferKey<u32> = BufferKey::new("kept");
        let kept = plan.buffer(kept, Elements::Pixels, true);
        plan.pass(NewPass::pixels("told", 0, vec![kept, Plan::RADIANCE]));
        plan.finish(Claim::Unbiased)
    }

    fn run(
        &self,
        _kernel: u32,
        inputs: &afterimage::pass::FrameInputs<'_>,
        band: &mut afterimage::pass::Band<'_>,
    ) -> Counters {
        let radiance: &mut [[f32; 3]] = band.take(afterimage::plan::Plan::RADIANCE);
        radiance.fill([f32::from(u8::from(inputs.motion.is_some())); 3]);
        Counters::default()
    }
}

/// A placement that stays where it is but says that it moves.
fn restless(place: Affine3A) -> Transform {
    let (_, rotation, translation) = place.to_scale_rotation_translation();
    let keys = vec![(0.0, translation), (1.0, translation)];
    let translation = Curve { keys, interpolation: Interpolation::Linear };
    let (rotation, scale) = (Curve::constant(rotation), Curve::constant(Vec3::ONE));
    Transform::Chain(vec![Track::Trs { translation, rotation, scale }])
}

/// Plans leave out to trace again behind a path's connection where neither lights nor geometry may
/// move, and to ask for the roughness of lobes where none has one; the pictures are the same to the
/// bit. The control, a scene of other materials, is another picture.
#[test]
fn paths_take_what_the_scene_needs() {
    let again = "tracing paths again behind their connections";
    let rough = "roughness of the lobes that paths are connected by";
    let shot = shot([24, 16], 6, 1);
    let pictures = |scene: &Scene, spec: &str| {
        let stage = Stage::new(scene.clone()).unwrap();
        let mut frames = FrameLoop::new(Arc::from(parse(spec).unwrap()), &stage, shot).unwrap();
        let bits: Vec<_> = (0..5).map(|_| bits(&frames.render().unwrap().picture())).collect();
        (bits, [again, rough].map(|what| skips(&stage, spec, &shot, what)))
    };
    let mut moves = room();
    let at = |x: f32| look_at(Vec3::new(x, 1.0, -3.0), Vec3::Y, 0.75).to_world.fixed();
    let place = |x: f32| at(x).to_scale_rotation_translation().2;
    let keys = vec![(0.0, place(0.0)), (1.0, place(1.0))];
    let translation = Curve { keys, interpolation: Interpolation::Linear };
    let rotation = Curve::constant(at(0.0).to_scale_rotation_translation().1);
    let track = Track::Trs { translation, rotation, scale: Curve::constant(Vec3::ONE) };
    moves.camera.to_world = Transform::Chain(vec![track]);
    moves.time = [0.0, 1.0];
    let mut wall = moves.clone();
    wall.instances[1].to_world = restless(wall.instances[1].to_world.fixed());
    // Everything matt, and a glossy ball that no path reaches, inside of a matt one.
    let mut matt = moves.clone();
    let white = diffuse(&mut matt, 0.6);
    for object in &mut matt.objects {
        Arc::make_mut(object).shapes.iter_mut().for_each(|shape| shape.material = white);
    }
    let mut hidden = matt.clone();
    let glossy = crate::support::metal(&mut hidden, 0.3);
    let center = Vec3::new(-0.5, 0.375, 0.25);
    let ball = Geometry::Sphere { center, radius: 0.125 };
    hidden.add_shape(Shape::new(ball, glossy));
    for keys in ["", ":direct=tree,neighbours=2,mature=0", ":predicate=footprint,shade=selected"] {
        let spec = format!("restir-pt{keys}");
        let [moves, wall, matt, hidden] =
            [&moves, &wall, &matt, &hidden].map(|scene| pictures(scene, &spec));
        assert_eq!((moves.1, wall.1), ([true, false], [false, false]));
        assert_eq!((matt.1, hidden.1), ([true, true], [true, false]));
        assert_eq!(moves.0, wall.0, "{spec}");
        assert_eq!(matt.0, hidden.0, "{spec}");
        assert_ne!(moves.0, matt.0);
    }
}

#[test]
fn what_moved_is_not_asked_for_where_nothing_moves() {
    let still = Stage::new(room()).unwrap();
    let moving = Stage::moving(room()).unwrap();
    for (stage, told) in [(&still, 0.0), (&moving, 1.0)] {
        let mut frames = FrameLoop::new(Arc::new(Told), stage, shot([4, 4], 2, 1)).unwrap();
        frames.render().unwrap();
        let shown = frames.render().unwrap().picture();
        assert!(
            shown.pixels.iter().all(|pixel| *pixel == Vec3::splat(told)),
            "{:?}",
            shown.pixels[0]
        );
    }
}

/// The boiling filter compares with the mean of the pixels that have a sample: where a few of a
/// tile are lit, alike, it drops none of them.
#[test]
fn boiling_takes_dark_pixels_for_no_part_of_the_mean() {
    let mut scene = Scene::new("patch");
    let white = diffuse(&mut scene, 0.5);
    let disk = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Y, radius: 0.12 };
    scene.add_shape(Shape::new(disk, white));
    for side in [-1.0, 1.0] {
        let place = Affine3A::from_translation(Vec3::new(side, 30.0, 0.0));
        light(&mut scene, LightKind::Point { intensity: Vec3::splat(900.0) }, place);
    }
    scene.camera = look_at(Vec3::new(0.0, 1.0, -0.01), Vec3::ZERO, 1.0);
    let stage = Stage::new(scene).unwrap();
    let shot = shot([16, 16], 2, 1);
    let [plain, filtered] =
        ["restir-di", "restir-di:boiling=0.9"].map(|spec| last_frame(&stage, spec, shot, 4).0);
    let lit = plain.pixels.iter().filter(|pixel| pixel.max_element() > 0.0).count();
    assert!((4..40).contains(&lit), "{lit} pixels are lit");
    let ratio = filtered.mean_luminance() / plain.mean_luminance();
    assert!((ratio - 1.0).abs() < 0.05, "the filter leaves {ratio}");
}
