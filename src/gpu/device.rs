//! The device: found, opened, and asked whether all went well.
//!
//! Any backend and any kind of adapter will do, software included; what an adapter lacks shows in
//! [`Gpu::draws_by_compute`], [`Gpu::draws_by_narrow_compute`] and [`Gpu::draws_by_raster`]. Errors of the device are values: work
//! that may fail runs in [`Gpu::checked`], and a lost device answers [`GpuError::Lost`] from then
//! on.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::gpu::memory::Account;
use crate::gpu::shader::PixelAtomics;

/// Why the GPU did not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter at all: no GPU, no software driver.
    #[error("no graphics adapter: neither a GPU nor a software driver answers")]
    NoAdapter,
    /// The adapter refused to open a device.
    #[error("adapter {adapter} gives no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// Memory of the device ran out.
    #[error("the graphics device has no memory left to {doing}")]
    OutOfMemory {
        /// What was tried.
        doing: &'static str,
    },
    /// The device was lost (driver reset, unplugged) or had an internal error.
    #[error("the graphics device was lost: {reason}")]
    Lost {
        /// What the driver said.
        reason: String,
    },
    /// The device refused a call.
    #[error("the graphics device refused to {doing}: {reason}")]
    Refused {
        /// What was tried.
        doing: &'static str,
        /// What it said.
        reason: String,
    },
    /// The adapter cannot draw points in the wanted way.
    #[error("adapter {adapter} cannot draw points by {path}: {missing}")]
    Unsupported {
        /// Name of the adapter.
        adapter: String,
        /// The wanted way.
        path: &'static str,
        /// What it lacks.
        missing: &'static str,
    },
}

/// What failed outside of a checked call, or that the device is gone.
type Failure = Arc<Mutex<Option<String>>>;

/// An open device and what is known of it.
#[derive(Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    vertex_storage: bool,
    fragment_storage: bool,
    narrow_compute: bool,
    failure: Failure,
    waits: AtomicU64,
    account: Arc<Account>,
}

const COMPUTE_FEATURES: wgpu::Features =
    wgpu::Features::SHADER_INT64.union(wgpu::Features::SHADER_INT64_ATOMIC_MIN_MAX);

/// The features that drawing uses where an adapter has them; none is required.
pub fn wanted_features(adapter: &wgpu::Adapter) -> wgpu::Features {
    adapter.features()
        & COMPUTE_FEATURES
            .union(wgpu::Features::TIMESTAMP_QUERY)
            .union(wgpu::Features::INDIRECT_FIRST_INSTANCE)
}

/// The limits that drawing uses: the defaults, and as large buffers and textures as there are.
pub fn wanted_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let offered = adapter.limits();
    wgpu::Limits {
        max_buffer_size: offered.max_buffer_size,
        max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
        max_texture_dimension_2d: offered.max_texture_dimension_2d,
        ..wgpu::Limits::downlevel_defaults()
    }
    .or_worse_values_from(&offered)
}

impl Gpu {
    /// Opens the best adapter by [`adapter_preference`].
    ///
    /// The variables of wgpu (`WGPU_BACKEND` and others) are obeyed.
    pub fn open() -> Result<Gpu, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
        // Arguments of draws in buffers are all our own. Their check is a dispatch before each pass
        // that draws by them, of which culling in rounds has several a frame.
        descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
        let instance = wgpu::Instance::new(descriptor);
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        adapters.sort_by_key(adapter_preference);
        let mut refusal = GpuError::NoAdapter;
        for adapter in adapters {
            match Gpu::open_adapter(&adapter) {
                Ok(gpu) => return Ok(gpu),
                Err(error) => refusal = error,
            }
        }
        Err(refusal)
    }

    /// Opens a given adapter.
    pub fn open_adapter(adapter: &wgpu::Adapter) -> Result<Gpu, GpuError> {
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("esker"),
            required_features: wanted_features(adapter),
            required_limits: wanted_limits(adapter),
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| {
                GpuError::NoDevice { adapter: adapter.get_info().name, reason: error.to_string() }
            })?;
        let gpu = Gpu::from_device(adapter, device, queue);
        let failure = gpu.failure.clone();
        gpu.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            note_failure(&failure, error.to_string());
        }));
        Ok(gpu)
    }

    /// Takes a device that somebody else opened (a window), best with [`wanted_features`] and
    /// [`wanted_limits`].
    pub fn from_device(adapter: &wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue) -> Gpu {
        let failure = Failure::default();
        let lost = failure.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note_failure(&lost, message);
            }
        });
        let flags = adapter.get_downlevel_capabilities().flags;
        Gpu {
            device,
            queue,
            info: adapter.get_info(),
            vertex_storage: flags.contains(wgpu::DownlevelFlags::VERTEX_STORAGE),
            fragment_storage: flags.contains(wgpu::DownlevelFlags::FRAGMENT_STORAGE),
            // Storage in fragments for the resolve.
            narrow_compute: flags.contains(
                wgpu::DownlevelFlags::COMPUTE_SHADERS | wgpu::DownlevelFlags::FRAGMENT_STORAGE,
            ),
            failure,
            waits: AtomicU64::new(0),
            account: Arc::default(),
        }
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Its queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Name, backend and driver in one line, for reports.
    pub fn description(&self) -> String {
        let wgpu::AdapterInfo { name, backend, driver, driver_info, .. } = &self.info;
        format!("{name} ({backend}, {driver} {driver_info})").replace(" )", ")")
    }

    /// Whether the adapter is a program on the CPU.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Whether 64-bit atomic minimum and maximum are there, the main way to draw points.
    pub fn draws_by_compute(&self) -> bool {
        self.device.features().contains(COMPUTE_FEATURES)
    }

    /// Whether compute shaders can draw with 32-bit atomics in two passes.
    pub fn draws_by_narrow_compute(&self) -> bool {
        self.narrow_compute
    }

    /// Whether vertex shaders may read storage buffers, which the way without atomics needs.
    pub fn draws_by_raster(&self) -> bool {
        self.vertex_storage
    }

    /// Whether models can be drawn: vertices and fragments read storage buffers.
    pub fn draws_meshes(&self) -> bool {
        self.vertex_storage && self.fragment_storage
    }

    /// Whether the GPU's own clock can be read.
    pub fn has_timestamps(&self) -> bool {
        self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// How compute shaders hold pixels where there are 64-bit atomics.
    pub fn wide_atomics(&self) -> PixelAtomics {
        match self.info.backend {
            wgpu::Backend::Metal => PixelAtomics::WideUnread,
            _ => PixelAtomics::Wide,
        }
    }

    /// An error of this adapter that lacks something.
    pub fn unsupported(&self, path: &'static str, missing: &'static str) -> GpuError {
        GpuError::Unsupported { adapter: self.info.name.clone(), path, missing }
    }

    /// Does `work` and tells whether the device accepted it and still lives.
    pub fn checked<T>(&self, doing: &'static str, work: impl FnOnce() -> T) -> Result<T, GpuError> {
        self.alive()?;
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let value = work();
        let refused = pollster::block_on(validation.pop());
        let out_of_memory = pollster::block_on(memory.pop());
        let broken = pollster::block_on(internal.pop());
        self.alive()?;
        if out_of_memory.is_some() {
            return Err(GpuError::OutOfMemory { doing });
        }
        match refused.or(broken) {
            Some(error) => Err(GpuError::Refused { doing, reason: error.to_string() }),
            None => Ok(value),
        }
    }

    pub(super) fn account(&self) -> &Arc<Account> {
        &self.account
    }

    /// How often somebody waited for the GPU so far.
    pub fn waits(&self) -> u64 {
        self.waits.load(Ordering::Relaxed)
    }

    /// Waits until all submitted work is done.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.waits.fetch_add(1, Ordering::Relaxed);
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.alive()?;
        waited.map(drop).map_err(|error| GpuError::Lost { reason: error.to_string() })
    }

    fn alive(&self) -> Result<(), GpuError> {
        match &*self.failure.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(reason) => Err(GpuError::Lost { reason: reason.clone() }),
            None => Ok(()),
        }
    }
}

fn note_failure(failure: &Failure, reason: String) {
    failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
}

/// Sorts adapters, the best first: a GPU before software, then one that draws by compute, then the
/// kind of GPU, then a modern backend.
pub fn adapter_preference(adapter: &wgpu::Adapter) -> impl Ord + use<> {
    let info = adapter.get_info();
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0u32,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    let backend = match info.backend {
        wgpu::Backend::Gl => 1u32,
        wgpu::Backend::Noop => 2,
        _ => 0,
    };
    let is_software = info.device_type == wgpu::DeviceType::Cpu || backend == 2;
    (is_software, !adapter.features().contains(COMPUTE_FEATURES), kind, backend)
}
