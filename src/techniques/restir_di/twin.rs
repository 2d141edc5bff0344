//! The kernels' twins for graphics processors: which WGSL they are made of, and its constants.

use super::{RestirDi, buffer, kernel, kernels};
use crate::direct::{DIRECT_WGSL, VISIBILITY_WGSL, Visibility};
use crate::plan::Plan;
use crate::resampling::{Family, MERGE_WGSL, RESAMPLING_WGSL};
use crate::techniques::Twin;

impl RestirDi {
    pub(super) fn kernel_twin(&self, kernel: u32, plan: &Plan) -> Twin {
        let flag = |b: bool| f64::from(u8::from(b));
        let id = |name: &str| plan.buffer(name).map_or(0.0, |id| id.0 as f64);
        let policy = match self.visibility {
            Visibility::Trace => 0,
            Visibility::InTarget => 1,
            Visibility::Bitterli => 2,
            Visibility::Reuse { .. } => 3,
            Visibility::Wis => 4,
            Visibility::WisControlVariate => 5,
        };
        let with_spatial = plan.buffer(buffer::HISTORY).is_some();
        let mut constants = vec![
            ("POLICY", f64::from(policy)),
            ("CANDIDATE_LIGHTS", f64::from(self.candidates)),
            ("CANDIDATE_BSDF", f64::from(plan.constant("bsdf samples"))),
            ("CANDIDATE_SURFACES", flag(plan.constant("emitting surfaces") != 0)),
            ("LIGHT_TILES", f64::from(plan.constant("light tiles"))),
            ("STILL", flag(plan.constant("still") != 0)),
            ("KEEP_NORMALS", flag(plan.buffer(buffer::NORMALS).is_some())),
            ("OWN_HISTORY", flag(!with_spatial)),
            ("CAP", f64::from(self.cap)),
            ("MAX_AGE", f64::from(self.max_age)),
            ("B_TILES", id(buffer::TILES)),
            ("B_NORMALS", id(buffer::NORMALS)),
            ("B_RESERVOIRS", id(buffer::RESERVOIRS)),
            ("B_HISTORY", id(buffer::HISTORY)),
            ("B_CONTROLS", id(buffer::CONTROLS)),
            ("B_HISTORY_CONTROLS", id(buffer::HISTORY_CONTROLS)),
        ];
        if let Visibility::Reuse { max_age, max_distance } = self.visibility {
            constants.push(("VISIBILITY_AGE", f64::from(max_age)));
            constants.push(("VISIBILITY_DISTANCE", f64::from(max_distance)));
        }
        let place = |family: Family| {
            let place = Family::ALL.iter().position(|f| *f == family);
            place.unwrap_or(0) as f64
        };
        let kernel_name = match kernel {
            kernel::RIS => "ris",
            kernel::TILES => "light_tiles",
            kernel::INITIAL => "initial",
            kernel::TEMPORAL => {
                constants.push(("FAMILY", place(self.temporal_mis)));
                "temporal"
            }
            kernel::BOILING => {
                constants.push(("BOILING_LIMIT", f64::from(kernels::boiling_limit(self.boiling))));
                "boiling"
            }
            kernel::MUTATE => {
                constants.push(("STEPS", f64::from(self.mutations)));
                constants.push(("LARGE_STEPS", f64::from(self.large_steps)));
                "mutate"
            }
            kernel::SHADE => "shade_only",
            kernel::PATHS | kernel::ALL_PATHS => {
                constants.push(("ROULETTE_AFTER", f64::from(self.roulette_after)));
                constants.push(("ALL_LIGHT", flag(kernel == kernel::ALL_PATHS)));
                "other_paths"
            }
            _ => {
                let round = kernel - kernel::SPATIAL;
                let last = round + 1 == self.rounds;
                let odd = !round.is_multiple_of(2);
                let from = if odd { buffer::BOUNCE } else { buffer::RESERVOIRS };
                let to = match (last, odd) {
                    (true, _) => buffer::HISTORY,
                    (false, false) => buffer::BOUNCE,
                    (false, true) => buffer::RESERVOIRS,
                };
                let control_to = if last { buffer::HISTORY_CONTROLS } else { buffer::CONTROLS };
                constants.extend([
                    ("FAMILY", place(self.mis)),
                    ("NEIGHBOURS", f64::from(self.neighbours)),
                    ("RADIUS", f64::from(self.radius)),
                    ("ROUND", f64::from(round)),
                    ("LAST", flag(last)),
                    ("DECOUPLED", flag(self.decoupled)),
                    ("B_FROM", id(from)),
                    ("B_TO", id(to)),
                    ("B_CONTROL_FROM", id(buffer::CONTROLS)),
                    ("B_CONTROL_TO", id(control_to)),
                ]);
                "spatial"
            }
        };
        let temporal = kernel == kernel::TEMPORAL;
        let spatial = kernel >= kernel::SPATIAL;
        let control = self.visibility == Visibility::WisControlVariate;
        let still = plan.constant("still") != 0;
        let decoupled = self.decoupled && spatial && kernel - kernel::SPATIAL + 1 == self.rounds;
        let traced = match self.visibility {
            Visibility::Wis | Visibility::WisControlVariate => true,
            Visibility::InTarget => false,
            _ => decoupled,
        };
        let flags = vec![
            ("KERNEL_TILES", flag(kernel == kernel::TILES)),
            ("KERNEL_RIS", flag(kernel == kernel::RIS)),
            ("KERNEL_INITIAL", flag(kernel == kernel::INITIAL)),
            ("KERNEL_TEMPORAL", flag(temporal)),
            ("KERNEL_BOILING", flag(kernel == kernel::BOILING)),
            ("KERNEL_MUTATE", flag(kernel == kernel::MUTATE)),
            ("KERNEL_SPATIAL", flag(spatial)),
            ("KERNEL_SHADE", flag(kernel == kernel::SHADE)),
            ("KERNEL_MERGE", flag(temporal || spatial)),
            ("KERNEL_SHADES", flag(spatial || kernel == kernel::SHADE)),
            // Stored targets serve both frames.
            ("IDENTITY", flag(temporal && still && !control)),
            ("TRACED", flag(traced)),
            ("SHOWS", flag(control || decoupled)),
        ];
        let mut modules = vec![RESAMPLING_WGSL, VISIBILITY_WGSL, DIRECT_WGSL];
        if temporal || spatial {
            modules.push(MERGE_WGSL);
        }
        modules.push(crate::wgsl!("restir_di.wgsl"));
        Twin { kernel: kernel_name, modules, constants, flags, ..Twin::default() }
    }
}
