//! Records of any LAS point format, every field filled with seeded noise.
//!
//! Numbers that are floating point stay finite, and sums of a wave packet's offset and size stay in
//! range: what a real scan would never hold is the business of tests that damage files.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", tables 7 to 17.

use super::random::Random;
use super::shapes::Coordinates;

/// Sizes of the records of point formats 0 to 10 without extra bytes.
pub const BASE_BYTES: [u16; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// Where GPS time stands in a record of a point format.
pub fn gps_time_offset(point_format: u8) -> Option<usize> {
    match point_format {
        0 | 2 => None,
        1 | 3..=5 => Some(20),
        _ => Some(22),
    }
}

/// Where the wave packet stands in a record of a point format.
fn wave_packet_offset(point_format: u8) -> Option<usize> {
    match point_format {
        4 => Some(28),
        5 => Some(34),
        9 => Some(30),
        10 => Some(38),
        _ => None,
    }
}

/// Records at the given places, all else noise.
///
/// `point_format` is 0 to 10. Each record ends with `extra_bytes` bytes of noise.
pub fn noise_at(places: &[Coordinates], point_format: u8, extra_bytes: u16, seed: u64) -> Vec<u8> {
    let base_bytes = usize::from(BASE_BYTES[usize::from(point_format)]);
    let record_bytes = base_bytes + usize::from(extra_bytes);
    let mut records = vec![0; places.len() * record_bytes];
    for (index, record) in records.chunks_exact_mut(record_bytes).enumerate() {
        let mut random = Random::new(seed, index as u64);
        random.fill(record);
        for (axis, coordinate) in places[index].into_iter().enumerate() {
            put(record, 4 * axis, &coordinate.to_le_bytes());
        }
        if let Some(at) = gps_time_offset(point_format) {
            put(record, at, &random.between(-1e9, 1e9).to_le_bytes());
        }
        if let Some(at) = wave_packet_offset(point_format) {
            put(record, at + 1, &random.below(1 << 40).to_le_bytes());
            for float in 0..4 {
                let value = random.between(-1e3, 1e3) as f32;
                put(record, at + 13 + 4 * float, &value.to_le_bytes());
            }
        }
    }
    records
}

/// `count` records of noise within a cube of 2^20 steps.
pub fn noise(count: usize, point_format: u8, extra_bytes: u16, seed: u64) -> Vec<u8> {
    let places = super::shapes::cube(count, (1 << 20) - 1, seed);
    noise_at(&places, point_format, extra_bytes, seed)
}

fn put(record: &mut [u8], at: usize, value: &[u8]) {
    record[at..at + value.len()].copy_from_slice(value);
}
