//! What the tests share: scenes built in code, and estimates with their standard errors.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::Frame;
use afterimage::picture::Picture;
use afterimage::plan::{Claim, Filter, Shot};
use afterimage::scene::{
    Camera, Color, ConductorColor, Geometry, Light, LightKind, Material, MaterialId, Mesh,
    Roughness, Scene, Shape, Transform,
};
use afterimage::stats::{
    Equivalence, Estimate, Margin, Moments, Verdict, equivalence, samples_for_bias, t_test, welch,
};
use afterimage::techniques::{REGISTRY, parse};
use glam::{Affine3A, Mat3, Vec3};

/// A shot of `size` pixels with the point filter.
pub(crate) fn shot(size: [u32; 2], depth: u32, effort: u32) -> Shot {
    Shot { size, depth, filter: Filter::Point, run: 1, effort: effort as f32, fps: 30 }
}

/// A Lambert material.
/// The scenes of the repository by their names, in the order of these.
pub(crate) fn own_scenes() -> Vec<(String, Scene)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let files = std::fs::read_dir(folder).expect("the folder of scenes");
    let mut files: Vec<_> = files.map(|file| file.expect("a file").path()).collect();
    files.retain(|file| file.extension().is_some_and(|end| end == "pbrt"));
    files.sort();
    let load = |file: &PathBuf| afterimage::scene::load::load(file).expect("a scene").scene;
    let name = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    files.iter().map(|file| (name(file), load(file))).collect()
}

pub(crate) fn diffuse(scene: &mut Scene, albedo: f32) -> MaterialId {
    scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(albedo)) })
}

/// A mesh of one planar polygon, as a fan; its normal points to where its corners run
/// counter-clockwise.
pub(crate) fn polygon(corners: &[Vec3]) -> Geometry {
    let triangles = (2..corners.len() as u32).map(|i| [0, i - 1, i]).collect();
    Geometry::Mesh(Arc::new(Mesh { positions: corners.to_vec(), triangles, ..Mesh::default() }))
}

/// A camera at `from` that looks at `to`.
pub(crate) fn look_at(from: Vec3, to: Vec3, fov: f32) -> Camera {
    let forward = (to - from).normalize();
    let up = if forward.y.abs() > 0.99 { Vec3::Z } else { Vec3::Y };
    let right = up.cross(forward).normalize();
    let to_world =
        Affine3A::from_cols(right.into(), forward.cross(right).into(), forward.into(), from.into());
    Camera { to_world: Transform::Fixed(to_world), fov }
}

/// A sphere around the origin, seen from inside.
pub(crate) fn sphere(radius: f32, material: MaterialId) -> Shape {
    Shape {
        reverse_orientation: true,
        ..Shape::new(Geometry::Sphere { center: Vec3::ZERO, radius }, material)
    }
}

/// Adds a small receiver at `at`: a patch with normal `n` and a camera that sees nothing else, at
/// cosine `mu` to it.
pub(crate) fn receiver(scene: &mut Scene, at: Vec3, n: Vec3, mu: f32, material: MaterialId) {
    let frame = Frame::from_normal(n);
    let corner = |x: f32, y: f32| at + (frame.tangent * x + frame.bitangent * y) * 0.01;
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    scene.add_shape(Shape::new(polygon(&corners), material));
    let towards_camera = n * mu + frame.tangent * (1.0 - mu * mu).sqrt();
    // All that is seen lies within 10⁻⁶ of `at`, from directions within 2·10⁻⁶.
    scene.camera = look_at(at + 0.25 * towards_camera, at, 2e-6);
}

/// Light from everywhere at infinity.
pub(crate) fn environment(scene: &mut Scene, radiance: Vec3) {
    let kind = LightKind::Environment { radiance, image: None };
    light(scene, kind, Affine3A::IDENTITY);
}

/// Adds a light without a surface.
pub(crate) fn light(scene: &mut Scene, kind: LightKind, to_world: Affine3A) {
    let key = scene.lights.len() as u64;
    scene.lights.push(Light { to_world: Transform::Fixed(to_world), kind, key });
}

/// Light space at `position` with +z along unit `axis`.
pub(crate) fn along(position: Vec3, axis: Vec3) -> Affine3A {
    let frame = Frame::from_normal(axis);
    Affine3A::from_mat3_translation(
        Mat3::from_cols(frame.tangent, frame.bitangent, frame.normal),
        position,
    )
}

/// A metal that reflects everything, of roughness `alpha`; 0 is a mirror.
pub(crate) fn metal(scene: &mut Scene, alpha: f32) -> MaterialId {
    scene.add_material(Material::Conductor {
        color: ConductorColor::Reflectance(Color::Constant(Vec3::ONE)),
        roughness: Roughness::isotropic(alpha),
    })
}

/// A room that has something of everything whose image has the same bits under exact changes:
/// coloured Lambert walls, a glossy and a mirroring metal, glass, and grey lights of three shapes.
/// All coordinates have few digits.
pub(crate) fn room() -> Scene {
    let mut scene = Scene::new("room");
    let paint = |scene: &mut Scene, rgb: [f32; 3]| {
        scene.add_material(Material::Diffuse { reflectance: Color::Constant(rgb.into()) })
    };
    let grey = paint(&mut scene, [0.7, 0.7, 0.7]);
    let red = paint(&mut scene, [0.6, 0.1, 0.2]);
    let green = paint(&mut scene, [0.1, 0.5, 0.3]);
    let glossy = metal(&mut scene, 0.2);
    let mirror = metal(&mut scene, 0.0);
    let roughness = Roughness::SMOOTH;
    let glass = scene.add_material(Material::Dielectric { eta: 1.5, roughness });
    let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let walls = [
        ([c(-1.0, 0.0, -1.0), c(-1.0, 0.0, 1.0), c(1.0, 0.0, 1.0), c(1.0, 0.0, -1.0)], grey),
        ([c(-1.0, 2.0, -1.0), c(1.0, 2.0, -1.0), c(1.0, 2.0, 1.0), c(-1.0, 2.0, 1.0)], grey),
        ([c(-1.0, 0.0, 1.0), c(-1.0, 2.0, 1.0), c(1.0, 2.0, 1.0), c(1.0, 0.0, 1.0)], grey),
        ([c(-1.0, 0.0, -1.0), c(-1.0, 2.0, -1.0), c(-1.0, 2.0, 1.0), c(-1.0, 0.0, 1.0)], red),
        ([c(1.0, 0.0, -1.0), c(1.0, 0.0, 1.0), c(1.0, 2.0, 1.0), c(1.0, 2.0, -1.0)], green),
    ];
    for (corners, material) in walls {
        scene.add_shape(Shape::new(polygon(&corners), material));
    }
    let ball =
        |x: f32, y: f32, z: f32, radius: f32| Geometry::Sphere { center: c(x, y, z), radius };
    scene.add_shape(Shape::new(ball(-0.5, 0.375, 0.25, 0.375), glossy));
    scene.add_shape(Shape::new(ball(0.5, 0.375, 0.0, 0.375), mirror));
    scene.add_shape(Shape::new(ball(-0.125, 0.25, -0.5, 0.25), glass));
    let lamp =
        [c(-0.5, 1.875, -0.5), c(0.5, 1.875, -0.5), c(0.5, 1.875, 0.25), c(-0.5, 1.875, 0.25)];
    scene.add_shape(Shape::new(polygon(&lamp), grey).emitting(Vec3::splat(4.0)));
    scene.add_shape(Shape::new(ball(0.0, 1.0, 0.75, 0.125), grey).emitting(Vec3::splat(8.0)));
    let disk = Geometry::Disk { center: c(-0.75, 1.25, -0.5), normal: Vec3::X, radius: 0.25 };
    scene.add_shape(Shape::new(disk, grey).emitting(Vec3::splat(2.0)));
    scene.camera = look_at(c(0.0, 1.0, -3.0), c(0.0, 1.0, 0.0), 0.75);
    scene
}

/// The techniques, and `nee` with all lights, that claim to be unbiased for a scene; the others are
/// left out with a word.
pub(crate) fn unbiased(stage: &Stage, shot: &Shot) -> Vec<&'static str> {
    REGISTRY
        .iter()
        .map(|entry| entry.name)
        .chain(["nee:lights=all"])
        .filter(|name| match parse(name).unwrap().plan(stage.facts(), shot).claim {
            Claim::Biased(why) => {
                println!("{}: left out `{name}`: {why}", stage.scene().name);
                false
            }
            _ => true,
        })
        .collect()
}

/// The last of `frames` frames after a restart.
pub(crate) fn last_frame(
    stage: &Stage,
    spec: &str,
    shot: Shot,
    frames: u32,
) -> (Picture, Counters) {
    let mut frame_loop = FrameLoop::new(Arc::from(parse(spec).unwrap()), stage, shot).unwrap();
    for _ in 1..frames {
        frame_loop.render().unwrap();
    }
    let frame = frame_loop.render().unwrap();
    assert_eq!(frame.counters.non_finite, 0, "{spec} gave values that are not finite");
    (frame.picture(), frame.counters)
}

/// The picture of the first frame.
pub(crate) fn picture(stage: &Stage, spec: &str, shot: Shot) -> Picture {
    last_frame(stage, spec, shot, 1).0
}

/// Bits of a picture, for comparisons that know no tolerance.
pub(crate) fn bits(picture: &Picture) -> Vec<[u32; 3]> {
    picture.pixels.iter().map(|p| p.to_array().map(f32::to_bits)).collect()
}

/// Mean of the red channel.
pub(crate) fn mean_red(picture: &Picture) -> f64 {
    picture.pixels.iter().map(|p| f64::from(p.x)).sum::<f64>() / picture.pixels.len() as f64
}

/// The picture's mean in the first frame of each of `count` restarts: independent for any
/// technique.
pub(crate) fn restarts(stage: &Stage, spec: &str, shot: Shot, count: u64) -> Moments {
    let mut frame_loop = FrameLoop::new(Arc::from(parse(spec).unwrap()), stage, shot).unwrap();
    (0..count)
        .map(|restart| {
            frame_loop.restart(shot.run + restart);
            let frame = frame_loop.render().unwrap();
            assert_eq!(frame.counters.non_finite, 0, "{spec} gave values that are not finite");
            mean_red(&frame.picture())
        })
        .collect()
}

/// Probability of a pass where the true difference is δ.
pub(crate) const ALPHA: f64 = 1e-3;
/// δ, relative to the answer.
pub(crate) const DELTA: f64 = 0.005;
/// Restarts of a test: enough that skewness can be judged, few enough that each mean is over many
/// paths.
pub(crate) const RESTARTS: u64 = 64;

/// Effort with which [`RESTARTS`] restarts pass with a probability of 99.9 % where there is no
/// bias: n = ((z₁₋α + z₀.₉₉₉₅) c/δ)² paths. Also gives c, a path's standard deviation over its
/// mean, from a pilot of other runs. The factor is for what the pilot does not know of c (4 %) and
/// for Student's quantile in the place of z.
fn effort(stage: &Stage, spec: &str, shot: Shot, sides: f64) -> (u32, f64) {
    let noise = |effort: u32| {
        let shot = Shot { effort: effort as f32, run: 1 << 40, ..shot };
        let pilot = restarts(stage, spec, shot, 4 * RESTARTS);
        let paths = shot.pixels() as f64 * f64::from(effort);
        let c = pilot.variance().sqrt() / pilot.mean() * paths.sqrt();
        assert!(c.is_finite(), "{spec} sees nothing: {pilot:?}");
        c
    };
    let mut c = noise(1);
    // Lobes learn from the first path of a frame on; under even light that is for the worse.
    if c > 1e-4 && parse(spec).unwrap().plan(stage.facts(), &shot).buffer("lobes").is_some() {
        c = c.max(noise(16));
    }
    let paths = sides * samples_for_bias(DELTA, 1.1 * c, 2.0 * ALPHA, 0.9995);
    let effort = (paths / (RESTARTS as f64 * shot.pixels() as f64)).ceil().max(1.0);
    assert!(effort < 2e4, "{spec} would need {paths:e} paths: choose another scene");
    (effort as u32, c)
}

fn margin(truth: f64) -> Margin {
    // A fail at 10⁻⁶: about a hundred of these tests run, with fixed seeds.
    Margin { delta: DELTA * truth, equivalence_alpha: ALPHA, difference_alpha: 1e-6 }
}

/// A sample's equivalence to `truth`, by TOST with margin δ · truth.
pub(crate) fn against(sample: &Moments, truth: f64) -> Equivalence {
    equivalence(&t_test(sample, truth), &margin(truth))
}

/// Asserts that a technique's mean is `truth`, and that it is not 1.01 · `truth`; within 10⁻⁵ where
/// there is no noise.
#[track_caller]
pub(crate) fn assert_mean(stage: &Stage, spec: &str, shot: Shot, truth: f64) {
    let (effort, c) = effort(stage, spec, shot, 1.0);
    assert_mean_with(stage, spec, Shot { effort: effort as f32, ..shot }, c, truth);
}

/// [`restarts`] with as many estimates as [`RESTARTS`] of `shot.effort` have. More effort is more
/// candidates but no more shadow rays for a technique that keeps reservoirs, so it gets more
/// restarts instead.
fn samples(stage: &Stage, spec: &str, shot: Shot) -> Moments {
    let plan = parse(spec).unwrap().plan(stage.facts(), &shot);
    if plan.buffer("reservoirs").is_some() {
        restarts(
            stage,
            spec,
            Shot { effort: 1.0, ..shot },
            RESTARTS * u64::from(shot.chains().max(4)),
        )
    } else {
        restarts(stage, spec, shot, RESTARTS)
    }
}

#[track_caller]
fn assert_mean_with(stage: &Stage, spec: &str, shot: Shot, c: f64, truth: f64) {
    let sample = samples(stage, spec, shot);
    let n = RESTARTS as f64 * f64::from(shot.effort) * shot.pixels() as f64;
    let result = against(&sample, truth);
    println!(
        "{} | {spec} | depth {} | n {n:.2e} | c {c:.3} | bias {:+.4} % | half width {:.4} %",
        stage.scene().name,
        shot.depth,
        100.0 * result.test.difference / truth,
        50.0 * (result.interval.1 - result.interval.0) / truth,
    );
    if c < 2e-3 {
        // No noise but that of rounding, of whose distribution nothing is known; where paths are
        // connected, of directions between points.
        let most = if c < 1e-4 { rounded(spec, 1e-5) } else { 5e-5 };
        assert!(result.test.difference.abs() < most * truth, "{spec}, truth {truth}: {result:?}");
        return;
    }
    assert_eq!(result.verdict, Verdict::Pass, "{spec}, truth {truth}: {result:?}");
    let control = against(&sample, 1.01 * truth);
    assert_eq!(control.verdict, Verdict::Fail, "{spec}, the control must fail: {control:?}");
}

/// [`assert_mean`] for every technique that claims it and does not need very many paths for it.
#[track_caller]
pub(crate) fn assert_means(scene: Scene, shot: Shot, truth: f64) {
    let stage = Stage::new(scene).unwrap();
    let names = unbiased(&stage, &shot);
    assert!(names.contains(&"nee"));
    for name in names {
        let (effort, c) = effort(&stage, name, shot, 1.0);
        if name != "nee" && c > 1.8 {
            println!("{}: left out `{name}`: c {c:.1} would take too long", stage.scene().name);
        } else {
            assert_mean_with(&stage, name, Shot { effort: effort as f32, ..shot }, c, truth);
        }
    }
}

/// Asserts that two ways to the same picture have the same mean, and that a hundredth more would be
/// seen.
#[track_caller]
pub(crate) fn assert_same_mean(a: (&Stage, Shot), b: (&Stage, Shot), spec: &str) {
    let sample = |(stage, shot): (&Stage, Shot), first: u64| {
        let (effort, _) = effort(stage, spec, shot, 2.0);
        samples(stage, spec, Shot { effort: effort as f32, run: shot.run + first, ..shot })
    };
    let (x, y) = (sample(a, 0).estimate(), sample(b, 1 << 20).estimate());
    let result = equivalence(&welch(&x, &y), &margin(y.mean));
    assert_eq!(result.verdict, Verdict::Pass, "{spec}: {result:?}");
    let brighter = Estimate { mean: 1.01 * y.mean, ..y };
    let control = equivalence(&welch(&x, &brighter), &margin(y.mean));
    assert_eq!(control.verdict, Verdict::Fail, "{spec}, the control must fail: {control:?}");
}

/// A tolerance for rounding, at least that of the estimates which a technique keeps: 16 bits a
/// channel, of which the largest has 15.
pub(crate) fn rounded(spec: &str, tolerance: f64) -> f64 {
    if spec.starts_with("restir-pt") { tolerance.max(0.5f64.powi(15)) } else { tolerance }
}

/// Asserts that every pixel is `truth` to within `tolerance` of it: there is no noise, so no
/// statistics.
#[track_caller]
pub(crate) fn assert_exact(picture: &Picture, truth: f64, tolerance: f64) {
    for pixel in &picture.pixels {
        let error = f64::from(pixel.x) / truth - 1.0;
        assert!(error.abs() <= tolerance, "{pixel} instead of {truth}: {error:e}");
    }
    let control = f64::from(picture.pixels[0].x) / (1.01 * truth) - 1.0;
    assert!(control.abs() > tolerance, "the control must fail");
}
