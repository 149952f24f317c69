//! The outline of a file: where its chunks are, and what lies beside them. Only this is read when a
//! recording is opened.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;

use mcap::records::op;

use crate::reader::RECORD_BYTES_MAX;
use crate::records::HEADER_BYTES;

/// Size of a part of a file without chunks that is read in one piece, bytes.
const PIECE_BYTES: u64 = 1 << 20;
/// Size of the reads between the chunks, bytes.
const READ_BYTES: usize = 1 << 12;

/// A part of a file that is read in one piece: one chunk, or records outside chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Piece {
    pub at: u64,
    pub length: u64,
    pub is_chunk: bool,
}

/// Outline of a file.
#[derive(Debug, Default)]
pub(crate) struct Outline {
    /// Parts with messages, up to the end of the data.
    pub pieces: Vec<Piece>,
    /// Attachments and metadata: opcode and body.
    pub named: Vec<(u8, Vec<u8>)>,
    /// Number of bytes up to the end of the last complete record; 0: not an MCAP file.
    pub whole_bytes: u64,
    /// Whether the file has its end.
    pub is_finished: bool,
}

impl Outline {
    /// Goes through the records of a file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(file: &File) -> io::Result<Self> {
        let length = file.metadata()?.len();
        let mut outline = Self::default();
        let magic = mcap::MAGIC.len() as u64;
        if length < magic || !is_magic(file, 0)? {
            return Ok(outline);
        }
        let mut reader = BufReader::with_capacity(READ_BYTES, file);
        let mut at = reader.seek(SeekFrom::Start(magic))?;
        let mut is_data = true;
        while at + HEADER_BYTES as u64 <= length {
            let mut header = [0; HEADER_BYTES];
            reader.read_exact(&mut header)?;
            let [opcode, size @ ..] = header;
            let size = u64::from_le_bytes(size);
            let end = size.checked_add(at + HEADER_BYTES as u64);
            let Some(end) = end.filter(|end| *end <= length) else {
                break;
            };
            is_data &= opcode != op::DATA_END;
            let is_named = matches!(opcode, op::ATTACHMENT | op::METADATA);
            let mut left = size;
            if is_data && is_named && size <= RECORD_BYTES_MAX as u64 {
                let mut body = vec![0; size as usize];
                reader.read_exact(&mut body)?;
                outline.named.push((opcode, body));
                left = 0;
            }
            if is_data {
                outline.add(opcode, at, end);
            }
            reader.seek_relative(i64::try_from(left).map_err(io::Error::other)?)?;
            at = end;
        }
        outline.is_finished = length >= 2 * magic && is_magic(file, length - magic)?;
        let is_end = outline.is_finished && length - at == magic;
        outline.whole_bytes = if is_end { length } else { at };
        Ok(outline)
    }

    fn add(&mut self, opcode: u8, at: u64, end: u64) {
        let is_chunk = opcode == op::CHUNK;
        match self.pieces.last_mut() {
            Some(last)
                if !is_chunk
                    && !last.is_chunk
                    && last.at + last.length == at
                    && end - last.at <= PIECE_BYTES =>
            {
                last.length = end - last.at;
            }
            // What else lies between chunks needs no look.
            _ if is_chunk || matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) => {
                self.pieces.push(Piece {
                    at,
                    length: end - at,
                    is_chunk,
                });
            }
            _ => {}
        }
    }
}

fn is_magic(file: &File, at: u64) -> io::Result<bool> {
    let mut bytes = [0; mcap::MAGIC.len()];
    file.read_exact_at(&mut bytes, at)?;
    Ok(bytes == *mcap::MAGIC)
}
