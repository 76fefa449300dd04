//! The layered coding of points since LAS 1.4: coordinates, returns, classes and times.
//!
//! The crate `laz` has a decoder for this, too; this one stands in its place because of its GPS
//! times (`laz_times`). Symbols, numbers and their models are `laz`'s. A field whose layer is
//! empty keeps the value that it has in the first point.
//!
//! After: the LASzip file format as its encoder defines it, item versions 3 and 4.

use std::io::{self, Cursor, Read, Seek};

use laz::DecompressionSelection;
use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::LayeredFieldDecompressor;

use super::laz_times::{TimeSymbols, Times};

/// Bytes of the item in a record.
const ITEM_BYTES: usize = 30;

/// Which of six models of coordinate differences fits a return, by number of returns and number of
/// the return.
const RETURN_MAP: [[u8; 16]; 16] = [
    [0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5],
    [1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3],
    [2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3],
    [3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5],
];

/// The point before, field by field as in the record.
#[derive(Clone, Copy, Default)]
struct Point {
    xyz: [i32; 3],
    intensity: u16,
    return_number: u8,
    returns: u8,
    /// Four flags of the classification, direction of the scan, edge of the flight line.
    flags: u8,
    channel: u8,
    class: u8,
    user_data: u8,
    scan_angle: i16,
    source: u16,
    time_bits: i64,
    has_new_time: bool,
}

impl Point {
    fn read(item: &[u8; ITEM_BYTES]) -> Self {
        let i32_at = |at| i32::from_le_bytes([item[at], item[at + 1], item[at + 2], item[at + 3]]);
        let u16_at = |at| u16::from_le_bytes([item[at], item[at + 1]]);
        Point {
            xyz: [0, 4, 8].map(i32_at),
            intensity: u16_at(12),
            return_number: item[14] & 15,
            returns: item[14] >> 4,
            flags: item[15] & 15 | item[15] >> 2 & 0x30,
            channel: item[15] >> 4 & 3,
            class: item[16],
            user_data: item[17],
            scan_angle: u16_at(18) as i16,
            source: u16_at(20),
            time_bits: i64::from_le_bytes(item[22..].try_into().expect("8 bytes are left")),
            has_new_time: false,
        }
    }

    fn write(&self, item: &mut [u8]) {
        for (to, value) in item.chunks_exact_mut(4).zip(self.xyz) {
            to.copy_from_slice(&value.to_le_bytes());
        }
        item[12..14].copy_from_slice(&self.intensity.to_le_bytes());
        item[14] = self.returns << 4 | self.return_number;
        item[15] = self.flags & 15 | (self.flags & 0x30) << 2 | self.channel << 4;
        item[16] = self.class;
        item[17] = self.user_data;
        item[18..20].copy_from_slice(&self.scan_angle.to_le_bytes());
        item[20..22].copy_from_slice(&self.source.to_le_bytes());
        item[22..30].copy_from_slice(&self.time_bits.to_le_bytes());
    }
}

/// The running median of coordinate differences: five numbers in order, of which the largest and
/// the smallest make room by turns.
#[derive(Clone, Copy)]
struct Median {
    sorted: [i32; 5],
    drops_largest: bool,
}

impl Median {
    const NEW: Median = Median { sorted: [0; 5], drops_largest: true };

    fn get(&self) -> i32 {
        self.sorted[2]
    }

    fn add(&mut self, value: i32) {
        let median = self.get();
        if self.drops_largest {
            let mut at = 4;
            while at > 0 && value < self.sorted[at - 1] {
                self.sorted[at] = self.sorted[at - 1];
                at -= 1;
            }
            self.sorted[at] = value;
            self.drops_largest = value < median;
        } else {
            let mut at = 0;
            while at < 4 && self.sorted[at + 1] < value {
                self.sorted[at] = self.sorted[at + 1];
                at += 1;
            }
            self.sorted[at] = value;
            self.drops_largest = value <= median;
        }
    }
}

/// What is remembered of the points of one scanner channel.
struct Context {
    last: Point,
    intensities: [u16; 8],
    x_differences: [Median; 12],
    y_differences: [Median; 12],
    heights: [i32; 8],
    changes: [ArithmeticModel; 8],
    channel: ArithmeticModel,
    returns: [Option<ArithmeticModel>; 16],
    return_number: [Option<ArithmeticModel>; 16],
    return_number_same_time: ArithmeticModel,
    class: [Option<ArithmeticModel>; 64],
    flags: [Option<ArithmeticModel>; 64],
    user_data: [Option<ArithmeticModel>; 64],
    dx: IntegerDecompressor,
    dy: IntegerDecompressor,
    z: IntegerDecompressor,
    intensity: IntegerDecompressor,
    scan_angle: IntegerDecompressor,
    source: IntegerDecompressor,
    times: Times,
}

impl Context {
    fn new(last: Point) -> Box<Self> {
        let model = |symbols| ArithmeticModelBuilder::new(symbols).build();
        let integer = |bits, contexts| {
            IntegerDecompressorBuilder::new().bits(bits).contexts(contexts).build_initialized()
        };
        Box::new(Context {
            last: Point { has_new_time: false, ..last },
            intensities: [last.intensity; 8],
            x_differences: [Median::NEW; 12],
            y_differences: [Median::NEW; 12],
            heights: [last.xyz[2]; 8],
            changes: std::array::from_fn(|_| model(128)),
            channel: model(3),
            returns: [const { None }; 16],
            return_number: [const { None }; 16],
            return_number_same_time: model(13),
            class: [const { None }; 64],
            flags: [const { None }; 64],
            user_data: [const { None }; 64],
            dx: integer(32, 2),
            dy: integer(32, 22),
            z: integer(32, 20),
            intensity: integer(16, 4),
            scan_angle: integer(16, 2),
            source: integer(16, 1),
            times: Times::new(TimeSymbols::OnlyChanged, last.time_bits),
        })
    }
}

/// A model that is made when it is first needed.
fn model(slot: &mut Option<ArithmeticModel>, symbols: u32) -> &mut ArithmeticModel {
    slot.get_or_insert_with(|| ArithmeticModelBuilder::new(symbols).build())
}

/// One layer of a chunk.
struct Layer {
    bytes: u32,
    decoder: ArithmeticDecoder<Cursor<Vec<u8>>>,
}

impl Layer {
    fn new() -> Self {
        Layer { bytes: 0, decoder: ArithmeticDecoder::new(Cursor::new(Vec::new())) }
    }

    /// Whether there is anything to decode.
    fn is_coded(&self) -> bool {
        self.bytes > 0
    }

    fn read(&mut self, input: &mut impl Read) -> io::Result<()> {
        if self.is_coded() {
            // It was checked to lie in the file.
            let mut bytes = vec![0; self.bytes as usize];
            input.read_exact(&mut bytes)?;
            self.decoder = ArithmeticDecoder::new(Cursor::new(bytes));
            self.decoder.read_init_bytes()?;
        }
        Ok(())
    }
}

/// The layers in their order.
struct Layers {
    xy: Layer,
    z: Layer,
    class: Layer,
    flags: Layer,
    intensity: Layer,
    scan_angle: Layer,
    user_data: Layer,
    source: Layer,
    time: Layer,
}

impl Layers {
    fn in_order(&mut self) -> [&mut Layer; 9] {
        let Layers { xy, z, class, flags, intensity, scan_angle, user_data, source, time } = self;
        [xy, z, class, flags, intensity, scan_angle, user_data, source, time]
    }
}

/// Decodes the item.
pub(super) struct Point14 {
    layers: Layers,
    channel: usize,
    contexts: [Option<Box<Context>>; 4],
    /// Version 3 tells the fields behind only of points that change the channel.
    tells_channel_always: bool,
}

impl Point14 {
    /// Of version 3 or 4.
    pub fn new(version: u16) -> Self {
        let layer = Layer::new;
        Point14 {
            layers: Layers {
                xy: layer(),
                z: layer(),
                class: layer(),
                flags: layer(),
                intensity: layer(),
                scan_angle: layer(),
                user_data: layer(),
                source: layer(),
                time: layer(),
            },
            channel: 0,
            contexts: [const { None }; 4],
            tells_channel_always: version > 3,
        }
    }

    /// The context of the point that follows: another one if the channel changes.
    fn next_context(&mut self) -> io::Result<(&mut Layers, &mut Context, Changes, bool)> {
        let Point14 { layers, channel, contexts, .. } = self;
        let context = contexts[*channel].as_mut().ok_or(io::ErrorKind::InvalidData)?;
        let last = &context.last;
        let kind = usize::from(last.return_number == 1)
            + 2 * usize::from(last.return_number >= last.returns)
            + 4 * usize::from(last.has_new_time);
        let changes = Changes(layers.xy.decoder.decode_symbol(&mut context.changes[kind])?);
        if changes.has_other_channel() {
            let step = layers.xy.decoder.decode_symbol(&mut context.channel)?;
            let last = context.last;
            *channel = (*channel + step as usize + 1) % 4;
            contexts[*channel].get_or_insert_with(|| Context::new(last));
        }
        let context = contexts[*channel].as_mut().ok_or(io::ErrorKind::InvalidData)?;
        context.last.channel = *channel as u8;
        Ok((layers, context, changes, changes.has_other_channel()))
    }
}

/// What differs from the point before.
#[derive(Clone, Copy)]
struct Changes(u32);

impl Changes {
    fn has_other_channel(self) -> bool {
        self.0 & 64 != 0
    }
    fn has_other_source(self) -> bool {
        self.0 & 32 != 0
    }
    fn has_new_time(self) -> bool {
        self.0 & 16 != 0
    }
    fn has_other_angle(self) -> bool {
        self.0 & 8 != 0
    }
    fn has_other_returns(self) -> bool {
        self.0 & 4 != 0
    }
    /// 0: the same return, 1: the next, 2: the one before, 3: another.
    fn return_step(self) -> u32 {
        self.0 & 3
    }
}

impl Context {
    fn decode_returns(&mut self, layers: &mut Layers, changes: Changes) -> io::Result<()> {
        let decoder = &mut layers.xy.decoder;
        let last = &mut self.last;
        if changes.has_other_returns() {
            let model = model(&mut self.returns[usize::from(last.returns)], 16);
            last.returns = decoder.decode_symbol(model)? as u8 & 15;
        }
        let before = last.return_number;
        last.return_number = 15
            & match changes.return_step() {
                0 => before,
                1 => before + 1,
                2 => before + 15,
                _ if changes.has_new_time() => {
                    let model = model(&mut self.return_number[usize::from(before)], 16);
                    decoder.decode_symbol(model)? as u8
                }
                _ => {
                    let step = decoder.decode_symbol(&mut self.return_number_same_time)?;
                    before + step as u8 + 2
                }
            };
        Ok(())
    }

    fn decode_position(&mut self, layers: &mut Layers, changes: Changes) -> io::Result<()> {
        let last = &mut self.last;
        let (returns, number) = (usize::from(last.returns), usize::from(last.return_number));
        let map = usize::from(RETURN_MAP[returns][number]);
        let median = map << 1 | usize::from(changes.has_new_time());
        let is_single = u32::from(returns == 1);
        let even = |bits: u32, most: u32| is_single + bits.min(most) / 2 * 2;

        let predicted = self.x_differences[median].get();
        let step = self.dx.decompress(&mut layers.xy.decoder, predicted, is_single)?;
        self.x_differences[median].add(step);
        last.xyz[0] = last.xyz[0].wrapping_add(step);

        let predicted = self.y_differences[median].get();
        let context = even(self.dx.k(), 20);
        let step = self.dy.decompress(&mut layers.xy.decoder, predicted, context)?;
        self.y_differences[median].add(step);
        last.xyz[1] = last.xyz[1].wrapping_add(step);

        if layers.z.is_coded() {
            let height = &mut self.heights[returns.abs_diff(number).min(7)];
            let context = even((self.dx.k() + self.dy.k()) / 2, 18);
            *height = self.z.decompress(&mut layers.z.decoder, *height, context)?;
            last.xyz[2] = *height;
        }
        Ok(())
    }

    fn decode_rest(&mut self, layers: &mut Layers, changes: Changes) -> io::Result<()> {
        let last = &mut self.last;
        let is_new = changes.has_new_time();
        let is_first = last.return_number == 1;
        let is_last = last.return_number >= last.returns;
        let kind = 2 * u32::from(is_first) + u32::from(is_last);
        if layers.class.is_coded() {
            let place = usize::from(last.class & 31) << 1 | usize::from(kind == 3);
            let model = model(&mut self.class[place], 256);
            last.class = layers.class.decoder.decode_symbol(model)? as u8;
        }
        if layers.flags.is_coded() {
            let model = model(&mut self.flags[usize::from(last.flags)], 64);
            last.flags = layers.flags.decoder.decode_symbol(model)? as u8 & 0x3f;
        }
        if layers.intensity.is_coded() {
            let before = &mut self.intensities[(kind << 1 | u32::from(is_new)) as usize];
            let decoder = &mut layers.intensity.decoder;
            *before = self.intensity.decompress(decoder, i32::from(*before), kind)? as u16;
            last.intensity = *before;
        }
        if layers.scan_angle.is_coded() && changes.has_other_angle() {
            let decoder = &mut layers.scan_angle.decoder;
            let before = i32::from(last.scan_angle);
            last.scan_angle =
                self.scan_angle.decompress(decoder, before, u32::from(is_new))? as i16;
        }
        if layers.user_data.is_coded() {
            let model = model(&mut self.user_data[usize::from(last.user_data / 4)], 256);
            last.user_data = layers.user_data.decoder.decode_symbol(model)? as u8;
        }
        if layers.source.is_coded() && changes.has_other_source() {
            let decoder = &mut layers.source.decoder;
            last.source = self.source.decompress(decoder, i32::from(last.source), 0)? as u16;
        }
        if layers.time.is_coded() && is_new {
            self.times.decode(&mut layers.time.decoder)?;
            last.time_bits = self.times.time();
        }
        last.has_new_time = is_new;
        Ok(())
    }
}

impl<R: Read + Seek> LayeredFieldDecompressor<R> for Point14 {
    fn size_of_field(&self) -> usize {
        ITEM_BYTES
    }

    fn set_selection(&mut self, _: DecompressionSelection) {
        // Everything is decoded.
    }

    fn init_first_point(
        &mut self,
        input: &mut R,
        first_point: &mut [u8],
        context: &mut usize,
    ) -> io::Result<()> {
        let mut item = [0; ITEM_BYTES];
        input.read_exact(&mut item)?;
        first_point.copy_from_slice(&item);
        let point = Point::read(&item);
        self.channel = usize::from(point.channel);
        *context = self.channel;
        self.contexts = [const { None }; 4];
        self.contexts[self.channel] = Some(Context::new(point));
        Ok(())
    }

    fn decompress_field_with(&mut self, item: &mut [u8], context: &mut usize) -> io::Result<()> {
        let tells_always = self.tells_channel_always;
        let (layers, of_channel, changes, is_other) = self.next_context()?;
        of_channel.decode_returns(layers, changes)?;
        of_channel.decode_position(layers, changes)?;
        of_channel.decode_rest(layers, changes)?;
        of_channel.last.write(item);
        if is_other || tells_always {
            *context = self.channel;
        }
        Ok(())
    }

    fn read_layers_sizes(&mut self, input: &mut R) -> io::Result<()> {
        for layer in self.layers.in_order() {
            let mut bytes = [0; 4];
            input.read_exact(&mut bytes)?;
            layer.bytes = u32::from_le_bytes(bytes);
        }
        Ok(())
    }

    fn read_layers(&mut self, input: &mut R) -> io::Result<()> {
        let mut layers = self.layers.in_order().into_iter();
        layers.try_for_each(|layer| layer.read(input))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use laz::record::{
        LayeredPointRecordCompressor, LayeredPointRecordDecompressor, RecordCompressor,
        RecordDecompressor,
    };
    use laz::{LazItem, LazItemRecordBuilder};
    use proptest::prelude::*;

    fn compressed(items: &Vec<LazItem>, records: &[Vec<u8>]) -> Vec<u8> {
        let mut compressor = LayeredPointRecordCompressor::new(Cursor::new(Vec::new()));
        compressor.set_fields_from(items).expect("known items");
        for record in records {
            compressor.compress_next(record).expect("it compresses");
        }
        compressor.done().expect("it ends");
        Box::new(compressor).box_into_inner().into_inner()
    }

    /// Records that keep step with a scanner for a while: several channels, returns, times.
    fn records(seed: u64, count: usize, wild: u32) -> Vec<Vec<u8>> {
        let mut state = seed;
        let mut random = move |below: u64| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) % below
        };
        let mut point = Point { time_bits: 0x4123_4567_89ab_cdef, ..Point::default() };
        let mut make = || {
            let is_wild = random(100) < u64::from(wild);
            let near = if is_wild { 1 << 32 } else { 200 };
            for c in &mut point.xyz {
                *c = c.wrapping_add(random(near) as i32);
            }
            if random(3) == 0 {
                point.channel = random(4) as u8;
            }
            if random(2) == 0 {
                point.returns = random(16) as u8;
                point.return_number = random(16) as u8;
            }
            point.return_number = (point.return_number + random(2) as u8) & 15;
            point.time_bits = match random(8) {
                0 => (random(1 << 31) << 33) as i64,
                1 => point.time_bits.wrapping_sub(random(1 << 20) as i64),
                2..5 => point.time_bits.wrapping_add(1000 * (1 + random(700) as i64)),
                _ => point.time_bits,
            };
            for (chance, value) in [(5, 0u8), (6, 1), (7, 2), (9, 3)] {
                if random(chance) == 0 {
                    match value {
                        0 => point.class = random(40) as u8,
                        1 => point.flags = random(64) as u8,
                        2 => point.user_data = random(256) as u8,
                        _ => point.source = random(1 << 16) as u16,
                    }
                }
            }
            point.intensity = (point.intensity / 2).wrapping_add(random(3000) as u16);
            point.scan_angle = point.scan_angle.wrapping_add(random(9) as i16 * 1000 - 4000);
            let mut record = vec![0; ITEM_BYTES];
            point.write(&mut record);
            record.extend((0..6).map(|_| random(256) as u8));
            record
        };
        (0..count).map(|_| make()).collect()
    }

    proptest! {
        /// What `laz` encodes comes out again, with colours behind that depend on the channel.
        #[test]
        fn points_come_back(seed: u64, count in 2usize..800, wild in 0u32..40, version in 3u16..=4) {
            let items = match version {
                3 => LazItemRecordBuilder::version_3_of::<laz::las::Point7>(0),
                _ => LazItemRecordBuilder::version_4_of::<laz::las::Point7>(0),
            };
            let records = records(seed, count, wild);
            let bytes = compressed(&items, &records);
            let mut decompressor = LayeredPointRecordDecompressor::new(Cursor::new(bytes));
            decompressor.add_field_decompressor(Point14::new(version));
            decompressor.set_fields_from(&items[1..].to_vec()).expect("known items");
            for record in &records {
                let mut back = vec![0; record.len()];
                decompressor.decompress_next(&mut back).expect("it decodes");
                prop_assert_eq!(&back, record);
            }
        }
    }

    #[test]
    fn the_median_makes_room_by_turns() {
        let mut median = Median::NEW;
        let medians = [5, 4, 3, 9, 9, 9, -7, 9].map(|value| {
            median.add(value);
            median.get()
        });
        assert_eq!(medians, [0, 0, 3, 4, 5, 9, 9, 9]);
    }
}
