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
use crate::resampling::{Decoupled, Estimator, Family, Merges, Selected};
use crate::reuse::parameters::reuse_rows;
use crate::reuse::passes::{self, Initial, Keys, kernel};
use crate::reuse::paths::{Connects, PathRecord, Paths};
use crate::reuse::policy::InTarget;
use crate::reuse::{Reuse, Settings, SpatialUse, Taps};
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
    rows.extend(reuse_rows!(RestirPt).into_iter().filter(|row| row.key != "mutations"));
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
    /// Frames of history that count, in [0, 250]; 0 is no temporal reuse.
    pub cap: u32,
    /// Weights of the temporal merge.
    pub temporal_mis: Family,
    /// Pixels asked a round, in [0, 8]; 0 is no spatial reuse.
    pub neighbours: u32,
    /// How far away they are at most, in pixels, in [1, 1000].
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
    /// Whether all inputs of the last merge are shown, not the selected one.
    pub decoupled: bool,
    /// Strength in [0, 1] of the boiling filter; 0 is off. Biased.
    pub boiling: f32,
    /// Frames after which a sample is dropped, in [0, 255]; 0 is never. Biased.
    pub max_age: u32,
    /// Always 0.
    mutations: u32,
}

impl Default for RestirPt {
    /// The unbiased preset.
    fn default() -> Self {
        let Settings { cap, temporal_mis, neighbours, radius, taps, rounds, .. } =
            Settings::default();
        let Settings { mis, spatial, mature, decoupled, boiling, max_age, .. } =
            Settings::default();
        Self {
            trees: 1,
            roulette_after: 5,
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
            boiling,
            max_age,
            mutations: 0,
        }
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
        if self.decoupled && self.neighbours == 0 {
            return Err(Error::usage(
                "`decoupled=true` shades with all inputs of the last spatial merge, but `neighbours` is 0; set it to at least 1",
            ));
        }
        Ok(())
    }

    /// The parameters of the passes of reuse on a scene: without history where its lights or
    /// geometry move.
    fn settings(&self, copies: bool) -> Settings {
        let Self { cap, temporal_mis, neighbours, radius, taps, rounds, mis, spatial, .. } = *self;
        let Self { mature, decoupled, boiling, max_age, mutations, .. } = *self;
        let cap = if copies { cap } else { 0 };
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
        }
    }

    fn claim(&self, settings: &Settings, still: bool) -> Claim {
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
        if self.cap > 0 && !copies {
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
        plan.finish(self.claim(&settings, facts.is_still(shot)))
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
        let reuse = Reuse::new(&paths, InTarget, technique.settings(true));
        match kernel {
            kernel::INITIAL => paths.initial(technique.trees, technique.roulette_after, band),
            kernel::TEMPORAL => reuse.temporal(band),
            kernel::BOILING => reuse.boiling(band),
            kernel::SHADE => reuse.shade(band),
            round => reuse.spatial(round - kernel::SPATIAL, band),
        }
    }
}
