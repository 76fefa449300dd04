//! What a conversion can be told, and what it takes by default.

use std::path::PathBuf;

use crate::build::Representative;
use crate::input::ReadOptions;

/// Settings of a conversion.
#[derive(Clone, Debug)]
pub struct ConvertOptions {
    /// Most memory to use, bytes. More makes fewer passes over temporary files; the output is the
    /// same. Default: half of what the machine or its control group has.
    pub memory_bytes: u64,
    /// Worker threads; 0 takes one per core. The output is the same for any number.
    pub threads: usize,
    /// Folder of temporary files; default: the output's.
    pub temp_dir: Option<PathBuf>,
    /// Replace an existing output.
    pub overwrite: bool,
    /// Levels within a node beyond its coarsest, 2..=8 (the paper's D). Fewer make more, smaller
    /// nodes. Default 7.
    pub depth: u32,
    /// Fewest points that make a child, at least 1. Fewer make more nodes; more leave more points
    /// without a level of their own. Default 1000.
    pub threshold: u32,
    /// How representatives are chosen.
    pub representative: Representative,
    /// How inputs are to be read where they do not tell.
    pub read: ReadOptions,
}

impl Default for ConvertOptions {
    fn default() -> Self {
        ConvertOptions {
            memory_bytes: available_memory() / 2,
            threads: 0,
            temp_dir: None,
            overwrite: false,
            depth: 7,
            threshold: 1000,
            representative: Representative::Color,
            read: ReadOptions::default(),
        }
    }
}

/// Levels within a node that conversion accepts.
pub const DEPTH_RANGE: std::ops::RangeInclusive<u32> = 2..=8;

/// Memory of the machine or of the control group that this process is in, whichever is less.
/// 4 GiB where neither can be read.
pub fn available_memory() -> u64 {
    let machine = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
    });
    let group = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"]
        .into_iter()
        .find_map(|path| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok());
    machine.into_iter().chain(group).min().unwrap_or(4 << 30)
}
