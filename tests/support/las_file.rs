//! A LAS file written by hand, so that tests of the build depend on no writer of ours.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::Path;

/// One point of format 3; `index` goes into the GPS time, so every point can be told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LasPoint {
    pub position: [i32; 3],
    pub color: [u16; 3],
    pub intensity: u16,
}

/// Bytes of a record of point format 3.
pub const RECORD_BYTES: usize = 34;

/// Where the GPS time stands in a record.
pub const GPS_TIME_OFFSET: usize = 20;

/// The record of a point that is number `index` of its file.
pub fn record(point: &LasPoint, index: u64) -> [u8; RECORD_BYTES] {
    let mut record = [0; RECORD_BYTES];
    for axis in 0..3 {
        record[4 * axis..4 * axis + 4].copy_from_slice(&point.position[axis].to_le_bytes());
        record[28 + 2 * axis..30 + 2 * axis].copy_from_slice(&point.color[axis].to_le_bytes());
    }
    record[12..14].copy_from_slice(&point.intensity.to_le_bytes());
    record[14] = 0b0000_1001;
    record[15] = (index % 19) as u8;
    record[GPS_TIME_OFFSET..28].copy_from_slice(&(index as f64).to_le_bytes());
    record
}

/// A whole LAS 1.2 file of format 3.
pub fn las_bytes(points: &[LasPoint], first_index: u64, scale: f64, offset: [f64; 3]) -> Vec<u8> {
    let header_bytes = 227u32;
    let mut file = vec![0; header_bytes as usize];
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, b"LASF");
    put(24, &[1, 2]);
    put(94, &(header_bytes as u16).to_le_bytes());
    put(96, &header_bytes.to_le_bytes());
    put(104, &[3]);
    put(105, &(RECORD_BYTES as u16).to_le_bytes());
    put(107, &(points.len() as u32).to_le_bytes());
    put(111, &(points.len() as u32).to_le_bytes());
    for (axis, offset) in offset.into_iter().enumerate() {
        put(131 + 8 * axis, &scale.to_le_bytes());
        put(155 + 8 * axis, &offset.to_le_bytes());
        let world = points.iter().map(|p| f64::from(p.position[axis]) * scale + offset);
        let (min, max) =
            world.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        put(179 + 16 * axis, &max.to_le_bytes());
        put(187 + 16 * axis, &min.to_le_bytes());
    }
    for (i, point) in points.iter().enumerate() {
        file.extend_from_slice(&record(point, first_index + i as u64));
    }
    file
}

/// Writes a file of format 3 with a scale of 0.001 and offsets as in UTM.
pub fn write_las(path: &Path, points: &[LasPoint]) {
    let bytes = las_bytes(points, 0, 0.001, [500_000.0, 5_000_000.0, 500.0]);
    std::fs::write(path, bytes).expect("the temporary folder takes a file");
}
