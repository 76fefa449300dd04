//! Counters of one frame or run, under the names that scripts read.

use serde::Serialize;

/// What one picture took, as `--stats` and the benchmarks write it. Absent values are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrameCounters {
    /// Time of the whole frame, milliseconds.
    pub frame_ms: f64,
    /// Points drawn.
    pub points_drawn: u64,
    /// Octree nodes drawn.
    pub nodes_drawn: u32,
    /// Draw or dispatch calls.
    pub draw_calls: u32,
    /// Bytes read from stores.
    pub bytes_read: u64,
    /// Bytes sent to the GPU.
    pub bytes_uploaded: u64,
    /// Largest resident memory of the process so far, where the system tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_rss_bytes: Option<u64>,
    /// Share of the reference's pixels left empty, where a reference was drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hole_fraction: Option<f64>,
    /// Colour error against the reference, 0-255, where one was drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse: Option<f64>,
}

/// Largest resident memory of this process so far; `None` where the system does not tell.
///
/// Read from `/proc/self/status` (VmHWM), so Linux only.
pub fn peak_rss_bytes() -> Option<u64> {
    parse_peak_rss(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn parse_peak_rss(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    kibibytes.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_from_the_status_text() {
        let status = "Name:\tesker\nVmPeak:\t  9000 kB\nVmHWM:\t    1234 kB\nVmRSS:\t 5 kB\n";
        assert_eq!(parse_peak_rss(status), Some(1234 * 1024));
        assert_eq!(parse_peak_rss("Name:\tesker\n"), None);
        assert_eq!(parse_peak_rss("VmHWM:\tlots\n"), None);
    }

    #[test]
    fn absent_values_are_left_out() {
        let text = serde_json::to_string(&FrameCounters::default()).expect("plain numbers");
        assert!(text.contains("\"points_drawn\":0") && !text.contains("rmse"), "{text}");
    }
}
