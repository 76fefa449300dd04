//! GPS times of LAZ points.
//!
//! Up to four sequences of times run side by side; each time continues one of them or begins
//! another. The decoder of `laz` calls itself for each symbol that switches to another sequence,
//! and a crafted file holds millions of these in a row, for which no stack is large enough. Here
//! it is a loop, and it ends: encoders switch once at most, because one step reaches any sequence.

use std::io::{self, Read};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::FieldDecompressor;

/// Largest multiple of the last difference with a symbol of its own.
const MOST_MULTIPLE: i32 = 500;
/// The negative multiples follow, up to this one.
const LEAST_MULTIPLE: i32 = -10;
/// Most switches in a row.
const MOST_SWITCHES: u32 = 16;
const SEQUENCES: usize = 4;

/// Which symbols there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeSymbols {
    /// Version 2 items: one symbol says that the time is that of the point before.
    WithUnchanged,
    /// Versions 3 and 4: that is told elsewhere.
    OnlyChanged,
}

/// What the decoder remembers of the times so far.
pub(super) struct Times {
    has_unchanged: u32,
    last: usize,
    next: usize,
    times: [i64; SEQUENCES],
    differences: [i32; SEQUENCES],
    /// How often in a row a difference was far from the one before.
    extremes: [u32; SEQUENCES],
    first_symbol: ArithmeticModel,
    multiple: ArithmeticModel,
    correction: IntegerDecompressor,
}

impl Times {
    /// With the first time, as its bits.
    pub fn new(symbols: TimeSymbols, first: i64) -> Self {
        let has_unchanged = u32::from(symbols == TimeSymbols::WithUnchanged);
        let multiples = (MOST_MULTIPLE - LEAST_MULTIPLE + 1) as u32;
        Times {
            has_unchanged,
            last: 0,
            next: 0,
            times: [first, 0, 0, 0],
            differences: [0; SEQUENCES],
            extremes: [0; SEQUENCES],
            first_symbol: ArithmeticModelBuilder::new(5 + has_unchanged).build(),
            multiple: ArithmeticModelBuilder::new(multiples + 4 + has_unchanged).build(),
            correction: IntegerDecompressorBuilder::new().bits(32).contexts(9).build_initialized(),
        }
    }

    /// The last time, as its bits.
    pub fn time(&self) -> i64 {
        self.times[self.last]
    }

    /// Decodes the next time.
    pub fn decode<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<()> {
        for _ in 0..=MOST_SWITCHES {
            let switch = if self.differences[self.last] == 0 {
                self.decode_first(decoder)?
            } else {
                self.decode_next(decoder)?
            };
            let Some(sequences) = switch else { return Ok(()) };
            self.last = (self.last + sequences as usize) % SEQUENCES;
        }
        let reason = format!("its GPS times switch more than {MOST_SWITCHES} times in a row");
        Err(io::Error::new(io::ErrorKind::InvalidData, reason))
    }

    /// The symbol where there was no difference yet; how many sequences further, if it switches.
    fn decode_first<R: Read>(
        &mut self,
        decoder: &mut ArithmeticDecoder<R>,
    ) -> io::Result<Option<u32>> {
        let symbol = decoder.decode_symbol(&mut self.first_symbol)?;
        match symbol + 1 - self.has_unchanged {
            0 => {}
            1 => {
                let difference = self.correction.decompress(decoder, 0, 0)?;
                self.differences[self.last] = difference;
                self.advance(difference);
                self.extremes[self.last] = 0;
            }
            2 => self.begin(decoder)?,
            more => return Ok(Some(more - 2)),
        }
        Ok(None)
    }

    /// The symbol where there was one.
    fn decode_next<R: Read>(
        &mut self,
        decoder: &mut ArithmeticDecoder<R>,
    ) -> io::Result<Option<u32>> {
        let symbol = decoder.decode_symbol(&mut self.multiple)? as i32;
        let before = self.differences[self.last];
        let past_multiples = MOST_MULTIPLE - LEAST_MULTIPLE + 1;
        if symbol >= past_multiples {
            return match (symbol - past_multiples) as u32 {
                0 if self.has_unchanged == 1 => Ok(None),
                other if other == self.has_unchanged => self.begin(decoder).map(|()| None),
                other => Ok(Some(other - self.has_unchanged)),
            };
        }
        let multiple = if symbol > MOST_MULTIPLE { MOST_MULTIPLE - symbol } else { symbol };
        let context = match multiple {
            1 => 1,
            0 => 7,
            2..10 => 2,
            10..MOST_MULTIPLE => 3,
            MOST_MULTIPLE => 4,
            LEAST_MULTIPLE => 6,
            _ => 5,
        };
        let predicted = multiple.wrapping_mul(before);
        let difference = self.correction.decompress(decoder, predicted, context)?;
        self.advance(difference);
        match multiple {
            1 => self.extremes[self.last] = 0,
            0 | MOST_MULTIPLE | LEAST_MULTIPLE => {
                self.extremes[self.last] += 1;
                if self.extremes[self.last] > 3 {
                    self.differences[self.last] = difference;
                    self.extremes[self.last] = 0;
                }
            }
            _ => {}
        }
        Ok(None)
    }

    fn advance(&mut self, difference: i32) {
        self.times[self.last] = self.times[self.last].wrapping_add(i64::from(difference));
    }

    /// Begins a sequence in the place of the oldest.
    fn begin<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> io::Result<()> {
        let predicted = (self.time() >> 32) as i32;
        let high = self.correction.decompress(decoder, predicted, 8)?;
        let low = decoder.read_int()?;
        self.next = (self.next + 1) % SEQUENCES;
        self.last = self.next;
        self.times[self.last] = i64::from(high) << 32 | i64::from(low);
        self.differences[self.last] = 0;
        self.extremes[self.last] = 0;
        Ok(())
    }
}

/// GPS times as an item of pointwise chunks, version 2.
pub(super) struct PointwiseTimes(Times);

impl PointwiseTimes {
    /// Before the first point.
    pub fn new() -> Self {
        PointwiseTimes(Times::new(TimeSymbols::WithUnchanged, 0))
    }
}

impl<R: Read> FieldDecompressor<R> for PointwiseTimes {
    fn size_of_field(&self) -> usize {
        8
    }

    fn decompress_first(&mut self, input: &mut R, first: &mut [u8]) -> io::Result<()> {
        input.read_exact(first)?;
        let bits = i64::from_le_bytes((*first).try_into().expect("the field has 8 bytes"));
        self.0 = Times::new(TimeSymbols::WithUnchanged, bits);
        Ok(())
    }

    fn decompress_with(
        &mut self,
        decoder: &mut ArithmeticDecoder<R>,
        field: &mut [u8],
    ) -> io::Result<()> {
        self.0.decode(decoder)?;
        field.copy_from_slice(&self.0.time().to_le_bytes());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use laz::LazItemRecordBuilder;
    use laz::encoders::ArithmeticEncoder;
    use laz::record::{
        RecordCompressor, RecordDecompressor, SequentialPointRecordCompressor,
        SequentialPointRecordDecompressor,
    };
    use proptest::prelude::*;
    use std::io::Cursor;

    /// Decodes one time out of so many switches, then what begins a sequence.
    fn after_switches(symbols: TimeSymbols, switches: usize) -> io::Result<i64> {
        let count = if symbols == TimeSymbols::WithUnchanged { 6 } else { 5 };
        let mut model = ArithmeticModelBuilder::new(count).with_compression(true).build();
        let mut encoder = ArithmeticEncoder::new(Cursor::new(Vec::new()));
        for _ in 0..switches {
            encoder.encode_symbol(&mut model, count - 1).expect("it encodes");
        }
        // The time did not change, or a small difference.
        encoder.encode_symbol(&mut model, 0).expect("it encodes");
        encoder.write_int(0).expect("it encodes");
        encoder.done().expect("it ends");
        let bytes = encoder.into_inner().into_inner();
        let mut decoder = ArithmeticDecoder::new(Cursor::new(bytes));
        decoder.read_init_bytes()?;
        let mut times = Times::new(symbols, 42);
        times.decode(&mut decoder)?;
        Ok(times.time())
    }

    #[test]
    fn endless_switches_are_an_error() {
        for symbols in [TimeSymbols::WithUnchanged, TimeSymbols::OnlyChanged] {
            // Four steps of a symbol that goes around once, or by one sequence, come back.
            after_switches(symbols, 4).expect("so many are allowed");
            let error = after_switches(symbols, 1_000_000).expect_err("so many are not");
            assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{error}");
        }
    }

    proptest! {
        /// What `laz` encodes pointwise comes out again.
        #[test]
        fn times_come_back(steps in proptest::collection::vec((0u8..8, any::<i64>()), 2..600)) {
            let items = LazItemRecordBuilder::version_2_of::<laz::las::Point1>(0);
            let mut time = 0x4100_0000_0000_0000i64;
            let mut step_before = 1000;
            let times: Vec<i64> = steps.iter().map(|&(kind, by)| {
                step_before = match kind {
                    0 => by >> 1,
                    1 => by >> 20,
                    2 => by >> 44,
                    3 => 0,
                    4 => step_before.wrapping_mul(-3),
                    _ => step_before.wrapping_mul(kind.into()),
                };
                time = time.wrapping_add(step_before);
                time
            }).collect();
            let record = |time: &i64| [&[7; 20][..], &time.to_le_bytes()].concat();
            let mut compressor = SequentialPointRecordCompressor::new(Cursor::new(Vec::new()));
            compressor.set_fields_from(&items).expect("known items");
            for time in &times {
                compressor.compress_next(&record(time)).expect("it compresses");
            }
            compressor.done().expect("it ends");
            let bytes = Box::new(compressor).box_into_inner().into_inner();
            let mut decompressor = SequentialPointRecordDecompressor::new(Cursor::new(bytes));
            decompressor.set_fields_from(&items[..1].to_vec()).expect("known items");
            decompressor.add_field_decompressor(PointwiseTimes::new());
            for time in &times {
                let mut back = vec![0; 28];
                decompressor.decompress_next(&mut back).expect("it decodes");
                prop_assert_eq!(&back, &record(time));
            }
        }
    }
}
