//! How `restir-pt` is tested part by part, and the combinations of parameters that tests run
//! through.

use crate::resampling::Family;
use crate::techniques::{Moving, Rung};

/// From trees alone to all of reuse, mutations among it, while anything moves.
pub(super) const RUNGS: &[Rung] = &[
    Rung::new("initial", "cap=0,neighbours=0,shade=selected", Moving::Still),
    Rung::new("initial, tree", "cap=0,neighbours=0,shade=selected,direct=tree", Moving::Still),
    Rung::new("three trees", "cap=0,neighbours=0,shade=selected,trees=3", Moving::Still),
    Rung::new("roulette at once", "cap=0,neighbours=0,roulette=1", Moving::Still),
    Rung::new("spatial, constant", "cap=0,mis=constant", Moving::Still),
    Rung::new("spatial, inverse-count", "cap=0,mis=inverse-count,shade=selected", Moving::Still),
    Rung::new("spatial, contribution", "cap=0,mis=contribution,shade=selected", Moving::Still),
    Rung::new("spatial, balance", "cap=0,mis=balance", Moving::Still),
    Rung::new("spatial, pairwise", "cap=0,mis=pairwise", Moving::Still),
    Rung::new("spatial, defensive", "cap=0,mis=defensive", Moving::Still),
    Rung::new("temporal", "neighbours=0", Moving::Still),
    Rung::new("full", "", Moving::Still),
    Rung::new("full, tree", "direct=tree", Moving::Still),
    Rung::new("full, separate", "direct=separate", Moving::Still),
    Rung::new("until mature", "mature=8", Moving::Still),
    Rung::new("selected", "shade=selected", Moving::Still),
    Rung::new("decoupled", "shade=decoupled", Moving::Still),
    Rung::new("reconnection only", "shift=reconnection", Moving::Still),
    Rung::new("replay only", "shift=replay", Moving::Still),
    Rung::new("footprint", "predicate=footprint", Moving::Still),
    Rung::new("paired", "taps=pairs,neighbours=3", Moving::Still),
    Rung::new("moving camera", "", Moving::Camera),
    Rung::new("moving light", "", Moving::Light),
    Rung::new("moving occluder", "", Moving::Occluder),
    Rung::new("all moves", "", Moving::All),
    Rung::new("all moves, footprint", "predicate=footprint", Moving::All),
    Rung::new("all moves, paired", "taps=pairs,neighbours=3", Moving::All),
    Rung::new("all moves, selected", "shade=selected", Moving::All),
    Rung::new("temporal, mutated", "neighbours=0,mutations=1", Moving::Still),
    Rung::new("temporal, mutated 5", "neighbours=0,mutations=5", Moving::Still),
    Rung::new("full, mutated", "mutations=1", Moving::Still),
    Rung::new("full, mutated 5", "mutations=5", Moving::Still),
    Rung::new("paired, mutated", "taps=pairs,neighbours=3,mutations=1", Moving::Still),
    Rung::new("paired, mutated 5", "taps=pairs,neighbours=3,mutations=5", Moving::Still),
    Rung::new("moving camera, mutated", "mutations=1", Moving::Camera),
    Rung::new("moving camera, mutated 5", "mutations=5", Moving::Camera),
    Rung::new("moving light, mutated", "mutations=1", Moving::Light),
    Rung::new("moving light, mutated 5", "mutations=5", Moving::Light),
    Rung::new("moving occluder, mutated", "mutations=1", Moving::Occluder),
    Rung::new("moving occluder, mutated 5", "mutations=5", Moving::Occluder),
    Rung::new("all moves, mutated", "mutations=1", Moving::All),
    Rung::new("all moves, mutated 5", "mutations=5", Moving::All),
    Rung::new("all moves, paired, mutated", "taps=pairs,neighbours=3,mutations=1", Moving::All),
];

/// Every family of MIS weights, every filter.
pub(super) fn variants() -> Vec<String> {
    let mut all: Vec<String> = Family::ALL
        .map(Family::name)
        .iter()
        .map(|family| format!("mis={family},temporal-mis={family},neighbours=3"))
        .collect();
    for keys in [
        "cap=0",
        "neighbours=0",
        "trees=3",
        "direct=tree",
        "direct=separate,neighbours=2",
        "predicate=footprint",
        "shift=reconnection",
        "shift=replay,direct=tree",
        "tiles=on,candidates=4,bsdf=2",
        "spatial=display,rounds=2",
        "taps=random,mature=4",
        "taps=pairs,neighbours=2",
        "shared=false,rounds=2",
        "shade=decoupled",
        "shade=selected",
        "boiling=0.2,max-age=60",
        "preset=offline,trees=2",
        "preset=interactive",
        "mutations=2",
        "mutations=5,kernel=gaussian,mutate-share=0.5,neighbours=0,shade=selected",
        "mutations=1,direct=separate,taps=pairs,neighbours=2",
        "mutations=1,predicate=footprint,direct=tree",
    ] {
        all.push(keys.to_string());
    }
    all
}
