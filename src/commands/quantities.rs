//! Numbers as people write them: `4GiB`, `512MB`, `2M`, `1280x720`.

/// Bytes: a number with an optional unit, decimal (kB, MB, GB) or binary (KiB, MiB, GiB); a bare
/// K, M or G is binary.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let units = [
        ("kib", 1u64 << 10),
        ("mib", 1 << 20),
        ("gib", 1 << 30),
        ("tib", 1 << 40),
        ("kb", 1000),
        ("mb", 1_000_000),
        ("gb", 1_000_000_000),
        ("tb", 1_000_000_000_000),
        ("k", 1 << 10),
        ("m", 1 << 20),
        ("g", 1 << 30),
        ("t", 1 << 40),
        ("b", 1),
    ];
    parse_with_units(text, &units, "a size such as 4GiB")
}

/// A count: a number with an optional k, M or G for thousands, millions, billions.
pub fn parse_count(text: &str) -> Result<u64, String> {
    let units = [("k", 1000u64), ("m", 1_000_000), ("g", 1_000_000_000)];
    parse_with_units(text, &units, "a count such as 2M")
}

fn parse_with_units(text: &str, units: &[(&str, u64)], expected: &str) -> Result<u64, String> {
    let lower = text.trim().to_ascii_lowercase();
    let wrong = || format!("'{text}' is not {expected}");
    let (number, unit) = units
        .iter()
        .find_map(|(name, unit)| lower.strip_suffix(name).map(|number| (number, *unit)))
        .unwrap_or((&lower, 1));
    let number = number.trim();
    if let Ok(whole) = number.parse::<u64>() {
        return whole.checked_mul(unit).ok_or_else(wrong);
    }
    let value = number.parse::<f64>().map_err(|_| wrong())? * unit as f64;
    let fits = value.is_finite() && value >= 0.0 && value < u64::MAX as f64;
    if fits { Ok(value as u64) } else { Err(wrong()) }
}

/// A picture size in pixels, `WIDTHxHEIGHT`, each 1..=16384.
pub fn parse_picture_size(text: &str) -> Result<(u32, u32), String> {
    let parse = || {
        let (width, height) = text.split_once(['x', 'X'])?;
        let side = |s: &str| s.trim().parse::<u32>().ok().filter(|side| (1..=16384).contains(side));
        Some((side(width)?, side(height)?))
    };
    parse().ok_or_else(|| format!("'{text}' is not a size such as 1280x720 (1 to 16384 each)"))
}

/// A size for people, in binary units.
pub fn show_bytes(bytes: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{bytes} B") } else { format!("{value:.1} {}", units[unit]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_counts_read_as_people_write_them() {
        assert_eq!(parse_bytes("512MiB"), Ok(512 << 20));
        assert_eq!(parse_bytes("1.5 GB"), Ok(1_500_000_000));
        assert_eq!(parse_bytes("2g"), Ok(2 << 30));
        assert_eq!(parse_bytes("4096"), Ok(4096));
        assert_eq!(parse_count("50M"), Ok(50_000_000));
        assert_eq!(parse_count("2.5k"), Ok(2500));
        for bad in ["", "x", "-3", "nan", "infM", "1e300G", "99999999999999999999"] {
            assert!(parse_bytes(bad).is_err(), "{bad}");
            assert!(parse_count(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_picture_size("1280x720"), Ok((1280, 720)));
        for bad in ["0x3", "3x", "20000x3", "3", "-1x5"] {
            assert!(parse_picture_size(bad).is_err(), "{bad}");
        }
    }
}
