//! Direct light by resampling: `ris` (candidates only) and `restir-di` (reuse over time and space; Bitterli et al. 2020, with the MIS weights of
//! Lin et al. 2022).
//!
//! What is resampled is light that comes straight to the primary hit and leaves it by a lobe that is not a delta. All other light, through
//! delta lobes there or over more segments, comes from the path tracer with fresh seeds.
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | tiles | lights | light points made ahead, for many lights |
//! | initial | hits | reservoirs: candidates, initial visibility |
//! | temporal | reservoirs, the last frame's `history` | reservoirs, in place |
//! | boiling | reservoirs of a tile | reservoirs, in place; off by default, biased |
//! | mutate | reservoirs | reservoirs, in place |
//! | spatial | reservoirs | `history` (the last round, which also shades) |
//! | shade | reservoirs | radiance, where there is no spatial pass |
//! | paths | hits | adds all other light to radiance |
//!
//! `history` keeps its contents from one frame to the next: it is read by `temporal` before the last spatial round overwrites it.

mod kernels;
mod plan;
mod twin;

use crate::direct::{REUSE_AGE, REUSE_DISTANCE, Visibility};
use crate::error::{Error, Result};
use crate::path::Counters;
use crate::plan::{Claim, Filter, Plan, SceneFacts, Shot};
use crate::resampling::{
    Conditions, ControlVariate, Decoupled, Estimator, Family, Selected, WeightedVisibility,
};
use crate::techniques::{Band, Entry, FrameInputs, Parameter, Technique, Twin, Values};

/// Most neighbours a round.
pub const MAX_NEIGHBOURS: usize = 8;
/// Pixels for each light point made ahead, and lights from which that pays.
const PIXELS_A_TILE_ENTRY: usize = 4;
const LIGHTS_FOR_TILES: u32 = 1000;
/// Width and height in pixels of the blocks that share a tile of light points.
const TILE_BLOCK: u32 = 8;
/// Width and height in pixels of the boiling filter's tiles.
const BOILING_TILE: u32 = 16;

const PARAMETERS: &[Parameter] = &[
    Parameter {
        key: "preset",
        about: "unbiased, or interactive: fewer rays and no blinking, biased; other keys override it",
        default: "unbiased",
    },
    CANDIDATES,
    BSDF,
    TILES_KEY,
    Parameter {
        key: "cap",
        about: "frames of history that count, in [0, 250] (Bitterli et al. 2020: 20); 0 is no temporal reuse; higher is less noise, slower reaction and more correlation",
        default: "20",
    },
    Parameter {
        key: "temporal-mis",
        about: "weights of the temporal merge: constant, inverse-count, contribution, balance, pairwise, defensive",
        default: "balance",
    },
    Parameter {
        key: "neighbours",
        about: "pixels asked a round, in [0, 8]; 0 is no spatial reuse; more is less noise for more time",
        default: "1",
    },
    Parameter {
        key: "radius",
        about: "how far away they are at most, in pixels, in [1, 1000]; more is less correlation, and more neighbours that do not fit",
        default: "16",
    },
    Parameter { key: "rounds", about: "rounds of spatial reuse, in [1, 8]", default: "1" },
    Parameter {
        key: "mis",
        about: "weights of the spatial merge: constant (biased), inverse-count, contribution, balance, pairwise, defensive",
        default: "defensive",
    },
    Parameter {
        key: "visibility",
        about: "what is done with shadow rays: trace, in-target, bitterli (biased), reuse, wis, wis-cv",
        default: "in-target",
    },
    Parameter {
        key: "visibility-age",
        about: "with visibility=reuse, frames that a stored outcome may be old, in [0, 255]; 255 is any number",
        default: "4",
    },
    Parameter {
        key: "visibility-distance",
        about: "with visibility=reuse, pixels that a stored outcome may come from, in [0, 127]; 0 is unbiased in still scenes",
        default: "16",
    },
    Parameter {
        key: "mutations",
        about: "moves of the light point between temporal and spatial reuse, in [0, 64] (Sawhney et al. 2024); more is less correlation for more time",
        default: "0",
    },
    Parameter {
        key: "large-steps",
        about: "share of mutations that draw another light, in [0, 1]; the others move on the same one",
        default: "0.3",
    },
    Parameter {
        key: "decoupled",
        about: "true: shade with all inputs of the last merge instead of the selected one; less noise in colour for a ray a neighbour",
        default: "false",
    },
    Parameter {
        key: "boiling",
        about: "strength in [0, 1] of a filter that drops bright reservoirs; 0 is off; biased",
        default: "0",
    },
    Parameter {
        key: "max-age",
        about: "frames after which a sample is dropped, in [0, 255]; 0 is never; biased",
        default: "0",
    },
    ROULETTE,
];

const CANDIDATES: Parameter = Parameter {
    key: "candidates",
    about: "light samples a pixel and frame at effort 1, in [0, 1024]; more is less noise for more time",
    default: "8",
};
const BSDF: Parameter = Parameter {
    key: "bsdf",
    about: "BSDF samples a pixel and frame at effort 1, in [0, 64]; they find large lights on glossy surfaces, a ray each",
    default: "1",
};
const TILES_KEY: Parameter = Parameter {
    key: "tiles",
    about: "light points made ahead in tiles that fit the cache: auto, on, off",
    default: "auto",
};
const ROULETTE: Parameter = Parameter {
    key: "roulette",
    about: "of the other light: scatterings before Russian roulette may end a path, in [0, 1000]",
    default: "5",
};

pub(super) const RIS: Entry = Entry {
    name: "ris",
    about: "direct light by resampling many candidates, without reuse (Talbot et al. 2005); other light as nee",
    parameters: &[Parameter { default: "32", ..CANDIDATES }, BSDF, TILES_KEY, ROULETTE],
    build: |values| {
        let defaults = RestirDi::ris();
        Ok(Box::new(
            RestirDi {
                candidates: values.integer("candidates", defaults.candidates, 0..=1024)?,
                bsdf: values.integer("bsdf", defaults.bsdf, 0..=64)?,
                tiles: tiles(values)?,
                roulette_after: values.integer("roulette", defaults.roulette_after, 0..=1000)?,
                ..defaults
            }
            .validated()?,
        ))
    },
};

pub(super) const RESTIR_DI: Entry = Entry {
    name: "restir-di",
    about: "direct light with samples reused over frames and pixels (Bitterli et al. 2020, Lin et al. 2022); other light as nee",
    parameters: PARAMETERS,
    build: |values| {
        let d = match values.choice("preset", 0, &["unbiased", "interactive"])? {
            0 => RestirDi::default(),
            _ => RestirDi::interactive(),
        };
        let families = Family::ALL.map(Family::name);
        let place = |family: Family| Family::ALL.iter().position(|f| *f == family).unwrap_or(0);
        let name = |policy: Visibility| {
            Visibility::NAMES.iter().position(|n| *n == policy.name()).unwrap_or(0)
        };
        let visibility = values.choice("visibility", name(d.visibility), &Visibility::NAMES)?;
        let age = values.integer("visibility-age", REUSE_AGE, 0..=255)?;
        let distance = values.integer("visibility-distance", REUSE_DISTANCE, 0..=127)?;
        let visibility = match Visibility::NAMES[visibility] {
            "reuse" => Visibility::Reuse { max_age: age, max_distance: distance },
            other if (age, distance) != (REUSE_AGE, REUSE_DISTANCE) => {
                return Err(Error::usage(format!(
                    "`visibility-age` and `visibility-distance` need `visibility=reuse`, but it is `{other}`"
                )));
            }
            "in-target" => Visibility::InTarget,
            "bitterli" => Visibility::Bitterli,
            "wis" => Visibility::Wis,
            "wis-cv" => Visibility::WisControlVariate,
            _ => Visibility::Trace,
        };
        Ok(Box::new(
            RestirDi {
                candidates: values.integer("candidates", d.candidates, 0..=1024)?,
                bsdf: values.integer("bsdf", d.bsdf, 0..=64)?,
                tiles: tiles(values)?,
                cap: values.integer("cap", d.cap, 0..=250)?,
                temporal_mis: Family::ALL
                    [values.choice("temporal-mis", place(d.temporal_mis), &families)?],
                neighbours: values.integer(
                    "neighbours",
                    d.neighbours,
                    0..=MAX_NEIGHBOURS as u32,
                )?,
                radius: values.number("radius", d.radius, 1.0..=1000.0)?,
                rounds: values.integer("rounds", d.rounds, 1..=8)?,
                mis: Family::ALL[values.choice("mis", place(d.mis), &families)?],
                visibility,
                mutations: values.integer("mutations", d.mutations, 0..=64)?,
                large_steps: values.number("large-steps", d.large_steps, 0.0..=1.0)?,
                decoupled: values.choice("decoupled", d.decoupled.into(), &["false", "true"])? == 1,
                boiling: values.number("boiling", d.boiling, 0.0..=1.0)?,
                max_age: values.integer("max-age", d.max_age, 0..=255)?,
                roulette_after: values.integer("roulette", d.roulette_after, 0..=1000)?,
                ..d
            }
            .validated()?,
        ))
    },
};

fn tiles(values: &mut Values) -> Result<LightTiles> {
    let all = [LightTiles::Auto, LightTiles::On, LightTiles::Off];
    Ok(all[values.choice("tiles", 0, &all.map(LightTiles::name))?])
}

/// Whether light points are made ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightTiles {
    /// From 1,000 lights on.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl LightTiles {
    const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::On => "on",
            Self::Off => "off",
        }
    }
}

/// `ris` and `restir-di`; presets are [`RestirDi::default`] (unbiased) and [`RestirDi::interactive`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestirDi {
    /// Whether reservoirs are kept and reused; without it only candidates, visibility and roulette count.
    pub reuse: bool,
    /// Light samples a pixel, frame and unit of effort, in [0, 1024].
    ///
    /// More is less noise for more time.
    pub candidates: u32,
    /// BSDF samples a pixel, frame and unit of effort, in [0, 64].
    ///
    /// They find large lights on glossy surfaces, for a ray each.
    pub bsdf: u32,
    /// Whether light points are made ahead in tiles that fit the cache.
    pub tiles: LightTiles,
    /// Frames of history that count, in [0, 250]; the papers have 20. 0 is no temporal reuse.
    ///
    /// Higher is less noise, slower reaction and more correlation.
    pub cap: u32,
    /// Weights of the temporal merge.
    pub temporal_mis: Family,
    /// Pixels asked a round, in [0, 8]. 0 is no spatial reuse.
    pub neighbours: u32,
    /// How far away they are at most, in pixels, in [1, 1000]; 20 to 30 in the papers, for pictures eight times as wide.
    ///
    /// Higher is less correlation, and more neighbours that do not fit.
    pub radius: f32,
    /// Rounds of spatial reuse, in [1, 8].
    pub rounds: u32,
    /// Weights of the spatial merge.
    pub mis: Family,
    /// What is done with shadow rays. Visibility in the target is the default: of all policies it had the least relmse times time on
    /// `penumbra` and `many-lights:1000` (`docs/results.md`).
    pub visibility: Visibility,
    /// Moves of the light point between temporal and spatial reuse, in [0, 64].
    pub mutations: u32,
    /// Share of mutations that draw another light, in [0, 1].
    pub large_steps: f32,
    /// Whether all inputs of the last merge are shown, not the selected one.
    pub decoupled: bool,
    /// Strength in [0, 1] of the boiling filter; 0 is off. Biased.
    pub boiling: f32,
    /// Frames after which a sample is dropped, in [0, 255]; 0 is never. Biased.
    pub max_age: u32,
    /// Of the other light: scatterings before Russian roulette may end a path, in [0, 1000].
    pub roulette_after: u32,
}

impl Default for RestirDi {
    /// The unbiased preset.
    fn default() -> Self {
        Self {
            reuse: true,
            candidates: 8,
            bsdf: 1,
            tiles: LightTiles::Auto,
            cap: 20,
            temporal_mis: Family::Balance,
            neighbours: 1,
            radius: 16.0,
            rounds: 1,
            mis: Family::DefensivePairwise,
            visibility: Visibility::InTarget,
            mutations: 0,
            large_steps: 0.3,
            decoupled: false,
            boiling: 0.0,
            max_age: 0,
            roulette_after: 5,
        }
    }
}

impl RestirDi {
    /// Fewer rays and no blinking, for a small bias: stored visibility, a boiling filter, an age limit.
    #[must_use]
    pub fn interactive() -> Self {
        Self { visibility: Visibility::REUSE, boiling: 0.2, max_age: 60, ..Self::default() }
    }

    /// Candidates only.
    #[must_use]
    pub fn ris() -> Self {
        Self {
            reuse: false,
            candidates: 32,
            cap: 0,
            neighbours: 0,
            visibility: Visibility::Trace,
            ..Self::default()
        }
    }

    fn validated(self) -> Result<Self> {
        self.validate()?;
        Ok(self)
    }

    /// Refuses what contradicts itself.
    ///
    /// # Errors
    /// A usage error that names both sides.
    pub fn validate(&self) -> Result<()> {
        let Self { candidates, bsdf, cap, neighbours, visibility, decoupled, .. } = *self;
        if candidates == 0 && bsdf == 0 {
            return Err(Error::usage(
                "`candidates` and `bsdf` are both 0, but one must be positive",
            ));
        }
        if candidates == 0 {
            return Err(Error::usage(
                "`candidates` is 0, but BSDF samples alone never find point, spot and distant lights: at least 1",
            ));
        }
        if decoupled && visibility == Visibility::Wis {
            return Err(Error::usage(
                "`decoupled=true` with `visibility=wis` would multiply every input by an average of others' visibility; use `visibility=wis-cv`",
            ));
        }
        if decoupled && neighbours == 0 {
            return Err(Error::usage(
                "`decoupled=true` shades with all inputs of the last spatial merge, but `neighbours` is 0; set it to at least 1",
            ));
        }
        if self.mutations > 0 && cap == 0 && neighbours == 0 {
            return Err(Error::usage(
                "`mutations` without reuse move a sample that nobody takes; set `cap` or `neighbours`",
            ));
        }
        Ok(())
    }

    /// What a chain of merges promises on a scene.
    fn conditions(&self, facts: &SceneFacts, shot: &Shot) -> Conditions {
        let still = is_still(facts, shot);
        let reuse = self.cap > 0 || self.neighbours > 0;
        let (temporal, spatial) = (self.cap > 0, self.neighbours > 0);
        let own_visibility = match self.visibility {
            Visibility::Reuse { max_age, max_distance } => {
                // A stored outcome stays right where nothing moves and it never leaves its pixel.
                (still || max_age == 0) && (max_distance == 0 || !spatial)
            }
            _ => true,
        };
        Conditions {
            reuse,
            partition: (!spatial || self.mis.partitions_unity())
                && (!temporal || still || self.temporal_mis.partitions_unity()),
            chained_weight_constant: !spatial || self.mis == Family::Constant,
            still,
            target_proportional: facts.grey_lights && !facts.glossy_lobes && !facts.transmission,
            own_visibility,
            // A pixel that takes from itself alone loses nothing with what it does not see, unless chains lead back there.
            drops_occluded: self.visibility == Visibility::Bitterli
                && (spatial || !still || self.mutations > 0),
            streamed_partition: (!spatial || self.mis.terms_partition_unity())
                && (!temporal || still || self.temporal_mis.terms_partition_unity()),
            sample_blind: self.max_age == 0,
        }
    }

    fn claim(&self, facts: &SceneFacts, shot: &Shot) -> Claim {
        let conditions = self.conditions(facts, shot);
        let claim = match self.visibility {
            Visibility::Wis => WeightedVisibility::claim(&conditions),
            Visibility::WisControlVariate => ControlVariate::claim(&conditions),
            _ if self.decoupled => Decoupled::claim(&conditions),
            _ => Selected::claim(&conditions),
        };
        let mut reasons = match claim {
            Claim::Biased(why) => vec![why],
            _ => Vec::new(),
        };
        if self.boiling > 0.0 {
            reasons.push("the boiling filter drops bright samples".into());
        }
        Claim::unless(&reasons)
    }
}

/// Whether every frame has the same receivers, lights and occluders.
fn is_still(facts: &SceneFacts, shot: &Shot) -> bool {
    !facts.moves() && shot.filter == Filter::Point
}

/// Numbers of kernels; spatial rounds count from the last one on.
mod kernel {
    pub(super) const RIS: u32 = 0;
    pub(super) const TILES: u32 = 1;
    pub(super) const INITIAL: u32 = 2;
    pub(super) const TEMPORAL: u32 = 3;
    pub(super) const BOILING: u32 = 4;
    pub(super) const MUTATE: u32 = 5;
    pub(super) const SHADE: u32 = 6;
    pub(super) const PATHS: u32 = 7;
    pub(super) const ALL_PATHS: u32 = 8;
    pub(super) const SPATIAL: u32 = 16;
}

/// Names of buffers.
mod buffer {
    pub(super) const NORMALS: &str = "normals";
    pub(super) const RESERVOIRS: &str = "reservoirs";
    pub(super) const HISTORY: &str = "history";
    pub(super) const CONTROLS: &str = "controls";
    pub(super) const HISTORY_CONTROLS: &str = "history controls";
    pub(super) const BOUNCE: &str = "bounce";
    pub(super) const TILES: &str = "light tiles";
}

impl Technique for RestirDi {
    fn spec(&self) -> String {
        let d = if self.reuse { Self::default() } else { Self::ris() };
        let mut pairs = Vec::new();
        let mut add = |key: &str, differs: bool, value: String| {
            if differs {
                pairs.push(format!("{key}={value}"));
            }
        };
        add("candidates", self.candidates != d.candidates, self.candidates.to_string());
        add("bsdf", self.bsdf != d.bsdf, self.bsdf.to_string());
        add("tiles", self.tiles != d.tiles, self.tiles.name().into());
        if self.reuse {
            add("cap", self.cap != d.cap, self.cap.to_string());
            let family = |f: Family| f.name().to_string();
            add("temporal-mis", self.temporal_mis != d.temporal_mis, family(self.temporal_mis));
            add("neighbours", self.neighbours != d.neighbours, self.neighbours.to_string());
            add("radius", self.radius != d.radius, self.radius.to_string());
            add("rounds", self.rounds != d.rounds, self.rounds.to_string());
            add("mis", self.mis != d.mis, family(self.mis));
            let policy = self.visibility;
            add("visibility", policy.name() != d.visibility.name(), policy.name().into());
            if let Visibility::Reuse { max_age, max_distance } = policy {
                add("visibility-age", max_age != REUSE_AGE, max_age.to_string());
                add(
                    "visibility-distance",
                    max_distance != REUSE_DISTANCE,
                    max_distance.to_string(),
                );
            }
            add("mutations", self.mutations != d.mutations, self.mutations.to_string());
            add("large-steps", self.large_steps != d.large_steps, self.large_steps.to_string());
            add("decoupled", self.decoupled != d.decoupled, self.decoupled.to_string());
            add("boiling", self.boiling != d.boiling, self.boiling.to_string());
            add("max-age", self.max_age != d.max_age, self.max_age.to_string());
        }
        add("roulette", self.roulette_after != d.roulette_after, self.roulette_after.to_string());
        let name = if self.reuse { RESTIR_DI.name } else { RIS.name };
        if pairs.is_empty() { name.into() } else { format!("{name}:{}", pairs.join(",")) }
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        plan::Planner::new(self, facts, shot).plan()
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        kernels::run(self, kernel, inputs, band)
    }

    fn twin(&self, kernel: u32, plan: &Plan) -> Option<Twin> {
        Some(self.kernel_twin(kernel, plan))
    }
}

#[cfg(test)]
mod tests {
    use crate::techniques::parse;

    #[test]
    fn presets_and_keys_round_trip() {
        let interactive = parse("restir-di:preset=interactive").unwrap().spec();
        assert_eq!(interactive, "restir-di:visibility=reuse,boiling=0.2,max-age=60");
        assert_eq!(parse(&interactive).unwrap().spec(), interactive);
        assert_eq!(parse("ris:candidates=4").unwrap().spec(), "ris:candidates=4");
    }

    #[test]
    fn contradictions_name_both_sides() {
        for (spec, text) in [
            ("restir-di:visibility=wis,decoupled=true", "visibility=wis-cv"),
            ("restir-di:decoupled=true,neighbours=0", "but `neighbours` is 0"),
            ("restir-di:visibility-age=9", "need `visibility=reuse`, but it is `in-target`"),
            ("restir-di:mutations=1,cap=0,neighbours=0", "set `cap` or `neighbours`"),
            ("restir-di:mis=balanced", "`mis` has no value `balanced`; known: balance"),
            ("restir-di:radius=0", "`radius` is `0`, but must be a number in [1, 1000]"),
            ("ris:candidates=0", "at least 1"),
        ] {
            let error = parse(spec).unwrap_err().to_string();
            assert!(error.contains(text), "{spec}: {error}");
        }
    }
}
