//! Numbers out of a stream of bits.

use super::packets::Stream;

/// How the numbers of a stream are written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coding {
    /// Single precision.
    Single,
    /// Double precision.
    Double,
    /// Differences to a smallest value, in as few bits as the range needs.
    Integer {
        /// The smallest value.
        min: i64,
        /// Bits of a number.
        bits: u32,
    },
}

impl Coding {
    /// Bits of a number.
    pub fn width(self) -> u32 {
        match self {
            Coding::Single => 32,
            Coding::Double => 64,
            Coding::Integer { bits, .. } => bits,
        }
    }

    /// Calls `take` with each number as a float; integers beyond 2^53 are rounded.
    pub fn each_float(self, stream: &Stream, mut take: impl FnMut(usize, f64)) {
        match self {
            Coding::Single => self.each_word(stream, |row, bits| {
                take(row, f64::from(f32::from_bits(bits as u32)));
            }),
            Coding::Double => self.each_word(stream, |row, bits| take(row, f64::from_bits(bits))),
            Coding::Integer { min, .. } => self.each_word(stream, |row, bits| {
                take(row, min.wrapping_add(bits as i64) as f64);
            }),
        }
    }

    /// Calls `take` with each integer; fractions are cut off.
    pub fn each_integer(self, stream: &Stream, mut take: impl FnMut(usize, i64)) {
        match self {
            Coding::Integer { min, .. } => self.each_word(stream, |row, bits| {
                take(row, min.wrapping_add(bits as i64));
            }),
            Coding::Single => self.each_word(stream, |row, bits| {
                take(row, f32::from_bits(bits as u32) as i64);
            }),
            Coding::Double => self.each_word(stream, |row, bits| {
                take(row, f64::from_bits(bits) as i64);
            }),
        }
    }

    fn each_word(self, stream: &Stream, mut take: impl FnMut(usize, u64)) {
        let width = self.width();
        let mask = if width >= 64 { u64::MAX } else { (1 << width) - 1 };
        let mut bit = stream.first_bit as usize;
        // A number of up to 57 bits lies within 8 bytes wherever it starts.
        if width <= 57 {
            for row in 0..stream.records {
                let at = bit / 8;
                let word = u64::from_le_bytes(
                    stream.bytes[at..at + 8].try_into().expect("the slice has 8 bytes"),
                );
                take(row, word >> (bit % 8) & mask);
                bit += width as usize;
            }
        } else {
            for row in 0..stream.records {
                let at = bit / 8;
                let word = u128::from_le_bytes(
                    stream.bytes[at..at + 16].try_into().expect("the slice has 16 bytes"),
                );
                take(row, (word >> (bit % 8)) as u64 & mask);
                bit += width as usize;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(bytes: &[u8], first_bit: u32, records: usize) -> Stream {
        Stream { bytes: [bytes, &[0; 16]].concat(), first_bit, records }
    }

    #[test]
    fn integers_of_any_width_come_out() {
        for width in [0u32, 1, 3, 8, 13, 31, 57, 58, 63, 64] {
            let min = -5i64;
            let mask = if width == 64 { u64::MAX } else { (1u64 << width) - 1 };
            let words: Vec<u64> =
                (0..40u64).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) & mask).collect();
            let mut bytes = vec![0u8; (40 * width as usize).div_ceil(8)];
            for (i, word) in words.iter().enumerate() {
                for bit in 0..width as usize {
                    let place = i * width as usize + bit;
                    bytes[place / 8] |= ((word >> bit & 1) as u8) << (place % 8);
                }
            }
            let coding = Coding::Integer { min, bits: width };
            let skipped = 40 * width as usize / 5 / 8 * 8;
            let first = if width == 0 { 0 } else { skipped.div_ceil(width as usize) };
            let start = first * width as usize;
            let part = stream(&bytes[start / 8..], (start % 8) as u32, 40 - first);
            let mut found = Vec::new();
            coding.each_integer(&part, |_, value| found.push(value.wrapping_sub(min) as u64));
            assert_eq!(found, words[first..], "width {width}");
        }
    }

    #[test]
    fn floats_come_out() {
        let bytes = [1.5f32.to_le_bytes(), (-2.25f32).to_le_bytes()].concat();
        let mut found = Vec::new();
        Coding::Single.each_float(&stream(&bytes, 0, 2), |_, value| found.push(value));
        assert_eq!(found, [1.5, -2.25]);
    }
}
