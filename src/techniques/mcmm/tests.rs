//! The mean of what is shown, with faults planted beside it; what is shown of single samples; what
//! frames have to do with each other.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::*;
use crate::counters::Counters;
use crate::frame::{FrameLoop, Stage};
use crate::math::luminance;
use crate::picture::Picture;
use crate::plan::{Filter, Shot};
use crate::scene::{
    Camera, Color, Geometry, Light, LightKind, Material, Mesh, Scene, Shape, Texture, TextureKind,
    Transform, load,
};
use crate::stats::{Estimate, Margin, Moments, Verdict, equivalence, welch};
use crate::techniques::parse;

fn scene(name: &str) -> Scene {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    load::load(&root.join("scenes").join(name)).unwrap().scene
}

fn shot(size: [u32; 2], effort: u32) -> Shot {
    Shot { size, depth: 2, filter: Filter::Point, run: 1, effort: effort as f32, fps: 30 }
}

/// Pictures of frames after `warm` of them, and the work of all.
fn frames(
    technique: impl Technique + 'static,
    scene: &Scene,
    shot: Shot,
    (warm, count): (u32, u32),
    mut each: impl FnMut(&Picture),
) -> Counters {
    let stage = Stage::new(scene.clone()).unwrap();
    let mut frames = FrameLoop::new(Arc::new(technique), &stage, shot).unwrap();
    let mut work = Counters::default();
    for frame in 0..warm + count {
        let outcome = frames.render().unwrap();
        work = work + outcome.counters;
        if frame >= warm {
            each(&outcome.picture());
        }
    }
    work
}

fn mean_of(picture: &Picture) -> f64 {
    let sum: f64 = picture.pixels.iter().map(|rgb| f64::from(luminance(*rgb))).sum();
    sum / picture.pixels.len() as f64
}

const SIZE: [u32; 2] = [32, 32];

/// What `nee` shows of a scene: the means of `count` frames of 16 paths a pixel.
struct Truth {
    scene: Scene,
    depth: u32,
    means: Moments,
}

impl Truth {
    fn new(scene: Scene, depth: u32, count: u32) -> Self {
        let lights = crate::techniques::LightSampling::All;
        let nee = crate::techniques::PathTracer { lights, ..Default::default() };
        let shot = Shot { run: 77, depth, ..shot(SIZE, 16) };
        let mut means = Moments::default();
        frames(nee, &scene, shot, (0, count), |picture| means.push(mean_of(picture)));
        Self { scene, depth, means }
    }

    /// The means of `count` frames of a technique, after twenty; they err independently.
    fn shown(&self, technique: Mcmm, effort: u32, count: u32) -> Moments {
        let shot = Shot { depth: self.depth, ..shot(SIZE, effort) };
        let mut means = Moments::default();
        frames(technique, &self.scene, shot, (20, count), |p| means.push(mean_of(p)));
        means
    }

    /// Relative bias of a technique's mean and its standard error.
    fn bias(&self, technique: Mcmm, effort: u32, count: u32) -> (f64, f64) {
        let shown = self.shown(technique, effort, count);
        let relative = |m: &Moments| m.standard_error() / self.means.mean();
        let error = relative(&shown).hypot(relative(&self.means));
        (shown.mean() / self.means.mean() - 1.0, error)
    }

    /// Asserts that a technique's mean is that of `nee` to 1 % (TOST, α = 10⁻³), so that a code
    /// that is 1 % wrong passes once in a thousand; against a truth of 2 % more it must not pass.
    fn assert_equal(&self, spec: &str, effort: u32, count: u32) {
        let shown = self.shown(with(spec, Planted::Nothing), effort, count).estimate();
        let truth = self.means.estimate();
        let delta = 0.01 * truth.mean;
        let margin = Margin { delta, equivalence_alpha: 1e-3, difference_alpha: 1e-6 };
        let result = equivalence(&welch(&shown, &truth), &margin);
        let name = &self.scene.name;
        let [bias, error] =
            [result.test.difference, result.test.standard_error].map(|x| 100.0 * x / truth.mean);
        println!("{spec} on {name}: {bias:+.2} ± {error:.2} %");
        assert_eq!(result.verdict, Verdict::Pass, "{spec} on {name}: {result:?}");
        let brighter = Estimate { mean: 1.02 * truth.mean, ..truth };
        let control = equivalence(&welch(&shown, &brighter), &margin);
        assert_ne!(control.verdict, Verdict::Pass, "{spec} on {name}: the control must not pass");
    }
}

fn with(spec: &str, planted: Planted) -> Mcmm {
    let (_, pairs) = spec.split_once(':').unwrap_or((spec, ""));
    let keys: Vec<&str> = rows().iter().map(|row| row.key).collect();
    let values = spec::Values::parse(spec, "mcmm", pairs, &keys).unwrap();
    Mcmm { planted, ..spec::build(Mcmm::default(), &rows(), &values).unwrap() }
}

/// A floor of ridges under a lamp on each side, one slope a column of pixels: neighbours see
/// different lamps.
fn ridges() -> Scene {
    let mut scene = Scene::new("ridges");
    let white = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ONE) });
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    // 32 strips between −1 and 1, up and down in turn.
    for strip in 0..32_u32 {
        let x = |at: u32| at as f32 / 16.0 - 1.0;
        let height = |at: u32| if at.is_multiple_of(2) { 0.0 } else { 0.08 };
        let first = positions.len() as u32;
        for at in [strip, strip + 1] {
            positions.push(Vec3::new(x(at), height(at), -1.0));
            positions.push(Vec3::new(x(at), height(at), 1.0));
        }
        triangles.push([first, first + 1, first + 2]);
        triangles.push([first + 1, first + 3, first + 2]);
    }
    let mesh = Mesh { positions, triangles, ..Mesh::default() };
    scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), white));
    let black = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) });
    for side in [-4.0, 4.0] {
        let ball = Geometry::Sphere { center: Vec3::new(side, 1.2, 0.0), radius: 0.5 };
        scene.add_shape(Shape::new(ball, black).emitting(Vec3::splat(20.0)));
    }
    // So far away that all rays are nearly parallel.
    scene.camera = Camera {
        to_world: Transform::Fixed(glam::Affine3A::from_mat3_translation(
            glam::Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y),
            Vec3::Y * 200.0,
        )),
        fov: 2.0 * (1.0_f32 / 200.0).atan(),
    };
    scene
}

/// `lamps` with a floor two fifths of which are black: lanes without work beside others.
fn holes() -> Scene {
    let mut scene = scene("lamps.pbrt");
    let color = |value: f32| Color::Constant(Vec3::splat(value));
    let kind = TextureKind::Checkerboard { first: color(0.0), second: color(0.7) };
    let mapping = glam::Affine2::from_scale(Vec2::splat(37.0));
    let texture = scene.add_texture(Texture { kind, mapping });
    let checks = scene.add_material(Material::Diffuse { reflectance: Color::Texture(texture) });
    for object in &mut scene.objects {
        let object = Arc::make_mut(object);
        for shape in &mut object.shapes {
            if shape.emission.is_none() && matches!(&shape.geometry, Geometry::Mesh(_)) {
                shape.material = checks;
            }
        }
    }
    scene
}

/// Each fault is wrong by its sign, and what stands beside it is not: five standard errors are 2 to
/// 5 %, so faults of less are looked for in `estimators_are_unbiased`.
#[test]
fn faults_show_in_the_mean() {
    use Planted::{DeadKeep, Multiplicity, NoShift, NoTurn, Nothing, OtherReceiver, Twice};
    let lamps = Truth::new(scene("lamps.pbrt"), 2, 60);
    let (ridges, holes) = (Truth::new(ridges(), 2, 60), Truth::new(holes(), 2, 60));
    let pane = Truth::new(pane(), 4, 60);
    let tsmis = "mcmm:preset=paper,estimator=tsmis,set=8";
    let often = "mcmm:preset=falcor";
    let ssmis = "mcmm:preset=paper";
    let caustics = "mcmm:paths=caustics";
    let cases: [(&str, &Truth, u32, u32, Planted, f64); 13] = [
        (tsmis, &lamps, 1, 200, Nothing, 0.0),
        (often, &lamps, 1, 200, Nothing, 0.0),
        (ssmis, &lamps, 8, 200, Nothing, 0.0),
        (often, &holes, 1, 400, Nothing, 0.0),
        (ssmis, &ridges, 8, 200, Nothing, 0.0),
        (caustics, &pane, 4, 100, Nothing, 0.0),
        (tsmis, &lamps, 1, 200, NoShift, -1.0),
        (often, &lamps, 1, 200, NoShift, -1.0),
        (often, &holes, 1, 400, DeadKeep, -1.0),
        (tsmis, &lamps, 1, 200, Multiplicity, -1.0),
        (ssmis, &lamps, 8, 100, OtherReceiver, 1.0),
        (ssmis, &ridges, 8, 200, NoTurn, 1.0),
        (caustics, &pane, 4, 100, Twice, 1.0),
    ];
    for (spec, truth, effort, count, planted, sign) in cases {
        let (bias, error) = truth.bias(with(spec, planted), effort, count);
        let (z, name) = (bias / error, &truth.scene.name);
        let percent = [bias, error].map(|x| 100.0 * x);
        println!(
            "{spec} on {name}, {planted:?}: {:+.2} ± {:.2} %, z {z:+.1}",
            percent[0], percent[1]
        );
        if sign == 0.0 {
            assert!(z.abs() < 4.0, "{spec}: {bias} ± {error}");
        } else {
            assert!(z * sign > 5.0, "{spec}, {planted:?}: {bias} ± {error}");
        }
    }
}

/// A floor under a pane of glass and a wide lamp above it: all direct light is bent, so light
/// sampling finds none, and BSDF sampling much.
fn pane() -> Scene {
    let mut scene = Scene::new("pane");
    let grey = Color::Constant(Vec3::splat(0.5));
    let matt = scene.add_material(Material::Diffuse { reflectance: grey });
    let glass = scene.add_material(Material::ThinDielectric { eta: 1.5 });
    let disk = |height: f32, normal: Vec3, radius: f32| Geometry::Disk {
        center: Vec3::Y * height,
        normal,
        radius,
    };
    scene.add_shape(Shape::new(disk(0.0, Vec3::Y, 4.0), matt));
    scene.add_shape(Shape::new(disk(1.0, Vec3::Y, 5.0), glass));
    let lamp = Shape::new(disk(1.5, Vec3::NEG_Y, 2.0), matt).emitting(Vec3::splat(5.0));
    scene.add_shape(lamp);
    let ball = Geometry::Sphere { center: Vec3::new(0.4, 0.2, 0.1), radius: 0.2 };
    scene.add_shape(Shape::new(ball, matt));
    scene.camera = Camera {
        to_world: Transform::Fixed(glam::Affine3A::from_mat3_translation(
            glam::Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y),
            Vec3::Y * 0.9,
        )),
        fov: 1.4,
    };
    scene
}

/// `lamps` with a sky and a point light.
fn open_lamps() -> Scene {
    let mut scene = scene("lamps.pbrt");
    let place = glam::Affine3A::from_translation(Vec3::new(0.3, 1.0, 0.2));
    let radiance = Vec3::new(0.3, 0.4, 0.6);
    for (key, kind, to_world) in [
        (91, LightKind::Environment { radiance, image: None }, Transform::IDENTITY),
        (92, LightKind::Point { intensity: Vec3::splat(2.0) }, Transform::Fixed(place)),
    ] {
        scene.lights.push(Light { kind, key, to_world });
    }
    scene
}

/// The three estimators, and what lobes guide with what is left to the path tracer, are all light,
/// each part once: small lamps, a sky, a point light, light through glass.
#[test]
fn estimators_are_unbiased() {
    let lamps = Truth::new(scene("lamps.pbrt"), 2, 120);
    lamps.assert_equal("mcmm:light=0.5", 4, 1200);
    lamps.assert_equal("mcmm:light=0.5,estimator=tsmis,set=8", 1, 600);
    lamps.assert_equal("mcmm:light=0.5,estimator=mixture", 4, 1200);
    let open = Truth::new(open_lamps(), 3, 200);
    open.assert_equal("mcmm:light=0.5,paths=all", 4, 1200);
    let pane = Truth::new(pane(), 4, 200);
    pane.assert_equal("mcmm:paths=caustics,light=0.1", 4, 600);
    pane.assert_equal("mcmm:paths=all,light=0.1", 4, 600);
    pane.assert_equal("mcmm:paths=caustics,estimator=mixture,light=0.1", 4, 600);
}

/// The closed form in the head of `lamps`, where nothing hides a lamp: the floor before z = −1.2.
#[test]
fn the_floor_of_lamps_is_known() {
    let scene = scene("lamps.pbrt");
    let stage = Stage::new(scene.clone()).unwrap();
    let (world, size) = (stage.first_world(), [32, 32]);
    let all = crate::techniques::LightSampling::All;
    let nee = crate::techniques::PathTracer { lights: all, ..Default::default() };
    let mut shown = Vec::new();
    frames(nee, &scene, shot(size, 64), (0, 1), |picture| shown.clone_from(&picture.pixels));
    let lamps = [
        (Vec3::new(-1.2, 1.1, 0.2), Vec3::new(60.0, 6.0, 4.0)),
        (Vec3::new(0.2, 0.7, -0.6), Vec3::new(5.0, 40.0, 8.0)),
        (Vec3::new(1.3, 1.4, 0.5), Vec3::new(8.0, 12.0, 70.0)),
    ];
    let (rays, mut known, mut sum) = (scene.camera.rays(size), 0, Vec3::ZERO);
    for (pixel, shown) in (0..).zip(&shown) {
        let at = Vec2::new((pixel % 32) as f32, (pixel / 32) as f32) + 0.5;
        let ray = rays.ray(at);
        let (origin, direction) = (ray.origin, ray.direction);
        let ray = crate::accel::Ray { origin, direction, t_max: f32::INFINITY };
        let Some(hit) = world.closest_hit(&ray) else { continue };
        let p = world.surface(&hit).position;
        if p.y.abs() > 1e-4 || p.z > -1.2 || p.x.abs() > 1.0 {
            continue;
        }
        // One lamp may hide another one.
        let hides = |ball: Vec3, lamp: Vec3| {
            let way = lamp - p;
            let along = ((ball - p).dot(way) / way.length_squared()).clamp(0.0, 1.0);
            ball != lamp && (p + way * along).distance(ball) < 0.17
        };
        if lamps.iter().any(|(ball, _)| lamps.iter().any(|(lamp, _)| hides(*ball, *lamp))) {
            continue;
        }
        known += 1;
        let light = lamps.iter().map(|(center, radiance)| {
            let way = *center - p;
            *radiance * (0.08 * 0.08 * way.y / way.length().powi(3))
        });
        let expected = 0.7 * light.sum::<Vec3>();
        let error = (*shown - expected) / expected;
        assert!(error.abs().max_element() < 0.05, "{p}: {shown} {expected}");
        sum += error;
    }
    let mean = sum / known as f32;
    assert!(known > 50 && mean.abs().max_element() < 2e-3, "{known} pixels, off by {mean}");
}

/// A chain that keeps a lobe before it has learnt hands on none; as it is, lobes live.
#[test]
fn lobes_are_kept_after_they_have_learnt() {
    let scene = scene("lamps.pbrt");
    let lobes = |planted| {
        let technique = Mcmm { carry: 0.9, ..with("mcmm:light=0", planted) };
        frames(technique, &scene, shot([32, 32], 1), (0, 20), |_| {}).lobes
    };
    assert!(lobes(Planted::Nothing) > 5_000, "{}", lobes(Planted::Nothing));
    assert_eq!(lobes(Planted::StashFirst), 0);
}

/// With BSDF sampling alone a frame is that of `bsdf`, to rounding: the draws are the same.
#[test]
fn without_lobes_it_is_bsdf_sampling() {
    let scene = scene("lamps.pbrt");
    let picture = |spec: &str| {
        let technique = parse(spec).unwrap();
        let stage = Stage::new(scene.clone()).unwrap();
        let mut frames = FrameLoop::new(Arc::from(technique), &stage, shot([32, 32], 4)).unwrap();
        frames.render().unwrap();
        frames.render().unwrap().picture()
    };
    let bsdf = picture("bsdf");
    assert!(bsdf.pixels.iter().any(|rgb| *rgb != Vec3::ZERO));
    for spec in [
        "mcmm:light=0,large=1",
        "mcmm:light=0,large=1,estimator=mixture",
        "mcmm:light=0,reads=0,carry=0,large=1",
    ] {
        for (ours, theirs) in picture(spec).pixels.iter().zip(&bsdf.pixels) {
            let error = (*ours - *theirs).abs().max_element();
            assert!(error <= 1e-6 * theirs.max_element(), "{spec}: {ours} {theirs}");
        }
    }
}

/// A pixel's errors in consecutive frames are not correlated, nor are those of pixels in different
/// tiles; inside a tile lobes are turned once for all, which may only make them negative.
#[test]
fn frames_err_independently() {
    let scene = scene("lamps.pbrt");
    for spec in ["mcmm:light=0", "mcmm:estimator=tsmis,set=8", "mcmm:estimator=mixture"] {
        let mut all: Vec<Vec<f64>> = Vec::new();
        let effort = if spec.contains("tsmis") { 1 } else { 4 };
        frames(
            with(spec, Planted::Nothing),
            &scene,
            shot([32, 32], effort),
            (20, 120),
            |picture| {
                all.push(picture.pixels.iter().map(|rgb| f64::from(luminance(*rgb))).collect());
            },
        );
        let count = all.len() as f64;
        let (mut time, mut inside, mut across) =
            (Moments::default(), Moments::default(), Moments::default());
        for pixel in 0..32 * 32_usize {
            let mean = all.iter().map(|frame| frame[pixel]).sum::<f64>() / count;
            let spread = all.iter().map(|frame| (frame[pixel] - mean).powi(2)).sum::<f64>() / count;
            if spread <= 0.0 {
                continue;
            }
            // The mean of the same frames lends each product −1/count of the variance.
            let own = |a: f64| a / spread + 1.0 / count;
            for pair in all.windows(2) {
                time.push(own((pair[0][pixel] - mean) * (pair[1][pixel] - mean)));
            }
            if pixel % 32 == 31 {
                continue;
            }
            let next = all.iter().map(|frame| frame[pixel + 1]).sum::<f64>() / count;
            let other =
                all.iter().map(|frame| (frame[pixel + 1] - next).powi(2)).sum::<f64>() / count;
            if other <= 0.0 {
                continue;
            }
            let group = if pixel % 8 == 7 { &mut across } else { &mut inside };
            for frame in &all {
                let product = (frame[pixel] - mean) * (frame[pixel + 1] - next);
                group.push(product / (spread * other).sqrt());
            }
        }
        let z = |m: &Moments| m.mean() / (m.variance() / m.count() as f64).sqrt();
        println!(
            "{spec}: time {:+.4} z {:+.1}, across {:+.4} z {:+.1}, inside {:+.4} z {:+.1}",
            time.mean(),
            z(&time),
            across.mean(),
            z(&across),
            inside.mean(),
            z(&inside)
        );
        assert!(z(&time).abs() < 4.5 && z(&across).abs() < 4.5 && z(&inside) < 4.5, "{spec}");
    }
}

/// No sample is worth more than F/(b `p_h`), which in `lamps` is the radiance of the brightest
/// lamp, 70, by the albedo over b, since every BSDF sample there is worth its radiance times the
/// albedo.
#[test]
fn samples_are_bounded_by_the_defensive_share() {
    let scene = scene("lamps.pbrt");
    for spec in
        ["mcmm:light=0", "mcmm:light=0,estimator=mixture", "mcmm:light=0,score=branch,prior=0"]
    {
        let mut most = 0.0_f32;
        frames(with(spec, Planted::Nothing), &scene, shot([32, 32], 1), (0, 60), |picture| {
            let brightest = picture.pixels.iter().map(|rgb| rgb.max_element());
            most = brightest.fold(most, f32::max);
        });
        assert!(most <= 70.0 * 0.86 / 0.2 * 1.02, "{spec}: {most}");
    }
}

/// What the previous frame's buffer holds is nobody's business: anything is unbiased and finite.
#[test]
fn garbage_in_the_buffer_is_variance() {
    // Bits that are no lobe of any chain: through the states' own test of soundness.
    let mut random = crate::math::rng::Stream::from_key(9);
    let prior = Mcmm::default().prior_of_lobes();
    let mut usable = 0;
    for _ in 0..200_000 {
        let words: [u32; 8] = std::array::from_fn(|_| random.word());
        let state: LobeState = bytemuck::cast(words);
        if let Some(lobe) = state.shape(&prior).and_then(|shape| shape.at(Vec3::ONE)) {
            usable += 1;
            assert!(lobe.mean.is_normalized() && lobe.kappa.is_finite());
            let density = lobe.density(Vec3::Z);
            assert!(density >= 0.0 && density.is_finite(), "{state:?}");
        }
    }
    assert!(usable > 1000, "{usable}");
}
