use afterimage::frame::{FrameLoop, Stage};
use afterimage::plan::{Filter, Shot};
use afterimage::techniques;
use std::sync::Arc;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let scene = if a[1].contains(':') {
        afterimage::scene::generate(&a[1]).unwrap()
    } else {
        afterimage::scene::load::load(std::path::Path::new(&a[1])).unwrap().scene
    };
    let stage = Stage::new(scene).unwrap();
    let size: u32 = a.get(3).map_or(96, |s| s.parse().unwrap());
    let frames_n: u32 = a.get(4).map_or(5, |s| s.parse().unwrap());
    let shot = Shot {
        size: [size, size * 3 / 4],
        depth: 2,
        filter: Filter::Point,
        run: 1,
        effort: 1,
        fps: 30,
    };
    let mut frames =
        FrameLoop::new(Arc::from(techniques::parse(&a[2]).unwrap()), &stage, shot).unwrap();
    let mut times: std::collections::BTreeMap<&str, Vec<f64>> = Default::default();
    let mut last = None;
    for i in 0..frames_n {
        let f = frames.render().unwrap();
        if i > 0 {
            for (n, ms) in f.passes {
                times.entry(n).or_default().push(*ms);
            }
            times.entry("~total").or_default().push(f.milliseconds());
        }
        last = Some(f.counters);
    }
    let px = f64::from(shot.size[0] * shot.size[1]);
    for (n, c) in last.unwrap().entries() {
        if c > 0 {
            println!("{n:20} {:.3}", c as f64 / px);
        }
    }
    for (n, mut t) in times {
        t.sort_by(f64::total_cmp);
        println!("{n:20} {:.3} ms  {:.1} ns/px", t[t.len() / 2], t[t.len() / 2] * 1e6 / px);
    }
}
