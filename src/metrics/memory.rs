//! Memory of this process, as the system counts it.

/// Largest resident memory of this process so far; `None` where the system does not tell.
///
/// Read from `/proc/self/status` (VmHWM), so Linux only.
pub fn peak_rss_bytes() -> Option<u64> {
    parse_status(&std::fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// Resident memory of this process now; `None` where the system does not tell.
///
/// Read from `/proc/self/status` (VmRSS), so Linux only.
pub fn rss_bytes() -> Option<u64> {
    parse_status(&std::fs::read_to_string("/proc/self/status").ok()?, "VmRSS:")
}

fn parse_status(status: &str, name: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    kibibytes.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_from_the_status_text() {
        let status = "Name:\tesker\nVmPeak:\t  9000 kB\nVmHWM:\t    1234 kB\nVmRSS:\t 5 kB\n";
        assert_eq!(parse_status(status, "VmHWM:"), Some(1234 * 1024));
        assert_eq!(parse_status(status, "VmRSS:"), Some(5 * 1024));
        assert_eq!(parse_status("Name:\tesker\n", "VmHWM:"), None);
        assert_eq!(parse_status("VmHWM:\tlots\n", "VmHWM:"), None);
    }
}
