//! The device, its memory and its shaders; what the GPU sees of a scene, struct by struct.
//!
//! [`layout`] compiles without a GPU because the CPU twins of the passes share its structs. The
//! rest needs the feature `gpu`. What is drawn, and in which order, is decided elsewhere.

pub mod layout;

#[cfg(feature = "gpu")]
mod arena;
#[cfg(feature = "gpu")]
mod bandwidth;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod growing_buffer;
#[cfg(feature = "gpu")]
mod memory;
#[cfg(feature = "gpu")]
mod read_back;
#[cfg(feature = "gpu")]
pub mod shader;
#[cfg(feature = "gpu")]
mod timing;

#[cfg(feature = "gpu")]
pub use arena::{WordArena, WordRange};
#[cfg(feature = "gpu")]
pub use bandwidth::copy_bandwidth;
#[cfg(feature = "gpu")]
pub use device::{Gpu, GpuError, adapter_preference, wanted_features, wanted_limits};
#[cfg(feature = "gpu")]
pub use growing_buffer::GrowingBuffer;
#[cfg(feature = "gpu")]
pub use memory::{HeldBuffer, HeldBytes};
#[cfg(feature = "gpu")]
pub use read_back::{read_buffer, read_texture};
#[cfg(feature = "gpu")]
pub use timing::{MeasuredFrame, PassTimer, PassTimes};
