//! What runs for a scene, in which order, and what is left out.

use super::{LightTiles, RestirDi, constant, kernel};
use crate::plan::{Builder, Claim, Domain, Elements, NewPass, Plan, SceneFacts, Shot};
use crate::reuse::light_points::{Record, TILE, TILES};
use crate::reuse::passes::{self, Initial};
use crate::reuse::policy::{Policy, WithPolicy};
use crate::techniques::Technique;

/// Pixels for each light point made ahead, and lights from which that pays.
const PIXELS_A_TILE_ENTRY: usize = 4;
const LIGHTS_FOR_TILES: u32 = 1000;
/// Estimates of a pixel from which each draws from the light table. All of a pixel's estimates draw
/// from one tile in a frame, so their errors have a part in common, which more of them do not
/// lessen: on `many_lights`, error times time with 58 estimates was twice that with 2.
const ESTIMATES_WITHOUT_TILES: u32 = 8;

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
    let emitter = add_candidates(technique, &mut plan);
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
        let initial = Initial { rays: [0, 0, emitter], shift_bounces: 0 };
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

/// Settles where candidates come from. Gives the emitter rays of an estimate.
fn add_candidates(technique: &RestirDi, plan: &mut Builder<'_>) -> u64 {
    let counts = plan.facts.lights;
    let lights = plan.facts.light_count();
    let surfaces = counts.triangles + counts.quadrics > 0;
    let bsdf = if counts.delta < lights { technique.bsdf } else { 0 };
    if technique.bsdf > 0 && bsdf == 0 {
        plan.skip("BSDF samples", "no direction meets point, spot and distant lights");
    }
    if bsdf > 0 && !surfaces {
        plan.skip("rays of BSDF samples", "all other lights are environments");
    }
    let many_estimates = plan.shot.most_estimates() >= ESTIMATES_WITHOUT_TILES;
    let tiles = match technique.tiles {
        LightTiles::On => true,
        LightTiles::Off => false,
        LightTiles::Auto => lights >= LIGHTS_FOR_TILES && !many_estimates,
    };
    let mut tile_count = 0;
    if tiles {
        let entries = plan.shot.pixels().div_ceil(PIXELS_A_TILE_ENTRY) as u32;
        tile_count = entries.div_ceil(TILE).max(1);
        let items = tile_count * TILE;
        let id = plan.buffer(TILES, Elements::Items(items), false);
        let domain = Domain::Items(items);
        plan.pass(NewPass { domain, ..NewPass::pixels("light tiles", kernel::TILES, vec![id]) });
    } else if technique.tiles == LightTiles::Auto {
        plan.skip(
            "light points made ahead",
            if many_estimates {
                "8 estimates of a pixel or more would share them"
            } else {
                "there are fewer than 1,000 lights"
            },
        );
    }
    plan.constant(constant::BSDF_SAMPLES, bsdf);
    plan.constant(constant::EMITTING_SURFACES, surfaces.into());
    plan.constant(constant::LIGHT_TILES, tile_count);
    if bsdf > 0 && surfaces {
        plan.need_emitters();
        u64::from(bsdf)
    } else {
        0
    }
}
