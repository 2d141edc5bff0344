//! Every WGSL function against its Rust twin, on a device; what the modules look like, without one.
//!
//! Where no adapter is, tests of the first kind say so and pass; under `AFTERIMAGE_REQUIRE_GPU=1`
//! they fail instead.

mod functions;
mod modules;
mod scene;

use std::sync::{Arc, OnceLock};

use super::compose::Composed;
use super::{Gpu, Inputs, SceneBuffers, Shader, groups};
use crate::math::rng::{RandomSource, Stream};
use crate::plan::Domain;
use crate::resampling::RESAMPLING_WGSL;
use crate::reuse::{CONTROL_WGSL, STORED_WGSL, WIS_WGSL};
use crate::scene::Scene;
use crate::twin::{Module, Twin};
use crate::world::World;

/// Inputs of a function under test.
const N: usize = 4096;

/// The device of all tests, or `None` with a reason on standard error.
pub(crate) fn device() -> Option<Arc<Gpu>> {
    static DEVICE: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    let opened = DEVICE.get_or_init(|| match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var("AFTERIMAGE_REQUIRE_GPU").is_ok_and(|v| v == "1");
            assert!(!required, "AFTERIMAGE_REQUIRE_GPU=1, but {error}");
            eprintln!("skipped: {error}");
            None
        }
    });
    opened.clone()
}

/// A scene without anything, for functions that need none.
fn empty() -> Arc<World> {
    static WORLD: OnceLock<Arc<World>> = OnceLock::new();
    let world = WORLD.get_or_init(|| {
        Arc::new(World::new(Scene::new("empty"), &Default::default()).expect("nothing is valid"))
    });
    world.clone()
}

/// Runs `fn test(i: u32)`, given as WGSL, for `inputs.len() / width` numbers. It reads `input(i,
/// k)` and calls `output(i, k, word)`, k < `out`.
fn run(
    gpu: &Arc<Gpu>,
    world: &Arc<World>,
    body: &str,
    (inputs, width): (&[u32], usize),
    out: usize,
) -> Vec<u32> {
    run_changed(gpu, world, body, (inputs, width), out, |text| text)
}

/// As [`run`], with a module that is changed first: how bugs are planted.
fn run_changed(
    gpu: &Arc<Gpu>,
    world: &Arc<World>,
    body: &str,
    (inputs, width): (&[u32], usize),
    out: usize,
    change: impl Fn(String) -> String,
) -> Vec<u32> {
    use wgpu::BufferUsages as Usage;
    let count = inputs.len() / width;
    let scene = SceneBuffers::still(gpu, world).unwrap();
    let harness = format!(
        "fn input(i: u32, k: u32) -> u32 {{ return state[i * {width}u + k]; }}
         fn input_float(i: u32, k: u32) -> f32 {{ return bitcast<f32>(input(i, k)); }}
         fn input_vector(i: u32, k: u32) -> vec3f {{
             return vec3f(input_float(i, k), input_float(i, k + 1u), input_float(i, k + 2u));
         }}
         fn output(i: u32, k: u32, word: u32) {{ state[{}u + i * {out}u + k] = word; }}
         fn output_float(i: u32, k: u32, x: f32) {{ output(i, k, bitcast<u32>(x)); }}
         fn output_vector(i: u32, k: u32, v: vec3f) {{
             output_float(i, k, v.x); output_float(i, k + 1u, v.y); output_float(i, k + 2u, v.z);
         }}
         {body}",
        inputs.len()
    );
    let harness = Module { name: "the harness", text: Box::leak(harness.into_boxed_str()) };
    let modules = vec![RESAMPLING_WGSL, STORED_WGSL, WIS_WGSL, CONTROL_WGSL, harness];
    let twin = Twin { kernel: "test", modules, ..Twin::default() };
    let domain = Domain::Items(count as u32);
    let kernel = Shader::new(&twin, domain, scene.constants());
    let composed = kernel.compose().unwrap();
    let composed = Composed { text: change(composed.text.clone()), ..composed };
    let pipeline = gpu.compile("test", &composed, &kernel.constants).unwrap();
    let copied = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
    let bytes = 4 * (inputs.len() + count * out) as u64;
    let state = gpu.buffer("state", bytes, copied).unwrap();
    gpu.queue().write_buffer(&state, 0, bytemuck::cast_slice(inputs));
    let counters = gpu.buffer("counters", 256, copied).unwrap();
    let uniform =
        gpu.buffer("inputs", size_of::<Inputs>() as u64, Usage::UNIFORM | Usage::COPY_DST).unwrap();
    let mut frame = Inputs { size: [64, 64], effort: 1, ..Inputs::default() };
    scene.describe(&mut frame);
    gpu.queue().write_buffer(&uniform, 0, bytemuck::bytes_of(&frame));
    let staging =
        gpu.buffer("staging", 4 * (count * out) as u64, Usage::MAP_READ | Usage::COPY_DST).unwrap();
    let bindings = crate::frame::gpu::bind(gpu, &scene, &uniform, &state, &counters);
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(groups(domain, [64, 64])[0], 1, 1);
    }
    let first = 4 * inputs.len() as u64;
    encoder.copy_buffer_to_buffer(&state, first, &staging, 0, Some(4 * (count * out) as u64));
    gpu.queue().submit([encoder.finish()]);
    let (sender, receiver) = std::sync::mpsc::channel();
    staging.map_async(wgpu::MapMode::Read, .., move |outcome| sender.send(outcome).unwrap());
    gpu.device().poll(wgpu::PollType::wait_indefinitely()).unwrap();
    receiver.recv().unwrap().unwrap();
    gpu.check().unwrap();
    let view = staging.get_mapped_range(..4 * (count * out) as u64).unwrap();
    view.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// Numbers in [0, 1), with both ends and halves among the first.
fn unit(random: &mut Stream, i: usize) -> f32 {
    const EDGES: [f32; 6] = [0.0, 0.5, 1.0 - f32::EPSILON / 2.0, 0.25, 5.960_464_5e-8, 0.75];
    if i % 16 < EDGES.len() { EDGES[i % 16] } else { random.uniform() }
}

/// Words with all bits in play, and edges.
fn word(random: &mut Stream, i: usize) -> u32 {
    match i % 32 {
        0 => 0,
        1 => u32::MAX,
        2 => 1,
        3 => 0x8000_0000,
        4 => 0x7FFF_FFFF,
        _ => random.word(),
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn float(word: u32) -> f32 {
    f32::from_bits(word)
}

/// Asserts that two numbers agree to `relative` of the larger of both and of `scale`.
#[track_caller]
fn close(what: &str, found: f32, wanted: f32, relative: f32, scale: f32) {
    let allowed = relative * wanted.abs().max(scale);
    assert!(
        found == wanted || (found - wanted).abs() <= allowed,
        "{what}: {found} on the device, {wanted} here"
    );
}
