//! What runs for a scene, in which order, and what is left out.

use super::{LOBES, Mcmm, McmmPaths, SetEstimator, kernel};
use crate::plan::{Builder, Claim, Domain, Elements, Grid, NewPass, Plan, SceneFacts, Shot};
use crate::resampling::Estimator;
use crate::reuse::lobes::{SetConditions, StochasticMis};
use crate::techniques::Technique;

/// Constant of the plan: whether lobes follow their lights.
pub(super) const FOLLOWS: &str = "lobes follow lights";

/// The plan of `mcmm`.
pub(super) fn plan(technique: &Mcmm, facts: &SceneFacts, shot: &Shot) -> Plan {
    let mut plan = Builder::new(technique.spec(), facts, shot);
    plan.primary_hits();
    plan.skip_coverage();
    let lights = &facts.lights;
    let met = lights.triangles + lights.quadrics + lights.environments;
    let estimates = u64::from(shot.most_estimates());
    let bounces = u64::from(shot.depth.saturating_sub(1)) * estimates;
    if shot.depth < 2 || facts.light_count() == 0 {
        let because = if shot.depth < 2 { "the depth is 1" } else { "no light emits anything" };
        plan.skip("light sampling", because);
        plan.skip("lobes", because);
        return plan.finish(Claim::Unbiased);
    }
    if met == 0 {
        plan.skip(
            "lobes: light sampling at every vertex instead",
            "no direction meets an emitter or a sky",
        );
        let pass = NewPass::pixels("paths", kernel::ALL_PATHS, vec![Plan::RADIANCE]);
        plan.pass(pass.rays(bounces, bounces, 0));
        return plan.finish(Claim::Unbiased);
    }
    if lights.delta == 0 {
        plan.skip("lights that no direction meets", "there are none");
    }
    if lights.environments == 0 {
        plan.skip("environment lookups", "there is no environment");
    }
    if technique.light == 0.0 {
        plan.skip("light sampling at the primary hit", "`light` is 0");
    }
    let follows = technique.follow && facts.moving_lights;
    plan.constant(FOLLOWS, follows.into());
    if technique.follow && !follows {
        plan.skip("lobes that follow their lights", "no light moves");
    }
    let lobes = plan.buffer(LOBES, Elements::Pixels, true);
    let [width, height] = technique.tile();
    let domain = Domain::Tiles { width, height, grid: Grid::Fixed([0, 0]) };
    let writes = vec![lobes, Plan::RADIANCE];
    let steps = estimates * u64::from(technique.steps());
    let sampled = if technique.light > 0.0 { steps } else { 0 };
    // Rays behind the first that a direction meets.
    let behind = steps * u64::from(shot.depth - 2);
    let [bounce, shadow] = match technique.paths {
        McmmPaths::Direct => [0, 0],
        McmmPaths::Caustics => [behind, 0],
        McmmPaths::All => [behind, behind],
    };
    let pass = NewPass { domain, ..NewPass::pixels("chains", kernel::CHAINS, writes) };
    plan.pass(pass.rays(steps + bounce, sampled + shadow, 0));
    if technique.paths == McmmPaths::All && !facts.delta_lobes {
        plan.skip("paths that leave the primary hit by a delta", "no lobe is a delta");
    } else if shot.depth > 2 || facts.delta_lobes {
        let pass = NewPass::pixels("paths", kernel::PATHS, vec![Plan::RADIANCE]);
        plan.pass(pass.rays(bounces, bounces - estimates, 0));
    } else {
        plan.skip("paths of other light", "the depth is 2 and no lobe is a delta");
    }
    plan.finish(StochasticMis::claim(&SetConditions {
        blind: technique.estimator != SetEstimator::Tsmis || technique.n <= technique.set,
        uniform: true,
        fresh: true,
        covers: technique.large > 0.0,
        finds_all_lights: technique.light > 0.0 || lights.delta == 0,
    }))
}
