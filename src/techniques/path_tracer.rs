//! Path tracing without reuse: by BSDF sampling only (`bsdf`), or with light sampling and multiple
//! importance sampling (`nee`), the reference that everything else is judged against.
//!
//! Papers: J. Kajiya (1986), *The Rendering Equation*; E. Veach (1997), *Robust Monte Carlo Methods
//! for Light Transport Simulation*, ch. 9.

use glam::Vec3;

use super::{Entry, Technique, Twin};
use crate::accel::{HitFilter, Ray};
use crate::counters::Counters;
use crate::error::Result;
use crate::pass::{Band, FrameInputs, PrimaryHit};
use crate::path::{Limits, emitted, finite_or_counted, sampled, scattered_radiance};
use crate::plan::{Builder, Claim, Filter, NewPass, Plan, SceneFacts, Shot};
use crate::spec::{self, Choice, Row, row};
use crate::world::WithFilter;

/// The rows of `bsdf`; `nee` has all of [`rows`].
fn rows_of_bsdf() -> [Row<PathTracer>; 1] {
    [row!(
        PathTracer,
        "roulette",
        roulette_after: 0..=1000,
        "scatterings before Russian roulette may end a path; lower is faster and noisier"
    )]
}

fn rows() -> [Row<PathTracer>; 2] {
    let [roulette] = rows_of_bsdf();
    let lights = row!(
        PathTracer,
        "lights",
        choice lights: LightSampling,
        "lights sampled at a vertex: one, by power, or all; all takes a ray a light, and is the better reference where hundreds of small lights are seen directly"
    );
    [roulette, lights]
}

pub(super) const BSDF: Entry = Entry {
    name: "bsdf",
    about: "path tracing by BSDF sampling alone (Kajiya 1986); cannot find point, spot and distant lights",
    parameters: || spec::describe(&rows_of_bsdf(), &PathTracer::bsdf()),
    build: |values| Ok(Box::new(spec::build(PathTracer::bsdf(), &rows_of_bsdf(), values)?)),
    direct: false,
    rungs: &[],
    variants: Vec::new,
};

pub(super) const NEE: Entry = Entry {
    name: "nee",
    about: "path tracing with light sampling and MIS at every vertex (Veach 1997); the reference",
    parameters: || spec::describe(&rows(), &PathTracer::default()),
    build: |values| Ok(Box::new(spec::build(PathTracer::default(), &rows(), values)?)),
    direct: false,
    rungs: &[],
    variants: || vec!["lights=all".to_string()],
};

/// Which lights a vertex samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightSampling {
    /// None: `bsdf`.
    None,
    /// One, chosen by power.
    One,
    /// Each of them once: time grows with their number, noise does not.
    All,
}

impl Choice for LightSampling {
    /// Those of `nee`; `bsdf` has no choice.
    const ALL: &'static [Self] = &[Self::One, Self::All];

    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::One => "one",
            Self::All => "all",
        }
    }
}

/// `bsdf` and `nee`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathTracer {
    /// Which lights are sampled.
    pub lights: LightSampling,
    /// Scatterings before Russian roulette may end a path, in [0, 1000].
    ///
    /// Lower values make a path cheaper and its estimate noisier.
    pub roulette_after: u32,
}

impl Default for PathTracer {
    fn default() -> Self {
        Self { lights: LightSampling::One, roulette_after: 5 }
    }
}

impl PathTracer {
    /// By BSDF sampling alone: `bsdf`.
    #[must_use]
    pub fn bsdf() -> Self {
        Self { lights: LightSampling::None, ..Self::default() }
    }

    fn paths<const LIGHTS: u8, F: HitFilter>(
        &self,
        filter: &F,
        inputs: &FrameInputs<'_>,
        band: &mut Band<'_>,
    ) -> Counters {
        let shot = inputs.shot;
        let limits = Limits { depth: shot.depth, roulette_after: self.roulette_after };
        let pixels = band.pixels();
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        let mut counters = Counters::default();
        match shot.filter {
            Filter::Point => {
                let hits: &[PrimaryHit] = inputs.read(Plan::HITS);
                for (pixel, out) in pixels.zip(radiance) {
                    let mut sum = Vec3::ZERO;
                    let estimates = inputs.estimates(pixel);
                    if let Some(hit) = hits[pixel.index as usize].get() {
                        let direction = inputs.primary_direction(pixel);
                        for sample in 0..estimates {
                            let seed = inputs.seeds(pixel.index).seed(sample);
                            let path = scattered_radiance::<LIGHTS, F>(
                                inputs.world,
                                filter,
                                seed,
                                (direction, &hit),
                                limits,
                                &mut counters,
                            );
                            sum += finite_or_counted(path, &mut counters);
                        }
                    }
                    *out = (sum * (1.0 / estimates as f32)).to_array();
                }
            }
            Filter::Box => {
                let emission: &mut [[f32; 3]] = band.take(Plan::EMISSION);
                for (pixel, (out, seen)) in pixels.zip(radiance.iter_mut().zip(emission)) {
                    let (mut sum, mut direct) = (Vec3::ZERO, Vec3::ZERO);
                    let estimates = inputs.estimates(pixel);
                    for sample in 0..estimates {
                        let position = inputs.sample_position(pixel.x, pixel.y, sample);
                        let ray = inputs.camera.ray(position);
                        counters.primary_rays += 1;
                        let primary = Ray {
                            origin: ray.origin,
                            direction: ray.direction,
                            t_max: f32::INFINITY,
                        };
                        let Some(hit) = inputs.world.camera_hit_with(&primary, filter) else {
                            direct += inputs.world.escaped_radiance(ray.direction);
                            continue;
                        };
                        direct +=
                            emitted(inputs.world, &inputs.world.accel.point(&hit), ray.direction);
                        let seed = inputs.seeds(pixel.index).seed(sample);
                        let path = scattered_radiance::<LIGHTS, F>(
                            inputs.world,
                            filter,
                            seed,
                            (ray.direction, &hit),
                            limits,
                            &mut counters,
                        );
                        sum += finite_or_counted(path, &mut counters);
                    }
                    let mean = 1.0 / estimates as f32;
                    *out = (sum * mean).to_array();
                    *seen = (direct * mean).to_array();
                }
            }
        }
        counters
    }
}

impl Technique for PathTracer {
    fn spec(&self) -> String {
        match self.lights {
            LightSampling::None => spec::write(BSDF.name, &Self::bsdf(), &rows_of_bsdf(), self),
            _ => spec::write(NEE.name, &Self::default(), &rows(), self),
        }
    }

    fn validate(&self) -> Result<()> {
        spec::check(&rows(), self)
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut plan = Builder::new(self.spec(), facts, shot);
        let samples = u64::from(shot.most_estimates());
        let bounces = u64::from(shot.depth.saturating_sub(1)) * samples;
        let sampled = match self.lights {
            LightSampling::None => 0,
            LightSampling::One => u64::from(facts.light_count().min(1)),
            LightSampling::All => u64::from(facts.light_count()),
        };
        let paths =
            |writes| NewPass::pixels("paths", 0, writes).rays(bounces, bounces * sampled, 0);
        match shot.filter {
            Filter::Point => {
                if shot.effort > 1.0 {
                    plan.skip("primary rays after a pixel's first sample", "the filter is a point");
                }
                plan.primary_hits();
                plan.pass(paths(vec![Plan::RADIANCE]));
            }
            Filter::Box => {
                let mut pass = paths(vec![Plan::RADIANCE, Plan::EMISSION]);
                pass.rays[0] = samples;
                plan.pass(pass);
            }
        }
        if self.lights != LightSampling::None && sampled == 0 {
            plan.skip("light sampling", "no light emits anything");
        }
        plan.skip_coverage();
        if facts.lights.environments == 0 {
            plan.skip("environment lookups", "there is no environment");
        }
        plan.finish(if self.lights == LightSampling::None && facts.lights.delta > 0 {
            Claim::Biased("BSDF sampling never finds point, spot and distant lights".into())
        } else {
            Claim::Unbiased
        })
    }

    fn twin(&self, _kernel: u32, _plan: &Plan) -> Option<Twin> {
        let sampled = match self.lights {
            LightSampling::None => sampled::NONE,
            LightSampling::One => sampled::ONE,
            LightSampling::All => sampled::ALL,
        };
        Some(Twin {
            kernel: "paths",
            modules: vec![crate::wgsl!("path_tracer.wgsl")],
            constants: vec![
                ("SAMPLED", f64::from(sampled)),
                ("ROULETTE_AFTER", f64::from(self.roulette_after)),
            ],
            ..Twin::default()
        })
    }

    fn run(&self, _kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        struct Paths<'a, 'b, 'c>(&'a PathTracer, &'a FrameInputs<'b>, &'a mut Band<'c>);
        impl WithFilter for Paths<'_, '_, '_> {
            type Output = Counters;

            fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
                let Self(technique, inputs, band) = self;
                match technique.lights {
                    LightSampling::None => {
                        technique.paths::<{ sampled::NONE }, F>(&filter, inputs, band)
                    }
                    LightSampling::One => {
                        technique.paths::<{ sampled::ONE }, F>(&filter, inputs, band)
                    }
                    LightSampling::All => {
                        technique.paths::<{ sampled::ALL }, F>(&filter, inputs, band)
                    }
                }
            }
        }
        inputs.world.with_filter(Paths(self, inputs, band))
    }
}
