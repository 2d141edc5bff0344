//! The kernels' twins for graphics processors: which WGSL they are made of, and its constants.

use super::{RestirDi, constant, kernel};
use crate::plan::{BufferKey, Plan};
use crate::resampling::{Family, MERGE_WGSL, RESAMPLING_WGSL};
use crate::reuse::light_points::{DIRECT_WGSL, Record, TILES, VISIBILITY_WGSL};
use crate::reuse::passes::{ControlPlace, Keys, NORMALS, Place, Round, kernel as reuse};
use crate::reuse::{Visibility, boiling_limit};
use crate::techniques::Twin;

impl RestirDi {
    pub(super) fn kernel_twin(&self, kernel: u32, plan: &Plan) -> Twin {
        let flag = |b: bool| f64::from(u8::from(b));
        fn id<T>(plan: &Plan, key: BufferKey<T>) -> f64 {
            plan.id(key).map_or(0.0, |id| id.0 as f64)
        }
        let record = |place| id(plan, Keys::<Record>::at(place));
        let control = |place: ControlPlace| id(plan, place.control_key());
        let fixed = |name| plan.constant(name).unwrap_or(0);
        let policy = match self.visibility {
            Visibility::Trace => 0,
            Visibility::InTarget => 1,
            Visibility::Bitterli => 2,
            Visibility::Reuse => 3,
            Visibility::Wis => 4,
            Visibility::WisControlVariate => 5,
        };
        let with_spatial = plan.id(Keys::<Record>::at(Place::History)).is_some();
        let mut constants = vec![
            ("POLICY", f64::from(policy)),
            ("CANDIDATE_LIGHTS", f64::from(self.candidates)),
            ("CANDIDATE_BSDF", f64::from(fixed(constant::BSDF_SAMPLES))),
            ("CANDIDATE_SURFACES", flag(fixed(constant::EMITTING_SURFACES) != 0)),
            ("LIGHT_TILES", f64::from(fixed(constant::LIGHT_TILES))),
            ("STILL", flag(plan.still)),
            ("KEEP_NORMALS", flag(plan.id(NORMALS).is_some())),
            ("OWN_HISTORY", flag(!with_spatial)),
            ("CAP", f64::from(self.cap)),
            ("MAX_AGE", f64::from(self.max_age)),
            ("B_TILES", id(plan, TILES)),
            ("B_NORMALS", id(plan, NORMALS)),
            ("B_RESERVOIRS", record(Place::Reservoirs)),
            ("B_HISTORY", record(Place::History)),
            ("B_CONTROLS", control(ControlPlace::Controls)),
            ("B_HISTORY_CONTROLS", control(ControlPlace::History)),
        ];
        if self.visibility == Visibility::Reuse {
            constants.push(("VISIBILITY_AGE", f64::from(self.visibility_age)));
            constants.push(("VISIBILITY_DISTANCE", f64::from(self.visibility_distance)));
        }
        let place = |family: Family| {
            let place = Family::ALL.iter().position(|f| *f == family);
            place.unwrap_or(0) as f64
        };
        let kernel_name = match kernel {
            kernel::RIS => "ris",
            kernel::TILES => "light_tiles",
            reuse::INITIAL => "initial",
            reuse::TEMPORAL => {
                constants.push(("FAMILY", place(self.temporal_mis)));
                "temporal"
            }
            reuse::BOILING => {
                constants.push(("BOILING_LIMIT", f64::from(boiling_limit(self.boiling))));
                "boiling"
            }
            reuse::MUTATE => {
                constants.push(("STEPS", f64::from(self.mutations)));
                constants.push(("LARGE_STEPS", f64::from(self.large_steps)));
                "mutate"
            }
            reuse::SHADE => "shade_only",
            kernel::PATHS | kernel::ALL_PATHS => {
                constants.push(("ROULETTE_AFTER", f64::from(self.roulette_after)));
                constants.push(("ALL_LIGHT", flag(kernel == kernel::ALL_PATHS)));
                "other_paths"
            }
            _ => {
                let round = Round::new(&self.settings(), kernel - reuse::SPATIAL);
                let (control_from, control_to) = round.controls();
                constants.extend([
                    ("FAMILY", place(self.mis)),
                    ("NEIGHBOURS", f64::from(self.neighbours)),
                    ("RADIUS", f64::from(self.radius)),
                    ("ROUND", f64::from(round.number)),
                    ("LAST", flag(round.last)),
                    ("DECOUPLED", flag(self.decoupled)),
                    ("B_FROM", record(round.from)),
                    ("B_TO", round.to.map_or(0.0, record)),
                    ("B_CONTROL_FROM", control(control_from)),
                    ("B_CONTROL_TO", control_to.map_or(0.0, control)),
                ]);
                "spatial"
            }
        };
        let temporal = kernel == reuse::TEMPORAL;
        let spatial = kernel >= reuse::SPATIAL;
        let with_control = self.visibility == Visibility::WisControlVariate;
        let still = plan.still;
        let decoupled = self.decoupled && spatial && kernel - reuse::SPATIAL + 1 == self.rounds;
        let traced = match self.visibility {
            Visibility::Wis | Visibility::WisControlVariate => true,
            Visibility::InTarget => false,
            _ => decoupled,
        };
        let flags = vec![
            ("KERNEL_TILES", flag(kernel == kernel::TILES)),
            ("KERNEL_RIS", flag(kernel == kernel::RIS)),
            ("KERNEL_INITIAL", flag(kernel == reuse::INITIAL)),
            ("KERNEL_TEMPORAL", flag(temporal)),
            ("KERNEL_BOILING", flag(kernel == reuse::BOILING)),
            ("KERNEL_MUTATE", flag(kernel == reuse::MUTATE)),
            ("KERNEL_SPATIAL", flag(spatial)),
            ("KERNEL_SHADE", flag(kernel == reuse::SHADE)),
            ("KERNEL_MERGE", flag(temporal || spatial)),
            ("KERNEL_SHADES", flag(spatial || kernel == reuse::SHADE)),
            // Stored targets serve both frames.
            ("IDENTITY", flag(temporal && still && !with_control)),
            ("TRACED", flag(traced)),
            ("SHOWS", flag(with_control || decoupled)),
        ];
        let mut modules = vec![RESAMPLING_WGSL, VISIBILITY_WGSL, DIRECT_WGSL];
        if temporal || spatial {
            modules.push(MERGE_WGSL);
        }
        modules.push(crate::wgsl!("restir_di.wgsl"));
        Twin { kernel: kernel_name, modules, constants, flags, ..Twin::default() }
    }
}
