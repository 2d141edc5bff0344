//! Paths by resampling and reuse: `restir-pt` (Lin et al. 2022, *Generalized Resampled Importance
//! Sampling*; hybrid shift).
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | light tiles | lights | light points made ahead, for many lights |
//! | initial | hits | reservoirs: a light point of the candidates or a path of the walks; estimates: the light of all of them |
//! | temporal | reservoirs, the last frame's `history` | reservoirs, in place |
//! | boiling | reservoirs of a tile | reservoirs, in place; off by default, biased |
//! | mutate | reservoirs | reservoirs, in place, whose paths moved; off by default |
//! | shifts | reservoirs | the path of each pixel as its partners see it |
//! | spatial | reservoirs, shifts | `history` (the last round, which also shades) |
//! | shade | reservoirs | radiance, where there is no spatial pass |
//!
//! What lies behind a path's reconnection vertex is traced again in the other frame where lights or
//! geometry move, and copied where only the camera does.

mod parameters;
mod rungs;

use parameters::rows;
pub use parameters::{Direct, Preset, Shade};

use std::borrow::Cow;
use std::marker::PhantomData;

use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::error::{Error, Result};
use crate::pass::{Band, FrameInputs};
use crate::path::Limits;
use crate::plan::{BufferPlan, Builder, Claim, Plan, SceneFacts, Shot};
use crate::resampling::{ControlVariate, Decoupled, Estimator, Merges, Selected};
use crate::reuse::light_points::{LightPoints, LightTiles, Supply};
use crate::reuse::passes::{self, Initial, Keys, Place, kernel as reuse_kernel};
use crate::reuse::paths::{
    self, Connects, Fresh, Kept, MOST_SEGMENTS, MutableRecord, PathRecord, Paths, Predicate,
    Records, ShiftKind,
};
use crate::reuse::policy::{InTarget, InTargetControl, Policy};
use crate::reuse::{Kernel, Reuse, Settings};
use crate::spec::{self, Choice};
use crate::techniques::{Entry, Technique};
use crate::world::WithFilter;

/// The bits of the least distance of a connection, as an f32.
const DISTANCE: &str = "least distance of a connection, bits";
/// Whether all lobes are Lambert's.
const MATT: &str = "all lobes are matt";
/// Walks a chain.
const WALKS: &str = "walks";
/// Reservoirs of a chain.
const PARTS: &str = "parts of the light with reservoirs of their own";
/// Whether what lies behind a connection is traced again in another frame.
const RETRACES: &str = "paths are traced again behind their connections";

/// Numbers of the technique's own kernels; those of reuse are [`crate::reuse::passes::kernel`].
mod kernel {
    pub(super) const TILES: u32 = 0;
}

pub(super) const RESTIR_PT: Entry = Entry {
    name: "restir-pt",
    about: "all light by paths reused over frames and pixels (Lin et al. 2022, hybrid shift)",
    parameters: || spec::describe(&rows(), &RestirPt::default()),
    build: |values| Ok(Box::new(spec::build(RestirPt::default(), &rows(), values)?.validated()?)),
    direct: false,
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
    /// How paths are shifted.
    pub shift: ShiftKind,
    /// When vertices are far enough apart to be connected.
    pub predicate: Predicate,
    /// Where direct light comes from.
    pub direct: Direct,
    /// Unless [`Direct::Tree`], light samples a pixel, frame and chain, in [1, 1024].
    ///
    /// More is less noise for more time.
    pub candidates: u32,
    /// Unless [`Direct::Tree`], BSDF samples a pixel, frame and chain, in [0, 64].
    ///
    /// They find large lights on glossy surfaces, for a ray each.
    pub bsdf: u32,
    /// Unless [`Direct::Tree`], whether light points are made ahead in tiles that fit the cache.
    pub tiles: LightTiles,
    /// With [`Taps::Xor`](crate::reuse::Taps::Xor) and [`Taps::Pairs`](crate::reuse::Taps::Pairs),
    /// whether a shift is made once for both pixels that ask for it.
    ///
    /// The picture is the same to the bit.
    pub shared: bool,
    /// What is shown.
    pub shade: Shade,
    /// Of reuse; `shade` stands for `decoupled`, which must be false.
    pub reuse: Settings,
}

impl Default for RestirPt {
    /// The unbiased preset. Its neighbours are asked in every frame, since indirect light is often
    /// found by few pixels.
    fn default() -> Self {
        let reuse = Settings { mature: 0, ..Settings::default() };
        Self {
            trees: 1,
            roulette_after: 5,
            shift: ShiftKind::Hybrid,
            predicate: Predicate::Distance,
            direct: Direct::Union,
            candidates: 8,
            bsdf: 1,
            tiles: LightTiles::Auto,
            shared: true,
            shade: Shade::Control,
            reuse,
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
        let Settings { decoupled, neighbours, mutations, kernel, mutate_share, .. } = self.reuse;
        let Self { candidates, bsdf, tiles, .. } = Self::default();
        if self.direct == Direct::Tree
            && (self.candidates, self.bsdf, self.tiles) != (candidates, bsdf, tiles)
        {
            return Err(Error::usage(format!(
                "`candidates`, `bsdf` and `tiles` need `direct=union` or `separate`, but it is `{}`",
                self.direct.name()
            )));
        }
        let steps = Settings::default();
        if mutations == 0 && (kernel, mutate_share) != (steps.kernel, steps.mutate_share) {
            return Err(Error::usage(
                "`kernel` and `mutate-share` say how paths are mutated, but `mutations` is 0; set it to at least 1",
            ));
        }
        if decoupled {
            return Err(Error::usage("`decoupled` is true, but `shade` says what is shown"));
        }
        if self.shade == Shade::Decoupled && neighbours == 0 {
            return Err(Error::usage(
                "`shade=decoupled` shows all inputs of the last spatial merge, but `neighbours` is 0; set it to at least 1",
            ));
        }
        Ok(())
    }

    fn mutates(&self) -> bool {
        self.reuse.mutations > 0
    }

    /// The paths of records.
    fn paths<'w>(&self, words: &'w [u32]) -> Cow<'w, [PathRecord]> {
        if self.mutates() {
            let records: &[MutableRecord] = bytemuck::cast_slice(words);
            records.iter().map(|record| record.path).collect()
        } else {
            Cow::Borrowed(bytemuck::cast_slice(words))
        }
    }

    fn supply(&self) -> Supply {
        Supply { candidates: self.candidates, bsdf: self.bsdf, tiles: self.tiles }
    }

    fn settings(&self) -> Settings {
        Settings { decoupled: self.shade == Shade::Decoupled, ..self.reuse }
    }

    fn claim(&self, still: bool, depth: u32) -> Claim {
        let settings = &self.reuse;
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
        let claim = match self.shade {
            Shade::Selected => Selected::claim(&merges),
            Shade::Decoupled => Decoupled::claim(&merges),
            Shade::Control => ControlVariate::claim(&merges),
        };
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
        if settings.duplicates > 0.0 && temporal {
            reasons.push("history counts by what it holds (`duplicates`)".into());
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

    fn signed(&self) -> bool {
        self.shade == Shade::Control
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
        plan.constant(DISTANCE, Connects::of_diagonal(facts.diagonal).distance.to_bits());
        let scatterings = u64::from(shot.depth) - 1;
        let matt = !facts.delta_lobes && !facts.glossy_lobes;
        plan.constant(MATT, matt.into());
        if matt {
            plan.skip("roughness of the lobes that paths are connected by", "all are matt");
        }
        let direct = self.direct != Direct::Tree;
        let walks = if direct && shot.depth == 2 && !facts.delta_lobes {
            plan.skip("paths of other light", "the depth is 2 and no lobe is a delta");
            0
        } else {
            self.trees
        };
        plan.constant(WALKS, walks);
        let emitter = if direct { self.supply().plan(&mut plan, kernel::TILES) } else { 0 };
        let walks = u64::from(walks) * scatterings;
        let retraces = facts.moving_lights || facts.moving_geometry;
        plan.constant(RETRACES, retraces.into());
        if self.reuse.cap > 0 && !retraces {
            plan.skip(
                "tracing paths again behind their connections",
                "neither lights nor geometry move",
            );
        }
        let parts = if self.direct == Direct::Separate && walks > 0 { 2 } else { 1 };
        plan.constant(PARTS, parts);
        let initial = Initial {
            parts,
            rays: [walks, walks, emitter],
            shift_bounces: scatterings,
            between_frames: retraces.into(),
            shares: self.shared,
        };
        let settings = self.settings();
        if self.mutates() {
            add::<MutableRecord>(&mut plan, self.shade, &settings, initial);
        } else {
            plan.skip("what follows a path's connection", "`mutations` is 0");
            add::<PathRecord>(&mut plan, self.shade, &settings, initial);
        }
        plan.finish(self.claim(facts.is_still(shot), shot.depth))
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        inputs.world.with_filter(Call { technique: self, kernel, inputs, band })
    }

    fn describe(&self, buffer: &BufferPlan, element: &[u32]) -> Vec<(&'static str, String)> {
        if Keys::<PathRecord>::ALL.iter().all(|key| key.name != buffer.name) {
            return Vec::new();
        }
        self.paths(element).iter().flat_map(PathRecord::describe).collect()
    }

    fn layers<'f>(
        &self,
        plan: &Plan,
        size: [u32; 2],
        buffer: &dyn Fn(&str) -> Option<&'f [u32]>,
    ) -> Vec<(&'static str, Vec<f32>)> {
        let places = [Place::History, Place::Reservoirs].map(Keys::<PathRecord>::at);
        let Some(records) = places.iter().find_map(|key| buffer(key.name)) else {
            return Vec::new();
        };
        let shifts = buffer(passes::SHIFTS.name).unwrap_or(&[]);
        paths::layers(&Kept {
            size,
            records: &self.paths(records),
            shown: plan.constant(PARTS).unwrap_or(1) as usize - 1,
            shifts: bytemuck::cast_slice(shifts),
        })
    }
}

/// Adds the passes of reuse with the estimator of `shade`.
fn add<R: Records>(plan: &mut Builder<'_>, shade: Shade, settings: &Settings, initial: Initial) {
    match shade {
        Shade::Control => passes::add::<R, InTargetControl>(plan, settings, initial),
        _ => passes::add::<R, InTarget>(plan, settings, initial),
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
        let fixed = |name| inputs.plan.constant(name).expect("the plan fixes what kernels ask for");
        let distance = f32::from_bits(fixed(DISTANCE));
        let matt = fixed(MATT) != 0;
        let connects = Connects::new(distance, technique.shift).by(technique.predicate).matt(matt);
        let retraces = fixed(RETRACES) != 0;
        let parts = fixed(PARTS);
        if kernel == kernel::TILES {
            let large_steps = 0.0;
            let points = LightPoints::<F, true> { frame: inputs, filter: &filter, large_steps };
            return points.tiles(band);
        }
        let frame = (inputs, &filter);
        let Settings { kernel: step, .. } = technique.reuse;
        let paths = Frame { connects, retraces, parts, step };
        if technique.mutates() {
            run(technique, &paths.of::<F, MutableRecord>(frame), kernel, band)
        } else {
            run(technique, &paths.of::<F, PathRecord>(frame), kernel, band)
        }
    }
}

/// What a frame's plan says of its paths.
struct Frame {
    connects: Connects,
    retraces: bool,
    parts: u32,
    step: Kernel,
}

impl Frame {
    fn of<'a, F, R>(&self, (frame, filter): (&'a FrameInputs<'a>, &'a F)) -> Paths<'a, F, R> {
        let Self { connects, retraces, parts, step: kernel } = *self;
        Paths { frame, filter, connects, retraces, parts, kernel, records: PhantomData }
    }
}

/// A kernel, with the type of the records chosen.
fn run<F: HitFilter + Sync, R: Records>(
    technique: &RestirPt,
    paths: &Paths<'_, F, R>,
    kernel: u32,
    band: &mut Band<'_>,
) -> Counters {
    let inputs = paths.frame;
    if kernel == reuse_kernel::INITIAL {
        let limits = Limits {
            depth: inputs.shot.depth.min(MOST_SEGMENTS),
            roulette_after: technique.roulette_after,
        };
        let direct = (technique.direct != Direct::Tree).then(|| technique.supply().sources(inputs));
        let walks = inputs.plan.constant(WALKS).expect("the plan fixes what kernels ask for");
        return paths.initial(Fresh { walks, limits, direct }, band);
    }
    let settings = technique.settings();
    match technique.shade {
        Shade::Control => reused(&Reuse::new(paths, InTargetControl, settings), kernel, band),
        _ => reused(&Reuse::new(paths, InTarget, settings), kernel, band),
    }
}

/// One of the passes that are the same for all domains.
fn reused<F: HitFilter + Sync, R: Records, P: Policy>(
    reuse: &Reuse<'_, Paths<'_, F, R>, P>,
    kernel: u32,
    band: &mut Band<'_>,
) -> Counters {
    match kernel {
        reuse_kernel::TEMPORAL => reuse.temporal(band),
        reuse_kernel::BOILING => reuse.boiling(band),
        reuse_kernel::MUTATE => reuse.mutate(band),
        reuse_kernel::SHADE => reuse.shade(band),
        round if round >= reuse_kernel::SHIFTS => {
            reuse.exchange(round - reuse_kernel::SHIFTS, band)
        }
        round => reuse.spatial(round - reuse_kernel::SPATIAL, band),
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
            (RestirPt { reuse: Settings { mutations: 65, ..reuse }, ..d }, "in [0, 64]"),
            (RestirPt { reuse: Settings { mutate_share: 0.5, ..reuse }, ..d }, "`mutations` is 0"),
            (RestirPt { reuse: Settings { decoupled: true, ..reuse }, ..d }, "but `shade` says"),
            (
                RestirPt {
                    shade: Shade::Decoupled,
                    reuse: Settings { neighbours: 0, ..reuse },
                    ..d
                },
                "but `neighbours` is 0",
            ),
        ] {
            let error = FrameLoop::new(Arc::new(technique), &stage(), shot(2)).unwrap_err();
            assert!(error.to_string().contains(text), "{technique:?}: {error}");
        }
        assert!(parse("restir-pt:mutations=1,mutate-share=0").is_err());
        let offline = parse("restir-pt:rounds=2,preset=offline").unwrap();
        let as_said = "restir-pt:trees=32,cap=0,neighbours=6,radius=10,rounds=2";
        assert_eq!(offline.spec(), as_said);
        assert_eq!(parse(as_said).unwrap().spec(), as_said);
        assert_eq!(parse("restir-pt:preset=unbiased").unwrap().spec(), "restir-pt");
        let claim = |spec| parse(spec).unwrap().plan(stage().facts(), &shot(4)).claim;
        assert!(matches!(claim("restir-pt:preset=interactive"), Claim::Biased(_)));
        assert!(matches!(claim("restir-pt:duplicates=0.5"), Claim::Biased(_)));
        assert_eq!(claim("restir-pt:preset=offline"), Claim::Unbiased);
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
