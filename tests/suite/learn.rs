//! The worked example of `docs/learn.md`: every number that the page gives, by the functions of
//! this crate, over all outcomes.

use afterimage::math::rng::RandomSource;
use afterimage::resampling::{
    Counting, Family, Finished, Identity, Input, Plain, Reservoir, merge,
};
use afterimage::stats::{Outcome, enumerate_f64, expectation};

type Pixel = [f32; 4];

/// What each of four lamps contributes.
const A: Pixel = [4.0, 1.0, 0.0, 2.0];
const B: Pixel = [4.0, 3.0, 1.0, 0.0];

/// A finished sample and p̂ of it.
type Sample = (Finished<usize, Counting>, f32);

/// A reservoir after candidates that were drawn uniformly.
fn reservoir(pixel: &Pixel, lamps: &[usize], random: &mut impl RandomSource) -> Sample {
    let mut reservoir = Plain::default();
    for &lamp in lamps {
        reservoir.stream(lamp, pixel[lamp] / (lamps.len() as f32 / 4.0), (), random);
    }
    let target = reservoir.selected().map_or(0.0, |lamp| pixel[lamp]);
    (reservoir.finish(target, 1.0), target)
}

fn initial(pixel: &Pixel, candidates: usize, random: &mut impl RandomSource) -> Sample {
    let lamps: Vec<usize> = (0..candidates).map(|_| random.index(4) as usize).collect();
    reservoir(pixel, &lamps, random)
}

/// The reservoir of [`B`] merged into that of [`A`].
fn merged(family: Family, a: Sample, b: Sample, random: &mut impl RandomSource) -> Sample {
    let mut map = Identity::new(|lamp: &usize, pixel: &Pixel| pixel[*lamp]);
    let own = Input { finished: a.0, target: a.1, domain: &A };
    let others = [Input { finished: b.0, target: b.1, domain: &B }];
    let mut out = Plain::default();
    let m = merge(&mut map, family, &own, others.as_slice(), &mut out, random, |_| ());
    (m.finished, m.target)
}

fn shown((finished, target): &Sample) -> f64 {
    f64::from(target * finished.weight.get())
}

/// Asserts mean and standard deviation of what is shown, to the digits that the page gives.
fn assert_row(what: &str, outcomes: &[Outcome<Sample, f64>], mean: f64, deviation: f64) {
    let first = expectation(outcomes, shown);
    let spread = (expectation(outcomes, |s| shown(s).powi(2)) - first * first).sqrt();
    println!("{what}: {first:.4}, {spread:.4}");
    assert!((first - mean).abs() < 1e-5, "{what}: mean {first}, the page says {mean}");
    assert!((spread - deviation).abs() < 0.005, "{what}: {spread}, the page says {deviation}");
}

#[test]
fn the_table_of_the_page() {
    for (candidates, deviation) in [(1, 5.92), (2, 4.18)] {
        let alone = enumerate_f64(|random| initial(&A, candidates, random));
        assert_row("alone", &alone, 7.0, deviation);
    }
    let rows = [
        (Family::Constant, 6.0, 3.31),
        (Family::Balance, 7.0, 3.89),
        (Family::default(), 7.0, 3.60),
    ];
    for (family, mean, deviation) in rows {
        let outcomes = enumerate_f64(|random| {
            let (a, b) = (initial(&A, 2, random), initial(&B, 2, random));
            merged(family, a, b, random)
        });
        assert_row(family.name(), &outcomes, mean, deviation);
        // The count of each lamp times W. Lamp 3 gives a nothing, and halves lose half of lamp 4.
        let last = if family == Family::Constant { 0.5 } else { 1.0 };
        for (lamp, truth) in [1.0, 1.0, 0.0, last].into_iter().enumerate() {
            let count = expectation(&outcomes, |(finished, _)| {
                let weight = f64::from(finished.weight.get());
                if finished.sample == Some(lamp) { weight } else { 0.0 }
            });
            assert!((count - truth).abs() < 1e-5, "{}, lamp {lamp}: {count}", family.name());
        }
    }
}

#[test]
fn the_steps_of_the_page() {
    // All outcomes as (probability, lamp counted from 1, W), in the order of the lamps.
    let list = |outcomes: Vec<Outcome<Sample, f64>>| {
        let mut list: Vec<_> = outcomes
            .iter()
            .map(|o| (o.probability, o.value.0.sample.map_or(0, |l| l + 1), o.value.0.weight.get()))
            .collect();
        list.sort_by_key(|outcome| outcome.1);
        list
    };
    let close = |found: &[(f64, usize, f32)], page: &[(f64, usize, f32)]| {
        assert_eq!(found.len(), page.len(), "{found:?}");
        for (f, p) in found.iter().zip(page) {
            let same = (f.0 - p.0).abs() < 1e-6 && f.1 == p.1 && (f.2 - p.2).abs() < 1e-5;
            assert!(same, "{found:?}, the page says {page:?}");
        }
    };
    let (third, quarter) = (1.0 / 3.0, 0.25);
    let a = list(enumerate_f64(|random| reservoir(&A, &[0, 3], random)));
    close(&a, &[(2.0 * third, 1, 3.0), (third, 4, 6.0)]);
    let b = list(enumerate_f64(|random| reservoir(&B, &[1, 2], random)));
    close(&b, &[(0.75, 2, 8.0 / 3.0), (quarter, 3, 8.0)]);
    let kept = |lamp: usize, weight_sum: f32, pixel: &Pixel| {
        let target = pixel[lamp];
        (Finished::from_sum(Some(lamp), weight_sum, target, 1.0, 1.0), target)
    };
    let m = list(enumerate_f64(|random| {
        merged(Family::Balance, kept(0, 12.0, &A), kept(1, 8.0, &B), random)
    }));
    close(&m, &[(0.75, 1, 2.0), (quarter, 2, 8.0)]);
}
