//! Rows on disk: many streams in one unnamed temporary file, which vanishes with the process.
//!
//! Each stream keeps a short tail in memory and appends full blocks to the file; reading gives its
//! rows back in the order in which they came (the paper's rejection files).

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::build::BuildError;

/// Takes whole rows of a stream; may append to other streams.
pub type TakeRows<'a> = &'a mut dyn FnMut(&mut SpillFile, &[u8]) -> Result<(), BuildError>;

/// Index of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamId(usize);

#[derive(Default)]
struct Stream {
    tail: Vec<u8>,
    /// Place and length in the file.
    blocks: Vec<(u64, u64)>,
    bytes: u64,
}

/// The temporary file and its streams.
pub struct SpillFile {
    folder: PathBuf,
    file: Option<File>,
    end: u64,
    tail_bytes: usize,
    streams: Vec<Stream>,
}

impl SpillFile {
    /// A spill file in `folder`, made when the first block is written. Each stream keeps at most
    /// `tail_bytes` in memory.
    pub fn new(folder: &Path, tail_bytes: usize) -> Self {
        SpillFile { folder: folder.into(), file: None, end: 0, tail_bytes, streams: Vec::new() }
    }

    /// A new empty stream.
    pub fn add_stream(&mut self) -> StreamId {
        self.streams.push(Stream::default());
        StreamId(self.streams.len() - 1)
    }

    /// Bytes written to disk so far.
    pub fn written_bytes(&self) -> u64 {
        self.end
    }

    /// Appends to a stream.
    pub fn append(&mut self, stream: StreamId, bytes: &[u8]) -> Result<(), BuildError> {
        let target = &mut self.streams[stream.0];
        target.bytes += bytes.len() as u64;
        if target.tail.len() + bytes.len() < self.tail_bytes {
            target.tail.extend_from_slice(bytes);
            return Ok(());
        }
        // Written from where they are, so that a tail's memory never outgrows its limit.
        let mut tail = std::mem::take(&mut target.tail);
        let written =
            self.write_block(stream, &tail).and_then(|()| self.write_block(stream, bytes));
        written.map_err(|source| self.error("cannot write", source))?;
        tail.clear();
        self.streams[stream.0].tail = tail;
        Ok(())
    }

    fn write_block(&mut self, stream: StreamId, bytes: &[u8]) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            empty => empty.insert(tempfile::tempfile_in(&self.folder)?),
        };
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(bytes)?;
        let (start, length) = (self.end, bytes.len() as u64);
        self.end += length;
        match self.streams[stream.0].blocks.last_mut() {
            Some((at, bytes)) if *at + *bytes == start => *bytes += length,
            _ => self.streams[stream.0].blocks.push((start, length)),
        }
        Ok(())
    }

    /// Calls `take` with a stream's bytes in order, whole rows of `row_bytes` at a time and about
    /// `piece_bytes` each. The stream stays; `take` may append to others.
    pub fn visit(
        &mut self,
        stream: StreamId,
        row_bytes: usize,
        piece_bytes: usize,
        take: TakeRows,
    ) -> Result<(), BuildError> {
        let blocks = self.streams[stream.0].blocks.clone();
        let piece_bytes = piece_bytes.max(row_bytes);
        let mut piece = Vec::with_capacity(piece_bytes + row_bytes);
        for (mut at, bytes) in blocks {
            let mut left = bytes;
            while left > 0 {
                let part = left.min((piece_bytes + row_bytes - piece.len()) as u64) as usize;
                let start = piece.len();
                piece.resize(start + part, 0);
                self.read_at(at, &mut piece[start..])
                    .map_err(|source| self.error("cannot read back", source))?;
                at += part as u64;
                left -= part as u64;
                if piece.len() >= piece_bytes {
                    let whole = piece.len() / row_bytes * row_bytes;
                    take(self, &piece[..whole])?;
                    piece.drain(..whole);
                }
            }
        }
        piece.extend_from_slice(&self.streams[stream.0].tail);
        if piece.is_empty() { Ok(()) } else { take(self, &piece) }
    }

    /// Forgets a stream's contents and its memory.
    pub fn forget(&mut self, stream: StreamId) {
        self.streams[stream.0] = Stream::default();
    }

    /// Replaces `out` by all bytes of a stream and forgets it.
    pub fn take_all(&mut self, stream: StreamId, out: &mut Vec<u8>) -> Result<(), BuildError> {
        let Stream { tail, blocks, bytes } = std::mem::take(&mut self.streams[stream.0]);
        out.clear();
        out.reserve_exact(bytes as usize);
        for (at, bytes) in blocks {
            let start = out.len();
            out.resize(start + bytes as usize, 0);
            self.read_at(at, &mut out[start..])
                .map_err(|source| self.error("cannot read back", source))?;
        }
        out.extend_from_slice(&tail);
        Ok(())
    }

    fn read_at(&mut self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let file = self.file.as_mut().expect("blocks exist only in a file");
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(out)
    }

    fn error(&self, action: &'static str, source: io::Error) -> BuildError {
        BuildError::Temporary { action, source, path: self.folder.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_come_back_in_order_however_they_were_cut() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for tail_bytes in [1, 10, 64, 10_000] {
            let mut spill = SpillFile::new(folder.path(), tail_bytes);
            let streams = [spill.add_stream(), spill.add_stream(), spill.add_stream()];
            let mut expected = vec![Vec::new(); 3];
            for i in 0..500u32 {
                let to = (i * 7 % 3) as usize % 2;
                let row = [i.to_le_bytes(), (i ^ 0xffff).to_le_bytes()].concat();
                expected[to].extend_from_slice(&row);
                spill.append(streams[to], &row).expect("appends");
            }
            let mut all = Vec::new();
            spill.take_all(streams[0], &mut all).expect("reads");
            assert_eq!(all, expected[0]);
            let mut visited = Vec::new();
            spill
                .visit(streams[1], 8, 100, &mut |_, rows| {
                    assert_eq!(rows.len() % 8, 0, "whole rows");
                    visited.extend_from_slice(rows);
                    Ok(())
                })
                .expect("visits");
            assert_eq!(visited, expected[1]);
            spill.take_all(streams[2], &mut all).expect("an empty stream reads");
            assert!(all.is_empty());
        }
    }
}
