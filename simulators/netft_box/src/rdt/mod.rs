//! The box without its sockets: requests and time are inputs, datagrams are outputs.

use std::net::SocketAddr;

use tangent_netft::codec::{
    Command, FT_RATE_HZ, RECORD_LENGTH, RECORDS_MAX, Record, Request, Status,
};

use crate::Settings;
use crate::fault::NetbFault;
use crate::samples::BoxSample;

/// The client that receives the stream.
#[derive(Clone, Copy, Debug)]
struct Client {
    address: SocketAddr,
    buffered: bool,
    /// Number of records still to send; `None`: unlimited.
    left: Option<u32>,
    rdt_sequence: u32,
}

/// The box's state.
#[derive(Debug)]
pub(crate) struct RdtBox {
    client: Option<Client>,
    ft_sequence: u32,
    bias: [i32; 6],
    last: [i32; 6],
    /// Counts of the last record.
    told: [i32; 6],
    random: Xorshift,
    noise: i32,
    threshold: Option<[i32; 6]>,
    latched: bool,
    datagram: Vec<u8>,
    held: Option<Vec<u8>>,
    faults: Faults,
}

/// xorshift64: the noise is identical in every run.
#[derive(Clone, Copy, Debug)]
struct Xorshift(u64);

impl Xorshift {
    /// A uniformly distributed number between `-half` and `half`.
    fn within(&mut self, half: i32) -> i32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        let width = 2 * i64::from(half) + 1;
        ((self.0 >> 1) as i64 % width - i64::from(half)) as i32
    }
}

#[derive(Debug, Default)]
struct Faults {
    drop: u32,
    duplicate: u32,
    reorder: bool,
    corrupt: u32,
    saturate: u32,
    status: u32,
    status_records: u32,
    frozen: Option<[i32; 6]>,
    stuck: Option<(usize, i32)>,
    implausible: u32,
}

impl RdtBox {
    /// `threshold` and `noise_counts`, the half width of the converters' noise, are in counts.
    pub(crate) fn new(threshold: Option<[i32; 6]>, noise_counts: u32) -> Self {
        Self {
            client: None,
            ft_sequence: 0,
            bias: [0; 6],
            last: [0; 6],
            told: [0; 6],
            random: Xorshift(0x9e37_79b9_7f4a_7c15),
            noise: i32::try_from(noise_counts).unwrap_or(i32::MAX),
            threshold,
            latched: false,
            datagram: Vec::with_capacity(RECORD_LENGTH * RECORDS_MAX),
            held: None,
            faults: Faults::default(),
        }
    }

    /// Whether a client receives the stream.
    pub(crate) fn is_streaming(&self) -> bool {
        self.client.is_some()
    }

    /// Processes a datagram of any client; true if it is a request. The newest request takes over
    /// the stream.
    pub(crate) fn request(&mut self, bytes: &[u8], from: SocketAddr) -> bool {
        let Ok(request) = Request::from_bytes(bytes) else {
            return false;
        };
        match request.command {
            Command::Stop => self.client = None,
            Command::RealTime | Command::Buffered | Command::MultiUnit => {
                self.datagram.clear();
                self.client = Some(Client {
                    address: from,
                    buffered: request.command == Command::Buffered,
                    left: (request.sample_count > 0).then_some(request.sample_count),
                    rdt_sequence: 0,
                });
            }
            Command::ResetThresholdLatch => self.latched = false,
            Command::SetSoftwareBias => self.bias = self.last,
        }
        true
    }

    /// Injects a fault from the next record on. The caller handles faults with a duration.
    pub(crate) fn inject(&mut self, fault: NetbFault) {
        match fault {
            NetbFault::Drop(n) => self.faults.drop = n,
            NetbFault::Duplicate(n) => self.faults.duplicate = n,
            NetbFault::Reorder => self.faults.reorder = true,
            NetbFault::Corrupt(n) => self.faults.corrupt = n,
            NetbFault::Saturate(n) => self.faults.saturate = n,
            NetbFault::Status { word, records } => {
                self.faults.status = word;
                self.faults.status_records = records;
            }
            NetbFault::Freeze(on) => self.faults.frozen = on.then_some(self.told),
            NetbFault::StickAxis(axis) => {
                self.faults.stuck = axis.and_then(|axis| Some((axis, *self.told.get(axis)?)));
            }
            NetbFault::Implausible { one_of } => self.faults.implausible = one_of,
            NetbFault::ForgetClient => self.client = None,
            NetbFault::Restart(_) => {
                *self = Self::new(self.threshold, self.noise.unsigned_abs());
            }
            NetbFault::Silence(_) => {}
        }
    }

    /// Counts of the box's clock between two records at this rate: the box divides its 7 kHz by a
    /// whole number.
    pub(crate) fn step(rate_hz: u32) -> u32 {
        (FT_RATE_HZ / f64::from(rate_hz.max(1))).round().max(1.0) as u32
    }

    /// Advances the clock without sending records.
    pub(crate) fn skip(&mut self, counts: u32) {
        self.ft_sequence = self.ft_sequence.wrapping_add(counts);
    }

    /// Processes the time of one record. Datagrams go to `send`; true if a record was made.
    pub(crate) fn tick(
        &mut self,
        sample: BoxSample,
        settings: Settings,
        mut send: impl FnMut(&[u8], SocketAddr),
    ) -> bool {
        self.skip(Self::step(settings.rate_hz));
        let record = self.reading(sample);
        let Some(client) = &mut self.client else {
            return false;
        };
        client.rdt_sequence = client.rdt_sequence.wrapping_add(1);
        let record = Record {
            rdt_sequence: client.rdt_sequence,
            ..record
        };
        let (address, buffered) = (client.address, client.buffered);
        let mut last = false;
        if let Some(left) = &mut client.left {
            *left -= 1;
            last = *left == 0;
        }
        if self.faults.drop > 0 {
            self.faults.drop -= 1;
        } else {
            self.datagram.extend_from_slice(&record.to_bytes());
        }
        let records = self.datagram.len() / RECORD_LENGTH;
        if last || !buffered || records >= settings.buffer_records as usize {
            self.flush(address, &mut send);
        }
        if last {
            self.client = None;
        }
        true
    }

    /// The present reading of the sensor, as a record without a client's sequence.
    fn reading(&mut self, sample: BoxSample) -> Record {
        self.last = sample.counts;
        let mut counts: [i32; 6] =
            std::array::from_fn(|i| sample.counts[i].saturating_sub(self.bias[i]));
        if self.noise > 0 {
            counts = counts.map(|count| count.saturating_add(self.random.within(self.noise)));
        }
        counts = self.faults.frozen.unwrap_or(counts);
        if let Some((axis, count)) = self.faults.stuck {
            counts[axis] = count;
        }
        self.told = counts;
        if self.faults.implausible > 0 && self.ft_sequence.is_multiple_of(self.faults.implausible) {
            counts = counts.map(|_| self.random.within(i32::MAX / 2));
        }
        let mut status = 0;
        if sample.saturated || self.faults.saturate > 0 {
            status |= Status::SUMMARY | Status::SATURATION;
        }
        if self.faults.saturate > 0 {
            self.faults.saturate -= 1;
            counts = counts.map(|count| count / 2 + 12_345_678);
        }
        if let Some(threshold) = self.threshold {
            let beyond = |i: usize| counts[i].unsigned_abs() > threshold[i].unsigned_abs();
            self.latched |= (0..6).any(beyond);
        }
        if self.latched {
            status |= Status::SUMMARY | Status::THRESHOLD;
        }
        if self.faults.status_records > 0 {
            self.faults.status_records -= 1;
            status |= self.faults.status;
        }
        Record {
            rdt_sequence: 0,
            ft_sequence: self.ft_sequence,
            status: Status(status),
            counts,
        }
    }

    fn flush(&mut self, address: SocketAddr, send: &mut impl FnMut(&[u8], SocketAddr)) {
        if self.datagram.is_empty() {
            return;
        }
        if self.faults.corrupt > 0 {
            self.faults.corrupt -= 1;
            send(&self.datagram[..self.datagram.len() - 7], address);
        }
        if self.faults.reorder {
            self.faults.reorder = false;
            self.held = Some(self.datagram.clone());
        } else {
            send(&self.datagram, address);
            if self.faults.duplicate > 0 {
                self.faults.duplicate -= 1;
                send(&self.datagram, address);
            }
            if let Some(held) = self.held.take() {
                send(&held, address);
            }
        }
        self.datagram.clear();
    }
}

#[cfg(test)]
mod tests;
