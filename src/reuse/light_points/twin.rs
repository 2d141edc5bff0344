//! What light points bring to twins for graphics processors.

use super::{Record, Supplied, TILES};
use crate::plan::Plan;
use crate::reuse::passes::NORMALS;
use crate::reuse::twin::{DomainTwin, TwinSettings, flag, id, shared, with_surfaces};
use crate::twin::{Module, Twin};

const RECEIVER: Module = crate::wgsl!("receiver.wgsl");
const TILES_WGSL: Module = crate::wgsl!("tiles.wgsl");
const CANDIDATES: Module = crate::wgsl!("candidates.wgsl");

impl Supplied {
    fn tile_constants(&self, plan: &Plan) -> [(&'static str, f64); 2] {
        [("LIGHT_TILES", f64::from(self.tiles)), ("B_TILES", id(plan, TILES))]
    }

    /// Adds what draws candidates to a twin that has [`receivers`].
    pub(crate) fn add_to(&self, twin: &mut Twin, plan: &Plan) {
        twin.modules.extend([TILES_WGSL, CANDIDATES]);
        twin.constants.extend(self.tile_constants(plan));
        twin.constants.extend([
            ("CANDIDATE_LIGHTS", f64::from(self.lights)),
            ("CANDIDATE_BSDF", f64::from(self.bsdf)),
            ("CANDIDATE_SURFACES", flag(self.surfaces)),
        ]);
    }

    /// The twin that fills the tiles.
    pub(crate) fn tiles(&self, plan: &Plan) -> Twin {
        let constants = self.tile_constants(plan).to_vec();
        Twin { kernel: "light_tiles", modules: vec![TILES_WGSL], constants, ..Twin::default() }
    }
}

/// A twin that has receivers and no reservoirs.
pub(crate) fn receivers(kernel: &'static str) -> Twin {
    let modules = vec![crate::resampling::RESAMPLING_WGSL, RECEIVER];
    Twin { kernel, modules, ..Twin::default() }
}

/// Light points as a domain of the passes.
pub(crate) fn domain(mutations: u32, large_steps: f32) -> DomainTwin {
    DomainTwin {
        modules: vec![RECEIVER, crate::wgsl!("record.wgsl"), crate::wgsl!("domain.wgsl")],
        shift: crate::wgsl!("shift.wgsl"),
        mutate: crate::wgsl!("mutate.wgsl"),
        mutate_constants: vec![
            ("STEPS", f64::from(mutations)),
            ("LARGE_STEPS", f64::from(large_steps)),
        ],
    }
}

/// The twin of the initial pass.
pub(crate) fn initial(at: &TwinSettings<'_>, domain: &DomainTwin, candidates: Supplied) -> Twin {
    let mut twin = shared::<Record>(at, domain);
    twin.kernel = "initial";
    with_surfaces(&mut twin, at);
    candidates.add_to(&mut twin, at.plan);
    twin.modules.push(crate::wgsl!("initial.wgsl"));
    twin.flags.push(("KEEP_NORMALS", flag(at.plan.id(NORMALS).is_some())));
    twin
}
