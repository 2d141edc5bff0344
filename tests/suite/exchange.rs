//! Shifts made once for both pixels of a pair.

use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::scene::Scene;
use afterimage::techniques::{Technique, parse};
use glam::Vec3;

use crate::support::{bits, look_at, own_scenes, shot};
use crate::union::{self, frames};

/// Which pixels take from which, and from which history, does not depend on any sample: with lamps
/// of other strengths and colours, other numbers of candidates and of walks, as many merges are
/// made and as many refused. (The control, a camera that stands elsewhere, counts others.)
#[test]
fn merges_do_not_know_the_samples() {
    let mut dim = union::scene();
    for shape in dim.objects.iter_mut().flat_map(|object| &mut Arc::make_mut(object).shapes) {
        if let Some(emission) = &mut shape.emission {
            emission.scale *= 0.01;
        }
    }
    let shot = shot([25, 16], 5, 2);
    for keys in ["", "taps=pairs,neighbours=3", "taps=random,mature=0,max-age=2", "boiling=0.5"] {
        let keys = format!("{keys},radius=3").trim_start_matches(',').to_string();
        for (name, other) in [("restir-pt", "trees=3,candidates=2"), ("restir-di", "candidates=2")]
        {
            let merges = |scene: &Scene, from: f32, more: &str| -> Vec<[u64; 3]> {
                let comma = if more.is_empty() { "" } else { "," };
                let spec = format!("{name}:{keys}{comma}{more}");
                let stage = Stage::moving(scene.clone()).unwrap();
                let technique = Arc::from(parse(&spec).unwrap());
                let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
                let counted = (0..4).map(|frame| {
                    let mut now = scene.clone();
                    let x = from + 0.05 * frame as f32;
                    now.camera = look_at(Vec3::new(x, 1.2, -3.0), Vec3::new(x, 0.7, 0.0), 0.8);
                    let counters = frames.render_scene(now).unwrap().counters;
                    [counters.temporal_merges, counters.spatial_merges, counters.reuse_rejected]
                });
                counted.collect()
            };
            let plain = merges(&union::scene(), 0.0, "");
            assert!(plain[3].iter().all(|count| *count > 0), "{plain:?}");
            assert_eq!(merges(&dim, 0.0, ""), plain, "{name}:{keys}");
            assert_eq!(merges(&union::scene(), 0.0, other), plain, "{name}:{keys}");
            assert_ne!(merges(&union::scene(), 0.3, ""), plain);
        }
    }
}

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

/// `duplicates` makes pixels nearby carry the same path less often, as the layer of what reservoirs
/// keep counts them: in a room whose light few paths find.
#[test]
fn duplicates_grow_rare_where_history_counts_less() {
    let scene = own_scenes().into_iter().find(|(name, _)| name == "slit").unwrap().1;
    let stage = Stage::new(scene).unwrap();
    let shot = shot([48, 27], 6, 1);
    let shared = |keys: &str| -> f32 {
        let technique = parse(&format!("restir-pt:cap=50,neighbours=3,radius=3{keys}"));
        let technique: Arc<dyn Technique> = Arc::from(technique.unwrap());
        let mut frames = FrameLoop::new(Arc::clone(&technique), &stage, shot).unwrap();
        let plan = frames.plan().clone();
        for _ in 0..20 {
            frames.render().unwrap();
        }
        let frame = frames.render().unwrap();
        let layers = technique.layers(&plan, shot.size, &|name| frame.buffer(name));
        let found = layers.iter().find(|(name, _)| *name == "duplicates").unwrap();
        found.1.iter().sum::<f32>() / found.1.len() as f32
    };
    let [off, half, full] = ["", ",duplicates=0.5", ",duplicates=1"].map(shared);
    println!("shares {off}, {half}, {full}");
    assert!(full < 0.9 * off && half < off, "{off}, {half}, {full}");
}
