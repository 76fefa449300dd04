//! Records of one source in the layout and on the lattice of the store.

use glam::DVec3;

use crate::build::sources::layout::Move;
use crate::points::{COORDINATE_BYTES, Lattice, Scalar, record_coordinates};

/// What to do with the coordinates of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coordinates {
    /// They are on the store's lattice, up to the source's shift.
    Keep,
    /// Whole multiples of the store's steps: `coordinate * factor + shift`, per axis.
    Scale {
        /// Steps of the store in one of the source.
        factor: [i64; 3],
        /// Steps between the origins.
        shift: [i64; 3],
    },
    /// No common steps: the nearest position.
    Round {
        /// The source's lattice.
        from: Lattice,
        /// The store's.
        to: Lattice,
    },
}

/// How records of a source become records of the store.
#[derive(Clone, Debug)]
pub struct Adapter {
    /// Size of the source's records.
    pub source_bytes: usize,
    /// Size of the store's records.
    pub store_bytes: usize,
    /// What to do with coordinates.
    pub coordinates: Coordinates,
    /// What to do with attributes.
    pub moves: Vec<Move>,
    /// Where the index of the source stands, and its type.
    pub source_place: Option<(usize, Scalar)>,
}

/// The first record whose coordinates do not fit.
#[derive(Debug, PartialEq, Eq)]
pub struct OutOfReach(pub usize);

impl Adapter {
    /// Replaces `adapted` by the records in the store's layout, all of them with that source.
    pub fn apply(
        &self,
        records: &[u8],
        source: u32,
        adapted: &mut Vec<u8>,
    ) -> Result<(), OutOfReach> {
        let count = records.len() / self.source_bytes;
        adapted.clear();
        adapted.resize(count * self.store_bytes, 0);
        self.place(records, adapted)?;
        for step in &self.moves {
            self.carry_out(step, records, adapted);
        }
        if let Some((at, scalar)) = self.source_place {
            let bytes = source.to_le_bytes();
            let value = &bytes[..scalar.bytes()];
            for record in adapted.chunks_exact_mut(self.store_bytes) {
                record[at..at + value.len()].copy_from_slice(value);
            }
        }
        Ok(())
    }

    fn place(&self, records: &[u8], adapted: &mut [u8]) -> Result<(), OutOfReach> {
        let pairs = || records.chunks_exact(self.source_bytes);
        let targets = adapted.chunks_exact_mut(self.store_bytes);
        match self.coordinates {
            Coordinates::Keep => {
                for (from, to) in pairs().zip(targets) {
                    to[..COORDINATE_BYTES].copy_from_slice(&from[..COORDINATE_BYTES]);
                }
            }
            Coordinates::Scale { factor, shift } => {
                for (row, (from, to)) in pairs().zip(targets).enumerate() {
                    let position = record_coordinates(from);
                    for axis in 0..3 {
                        let steps = i64::from(position[axis])
                            .checked_mul(factor[axis])
                            .and_then(|steps| steps.checked_add(shift[axis]))
                            .and_then(|steps| i32::try_from(steps).ok())
                            .ok_or(OutOfReach(row))?;
                        to[4 * axis..4 * axis + 4].copy_from_slice(&steps.to_le_bytes());
                    }
                }
            }
            Coordinates::Round { from: own, to: store } => {
                let most = DVec3::splat(f64::from(i32::MAX));
                for (row, (from, to)) in pairs().zip(targets).enumerate() {
                    let position = record_coordinates(from).map(i64::from);
                    let steps = store.lattice(own.world(position.into())).round();
                    if !steps.abs().cmple(most).all() {
                        return Err(OutOfReach(row));
                    }
                    let steps = steps.as_ivec3();
                    for axis in 0..3 {
                        to[4 * axis..4 * axis + 4].copy_from_slice(&steps[axis].to_le_bytes());
                    }
                }
            }
        }
        Ok(())
    }

    fn carry_out(&self, step: &Move, records: &[u8], adapted: &mut [u8]) {
        let pairs =
            records.chunks_exact(self.source_bytes).zip(adapted.chunks_exact_mut(self.store_bytes));
        match *step {
            Move::Copy { from, to, bytes } => {
                for (source, target) in pairs {
                    target[to..to + bytes].copy_from_slice(&source[from..from + bytes]);
                }
            }
            Move::Convert { from: (from, own), to: (to, wide), components } => {
                for (source, target) in pairs {
                    for i in 0..components {
                        let value = &source[from + i * own.bytes()..];
                        convert(own, value, wide, &mut target[to + i * wide.bytes()..]);
                    }
                }
            }
            Move::Returns { from, to } => {
                for (source, target) in pairs {
                    let byte = source[from];
                    target[to] = byte & 0x07 | (byte >> 3 & 0x07) << 4;
                }
            }
            Move::Flags { returns, class, to } => {
                for (source, target) in pairs {
                    target[to] = source[class] >> 5 | source[returns] & 0xc0;
                }
            }
            Move::Class { from, to } => {
                for (source, target) in pairs {
                    target[to] = source[from] & 0x1f;
                }
            }
            Move::ScanAngle { from, to } => {
                for (source, target) in pairs {
                    let degrees = f64::from(source[from] as i8);
                    let units = (degrees / 0.006).round() as i16;
                    target[to..to + 2].copy_from_slice(&units.to_le_bytes());
                }
            }
        }
    }
}

/// Writes a value in a type that holds it.
fn convert(from: Scalar, value: &[u8], to: Scalar, target: &mut [u8]) {
    let integer = match from {
        Scalar::U64 => {
            i128::from(u64::from_le_bytes(value[..8].try_into().expect("the slice has 8 bytes")))
        }
        Scalar::I64 => {
            i128::from(i64::from_le_bytes(value[..8].try_into().expect("the slice has 8 bytes")))
        }
        Scalar::F32 | Scalar::F64 => 0,
        _ => from.read(value) as i128,
    };
    match to {
        Scalar::F32 => target[..4].copy_from_slice(&(from.read(value) as f32).to_le_bytes()),
        Scalar::F64 => target[..8].copy_from_slice(&from.read(value).to_le_bytes()),
        _ => {
            let bytes = to.bytes();
            target[..bytes].copy_from_slice(&integer.to_le_bytes()[..bytes]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(moves: Vec<Move>) -> Adapter {
        Adapter {
            source_bytes: 20,
            store_bytes: 24,
            coordinates: Coordinates::Scale { factor: [10, 10, 1], shift: [5, 0, -1] },
            moves,
            source_place: Some((22, Scalar::U16)),
        }
    }

    fn record(position: [i32; 3], rest: [u8; 8]) -> Vec<u8> {
        let mut record: Vec<u8> = position.iter().flat_map(|c| c.to_le_bytes()).collect();
        record.extend(rest);
        record
    }

    #[test]
    fn old_fields_become_new_ones() {
        let moves = vec![
            Move::Returns { from: 14, to: 14 },
            Move::Flags { returns: 14, class: 15, to: 15 },
            Move::Class { from: 15, to: 16 },
            Move::ScanAngle { from: 16, to: 18 },
            Move::Convert { from: (12, Scalar::U16), to: (12, Scalar::U16), components: 1 },
        ];
        // Return 2 of 3, scan direction and edge; class 6, synthetic and withheld; -15 degrees.
        let source = record([7, -3, 2], [0x34, 0x12, 0b1101_1010, 0b1010_0110, 241, 9, 1, 0]);
        let mut adapted = Vec::new();
        adapter(moves).apply(&source, 258, &mut adapted).unwrap();
        assert_eq!(record_coordinates(&adapted), [75, -30, 1]);
        assert_eq!(adapted[12..14], [0x34, 0x12]);
        assert_eq!(adapted[14], 0x32, "return 2 of 3");
        assert_eq!(adapted[15], 0b1100_0101, "edge, direction, withheld, synthetic");
        assert_eq!(adapted[16], 6);
        assert_eq!(i16::from_le_bytes([adapted[18], adapted[19]]), -2500);
        assert_eq!(adapted[22..24], [2, 1]);
    }

    #[test]
    fn coordinates_beyond_32_bits_are_told() {
        let records = [record([1, 1, 1], [0; 8]), record([300_000_000, 0, 0], [0; 8])].concat();
        let outcome = adapter(Vec::new()).apply(&records, 0, &mut Vec::new());
        assert_eq!(outcome, Err(OutOfReach(1)));
    }

    #[test]
    fn values_keep_their_worth_in_wider_types() {
        let cases: [(Scalar, Vec<u8>, Scalar); 4] = [
            (Scalar::I8, vec![0xf0], Scalar::I64),
            (Scalar::U32, 4_000_000_000u32.to_le_bytes().into(), Scalar::I64),
            (Scalar::U16, vec![0xff, 0xff], Scalar::F32),
            (Scalar::F32, (-1.25f32).to_le_bytes().into(), Scalar::F64),
        ];
        for (from, bytes, to) in cases {
            let mut target = [0; 8];
            convert(from, &bytes, to, &mut target);
            assert_eq!(to.read(&target), from.read(&bytes), "{from:?} as {to:?}");
        }
    }
}
