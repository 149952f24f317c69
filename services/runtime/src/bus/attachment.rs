//! Attachment of every sample, in rmw_zenoh's layout: sequence number, source time, publisher's id.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Length of an attachment, bytes: i64 sequence number, i64 source time in ns since the Unix epoch,
/// u8 16, 16 bytes of id; all little-endian.
pub const LENGTH: usize = 33;

/// A decoded attachment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Attachment {
    /// Sequence number, counted by the publisher from 1; 0 if the publisher does not state it.
    pub sequence: u64,
    /// Time of publication, ns since the Unix epoch on the publisher's host.
    pub source_time_ns: i64,
    /// Id, random for each publisher and start.
    pub publisher: [u8; 16],
}

impl Attachment {
    /// Encodes the attachment.
    pub fn to_bytes(self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        bytes[..8].copy_from_slice(&(self.sequence as i64).to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_time_ns.to_le_bytes());
        bytes[16] = 16;
        bytes[17..].copy_from_slice(&self.publisher);
        bytes
    }

    /// Decodes an attachment; `None` if the bytes are not one.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk::<8>()?;
        let (time, rest) = rest.split_first_chunk::<8>()?;
        let (&length, publisher) = rest.split_first()?;
        let publisher = <[u8; 16]>::try_from(publisher).ok()?;
        let sequence = u64::try_from(i64::from_le_bytes(*sequence)).ok()?;
        (length == 16).then_some(Self {
            sequence,
            source_time_ns: i64::from_le_bytes(*time),
            publisher,
        })
    }
}

/// Generates the ids of a bus's publishers: eight random bytes for the bus, and eight that count
/// its publishers.
#[derive(Clone, Debug)]
pub struct BusId {
    bus: [u8; 8],
    next: Arc<AtomicU64>,
}

impl BusId {
    /// Draws the random part for a new bus.
    pub fn new() -> Self {
        // The standard library seeds its hash maps from the system's randomness.
        let random = RandomState::new().build_hasher().finish();
        Self {
            bus: random.to_le_bytes(),
            next: Arc::new(AtomicU64::new(1)),
        }
    }

    /// Id of a new publisher.
    pub fn next(&self) -> [u8; 16] {
        let mut id = [0; 16];
        id[..8].copy_from_slice(&self.bus);
        id[8..].copy_from_slice(&self.next.fetch_add(1, Ordering::Relaxed).to_le_bytes());
        id
    }

    /// Whether the id belongs to a publisher of this bus.
    pub fn made(&self, publisher: &[u8; 16]) -> bool {
        publisher[..8] == self.bus
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_is_that_of_rmw_zenoh() {
        let attachment = Attachment {
            sequence: 258,
            source_time_ns: -2,
            publisher: *b"0123456789abcdef",
        };
        let bytes = attachment.to_bytes();
        assert_eq!(bytes[..8], [2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[8..16], [0xfe, 255, 255, 255, 255, 255, 255, 255]);
        assert_eq!(bytes[16], 16);
        assert_eq!(&bytes[17..], b"0123456789abcdef");
        assert_eq!(Attachment::from_bytes(&bytes), Some(attachment));
    }

    #[test]
    fn other_lengths_and_negative_sequences_are_none() {
        let mut bytes = Attachment::default().to_bytes();
        for length in 0..LENGTH {
            assert_eq!(Attachment::from_bytes(&bytes[..length]), None);
        }
        bytes[16] = 15;
        assert_eq!(Attachment::from_bytes(&bytes), None);
        bytes[16] = 16;
        bytes[7] = 0x80;
        assert_eq!(Attachment::from_bytes(&bytes), None);
    }

    #[test]
    fn ids_differ_and_say_which_bus_made_them() {
        let (one, other) = (BusId::new(), BusId::new());
        let (first, second) = (one.next(), one.next());
        assert_ne!(first, second);
        assert!(one.made(&first) && one.made(&second) && one.clone().made(&second));
        assert!(!one.made(&other.next()) && !one.made(&[0; 16]));
    }
}
