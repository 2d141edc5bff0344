//! `nee` against an independent renderer: Mitsuba 3.9.1's path tracer on the same files
//! (`../shared/references`, 16 runs, with variances).
//!
//! α = 0.01, δ = 0.5 % of the image's mean luminance (1 % on veach-bidir, whose caustics leave
//! fireflies); tiles of 32² pixels by Welch with Holm at 10⁻³. Both pictures are box filtered;
//! pixels whose 3×3 neighbourhood sees an emitter are masked. The control is the same picture with
//! all reflected light × 1.01, which must fail. Figures stand in `docs/results.md`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use afterimage::accel::Ray;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{Material, Scalar, TextureKind, load};
use afterimage::stats::{Criteria, PictureTest, Restarts, Truth, Verdict};
use afterimage::techniques::parse;
use glam::{Affine2, Vec2, Vec3};

/// `../shared/…`, or `None` with a printed note.
pub(crate) fn shared(path: &str) -> Option<PathBuf> {
    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(path);
    if !full.exists() {
        println!("skipped: {} is not there", full.display());
        return None;
    }
    Some(full)
}

pub(crate) fn read_exr(path: &Path) -> (usize, usize, Vec<Vec3>) {
    let new =
        |size: exr::math::Vec2<usize>, _: &_| (size.0, size.1, vec![Vec3::ZERO; size.0 * size.1]);
    let set = |image: &mut (usize, usize, Vec<Vec3>),
               at: exr::math::Vec2<usize>,
               (r, g, b, _): (f32, f32, f32, f32)| {
        image.2[at.1 * image.0 + at.0] = Vec3::new(r, g, b);
    };
    let image =
        exr::prelude::read_first_rgba_layer_from_file(path, new, set).expect("a reference EXR");
    image.layer_data.channel_data.pixels
}

/// Pixels that count: no emitter within one pixel.
pub(crate) fn mask(emission: &[Vec3], width: usize, height: usize) -> Vec<bool> {
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
            rows.flat_map(|v| {
                (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |u| v * width + u)
            })
            .all(|j| emission[j] == Vec3::ZERO)
        })
        .collect()
}

/// Marks pixels that see metal with α ≥ 0.2. The reference's masking is separable, G₁(o) G₁(i),
/// ours height-correlated, as in pbrt and the specification: 1 % brighter on such a plate. (With
/// separable masking here no tile differs; see `docs/results.md`.)
fn exclude_rough_metal(stage: &Stage, size: [u32; 2], marked: &mut [Vec3]) {
    let world = stage.first_world();
    let rays = world.scene.camera.rays(size);
    for (i, mark) in marked.iter_mut().enumerate() {
        let at = Vec2::new((i as u32 % size[0]) as f32 + 0.5, (i as u32 / size[0]) as f32 + 0.5);
        let ray = rays.ray(at);
        let hit = world.closest_hit(&Ray {
            origin: ray.origin,
            direction: ray.direction,
            t_max: f32::INFINITY,
        });
        let Some(hit) = hit else { continue };
        let (shape, _) = world.accel.shape_of(&hit);
        if let Material::Conductor { roughness, .. } =
            world.scene.materials[world.shapes[shape as usize].material.index()]
            && matches!(roughness.u, Scalar::Constant(alpha) if alpha >= 0.2)
        {
            *mark = Vec3::ONE;
        }
    }
}

struct Case {
    scene: &'static str,
    delta: f64,
    restarts: u32,
    spp: u32,
}

fn run(case: &Case) -> Option<(PictureTest, PictureTest)> {
    let Case { scene, delta, restarts, spp } = *case;
    let file = shared(&format!("scenes/{scene}/scene.pbrt"))?;
    let (width, height, mean) = read_exr(&shared(&format!("references/{scene}.exr"))?);
    let (_, _, variance) = read_exr(&shared(&format!("references/{scene}_variance.exr"))?);
    let reference = Truth::with_variance(width, height, mean, variance, 15.0).unwrap();
    let mut loaded = load::load(&file).unwrap().scene;
    // The reference reads pictures with their first row at t = 0, pbrt (and the scenes' own
    // published images) at t = 1.
    for texture in &mut loaded.textures {
        if let TextureKind::Image { .. } = texture.kind {
            texture.mapping =
                Affine2::from_scale_angle_translation(Vec2::new(1.0, -1.0), 0.0, Vec2::Y)
                    * texture.mapping;
        }
    }
    let stage = Stage::new(loaded).unwrap();
    let size = [width as u32, height as u32];
    let shot = Shot { size, depth: 8, filter: Filter::Box, run: 0, effort: spp as f32, fps: 30 };
    let mut frames = FrameLoop::new(Arc::from(parse("nee").unwrap()), &stage, shot).unwrap();
    let mut seen = vec![Vec3::ZERO; width * height];
    let mut pictures = Vec::new();
    for restart in 0..restarts {
        frames.restart(1000 + u64::from(restart));
        let frame = frames.render().unwrap();
        assert_eq!(frame.counters.non_finite, 0, "{scene}");
        for (sum, value) in seen.iter_mut().zip(&frame.emission().pixels) {
            *sum += *value;
        }
        pictures.push(frame.picture().pixels);
    }
    let mut excluded = seen;
    if scene == "veach-mis" {
        exclude_rough_metal(&stage, [width as u32, height as u32], &mut excluded);
    }
    let mask = mask(&excluded, width, height);
    let criteria = Criteria {
        delta,
        equivalence_alpha: 0.01,
        tile_alpha: 1e-3,
        channels: false,
        ..Criteria::default()
    };
    let test = |factor: f32| {
        let mut all = Restarts::new(width, height, 32, Some(mask.clone())).unwrap();
        for picture in &pictures {
            let scaled: Vec<Vec3> = picture.iter().map(|p| *p * factor).collect();
            all.push(&scaled).unwrap();
        }
        all.compare(&reference, &criteria).unwrap()
    };
    Some((test(1.0), test(1.01)))
}

fn show(case: &Case, name: &str, test: &PictureTest) {
    let (low, high) = test.relative_interval();
    println!(
        "{:<12} {name:<8} {:?} {:+.3} % [{:+.3}, {:+.3}] of ±{} %, {} x {} spp, {} of {} tiles rejected, min p {:.1e}",
        case.scene,
        test.luminance.verdict,
        100.0 * test.relative(),
        100.0 * low,
        100.0 * high,
        100.0 * case.delta,
        test.restarts,
        case.spp,
        test.tiles_rejected,
        test.tiles.len(),
        test.tiles_min_p,
    );
}

fn check(case: &Case) {
    let Some((test, control)) = run(case) else { return };
    show(case, "nee", &test);
    show(case, "× 1.01", &control);
    assert_eq!(
        test.luminance.verdict,
        Verdict::Pass,
        "{}: not equivalent to the reference",
        case.scene
    );
    assert_eq!(test.tiles_rejected, 0, "{}: a tile differs from the reference", case.scene);
    assert_ne!(control.luminance.verdict, Verdict::Pass, "{}: the control passed", case.scene);
}

#[test]
#[ignore = "slow: 20 s"]
fn cornell_box() {
    check(&Case { scene: "cornell-box", delta: 0.005, restarts: 16, spp: 8 });
}

// The names of tests that the continuous run skips begin with `long_`.

#[test]
#[ignore = "long: 12 minutes"]
fn long_veach_mis() {
    // Three times the samples of the others: the reference's own standard error, 0.10 %, leaves
    // little room in the margin.
    check(&Case { scene: "veach-mis", delta: 0.005, restarts: 48, spp: 256 });
}

#[test]
#[ignore = "long: 3 minutes"]
fn long_veach_ajar() {
    check(&Case { scene: "veach-ajar", delta: 0.005, restarts: 16, spp: 80 });
}

#[test]
#[ignore = "long: 5 minutes"]
fn long_veach_bidir() {
    check(&Case { scene: "veach-bidir", delta: 0.01, restarts: 16, spp: 192 });
}

/// The coated-diffuse deviation, as a number. The reference's `roughplastic` loses energy in its
/// rough interface (at ρ = 0.8, α = 0.2 it reflects 0.547 of normal light, ours 0.639; smooth coats
/// agree to 4 digits), and a closed room of such panels multiplies that: we are about 11 %
/// brighter. Not an equivalence: the interval only catches a change. See `docs/results.md`.
#[test]
#[ignore = "slow: 150 s"]
fn living_room_coats() {
    let case = Case { scene: "living-room", delta: 0.01, restarts: 8, spp: 24 };
    let Some((test, _)) = run(&case) else { return };
    show(&case, "nee", &test);
    let (low, high) = test.relative_interval();
    assert!(
        low > 0.08 && high < 0.14,
        "the deviation of coated surfaces changed: {:+.3} %",
        100.0 * test.relative()
    );
}
