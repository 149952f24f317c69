//! The box without its sockets: requests and time go in, datagrams come out.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tangent_netft::codec::{
    Command, FT_RATE_HZ, RECORD_LENGTH, RECORDS_MAX, Record, Request, Status,
};

use super::{NetbFault, Settings};

/// Most samples that wait for their time: 0.4 s at 7 kHz.
const SAMPLES_MAX: usize = 2800;

/// One reading of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoxSample {
    /// Fx, Fy, Fz, Tx, Ty, Tz in counts.
    pub counts: [i32; 6],
    /// A gauge is at its end.
    pub saturated: bool,
}

/// Longest wait for a sample whose time has come: a plant computes a period a little after it
/// began. Without the wait, the records of that little would all repeat one sample, and its noise
/// would weigh as much as theirs together.
const SAMPLE_PATIENCE: Duration = Duration::from_millis(10);

/// Samples that wait for their time.
#[derive(Debug, Default)]
pub(super) struct SampleQueue {
    waiting: VecDeque<(Instant, BoxSample)>,
    now: BoxSample,
    /// End of the last sample's time; none when a reading holds for ever.
    known_until: Option<Instant>,
}

impl SampleQueue {
    pub(super) fn push(&mut self, first: Instant, interval: Duration, samples: &[BoxSample]) {
        let mut time = first;
        for sample in samples {
            if self.waiting.len() == SAMPLES_MAX {
                self.waiting.pop_front();
            }
            self.waiting.push_back((time, *sample));
            time += interval;
        }
        self.known_until = Some(time);
    }

    pub(super) fn hold(&mut self, sample: BoxSample) {
        self.waiting.clear();
        self.now = sample;
        self.known_until = None;
    }

    /// The reading at `time`, of the past at `now`; none while it may still come.
    pub(super) fn at(&mut self, time: Instant, now: Instant) -> Option<BoxSample> {
        let unknown = self.known_until.is_some_and(|until| time >= until);
        if unknown && now.saturating_duration_since(time) < SAMPLE_PATIENCE {
            return None;
        }
        while let Some((start, sample)) = self.waiting.front()
            && *start <= time
        {
            self.now = *sample;
            self.waiting.pop_front();
        }
        Some(self.now)
    }
}

/// The one client that gets the stream.
#[derive(Clone, Copy, Debug)]
struct Client {
    address: SocketAddr,
    buffered: bool,
    /// Records still to send; none: without end.
    left: Option<u32>,
    rdt_sequence: u32,
}

/// The box's state.
#[derive(Debug)]
pub(super) struct RdtBox {
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

/// xorshift64: the same noise in every run.
#[derive(Clone, Copy, Debug)]
struct Xorshift(u64);

impl Xorshift {
    /// Between plus and minus `half`, evenly.
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
    /// `threshold` in counts; `noise_counts` is the half width of its converters' noise.
    pub(super) fn new(threshold: Option<[i32; 6]>, noise_counts: u32) -> Self {
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

    /// True while somebody is served.
    pub(super) fn is_streaming(&self) -> bool {
        self.client.is_some()
    }

    /// A datagram from anybody; true when it is a request. The newest request takes the stream.
    pub(super) fn request(&mut self, bytes: &[u8], from: SocketAddr) -> bool {
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

    /// From the next record on. Times are kept by the caller.
    pub(super) fn inject(&mut self, fault: NetbFault) {
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
    pub(super) fn step(rate_hz: u32) -> u32 {
        (FT_RATE_HZ / f64::from(rate_hz.max(1))).round().max(1.0) as u32
    }

    /// The clock runs on unheard.
    pub(super) fn skip(&mut self, counts: u32) {
        self.ft_sequence = self.ft_sequence.wrapping_add(counts);
    }

    /// One record's time has come. Datagrams go to `send`; true when a record was made.
    pub(super) fn tick(
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

    /// What the sensor reads now, as a record without a client's sequence.
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
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_netft::codec::records;

    const SETTINGS: Settings = Settings {
        rate_hz: 7000,
        buffer_records: 4,
    };

    fn client(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn ask(simulated: &mut RdtBox, command: Command, sample_count: u32, port: u16) {
        let request = Request {
            command,
            sample_count,
        };
        assert!(simulated.request(&request.to_bytes(), client(port)));
    }

    /// Datagrams of `ticks` records, each with its receiver's port and its records.
    fn run(simulated: &mut RdtBox, ticks: usize, sample: BoxSample) -> Vec<(u16, Vec<Record>)> {
        let mut sent = Vec::new();
        for _ in 0..ticks {
            simulated.tick(sample, SETTINGS, |bytes, to| {
                let found = records(bytes).map(Iterator::collect).unwrap_or_default();
                sent.push((to.port(), found));
            });
        }
        sent
    }

    fn sequences(sent: &[(u16, Vec<Record>)]) -> Vec<Vec<u32>> {
        sent.iter()
            .map(|(_, records)| records.iter().map(|r| r.rdt_sequence).collect())
            .collect()
    }

    #[test]
    fn real_time_sends_one_record_each_and_stops_after_the_count() {
        let mut simulated = RdtBox::new(None, 0);
        ask(&mut simulated, Command::RealTime, 3, 1);
        let sent = run(&mut simulated, 9, BoxSample::default());
        assert_eq!(sequences(&sent), [[1], [2], [3]]);
        assert!(!simulated.is_streaming());
    }

    #[test]
    fn buffered_sends_several_and_the_rest_at_the_end() {
        let mut simulated = RdtBox::new(None, 0);
        ask(&mut simulated, Command::Buffered, 6, 1);
        let sent = run(&mut simulated, 9, BoxSample::default());
        assert_eq!(sequences(&sent), [vec![1, 2, 3, 4], vec![5, 6]]);
    }

    #[test]
    fn the_newest_request_takes_the_stream_and_the_clock_runs_on() {
        let mut simulated = RdtBox::new(None, 0);
        ask(&mut simulated, Command::RealTime, 0, 1);
        let first = run(&mut simulated, 2, BoxSample::default());
        ask(&mut simulated, Command::RealTime, 0, 2);
        let second = run(&mut simulated, 1, BoxSample::default());
        assert_eq!((first[1].0, second[0].0), (1, 2));
        assert_eq!(second[0].1[0].rdt_sequence, 1);
        assert_eq!(second[0].1[0].ft_sequence, first[1].1[0].ft_sequence + 1);
    }

    #[test]
    fn a_software_bias_is_for_everybody_and_for_good() {
        let mut simulated = RdtBox::new(None, 0);
        let sample = BoxSample {
            counts: [5, -5, 7, 0, 1, 2],
            saturated: false,
        };
        ask(&mut simulated, Command::RealTime, 0, 1);
        assert_eq!(run(&mut simulated, 1, sample)[0].1[0].counts, sample.counts);
        ask(&mut simulated, Command::SetSoftwareBias, 0, 3);
        ask(&mut simulated, Command::RealTime, 0, 2);
        assert_eq!(run(&mut simulated, 1, sample)[0].1[0].counts, [0; 6]);
    }

    #[test]
    fn a_threshold_latches_until_it_is_reset() {
        let mut simulated = RdtBox::new(Some([100; 6]), 0);
        let strong = BoxSample {
            counts: [0, 0, -101, 0, 0, 0],
            saturated: false,
        };
        ask(&mut simulated, Command::RealTime, 0, 1);
        let status = |sent: Vec<(u16, Vec<Record>)>| sent[0].1[0].status;
        assert_eq!(status(run(&mut simulated, 1, strong)), Status(0x8001_0000));
        let latched = status(run(&mut simulated, 1, BoxSample::default()));
        assert_eq!(latched, Status(0x8001_0000));
        ask(&mut simulated, Command::ResetThresholdLatch, 0, 1);
        assert_eq!(
            status(run(&mut simulated, 1, BoxSample::default())),
            Status(0)
        );
    }

    #[test]
    fn faults_are_what_they_say() {
        let mut simulated = RdtBox::new(None, 0);
        ask(&mut simulated, Command::RealTime, 0, 1);
        simulated.inject(NetbFault::Drop(2));
        assert_eq!(
            sequences(&run(&mut simulated, 3, BoxSample::default())),
            [[3]]
        );
        simulated.inject(NetbFault::Duplicate(1));
        assert_eq!(
            sequences(&run(&mut simulated, 2, BoxSample::default())),
            [[4], [4], [5]]
        );
        simulated.inject(NetbFault::Reorder);
        assert_eq!(
            sequences(&run(&mut simulated, 2, BoxSample::default())),
            [[7], [6]]
        );
        simulated.inject(NetbFault::Corrupt(1));
        let damaged: [Vec<u32>; 2] = [vec![], vec![8]];
        assert_eq!(
            sequences(&run(&mut simulated, 1, BoxSample::default())),
            damaged
        );
        simulated.inject(NetbFault::Saturate(1));
        let sent = run(&mut simulated, 2, BoxSample::default());
        assert_eq!(sent[0].1[0].status, Status(0x8002_0000));
        assert_eq!(sent[1].1[0].status, Status(0));
        simulated.inject(NetbFault::Restart(Duration::ZERO));
        assert!(!simulated.is_streaming());
    }

    #[test]
    fn a_frozen_box_goes_on_counting() {
        let mut simulated = RdtBox::new(None, 1000);
        ask(&mut simulated, Command::RealTime, 0, 1);
        let counts = |sent: &[(u16, Vec<Record>)]| -> Vec<[i32; 6]> {
            sent.iter().map(|(_, records)| records[0].counts).collect()
        };
        let alive = counts(&run(&mut simulated, 5, sample(50_000)));
        assert!(alive.windows(2).all(|w| w[0] != w[1]), "{alive:?}");
        assert!(alive.iter().flatten().all(|c| (c - 50_000).abs() <= 1000));
        simulated.inject(NetbFault::Freeze(true));
        let frozen = run(&mut simulated, 5, sample(90_000));
        assert_eq!(counts(&frozen), [alive[4]; 5]);
        assert_eq!(sequences(&frozen), [[6], [7], [8], [9], [10]]);
        simulated.inject(NetbFault::Freeze(false));
        simulated.inject(NetbFault::StickAxis(Some(2)));
        let stuck = counts(&run(&mut simulated, 5, sample(90_000)));
        assert!(
            stuck
                .windows(2)
                .all(|w| w[0][2] == w[1][2] && w[0][1] != w[1][1])
        );
        simulated.inject(NetbFault::StickAxis(None));
        simulated.inject(NetbFault::Implausible { one_of: 4 });
        let wild = counts(&run(&mut simulated, 40, sample(0)));
        let far = wild.iter().filter(|c| c[0].abs() > 1000).count();
        assert!((8..=10).contains(&far), "{far}");
    }

    fn sample(x: i32) -> BoxSample {
        BoxSample {
            counts: [x; 6],
            saturated: false,
        }
    }

    #[test]
    fn samples_are_read_at_their_time_and_the_last_stays() {
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut queue = SampleQueue::default();
        let read = |queue: &mut SampleQueue, at: u64, now: u64| {
            queue
                .at(start + ms(at), start + ms(now))
                .map(|s| s.counts[0])
        };
        assert_eq!(read(&mut queue, 0, 0), Some(0), "never fed");
        queue.push(start, ms(1), &[sample(1), sample(2), sample(3)]);
        assert_eq!(read(&mut queue, 0, 0), Some(1));
        assert_eq!(read(&mut queue, 1, 1), Some(2));
        assert_eq!(read(&mut queue, 2, 2), Some(3));
        assert_eq!(read(&mut queue, 3, 3), None, "may still come");
        assert_eq!(read(&mut queue, 3, 12), None);
        assert_eq!(read(&mut queue, 3, 13), Some(3), "does not come");
        queue.push(start + ms(1), ms(1), &[sample(4), sample(5)]);
        assert_eq!(read(&mut queue, 4, 20), Some(5), "the past is skipped");
        queue.hold(sample(6));
        assert_eq!(read(&mut queue, 90, 90), Some(6));
    }

    #[test]
    fn a_plant_that_computes_its_period_late_has_every_sample_read_once() {
        // As in the cell: samples of a period of 8 ms, known 2.3 ms after it began; the box looks
        // every 0.2 ms.
        let us = Duration::from_micros;
        let (start, interval) = (Instant::now(), us(125));
        let mut queue = SampleQueue::default();
        queue.push(start, interval, &[sample(0)]);
        let (mut due, mut read) = (start, Vec::new());
        let mut pushed = 0;
        for look in 0..400 {
            let now = start + us(200) * look;
            if now >= start + us(2300) + us(8000) * pushed {
                let first = 1 + 64 * pushed as i32;
                let samples: Vec<_> = (first..first + 64).map(sample).collect();
                queue.push(start + us(8000) * pushed + interval, interval, &samples);
                pushed += 1;
            }
            while due <= now
                && let Some(sample) = queue.at(due, now)
            {
                read.push(sample.counts[0]);
                due += interval;
            }
        }
        assert!(read.len() > 600, "{} read", read.len());
        let all: Vec<i32> = (0..read.len() as i32).collect();
        assert_eq!(read, all);
    }

    proptest! {
        #[test]
        fn no_request_whatever_breaks_the_box(requests in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..12), 0..20),
                                              faults: [u8; 4]) {
            let mut simulated = RdtBox::new(Some([i32::MIN; 6]), 0);
            simulated.inject(NetbFault::Duplicate(u32::from(faults[0])));
            simulated.inject(NetbFault::Drop(u32::from(faults[1])));
            for bytes in requests {
                simulated.request(&bytes, client(9));
                for _ in 0..3 {
                    let sample = BoxSample { counts: [i32::MIN; 6], saturated: true };
                    simulated.tick(sample, SETTINGS, |bytes, _| assert!(bytes.len() <= RECORD_LENGTH * RECORDS_MAX));
                }
            }
        }
    }
}
