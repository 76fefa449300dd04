//! Morton (Z-order) codes of integer cells.
//!
//! A code interleaves the bits of three coordinates, x in the lowest place, so that the top
//! `3 g` bits of a `3 b` bit code name the cell at level `g`. The octant of a cell within its
//! parent is its lowest three bits: 1 for upper x, 2 for upper y, 4 for upper z.

use std::fmt::Debug;
use std::hash::Hash;

/// An unsigned integer wide enough for the Morton codes of one octree.
///
/// `u64` holds 21 bits per axis, `u128` the 32 bits that any integer lattice of scan files needs.
pub trait MortonKey: Copy + Ord + Send + Sync + Debug + Hash + Default + 'static {
    /// Most bits per axis that fit.
    const MAX_BITS: u32;
    /// Bytes of the key.
    const BYTES: usize;

    /// Interleaves three coordinates of at most [`MAX_BITS`](Self::MAX_BITS) bits each.
    fn encode(cell: [u32; 3]) -> Self;
    /// The coordinates that [`encode`](Self::encode) interleaved.
    fn decode(self) -> [u32; 3];
    /// The code of the enclosing cell `levels` levels up.
    fn ancestor(self, levels: u32) -> Self;
    /// Number of low bits in which two codes may differ: 0 if they are equal.
    fn differing_bits(self, other: Self) -> u32;
    /// Levels of the cells that hold both codes, which have so many bits per axis: `bits` if they
    /// are equal.
    #[inline]
    fn shared_levels(self, other: Self, bits: u32) -> u32 {
        bits - self.differing_bits(other).div_ceil(3)
    }
    /// The first code within this cell, `levels` levels down.
    fn first_within(self, levels: u32) -> Self;
    /// The next code.
    fn next(self) -> Self;
    /// Smallest and largest coordinates of cells, per axis; the largest and the smallest numbers
    /// without cells.
    fn bounds(codes: impl Iterator<Item = Self>) -> [[u32; 3]; 2];
    /// Writes the code's [`BYTES`](Self::BYTES) bytes, little-endian.
    fn write(self, bytes: &mut [u8]);
    /// Reads what [`write`](Self::write) wrote.
    fn read(bytes: &[u8]) -> Self;
    /// The lowest `3 bits` bits: the code relative to the cell that encloses it `bits` levels up.
    fn local(self, bits: u32) -> Self;
    /// The low 64 bits.
    fn low_u64(self) -> u64;
    /// The code in the widest type.
    fn widen(self) -> u128;
    /// The inverse of [`widen`](Self::widen) for codes that fit.
    fn narrow(wide: u128) -> Self;
    /// How far this code is behind another that is not larger, if that fits.
    fn offset_from(self, base: Self) -> Option<u64>;
    /// The code so far behind this one.
    fn at_offset(self, offset: u64) -> Self;
}

/// What is done alike to codes of both widths.
macro_rules! same_for_both_widths {
    () => {
        #[inline]
        fn ancestor(self, levels: u32) -> Self {
            self.checked_shr(3 * levels).unwrap_or(0)
        }
        #[inline]
        fn differing_bits(self, other: Self) -> u32 {
            Self::BITS - (self ^ other).leading_zeros()
        }
        fn first_within(self, levels: u32) -> Self {
            self.checked_shl(3 * levels).unwrap_or(0)
        }
        fn next(self) -> Self {
            self + 1
        }
        fn bounds(codes: impl Iterator<Item = Self>) -> [[u32; 3]; 2] {
            // The bits of one axis, left where they are, compare as the coordinate does.
            let axes: [Self; 3] = [
                [u32::MAX >> (32 - Self::MAX_BITS), 0, 0],
                [0, u32::MAX >> (32 - Self::MAX_BITS), 0],
                [0, 0, u32::MAX >> (32 - Self::MAX_BITS)],
            ]
            .map(Self::encode);
            let (mut low, mut high, mut any) = ([Self::MAX; 3], [0; 3], false);
            for code in codes {
                any = true;
                for (i, axis) in axes.iter().enumerate() {
                    low[i] = low[i].min(code & axis);
                    high[i] = high[i].max(code & axis);
                }
            }
            if !any {
                return [[u32::MAX; 3], [0; 3]];
            }
            [low[0] | low[1] | low[2], high[0] | high[1] | high[2]].map(Self::decode)
        }
    };
}

impl MortonKey for u64 {
    const MAX_BITS: u32 = 21;
    const BYTES: usize = 8;

    same_for_both_widths!();

    #[inline]
    fn encode(cell: [u32; 3]) -> Self {
        spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
    }
    fn decode(self) -> [u32; 3] {
        [gather(self), gather(self >> 1), gather(self >> 2)]
    }
    fn write(self, bytes: &mut [u8]) {
        bytes[..8].copy_from_slice(&self.to_le_bytes());
    }
    #[inline]
    fn read(bytes: &[u8]) -> Self {
        u64::from_le_bytes(bytes[..8].try_into().expect("a code has 8 bytes"))
    }
    #[inline]
    fn local(self, bits: u32) -> Self {
        self & 1u64.checked_shl(3 * bits).map_or(u64::MAX, |bit| bit - 1)
    }
    #[inline]
    fn low_u64(self) -> u64 {
        self
    }
    fn widen(self) -> u128 {
        u128::from(self)
    }
    fn narrow(wide: u128) -> Self {
        wide as u64
    }
    #[inline]
    fn offset_from(self, base: Self) -> Option<u64> {
        self.checked_sub(base)
    }
    #[inline]
    fn at_offset(self, offset: u64) -> Self {
        self.wrapping_add(offset)
    }
}

impl MortonKey for u128 {
    const MAX_BITS: u32 = 32;
    const BYTES: usize = 12;

    same_for_both_widths!();

    #[inline]
    fn encode(cell: [u32; 3]) -> Self {
        let low = u64::encode(cell.map(|c| c & 0x1f_ffff));
        let high = u64::encode(cell.map(|c| c >> 21));
        u128::from(low) | u128::from(high) << 63
    }
    fn decode(self) -> [u32; 3] {
        let low = (self as u64 & (u64::MAX >> 1)).decode();
        let high = ((self >> 63) as u64).decode();
        [0, 1, 2].map(|axis| low[axis] | high[axis] << 21)
    }
    fn write(self, bytes: &mut [u8]) {
        bytes[..12].copy_from_slice(&self.to_le_bytes()[..12]);
    }
    #[inline]
    fn read(bytes: &[u8]) -> Self {
        let mut wide = [0; 16];
        wide[..12].copy_from_slice(&bytes[..12]);
        u128::from_le_bytes(wide)
    }
    #[inline]
    fn local(self, bits: u32) -> Self {
        self & 1u128.checked_shl(3 * bits).map_or(u128::MAX, |bit| bit - 1)
    }
    #[inline]
    fn low_u64(self) -> u64 {
        self as u64
    }
    fn widen(self) -> u128 {
        self
    }
    fn narrow(wide: u128) -> Self {
        wide
    }
    #[inline]
    fn offset_from(self, base: Self) -> Option<u64> {
        u64::try_from(self.checked_sub(base)?).ok()
    }
    #[inline]
    fn at_offset(self, offset: u64) -> Self {
        self.wrapping_add(u128::from(offset))
    }
}

/// Spreads the low 21 bits of `v` to every third bit.
#[inline]
fn spread(v: u32) -> u64 {
    let mut x = u64::from(v) & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Collects every third bit of `v`; the inverse of [`spread`].
fn gather(v: u64) -> u32 {
    let mut x = v & 0x1249_2492_4924_9249;
    x = (x ^ x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x ^ x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x ^ x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x ^ x >> 16) & 0x001f_0000_0000_ffff;
    (x ^ x >> 32) as u32 & 0x1f_ffff
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// One bit at a time, straight from the definition.
    fn encode_slowly(cell: [u32; 3], bits: u32) -> u128 {
        let mut code = 0;
        for bit in 0..bits {
            for (axis, c) in cell.iter().enumerate() {
                code |= u128::from(c >> bit & 1) << (3 * bit as usize + axis);
            }
        }
        code
    }

    proptest! {
        #[test]
        fn narrow_codes_match_the_definition(x in 0u32..1 << 21, y in 0u32..1 << 21, z in 0u32..1 << 21) {
            let code = u64::encode([x, y, z]);
            prop_assert_eq!(u128::from(code), encode_slowly([x, y, z], 21));
            prop_assert_eq!(code.decode(), [x, y, z]);
        }

        #[test]
        fn bounds_are_those_of_each_axis(cells in proptest::collection::vec(any::<[u32; 3]>(), 0..20)) {
            let axis = |i: usize| cells.iter().map(move |cell| cell[i]);
            let low = [0, 1, 2].map(|i| axis(i).min().unwrap_or(u32::MAX));
            let high = [0, 1, 2].map(|i| axis(i).max().unwrap_or(0));
            let codes = cells.iter().map(|&cell| u128::encode(cell));
            prop_assert_eq!(u128::bounds(codes), [low, high]);
            let small = |cell: [u32; 3]| cell.map(|c| if c == u32::MAX { c } else { c & 0x1f_ffff });
            let codes = cells.iter().map(|&cell| u64::encode(small(cell)));
            if !cells.is_empty() {
                let [low, high] = u64::bounds(codes);
                let axis = |i: usize| cells.iter().map(move |&cell| small(cell)[i] & 0x1f_ffff);
                prop_assert_eq!(low, [0, 1, 2].map(|i| axis(i).min().unwrap_or(0)));
                prop_assert_eq!(high, [0, 1, 2].map(|i| axis(i).max().unwrap_or(0)));
            }
        }

        #[test]
        fn wide_codes_match_the_definition(x: u32, y: u32, z: u32, level in 0u32..32) {
            let code = u128::encode([x, y, z]);
            prop_assert_eq!(code, encode_slowly([x, y, z], 32));
            prop_assert_eq!(code.decode(), [x, y, z]);
            prop_assert_eq!(code.ancestor(level).decode(), [x >> level, y >> level, z >> level]);
            let mask = ((1u64 << level) - 1) as u32;
            prop_assert_eq!(code.local(level).decode(), [x & mask, y & mask, z & mask]);
        }
    }
}
