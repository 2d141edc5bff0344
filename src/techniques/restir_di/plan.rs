//! What runs for a scene, in which order, and what is left out.

use super::{
    BOILING_TILE, LIGHTS_FOR_TILES, LightTiles, PIXELS_A_TILE_ENTRY, RestirDi, buffer, is_still,
    kernel,
};
use crate::direct::Visibility;
use crate::plan::{
    BufferId, BufferPlan, Claim, Domain, Elements, Filter, Kernel, Pass, Plan, Runs, SceneFacts,
    Shot, Skip,
};
use crate::resampling::Family;
use crate::techniques::Technique;

/// A plan in the making.
pub(super) struct Planner<'a> {
    technique: &'a RestirDi,
    facts: &'a SceneFacts,
    shot: &'a Shot,
    still: bool,
    passes: Vec<Pass>,
    buffers: Vec<BufferPlan>,
    skipped: Vec<Skip>,
    constants: Vec<(&'static str, u32)>,
}

impl<'a> Planner<'a> {
    pub(super) fn new(technique: &'a RestirDi, facts: &'a SceneFacts, shot: &'a Shot) -> Self {
        Self {
            technique,
            facts,
            shot,
            still: is_still(facts, shot),
            passes: Vec::new(),
            buffers: Plan::standard_buffers(),
            skipped: Vec::new(),
            constants: Vec::new(),
        }
    }

    fn skip(&mut self, what: &'static str, because: &'static str) {
        self.skipped.push(Skip { what, because });
    }

    fn buffer(&mut self, name: &'static str, bytes: u32, history: bool) -> BufferId {
        self.buffers.push(BufferPlan { name, bytes, elements: Elements::Pixels, history });
        BufferId(self.buffers.len() - 1)
    }

    fn pass(&mut self, name: &'static str, kernel: u32, writes: Vec<BufferId>, runs: Runs) {
        let domain = Domain::Pixels;
        self.passes.push(Pass { name, kernel: Kernel::Technique(kernel), domain, writes, runs });
    }

    pub(super) fn plan(mut self) -> Plan {
        let RestirDi { bsdf, cap, neighbours, rounds, mutations, visibility, boiling, .. } =
            *self.technique;
        let (facts, shot) = (self.facts, self.shot);
        let lights = facts.light_count();
        let effort = u64::from(shot.effort);
        let bounces = u64::from(shot.depth.saturating_sub(1));
        let surfaces = facts.lights.triangles + facts.lights.quadrics > 0;
        // A single light leaves nothing to choose; no light, or no scattering, leaves nothing at all.
        let resampled = lights > 1 && shot.depth > 1;
        let nothing = lights == 0 || shot.depth < 2;
        let reuse = self.technique.reuse && resampled;
        let temporal = reuse && cap > 0;
        let spatial = reuse && neighbours > 0;
        let control = reuse && visibility == Visibility::WisControlVariate;

        if !facts.moves() && shot.filter == Filter::Point {
            self.skip("primary rays after the first frame", "nothing moves");
        }
        self.passes.push(Pass {
            name: "primary hits",
            kernel: Kernel::PrimaryHits,
            domain: Domain::Pixels,
            writes: vec![Plan::HITS, Plan::EMISSION],
            runs: if self.still { Runs::Once } else { Runs::Always },
        });
        if !facts.alpha {
            self.skip("coverage lookups at every hit", "no surface has a coverage mask");
        }
        if nothing {
            let because = if lights == 0 { "no light emits anything" } else { "the depth is 1" };
            self.skip("light sampling", because);
        }
        if lights == 1 && !nothing {
            self.skip(
                "resampling and reservoirs: light sampling with MIS instead",
                "there is one light",
            );
            self.pass("paths", kernel::ALL_PATHS, vec![Plan::RADIANCE], Runs::Always);
        }
        let with_bsdf = resampled && bsdf > 0 && facts.lights.delta < lights;
        if resampled && bsdf > 0 && !with_bsdf {
            self.skip("BSDF samples", "no direction meets point, spot and distant lights");
        }
        if resampled && with_bsdf && !surfaces {
            self.skip("rays of BSDF samples", "all other lights are environments");
        }
        let tiles = resampled
            && match self.technique.tiles {
                LightTiles::On => true,
                LightTiles::Off => false,
                LightTiles::Auto => lights >= LIGHTS_FOR_TILES,
            };
        let mut tile_count = 0;
        if tiles {
            let entries = shot.pixels().div_ceil(PIXELS_A_TILE_ENTRY) as u32;
            tile_count = entries.div_ceil(crate::direct::TILE).max(1);
            let items = tile_count * crate::direct::TILE;
            self.buffers.push(BufferPlan {
                name: buffer::TILES,
                bytes: size_of::<crate::direct::TileEntry>() as u32,
                elements: Elements::Items(items),
                history: false,
            });
            self.passes.push(Pass {
                name: "light tiles",
                kernel: Kernel::Technique(kernel::TILES),
                domain: Domain::Items(items),
                writes: vec![BufferId(self.buffers.len() - 1)],
                runs: Runs::Always,
            });
        } else if resampled && self.technique.tiles == LightTiles::Auto {
            self.skip("light points made ahead", "there are fewer than 1,000 lights");
        }
        self.constants = vec![
            ("still", self.still.into()),
            ("bsdf samples", if with_bsdf { bsdf } else { 0 }),
            ("emitting surfaces", surfaces.into()),
            ("light tiles", tile_count),
        ];

        if resampled && !reuse {
            self.pass("ris", kernel::RIS, vec![Plan::RADIANCE], Runs::Always);
        }
        if reuse {
            self.reuse_passes(temporal, spatial, control, (mutations, boiling));
        }
        if self.still && temporal {
            self.skip(
                "motion vectors, the previous frame's surfaces and lights",
                "nothing moves and the filter is a point",
            );
        }
        let deep = shot.depth > 2 && lights > 0;
        let other = resampled && (deep || (facts.delta_lobes && shot.depth > 1));
        if other {
            self.pass("paths", kernel::PATHS, vec![Plan::RADIANCE], Runs::Always);
        } else if resampled {
            self.skip("paths of other light", "the depth is 2 and no lobe is a delta");
        }

        let k = u64::from(neighbours);
        let pairs = |family: Family| match family {
            Family::Constant => k,
            Family::Balance => k * (k + 1),
            _ => 2 * k,
        };
        let moving = u64::from(!self.still);
        let decoupled = u64::from(self.technique.decoupled && spatial);
        let round = u64::from(rounds) * u64::from(spatial);
        let shadow = if !resampled {
            0
        } else if !reuse {
            effort
        } else {
            let changed = u64::from(mutations > 0);
            let temporal = u64::from(temporal);
            match visibility {
                Visibility::Trace => 1 + decoupled * k,
                Visibility::Bitterli => 2 + decoupled * k,
                Visibility::InTarget => {
                    1 + temporal * moving * 2
                        + round * pairs(self.technique.mis)
                        + u64::from(mutations)
                }
                Visibility::Reuse => 2 + decoupled * k + changed,
                Visibility::Wis => 1 + round * k,
                Visibility::WisControlVariate => 1 + temporal * moving + round * k + changed,
            }
        };
        let paths = if nothing {
            0
        } else if lights == 1 {
            bounces * effort
        } else if other {
            (bounces - 1) * effort
        } else {
            0
        };
        let bounce = if nothing || (resampled && !other) { 0 } else { bounces * effort };
        let emitter = if with_bsdf && surfaces { u64::from(bsdf) * effort } else { 0 };
        let claim = if reuse { self.technique.claim(facts, shot) } else { Claim::Unbiased };
        Plan {
            technique: self.technique.spec(),
            passes: self.passes,
            buffers: self.buffers,
            skipped: self.skipped,
            rays_per_pixel: [1, bounce, shadow + paths, emitter],
            constants: self.constants,
            emitters: with_bsdf && surfaces,
            claim,
        }
    }

    fn reuse_passes(
        &mut self,
        temporal: bool,
        spatial: bool,
        control: bool,
        (mutations, boiling): (u32, f32),
    ) {
        let record = size_of::<crate::direct::Record>() as u32;
        let estimate = size_of::<crate::direct::Control>() as u32;
        let rounds = self.technique.rounds;
        if temporal && !self.still {
            self.buffers[Plan::HITS.0].history = true;
        }
        let normals = (spatial || (temporal && !self.still))
            .then(|| self.buffer(buffer::NORMALS, 4, temporal && !self.still));
        // Without a spatial pass the reservoirs are their own history.
        let own_history = temporal && !spatial;
        let reservoirs = self.buffer(buffer::RESERVOIRS, record, own_history);
        let history = spatial.then(|| self.buffer(buffer::HISTORY, record, false));
        let bounce = (spatial && rounds > 1).then(|| self.buffer(buffer::BOUNCE, record, false));
        let controls = control.then(|| self.buffer(buffer::CONTROLS, estimate, own_history));
        let history_controls =
            (control && spatial).then(|| self.buffer(buffer::HISTORY_CONTROLS, estimate, false));

        let mut writes = vec![reservoirs];
        writes.extend(controls);
        writes.extend(normals);
        self.pass("initial", kernel::INITIAL, writes, Runs::Always);
        let in_place = |controls: Option<BufferId>| {
            let mut writes = vec![reservoirs];
            writes.extend(controls);
            writes
        };
        if temporal {
            self.pass("temporal", kernel::TEMPORAL, in_place(controls), Runs::WithHistory);
        }
        if boiling > 0.0 {
            self.passes.push(Pass {
                name: "boiling",
                kernel: Kernel::Technique(kernel::BOILING),
                domain: Domain::Tiles { width: BOILING_TILE, height: BOILING_TILE, origin: [0, 0] },
                writes: vec![reservoirs],
                runs: Runs::Always,
            });
        }
        if mutations > 0 {
            self.pass("mutate", kernel::MUTATE, in_place(controls), Runs::Always);
        }
        if let Some(history) = history {
            for round in 0..rounds {
                // The last round is number 0 and writes the history; those before alternate between the other two buffers.
                let left = rounds - 1 - round;
                let last = left == 0;
                let to = match bounce {
                    _ if last => history,
                    Some(bounce) if round.is_multiple_of(2) => bounce,
                    _ => reservoirs,
                };
                let mut writes = vec![to];
                writes.extend(if last { history_controls } else { controls });
                if last {
                    writes.push(Plan::RADIANCE);
                }
                self.pass("spatial", kernel::SPATIAL + round, writes, Runs::Always);
            }
        } else {
            self.skip("spatial reuse", "no neighbours are asked for");
            self.pass("shade", kernel::SHADE, vec![Plan::RADIANCE], Runs::Always);
        }
        if !temporal {
            self.skip("temporal reuse", "the cap is 0");
        }
    }
}
