//! The same frames on both backends: pass by pass from the same bytes, whole sequences by paired
//! tests, skips by counters.

use std::sync::Arc;

use glam::{Quat, Vec3};

use super::*;
use crate::gpu::Gpu;
use crate::math::rng::Purpose;
use crate::pass::Band;
use crate::plan::{BufferId, Builder, Domain, Filter, Grid, NewPass};
use crate::scene::{
    Color, ConductorColor, Curve, Interpolation, Material, Roughness, Track, Transform,
};
use crate::stats::{Margin, Moments, Verdict, equivalence, t_test};
use crate::techniques::{REGISTRY, parse};

fn device() -> Option<Arc<Gpu>> {
    crate::gpu::tests::device()
}

fn shot(size: [u32; 2], depth: u32) -> Shot {
    Shot { size, depth, filter: Filter::Point, run: 7, effort: 1.0, fps: 30 }
}

fn stage(name: &str) -> Stage {
    let scene = crate::scene::generate(name).unwrap();
    Stage::new(scene).unwrap()
}

/// Two shapes of lights, spheres, a mirror; nothing moves.
fn still() -> Stage {
    stage("many-lights:60")
}

/// The same with many lights, so that tiles are made.
fn many() -> Stage {
    stage("many-lights:1500")
}

/// Scenes whose camera, lights and geometry move and grow are made of a still one, instance by
/// instance. Surfaces look different from every side, and lamps shine to both.
fn moving() -> Stage {
    let mut scene = crate::scene::generate("many-lights:60").unwrap();
    let color = ConductorColor::Reflectance(Color::Constant(Vec3::new(0.9, 0.7, 0.5)));
    for material in &mut scene.materials {
        if matches!(material, Material::Diffuse { .. }) {
            *material = Material::Conductor { color, roughness: Roughness::isotropic(0.3) };
        }
    }
    for shape in scene.objects.iter_mut().flat_map(|object| &mut Arc::make_mut(object).shapes) {
        if let Some(emission) = &mut shape.emission {
            emission.two_sided = true;
        }
    }
    let along = |from: Vec3, to: Vec3| Curve {
        keys: vec![(0.0, from), (1.0, to)],
        interpolation: Interpolation::Linear,
    };
    let moved = |transform: &Transform, by: Vec3, growth: f32, turn: f32| {
        let rotation = Curve {
            keys: vec![(0.0, Quat::IDENTITY), (1.0, Quat::from_rotation_y(turn))],
            interpolation: Interpolation::Linear,
        };
        let scale = along(Vec3::ONE, Vec3::splat(growth));
        let track = Track::Trs { translation: along(Vec3::ZERO, by), rotation, scale };
        Transform::Chain(vec![track, Track::Fixed(transform.fixed())])
    };
    let size = crate::world::bounds(&scene);
    let step = 0.05 * (size[1] - size[0]).length();
    scene.camera.to_world =
        moved(&scene.camera.to_world, step * Vec3::new(1.0, 0.2, 0.5), 1.0, 0.3);
    let count = scene.instances.len();
    for (at, instance) in scene.instances.iter_mut().enumerate() {
        if at * 3 > count {
            instance.to_world =
                moved(&instance.to_world, step * Vec3::new(0.3, 0.4, -0.2), 1.5, 0.1);
        }
    }
    scene.time = [0.0, 1.0];
    Stage::new(scene).unwrap()
}

/// Words of every buffer after the first `passes` passes of frame `frame`; all frames before it,
/// and all but the last of these passes, ran on the CPU. With `here`, the last one did, too.
fn after(
    gpu: &Arc<Gpu>,
    (stage, spec, shot): (&Stage, &str, Shot),
    (frame, passes, here): (u32, usize, bool),
) -> Vec<Vec<u32>> {
    let backend = Backend::Gpu(gpu.clone());
    let mut frames =
        FrameLoop::with_backend(Arc::from(parse(spec).unwrap()), stage, shot, &backend).unwrap();
    frames.run_on_cpu(usize::MAX);
    for _ in 0..frame {
        frames.render().unwrap();
    }
    frames.run_on_cpu(if here { passes } else { passes - 1 });
    let Runner::Gpu(device) = &mut frames.runner else { panic!("{spec} runs on the CPU") };
    device.stop_after = passes;
    frames.render().unwrap();
    let Runner::Gpu(device) = &frames.runner else { panic!("{spec} runs on the CPU") };
    let buffers = (0..frames.plan.buffers.len()).map(BufferId);
    buffers.map(|id| device.buffer(id).unwrap().clone()).collect()
}

/// Elements of both that differ by more than rounding. Integers are compared as they are, values to
/// 10⁻³: a hundred times the rounding of a sum over a shading point's lobes, a tenth of an error
/// that a picture would show.
fn differing<'a>(
    name: &str,
    here: &'a [u32],
    there: &'a [u32],
    words: usize,
) -> Vec<[&'a [u32]; 2]> {
    // A pixel has one reservoir and one estimate a chain.
    let words = match name {
        "reservoirs" | "history" | "bounce" | "second bounce" => 6,
        "controls" | "bounce controls" | "history controls" => 2,
        _ => words,
    };
    let elements = here.chunks(words).zip(there.chunks(words));
    elements.filter(|(a, b)| !same_element(name, a, b)).map(|(a, b)| [a, b]).collect()
}

fn same_element(name: &str, a: &[u32], b: &[u32]) -> bool {
    let close = |a: u32, b: u32, relative: f32| {
        let (a, b) = (f32::from_bits(a), f32::from_bits(b));
        a == b || (a - b).abs() <= relative * a.abs().max(b.abs()).max(1e-6)
    };
    // Places on a primitive lie in [0, 1]: the rounding of their numerators does not shrink with
    // them.
    let near = |a: u32, b: u32, error: f32| (f32::from_bits(a) - f32::from_bits(b)).abs() <= error;
    match name {
        // Distance and place; which primitive of which instance.
        "hits" => {
            a[3..] == b[3..]
                && close(a[0], b[0], 1e-4)
                && (a[3] == u32::MAX || (near(a[1], b[1], 1e-3) && near(a[2], b[2], 1e-3)))
        }
        // Light, place on it, W, target, confidence and age and visibility.
        "reservoirs" | "history" | "bounce" | "second bounce" => {
            let kept = |w: u32| w >> 16;
            a[0] == b[0]
                && (1..3).all(|k| near(a[k], b[k], 1e-4))
                && (3..5).all(|k| close(a[k], b[k], 1e-3))
                && a[5] & 0xFFFF == b[5] & 0xFFFF
                && kept(a[5]).abs_diff(kept(b[5])) <= 2
        }
        "normals" => (0..2).all(|k| {
            let part = |w: u32| (w >> (16 * k)) as u16 as i16;
            part(a[0]).abs_diff(part(b[0])) <= 2
        }),
        // Signed sums, whose terms may cancel: with 10⁻³ instead, 3 of 3,072 differ. Terms are of
        // order 1 in these scenes; where they cancel to nothing, f32 leaves up to 2⁻²⁴ of them.
        "controls" | "bounce controls" | "history controls" => {
            let words = |w: &[u32]| -> crate::reuse::Control { bytemuck::cast([w[0], w[1]]) };
            let (a, b) = (words(a), words(b));
            let scale = a.estimate().abs().max_element().max(b.estimate().abs().max_element());
            let rounding = 0.5 * f32::EPSILON;
            a.visible() == b.visible()
                && (a.estimate() - b.estimate()).abs().max_element() <= 2e-3 * scale + rounding
        }
        "light tiles" => {
            a[9..12] == b[9..12] && (0..9).chain(12..15).all(|k| close(a[k], b[k], 1e-3))
        }
        // Colours.
        _ => a.iter().zip(b).all(|(a, b)| close(*a, *b, 1e-3)),
    }
}

/// Each pass of a frame from the same bytes: at most one element in 10⁴ (and two in all, a chain)
/// decides otherwise by rounding.
fn passes_agree(gpu: &Arc<Gpu>, stage: &Stage, spec: &str, shot: Shot) {
    let technique = parse(spec).unwrap();
    let plan = technique.plan(stage.facts(), &shot);
    for frame in [0, 2] {
        let mut count = 0;
        for pass in &plan.passes {
            let runs = match pass.runs {
                Runs::Always => true,
                Runs::Once => frame == 0,
                Runs::WithHistory => frame > 0,
            };
            if !runs {
                continue;
            }
            count += 1;
            let how = (stage, spec, shot);
            let here = after(gpu, how, (frame, count, true));
            let there = after(gpu, how, (frame, count, false));
            for id in &pass.writes {
                let buffer = &plan.buffers[id.0];
                let words = buffer.bytes as usize / 4;
                let elements = here[id.0].len() / words;
                let flips = differing(buffer.name, &here[id.0], &there[id.0], words);
                assert!(
                    flips.len() <= shot.effort as usize * 2.max(elements / 10_000),
                    "{spec}, frame {frame}, pass `{}`: {} of {elements} elements of `{}` differ, here and there {:x?}",
                    pass.name,
                    flips.len(),
                    buffer.name,
                    &flips[..8.min(flips.len())]
                );
            }
        }
    }
}

const POLICIES: [&str; 6] = [
    "restir-di",
    "restir-di:visibility=trace,neighbours=2",
    "restir-di:visibility=bitterli",
    "restir-di:visibility=reuse,mutations=2",
    "restir-di:visibility=wis,mis=constant",
    "restir-di:visibility=wis-cv,mutations=1",
];

#[test]
fn every_pass_gives_the_same_from_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let still = still();
    for spec in POLICIES {
        passes_agree(&gpu, &still, spec, shot([64, 48], 2));
    }
    // Two have no twins yet.
    let without = ["restir-pt", "mcmm"];
    let twins = REGISTRY.iter().map(|entry| entry.name).filter(|name| !without.contains(name));
    for spec in twins.chain([
        "nee:lights=all",
        "restir-di:neighbours=0",
        "restir-di:visibility=wis-cv,neighbours=0",
        "restir-di:rounds=3,mis=balance,neighbours=2",
        "restir-di:mis=inverse-count,temporal-mis=contribution",
        "restir-di:mis=contribution,neighbours=3,temporal-mis=inverse-count",
        "restir-di:mis=pairwise,decoupled=true,visibility=reuse",
        "restir-di:visibility=reuse,boiling=0.2,max-age=60,decoupled=true",
    ]) {
        passes_agree(&gpu, &still, spec, shot([64, 48], 3));
    }
    let many = many();
    for spec in ["ris", "restir-di"] {
        passes_agree(&gpu, &many, spec, shot([64, 48], 2));
    }
}

/// The same of what few plans have: several chains of a pixel, efforts with a fraction, taps of
/// each pixel's own, spatial results that are not kept.
#[test]
fn every_pass_of_less_common_plans_gives_the_same_from_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let still = still();
    let chains = Shot { effort: 2.0, ..shot([64, 48], 2) };
    for spec in ["restir-di:neighbours=0,boiling=0.3", "restir-di:visibility=wis-cv,mutations=1"] {
        passes_agree(&gpu, &still, spec, chains);
    }
    for spec in ["nee", "ris"] {
        passes_agree(&gpu, &still, spec, Shot { effort: 1.4, ..shot([64, 48], 3) });
    }
    passes_agree(&gpu, &still, "restir-di:taps=random,neighbours=2,mature=1", shot([64, 48], 2));
    let display = "restir-di:spatial=display,rounds=3,visibility=wis-cv";
    passes_agree(&gpu, &still, display, shot([64, 48], 2));
    passes_agree(&gpu, &moving(), "restir-di:spatial=display", chains);
    // In frame 2, what the first frame chose is too old.
    passes_agree(&gpu, &still, "restir-di:max-age=1", shot([64, 48], 2));
}

/// Writes to each pixel the sum of the pixels' numbers in its tile, and how many of its lanes lie
/// outside of the picture. The grid begins elsewhere in each frame.
#[derive(Debug)]
struct TileSums([u32; 2]);

impl Technique for TileSums {
    fn spec(&self) -> String {
        "tile-sums".into()
    }
    fn validate(&self) -> Result<()> {
        Ok(())
    }
    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut plan = Builder::new(self.spec(), facts, shot);
        let ([width, height], grid) = (self.0, Grid::PerFrame(Purpose::TileMask));
        let pass = NewPass::pixels("sums", 0, vec![Plan::RADIANCE]);
        plan.pass(NewPass { domain: Domain::Tiles { width, height, grid }, ..pass });
        plan.finish(crate::plan::Claim::Unbiased)
    }
    fn run(&self, _: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        let tiles = band.tiles(inputs.shot.size);
        let first = band.range.start * band.width;
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        for tile in tiles {
            let pixels: Vec<_> = (0..tile.lanes()).filter_map(|lane| tile.pixel(lane)).collect();
            let sum: u32 = pixels.iter().map(|pixel| pixel.index).sum();
            let outside = tile.lanes() - pixels.len() as u32;
            for pixel in pixels {
                let shown = [sum as f32, outside as f32, tile.lanes() as f32];
                radiance[(pixel.index - first) as usize] = shown;
            }
        }
        Counters { paths: 1, ..Counters::default() }
    }
    fn twin(&self, _: u32, _: &Plan) -> Option<crate::twin::Twin> {
        const TEXT: &str = "
            var<workgroup> sum: atomic<u32>;
            var<workgroup> outside: atomic<u32>;
            fn tile_sums(pixel: u32, x: u32, y: u32, lane: u32, inside: bool) {
                if inside { atomicAdd(&sum, y * inputs.size.x + x); } else { atomicAdd(&outside, 1u); }
                workgroupBarrier();
                if inside {
                    let shown = vec3f(f32(atomicLoad(&sum)), f32(atomicLoad(&outside)), f32(TILE_WIDTH * TILE_HEIGHT));
                    write_vector(buffer_now(RADIANCE) + pixel * 3u, shown);
                }
            }";
        let modules = vec![crate::twin::Module { name: "tile_sums.wgsl", text: TEXT }];
        Some(crate::twin::Twin { kernel: "tile_sums", modules, ..Default::default() })
    }
}

/// Grids of tiles begin at the same place on both backends in every frame, and all lanes of a tile
/// run.
#[test]
fn tiles_are_the_same_wherever_their_grid_begins() {
    let Some(gpu) = device() else { return };
    let still = still();
    for (tile, size) in [([5, 3], [17, 23]), ([16, 16], [40, 30]), ([8, 4], [9, 7])] {
        let start = |backend: &Backend| {
            let technique = Arc::new(TileSums(tile));
            FrameLoop::with_backend(technique, &still, shot(size, 2), backend).unwrap()
        };
        let (mut here, mut there) = (start(&Backend::Cpu), start(&Backend::Gpu(gpu.clone())));
        let mut seen = std::collections::HashSet::new();
        for frame in 0..12 {
            let a = here.render().unwrap().picture().pixels;
            let b = there.render().unwrap().picture().pixels;
            assert!(a == b, "tiles of {tile:?} in {size:?}, frame {frame}");
            seen.insert(a[0].to_array().map(f32::to_bits));
        }
        assert!(seen.len() > 4, "the grid moves: {}", seen.len());
    }
    let backend = Backend::Gpu(gpu);
    let large = Arc::new(TileSums([32, 32]));
    let error = FrameLoop::with_backend(large, &still, shot([64, 64], 2), &backend).unwrap_err();
    assert!(error.is_gpu() && error.to_string().contains("at most 256 pixels a tile"), "{error}");
}

#[test]
fn every_pass_of_moving_scenes_gives_the_same_from_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let moving = moving();
    for spec in ["nee", "restir-di", "restir-di:visibility=wis-cv", "restir-di:visibility=wis"] {
        passes_agree(&gpu, &moving, spec, shot([64, 48], 2));
    }
    let boxed = Shot { filter: Filter::Box, ..shot([64, 48], 2) };
    passes_agree(&gpu, &still(), "restir-di", boxed);
    passes_agree(&gpu, &still(), "nee", boxed);
}

/// Differences of mean luminance, GPU − CPU with equal seeds, over restarts, as shares of the mean:
/// two one-sided t tests place their mean within 0.5 % (α = 10⁻³). Rare decisions by rounding skew
/// them, so Student's law is not exact; but no single difference may leave the margin either.
fn assert_equivalent(
    gpu: &Arc<Gpu>,
    (stage, spec, shot): (&Stage, &str, Shot),
    (frames, restarts): (u32, u32),
) {
    const DELTA: f64 = 0.005;
    let start = |backend: &Backend| {
        FrameLoop::with_backend(Arc::from(parse(spec).unwrap()), stage, shot, backend).unwrap()
    };
    let mut loops = [start(&Backend::Cpu), start(&Backend::Gpu(gpu.clone()))];
    let mut pairs = Vec::new();
    for restart in 0..restarts {
        pairs.push(loops.each_mut().map(|frames_of| {
            frames_of.restart(u64::from(restart) + 100);
            let mut shown = 0.0;
            for _ in 0..frames {
                let frame = frames_of.render().unwrap();
                assert_eq!(frame.counters.non_finite + frame.counters.weights_rejected, 0);
                shown = frame.picture().mean_luminance();
            }
            shown
        }));
    }
    let mean = pairs.iter().map(|[here, _]| here).sum::<f64>() / f64::from(restarts);
    assert!(mean > 0.0, "{spec}: black");
    let mut differences = Moments::default();
    let mut worst = 0.0_f64;
    for [here, there] in pairs {
        let difference = (there - here) / mean;
        differences.push(difference);
        worst = worst.max(difference.abs());
    }
    let (low, high) = t_test(&differences, 0.0).interval(1.0 - 2e-3);
    eprintln!(
        "{spec}: GPU - CPU in {:+.5} to {:+.5} %, worst {:.5} %",
        100.0 * low,
        100.0 * high,
        100.0 * worst
    );
    assert!(
        low > -DELTA && high < DELTA && worst < DELTA,
        "{spec}: {low} to {high}, worst {worst}"
    );
}

#[test]
fn sequences_are_equivalent() {
    let Some(gpu) = device() else { return };
    let (still, moving) = (still(), moving());
    for spec in ["nee", "ris"].into_iter().chain(POLICIES) {
        assert_equivalent(&gpu, (&still, spec, shot([40, 30], 2)), (4, 12));
    }
    for spec in ["restir-di", "restir-di:visibility=wis-cv"] {
        assert_equivalent(&gpu, (&moving, spec, shot([40, 30], 2)), (4, 12));
    }
}

/// The control: a kernel that adds 1 % is found, by the pairs and by the pass.
#[test]
fn a_small_difference_in_a_kernel_is_found() {
    let Some(gpu) = device() else { return };
    let still = still();
    let shot = shot([40, 30], 2);
    let technique: Arc<dyn Technique> = Arc::new(Brighter(parse("nee").unwrap()));
    let mut here = FrameLoop::new(technique.clone(), &still, shot).unwrap();
    let mut there = FrameLoop::with_backend(technique, &still, shot, &Backend::Gpu(gpu)).unwrap();
    let (mut differences, mut mean) = (Moments::default(), 0.0);
    for run in 0..12 {
        here.restart(run);
        there.restart(run);
        let a = here.render().unwrap().picture().mean_luminance();
        let b = there.render().unwrap().picture().mean_luminance();
        differences.push(b - a);
        mean += a / 12.0;
    }
    let margin = Margin { delta: 0.005 * mean, equivalence_alpha: 1e-3, difference_alpha: 1e-3 };
    assert_eq!(equivalence(&t_test(&differences, 0.0), &margin).verdict, Verdict::Fail);
}

/// `nee`, whose twin is 1 % too bright.
#[derive(Debug)]
struct Brighter(Box<dyn Technique>);

impl Technique for Brighter {
    fn spec(&self) -> String {
        "brighter".into()
    }
    fn validate(&self) -> Result<()> {
        Ok(())
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        self.0.plan(facts, shot)
    }
    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        self.0.run(kernel, inputs, band)
    }
    fn twin(&self, kernel: u32, plan: &Plan) -> Option<crate::twin::Twin> {
        let mut twin = self.0.twin(kernel, plan)?;
        let text = twin.modules[0].text.replace("sum * mean", "sum * mean * 1.01");
        twin.modules[0].text = Box::leak(text.into_boxed_str());
        Some(twin)
    }
}

/// A technique without a twin runs on the CPU, and says so.
#[test]
fn a_technique_without_a_twin_runs_on_the_cpu() {
    #[derive(Debug)]
    struct Plain(Box<dyn Technique>);
    impl Technique for Plain {
        fn spec(&self) -> String {
            "plain".into()
        }
        fn validate(&self) -> Result<()> {
            Ok(())
        }

        fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
            self.0.plan(facts, shot)
        }
        fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
            self.0.run(kernel, inputs, band)
        }
    }
    let Some(gpu) = device() else { return };
    let still = still();
    let backend = Backend::Gpu(gpu.clone());
    let start = |technique: Arc<dyn Technique>| {
        FrameLoop::with_backend(technique, &still, shot([16, 16], 2), &backend).unwrap()
    };
    let mut plain = start(Arc::new(Plain(parse("nee").unwrap())));
    assert_eq!(plain.runs_on(), None);
    assert!(plain.render().unwrap().picture().mean_luminance() > 0.0);
    let twin = start(Arc::from(parse("nee").unwrap()));
    assert_eq!(twin.runs_on(), Some(gpu.info().to_string()));
    assert!(twin.scene_bytes() > 0);
}

/// Counters of both backends are equal but for rays that rounding decides, and what the plan leaves
/// out is 0 on both.
#[test]
fn skips_are_the_same_on_both_backends() {
    let Some(gpu) = device() else { return };
    let still = still();
    for spec in ["nee", "ris", "restir-di", "restir-di:visibility=trace", "restir-di:cap=0"] {
        let backend = Backend::Gpu(gpu.clone());
        let start = |backend: &Backend| {
            FrameLoop::with_backend(
                Arc::from(parse(spec).unwrap()),
                &still,
                shot([48, 32], 2),
                backend,
            )
            .unwrap()
        };
        let (mut here, mut there) = (start(&Backend::Cpu), start(&backend));
        for frame in 0..3 {
            let a = here.render().unwrap();
            let (a, a_passes) = (a.counters, a.passes.len());
            let b = there.render().unwrap();
            assert_eq!(a_passes, b.passes.len(), "{spec}: dispatches are the plan's passes");
            for ((name, a), (_, b)) in a.entries().into_iter().zip(b.counters.entries()) {
                let apart = a.abs_diff(b);
                assert!(
                    apart <= 4 + a / 5_000,
                    "{spec}, frame {frame}: {name} is {a} here, {b} there"
                );
                assert!((a == 0) == (b == 0) || apart <= 4, "{spec}: {name} {a} {b}");
            }
            if frame > 0 {
                assert_eq!(b.counters.primary_rays, 0, "nothing moves");
            }
        }
    }
}

/// A run may take its first passes from the CPU; the picture is the same to rounding whatever their
/// number.
#[test]
fn a_disagreement_can_be_bisected() {
    let Some(gpu) = device() else { return };
    let still = still();
    let mut pictures = Vec::new();
    for passes in 0..=4 {
        let backend = Backend::Gpu(gpu.clone());
        let technique = Arc::from(parse("restir-di").unwrap());
        let mut frames =
            FrameLoop::with_backend(technique, &still, shot([32, 24], 2), &backend).unwrap();
        frames.run_on_cpu(passes);
        for _ in 0..3 {
            frames.render().unwrap();
        }
        pictures.push(frames.render().unwrap().picture().mean_luminance());
    }
    assert!(pictures[0] > 0.0);
    for picture in &pictures {
        assert!((picture / pictures[0] - 1.0).abs() < 1e-3, "{pictures:?}");
    }
}

/// A host moves its own scene: lights come and go, and both backends follow.
#[test]
fn hosts_move_scenes_on_both_backends() {
    let Some(gpu) = device() else { return };
    let scene = crate::scene::generate("many-lights:40").unwrap();
    let stage = Stage::moving(scene.clone()).unwrap();
    let start = |backend: &Backend| {
        let technique = Arc::from(parse("restir-di").unwrap());
        FrameLoop::with_backend(technique, &stage, shot([48, 32], 2), backend).unwrap()
    };
    let (mut here, mut there) = (start(&Backend::Cpu), start(&Backend::Gpu(gpu)));
    for step in 0..4_u32 {
        let mut now = scene.clone();
        // An instance goes, and comes back; one more is placed.
        if step == 1 {
            now.instances.remove(now.instances.len() - 3);
        }
        if step == 3 {
            for extra in 0..40 {
                let last = now.instances[now.instances.len() - 1].clone();
                let by = glam::Affine3A::from_translation(Vec3::Y * 0.1 * (extra + 1) as f32);
                let place = Transform::Fixed(by * last.to_world.fixed());
                now.add_instance(last.object, place, 10_000 + extra);
            }
        }
        let a = here.render_scene(now.clone()).unwrap().picture();
        let b = there.render_scene(now).unwrap().picture();
        let (a, b) = (a.mean_luminance(), b.mean_luminance());
        assert!(a > 0.0 && (b / a - 1.0).abs() < 2e-3, "frame {step}: {a} here, {b} there");
    }
}

/// Loops on one stage share its arenas, whatever each of them asks for: one that needs no emitters'
/// tree leaves none out for others.
#[test]
fn loops_that_need_more_of_a_shared_scene_get_it() {
    let Some(gpu) = device() else { return };
    let still = still();
    let backend = Backend::Gpu(gpu);
    let start = |spec: &str, backend: &Backend| {
        let technique = Arc::from(parse(spec).unwrap());
        FrameLoop::with_backend(technique, &still, shot([40, 30], 2), backend).unwrap()
    };
    let mut first = start("nee", &backend);
    first.render().unwrap();
    let (mut here, mut there) = (start("ris", &Backend::Cpu), start("ris", &backend));
    let (a, b) = (here.render().unwrap(), there.render().unwrap());
    assert!(a.counters.emitter_rays > 0 && a.counters.emitter_rays == b.counters.emitter_rays);
    assert!((b.picture().mean_luminance() / a.picture().mean_luminance() - 1.0).abs() < 1e-3);
    drop(first);
}

/// A host's first scene need not be the stage's; lights, materials and skies that go come back;
/// restarts show what they should. A scene that is refused leaves the loop where it was.
#[test]
fn hosts_scenes_come_and_go_on_both_backends() {
    use crate::scene::{Color, Light, LightKind, Material, Texture, TextureKind};
    let Some(gpu) = device() else { return };
    let mut scene = crate::scene::generate("many-lights:20").unwrap();
    let sky = LightKind::Environment { radiance: Vec3::splat(2.0), image: None };
    let sky = Light { to_world: Transform::IDENTITY, kind: sky, key: 77 };
    scene.lights.push(sky);
    let stage = Stage::moving(scene.clone()).unwrap();
    let start = |backend: &Backend| {
        let technique = Arc::from(parse("restir-di").unwrap());
        FrameLoop::with_backend(technique, &stage, shot([40, 30], 2), backend).unwrap()
    };
    let (mut here, mut there) = (start(&Backend::Cpu), start(&Backend::Gpu(gpu)));
    let night = Scene { lights: Vec::new(), ..scene.clone() };
    let mut red = night.clone();
    red.materials[0] = Material::Diffuse { reflectance: Color::Constant(Vec3::X) };
    let mut fewer = red.clone();
    fewer.instances.drain(2..4);
    // Textures in textures in textures: more than kernels hold.
    let mut deep = scene.clone();
    for number in 0..12 {
        let constant = TextureKind::Constant(glam::Vec4::ONE);
        let first = crate::scene::TextureId(0);
        let second = crate::scene::TextureId(deep.textures.len().max(1) as u32 - 1);
        let kind = if number == 0 { constant } else { TextureKind::Product { first, second } };
        deep.add_texture(Texture { kind, mapping: glam::Affine2::IDENTITY });
    }
    for round in 0..2 {
        for (step, now) in
            [&night, &scene, &red, &deep, &fewer, &scene, &night, &scene].into_iter().enumerate()
        {
            if std::ptr::eq(now, &deep) {
                let error = there.render_scene(now.clone()).unwrap_err();
                assert!(
                    error.is_gpu() && error.to_string().contains("texture 8 holds 9 values"),
                    "{error}"
                );
                continue;
            }
            let a = here.render_scene(now.clone()).unwrap().picture();
            let b = there.render_scene(now.clone()).unwrap().picture();
            let (a, b) = (a.mean_luminance(), b.mean_luminance());
            assert!(
                a > 0.0 && (b / a - 1.0).abs() < 3e-3,
                "round {round}, frame {step}: {a} here, {b} there"
            );
        }
        here.restart(round + 5);
        there.restart(round + 5);
    }
}

/// What the device has not enough of is an error that names it, and the CPU goes on.
#[test]
fn too_large_a_picture_is_refused_by_name() {
    let Some(gpu) = device() else { return };
    let still = still();
    let backend = Backend::Gpu(gpu);
    let huge = shot([40_000, 40_000], 2);
    let technique: Arc<dyn Technique> = Arc::from(parse("restir-di").unwrap());
    let error = FrameLoop::with_backend(technique.clone(), &still, huge, &backend).unwrap_err();
    let text = error.to_string();
    assert!(error.is_gpu() && text.contains("the state"), "{text}");
    let large = shot([8_000, 6_000], 2);
    let error = FrameLoop::with_backend(technique.clone(), &still, large, &backend).unwrap_err();
    let text = error.to_string();
    assert!(
        error.is_gpu() && text.contains("the frame loop's state") && text.contains("at most"),
        "{text}"
    );
    FrameLoop::new(technique, &still, shot([8, 8], 2)).unwrap().render().unwrap();
}

/// A device that is gone gives errors, no panic; another loop on the CPU goes on.
#[test]
fn a_lost_device_is_an_error() {
    if device().is_none() {
        return;
    }
    let own = Gpu::open(None).unwrap();
    let still = still();
    let technique: Arc<dyn Technique> = Arc::from(parse("nee").unwrap());
    let backend = Backend::Gpu(own.clone());
    let mut frames =
        FrameLoop::with_backend(technique.clone(), &still, shot([16, 16], 2), &backend).unwrap();
    frames.render().unwrap();
    own.device().destroy();
    let error = frames.render().unwrap_err();
    assert!(error.is_gpu() && error.to_string().contains(&own.info().name), "{error}");
    assert!(frames.render().is_err(), "it stays lost");
    let again = FrameLoop::with_backend(technique.clone(), &still, shot([16, 16], 2), &backend);
    assert!(again.is_err_and(|error| error.is_gpu()));
    FrameLoop::new(technique, &still, shot([8, 8], 2)).unwrap().render().unwrap();
}

/// Frames under way give what frames one by one do, on both backends; what is asked out of turn is
/// refused.
#[test]
fn frames_may_be_under_way() {
    let Some(gpu) = device() else { return };
    let moving = moving();
    for backend in [Backend::Cpu, Backend::Gpu(gpu)] {
        let start = || {
            let technique = Arc::from(parse("restir-di").unwrap());
            FrameLoop::with_backend(technique, &moving, shot([32, 24], 2), &backend).unwrap()
        };
        let (mut one, mut ahead) = (start(), start());
        assert!(ahead.finish().is_err_and(|e| e.to_string().contains("submit one first")));
        ahead.submit().unwrap();
        ahead.submit().unwrap();
        assert!(ahead.submit().is_err_and(|e| e.to_string().contains("at most 2")));
        assert!(ahead.render().is_err_and(|e| e.to_string().contains("finish them first")));
        for index in 0..5 {
            let wanted = one.render().unwrap();
            let (picture, counters) = (wanted.picture(), wanted.counters);
            let guides = wanted.guides();
            let found = ahead.finish().unwrap();
            assert_eq!((found.index, found.counters), (index, counters));
            assert_eq!(found.picture().pixels, picture.pixels);
            assert_eq!(found.guides().depth, guides.depth);
            ahead.submit().unwrap();
        }
        ahead.restart(3);
        ahead.render().unwrap();
    }
}
