//! The graphics processor: adapters, a device, pipelines, the scene in four arenas. Frames are run
//! by [`crate::frame`].
//!
//! | file | holds |
//! |---|---|
//! | `upload` | a world as words: what lies where |
//! | `shader` | which WGSL modules make a kernel |
//! | `compose` | modules as one text: what is left out, where errors are |
//! | `entry` | entry points and workgroups, by what a kernel runs over |
//! | `scene.wgsl` | the arenas from the other side: bindings, words, textures |
//!
//! WGSL stands beside the Rust that it is the twin of, with the same names in the same order
//! (`math/rng.wgsl`, `accel/accel.wgsl`, …). What needs nothing of this crate's scene is public
//! ([`wgsl`]), for hosts with pipelines of their own.

mod compose;
mod entry;
mod shader;
#[cfg(test)]
pub(crate) mod tests;
mod upload;

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, Weak};

pub(crate) use entry::{groups, workgroup};
pub use shader::wgsl;
pub(crate) use shader::{SceneConstants, Shader};
pub(crate) use upload::{CameraRecord, Inputs, Links, MAX_BUFFERS, ProjectionRecord, SceneBuffers};

use compose::Composed;
use entry::ENTRY;

use crate::error::{Error, Result};
use crate::world::World;

/// Storage buffers a kernel may bind: what every WebGPU device has.
pub const STORAGE_BUFFERS: u32 = 8;

/// A graphics processor that can be asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterInfo {
    /// As its driver calls it.
    pub name: String,
    /// Vulkan, Metal or Dx12: one device may be there once for each.
    pub api: String,
    /// Integrated, discrete, virtual or a processor's own program.
    pub kind: String,
    /// The driver and its version.
    pub driver: String,
}

impl AdapterInfo {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        let kind = match info.device_type {
            wgpu::DeviceType::IntegratedGpu => "integrated",
            wgpu::DeviceType::DiscreteGpu => "discrete",
            wgpu::DeviceType::VirtualGpu => "virtual",
            wgpu::DeviceType::Cpu => "software",
            wgpu::DeviceType::Other => "other",
        };
        Self {
            name: info.name,
            api: format!("{:?}", info.backend),
            kind: kind.to_string(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_string(),
        }
    }
}

impl fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name, self.api)
    }
}

/// A device with everything that loops share: pipelines, and scenes that do not move.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: AdapterInfo,
    timestamps: bool,
    layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    pipelines: Mutex<HashMap<String, wgpu::ComputePipeline>>,
    scenes: Mutex<Vec<(Weak<World>, Weak<SceneBuffers>)>>,
    failure: Arc<Mutex<Option<String>>>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Gpu").field("info", &self.info).finish_non_exhaustive()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // A thread that panicked left nothing half done in these maps.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn all_adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::PRIMARY;
    let instance = wgpu::Instance::new(descriptor);
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY))
}

/// All graphics processors, the ones to be preferred first.
#[must_use]
pub fn adapters() -> Vec<AdapterInfo> {
    let mut all = all_adapters();
    all.sort_by_key(preference);
    all.iter().map(AdapterInfo::of).collect()
}

fn preference(adapter: &wgpu::Adapter) -> u32 {
    match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

impl Gpu {
    /// Opens the preferred adapter, or the first whose `name (api)` contains `wanted`, capitals or
    /// not.
    ///
    /// # Errors
    /// No adapter, none of that name (the message lists all), or one that lacks what kernels need
    /// ([`Error::is_gpu`]).
    pub fn open(wanted: Option<&str>) -> Result<Arc<Self>> {
        let mut all = all_adapters();
        all.sort_by_key(preference);
        let names: Vec<String> = all.iter().map(|a| AdapterInfo::of(a).to_string()).collect();
        if all.is_empty() {
            return Err(Error::gpu(
                "no graphics processor was found (Vulkan, Metal or Dx12); on Debian, the package mesa-vulkan-drivers brings one in software",
            ));
        }
        let wanted = wanted.map(str::to_lowercase);
        let fits = |name: &String| {
            wanted.as_ref().is_none_or(|wanted| name.to_lowercase().contains(wanted.as_str()))
        };
        let Some(at) = names.iter().position(fits) else {
            return Err(Error::gpu(format!(
                "no adapter's name contains `{}`; known: {}",
                wanted.unwrap_or_default(),
                names.join("; ")
            )));
        };
        Self::with_adapter(&all[at])
    }

    fn with_adapter(adapter: &wgpu::Adapter) -> Result<Arc<Self>> {
        let info = AdapterInfo::of(adapter);
        let most = adapter.limits();
        // All limits are those of every WebGPU device, but for the size of buffers: large scenes
        // need what there is.
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: most.max_storage_buffer_binding_size,
            max_buffer_size: most.max_buffer_size,
            ..wgpu::Limits::default()
        };
        if let Some(what) = lacks(&limits, &most) {
            return Err(Error::gpu(format!("{info} has too few {what}")));
        }
        let timestamps = adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let features =
            if timestamps { wgpu::Features::TIMESTAMP_QUERY } else { wgpu::Features::empty() };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("afterimage"),
            required_features: features,
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| Error::gpu(format!("{info} gives no device: {error}")))?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>| {
            let failure = failure.clone();
            move |text: String| {
                locked(&failure).get_or_insert(text);
            }
        };
        let lost = note(&failure);
        device.set_device_lost_callback(move |reason, text| {
            lost(format!("the device was lost ({reason:?}): {text}"));
        });
        let uncaptured = note(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            uncaptured(error.to_string());
        }));
        let layout = bind_group_layout(&device);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("all kernels"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        Ok(Arc::new(Self {
            device,
            queue,
            info,
            timestamps,
            layout,
            pipeline_layout,
            pipelines: Mutex::default(),
            scenes: Mutex::default(),
            failure,
        }))
    }

    /// Which graphics processor this is.
    #[must_use]
    pub fn info(&self) -> &AdapterInfo {
        &self.info
    }

    /// Whether each pass is timed by the device itself; else a frame's time is one number.
    #[must_use]
    pub fn has_timestamps(&self) -> bool {
        self.timestamps
    }

    pub(crate) fn device(&self) -> &wgpu::Device {
        &self.device
    }

    pub(crate) fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// An error of the device, which is not to be used any more.
    pub(crate) fn failed(&self, why: &str) -> Error {
        locked(&self.failure).get_or_insert_with(|| why.to_string());
        Error::gpu(format!("{}: {why}", self.info))
    }

    /// Whatever went wrong since the device was opened, as an error.
    pub(crate) fn check(&self) -> Result<()> {
        match locked(&self.failure).as_ref() {
            Some(text) => Err(Error::gpu(format!("{}: {text}", self.info))),
            None => Ok(()),
        }
    }

    /// Makes something; an error of the device becomes one that says what was being made.
    pub(crate) fn guarded<T>(&self, what: &str, make: impl FnOnce() -> T) -> Result<T> {
        let scopes = [
            self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory),
            self.device.push_error_scope(wgpu::ErrorFilter::Validation),
        ];
        let made = make();
        let mut found = None;
        // Innermost first.
        for scope in scopes.into_iter().rev() {
            found = found.or(pollster::block_on(scope.pop()));
        }
        match found {
            Some(wgpu::Error::OutOfMemory { .. }) => {
                Err(Error::gpu(format!("{}: out of memory for {what}", self.info)))
            }
            Some(error) => Err(Error::gpu(format!("{}: {what}: {error}", self.info))),
            None => Ok(made),
        }
    }

    /// A buffer of `bytes` bytes.
    pub(crate) fn buffer(
        &self,
        what: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer> {
        // No binding is empty; copies want multiples of 4, structures 16.
        let size = bytes.max(16).next_multiple_of(16);
        let limits = self.device.limits();
        let most = if usage.contains(wgpu::BufferUsages::STORAGE) {
            limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
        } else {
            limits.max_buffer_size
        };
        if size > most {
            return Err(Error::gpu(format!(
                "{what} takes {size} bytes, but {} binds at most {most}",
                self.info
            )));
        }
        self.guarded(what, || {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(what),
                size,
                usage,
                mapped_at_creation: false,
            })
        })
    }

    /// The pipeline of a kernel, compiled once a device.
    pub(crate) fn pipeline(&self, kernel: &Shader) -> Result<wgpu::ComputePipeline> {
        let composed = kernel.compose()?;
        let key = kernel.key(&composed.text);
        if let Some(pipeline) = locked(&self.pipelines).get(&key) {
            return Ok(pipeline.clone());
        }
        let pipeline = self.compile(kernel.name, &composed, &kernel.constants)?;
        locked(&self.pipelines).insert(key, pipeline.clone());
        Ok(pipeline)
    }

    /// A pipeline of a text. Errors of the text name the module's file and line.
    fn compile(
        &self,
        name: &str,
        composed: &Composed,
        constants: &[(&str, f64)],
    ) -> Result<wgpu::ComputePipeline> {
        let what = format!("kernel `{name}`");
        let mut said = Vec::new();
        let module = self.guarded(&what, || {
            let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(name),
                source: wgpu::ShaderSource::Wgsl(composed.text.as_str().into()),
            });
            said = pollster::block_on(module.get_compilation_info()).messages;
            module
        });
        let module = module.map_err(|error| {
            let placed = said.iter().find_map(|message| {
                let line = message.location?.line_number as usize;
                Some(composed.explain(line, &message.message))
            });
            placed.map_or(error, |text| Error::gpu(format!("{what}: {text}")))
        })?;
        self.guarded(&what, || {
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&self.pipeline_layout),
                module: &module,
                entry_point: Some(ENTRY),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    ..wgpu::PipelineCompilationOptions::default()
                },
                cache: None,
            })
        })
    }

    /// Number of pipelines compiled so far.
    #[must_use]
    pub fn pipeline_count(&self) -> usize {
        locked(&self.pipelines).len()
    }

    /// A still world's arenas, shared by all loops that show it; with the emitters' tree where that
    /// is `wanted`.
    pub(crate) fn scene(
        self: &Arc<Self>,
        world: &Arc<World>,
        wanted: bool,
    ) -> Result<Arc<SceneBuffers>> {
        let mut scenes = locked(&self.scenes);
        scenes.retain(|(world, buffers)| world.strong_count() > 0 && buffers.strong_count() > 0);
        let known =
            scenes.iter().find(|(known, _)| std::ptr::eq(known.as_ptr(), Arc::as_ptr(world)));
        let fits = |buffers: &Arc<SceneBuffers>| buffers.has_emitters() || !wanted;
        if let Some(buffers) = known.and_then(|(_, buffers)| buffers.upgrade()).filter(fits) {
            return Ok(buffers);
        }
        scenes.retain(|(known, _)| !std::ptr::eq(known.as_ptr(), Arc::as_ptr(world)));
        let buffers = Arc::new(SceneBuffers::still(self, world)?);
        scenes.push((Arc::downgrade(world), Arc::downgrade(&buffers)));
        Ok(buffers)
    }
}

/// The first limit that an adapter does not reach.
fn lacks(wanted: &wgpu::Limits, has: &wgpu::Limits) -> Option<String> {
    let pairs = [
        ("storage buffers a stage", STORAGE_BUFFERS, has.max_storage_buffers_per_shader_stage),
        (
            "invocations a workgroup",
            wanted.max_compute_invocations_per_workgroup,
            has.max_compute_invocations_per_workgroup,
        ),
        (
            "workgroups a dimension",
            wanted.max_compute_workgroups_per_dimension,
            has.max_compute_workgroups_per_dimension,
        ),
        (
            "bytes of workgroup memory",
            wanted.max_compute_workgroup_storage_size,
            has.max_compute_workgroup_storage_size,
        ),
    ];
    pairs
        .into_iter()
        .find(|(_, wanted, has)| has < wanted)
        .map(|(what, wanted, has)| format!("{what}: {has}, but kernels need {wanted}"))
}

fn bind_group_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
    let mut entries = vec![entry(0, wgpu::BufferBindingType::Uniform)];
    entries.extend((1..=4).map(|binding| entry(binding, storage(true))));
    entries.extend((5..=6).map(|binding| entry(binding, storage(false))));
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("all kernels"),
        entries: &entries,
    })
}
