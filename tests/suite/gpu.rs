//! Scene files on both backends. Skipped with a reason where no adapter is; a failure under
//! `AFTERIMAGE_REQUIRE_GPU=1`.

use std::path::Path;
use std::sync::Arc;

use afterimage::frame::{Backend, FrameLoop, Stage};
use afterimage::gpu::Gpu;
use afterimage::plan::{Filter, Shot};
use afterimage::scene::load::load;
use afterimage::stats::{Moments, t_test};
use afterimage::techniques::parse;

fn device() -> Option<Arc<Gpu>> {
    match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var("AFTERIMAGE_REQUIRE_GPU").is_ok_and(|v| v == "1");
            assert!(!required, "AFTERIMAGE_REQUIRE_GPU=1, but {error}");
            eprintln!("skipped: {error}");
            None
        }
    }
}

/// Means of the picture and its four tiles.
fn means(frames: &mut FrameLoop, count: u32) -> [f64; 5] {
    let mut means = [0.0; 5];
    for _ in 0..count {
        let picture = frames.render().unwrap().picture();
        let (width, height) = (picture.width, picture.height);
        means = [0.0; 5];
        for (at, pixel) in picture.pixels.iter().enumerate() {
            let (x, y) = (at as u32 % width, at as u32 / width);
            let tile = u32::from(x >= width / 2) + 2 * u32::from(y >= height / 2);
            let share = 1.0 / f64::from(width * height);
            let value = f64::from(afterimage::math::luminance(*pixel)) * share;
            means[0] += value;
            means[1 + tile as usize] += value;
        }
    }
    means
}

/// Two one-sided t tests (α = 10⁻³) place the mean of paired differences, GPU − CPU with equal
/// seeds, within 0.5 % of the picture's mean; no single pair leaves that margin, since rare
/// decisions by rounding skew the differences.
fn assert_equivalent(gpu: &Arc<Gpu>, stage: &Stage, name: &str, spec: &str, how: (Shot, u32, u32)) {
    const DELTA: f64 = 0.005;
    let (shot, frames, restarts) = how;
    let start = |backend: &Backend| {
        FrameLoop::with_backend(Arc::from(parse(spec).unwrap()), stage, shot, backend).unwrap()
    };
    let (mut here, mut there) = (start(&Backend::Cpu), start(&Backend::Gpu(gpu.clone())));
    let (mut pairs, mut mean) = (Vec::new(), 0.0);
    for restart in 0..restarts {
        here.restart(restart.into());
        there.restart(restart.into());
        let (a, b) = (means(&mut here, frames), means(&mut there, frames));
        mean += a[0] / f64::from(restarts);
        pairs.push((a, b));
    }
    assert!(mean > 0.0, "{name}, {spec}: black");
    let mut line = format!("| {name} | `{spec}` |");
    for part in 0..5 {
        let mut differences = Moments::default();
        let mut worst = 0.0_f64;
        for (a, b) in &pairs {
            let difference = (b[part] - a[part]) / mean;
            differences.push(difference);
            worst = worst.max(difference.abs());
        }
        let (low, high) = t_test(&differences, 0.0).interval(1.0 - 2e-3);
        let inside = low > -DELTA && high < DELTA && worst < DELTA;
        assert!(inside, "{name}, {spec}, part {part}: {low:.2e} to {high:.2e}, worst {worst:.2e}");
        if part == 0 {
            line += &format!(" {:+.1e} to {:+.1e} | {:.1e} |", low, high, worst);
        }
    }
    eprintln!("{line}");
}

const SPECS: [&str; 8] = [
    "nee",
    "ris",
    "restir-di",
    "restir-di:visibility=trace",
    "restir-di:visibility=bitterli",
    "restir-di:visibility=reuse",
    "restir-di:visibility=wis",
    "restir-di:visibility=wis-cv",
];

fn shot(size: [u32; 2], depth: u32) -> Shot {
    Shot { size, depth, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 }
}

/// Done by CI's slow step: minutes, most of them for the driver's compiler.
#[test]
#[ignore = "minutes"]
fn every_policy_is_equivalent_on_every_scene() {
    let Some(gpu) = device() else { return };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in ["cornell", "penumbra", "many_lights", "moving"] {
        let scene = load(&root.join("scenes").join(name).with_extension("pbrt")).unwrap().scene;
        let stage = Stage::new(scene).unwrap();
        for spec in SPECS {
            assert_equivalent(&gpu, &stage, name, spec, (shot([48, 36], 2), 5, 16));
        }
    }
    let ajar = root.join("../shared/scenes/veach-ajar/scene.pbrt");
    if !ajar.exists() {
        eprintln!("skipped: veach-ajar, since {} is not there", ajar.display());
        return;
    }
    let stage = Stage::new(load(&ajar).unwrap().scene).unwrap();
    assert_equivalent(&gpu, &stage, "veach-ajar", "nee", (shot([48, 27], 3), 1, 16));
}

/// What is seen through each pixel is the same on a real scene: the same surface but for edges,
/// distances to 10⁻⁴.
#[test]
fn primary_hits_of_a_real_scene_agree() {
    let Some(gpu) = device() else { return };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes/veach-ajar/scene.pbrt");
    if !file.exists() {
        eprintln!("skipped: {} is not there", file.display());
        return;
    }
    let stage = Stage::new(load(&file).unwrap().scene).unwrap();
    let shot = shot([192, 108], 1);
    let start = |backend: &Backend| {
        FrameLoop::with_backend(Arc::from(parse("nee").unwrap()), &stage, shot, backend).unwrap()
    };
    let (mut here, mut there) = (start(&Backend::Cpu), start(&Backend::Gpu(gpu)));
    let (a, b) = (here.render().unwrap(), there.render().unwrap());
    let hits =
        |frame: &afterimage::frame::Frame<'_>| frame.buffer::<[u32; 5]>("hits").unwrap().to_vec();
    let (a, b) = (hits(&a), hits(&b));
    let apart = a.iter().zip(&b).filter(|(a, b)| {
        let (ta, tb) = (f32::from_bits(a[0]), f32::from_bits(b[0]));
        a[3..] != b[3..] || !(ta == tb || (ta - tb).abs() < 1e-4 * ta)
    });
    let apart = apart.count();
    assert!(apart <= a.len() / 2000, "{apart} of {} primary hits differ", a.len());
}

/// A wrong name lists what there is, as an error of its own kind.
#[test]
fn an_unknown_adapter_is_refused_by_name() {
    if device().is_none() {
        return;
    }
    let error = Gpu::open(Some("no such device")).unwrap_err();
    assert!(error.is_gpu() && error.to_string().contains("known: "), "{error}");
}
