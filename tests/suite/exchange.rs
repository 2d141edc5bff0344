//! Shifts made once for both pixels of a pair.

use crate::support::{bits, shot};
use crate::union::frames;

/// Where shifts are made once for both pixels, the pictures of all frames are those of merges that
/// make their own, to the bit: for every family, still and moving, with several partners, rounds
/// and chains, partners that only one of both accepts (`xor`) and pairs. Each frame is made of the
/// records of the one before. With another number of partners it is not so.
#[test]
fn paired_is_unpaired() {
    let families = ["constant", "inverse-count", "contribution", "balance", "pairwise"];
    let families = families.map(|family| format!("neighbours=3,mature=0,taps=pairs,mis={family}"));
    let others = [
        "taps=pairs",
        "mature=2",
        "mature=2,taps=pairs,neighbours=2",
        "mature=0,neighbours=4,shade=selected,direct=tree",
        "mature=0,neighbours=2,taps=pairs,rounds=2,shade=decoupled",
        "mature=0,taps=pairs,radius=3,spatial=display,rounds=2,cap=3",
        "mature=0,shift=replay,taps=pairs,predicate=footprint,mis=balance",
    ];
    for moving in [false, true] {
        for keys in families.iter().map(String::as_str).chain(others) {
            for shot in [shot([25, 16], 5, 1), shot([12, 16], 4, 2)] {
                let of = |more: &str| frames(&format!("restir-pt:{keys}{more}"), shot, moving);
                let (shared, own) = (of(""), of(",shared=false"));
                for (frame, (shared, own)) in shared.iter().zip(&own).enumerate() {
                    assert!(own.mean_luminance() > 0.0);
                    let (shared, own) = (bits(shared), bits(own));
                    let differ = shared.iter().zip(&own).filter(|(a, b)| **a != **b).count();
                    assert_eq!(differ, 0, "pixels of frame {frame}, moving {moving}, `{keys}`");
                }
            }
        }
        let alone = frames("restir-pt:neighbours=0", shot([25, 16], 5, 1), moving);
        let paired = frames("restir-pt:taps=pairs", shot([25, 16], 5, 1), moving);
        assert_ne!(bits(&alone[0]), bits(&paired[0]));
    }
}
