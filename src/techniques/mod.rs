//! The methods under comparison. Each is immutable parameters plus kernels; its state lies in the frame loop's buffers.
//!
//! A technique is named by a SPEC: `name` or `name:key=value,key=value`. [`REGISTRY`] lists all; the command line, benches and tests loop
//! over it.

mod path_tracer;
mod restir_di;

use std::fmt;

pub use crate::spec::{Parameter, Values};
pub use path_tracer::{LightSampling, PathTracer};
pub use restir_di::{LightTiles, RestirDi};

use crate::counters::Counters;
use crate::error::{Error, Result, suggest};
use crate::pass::{Band, FrameInputs};
use crate::plan::{Plan, SceneFacts, Shot};
pub use crate::twin::Twin;

/// A rendering method.
///
/// Laws, which one test holds every entry of [`REGISTRY`] to:
/// 1. `parse(technique.spec())` gives the same technique.
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

    /// Runs kernel number `kernel` over a band; one call a band, all per-ray choices are made inside it once.
    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters;

    /// The same kernel for a graphics processor; `None`: there is none, and the technique runs on the CPU.
    fn twin(&self, _kernel: u32, _plan: &Plan) -> Option<Twin> {
        None
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
}

/// All techniques.
pub const REGISTRY: &[Entry] =
    &[path_tracer::BSDF, path_tracer::NEE, restir_di::RIS, restir_di::RESTIR_DI];

/// The technique that a SPEC names.
///
/// # Errors
/// Unknown names and keys list what exists, nearest first; values out of range say what is allowed.
pub fn parse(spec: &str) -> Result<Box<dyn Technique>> {
    let (name, rest) = spec.split_once(':').unwrap_or((spec, ""));
    let names: Vec<&str> = REGISTRY.iter().map(|entry| entry.name).collect();
    let entry = REGISTRY.iter().find(|entry| entry.name == name).ok_or_else(|| {
        Error::usage(format!("no technique is called `{name}`; {}", suggest(name, &names)))
    })?;
    let parameters = (entry.parameters)();
    let keys: Vec<&str> = parameters.iter().map(|parameter| parameter.key).collect();
    (entry.build)(&Values::parse(spec, name, rest, &keys)?)
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn unknown_names_and_keys_list_what_exists() {
        for (spec, text) in [
            ("ne", "no technique is called `ne`; known: nee, ris, bsdf, restir-di"),
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
