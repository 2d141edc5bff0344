//! A host with a pipeline and a scene of its own takes the crate's random numbers, reservoirs and
//! merges as WGSL.
//!
//! The scene is a floor under 400 coloured lamps, with three balls that cast shadows: closed
//! formulas in the host's shader, no mesh, no tree, nothing of this crate. Each pixel draws 16
//! lamps, keeps one, takes what eight neighbours kept, and asks one shadow ray. The picture's mean
//! over frames must agree with the sum over all lamps.
//!
//! `cargo run --release --example host_wgpu [FRAMES]`

use afterimage::gpu::wgsl;

/// Width and height in pixels.
const SIZE: u32 = 96;
const LAMPS: u32 = 400;

/// What `wgsl::MERGE` asks of a host, and the host's own kernels.
const HOST: &str = "
const SIZE: u32 = 96u;
const LAMPS: u32 = 400u;
const CANDIDATES: u32 = 16u;
const NEIGHBOURS: u32 = 8u;

struct Lamp { position: vec3f, intensity: vec3f }
struct Kept { lamp: u32, weight: f32, target_luminance: f32, confidence: f32 }
struct Frame { number: u32, reuse: u32, a: u32, b: u32 }

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> kept: array<Kept>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> exact: array<vec4f>;

fn lamp_at(i: u32) -> Lamp {
    let word = pcg4d(vec4<u32>(i, 7u, 3u, 1u));
    let more = pcg4d(vec4<u32>(i, 8u, 3u, 1u));
    let place = vec3f(unit_float(word.x) * 8.0 - 4.0, 0.3 + 2.0 * unit_float(word.y), unit_float(word.z) * 8.0 - 4.0);
    let color = vec3f(unit_float(more.x), unit_float(more.y), unit_float(more.z));
    let power = exp2(-8.0 * unit_float(word.w));
    return Lamp(place, color * power);
}

fn floor_at(pixel: u32) -> vec3f {
    let xy = vec2f(f32(pixel % SIZE), f32(pixel / SIZE)) + 0.5;
    return vec3f(xy.x / f32(SIZE) * 8.0 - 4.0, 0.0, xy.y / f32(SIZE) * 8.0 - 4.0);
}

// Light of a lamp at a point of the floor, without shadows.
fn unshadowed(i: u32, place: vec3f) -> vec3f {
    let lamp = lamp_at(i);
    let d = lamp.position - place;
    let squared = dot(d, d);
    return lamp.intensity * (d.y / (squared * sqrt(squared)));
}

fn is_visible(i: u32, place: vec3f) -> bool {
    let d = lamp_at(i).position - place;
    for (var ball = 0u; ball < 3u; ball++) {
        let center = vec3f(f32(ball) * 2.4 - 2.4, 0.5, f32(ball % 2u) * 1.5 - 0.7);
        let o = place - center;
        let t = clamp(-dot(o, d) / dot(d, d), 0.0, 1.0);
        let near = o + t * d;
        if dot(near, near) < 0.2 { return false; }
    }
    return true;
}

// --- The host's half of the merge.
struct Sample { lamp: u32 }
struct Merge { pixels: array<u32, 9> }

fn input_finished(m: ptr<function, Merge>, input: u32) -> Finished {
    let k = kept[(*m).pixels[input]];
    return Finished(Sample(k.lamp), k.weight, k.confidence);
}
fn input_target(m: ptr<function, Merge>, input: u32) -> f32 {
    return kept[(*m).pixels[input]].target_luminance;
}
fn target_of(integrand: vec3f) -> f32 { return dot(integrand, vec3f(0.2126, 0.7152, 0.0722)); }
// A lamp stays the same lamp wherever it is seen from.
fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted {
    let there = unshadowed(sample.lamp, floor_at((*m).pixels[destination]));
    return Shifted(sample, there, 1.0, target_of(there) > 0.0);
}
fn carry(m: ptr<function, Merge>, term: Term) -> Carried { return Carried(1.0, vec3f(0.0)); }

@compute @workgroup_size(64)
fn draw(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.x;
    if pixel >= SIZE * SIZE { return; }
    let place = floor_at(pixel);
    var random = stream_new(vec2<u32>(1u, 0u), pixel, frame.number, PURPOSE_SELECTION, 0u);
    var r = reservoir_new();
    var best = 0u;
    for (var c = 0u; c < CANDIDATES; c++) {
        let lamp = stream_index(&random, LAMPS);
        let weight = target_of(unshadowed(lamp, place)) * f32(LAMPS) / f32(CANDIDATES);
        if reservoir_stream(&r, weight, 0.0, vec3f(0.0), &random) { best = lamp; }
    }
    let target_luminance = target_of(unshadowed(best, place));
    kept[pixel] = Kept(best, contribution_weight(r.weight_sum, target_luminance, 1.0), target_luminance, 1.0);
}

@compute @workgroup_size(64)
fn reuse(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.x;
    if pixel >= SIZE * SIZE { return; }
    var random = stream_new(vec2<u32>(1u, 0u), pixel, frame.number, PURPOSE_NEIGHBOURS, 0u);
    var m: Merge;
    m.pixels[0] = pixel;
    var count = 0u;
    for (var n = 0u; n < NEIGHBOURS * frame.reuse; n++) {
        let at = vec2<i32>(i32(pixel % SIZE), i32(pixel / SIZE))
            + vec2<i32>(i32(stream_index(&random, 13u)) - 6, i32(stream_index(&random, 13u)) - 6);
        if all(at >= vec2<i32>(0)) && all(at < vec2<i32>(i32(SIZE))) {
            count += 1u;
            m.pixels[count] = u32(at.y) * SIZE + u32(at.x);
        }
    }
    var r = reservoir_new();
    var selection = stream_new(vec2<u32>(1u, 0u), pixel, frame.number, PURPOSE_SELECTION, 1u);
    let merged = merge(&m, FAMILY_DEFENSIVE, count, &r, &selection);
    var shown = vec3f(0.0);
    let place = floor_at(pixel);
    if merged.finished.weight > 0.0 && is_visible(merged.finished.sample.lamp, place) {
        shown = unshadowed(merged.finished.sample.lamp, place) * merged.finished.weight;
    }
    // Sum of colours, and of squared luminance.
    let y = target_of(shown);
    sums[pixel] += vec4f(shown, y * y);
}

@compute @workgroup_size(64)
fn all_lamps(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.x;
    if pixel >= SIZE * SIZE { return; }
    let place = floor_at(pixel);
    var sum = vec3f(0.0);
    for (var i = 0u; i < LAMPS; i++) {
        if is_visible(i, place) { sum += unshadowed(i, place); }
    }
    exact[pixel] = vec4f(sum, 0.0);
}
";

fn luminance(rgb: &[f32]) -> f64 {
    f64::from(rgb[0]) * 0.2126 + f64::from(rgb[1]) * 0.7152 + f64::from(rgb[2]) * 0.0722
}

/// The host's own device and pipelines.
struct Host {
    device: wgpu::Device,
    queue: wgpu::Queue,
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    bindings: wgpu::BindGroup,
    frame: wgpu::Buffer,
    buffers: [wgpu::Buffer; 3],
}

impl Host {
    fn new() -> Option<Self> {
        let descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        let instance = wgpu::Instance::new(descriptor);
        let adapter = pollster::block_on(instance.request_adapter(&Default::default())).ok()?;
        println!("adapter  {}", adapter.get_info().name);
        let (device, queue) =
            pollster::block_on(adapter.request_device(&Default::default())).ok()?;
        let text = [wgsl::RNG, wgsl::RESAMPLING, wgsl::MERGE, HOST].concat();
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("host"),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let storage = wgpu::BufferBindingType::Storage { read_only: false };
        let mut entries = vec![entry(0, wgpu::BufferBindingType::Uniform)];
        entries.extend((1..=3).map(|binding| entry(binding, storage)));
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: None,
            entries: &entries,
        });
        let buffer = |size, usage| {
            let descriptor =
                wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
            device.create_buffer(&descriptor)
        };
        use wgpu::BufferUsages as Usage;
        let frame = buffer(16, Usage::UNIFORM | Usage::COPY_DST);
        let pixels = u64::from(SIZE * SIZE) * 16;
        let stored = Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST;
        let buffers = [(); 3].map(|()| buffer(pixels, stored));
        let all = [&frame, &buffers[0], &buffers[1], &buffers[2]];
        let entries: Vec<_> = all
            .into_iter()
            .enumerate()
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &layout,
            entries: &entries,
        });
        Some(Self { device, queue, module, layout, bindings, frame, buffers })
    }

    fn pipeline(&self, entry: &str) -> wgpu::ComputePipeline {
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: Some(&layout),
            module: &self.module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        })
    }

    fn run(&self, frame: [u32; 4], kernels: &[&wgpu::ComputePipeline]) {
        self.queue.write_buffer(&self.frame, 0, bytemuck::cast_slice(&frame));
        let mut encoder = self.device.create_command_encoder(&Default::default());
        for kernel in kernels {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(kernel);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups((SIZE * SIZE).div_ceil(64), 1, 1);
        }
        self.queue.submit([encoder.finish()]);
    }

    fn clear(&self, buffer: usize) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(&self.buffers[buffer], 0, None);
        self.queue.submit([encoder.finish()]);
    }

    /// Four floats a pixel.
    fn read(&self, buffer: usize) -> Vec<f32> {
        let source = &self.buffers[buffer];
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: source.size(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(source, 0, &staging, 0, Some(source.size()));
        self.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, .., |mapped| mapped.expect("the buffer is mapped"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
        let view = staging.get_mapped_range(..).expect("it was mapped");
        view.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }
}

fn main() {
    let frames: u32 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(200);
    let Some(host) = Host::new() else {
        println!("skipped: no graphics processor");
        return;
    };
    println!("scene    {LAMPS} lamps over a floor of {SIZE} x {SIZE} pixels; {frames} frames");
    host.run([0; 4], &[&host.pipeline("all_lamps")]);
    let exact = host.read(2);
    let (draw, reuse) = (host.pipeline("draw"), host.pipeline("reuse"));
    let mean_exact = exact.chunks(4).map(luminance).sum::<f64>();
    for (name, neighbours) in [("alone", 0), ("reuse", 1)] {
        host.clear(1);
        for number in 0..frames {
            host.run([number, neighbours, 0, 0], &[&draw, &reuse]);
        }
        let sums = host.read(1);
        let n = f64::from(frames);
        let (mut mean, mut relmse) = (0.0, 0.0);
        let average = mean_exact / f64::from(SIZE * SIZE);
        for (sum, exact) in sums.chunks(4).zip(exact.chunks(4)) {
            let (seen, truth) = (luminance(sum) / n, luminance(exact));
            mean += seen;
            let error = f64::from(sum[3]) / n - 2.0 * seen * truth + truth * truth;
            relmse += error / (truth * truth + 0.01 * average * average);
        }
        relmse /= f64::from(SIZE * SIZE);
        let off = mean / mean_exact - 1.0;
        println!(
            "{name:<8} relmse of a frame {relmse:.4}, mean over frames {:+.3} % off",
            100.0 * off
        );
        assert!(off.abs() < 0.01, "the mean is {off} off: merges must not change it");
    }
}
