//! The kernels' twins for graphics processors: which WGSL they are made of, and its constants.

use super::{RestirDi, kernel};
use crate::plan::Plan;
use crate::reuse::light_points::Record;
use crate::reuse::light_points::twin::{domain, initial, receivers};
use crate::reuse::twin::{TwinSettings, flag, twin};
use crate::twin::Twin;

impl RestirDi {
    pub(super) fn kernel_twin(&self, kernel: u32, plan: &Plan) -> Twin {
        let candidates = || self.supply().supplied(plan);
        match kernel {
            kernel::TILES => candidates().tiles(plan),
            kernel::RIS => {
                let mut ris = receivers("ris");
                candidates().add_to(&mut ris, plan);
                ris.modules.push(crate::wgsl!("ris.wgsl"));
                ris
            }
            kernel::PATHS | kernel::ALL_PATHS => Twin {
                kernel: "paths",
                modules: vec![crate::wgsl!("paths.wgsl")],
                constants: vec![
                    ("ROULETTE_AFTER", f64::from(self.roulette_after)),
                    ("ALL_LIGHT", flag(kernel == kernel::ALL_PATHS)),
                ],
                ..Twin::default()
            },
            _ => {
                let (settings, limits) = (self.settings(), self.limits());
                let at = TwinSettings { plan, settings, visibility: self.visibility, limits };
                let domain = domain(self.mutations, self.large_steps);
                twin::<Record>(kernel, &at, &domain)
                    .unwrap_or_else(|| initial(&at, &domain, candidates()))
            }
        }
    }
}
