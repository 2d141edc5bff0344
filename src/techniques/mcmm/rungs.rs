//! How `mcmm` is tested part by part, and the combinations of parameters that tests run through.

use crate::techniques::{Moving, Rung};

/// Each estimator with light sampling and without, still and moving.
pub(super) const RUNGS: &[Rung] = &[
    Rung::new("ssmis, 32", "", Moving::Still),
    Rung::new("ssmis, 8", "set=8", Moving::Still),
    Rung::new("tsmis, 8", "estimator=tsmis,set=8", Moving::Still),
    Rung::new("mixture, 16", "estimator=mixture", Moving::Still),
    Rung::new("ssmis, 32, no light", "light=0", Moving::Still),
    Rung::new("ssmis, 8, no light", "set=8,light=0", Moving::Still),
    Rung::new("tsmis, 8, no light", "estimator=tsmis,set=8,light=0", Moving::Still),
    Rung::new("mixture, 16, no light", "estimator=mixture,light=0", Moving::Still),
    Rung::new("preset paper", "preset=paper", Moving::Still),
    Rung::new("preset falcor", "preset=falcor", Moving::Still),
    Rung::new("moving, ssmis, 32", "", Moving::All),
    Rung::new("moving, ssmis, 8", "set=8", Moving::All),
    Rung::new("moving, tsmis, 8", "estimator=tsmis,set=8", Moving::All),
    Rung::new("moving, mixture, 16", "estimator=mixture", Moving::All),
    Rung::new("moving, ssmis, 32, no light", "light=0", Moving::All),
    Rung::new("moving, ssmis, 8, no light", "set=8,light=0", Moving::All),
    Rung::new("moving, tsmis, 8, no light", "estimator=tsmis,set=8,light=0", Moving::All),
    Rung::new("moving, mixture, 16, no light", "estimator=mixture,light=0", Moving::All),
];

/// Every estimator, every way to choose lobes.
pub(super) fn variants() -> Vec<String> {
    [
        "set=8",
        "set=7,window=2",
        "set=1,light=0.5",
        "estimator=tsmis,set=8",
        "estimator=tsmis,n=3,set=5,score=branch",
        "estimator=mixture,k=5",
        "estimator=mixture,k=16,score=branch,carry=0",
        "preset=paper,light=0.25",
        "preset=falcor,light=0.25",
        "large=1",
        "reads=0,carry=1",
        "light=0.5,prior=0,cap=3,alpha=1",
        "paths=caustics",
        "paths=all",
        "paths=all,estimator=tsmis,set=8,light=0.5",
    ]
    .map(String::from)
    .to_vec()
}
