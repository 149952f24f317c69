//! CDR as ROS 2 writes it (XCDR1, little-endian), through serde. The bus encodes and decodes with
//! it, the recorder stores its bytes.
//!
//! Layout: four bytes `00 01 00 00`, then the fields in order, each aligned to its own size counted
//! from after those four bytes. A fixed array is its elements; a sequence is a `u32` count and its
//! elements; a string is a `u32` count that includes a closing NUL. (OMG formal/2002-06-51, 15.3;
//! the ROS 2 middlewares agree on it.)

mod decode;
mod encode;

pub use decode::decode;
pub use encode::encode;

/// The four bytes before every payload: plain CDR, little-endian, no options.
pub const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are not a valid message, or a value cannot be encoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}{}{}", place(.path), at(.offset))]
pub struct CdrError {
    /// Byte offset from the start of the payload, header included, where reading stopped.
    pub offset: usize,
    /// Field that was being read, dotted, e.g. `header.frame_id`; empty outside any field.
    pub path: String,
    /// What was wrong.
    pub reason: CdrFault,
}

fn place(path: &str) -> String {
    if path.is_empty() {
        String::new()
    } else {
        format!(", in field `{path}`")
    }
}

fn at(offset: &usize) -> String {
    format!(", at byte {offset}")
}

/// Kind of damage.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrFault {
    /// The payload ends inside a value.
    #[error("payload too short: {needed} more bytes needed, {left} left")]
    Short {
        /// Number of bytes that the value takes, padding included.
        needed: usize,
        /// Number of bytes left.
        left: usize,
    },
    /// The first four bytes are not [`HEADER`].
    #[error("encapsulation {found:02x?} is not supported: only plain little-endian CDR (00 01) is")]
    Encapsulation {
        /// First bytes found.
        found: [u8; 2],
    },
    /// A sequence or string claims more elements than the payload has bytes.
    #[error("length {length} exceeds the {left} bytes left")]
    Length {
        /// Number of elements claimed.
        length: u32,
        /// Number of bytes left.
        left: usize,
    },
    /// A string is not UTF-8, or does not end with NUL.
    #[error("not a string: {0}")]
    Text(&'static str),
    /// A bool is neither 0 nor 1.
    #[error("a bool must be 0 or 1, not {0}")]
    Bool(u8),
    /// Bytes left over after the last field.
    #[error("{0} bytes left over after the last field: another version of the message?")]
    Trailing(usize),
    /// A sequence or string is too long for CDR's 32-bit counts, or for the fixed capacity of the
    /// field.
    #[error("{0}")]
    Value(String),
    /// A serde type that ROS 2 messages do not have.
    #[error("{0} has no place in a ROS 2 message")]
    Unsupported(&'static str),
}

impl CdrError {
    fn new(offset: usize, reason: CdrFault) -> Self {
        Self {
            offset,
            path: String::new(),
            reason,
        }
    }

    /// Adds an outer field's name at the front of the path.
    fn within(mut self, field: &str) -> Self {
        if self.path.is_empty() {
            self.path = field.to_owned();
        } else {
            self.path = format!("{field}.{}", self.path);
        }
        self
    }
}

impl serde::ser::Error for CdrError {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self::new(0, CdrFault::Value(message.to_string()))
    }
}

impl serde::de::Error for CdrError {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self::new(0, CdrFault::Value(message.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::standard::{Header, RegionOfInterest, Time, WrenchStamped};
    use crate::tangent::{ArmState, Health, NormalEstimate, Request};
    use crate::{FrameId, JointArray};
    use proptest::prelude::*;

    #[test]
    fn a_header_has_the_bytes_that_ros_2_gives_it() {
        let header = Header {
            stamp: Time { sec: 1, nanosec: 2 },
            frame_id: FrameId::from("base").unwrap(),
        };
        let mut bytes = Vec::new();
        encode(&header, &mut bytes).unwrap();
        let expected = [
            0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0, b'b', b'a', b's', b'e', 0,
        ];
        assert_eq!(bytes, expected);
        assert_eq!(decode::<Header>(&bytes).unwrap(), header);
    }

    #[test]
    fn eight_byte_numbers_align_from_after_the_encapsulation() {
        let message = WrenchStamped::default();
        let mut bytes = Vec::new();
        encode(&message, &mut bytes).unwrap();
        // stamp 8, count 4, NUL 1, padding 3, six doubles.
        assert_eq!(bytes.len(), 4 + 8 + 4 + 1 + 3 + 48);
    }

    #[test]
    fn a_cut_payload_says_which_field_it_broke_off_in() {
        let mut bytes = Vec::new();
        encode(&WrenchStamped::default(), &mut bytes).unwrap();
        let error = decode::<WrenchStamped>(&bytes[..30]).unwrap_err();
        assert_eq!(error.path, "wrench.force.y");
        assert_eq!(error.offset, 28);
        assert_eq!(
            error.to_string(),
            "payload too short: 8 more bytes needed, 2 left, in field `wrench.force.y`, at byte 28"
        );
    }

    #[test]
    fn a_length_beyond_the_payload_is_refused_before_anything_is_reserved() {
        let mut bytes = HEADER.to_vec();
        bytes.extend(u32::MAX.to_le_bytes());
        bytes.extend([0; 8]);
        let error = decode::<Request>(&bytes).unwrap_err();
        assert_eq!(error.path, "action");
        assert!(matches!(error.reason, CdrFault::Length { .. }), "{error}");
    }

    #[test]
    fn more_joints_than_an_arm_has_are_refused() {
        let mut bytes = HEADER.to_vec();
        bytes.extend(8u32.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend([0; 64]);
        assert!(decode::<JointArray>(&bytes).is_err());
    }

    #[test]
    fn other_encapsulations_and_left_over_bytes_are_refused() {
        assert!(matches!(
            decode::<Time>(&[0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2])
                .unwrap_err()
                .reason,
            CdrFault::Encapsulation { found: [0, 0] }
        ));
        assert!(decode::<Time>(&[]).is_err());
        let mut bytes = Vec::new();
        encode(&Time { sec: 1, nanosec: 2 }, &mut bytes).unwrap();
        bytes.extend([0; 8]);
        assert_eq!(
            decode::<Time>(&bytes).unwrap_err().reason,
            CdrFault::Trailing(8)
        );
    }

    /// As rclpy 9.1.2 wrote `RegionOfInterest`: 17 bytes of message in 20.
    #[test]
    fn a_size_rounded_up_to_four_is_accepted_whatever_the_rest_holds() {
        let message = RegionOfInterest {
            x_offset: 1,
            do_rectify: true,
            ..RegionOfInterest::default()
        };
        let mut bytes = Vec::new();
        encode(&message, &mut bytes).unwrap();
        assert_eq!(bytes.len(), 21);
        bytes.extend([0x5f, 0x5f, 0x63]);
        assert_eq!(decode::<RegionOfInterest>(&bytes).unwrap(), message);
        for more in [1, 2, 4] {
            let longer = [&bytes[..], &[0; 4][..more]].concat();
            let error = decode::<RegionOfInterest>(&longer).unwrap_err();
            assert_eq!(error.reason, CdrFault::Trailing(3 + more));
        }
        assert!(decode::<RegionOfInterest>(&bytes[..22]).is_err());
    }

    #[test]
    fn encoding_again_reuses_the_buffer() {
        let mut bytes = Vec::new();
        let message = ArmState::default();
        encode(&message, &mut bytes).unwrap();
        let (place, capacity, first) = (bytes.as_ptr(), bytes.capacity(), bytes.clone());
        encode(&message, &mut bytes).unwrap();
        assert_eq!((bytes.as_ptr(), bytes.capacity()), (place, capacity));
        assert_eq!(bytes, first);
    }

    proptest! {
        #[test]
        fn hostile_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..600), keep in any::<bool>()) {
            if keep && bytes.len() >= 4 {
                bytes[..4].copy_from_slice(&HEADER);
            }
            let _ = decode::<ArmState>(&bytes);
            let _ = decode::<Health>(&bytes);
            let _ = decode::<NormalEstimate>(&bytes);
            let _ = decode::<crate::standard::TFMessage>(&bytes);
        }

        #[test]
        fn a_flipped_byte_never_panics(at in 0usize..400, value in any::<u8>()) {
            let health = Health {
                rate_names: vec!["a".into(), "bb".into()],
                rates_hz: vec![1.0, 2.0],
                ..Health::default()
            };
            let mut bytes = Vec::new();
            encode(&health, &mut bytes).unwrap();
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = decode::<Health>(&bytes);
        }

        #[test]
        fn what_goes_in_comes_out(names in prop::collection::vec("[a-zä ]{0,9}", 0..5),
                                  rates in prop::collection::vec(any::<f64>().prop_filter("comparable", |x| !x.is_nan()), 0..5),
                                  missed in any::<u64>(), state in any::<u8>()) {
            let health = Health { rate_names: names, rates_hz: rates, missed_cycles: missed, state, ..Health::default() };
            let mut bytes = Vec::new();
            encode(&health, &mut bytes).unwrap();
            prop_assert_eq!(decode::<Health>(&bytes).unwrap(), health);
        }
    }
}
