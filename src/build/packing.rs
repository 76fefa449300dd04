//! Rows made shorter for the temporary file: quickly rather than much.
//!
//! Rows of a page come from one place and mostly from one pass of the scanner, so many of their
//! bytes change little from row to row. Of 64 rows at a time each byte becomes its zigzag-coded
//! difference to the one above it; of the 64 differences in a column only as many bits are kept as
//! the largest needs. A width of 5 is 4 bits and 1 bit, each packed on its own, so that all loops
//! are over whole bytes.
//!
//! Layout of packed rows: the length of a row (`u32`), then per 64 rows a nibble of width per
//! column, then the columns' bits.

/// Rows that are packed together.
pub const GROUP: usize = 64;

/// Memory for packing and unpacking.
#[derive(Default)]
pub struct Packer {
    /// Differences of a group, row by row.
    differences: Vec<u8>,
    /// The row above the group.
    above: Vec<u8>,
    /// Per column all differences or-ed.
    all: Vec<u8>,
    /// The packed bytes.
    pub bytes: Vec<u8>,
}

impl Packer {
    /// Packs rows of `stride` bytes into `bytes`; whether that makes them shorter.
    pub fn pack(&mut self, rows: &[u8], stride: usize) -> bool {
        if stride == 0 || rows.len() < GROUP * stride || !rows.len().is_multiple_of(stride) {
            return false;
        }
        let Packer { differences, above, all, bytes } = self;
        bytes.clear();
        bytes.extend_from_slice(&(stride as u32).to_le_bytes());
        differences.resize(GROUP * stride, 0);
        above.clear();
        above.resize(stride, 0);
        for group in rows.chunks(GROUP * stride) {
            let (coded, unused) = differences.split_at_mut(group.len());
            unused.fill(0);
            let (first, others) = coded.split_at_mut(stride);
            code(&group[..stride], above, first);
            code(&group[stride..], group, others);
            above.copy_from_slice(&group[group.len() - stride..]);
            all.clear();
            all.resize(stride, 0);
            for row in differences.chunks_exact(stride) {
                all.iter_mut().zip(row).for_each(|(all, byte)| *all |= byte);
            }
            let width = |all: &u8| u8::BITS - all.leading_zeros();
            bytes.extend(all.chunks(2).map(|pair| {
                let [low, high] = [&pair[0], pair.get(1).unwrap_or(&0)].map(width);
                (low | high << 4) as u8
            }));
            for (c, width) in all.iter().map(width).enumerate().filter(|&(_, width)| width > 0) {
                let mut column = [0; GROUP];
                for (byte, row) in column.iter_mut().zip(differences.chunks_exact(stride)) {
                    *byte = row[c];
                }
                push_bits(&column, width, bytes);
            }
            if bytes.len() >= rows.len() {
                return false;
            }
        }
        true
    }

    /// Unpacks what [`pack`](Self::pack) made of as many rows as fill `rows`; whether it could be
    /// that.
    pub fn unpack(&mut self, packed: &[u8], rows: &mut [u8]) -> bool {
        self.try_unpack(packed, rows).is_some()
    }

    fn try_unpack(&mut self, packed: &[u8], rows: &mut [u8]) -> Option<()> {
        let Packer { differences, above, .. } = self;
        let (stride, mut rest) = packed.split_first_chunk::<4>()?;
        let stride = u32::from_le_bytes(*stride) as usize;
        // Even columns without a bit have their widths.
        if stride == 0 || !rows.len().is_multiple_of(stride) || stride > 2 * packed.len() {
            return None;
        }
        differences.resize(GROUP * stride, 0);
        above.clear();
        above.resize(stride, 0);
        for group in rows.chunks_mut(GROUP * stride) {
            differences.fill(0);
            let widths;
            (widths, rest) = rest.split_at_checked(stride.div_ceil(2))?;
            for c in 0..stride {
                let width = widths[c / 2] >> (c % 2 * 4) & 15;
                if width > 0 {
                    let mut column = [0; GROUP];
                    rest = take_bits(rest, u32::from(width), &mut column)?;
                    for (row, byte) in differences.chunks_exact_mut(stride).zip(column) {
                        row[c] = byte;
                    }
                }
            }
            let rows = group.chunks_exact_mut(stride).zip(differences.chunks_exact(stride));
            for (row, coded) in rows {
                for ((byte, above), coded) in row.iter_mut().zip(above.iter_mut()).zip(coded) {
                    *above = above.wrapping_add(unzigzag(*coded));
                    *byte = *above;
                }
            }
        }
        rest.is_empty().then_some(())
    }
}

/// Fills `coded` with the differences of bytes to those above them.
fn code(bytes: &[u8], above: &[u8], coded: &mut [u8]) {
    for ((coded, byte), above) in coded.iter_mut().zip(bytes).zip(above) {
        *coded = zigzag(byte.wrapping_sub(*above));
    }
}

fn zigzag(difference: u8) -> u8 {
    difference << 1 ^ 0u8.wrapping_sub(difference >> 7)
}

fn unzigzag(coded: u8) -> u8 {
    coded >> 1 ^ 0u8.wrapping_sub(coded & 1)
}

/// Appends the lowest `width` bits of each.
fn push_bits(column: &[u8; GROUP], width: u32, bytes: &mut Vec<u8>) {
    if width == 8 {
        return bytes.extend_from_slice(column);
    }
    let mut low = 0;
    if width & 4 != 0 {
        push::<4, 32>(column, low, bytes);
        low += 4;
    }
    if width & 2 != 0 {
        push::<2, 16>(column, low, bytes);
        low += 2;
    }
    if width & 1 != 0 {
        push::<1, 8>(column, low, bytes);
    }
}

/// Appends `W` bits of each from bit `low` up, in `N` bytes.
fn push<const W: usize, const N: usize>(column: &[u8; GROUP], low: usize, bytes: &mut Vec<u8>) {
    let mask = (1u8 << W) - 1;
    let mut packed = [0u8; N];
    for (k, part) in column.chunks_exact(N).enumerate() {
        for (packed, byte) in packed.iter_mut().zip(part) {
            *packed |= (byte >> low & mask) << (k * W);
        }
    }
    bytes.extend_from_slice(&packed);
}

/// Reads what [`push_bits`] appended; returns what is behind it.
fn take_bits<'a>(mut rest: &'a [u8], width: u32, column: &mut [u8; GROUP]) -> Option<&'a [u8]> {
    if width >= 8 {
        let (bytes, rest) = rest.split_first_chunk::<GROUP>()?;
        *column = *bytes;
        return (width == 8).then_some(rest);
    }
    column.fill(0);
    let mut low = 0;
    if width & 4 != 0 {
        rest = take::<4, 32>(rest, low, column)?;
        low += 4;
    }
    if width & 2 != 0 {
        rest = take::<2, 16>(rest, low, column)?;
        low += 2;
    }
    if width & 1 != 0 {
        rest = take::<1, 8>(rest, low, column)?;
    }
    Some(rest)
}

fn take<'a, const W: usize, const N: usize>(
    rest: &'a [u8],
    low: usize,
    column: &mut [u8; GROUP],
) -> Option<&'a [u8]> {
    let mask = (1u8 << W) - 1;
    let (packed, rest) = rest.split_first_chunk::<N>()?;
    for (k, part) in column.chunks_exact_mut(N).enumerate() {
        for (byte, packed) in part.iter_mut().zip(packed) {
            *byte |= (packed >> (k * W) & mask) << low;
        }
    }
    Some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rows_come_back(
            stride in 1usize..40,
            count in 64usize..300,
            noise in proptest::collection::vec(0u32..=8, 40),
            seed: u64,
        ) {
            let mut state = seed;
            let mut rows = vec![0; stride * count];
            for row in rows.chunks_exact_mut(stride) {
                for (byte, noise) in row.iter_mut().zip(&noise) {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    *byte = ((state >> 56) as u32 & ((1 << noise) - 1)) as u8;
                }
            }
            let mut packer = Packer::default();
            let is_shorter = packer.pack(&rows, stride);
            // A bit of differences more than of noise, a nibble of width for 64 values.
            let bits: usize = noise[..stride].iter().map(|&n| (n as usize + 1).min(8)).sum();
            prop_assert!(is_shorter || bits + stride >= 8 * stride || !count.is_multiple_of(64));
            if is_shorter {
                let packed = packer.bytes.clone();
                prop_assert!(packed.len() < rows.len());
                let mut back = vec![0xaa; rows.len()];
                prop_assert!(packer.unpack(&packed, &mut back));
                prop_assert_eq!(&back, &rows);
                prop_assert!(!packer.unpack(&packed[..packed.len() - 1], &mut back));
            }
        }

        #[test]
        fn foreign_bytes_are_refused_or_rows(
            bytes in proptest::collection::vec(any::<u8>(), 0..400),
            length in 0usize..400,
        ) {
            let mut packed = bytes;
            // A stride that may fit.
            packed.iter_mut().take(4).skip(1).for_each(|byte| *byte = 0);
            Packer::default().unpack(&packed, &mut vec![0; length]);
        }
    }

    #[test]
    fn what_repeats_shrinks_and_noise_stays_as_it_is() {
        let mut packer = Packer::default();
        let rows: Vec<u8> = (0..2048u32).flat_map(|i| [1, 2, 3, i as u8, (i >> 8) as u8]).collect();
        assert!(packer.pack(&rows, 5));
        // 2 bits of differences in one column, 1 in another every 4th group; 3 bytes of widths.
        assert!(packer.bytes.len() < 2048 * 5 / 10, "{}", packer.bytes.len());
        let noise: Vec<u8> =
            (0..2048u32).map(|i| (i.wrapping_mul(2654435761) >> 24) as u8).collect();
        assert!(!packer.pack(&noise, 1));
    }
}
