//! Every technique on surfaces whose look depends on the view, while the camera, lights and
//! occluders move: in squares and strips of pixels, with an effort of 1 and of more.
//!
//! The floor is seven strips: a Lambert surface, where the view cancels, and six where it does not.
//! Each strip is a region of its own, so that no error hides behind a brighter surface. The truth
//! is `nee` with a scene of that frame alone, which knows no other frame and which other tests hold
//! to closed forms and to another renderer; its own standard error is asserted to be below a fifth
//! of δ.

use std::sync::Arc;

use afterimage::accel::Ray;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Claim, Shot};
use afterimage::scene::{
    Color, ConductorColor, Geometry, Image, ImageData, LightKind, Material, MaterialId, Roughness,
    Scalar, Scene, Shape, Texture, TextureKind, Transform, Wrap,
};
use afterimage::stats::Moments;
use afterimage::techniques::{Entry, REGISTRY, Technique};
use glam::{Affine2, Affine3A, Vec2, Vec3};
use rayon::prelude::*;

use crate::course::{Course, Look, assert_unbiased};
use crate::support::{diffuse, light, look_at, metal, polygon, shot};

const STRIPS: usize = 7;
/// Places in the list of instances, behind the strips.
const BLOCKER: usize = STRIPS;
const LAMP: usize = STRIPS + 1;

/// The strips' materials.
fn materials(scene: &mut Scene) -> [MaterialId; STRIPS] {
    // 4 x 4 texels, none like another.
    let texels =
        (0..16).map(|i| [0.2 + 0.05 * i as f32, 0.9 - 0.05 * i as f32, 0.5, 1.0]).collect();
    let image = scene.add_image(Image { width: 4, height: 4, data: ImageData::Float(texels) });
    let kind = TextureKind::Image { image, wrap: Wrap::Repeat, scale: 1.0, invert: false };
    let mapping = Affine2::from_scale(Vec2::new(2.0, 5.0));
    let texture = scene.add_texture(Texture { kind, mapping });
    let lambert = scene
        .add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::new(0.7, 0.5, 0.3)) });
    let coat = scene.add_material(Material::CoatedDiffuse {
        reflectance: Color::Constant(Vec3::new(0.2, 0.3, 0.6)),
        eta: 1.5,
        roughness: Roughness::isotropic(0.1),
    });
    let rough = Roughness { u: Scalar::Constant(0.5), v: Scalar::Constant(0.2), remap: false };
    let brushed = scene.add_material(Material::Conductor {
        color: ConductorColor::Reflectance(Color::Constant(Vec3::new(0.9, 0.6, 0.4))),
        roughness: rough,
    });
    let frosted =
        scene.add_material(Material::Dielectric { eta: 1.5, roughness: Roughness::isotropic(0.3) });
    let textured = scene.add_material(Material::MetallicRoughness {
        base_color: Color::Texture(texture),
        metallic: Scalar::Constant(0.5),
        roughness: Scalar::Texture(texture, afterimage::scene::Channel::Green),
        ior: 1.5,
        specular: Scalar::Constant(1.0),
        specular_color: Color::Constant(Vec3::ONE),
        transmission: Scalar::Constant(0.0),
        double_sided: true,
    });
    [lambert, metal(scene, 0.05), metal(scene, 0.2), coat, brushed, frosted, textured]
}

/// Strips from left to right, a ball that casts shadows above them, a lamp in front that all strips
/// mirror to the camera, and one below them that shines through the glass.
fn strips() -> Scene {
    let mut scene = Scene::new("strips");
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    for (i, material) in materials(&mut scene).into_iter().enumerate() {
        let (x, w) = (-2.1 + 0.6 * i as f32, 0.6);
        let corners = [c(x, 0.0, -1.0), c(x, 0.0, 2.0), c(x + w, 0.0, 2.0), c(x + w, 0.0, -1.0)];
        let mut shape = Shape::new(polygon(&corners), material);
        if let Geometry::Mesh(mesh) = &mut shape.geometry {
            let uv = |p: &Vec3| Vec2::new((p.x - x) / w, (p.z + 1.0) / 3.0);
            let uvs = mesh.positions.iter().map(uv).collect();
            Arc::make_mut(mesh).uvs = uvs;
        }
        scene.add_shape(shape);
    }
    let grey = diffuse(&mut scene, 0.5);
    let ball = Geometry::Sphere { center: c(0.0, 0.6, 0.4), radius: 0.25 };
    scene.add_shape(Shape::new(ball, grey));
    let lamp = [c(-3.5, 0.2, 3.0), c(-3.5, 2.4, 3.2), c(3.5, 2.4, 3.2), c(3.5, 0.2, 3.0)];
    scene.add_shape(Shape::new(polygon(&lamp), grey).emitting(c(2.0, 1.5, 1.0)));
    let below = Geometry::Sphere { center: c(0.9, -1.0, 0.5), radius: 0.5 };
    scene.add_shape(Shape::new(below, grey).emitting(c(2.0, 3.0, 4.0)));
    scene.camera = look_at(c(0.0, 1.6, -2.6), c(0.0, 0.0, 0.4), 0.9);
    scene
}

fn moved(scene: &mut Scene, instance: usize, by: Vec3) {
    scene.instances[instance].to_world = Transform::Fixed(Affine3A::from_translation(by));
}

/// A pan with a step to the side: every pixel's view turns.
fn camera(scene: &mut Scene, i: u32) {
    let t = 0.06 * i as f32;
    let (from, to) = (Vec3::new(2.0 * t, 1.6 - t, -2.6), Vec3::new(t, 0.0, 0.4));
    scene.camera = look_at(from, to, 0.9);
}

fn lamp(scene: &mut Scene, i: u32) {
    moved(scene, LAMP, Vec3::new(0.1 * i as f32, 0.05 * i as f32, 0.0));
}

fn blocker(scene: &mut Scene, i: u32) {
    moved(scene, BLOCKER, Vec3::new(0.2 * i as f32 - 0.4, 0.0, 0.1 * i as f32));
}

pub(crate) fn courses() -> [(&'static str, Course); 5] {
    let course = |at| Course { base: strips(), at };
    [
        ("still", course(|_, _| {})),
        ("camera", course(camera)),
        ("lamp", course(lamp)),
        ("occluder", course(blocker)),
        (
            "all",
            course(|scene, i| {
                camera(scene, i);
                lamp(scene, i);
                blocker(scene, i);
            }),
        ),
    ]
}

/// All of them move.
pub(crate) fn moving() -> (&'static str, Course) {
    let [.., all] = courses();
    all
}

/// The pixels of each strip.
fn regions(scene: &Scene, stage: &Stage, size: [u32; 2]) -> Vec<Vec<bool>> {
    let world = stage.first_world();
    let rays = scene.camera.rays(size);
    let strip = |pixel: u32| {
        let at = Vec2::new((pixel % size[0]) as f32, (pixel / size[0]) as f32) + 0.5;
        let ray = rays.ray(at);
        let ray = Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
        world.closest_hit(&ray).map(|hit| hit.instance as usize)
    };
    let strips: Vec<_> = (0..size[0] * size[1]).map(strip).collect();
    (0..STRIPS).map(|i| strips.iter().map(|at| *at == Some(i)).collect()).collect()
}

/// What each strip shows in a frame: `nee` with a scene that knows that frame only.
fn looks(course: &Course, shot: Shot, age: u32, delta: f64) -> Vec<Look> {
    const BATCHES: u64 = 16;
    let scene = course.frame(age);
    let stage = Stage::new(scene.clone()).unwrap();
    let technique: Arc<dyn Technique> = Arc::from(afterimage::techniques::parse("nee").unwrap());
    let shot = Shot { effort: 256.0, run: 1 << 50, ..shot };
    let pictures: Vec<Vec<Vec3>> = (0..BATCHES)
        .into_par_iter()
        .map(|batch| {
            let shot = Shot { run: shot.run + batch, ..shot };
            let mut frames = FrameLoop::new(technique.clone(), &stage, shot).unwrap();
            frames.render().unwrap().picture().pixels
        })
        .collect();
    let truth: Vec<Vec3> = (0..shot.pixels())
        .map(|at| pictures.iter().map(|picture| picture[at]).sum::<Vec3>() / BATCHES as f32)
        .collect();
    let look = |region: Vec<bool>| {
        let mean = |picture: &Vec<Vec3>| crate::course::means(picture, &region)[0];
        let sample: Moments = pictures.iter().map(mean).collect();
        let error = (sample.variance() / BATCHES as f64).sqrt() / sample.mean();
        assert!(error < delta, "the truth is known to {error} only");
        Look { age, region, truth: truth.clone() }
    };
    regions(&scene, &stage, shot.size).into_iter().map(look).collect()
}

const DELTA: f64 = 0.06;

/// Every strip of every technique that claims to be unbiased is, at ages 1 and 3.
pub(crate) fn check_strips(entries: &[Entry], (name, course): &(&str, Course), shot: Shot) {
    let stage = course.stage();
    let looks: Vec<Look> = [1, 3].iter().flat_map(|age| looks(course, shot, *age, DELTA)).collect();
    // With several near neighbours where it has any: they differ most in what they see of a strip.
    // As it is only where everything moves, and with most samples for lights where that can be
    // chosen: it is the noise of one.
    let near = "neighbours=3,radius=4,taps=random,mature=0";
    let specs = entries.iter().flat_map(|entry| {
        let has = |key| (entry.parameters)().iter().any(|parameter| parameter.key == key);
        let asks = has("neighbours");
        let lit = if has("light") { "light=0.9" } else { "" };
        let plain = (*name == "all").then_some((entry, lit));
        plain.into_iter().chain(asks.then_some((entry, near)))
    });
    for (entry, keys) in specs {
        let technique: Arc<dyn Technique> = Arc::from(entry.parse(keys).unwrap());
        let plan = technique.plan(stage.facts(), &shot);
        if plan.claim != Claim::Unbiased {
            println!("{name}: left out `{}`: {}", entry.name, plan.claim);
            continue;
        }
        if *name != "all" && !plan.keeps_history() {
            // It sees each frame as if it were the first.
            continue;
        }
        println!("{name}");
        assert_unbiased((course, &stage), &technique, shot, &looks, DELTA);
    }
}

/// Every strip of one configuration.
pub(crate) fn check_spec(entry: &Entry, keys: &str, (_, course): &(&str, Course), shot: Shot) {
    let stage = course.stage();
    let looks: Vec<Look> = [1, 3].iter().flat_map(|age| looks(course, shot, *age, DELTA)).collect();
    let technique: Arc<dyn Technique> = Arc::from(entry.parse(keys).unwrap());
    assert_unbiased((course, &stage), &technique, shot, &looks, DELTA);
}

#[test]
fn every_technique_shows_every_surface_while_anything_moves() {
    for course in &courses() {
        check_strips(REGISTRY, course, shot([24, 12], 2, 1));
    }
}

#[test]
fn an_effort_of_three_and_a_square_show_the_same() {
    let (name, mut all) = moving();
    // A light that no ray meets, too.
    let place = Affine3A::from_translation(Vec3::new(0.0, 2.0, -1.0));
    light(&mut all.base, LightKind::Point { intensity: Vec3::splat(1.0) }, place);
    let all = (name, all);
    check_strips(REGISTRY, &all, shot([20, 20], 2, 3));
}
