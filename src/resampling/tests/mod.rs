//! Laws and exact expectations of the core, without noise: every outcome of every draw is
//! enumerated on the very code that renders.

mod laws;
mod lobes;
mod merging;
mod mutation;
mod numerics;
mod toy;
mod visibility;

use super::{ContributionWeight, Counting, Finished, Input, Plain, Reservoir, ShiftMap, Shifted};
use crate::math::rng::{RandomSource, Stream};

/// Probabilities are f64, weights f32 of some ten operations: a fraction that differs is off by far
/// more.
const ROUNDING: f64 = 1e-6;

fn is_close(value: f64, exact: f64) -> bool {
    (value - exact).abs() <= ROUNDING * exact.abs().max(1.0)
}

#[track_caller]
fn assert_close(value: f64, exact: f64) {
    assert!(is_close(value, exact), "{value} instead of {exact}");
}

/// A finished sample of a finite domain.
type Sample = Finished<usize, Counting>;

/// Finite domains whose states have masses, with partial injections between the first, canonical
/// one and the others.
///
/// A sum over a domain is Σ f(x) mass(x); a map's Jacobian is the ratio of the masses, so it is
/// seldom 1.
#[derive(Clone, Debug)]
struct Finite {
    mass: Vec<Vec<f32>>,
    target: Vec<Vec<f32>>,
    /// What each canonical state is in each domain.
    image: Vec<Vec<Option<usize>>>,
}

impl Finite {
    /// Domains of unit masses and any targets that share their states.
    fn shared(target: &[&[f32]]) -> Self {
        Self {
            mass: target.iter().map(|t| vec![1.0; t.len()]).collect(),
            target: target.iter().map(|t| t.to_vec()).collect(),
            image: target.iter().map(|t| (0..t.len()).map(Some).collect()).collect(),
        }
    }

    /// A canonical domain and up to three others, of two to four states.
    fn random(random: &mut Stream) -> Self {
        const MASSES: [f32; 4] = [0.5, 1.0, 1.5, 2.0];
        const TARGETS: [f32; 6] = [0.0, 0.0, 1.0, 2.0, 3.0, 0.25];
        let pick =
            |from: &[f32], random: &mut Stream| from[random.index(from.len() as u32) as usize];
        let domains = 1 + random.index(4) as usize;
        let states: Vec<usize> = (0..domains).map(|_| 2 + random.index(3) as usize).collect();
        let mut fill = |from: &[f32]| -> Vec<Vec<f32>> {
            states.iter().map(|&n| (0..n).map(|_| pick(from, random)).collect()).collect()
        };
        let (mass, mut target) = (fill(&MASSES), fill(&TARGETS));
        target[0][0] = 1.0;
        let mut image = vec![(0..states[0]).map(Some).collect()];
        for &n in &states[1..] {
            let mut free: Vec<usize> = (0..n).collect();
            let to = (0..states[0]).map(|_| {
                let defined = !free.is_empty() && random.choose(3.0, 4.0);
                defined.then(|| free.swap_remove(random.index(free.len() as u32) as usize))
            });
            image.push(to.collect());
        }
        Self { mass, target, image }
    }

    /// p̂←ᵢ of every domain at a canonical state.
    fn from(&self, state: usize) -> Vec<f32> {
        (0..self.mass.len())
            .map(|domain| {
                self.image[domain][state].map_or(0.0, |there| {
                    self.target[domain][there] * self.mass[domain][there] / self.mass[0][state]
                })
            })
            .collect()
    }

    /// Resampling from uniform candidates.
    fn initial(
        &self,
        domain: usize,
        (candidates, confidence): (u32, f32),
        random: &mut impl RandomSource,
    ) -> Sample {
        let states = self.mass[domain].len() as u32;
        let mut reservoir = Plain::default();
        for _ in 0..candidates {
            let state = random.index(states) as usize;
            let inverse_pdf = self.mass[domain][state] * states as f32;
            let weight = self.target[domain][state] * inverse_pdf / candidates as f32;
            reservoir.stream(state, weight, (), random);
        }
        let target = reservoir.selected().map_or(0.0, |state| self.target[domain][state]);
        reservoir.finish(target, confidence)
    }

    /// A sample as a merge takes it.
    fn input<'a>(&self, finished: Sample, domain: &'a usize) -> Input<'a, usize, usize, Counting> {
        let target = finished.sample.map_or(0.0, |state| self.target[*domain][state]);
        Input { finished, target, domain }
    }
}

impl ShiftMap for Finite {
    type Sample = usize;
    type Domain = usize;
    type Integrand = f32;
    type Stratum = ();

    fn shift(
        &mut self,
        &sample: &usize,
        &from: &usize,
        &to: &usize,
    ) -> Option<Shifted<usize, f32>> {
        let there = if from == to {
            sample
        } else {
            let canonical = self.image[from].iter().position(|&image| image == Some(sample))?;
            self.image[to][canonical]?
        };
        Some(Shifted {
            sample: there,
            integrand: self.target[to][there],
            jacobian: self.mass[to][there] / self.mass[from][sample],
        })
    }

    fn stratum(&self, _sample: &usize) {}
}
