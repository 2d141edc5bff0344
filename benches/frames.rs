//! One steady frame of every technique, 128 × 128 pixels: `frames/SCENE/TECHNIQUE`, in pixels a second.

use std::path::Path;
use std::sync::Arc;

use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::scene::load;
use afterimage::techniques::{REGISTRY, parse};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const SIZE: [u32; 2] = [128, 128];

fn frames(criterion: &mut Criterion) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for scene in ["cornell", "many_lights", "plates", "glass"] {
        let path = root.join("scenes").join(scene).with_extension("pbrt");
        let stage =
            Stage::new(load::load(&path).expect("our own scene loads").scene).expect("and builds");
        let mut group = criterion.benchmark_group(format!("frames/{scene}"));
        group.throughput(Throughput::Elements(u64::from(SIZE[0] * SIZE[1]))).sample_size(20);
        for entry in REGISTRY {
            let technique = Arc::from(parse(entry.name).expect("a registered name"));
            let depth = stage.facts().depth.min(8);
            let shot =
                Shot { size: SIZE, depth, filter: Filter::Point, run: 1, effort: 1, fps: 30 };
            let mut frames = FrameLoop::new(technique, &stage, shot).expect("a valid shot");
            let first = frames.render().expect("a frame");
            assert_eq!((first.counters.non_finite, first.picture().non_finite()), (0, 0));
            group.bench_function(entry.name, |bencher| {
                bencher.iter(|| frames.render().expect("a frame").counters);
            });
        }
        group.finish();
    }
}

criterion_group!(benches, frames);
criterion_main!(benches);
