//! Speed and error beside Mitsuba 3 on the same files: what `docs/performance.md` says of it. Needs
//! `../shared/peer` and, in `AFTERIMAGE_PEER_PYTHON`, a Python that has Mitsuba; says so where they
//! are missing. It takes a quiet machine:
//!
//! `AFTERIMAGE_PEER_PYTHON=/path/to/python cargo test --profile published --test suite peer:: --
//! --ignored --nocapture --test-threads 1`
//!
//! Both renderers have two threads and take turns; rates are medians. Mitsuba's pixels are box
//! filtered. Error is the variance of a sample over r² + 10⁻² r̄², as in `docs/metrics.md`, r the
//! mean of Mitsuba's runs, pixels near emitters masked; what counts is error times time.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::{Scene, Transform, generate_pbrt, load};
use afterimage::stats::Moments;
use afterimage::techniques::parse;
use glam::{Mat4, Vec3};

use crate::references::{mask, read_exr, shared};
use crate::support::picture;

/// A sampled renderer's run.
struct Run {
    /// 10⁶ samples a second.
    rate: f64,
    mean: Vec<Vec3>,
    /// Of one sample.
    variance: Vec<Vec3>,
}

struct Mitsuba {
    python: PathBuf,
    script: PathBuf,
    folder: PathBuf,
}

impl Mitsuba {
    fn new() -> Option<Self> {
        let script = shared("peer/render_mitsuba.py")?;
        let Some(python) = std::env::var_os("AFTERIMAGE_PEER_PYTHON") else {
            println!("skipped: AFTERIMAGE_PEER_PYTHON names no Python with Mitsuba");
            return None;
        };
        let folder = std::env::temp_dir().join(format!("afterimage-peer-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Some(Self { python: python.into(), script, folder })
    }

    /// `scene` is a folder with a `scene.pbrt`.
    fn run(&self, scene: &Path, [w, h]: [u32; 2], depth: u32, spp: u32, runs: u32) -> Run {
        let out = self.folder.join("peer.exr");
        let output = Command::new(&self.python)
            .arg(&self.script)
            .arg(scene)
            .args(["--size", &format!("{w}x{h}"), "--threads", "2"])
            .args(["--depth", &depth.to_string(), "--spp", &spp.to_string()])
            .args(["--runs", &runs.to_string(), "--out"])
            .arg(&out)
            .output()
            .expect("the Python of AFTERIMAGE_PEER_PYTHON");
        let text = String::from_utf8_lossy(&output.stdout);
        let report: Option<serde_json::Value> =
            text.lines().last().and_then(|line| serde_json::from_str(line).ok());
        let Some(report) = report else {
            panic!("Mitsuba failed: {}", String::from_utf8_lossy(&output.stderr));
        };
        let rate = report["samples_per_second"].as_f64().expect("a rate") * 1e-6;
        let mut variance = Vec::new();
        if runs > 1 {
            // The file's variance is that of the mean of all runs.
            variance = read_exr(&self.folder.join("peer_variance.exr")).2;
            variance.iter_mut().for_each(|v| *v *= (runs * spp) as f32);
        }
        Run { rate, mean: read_exr(&out).2, variance }
    }
}

impl Drop for Mitsuba {
    fn drop(&mut self) {
        // A leftover in the temporary folder harms nobody.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn two_threads<T: Send>(job: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap().install(job)
}

/// `nee` with `restarts` frames of `spp` samples.
fn ours(stage: &Stage, size: [u32; 2], depth: u32, spp: u32, restarts: u64) -> Run {
    let shot = Shot { size, depth, filter: Filter::Box, run: 0, effort: spp as f32, fps: 30 };
    let mut frames = FrameLoop::new(Arc::from(parse("nee").unwrap()), stage, shot).unwrap();
    let pixels = (size[0] * size[1]) as usize;
    let mut moments = vec![[Moments::new(); 3]; pixels];
    let mut seconds = 0.0;
    for restart in 0..restarts {
        frames.restart(restart);
        let begin = Instant::now();
        let frame = frames.render().unwrap();
        seconds += begin.elapsed().as_secs_f64();
        for (moments, pixel) in moments.iter_mut().zip(&frame.picture().pixels) {
            for (moments, value) in moments.iter_mut().zip(pixel.to_array()) {
                moments.push(f64::from(value));
            }
        }
    }
    let of = |f: &dyn Fn(&Moments) -> f64| -> Vec<Vec3> {
        moments.iter().map(|m| Vec3::from(m.each_ref().map(|m| f(m) as f32))).collect()
    };
    Run {
        rate: pixels as f64 * f64::from(spp) * restarts as f64 / seconds * 1e-6,
        mean: of(&Moments::mean),
        variance: of(&|m| m.variance() * f64::from(spp)),
    }
}

/// Mean over pixels and channels of variance / (r² + 10⁻² r̄²), whole and without the worst
/// thousandth of the pixels.
fn relative(variance: &[Vec3], reference: &[Vec3], counts: &[bool]) -> [f64; 2] {
    let kept = || counts.iter().enumerate().filter(|(_, counts)| **counts).map(|(at, _)| at);
    let sum: f64 = kept().map(|at| f64::from(reference[at].element_sum() / 3.0)).sum();
    let floor = 1e-2 * (sum / kept().count() as f64).powi(2);
    let mut errors: Vec<f64> = kept()
        .map(|at| {
            let (v, r) = (variance[at].as_dvec3(), reference[at].as_dvec3());
            (v / (r * r + floor)).element_sum() / 3.0
        })
        .collect();
    errors.sort_unstable_by(f64::total_cmp);
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    [mean(&errors), mean(&errors[..errors.len() - errors.len() / 1000])]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Pixels without an emitter within one pixel.
fn counted(stage: &Stage, size: [u32; 2]) -> Vec<bool> {
    let shot = Shot { size, depth: 1, filter: Filter::Box, run: 0, effort: 64.0, fps: 30 };
    let mut frames = FrameLoop::new(Arc::from(parse("bsdf").unwrap()), stage, shot).unwrap();
    let emission = frames.render().unwrap().emission();
    mask(&emission.pixels, size[0] as usize, size[1] as usize)
}

#[test]
#[ignore = "long: 6 minutes, needs Mitsuba"]
fn long_samples_a_second_and_error_times_time() {
    let Some(mitsuba) = Mitsuba::new() else { return };
    let size = [320, 180];
    println!(
        "| scene | Mitsuba, 10⁶ samples/s | `nee`, 10⁶ samples/s | ratio | time to equal error, ours over Mitsuba's | without the worst 0.1 % |"
    );
    println!("|---|---|---|---|---|---|");
    for scene in ["cornell-box", "veach-mis", "veach-bidir", "veach-ajar"] {
        let Some(folder) = shared(&format!("scenes/{scene}")) else { return };
        let stage = Stage::new(load::load(&folder.join("scene.pbrt")).unwrap().scene).unwrap();
        let counts = counted(&stage, size);
        let (mut theirs, mut own) = (Vec::new(), Vec::new());
        for _ in 0..3 {
            theirs.push(mitsuba.run(&folder, size, 8, 64, 1).rate);
            own.push(two_threads(|| ours(&stage, size, 8, 16, 4)).rate);
        }
        let (theirs, own) = (median(theirs), median(own));
        let peer = mitsuba.run(&folder, size, 8, 64, 16);
        let here = two_threads(|| ours(&stage, size, 8, 64, 16));
        let [whole, trimmed] = [0, 1].map(|which| {
            let error = |run: &Run| relative(&run.variance, &peer.mean, &counts)[which];
            error(&here) / own / (error(&peer) / theirs)
        });
        println!(
            "| {scene} | {theirs:.2} | {own:.2} | {:.2} | {whole:.2} | {trimmed:.2} |",
            own / theirs
        );
        assert!(own > 0.0 && theirs > 0.0 && whole.is_finite() && trimmed.is_finite());
    }
}

/// Mean squared errors of single frames after `ages` frames, over restarts, with the milliseconds
/// of each of these frames.
fn frames(stage: &Stage, spec: &str, size: [u32; 2], ages: [u32; 2]) -> [(Vec<Vec3>, f64); 2] {
    let truth = {
        let shot = Shot { size, depth: 2, filter: Filter::Point, run: 7, effort: 24.0, fps: 30 };
        picture(stage, "nee:lights=all", shot)
    };
    let shot = Shot { size, depth: 2, filter: Filter::Point, run: 0, effort: 1.0, fps: 30 };
    let mut frames = FrameLoop::new(Arc::from(parse(spec).unwrap()), stage, shot).unwrap();
    const RESTARTS: u32 = 24;
    let mut found = [0, 1].map(|_| (vec![Vec3::ZERO; truth.pixels.len()], Vec::new()));
    for restart in 0..RESTARTS {
        frames.restart(u64::from(restart));
        for age in 1..=ages[1] {
            let frame = frames.render().unwrap();
            let Some(at) = ages.iter().position(|wanted| *wanted == age) else { continue };
            found[at].1.push(frame.milliseconds());
            let pixels = &frame.picture().pixels;
            for ((sum, value), truth) in found[at].0.iter_mut().zip(pixels).zip(&truth.pixels) {
                *sum += (*value - *truth) * (*value - *truth) / RESTARTS as f32;
            }
        }
    }
    found.map(|(errors, ms)| (errors, median(ms)))
}

#[test]
#[ignore = "long: 5 minutes, needs Mitsuba"]
fn long_a_thousand_lights_at_depth_two() {
    let Some(mitsuba) = Mitsuba::new() else { return };
    let size = [192, 108];
    let pixels = f64::from(size[0] * size[1]);
    let text = generate_pbrt("many-lights:1000").unwrap();
    let file = mitsuba.folder.join("scene.pbrt");
    std::fs::write(&file, &text).unwrap();
    let scene: Scene = load::load(&file).unwrap().scene;
    // The peer's reader knows no LookAt.
    let Transform::Fixed(to_world) = scene.camera.to_world else { panic!("the camera moves") };
    let columns = Mat4::from(to_world.inverse()).to_cols_array();
    let matrix: Vec<String> = columns.iter().map(f32::to_string).collect();
    let line = text.lines().find(|line| line.starts_with("LookAt")).expect("a camera");
    let text = text.replace(line, &format!("Transform [ {} ]", matrix.join(" ")));
    std::fs::write(&file, text).unwrap();
    let stage = Stage::new(scene).unwrap();
    let counts = counted(&stage, size);
    let peer = mitsuba.run(&mitsuba.folder, size, 2, 256, 16);
    // Error of a frame that takes t ms: of a sample, over samples a pixel in that time.
    let error = relative(&peer.variance, &peer.mean, &counts)[0] * pixels / (peer.rate * 1e3);
    println!("Mitsuba: {:.2} · 10⁶ samples/s, relMSE {error:.2} ms / t", peer.rate);
    println!("| technique | frame | ms | relMSE | Mitsuba's in that time | ratio |");
    println!("|---|---|---|---|---|---|");
    for spec in ["nee", "ris", "restir-di", "restir-di:visibility=wis"] {
        for (age, (errors, ms)) in
            [1, 20].iter().zip(two_threads(|| frames(&stage, spec, size, [1, 20])))
        {
            let own = relative(&errors, &peer.mean, &counts)[0];
            let theirs = error / ms;
            println!(
                "| `{spec}` | {age} | {ms:.1} | {own:.3} | {theirs:.2} | {:.1} |",
                theirs / own
            );
            assert!(own.is_finite() && own > 0.0);
        }
    }
}
