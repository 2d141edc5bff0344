//! Paths by resampling and reuse: `restir-pt` (Lin et al. 2022, *Generalized Resampled Importance
//! Sampling*; hybrid shift).
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | initial | hits | reservoirs: a path of each walk |
//! | temporal | reservoirs, the last frame's `history` | reservoirs, in place |
//! | boiling | reservoirs of a tile | reservoirs, in place; off by default, biased |
//! | spatial | reservoirs | `history` (the last round, which also shades) |
//! | shade | reservoirs | radiance, where there is no spatial pass |
//!
//! What a shift keeps of a path behind its reconnection vertex is copied, so history is used only
//! where neither lights nor geometry move; a moving camera is fine.

mod rungs;

use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Band, FrameInputs};
use crate::plan::{BufferPlan, Builder, Claim, Plan, SceneFacts, Shot};
use crate::resampling::{Decoupled, Estimator, Merges, Selected};
use crate::reuse::parameters::reuse_rows;
use crate::reuse::passes::{self, Initial, Keys, kernel};
use crate::reuse::paths::{Connects, MOST_SEGMENTS, PathRecord, Paths};
use crate::reuse::policy::InTarget;
use crate::reuse::{Reuse, Settings};
use crate::spec::{self, Choice, Row, row};
use crate::techniques::{Entry, Technique};
use crate::world::WithFilter;

/// The bits of the least distance of a connection, as an f32.
const DISTANCE: &str = "least distance of a connection, bits";

fn rows() -> Vec<Row<RestirPt>> {
    let mut rows = vec![
        row!(
            RestirPt,
            "trees",
            trees: 1..=1024,
            "walks a pixel and frame whose paths a reservoir chooses from; more is less noise for more time"
        ),
        row!(
            RestirPt,
            "roulette",
            roulette_after: 0..=1000,
            "scatterings before Russian roulette may end a walk"
        ),
    ];
    // Paths are not mutated.
    rows.extend(reuse_rows!(RestirPt, reuse).into_iter().filter(|row| row.key != "mutations"));
    rows
}

pub(super) const RESTIR_PT: Entry = Entry {
    name: "restir-pt",
    about: "all light by paths reused over frames and pixels (Lin et al. 2022, hybrid shift)",
    parameters: || spec::describe(&rows(), &RestirPt::default()),
    build: |values| Ok(Box::new(spec::build(RestirPt::default(), &rows(), values)?.validated()?)),
    rungs: rungs::RUNGS,
    variants: rungs::variants,
};

/// `restir-pt`; see the module's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestirPt {
    /// Walks a pixel, frame and chain, in [1, 1024].
    ///
    /// More is less noise for more time.
    pub trees: u32,
    /// Scatterings before Russian roulette may end a walk, in [0, 1000].
    pub roulette_after: u32,
    /// Of reuse; paths are not mutated, so `mutations` must be 0.
    pub reuse: Settings,
}

impl Default for RestirPt {
    /// The unbiased preset.
    fn default() -> Self {
        Self { trees: 1, roulette_after: 5, reuse: Settings::default() }
    }
}

impl RestirPt {
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
        let Settings { decoupled, neighbours, mutations, .. } = self.reuse;
        if mutations > 0 {
            return Err(Error::usage(format!(
                "`mutations` is {mutations}, but paths are not mutated: it must be 0"
            )));
        }
        if decoupled && neighbours == 0 {
            return Err(Error::usage(
                "`decoupled=true` shades with all inputs of the last spatial merge, but `neighbours` is 0; set it to at least 1",
            ));
        }
        Ok(())
    }

    /// The parameters of the passes of reuse on a scene: without history where its lights or
    /// geometry move.
    fn settings(&self, copies: bool) -> Settings {
        Settings { cap: if copies { self.reuse.cap } else { 0 }, ..self.reuse }
    }

    fn claim(&self, settings: &Settings, still: bool, depth: u32) -> Claim {
        let (temporal, spatial) = (settings.cap > 0, settings.neighbours > 0);
        let whole =
            |partition: bool, terms: bool| (!spatial || partition) && (!temporal || still || terms);
        let (mis, temporal_mis) = (settings.mis, settings.temporal_mis);
        let merges = Merges {
            reuse: temporal || spatial,
            partition: whole(mis.partitions_unity(), temporal_mis.partitions_unity()),
            streamed_partition: whole(
                mis.terms_partition_unity(),
                temporal_mis.terms_partition_unity(),
            ),
            chained_weight_constant: true,
            still,
            target_proportional: true,
            own_visibility: true,
            drops_occluded: false,
            sample_blind: settings.max_age == 0,
        };
        let claim =
            if settings.decoupled { Decoupled::claim(&merges) } else { Selected::claim(&merges) };
        let mut reasons = match claim {
            Claim::Biased(why) => vec![why],
            _ => Vec::new(),
        };
        if depth > MOST_SEGMENTS {
            reasons.push(format!("paths of more than {MOST_SEGMENTS} segments are left out"));
        }
        if settings.boiling > 0.0 {
            reasons.push("the boiling filter drops bright samples".into());
        }
        Claim::unless(&reasons)
    }
}

impl Technique for RestirPt {
    fn spec(&self) -> String {
        spec::write(RESTIR_PT.name, &Self::default(), &rows(), self)
    }

    fn validate(&self) -> Result<()> {
        Self::validate(self)
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut plan = Builder::new(self.spec(), facts, shot);
        plan.primary_hits();
        plan.skip_coverage();
        if shot.depth < 2 || facts.light_count() == 0 {
            let because = if shot.depth < 2 { "the depth is 1" } else { "no light emits anything" };
            plan.skip("light sampling", because);
            plan.skip("paths and reservoirs", because);
            return plan.finish(Claim::Unbiased);
        }
        let copies = !(facts.moving_lights || facts.moving_geometry);
        let settings = self.settings(copies);
        if self.reuse.cap > 0 && !copies {
            plan.skip(
                "temporal reuse",
                "lights or geometry move, and what lies behind a reconnection is not traced again",
            );
        }
        plan.constant(DISTANCE, Connects::of_diagonal(facts.diagonal).distance.to_bits());
        let scatterings = u64::from(shot.depth) - 1;
        let walks = u64::from(self.trees) * scatterings;
        let initial = Initial { rays: [walks, walks, 0], shift_bounces: scatterings };
        passes::add::<PathRecord, InTarget>(&mut plan, &settings, initial);
        plan.finish(self.claim(&settings, facts.is_still(shot), shot.depth))
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        inputs.world.with_filter(Call { technique: self, kernel, inputs, band })
    }

    fn describe(&self, buffer: &BufferPlan, element: &[u32]) -> Vec<(&'static str, String)> {
        if Keys::<PathRecord>::ALL.iter().all(|key| key.name != buffer.name) {
            return Vec::new();
        }
        let records: &[PathRecord] = bytemuck::cast_slice(element);
        records.iter().flat_map(PathRecord::describe).collect()
    }
}

/// One call of a kernel, before the type of the coverage filter is chosen.
struct Call<'a, 'b, 'c> {
    technique: &'a RestirPt,
    kernel: u32,
    inputs: &'a FrameInputs<'b>,
    band: &'a mut Band<'c>,
}

impl WithFilter for Call<'_, '_, '_> {
    type Output = Counters;

    fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
        let Call { technique, kernel, inputs, band } = self;
        let bits = inputs.plan.constant(DISTANCE).expect("the plan fixes what its kernels ask for");
        let connects = Connects { distance: f32::from_bits(bits), roughness: Connects::ROUGHNESS };
        let paths = Paths { frame: inputs, filter: &filter, connects };
        let reuse = Reuse::new(&paths, InTarget, technique.reuse);
        match kernel {
            kernel::INITIAL => paths.initial(technique.trees, technique.roulette_after, band),
            kernel::TEMPORAL => reuse.temporal(band),
            kernel::BOILING => reuse.boiling(band),
            kernel::SHADE => reuse.shade(band),
            round => reuse.spatial(round - kernel::SPATIAL, band),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::frame::{FrameLoop, Stage};
    use crate::plan::Filter;
    use crate::techniques::parse;

    fn stage() -> Stage {
        Stage::new(crate::scene::generate("many-lights:3").unwrap()).unwrap()
    }

    fn shot(depth: u32) -> Shot {
        Shot { size: [2, 2], depth, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 }
    }

    #[test]
    fn what_cannot_be_is_refused_by_the_loop() {
        let (d, reuse) = (RestirPt::default(), Settings::default());
        for (technique, text) in [
            (RestirPt { trees: 0, ..d }, "`trees` is `0`, but must be an integer in [1, 1024]"),
            (RestirPt { reuse: Settings { rounds: 9, ..reuse }, ..d }, "in [1, 8]"),
            (RestirPt { reuse: Settings { mutations: 1, ..reuse }, ..d }, "it must be 0"),
            (
                RestirPt { reuse: Settings { decoupled: true, neighbours: 0, ..reuse }, ..d },
                "but `neighbours` is 0",
            ),
        ] {
            let error = FrameLoop::new(Arc::new(technique), &stage(), shot(2)).unwrap_err();
            assert!(error.to_string().contains(text), "{technique:?}: {error}");
        }
        assert!(parse("restir-pt:mutations=1").is_err());
        let spec = "restir-pt:trees=3,cap=4,mis=balance";
        assert_eq!(parse(spec).unwrap().spec(), spec);
    }

    #[test]
    fn paths_that_no_record_holds_are_said_to_be_left_out() {
        let stage = stage();
        let claim = |depth| RestirPt::default().plan(stage.facts(), &shot(depth)).claim;
        assert_eq!(claim(256), Claim::Unbiased);
        assert!(matches!(claim(257), Claim::Biased(why) if why.contains("256 segments")));
        let technique = Arc::new(RestirPt::default());
        let mut frames = FrameLoop::new(technique, &stage, shot(1000)).unwrap();
        for _ in 0..2 {
            assert_eq!(frames.render().unwrap().counters.non_finite, 0);
        }
    }
}
