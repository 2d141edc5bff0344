//! The methods under comparison. Each is immutable parameters plus kernels; its state lies in the
//! frame loop's buffers.
//!
//! A technique is named by a SPEC: `name` or `name:key=value,key=value`. [`REGISTRY`] lists all;
//! the command line, benches and tests loop over it.

mod mcmm;
mod other_light;
mod path_tracer;
mod restir_di;
mod restir_pt;
mod rung;

use std::fmt;

pub use crate::reuse::light_points::LightTiles;
pub use crate::spec::{Parameter, Values};
pub use mcmm::{LobeScore, Mcmm, McmmPaths, McmmPreset, ReadsMode, SetEstimator};
pub use path_tracer::{LightSampling, PathTracer};
pub use restir_di::RestirDi;
pub use restir_pt::{Direct, Preset, RestirPt, Shade};
pub use rung::{Moving, Rung};

use crate::counters::Counters;
use crate::error::{Error, Result, suggest};
use crate::pass::{Band, FrameInputs};
use crate::plan::{BufferPlan, Plan, SceneFacts, Shot};
pub use crate::twin::Twin;

/// A rendering method.
///
/// Laws, which one test holds every entry of [`REGISTRY`] to:
/// 1. Its entry makes the same technique of `technique.spec()`.
/// 2. A kernel's writes depend on its inputs only, not on how the picture is cut into bands.
/// 3. The mean over runs agrees with `plan().claim`.
/// 4. No frame uses more rays of a kind than `plan().rays_per_pixel()` says.
pub trait Technique: fmt::Debug + Send + Sync {
    /// The canonical SPEC: the name, and the parameters that differ from their defaults.
    fn spec(&self) -> String;

    /// Refuses parameters that are out of range or contradict each other; every constructor of a
    /// frame loop calls it, so `plan` and `run` only meet parameters that it accepts.
    ///
    /// # Errors
    /// A usage error that names the parameter, what was given and what is allowed.
    fn validate(&self) -> Result<()>;

    /// What will run for a scene, and what is left out.
    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan;

    /// Whether single pixels may be below 0, as those of control variates: average or filter such
    /// pictures before anything cuts them off at 0, which alone would make them too bright.
    fn signed(&self) -> bool {
        false
    }

    /// Runs kernel number `kernel` over a band; one call a band, all per-ray choices are made
    /// inside it once.
    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters;

    /// The same kernel for a graphics processor; `None`: there is none, and the technique runs on
    /// the CPU.
    fn twin(&self, _kernel: u32, _plan: &Plan) -> Option<Twin> {
        None
    }

    /// What one element of a buffer of the technique's plan says to people, as names and values:
    /// what `inspect` prints of a pixel. Nothing for buffers that say nothing.
    fn describe(&self, _buffer: &BufferPlan, _element: &[u32]) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// Returns pictures of one number a pixel, by name, of what the technique's buffers hold;
    /// `render` adds them to its file. `buffer` gives the words of a buffer of the plan.
    fn layers<'f>(
        &self,
        _plan: &Plan,
        _size: [u32; 2],
        _buffer: &dyn Fn(&str) -> Option<&'f [u32]>,
    ) -> Vec<(&'static str, Vec<f32>)> {
        Vec::new()
    }
}

/// A line of the [`REGISTRY`].
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// As in a SPEC.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Its parameters.
    pub parameters: fn() -> Vec<Parameter>,
    /// Builds the technique from given values, each of a key that `parameters` lists.
    pub build: fn(&Values) -> Result<Box<dyn Technique>>,
    /// Whether only direct light is its own, all longer paths being walked.
    pub direct: bool,
    /// How it is tested part by part; none: [`Rung::DEFAULT`].
    pub rungs: &'static [Rung],
    /// Parameters (`key=value,key=value`) beside the defaults that tests shall run through.
    pub variants: fn() -> Vec<String>,
}

impl Entry {
    /// The technique with parameters `key=value,key=value`; none are the defaults.
    ///
    /// # Errors
    /// Unknown keys list what exists, nearest first; values out of range say what is allowed.
    pub fn parse(&self, pairs: &str) -> Result<Box<dyn Technique>> {
        let parameters = (self.parameters)();
        let keys: Vec<&str> = parameters.iter().map(|parameter| parameter.key).collect();
        (self.build)(&Values::parse(&self.spec(pairs), self.name, pairs, &keys)?)
    }

    /// Its rungs, or those of a technique that has none.
    #[must_use]
    pub fn ladder(&self) -> &'static [Rung] {
        if self.rungs.is_empty() { Rung::DEFAULT } else { self.rungs }
    }

    /// The SPECs that tests shall run through: the name alone, and with each of its variants.
    #[must_use]
    pub fn specs(&self) -> Vec<String> {
        let variants = (self.variants)();
        let specs = variants.iter().map(|pairs| self.spec(pairs));
        [self.name.to_string()].into_iter().chain(specs).collect()
    }

    fn spec(&self, pairs: &str) -> String {
        if pairs.is_empty() { self.name.to_string() } else { format!("{}:{pairs}", self.name) }
    }
}

/// All techniques.
pub const REGISTRY: &[Entry] = &[
    path_tracer::BSDF,
    path_tracer::NEE,
    mcmm::MCMM,
    restir_di::RIS,
    restir_di::RESTIR_DI,
    restir_pt::RESTIR_PT,
];

/// The registered technique that a SPEC names.
///
/// # Errors
/// Unknown names and keys list what exists, nearest first; values out of range say what is allowed.
pub fn parse(spec: &str) -> Result<Box<dyn Technique>> {
    let (entry, pairs) = find(REGISTRY, spec)?;
    entry.parse(pairs)
}

/// The entry that a SPEC names, of [`REGISTRY`] or of a host's own, and the SPEC's parameters.
///
/// # Errors
/// An unknown name lists what exists, nearest first.
pub fn find<'e, 's>(entries: &'e [Entry], spec: &'s str) -> Result<(&'e Entry, &'s str)> {
    let (name, pairs) = spec.split_once(':').unwrap_or((spec, ""));
    let entry = entries.iter().find(|entry| entry.name == name).ok_or_else(|| {
        let names: Vec<&str> = entries.iter().map(|entry| entry.name).collect();
        Error::usage(format!("no technique is called `{name}`; {}", suggest(name, &names)))
    })?;
    Ok((entry, pairs))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::frame::{FrameLoop, Stage};
    use crate::math::rng::recording;
    use crate::plan::Filter;
    use crate::scene::generate;

    #[test]
    fn every_entry_parses_and_its_spec_is_stable() {
        for entry in REGISTRY {
            let technique = parse(entry.name).unwrap();
            assert_eq!(technique.spec(), entry.name);
            for parameter in (entry.parameters)() {
                let spec = format!("{}:{}={}", entry.name, parameter.key, parameter.default);
                assert_eq!(
                    parse(&spec).unwrap().spec(),
                    entry.name,
                    "defaults are left out of the canonical SPEC"
                );
            }
        }
        assert_eq!(parse("nee:roulette=3").unwrap().spec(), "nee:roulette=3");
    }

    /// No two draws of a technique's frames have the same counters: no two passes share a purpose
    /// and round, no two candidates a seed, no two frames a number. The control is a run that is
    /// recorded twice.
    #[test]
    fn no_number_is_drawn_twice() {
        let mut scene = generate("many-lights:40").unwrap();
        scene.camera.fov = 0.9;
        let stage = Stage::moving(scene.clone()).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let twice = |draws: &[[u32; 4]]| {
            let mut seen = std::collections::HashMap::new();
            draws.iter().find_map(|draw| {
                let count: &mut u32 = seen.entry(*draw).or_default();
                *count += 1;
                (*count > 1).then_some(*draw)
            })
        };
        let specs: Vec<String> = REGISTRY.iter().flat_map(Entry::specs).collect();
        let more = [
            "nee:lights=all",
            "restir-di:tiles=on,rounds=3,mutations=2,taps=random",
            // So few that the numbers of BSDF samples are those of the first paths.
            "ris:candidates=1",
            "restir-di:candidates=1",
            "restir-pt:candidates=1,trees=2",
        ];
        for spec in specs.iter().map(String::as_str).chain(more) {
            for filter in [Filter::Point, Filter::Box] {
                let shot = Shot { size: [24, 18], depth: 3, filter, run: 5, effort: 2.0, fps: 30 };
                let mut frames =
                    FrameLoop::new(Arc::from(parse(spec).unwrap()), &stage, shot).unwrap();
                let draws = pool.install(|| {
                    recording::of(|| {
                        for _ in 0..3 {
                            frames.render_scene(scene.clone()).unwrap();
                        }
                    })
                });
                assert!(draws.len() > 1000, "{spec}: only {} draws", draws.len());
                assert_eq!(twice(&draws), None, "{spec}, {filter:?}");
                let again: Vec<_> = draws.iter().chain(&draws[7..8]).copied().collect();
                assert!(twice(&again).is_some(), "the control must fail");
            }
        }
    }

    #[test]
    fn every_variant_parses() {
        for spec in REGISTRY.iter().flat_map(Entry::specs) {
            parse(&spec).unwrap();
        }
    }

    #[test]
    fn unknown_names_and_keys_list_what_exists() {
        for (spec, text) in [
            (
                "ne",
                "no technique is called `ne`; known: nee, ris, bsdf, mcmm, restir-di, restir-pt",
            ),
            ("nee:rulette=3", "`nee` has no parameter `rulette`; known: roulette, lights"),
            (
                "nee:roulette",
                "`roulette` in `nee:roulette` is not of the form key=value; known: roulette, lights",
            ),
            ("nee:roulette=-1", "`roulette` is `-1`, but must be an integer in [0, 1000]"),
            (
                "nee:roulette=1,roulette=2",
                "`roulette` is given twice in `nee:roulette=1,roulette=2`",
            ),
        ] {
            assert_eq!(parse(spec).unwrap_err().to_string(), text);
        }
    }
}
