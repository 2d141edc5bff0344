//! How `restir-di` is tested part by part, and the combinations of parameters that tests run
//! through.

use crate::resampling::Family;
use crate::reuse::Visibility;
use crate::techniques::{Moving, Rung};

/// From candidates alone to all of reuse on moving scenes.
pub(super) const RUNGS: &[Rung] = &[
    Rung::new("initial", "cap=0,neighbours=0", Moving::Still),
    Rung::new("spatial, constant", "cap=0,mis=constant", Moving::Still),
    Rung::new("spatial, inverse-count", "cap=0,mis=inverse-count", Moving::Still),
    Rung::new("spatial, contribution", "cap=0,mis=contribution", Moving::Still),
    Rung::new("spatial, balance", "cap=0,mis=balance", Moving::Still),
    Rung::new("spatial, pairwise", "cap=0,mis=pairwise", Moving::Still),
    Rung::new("spatial, defensive", "cap=0,mis=defensive", Moving::Still),
    Rung::new("temporal", "neighbours=0", Moving::Still),
    Rung::new("full", "", Moving::Still),
    Rung::new("moving camera", "", Moving::Camera),
    Rung::new("moving light", "", Moving::Light),
    Rung::new("moving occluder", "", Moving::Occluder),
    Rung::new("mutations", "mutations=1", Moving::Still),
    Rung::new("moving, mutations", "mutations=1", Moving::All),
    Rung::new("visibility trace", "visibility=trace", Moving::Still),
    Rung::new("moving, visibility trace", "visibility=trace", Moving::All),
    Rung::new("visibility bitterli", "visibility=bitterli", Moving::Still),
    Rung::new("visibility reuse", "visibility=reuse", Moving::Still),
    Rung::new("visibility wis", "visibility=wis", Moving::Still),
    Rung::new("visibility wis-cv", "visibility=wis-cv", Moving::Still),
    Rung::new("moving, visibility wis-cv", "visibility=wis-cv", Moving::All),
    Rung::new("decoupled", "decoupled=true", Moving::Still),
    Rung::new("two rounds", "rounds=2", Moving::Still),
    Rung::new("every pixel", "mature=0", Moving::Still),
    Rung::new("moving, every pixel", "mature=0", Moving::All),
    Rung::new("own taps", "taps=random,mature=0", Moving::Still),
    Rung::new("shown only", "spatial=display,mature=0", Moving::Still),
    Rung::new("moving, shown only", "spatial=display,mature=0", Moving::All),
];

/// Every policy with and without its companions, every family of MIS weights, every filter.
pub(super) fn variants() -> Vec<String> {
    let mut all = Vec::new();
    for policy in Visibility::ALL.map(Visibility::name) {
        all.push(format!("visibility={policy}"));
        all.push(format!("visibility={policy},neighbours=0"));
        all.push(format!("visibility={policy},mutations=2,rounds=3"));
        if policy != Visibility::Wis.name() {
            all.push(format!("visibility={policy},decoupled=true"));
        }
    }
    for family in Family::ALL.map(Family::name) {
        all.push(format!("mis={family},temporal-mis={family},neighbours=3"));
    }
    all.push("cap=0".to_string());
    all.push("taps=xor,neighbours=3".to_string());
    all.push("taps=pairs,neighbours=3,mature=0".to_string());
    all.push("spatial=display,rounds=2".to_string());
    all.push("taps=random,mature=4".to_string());
    all.push("visibility=reuse,boiling=0.2,max-age=60".to_string());
    all.push("tiles=on,boiling=0.5".to_string());
    all
}
