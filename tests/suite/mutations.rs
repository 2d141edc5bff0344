//! Do mutations do what they are for? Covariance between neighbours falls, the error of a pixel stays (Sawhney et al. 2024).

use std::path::Path;
use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::metrics::{Comparison, covariance_r8};
use afterimage::picture::Picture;
use afterimage::scene::load;
use afterimage::stats::Moments;
use afterimage::techniques::parse;
use glam::Vec3;

use crate::support::{last_frame, shot};

/// Restarts of each SPEC.
const RESTARTS: u64 = 48;

/// Frame 30 of [`RESTARTS`] runs from `first` on, so that SPECs can be compared with the same seeds.
fn pictures(stage: &Stage, spec: &str, size: [u32; 2], first: u64) -> Vec<Picture> {
    let technique = Arc::from(parse(spec).unwrap());
    let mut frames = FrameLoop::new(technique, stage, shot(size, 2, 1)).unwrap();
    (0..RESTARTS)
        .map(|run| {
            frames.restart(first + run);
            for _ in 1..30 {
                frames.render().unwrap();
            }
            frames.render().unwrap().picture()
        })
        .collect()
}

fn truth(stage: &Stage, size: [u32; 2]) -> Picture {
    let mut sum = vec![Vec3::ZERO; (size[0] * size[1]) as usize];
    for run in 0..8 {
        let shot = afterimage::plan::Shot { run: 90 + run, effort: 128, ..shot(size, 2, 1) };
        let (picture, _) = last_frame(stage, "nee", shot, 1);
        sum.iter_mut().zip(&picture.pixels).for_each(|(s, p)| *s += *p / 8.0);
    }
    Picture::new(size[0], size[1], sum)
}

/// On `cornell` with a long history, where correlation shows, the relative covariance within 8 pixels falls for 1 and 5 mutations, beyond
/// both 95 % intervals; the mean squared error, paired by seed, does not rise by 3 % (99 % interval). The control, other seeds without
/// mutations, must not look like a fall. On `plates` mutations change neither: printed, not asserted.
#[test]
#[ignore = "slow: 90 s"]
fn covariance_falls_and_the_error_does_not_rise() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for scene in ["cornell", "plates"] {
        let path = root.join("scenes").join(scene).with_extension("pbrt");
        let stage = Stage::new(load::load(&path).unwrap().scene).unwrap();
        let size = [64, 48];
        let truth = truth(&stage, size);
        let mse = |p: &Picture| Comparison::new(p, &truth, None).unwrap().mse();
        let base = "restir-di:cap=50,neighbours=3";
        let without = pictures(&stage, base, size, 7000);
        let reference = covariance_r8(&without, &truth, None).unwrap();
        let (least, _) = reference.interval(0.95);
        println!("{scene} n = 0: covariance {:.3e}, at least {least:.3e}", reference.mean);
        for n in [1, 5] {
            let with = pictures(&stage, &format!("{base},mutations={n}"), size, 7000);
            let covariance = covariance_r8(&with, &truth, None).unwrap();
            let (_, most) = covariance.interval(0.95);
            let ratio: Moments =
                without.iter().zip(&with).map(|(a, b)| mse(b) / mse(a) - 1.0).collect();
            let (low, high) = ratio.estimate().interval(0.99);
            println!(
                "{scene} n = {n}: covariance {:.3e} ({:+.1} %), at most {most:.3e}; mse {:+.1} % [{:+.1}, {:+.1}]",
                covariance.mean,
                100.0 * (covariance.mean / reference.mean - 1.0),
                100.0 * ratio.mean(),
                100.0 * low,
                100.0 * high
            );
            assert!(scene != "cornell" || (most < least && high < 0.03), "{scene}, {n} mutations");
        }
        if scene == "cornell" {
            let control = covariance_r8(&pictures(&stage, base, size, 9000), &truth, None).unwrap();
            assert!(
                control.interval(0.95).1 >= least,
                "the control looks like a fall: {control:?}"
            );
        }
    }
}
