//! What runs for a scene, in which order, and what is left out.

use super::{RestirDi, kernel};
use crate::plan::{Builder, Claim, NewPass, Plan, SceneFacts, Shot};
use crate::reuse::light_points::Record;
use crate::reuse::passes::{self, Initial};
use crate::reuse::policy::{Policy, WithPolicy};
use crate::techniques::Technique;

/// What is left out because of the lights.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Light {
    /// Nothing can be lit.
    None,
    /// A single light leaves nothing to choose.
    One,
    /// Light is resampled.
    Many,
}

/// The plan of `ris` or `restir-di`.
pub(super) fn plan(technique: &RestirDi, facts: &SceneFacts, shot: &Shot) -> Plan {
    let mut plan = Builder::new(technique.spec(), facts, shot);
    let lights = facts.light_count();
    let light = match lights {
        _ if shot.depth < 2 => Light::None,
        0 => Light::None,
        1 => Light::One,
        _ => Light::Many,
    };
    plan.primary_hits();
    plan.skip_coverage();
    let bounces = u64::from(shot.depth.saturating_sub(1)) * u64::from(shot.most_estimates());
    match light {
        Light::None => {
            let because = if lights == 0 { "no light emits anything" } else { "the depth is 1" };
            plan.skip("light sampling", because);
            return plan.finish(Claim::Unbiased);
        }
        Light::One => {
            plan.skip(
                "resampling and reservoirs: light sampling with MIS instead",
                "there is one light",
            );
            let pass = NewPass::pixels("paths", kernel::ALL_PATHS, vec![Plan::RADIANCE]);
            plan.pass(pass.rays(bounces, bounces, 0));
            return plan.finish(Claim::Unbiased);
        }
        Light::Many => {}
    }
    let emitter = technique.supply().plan(&mut plan, kernel::TILES);
    let claim = if technique.reuse {
        struct Passes<'a, 'b> {
            plan: &'a mut Builder<'b>,
            technique: &'a RestirDi,
            initial: Initial,
        }
        impl WithPolicy for Passes<'_, '_> {
            type Output = ();

            fn with<P: Policy>(self, _policy: P) {
                let Self { plan, technique, initial } = self;
                passes::add::<Record, P>(plan, &technique.settings(), initial);
            }
        }
        let initial = Initial {
            rays: [0, 0, emitter],
            parts: 1,
            shift_bounces: 0,
            between_frames: 0,
            shares: false,
        };
        let passes = Passes { plan: &mut plan, technique, initial };
        technique.visibility.choose(technique.limits(), passes);
        technique.claim(facts, shot)
    } else {
        let estimates = u64::from(shot.most_estimates());
        let pass = NewPass::pixels("ris", kernel::RIS, vec![Plan::RADIANCE]);
        plan.pass(pass.rays(0, estimates, estimates * emitter));
        Claim::Unbiased
    };
    if shot.depth > 2 || facts.delta_lobes {
        let shadow = bounces - u64::from(shot.most_estimates());
        let pass = NewPass::pixels("paths", kernel::PATHS, vec![Plan::RADIANCE]);
        plan.pass(pass.rays(bounces, shadow, 0));
    } else {
        plan.skip("paths of other light", "the depth is 2 and no lobe is a delta");
    }
    plan.finish(claim)
}
