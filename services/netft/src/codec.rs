//! RDT, the Net F/T's UDP protocol: encoding and decoding of requests and records, for both sides,
//! without a socket.

use tangent_sensing::SensorCondition;

/// UDP port of RDT on a real box.
pub const RDT_PORT: u16 = 49152;
/// Rate of the box's own clock, counted by [`Record::ft_sequence`], Hz.
pub const FT_RATE_HZ: f64 = 7000.0;
/// Length of a request, bytes.
pub const REQUEST_LENGTH: usize = 8;
/// Length of a record, bytes.
pub const RECORD_LENGTH: usize = 36;
/// Largest number of records in one datagram.
pub const RECORDS_MAX: usize = 40;
/// Length of the longest datagram that a box sends, bytes.
pub const DATAGRAM_MAX: usize = RECORD_LENGTH * RECORDS_MAX;

const HEADER: u16 = 0x1234;

/// Why bytes are not valid RDT.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// A request of another length.
    #[error("a request of {0} bytes: RDT requests have {REQUEST_LENGTH} bytes")]
    RequestLength(usize),
    /// A request with another header.
    #[error("a request that begins with {0:#06x}: RDT begins with {HEADER:#06x}")]
    Header(u16),
    /// An unknown command.
    #[error("unknown RDT command {0:#06x}")]
    Command(u16),
    /// A datagram that is not a whole number of records.
    #[error(
        "a datagram of {0} bytes: RDT sends 1 to {RECORDS_MAX} records of {RECORD_LENGTH} bytes each"
    )]
    DatagramLength(usize),
}

/// Command of a client to the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// End the stream.
    Stop,
    /// One record per datagram.
    RealTime,
    /// Several records per datagram, as the box is configured (`comrdtbsiz`).
    Buffered,
    /// Records of several boxes.
    MultiUnit,
    /// Reset a force threshold that has tripped.
    ResetThresholdLatch,
    /// Make the present reading the box's zero, permanently and for every client.
    SetSoftwareBias,
}

impl Command {
    const ALL: [(Self, u16); 6] = [
        (Self::Stop, 0),
        (Self::RealTime, 2),
        (Self::Buffered, 3),
        (Self::MultiUnit, 4),
        (Self::ResetThresholdLatch, 0x41),
        (Self::SetSoftwareBias, 0x42),
    ];

    /// Number of the command in a request.
    pub fn code(self) -> u16 {
        Self::ALL
            .iter()
            .find(|(command, _)| *command == self)
            .map_or(0, |(_, code)| *code)
    }
}

/// A client's datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// The command.
    pub command: Command,
    /// Number of records to send; 0: unlimited.
    pub sample_count: u32,
}

impl Request {
    /// Encodes the request.
    pub fn to_bytes(self) -> [u8; REQUEST_LENGTH] {
        let mut bytes = [0; REQUEST_LENGTH];
        bytes[..2].copy_from_slice(&HEADER.to_be_bytes());
        bytes[2..4].copy_from_slice(&self.command.code().to_be_bytes());
        bytes[4..].copy_from_slice(&self.sample_count.to_be_bytes());
        bytes
    }

    /// # Errors
    /// Another length, header or command than RDT's.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CodecError> {
        let &[h0, h1, c0, c1, n0, n1, n2, n3] = bytes else {
            return Err(CodecError::RequestLength(bytes.len()));
        };
        let header = u16::from_be_bytes([h0, h1]);
        if header != HEADER {
            return Err(CodecError::Header(header));
        }
        let code = u16::from_be_bytes([c0, c1]);
        let command = Command::ALL
            .iter()
            .find(|(_, known)| *known == code)
            .map(|(command, _)| *command)
            .ok_or(CodecError::Command(code))?;
        Ok(Self {
            command,
            sample_count: u32::from_be_bytes([n0, n1, n2, n3]),
        })
    }
}

/// The box's status word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(pub u32);

impl Status {
    /// Set if any error or warning is set.
    pub const SUMMARY: u32 = 1 << 31;
    /// A force threshold has tripped: a warning; the reading is valid.
    pub const THRESHOLD: u32 = 1 << 16;
    /// A gauge is at the end of its range: the reading is wrong, though it looks plausible.
    pub const SATURATION: u32 = 1 << 17;

    /// Names of all 32 bits, lowest first.
    pub const NAMES: [&'static str; 32] = [
        "watchdog reset",
        "DAC/ADC check too high",
        "DAC/ADC check too low",
        "analog ground out of range",
        "supply voltage too high",
        "supply voltage too low",
        "bad active calibration",
        "EEPROM failure",
        "invalid configuration",
        "reserved bit 9",
        "reserved bit 10",
        "sensor too hot",
        "sensor too cold",
        "reserved bit 13",
        "CAN bus error",
        "error in the sensor",
        "force threshold tripped",
        "gauge saturated",
        "reserved bit 18",
        "reserved bit 19",
        "reserved bit 20",
        "reserved bit 21",
        "reserved bit 22",
        "reserved bit 23",
        "reserved bit 24",
        "reserved bit 25",
        "reserved bit 26",
        "reserved bit 27",
        "reserved bit 28",
        "reserved bit 29",
        "reserved bit 30",
        "summary of errors and warnings",
    ];

    /// Whether the reading of the same record can be used. A tripped threshold is only a warning; a
    /// bit without a known name counts as an error.
    pub fn condition(self) -> SensorCondition {
        if self.0 & Self::SATURATION != 0 {
            SensorCondition::Saturated
        } else if self.0 & !(Self::SUMMARY | Self::THRESHOLD) != 0 || self.0 == Self::SUMMARY {
            SensorCondition::Error
        } else {
            SensorCondition::Good
        }
    }

    /// Names of the bits that are set, except the summary.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES
            .iter()
            .enumerate()
            .filter(move |(bit, _)| {
                self.0 >> bit & 1 == 1 && (*bit < 31 || self.0 == Self::SUMMARY)
            })
            .map(|(_, name)| *name)
    }
}

/// One reading of the sensor as the box sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record {
    /// Number of the record since the request, from 1.
    pub rdt_sequence: u32,
    /// Count of the box's own clock, 7 kHz at any rate of records.
    pub ft_sequence: u32,
    /// Status, which shows whether the counts are valid.
    pub status: Status,
    /// Fx, Fy, Fz, Tx, Ty, Tz in counts.
    pub counts: [i32; 6],
}

impl Record {
    /// Encodes the record.
    pub fn to_bytes(&self) -> [u8; RECORD_LENGTH] {
        let mut bytes = [0; RECORD_LENGTH];
        let words = [self.rdt_sequence, self.ft_sequence, self.status.0]
            .into_iter()
            .chain(self.counts.iter().map(|count| *count as u32));
        for (four, word) in bytes.chunks_exact_mut(4).zip(words) {
            four.copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let word = |i: usize| {
            bytes
                .get(4 * i..4 * i + 4)
                .and_then(|four| four.try_into().ok())
                .map_or(0, u32::from_be_bytes)
        };
        Self {
            rdt_sequence: word(0),
            ft_sequence: word(1),
            status: Status(word(2)),
            counts: std::array::from_fn(|i| word(3 + i) as i32),
        }
    }
}

/// The records of one datagram, oldest first.
///
/// # Errors
/// The datagram is empty, too long, or not a whole number of records; none of it is used.
pub fn records(datagram: &[u8]) -> Result<impl Iterator<Item = Record> + '_, CodecError> {
    let length = datagram.len();
    if length == 0 || length > DATAGRAM_MAX || !length.is_multiple_of(RECORD_LENGTH) {
        return Err(CodecError::DatagramLength(length));
    }
    Ok(datagram.chunks_exact(RECORD_LENGTH).map(Record::from_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    prop_compose! {
        fn record()(rdt_sequence: u32, ft_sequence: u32, status: u32, counts: [i32; 6]) -> Record {
            Record { rdt_sequence, ft_sequence, status: Status(status), counts }
        }
    }

    proptest! {
        #[test]
        fn a_datagram_there_and_back_is_itself(sent in prop::collection::vec(record(), 1..=RECORDS_MAX)) {
            let bytes: Vec<u8> = sent.iter().flat_map(Record::to_bytes).collect();
            prop_assert_eq!(records(&bytes).unwrap().collect::<Vec<_>>(), sent);
        }

        #[test]
        fn garbage_is_whole_records_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            match records(&bytes) {
                Ok(found) => prop_assert_eq!(found.count() * RECORD_LENGTH, bytes.len()),
                Err(error) => prop_assert_eq!(error, CodecError::DatagramLength(bytes.len())),
            }
            if let Ok(request) = Request::from_bytes(&bytes) {
                prop_assert_eq!(&request.to_bytes()[..], &bytes[..]);
            }
        }

        #[test]
        fn a_request_there_and_back_is_itself(command in 0usize..6, sample_count: u32) {
            let request = Request { command: Command::ALL[command].0, sample_count };
            prop_assert_eq!(Request::from_bytes(&request.to_bytes()), Ok(request));
        }

        #[test]
        fn a_status_is_good_only_without_errors(word: u32) {
            let good = matches!(word, 0 | 0x0001_0000 | 0x8001_0000);
            prop_assert_eq!(Status(word).condition() == SensorCondition::Good, good);
        }
    }

    #[test]
    fn bytes_are_those_of_the_manual() {
        let request = Request {
            command: Command::RealTime,
            sample_count: 0,
        };
        assert_eq!(request.to_bytes(), [0x12, 0x34, 0, 2, 0, 0, 0, 0]);
        let mut bytes = [0; RECORD_LENGTH];
        bytes[3] = 1;
        bytes[7] = 9;
        bytes[8..12].copy_from_slice(&[0x80, 0x02, 0, 0]);
        bytes[12..16].copy_from_slice(&[0xff, 0xff, 0xff, 0xfe]);
        let record = records(&bytes).unwrap().next().unwrap();
        assert_eq!((record.rdt_sequence, record.ft_sequence), (1, 9));
        assert_eq!(record.counts, [-2, 0, 0, 0, 0, 0]);
        assert_eq!(record.status.condition(), SensorCondition::Saturated);
    }

    #[test]
    fn every_bit_has_a_name_of_its_own() {
        for bit in 0..32 {
            let names: Vec<_> = Status(1 << bit).names().collect();
            assert_eq!(names, [Status::NAMES[bit]]);
            assert!(!Status::NAMES[..bit].contains(&Status::NAMES[bit]));
        }
        let names: Vec<_> = Status(0x8003_0000).names().collect();
        assert_eq!(names, ["force threshold tripped", "gauge saturated"]);
    }

    #[test]
    fn invalid_requests_are_refused_with_the_reason() {
        assert_eq!(
            Request::from_bytes(&[0x12, 0x34, 0, 9, 0, 0, 0, 0])
                .unwrap_err()
                .to_string(),
            "unknown RDT command 0x0009"
        );
        assert_eq!(Request::from_bytes(&[0; 8]), Err(CodecError::Header(0)));
        assert_eq!(Request::from_bytes(&[]), Err(CodecError::RequestLength(0)));
    }
}
