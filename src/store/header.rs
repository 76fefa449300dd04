//! The first 128 bytes of a store: what it is and where its parts are.
//!
//! Layout: `FORMAT.md`, "Header". All integers little-endian.

/// The first eight bytes of every store.
pub const MAGIC: [u8; 8] = *b"ESKER\r\n\x1a";
/// The version this program writes and reads.
pub const VERSION: u32 = 1;
/// Size of the header, bytes.
pub const HEADER_BYTES: usize = 128;

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
    /// First byte of node data.
    pub data_offset: u64,
    /// Bytes of node data.
    pub data_bytes: u64,
    /// Points in the store.
    pub point_count: u64,
}

/// Why 128 bytes are not a header.
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
    /// The header as it stands in the file.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0u8; HEADER_BYTES];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, &MAGIC);
        put(8, &VERSION.to_le_bytes());
        put(12, &(HEADER_BYTES as u32).to_le_bytes());
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

    /// Reads a header and checks all that can be checked without the rest of the file.
    pub fn decode(bytes: &[u8; HEADER_BYTES]) -> Result<Header, HeaderError> {
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
        if u32_at(8) != VERSION {
            return Err(HeaderError::Version(u32_at(8)));
        }
        let (found, stated) = (crc32c::crc32c(&bytes[..124]), u32_at(124));
        if found != stated {
            return Err(HeaderError::Damaged(format!(
                "checksum {found:08x}, it says {stated:08x}"
            )));
        }
        let header = Header {
            file_bytes: u64_at(16),
            metadata: part(24),
            directory: part(48),
            node_count: u32_at(68),
            appendix: part(72),
            data_offset: u64_at(96),
            data_bytes: u64_at(104),
            point_count: u64_at(112),
        };
        // The parts follow one another without gaps, so that every byte of the file is covered by
        // one checksum.
        let parts = [
            (header.metadata.offset, header.metadata.bytes),
            (header.directory.offset, header.directory.bytes),
            (header.data_offset, header.data_bytes),
            (header.appendix.offset, header.appendix.bytes),
        ];
        let mut end = HEADER_BYTES as u64;
        for (offset, bytes) in parts {
            if offset != end {
                return Err(HeaderError::Damaged("its parts do not follow one another".into()));
            }
            end = end
                .checked_add(bytes)
                .ok_or_else(|| HeaderError::Damaged("a part is longer than any file".into()))?;
        }
        if end != header.file_bytes {
            return Err(HeaderError::Damaged("its parts do not add up to the file".into()));
        }
        Ok(header)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Header {
        Header {
            file_bytes: 128 + 10 + 20 + 30 + 5,
            metadata: PartExtent { offset: 128, bytes: 10, checksum: 1 },
            directory: PartExtent { offset: 138, bytes: 20, checksum: 2 },
            node_count: 3,
            data_offset: 158,
            data_bytes: 30,
            appendix: PartExtent { offset: 188, bytes: 5, checksum: 4 },
            point_count: 99,
        }
    }

    #[test]
    fn headers_come_back_and_every_flipped_byte_is_seen() {
        let bytes = sample().encode();
        assert_eq!(Header::decode(&bytes), Ok(sample()));
        for at in 0..HEADER_BYTES {
            let mut damaged = bytes;
            damaged[at] ^= 0x40;
            assert!(Header::decode(&damaged).is_err(), "byte {at}");
        }
    }

    #[test]
    fn gaps_between_parts_are_refused() {
        let mut header = sample();
        header.data_offset += 1;
        assert!(matches!(Header::decode(&header.encode()), Err(HeaderError::Damaged(_))));
    }
}
