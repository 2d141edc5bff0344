//! The resampling core in a renderer of one's own: nothing of this crate's scene, rays or frame
//! loop is used.
//!
//! The host has a floor of pixels under a few hundred lamps, and a wall that some lamps are behind.
//! It brings three things: a sample (a lamp's number), a domain (a pixel's place on the floor), and
//! the integrand (what a lamp sends there). Everything else, reservoirs, MIS weights, merges over
//! time and space, is the core's.
//!
//! ```sh
//! cargo run --release --example own_renderer
//! ```

use afterimage::math::rng::{RandomSource, Stream};
use afterimage::resampling::{
    Counting, Family, Finished, Identity, Input, Plain, Reservoir, merge, merge_history,
};

const WIDTH: usize = 48;
const LAMPS: usize = 300;
const FRAMES: usize = 24;

/// The host's scene: lamps over a line of floor points, and a wall between x = 0.45 and 0.5 that is
/// 0.4 high.
struct Lamp {
    x: f32,
    height: f32,
    power: f32,
}

fn lamps() -> Vec<Lamp> {
    let mut random = Stream::from_key(7);
    (0..LAMPS)
        .map(|_| Lamp {
            x: random.uniform(),
            height: 0.3 + 0.7 * random.uniform(),
            // Few bright ones, many dim ones.
            power: 0.01 / (0.01 + random.uniform()),
        })
        .collect()
}

/// What a lamp sends to a floor point, without the wall.
fn unshadowed(lamp: &Lamp, x: f32) -> f32 {
    let squared = (lamp.x - x).powi(2) + lamp.height.powi(2);
    lamp.power * lamp.height / squared.powf(1.5)
}

/// The host's shadow ray.
fn visible(lamp: &Lamp, x: f32) -> bool {
    // Height of the segment where it crosses the wall's faces.
    [0.45, 0.5].iter().all(|&wall| {
        let share = (wall - x) / (lamp.x - x);
        !(0.0..=1.0).contains(&share) || share * lamp.height > 0.4
    })
}

/// A pixel's reservoir, as the host stores it: sample, weight, confidence, and p̂ of the sample.
type Stored = (Finished<usize, Counting>, f32);

/// Mean over pixels of the squared relative error, and the sum over pixels, of one more frame.
fn render(lamps: &[Lamp], truth: &[f32], reuse: bool, run: u64) -> (f64, f64) {
    let places: Vec<f32> = (0..WIDTH).map(|i| (i as f32 + 0.5) / WIDTH as f32).collect();
    // The target is what arrives, visibility included, so that reservoirs hold lamps that are seen.
    let integrand = |lamp: &usize, x: &f32| {
        let lamp = &lamps[*lamp];
        if visible(lamp, *x) { unshadowed(lamp, *x) } else { 0.0 }
    };
    let mut map = Identity::new(integrand);
    let mut history: Vec<Stored> = vec![(Finished::empty(0.0), 0.0); WIDTH];
    let (mut error, mut sum) = (0.0, 0.0);
    for frame in 0..FRAMES {
        // Fresh candidates: eight lamps by chance; the one that is kept is tested for visibility.
        let mut random = Stream::from_key(run << 32 | frame as u64);
        let fresh: Vec<Stored> = places
            .iter()
            .map(|x| {
                let mut reservoir = Plain::default();
                for _ in 0..8 {
                    let lamp = random.index(LAMPS as u32) as usize;
                    let weight = unshadowed(&lamps[lamp], *x) * LAMPS as f32 / 8.0;
                    reservoir.stream(lamp, weight, (), &mut random);
                }
                let target = reservoir.selected().map_or(0.0, |l| unshadowed(&lamps[l], *x));
                let finished: Finished<usize, Counting> = reservoir.finish(target, 1.0);
                match finished.sample {
                    Some(lamp) if visible(&lamps[lamp], *x) => (finished, target),
                    _ => (Finished::empty(1.0), 0.0),
                }
            })
            .collect();
        let input = |stored: &Stored, at: usize| Input {
            finished: stored.0,
            target: stored.1,
            domain: &places[at],
        };
        let mut current = fresh.clone();
        if reuse {
            for at in 0..WIDTH {
                if frame > 0 {
                    let merged = merge_history(
                        &mut map,
                        (Family::Balance, 20.0),
                        &input(&fresh[at], at),
                        &input(&history[at], at),
                        &mut Plain::default(),
                        &mut random,
                        |_| (),
                    );
                    current[at] = (merged.finished, merged.target);
                }
            }
            let after_temporal = current.clone();
            for at in 0..WIDTH {
                // Two neighbours, chosen by place alone.
                let neighbours: Vec<_> = [at.wrapping_sub(3), at + 2]
                    .into_iter()
                    .filter(|&other| other < WIDTH)
                    .map(|other| input(&after_temporal[other], other))
                    .collect();
                let merged = merge(
                    &mut map,
                    Family::DefensivePairwise,
                    &input(&after_temporal[at], at),
                    &neighbours[..],
                    &mut Plain::default(),
                    &mut random,
                    |_| (),
                );
                current[at] = (merged.finished, merged.target);
            }
        }
        history.clone_from(&current);
        if frame + 1 == FRAMES {
            for (at, (finished, target)) in current.iter().enumerate() {
                let shown = target * finished.weight.get();
                error += f64::from((shown / truth[at] - 1.0).powi(2)) / WIDTH as f64;
                sum += f64::from(shown);
            }
        }
    }
    (error, sum)
}

fn main() {
    let lamps = lamps();
    let truth: Vec<f32> = (0..WIDTH)
        .map(|i| (i as f32 + 0.5) / WIDTH as f32)
        .map(|x| lamps.iter().filter(|l| visible(l, x)).map(|l| unshadowed(l, x)).sum())
        .collect();
    let total: f64 = truth.iter().map(|t| f64::from(*t)).sum();
    let runs = 2000;
    for reuse in [false, true] {
        let (mut error, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for run in 0..runs {
            let (e, s) = render(&lamps, &truth, reuse, run);
            error += e / runs as f64;
            sum += s / runs as f64;
            squares += s * s / runs as f64;
        }
        let deviation = ((squares - sum * sum) / runs as f64).sqrt();
        println!(
            "{:<22} mean squared relative error {error:.4}, bias {:+.2} % ± {:.2} %",
            if reuse { "with reuse" } else { "fresh candidates only" },
            100.0 * (sum / total - 1.0),
            196.0 * deviation / total,
        );
        // Four standard errors: a false alarm in 16,000 runs of this example; the seeds are fixed.
        assert!((sum - total).abs() < 4.0 * deviation, "{sum} instead of {total}");
    }
}
