//! The header of a store: what it is and where its parts are.
//!
//! Layout: `FORMAT.md`, "Header". All integers little-endian. Two slots of equal size, so that a
//! change of a store is one write of the slot not in use: whatever happens, one of them is whole.

/// The first eight bytes of every store.
pub const MAGIC: [u8; 8] = *b"ESKER\r\n\x1a";
/// The version this program writes; it reads this one and those before.
pub const VERSION: u32 = 3;
/// The version of stores in which every section has bytes.
pub const FULL_VERSION: u32 = 2;
/// Size of one slot, bytes; all of the header in version 1.
pub const SLOT_BYTES: usize = 128;
/// Size of the header, bytes.
pub const HEADER_BYTES: usize = 2 * SLOT_BYTES;

/// Place, size and checksum of one part of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PartExtent {
    /// First byte in the file.
    pub offset: u64,
    /// Length in bytes.
    pub bytes: u64,
    /// CRC-32C of those bytes.
    pub checksum: u32,
}

/// The header, decoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Version of the format.
    pub version: u32,
    /// How often the store was written to: 1 for a new one, one more with every change.
    pub generation: u32,
    /// Length of the whole file.
    pub file_bytes: u64,
    /// The metadata (JSON).
    pub metadata: PartExtent,
    /// The node directory.
    pub directory: PartExtent,
    /// Rows of the directory.
    pub node_count: u32,
    /// Records of the source files that are kept verbatim.
    pub appendix: PartExtent,
    /// First byte of node data; in version 2, of the coarse nodes that stand together at its end.
    pub data_offset: u64,
    /// Bytes of all nodes.
    pub data_bytes: u64,
    /// Points in the store.
    pub point_count: u64,
}

/// The header of an open store and the slot that it did not come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FoundHeader {
    /// The latest header that is whole.
    pub header: Header,
    /// Whether the other slot holds something that is neither nothing nor a header.
    pub other_is_damaged: bool,
}

/// Why bytes are not a header.
#[derive(Debug, PartialEq, Eq)]
pub enum HeaderError {
    /// Other first bytes.
    Magic,
    /// Another version, with it.
    Version(u32),
    /// Something is damaged.
    Damaged(String),
}

impl Header {
    /// The header as it stands in its slot.
    pub fn encode(&self) -> [u8; SLOT_BYTES] {
        let mut bytes = [0u8; SLOT_BYTES];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, &MAGIC);
        put(8, &self.version.to_le_bytes());
        let second = if self.version == 1 { SLOT_BYTES as u32 } else { self.generation };
        put(12, &second.to_le_bytes());
        put(16, &self.file_bytes.to_le_bytes());
        for (at, part, extra) in [
            (24, self.metadata, 0),
            (48, self.directory, self.node_count),
            (72, self.appendix, 0u32),
        ] {
            put(at, &part.offset.to_le_bytes());
            put(at + 8, &part.bytes.to_le_bytes());
            put(at + 16, &part.checksum.to_le_bytes());
            put(at + 20, &extra.to_le_bytes());
        }
        put(96, &self.data_offset.to_le_bytes());
        put(104, &self.data_bytes.to_le_bytes());
        put(112, &self.point_count.to_le_bytes());
        let checksum = crc32c::crc32c(&bytes[..124]);
        bytes[124..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Where its slot begins.
    pub fn slot_offset(&self) -> u64 {
        (self.generation.saturating_sub(1) % 2) as u64 * SLOT_BYTES as u64
    }

    /// The header among the first bytes of a file, both slots or what there is of them.
    pub fn find(bytes: &[u8]) -> Result<FoundHeader, HeaderError> {
        let slot = |i: usize| -> Option<&[u8; SLOT_BYTES]> {
            bytes.get(i * SLOT_BYTES..(i + 1) * SLOT_BYTES)?.try_into().ok()
        };
        let Some(first) = slot(0) else {
            return Err(HeaderError::Damaged(format!("{} bytes are too few", bytes.len())));
        };
        if first[..8] != MAGIC {
            return Err(HeaderError::Magic);
        }
        let found = Header::decode(first);
        if matches!(&found, Ok(header) if header.version == 1) {
            return found.map(|header| FoundHeader { header, other_is_damaged: false });
        }
        let second = slot(1).ok_or_else(|| HeaderError::Damaged("its second half".into()))?;
        let is_empty = second.iter().all(|&byte| byte == 0);
        let other = Header::decode(second);
        match (found, other) {
            (Ok(a), Ok(b)) if a.generation >= b.generation => {
                Ok(FoundHeader { header: a, other_is_damaged: false })
            }
            (Ok(_), Ok(b)) => Ok(FoundHeader { header: b, other_is_damaged: false }),
            (Ok(a), Err(_)) => Ok(FoundHeader { header: a, other_is_damaged: !is_empty }),
            (Err(HeaderError::Damaged(_)), Ok(b)) => {
                Ok(FoundHeader { header: b, other_is_damaged: true })
            }
            (Err(error), _) => Err(error),
        }
    }

    /// Reads a slot and checks all that can be checked without the rest of the file.
    fn decode(bytes: &[u8; SLOT_BYTES]) -> Result<Header, HeaderError> {
        let u32_at = |at: usize| {
            u32::from_le_bytes(bytes[at..at + 4].try_into().expect("the slice has 4 bytes"))
        };
        let u64_at = |at: usize| {
            u64::from_le_bytes(bytes[at..at + 8].try_into().expect("the slice has 8 bytes"))
        };
        let part = |at: usize| PartExtent {
            offset: u64_at(at),
            bytes: u64_at(at + 8),
            checksum: u32_at(at + 16),
        };
        if bytes[..8] != MAGIC {
            return Err(HeaderError::Magic);
        }
        let version = u32_at(8);
        if !(1..=VERSION).contains(&version) {
            return Err(HeaderError::Version(version));
        }
        let (found, stated) = (crc32c::crc32c(&bytes[..124]), u32_at(124));
        if found != stated {
            return Err(HeaderError::Damaged(format!(
                "checksum {found:08x}, it says {stated:08x}"
            )));
        }
        let header = Header {
            version,
            generation: if version == 1 { 1 } else { u32_at(12) },
            file_bytes: u64_at(16),
            metadata: part(24),
            directory: part(48),
            node_count: u32_at(68),
            appendix: part(72),
            data_offset: u64_at(96),
            data_bytes: u64_at(104),
            point_count: u64_at(112),
        };
        if version == 1 { header.check_parts_1() } else { header.check_parts() }
            .map_err(|reason| HeaderError::Damaged(reason.into()))?;
        Ok(header)
    }

    /// Version 1: the parts follow one another, node data last but one.
    fn check_parts_1(&self) -> Result<(), &'static str> {
        let end = follow(
            SLOT_BYTES as u64,
            [
                (self.metadata.offset, self.metadata.bytes),
                (self.directory.offset, self.directory.bytes),
                (self.data_offset, self.data_bytes),
                (self.appendix.offset, self.appendix.bytes),
            ],
        )?;
        if end == self.file_bytes { Ok(()) } else { Err("its parts do not add up to the file") }
    }

    /// Node data first, then the other parts without gaps. Only in a store that was changed may
    /// there be bytes that are no longer in use.
    fn check_parts(&self) -> Result<(), &'static str> {
        if self.generation == 0 {
            return Err("there is no generation 0");
        }
        let end = follow(
            self.metadata.offset,
            [
                (self.metadata.offset, self.metadata.bytes),
                (self.directory.offset, self.directory.bytes),
                (self.appendix.offset, self.appendix.bytes),
            ],
        )?;
        let room = self.metadata.offset.checked_sub(HEADER_BYTES as u64);
        let room = room.ok_or("a part overlaps the header")?;
        let fits = match self.generation {
            1 => self.data_bytes == room,
            _ => self.data_bytes <= room,
        };
        let coarse = HEADER_BYTES as u64..=self.metadata.offset;
        if end != self.file_bytes || !fits || !coarse.contains(&self.data_offset) {
            return Err("its parts do not add up to the file");
        }
        Ok(())
    }
}

/// The end of parts that follow one another from `start`.
fn follow<const N: usize>(start: u64, parts: [(u64, u64); N]) -> Result<u64, &'static str> {
    parts.into_iter().try_fold(start, |end, (offset, bytes)| {
        if offset != end {
            return Err("its parts do not follow one another");
        }
        end.checked_add(bytes).ok_or("a part is longer than any file")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Header {
        Header {
            version: 2,
            generation: 1,
            file_bytes: 256 + 30 + 10 + 20 + 5,
            data_offset: 266,
            data_bytes: 30,
            metadata: PartExtent { offset: 286, bytes: 10, checksum: 1 },
            directory: PartExtent { offset: 296, bytes: 20, checksum: 2 },
            node_count: 3,
            appendix: PartExtent { offset: 316, bytes: 5, checksum: 4 },
            point_count: 99,
        }
    }

    fn file(slots: [Option<Header>; 2]) -> Vec<u8> {
        let slot = |header: Option<Header>| header.map_or([0; SLOT_BYTES], |h| h.encode());
        slots.map(slot).concat()
    }

    #[test]
    fn headers_come_back_and_every_flipped_byte_is_seen() {
        let bytes = file([Some(sample()), None]);
        let found = FoundHeader { header: sample(), other_is_damaged: false };
        assert_eq!(Header::find(&bytes), Ok(found));
        for at in 0..HEADER_BYTES {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x40;
            let found = Header::find(&damaged);
            assert!(found.is_err() || found.is_ok_and(|f| f.other_is_damaged), "byte {at}");
        }
    }

    #[test]
    fn the_latest_whole_slot_counts() {
        let changed = Header { generation: 2, data_bytes: 12, point_count: 120, ..sample() };
        assert_eq!(changed.slot_offset(), 128);
        let bytes = file([Some(sample()), Some(changed)]);
        assert_eq!(Header::find(&bytes).map(|found| found.header), Ok(changed));
        for at in 128..256 {
            let mut torn = bytes.clone();
            torn[at] ^= 0x10;
            let found = FoundHeader { header: sample(), other_is_damaged: true };
            assert_eq!(Header::find(&torn), Ok(found), "byte {at}");
        }
        let third = Header { generation: 3, ..changed };
        assert_eq!(third.slot_offset(), 0);
        let bytes = file([Some(third), Some(changed)]);
        assert_eq!(Header::find(&bytes).map(|found| found.header), Ok(third));
    }

    #[test]
    fn gaps_are_for_changed_stores() {
        let gap = Header { data_bytes: 29, ..sample() };
        assert!(matches!(Header::find(&file([Some(gap), None])), Err(HeaderError::Damaged(_))));
        let mut apart = sample();
        apart.directory.offset += 1;
        assert!(matches!(Header::find(&file([Some(apart), None])), Err(HeaderError::Damaged(_))));
    }
}
