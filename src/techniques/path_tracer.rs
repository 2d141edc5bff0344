//! Path tracing without reuse: by BSDF sampling only (`bsdf`), or with light sampling and multiple importance sampling (`nee`), the
//! reference that everything else is judged against.
//!
//! Papers: J. Kajiya (1986), *The Rendering Equation*; E. Veach (1997), *Robust Monte Carlo Methods for Light Transport Simulation*, ch. 9.

use glam::Vec3;

use super::{Band, Entry, FrameInputs, Parameter, PrimaryHit, Technique, Twin, Values};
use crate::accel::{HitFilter, Ray};
use crate::error::Result;
use crate::math::rng::path_seed;
use crate::path::{Counters, Limits, emitted, finite_or_counted, sampled, scattered_radiance};
use crate::plan::{Claim, Domain, Filter, Kernel, Pass, Plan, Runs, SceneFacts, Shot, Skip};
use crate::world::WithFilter;

const ROULETTE: Parameter = Parameter {
    key: "roulette",
    about: "scatterings before Russian roulette may end a path, in [0, 1000]; lower is faster and noisier",
    default: "5",
};
const LIGHTS: Parameter = Parameter {
    key: "lights",
    about: "lights sampled at a vertex: one, by power, or all; all takes a ray a light, and is the better reference where hundreds of small lights are seen directly",
    default: "one",
};

pub(super) const BSDF: Entry = Entry {
    name: "bsdf",
    about: "path tracing by BSDF sampling alone (Kajiya 1986); cannot find point, spot and distant lights",
    parameters: &[ROULETTE],
    build: |values| PathTracer::from_values(LightSampling::None, values),
};

pub(super) const NEE: Entry = Entry {
    name: "nee",
    about: "path tracing with light sampling and MIS at every vertex (Veach 1997); the reference",
    parameters: &[ROULETTE, LIGHTS],
    build: |values| {
        let all = [LightSampling::One, LightSampling::All];
        let lights = all[values.choice("lights", 0, &["one", "all"])?];
        PathTracer::from_values(lights, values)
    },
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
    fn from_values(lights: LightSampling, values: &mut Values) -> Result<Box<dyn Technique>> {
        let default = Self { lights, ..Self::default() };
        let roulette_after = values.integer("roulette", default.roulette_after, 0..=1000)?;
        Ok(Box::new(Self { roulette_after, ..default }))
    }

    fn paths<const LIGHTS: u8, F: HitFilter>(
        &self,
        filter: &F,
        inputs: &FrameInputs<'_>,
        band: &mut Band<'_>,
    ) -> Counters {
        let shot = inputs.shot;
        let limits = Limits { depth: shot.depth, roulette_after: self.roulette_after };
        let radiance: &mut [[f32; 3]] = band.take(0);
        let mut counters = Counters::default();
        let mean = 1.0 / shot.effort as f32;
        match shot.filter {
            Filter::Point => {
                let hits: &[PrimaryHit] = inputs.read(Plan::HITS);
                let first = band.range.start * band.width;
                for (local, out) in radiance.iter_mut().enumerate() {
                    let pixel = first + local as u32;
                    let mut sum = Vec3::ZERO;
                    if let Some(hit) = hits[pixel as usize].get() {
                        let position =
                            inputs.sample_position(pixel % band.width, pixel / band.width, 0);
                        let direction = inputs.camera.ray(position).direction;
                        for sample in 0..shot.effort {
                            let seed = path_seed(shot.run, pixel, inputs.frame, sample);
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
                    *out = (sum * mean).to_array();
                }
            }
            Filter::Box => {
                let emission: &mut [[f32; 3]] = band.take(1);
                let first = band.range.start * band.width;
                for (local, (out, seen)) in radiance.iter_mut().zip(emission).enumerate() {
                    let pixel = first + local as u32;
                    let (mut sum, mut direct) = (Vec3::ZERO, Vec3::ZERO);
                    for sample in 0..shot.effort {
                        let position =
                            inputs.sample_position(pixel % band.width, pixel / band.width, sample);
                        let ray = inputs.camera.ray(position);
                        counters.primary_rays += 1;
                        let primary = Ray {
                            origin: ray.origin,
                            direction: ray.direction,
                            t_max: f32::INFINITY,
                        };
                        let Some(hit) = inputs.world.accel.closest_hit(&primary, filter) else {
                            direct += inputs.world.escaped_radiance(ray.direction);
                            continue;
                        };
                        direct +=
                            emitted(inputs.world, &inputs.world.accel.point(&hit), ray.direction);
                        let seed = path_seed(shot.run, pixel, inputs.frame, sample);
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
        let Self { lights, roulette_after } = *self;
        let name = if lights == LightSampling::None { BSDF.name } else { NEE.name };
        let mut keys = Vec::new();
        if lights == LightSampling::All {
            keys.push("lights=all".to_string());
        }
        if roulette_after != Self::default().roulette_after {
            keys.push(format!("roulette={roulette_after}"));
        }
        if keys.is_empty() { name.into() } else { format!("{name}:{}", keys.join(",")) }
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut skipped = Vec::new();
        let still = !facts.moving_camera && !facts.moving_geometry;
        let mut passes = Vec::new();
        let bounces = u64::from(shot.depth.saturating_sub(1));
        let samples = u64::from(shot.effort);
        let mut primary = samples;
        match shot.filter {
            Filter::Point => {
                primary = 1;
                passes.push(Pass {
                    name: "primary hits",
                    kernel: Kernel::PrimaryHits,
                    domain: Domain::Pixels,
                    writes: vec![Plan::HITS, Plan::EMISSION],
                    runs: if still && !facts.moving_lights { Runs::Once } else { Runs::Always },
                });
                if shot.effort > 1 {
                    skipped.push(Skip {
                        what: "primary rays after a pixel's first sample",
                        because: "the filter is a point",
                    });
                }
                if still && !facts.moving_lights {
                    skipped.push(Skip {
                        what: "primary rays after the first frame",
                        because: "nothing moves",
                    });
                }
                passes.push(Pass {
                    name: "paths",
                    kernel: Kernel::Technique(0),
                    domain: Domain::Pixels,
                    writes: vec![Plan::RADIANCE],
                    runs: Runs::Always,
                });
            }
            Filter::Box => passes.push(Pass {
                name: "paths",
                kernel: Kernel::Technique(0),
                domain: Domain::Pixels,
                writes: vec![Plan::RADIANCE, Plan::EMISSION],
                runs: Runs::Always,
            }),
        }
        let sampled = match self.lights {
            LightSampling::None => 0,
            LightSampling::One => u64::from(facts.light_count().min(1)),
            LightSampling::All => u64::from(facts.light_count()),
        };
        if self.lights != LightSampling::None && sampled == 0 {
            skipped.push(Skip { what: "light sampling", because: "no light emits anything" });
        }
        if !facts.alpha {
            skipped.push(Skip {
                what: "coverage lookups at every hit",
                because: "no surface has a coverage mask",
            });
        }
        if facts.lights.environments == 0 {
            skipped.push(Skip { what: "environment lookups", because: "there is no environment" });
        }
        let claim = if self.lights == LightSampling::None && facts.lights.delta > 0 {
            Claim::Biased("BSDF sampling never finds point, spot and distant lights".into())
        } else {
            Claim::Unbiased
        };
        Plan {
            technique: self.spec(),
            passes,
            buffers: Plan::standard_buffers(),
            skipped,
            rays_per_pixel: [primary, bounces * samples, bounces * samples * sampled, 0],
            constants: Vec::new(),
            emitters: false,
            claim,
        }
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
