//! Records in bytes, one by one and without copies.

/// Bytes before the body of a record: its opcode and its length.
pub(crate) const HEADER_BYTES: usize = 9;

/// One record.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawRecord<'a> {
    pub opcode: u8,
    pub body: &'a [u8],
    /// Opcode, length and body.
    pub whole: &'a [u8],
}

/// Iterator over the complete records; ends where the next one is incomplete.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawRecords<'a> {
    left: &'a [u8],
}

impl<'a> RawRecords<'a> {
    /// Records one after another, such as those of a chunk.
    pub fn of(bytes: &'a [u8]) -> Self {
        Self { left: bytes }
    }

    /// What follows the records so far.
    pub fn rest(&self) -> &'a [u8] {
        self.left
    }
}

impl<'a> Iterator for RawRecords<'a> {
    type Item = RawRecord<'a>;

    fn next(&mut self) -> Option<Self::Item> {
        let (header, _) = self.left.split_first_chunk::<HEADER_BYTES>()?;
        let [opcode, length @ ..] = *header;
        let length = usize::try_from(u64::from_le_bytes(length)).ok()?;
        let (whole, left) = self
            .left
            .split_at_checked(HEADER_BYTES.checked_add(length)?)?;
        self.left = left;
        Some(RawRecord {
            opcode,
            body: &whole[HEADER_BYTES..],
            whole,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_end_where_the_bytes_do() {
        let mut bytes = Vec::new();
        for (opcode, length) in [(1_u8, 3_u64), (2, 0)] {
            bytes.push(opcode);
            bytes.extend(length.to_le_bytes());
            bytes.extend(vec![7; length as usize]);
        }
        let whole = bytes.len();
        bytes.push(3);
        bytes.extend(u64::MAX.to_le_bytes());
        bytes.extend([9; 20]);
        let mut records = RawRecords::of(&bytes);
        let first = records.next().unwrap();
        assert_eq!(
            (first.opcode, first.body, first.whole.len()),
            (1, &[7; 3][..], 12)
        );
        let second = records.next().unwrap();
        assert_eq!((second.opcode, second.body.len()), (2, 0));
        assert!(records.next().is_none());
        assert_eq!(records.rest(), &bytes[whole..]);
    }
}
