//! One device per test process.

use std::sync::{Arc, OnceLock};

use esker::gpu::{Gpu, GpuError};

/// The device of this process. Without an adapter `None`, said aloud; in CI that is a failure.
pub fn gpu() -> Option<Arc<Gpu>> {
    static GPU: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    GPU.get_or_init(|| match Gpu::open() {
        Ok(gpu) => Some(Arc::new(gpu)),
        Err(GpuError::NoAdapter) if std::env::var_os("CI").is_none() => {
            eprintln!("skipped: no graphics adapter");
            None
        }
        Err(error) => panic!("{error}"),
    })
    .clone()
}
