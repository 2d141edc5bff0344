//! Direct light by resampling: `ris` (candidates only) and `restir-di` (reuse over time and space;
//! Bitterli et al. 2020, with the MIS weights of Lin et al. 2022).
//!
//! What is resampled is light that comes straight to the primary hit and leaves it by a lobe that
//! is not a delta. All other light, through delta lobes there or over more segments, comes from the
//! path tracer with fresh seeds.
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
//! `history` keeps its contents from one frame to the next: it is read by `temporal` before the
//! last spatial round overwrites it.

mod kernels;
mod plan;
mod rungs;
mod twin;

use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Band, FrameInputs};
use crate::plan::{BufferPlan, Claim, Plan, SceneFacts, Shot};
use crate::resampling::{
    ControlVariate, Decoupled, Estimator, Family, Merges, Selected, WeightedVisibility,
};
use crate::reuse::light_points::{LightTiles, Record, Supply};
use crate::reuse::parameters::reuse_rows;
use crate::reuse::passes::Keys;
use crate::reuse::policy::StoredOutcome;
use crate::reuse::{Kernel, REUSE_AGE, REUSE_DISTANCE, Settings, SpatialUse, Taps, Visibility};
use crate::spec::{self, Choice, Row, row};
use crate::techniques::{Entry, Technique, Twin};

/// The rows of `ris`; `restir-di` has all of [`rows`].
fn rows_of_ris() -> Vec<Row<RestirDi>> {
    vec![
        row!(
            RestirDi,
            "candidates",
            candidates: 0..=1024,
            "light samples a pixel and frame at effort 1; more is less noise for more time"
        ),
        row!(
            RestirDi,
            "bsdf",
            bsdf: 0..=64,
            "BSDF samples a pixel and frame at effort 1; they find large lights on glossy surfaces, a ray each"
        ),
        row!(RestirDi, "tiles", choice tiles: LightTiles, "light points made ahead in tiles that fit the cache"),
        row!(
            RestirDi,
            "roulette",
            roulette_after: 0..=1000,
            "of the other light: scatterings before Russian roulette may end a path"
        ),
    ]
}

fn rows() -> Vec<Row<RestirDi>> {
    let mut rows = rows_of_ris();
    rows.extend(reuse_rows!(RestirDi));
    rows.extend([
        row!(
            RestirDi,
            "visibility",
            choice visibility: Visibility,
            "what is done with shadow rays; bitterli is biased"
        ),
        row!(
            RestirDi,
            "visibility-age",
            visibility_age: 0..=255,
            "with visibility=reuse, frames that a stored outcome may be old; 255 is any number"
        ),
        row!(
            RestirDi,
            "visibility-distance",
            visibility_distance: 0..=127,
            "with visibility=reuse, pixels that a stored outcome may come from; 0 is unbiased in still scenes"
        ),
        row!(
            RestirDi,
            "large-steps",
            number large_steps: 0.0..=1.0,
            "share of mutations that draw another light; the others move on the same one"
        ),
    ]);
    rows
}

pub(super) const RIS: Entry = Entry {
    name: "ris",
    about: "direct light by resampling many candidates, without reuse (Talbot et al. 2005); other light as nee",
    parameters: || spec::describe(&rows_of_ris(), &RestirDi::ris()),
    build: |values| {
        Ok(Box::new(spec::build(RestirDi::ris(), &rows_of_ris(), values)?.validated()?))
    },
    direct: true,
    rungs: &[],
    variants: Vec::new,
};

pub(super) const RESTIR_DI: Entry = Entry {
    name: "restir-di",
    about: "direct light with samples reused over frames and pixels (Bitterli et al. 2020, Lin et al. 2022); other light as nee",
    parameters: || spec::describe(&rows(), &RestirDi::default()),
    build: |values| Ok(Box::new(spec::build(RestirDi::default(), &rows(), values)?.validated()?)),
    direct: true,
    rungs: rungs::RUNGS,
    variants: rungs::variants,
};

/// `ris` ([`RestirDi::ris`]) and `restir-di` ([`RestirDi::default`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestirDi {
    /// Whether reservoirs are kept and reused; without it only candidates, visibility and roulette
    /// count.
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
    /// How far away they are at most, in pixels, in [1, 1000]; 20 to 30 in the papers, for pictures
    /// eight times as wide.
    ///
    /// Higher is less correlation, and more neighbours that do not fit.
    pub radius: f32,
    /// Which they are.
    pub taps: Taps,
    /// Rounds of spatial reuse, in [1, 8].
    pub rounds: u32,
    /// Weights of the spatial merge.
    pub mis: Family,
    /// What becomes of the spatial result.
    pub spatial: SpatialUse,
    /// Where nothing moves, frames of history from which a pixel takes nothing from its neighbours,
    /// in [0, 250]; 0: every pixel always takes.
    pub mature: u32,
    /// What is done with shadow rays. Visibility in the target is the default: of all policies it
    /// had the least relmse times time on `penumbra` and `many-lights:1000` (`docs/results.md`).
    pub visibility: Visibility,
    /// With [`Visibility::Reuse`], frames that a stored outcome may be old, in [0, 255]; 255 is any
    /// number.
    pub visibility_age: u32,
    /// With [`Visibility::Reuse`], pixels that a stored outcome may come from, in [0, 127].
    ///
    /// 0 is unbiased in still scenes.
    pub visibility_distance: u32,
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
            taps: Taps::Xor,
            rounds: 1,
            mis: Family::DefensivePairwise,
            spatial: SpatialUse::Feedback,
            mature: 8,
            visibility: Visibility::InTarget,
            visibility_age: REUSE_AGE,
            visibility_distance: REUSE_DISTANCE,
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

    /// Refuses what is out of range or contradicts itself.
    ///
    /// # Errors
    /// A usage error that names the parameter and what is allowed, or both sides.
    pub fn validate(&self) -> Result<()> {
        spec::check(&rows(), self)?;
        let Self { candidates, bsdf, cap, neighbours, visibility, decoupled, .. } = *self;
        let limits = (self.visibility_age, self.visibility_distance);
        if visibility != Visibility::Reuse && limits != (REUSE_AGE, REUSE_DISTANCE) {
            return Err(Error::usage(format!(
                "`visibility-age` and `visibility-distance` need `visibility=reuse`, but it is `{}`",
                visibility.name()
            )));
        }
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

    /// The parameters of the passes of reuse.
    pub(crate) fn settings(&self) -> Settings {
        let Self { cap, temporal_mis, neighbours, radius, taps, rounds, mis, spatial, .. } = *self;
        let Self { mature, decoupled, mutations, boiling, max_age, .. } = *self;
        Settings {
            cap,
            temporal_mis,
            neighbours,
            radius,
            taps,
            rounds,
            mis,
            spatial,
            mature,
            decoupled,
            mutations,
            boiling,
            max_age,
            // Only paths ask for these.
            kernel: Kernel::Kelemen,
            mutate_share: 1.0,
            duplicates: 0.0,
        }
    }

    /// Where candidates come from.
    fn supply(&self) -> Supply {
        Supply { candidates: self.candidates, bsdf: self.bsdf, tiles: self.tiles }
    }

    /// The limits of [`Visibility::Reuse`].
    fn limits(&self) -> StoredOutcome {
        StoredOutcome { max_age: self.visibility_age, max_distance: self.visibility_distance }
    }

    /// What a chain of merges promises on a scene.
    fn conditions(&self, facts: &SceneFacts, shot: &Shot) -> Merges {
        let still = facts.is_still(shot);
        let reuse = self.cap > 0 || self.neighbours > 0;
        let (temporal, spatial) = (self.cap > 0, self.neighbours > 0);
        let own_visibility = match self.visibility {
            // A stored outcome stays right where nothing moves and it never leaves its pixel.
            Visibility::Reuse => {
                (still || self.visibility_age == 0) && (self.visibility_distance == 0 || !spatial)
            }
            _ => true,
        };
        Merges {
            reuse,
            partition: (!spatial || self.mis.partitions_unity())
                && (!temporal || still || self.temporal_mis.partitions_unity()),
            chained_weight_constant: !spatial || self.mis == Family::Constant,
            still,
            target_proportional: facts.grey_lights && !facts.glossy_lobes && !facts.transmission,
            own_visibility,
            // A pixel that takes from itself alone loses nothing with what it does not see, unless
            // chains lead back there.
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

/// Numbers of the technique's own kernels; those of reuse are [`crate::reuse::passes::kernel`].
mod kernel {
    pub(super) const RIS: u32 = 0;
    pub(super) const TILES: u32 = 1;
    pub(super) const PATHS: u32 = 2;
    pub(super) const ALL_PATHS: u32 = 3;
}

impl Technique for RestirDi {
    fn spec(&self) -> String {
        if self.reuse {
            spec::write(RESTIR_DI.name, &Self::default(), &rows(), self)
        } else {
            spec::write(RIS.name, &Self::ris(), &rows_of_ris(), self)
        }
    }

    fn validate(&self) -> Result<()> {
        Self::validate(self)
    }

    fn signed(&self) -> bool {
        self.reuse && self.visibility == Visibility::WisControlVariate
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        plan::plan(self, facts, shot)
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        kernels::run(self, kernel, inputs, band)
    }

    fn twin(&self, kernel: u32, plan: &Plan) -> Option<Twin> {
        Some(self.kernel_twin(kernel, plan))
    }

    fn describe(&self, buffer: &BufferPlan, element: &[u32]) -> Vec<(&'static str, String)> {
        if Keys::<Record>::ALL.iter().all(|key| key.name != buffer.name) {
            return Vec::new();
        }
        bytemuck::cast_slice::<u32, Record>(element).iter().flat_map(Record::describe).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Filter;
    use crate::techniques::parse;

    #[test]
    fn keys_round_trip() {
        let spec = "restir-di:boiling=0.2,max-age=60,visibility=reuse";
        assert_eq!(parse(spec).unwrap().spec(), spec);
        assert_eq!(parse("ris:candidates=4").unwrap().spec(), "ris:candidates=4");
    }

    /// What a SPEC cannot say a struct must not, either: each is refused with the allowed range.
    #[test]
    fn values_out_of_range_are_refused_by_the_loop() {
        let mut scene = crate::scene::generate("many-lights:3").unwrap();
        scene.name = "three lights".into();
        let stage = crate::frame::Stage::new(scene).unwrap();
        let shot =
            Shot { size: [2, 2], depth: 2, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
        let d = RestirDi::default();
        for (technique, text) in [
            (RestirDi { rounds: 0, ..d }, "`rounds` is `0`, but must be an integer in [1, 8]"),
            (
                RestirDi { neighbours: 64, ..d },
                "`neighbours` is `64`, but must be an integer in [0, 8]",
            ),
            (
                RestirDi { cap: 100_000, ..d },
                "`cap` is `100000`, but must be an integer in [0, 250]",
            ),
            (
                RestirDi { radius: f32::NAN, ..d },
                "`radius` is `NaN`, but must be a number in [1, 1000]",
            ),
            (RestirDi { candidates: 0, bsdf: 0, ..d }, "one must be positive"),
        ] {
            let error = crate::frame::FrameLoop::new(std::sync::Arc::new(technique), &stage, shot);
            let error = error.unwrap_err().to_string();
            assert!(error.contains(text), "{technique:?}: {error}");
        }
        crate::frame::FrameLoop::new(std::sync::Arc::new(d), &stage, shot).unwrap();
    }

    /// What drops samples is biased where that loses light, and says so; the same where nothing is
    /// lost claims nothing.
    #[test]
    fn what_drops_samples_claims_a_bias() {
        let scene = crate::scene::generate("many-lights:20").unwrap();
        let still = crate::frame::Stage::new(scene.clone()).unwrap();
        let moving = crate::frame::Stage::moving(scene).unwrap();
        let shot =
            Shot { size: [2, 2], depth: 2, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
        for (spec, biased) in [
            ("restir-di", [false, false]),
            ("restir-di:max-age=5", [true, true]),
            ("restir-di:boiling=0.1", [true, true]),
            ("restir-di:visibility=bitterli", [true, true]),
            ("restir-di:visibility=bitterli,neighbours=0", [false, true]),
            ("restir-di:visibility=bitterli,neighbours=0,mutations=1", [true, true]),
            ("restir-di:mis=constant", [true, true]),
            ("restir-di:mis=constant,neighbours=0", [false, false]),
            ("restir-di:temporal-mis=constant", [false, true]),
        ] {
            let claims = [&still, &moving].map(|stage| {
                let claim = parse(spec).unwrap().plan(stage.facts(), &shot).claim;
                claim != Claim::Unbiased
            });
            assert_eq!(claims, biased, "{spec}");
        }
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
