//! Driver for a wrench on the bus: the reading of an e-Series arm's own sensor (`arm/wrench`), or a
//! topic of another program.
//!
//! A sample is conditioned and published in the thread that publishes it, so that a controller in
//! the same process gets the wrench of the present robot packet. The service's own thread only
//! reports silence.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tangent_mechanics::{Sensor, Tool, Wrench};
use tangent_runtime::bus::Received;
use tangent_runtime::{
    Beat, Bus, HealthReporter, Publisher, RealtimeReport, Stop, clock as host_clock,
};
use tangent_schemas::Text;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::WrenchStatus;
use tangent_schemas::topics::{self, Delivery, Topic};
use tangent_sensing::{ConditionedWrench, SensorCondition, Validity};
use tangent_tare::tell_zero;

use crate::conditioning::{Conditioning, WrenchSample};
use crate::config::{BusSource, Config};
use crate::meters::Meters;
use crate::stream::StreamCounts;
use crate::{NetftError, SERVICE};

/// Resolution by which a frozen sensor is detected, parts per N or Nm. The numbers of a message are
/// not counts of a converter.
const COUNTS_PER_UNIT: f64 = 1e6;
/// Interval between two checks for silence.
const TICK: Duration = Duration::from_millis(10);
/// Interval between two reports of silence.
const SILENCE_PERIOD: Duration = Duration::from_millis(50);
/// Time over which the rate is measured, s.
const RATE_WINDOW_S: f64 = 2.0;
/// Largest relative deviation of the measured rate from the configured one: beyond it, the filter
/// has another cut-off than the cell file states.
const RATE_TOLERANCE: f64 = 0.2;
/// Gap between two stamps, in periods, from which samples are counted as lost. Stamps are times of
/// arrival, which jitter.
const GAP_PERIODS: f64 = 2.5;

/// Runs until `stop`.
///
/// # Errors
/// A setting is out of range, or the bus refuses a topic.
pub(crate) fn run(
    config: Config,
    source: &BusSource,
    bus: &Bus,
    conditioning: Conditioning,
    health: HealthReporter,
    stop: &Stop,
) -> Result<(), NetftError> {
    health.realtime(&RealtimeReport::not_asked(SERVICE));
    let patience = crate::receiver::patience(config.patience, config.rate_hz);
    let seen = Arc::new(Seen::default());
    let topic: Topic<WrenchStamped> = Topic::named(source.key.clone(), Delivery::RealTime);
    let epoch = Instant::now();
    let driver = BusDriver::new(config, source, bus, conditioning, health, epoch, &seen)?;
    let driver = Arc::new(Mutex::new(driver));
    let (taking, noticed) = (Arc::clone(&driver), Arc::clone(&seen));
    let handle = bus.on(&topic, move |received| {
        // The publisher is a real-time loop, which must not wait. The lock is taken only while
        // silence is reported; a sample that is not taken then counts as lost.
        if let Ok(mut driver) = taking.try_lock() {
            driver.take(received, &noticed);
        }
    })?;
    tracing::info!("reading the wrench on {}", source.key);
    let beat = Beat::new(SERVICE);
    let mut told: Option<Instant> = None;
    while !stop.wait(TICK) {
        beat.beat();
        let since = epoch
            .elapsed()
            .saturating_sub(Duration::from_nanos(seen.arrived_ns().unsigned_abs()));
        if since < patience {
            if told.take().is_some() {
                tracing::info!("the wrench on {} is back", source.key);
            }
            continue;
        }
        let first = told.is_none();
        if first || told.is_some_and(|at| at.elapsed() >= SILENCE_PERIOD) {
            told = Some(Instant::now());
            let mut driver = driver.lock().unwrap_or_else(PoisonError::into_inner);
            driver.silent(source, first, &seen);
        }
    }
    drop(handle);
    Ok(())
}

/// State of the driver, for the thread that detects silence.
#[derive(Debug, Default)]
struct Seen {
    /// Arrival of the last sample since the driver's epoch, ns; 0 before the first.
    arrived_ns: AtomicI64,
    /// Whether the newest message was refused because of its frame.
    wrong_frame: AtomicBool,
}

impl Seen {
    fn arrived_ns(&self) -> i64 {
        self.arrived_ns.load(Ordering::Acquire)
    }
}

struct BusDriver {
    config: Config,
    frame: Option<String>,
    sign: f64,
    raw: Publisher<WrenchStamped>,
    tool: Publisher<WrenchStamped>,
    status: Publisher<WrenchStatus>,
    conditioning: Conditioning,
    epoch: Instant,
    patience: Duration,
    health: HealthReporter,
    meters: Meters,
    counts: StreamCounts,
    /// Samples between two publications of the wrench, and of the raw reading.
    interval: u64,
    raw_interval: u64,
    since_published: u64,
    since_raw: u64,
    last: Option<Last>,
    newest: Option<(ConditionedWrench, i64)>,
    silent: bool,
    rate: RateMeter,
    /// Present content of the health message: validity, and whether the rate is wrong.
    told: Option<(Validity, bool)>,
}

/// The last message that was taken.
#[derive(Clone, Copy, Debug)]
struct Last {
    publisher: [u8; 16],
    sequence: u64,
    stamp_ns: i64,
    received: Instant,
}

impl BusDriver {
    fn new(
        config: Config,
        source: &BusSource,
        bus: &Bus,
        mut conditioning: Conditioning,
        health: HealthReporter,
        epoch: Instant,
        seen: &Seen,
    ) -> Result<Self, NetftError> {
        seen.arrived_ns.store(0, Ordering::Release);
        conditioning.adopt_rate(&config, config.rate_hz)?;
        conditioning.adopt_sensor(&config, &source.owner, 0.0);
        let interval = |hz: f64| (config.rate_hz / hz).round().max(1.0) as u64;
        Ok(Self {
            frame: source.frame.clone(),
            sign: if source.inverted { -1.0 } else { 1.0 },
            raw: bus.publisher(&topics::WRENCH_RAW)?,
            tool: bus.publisher(&topics::WRENCH_TOOL)?,
            status: bus.publisher(&topics::WRENCH_STATUS)?,
            conditioning,
            epoch,
            patience: crate::receiver::patience(config.patience, config.rate_hz),
            meters: Meters::new(&health),
            health,
            counts: StreamCounts::default(),
            interval: interval(config.tool_rate_hz),
            raw_interval: config.raw_rate_hz.map_or(1, interval),
            since_published: u64::MAX / 2,
            since_raw: u64::MAX / 2,
            last: None,
            newest: None,
            silent: true,
            rate: RateMeter::default(),
            told: None,
            config,
        })
    }

    /// Takes one message, in its publisher's thread. Takes no lock and allocates nothing.
    fn take(&mut self, received: &Received<WrenchStamped>, seen: &Seen) {
        let Some(missed) = self.admit(received, seen) else {
            return;
        };
        let arrival_s = self.since_epoch(received.received).as_secs_f64();
        let stamp_ns = stamp_ns(received);
        self.meters.record_age.mark();
        self.meters.records.tick();
        self.rate.tick(arrival_s);
        let wrench = &received.message.wrench;
        let (f, t) = (&wrench.force, &wrench.torque);
        let vector = [f.x, f.y, f.z, t.x, t.y, t.z].map(|value| self.sign * value);
        let sample = WrenchSample {
            // `as` saturates at the limits of the integer, far beyond any load.
            counts: vector.map(|value| (value * COUNTS_PER_UNIT).round() as i32),
            wrench: Wrench::<Sensor>::from_vector(&vector.into()),
            condition: SensorCondition::Good,
            missed,
            time_s: arrival_s,
            arrival_s,
        };
        self.since_raw += 1;
        if self.since_raw >= self.raw_interval {
            self.since_raw = 0;
            self.raw.publish(&WrenchStamped {
                header: Header::in_frame::<Sensor>(stamp_ns),
                wrench: (&sample.wrench).into(),
            });
        }
        self.conditioning.refresh_pose();
        self.since_published += 1;
        let Some(wrench) = self.conditioning.take(&self.config, &sample) else {
            return;
        };
        let turned_bad = wrench.validity != Validity::Valid
            && self
                .newest
                .is_some_and(|(newest, _)| newest.validity != wrench.validity);
        self.newest = Some((wrench, stamp_ns));
        if self.since_published < self.interval && !turned_bad {
            return;
        }
        self.since_published = 0;
        self.publish(&wrench, stamp_ns, received);
    }

    /// Whether the message is used, and the number of samples lost before it: it has to be in the
    /// right frame, from the one publisher, and newer than the last.
    fn admit(&mut self, received: &Received<WrenchStamped>, seen: &Seen) -> Option<u32> {
        let frame = received.message.header.frame_id.as_str();
        if self.frame.as_deref().is_some_and(|wanted| wanted != frame) {
            let before = seen.wrong_frame.swap(true, Ordering::Relaxed);
            if !before {
                self.tell_frame(frame);
            }
            return None;
        }
        seen.wrong_frame.store(false, Ordering::Relaxed);
        let stamp_ns = stamp_ns(received);
        let mut missed = 0;
        if let Some(last) = self.last {
            let pause = received.received.saturating_duration_since(last.received);
            if last.publisher != received.publisher {
                // Two programs that publish one wrench would alternate. Another one is accepted
                // once the first is silent.
                if pause < self.patience {
                    return None;
                }
            } else if stamp_ns <= last.stamp_ns && pause < self.patience {
                self.counts.out_of_order += 1;
                return None;
            } else {
                missed = self.missed(&last, received.sequence, stamp_ns);
            }
        }
        self.last = Some(Last {
            publisher: received.publisher,
            sequence: received.sequence,
            stamp_ns,
            received: received.received,
        });
        self.counts.records += 1;
        self.counts.lost = self.counts.lost.saturating_add(u64::from(missed));
        if std::mem::take(&mut self.silent) {
            self.counts.reconnects += u64::from(self.counts.records > 1);
            self.told = None;
            self.rate = RateMeter::default();
        }
        let arrived = self.since_epoch(received.received).as_nanos().max(1);
        let arrived = i64::try_from(arrived).unwrap_or(i64::MAX);
        seen.arrived_ns.store(arrived, Ordering::Release);
        Some(missed)
    }

    /// Samples lost since `last`: by the publisher's count, or by a gap between the stamps.
    fn missed(&self, last: &Last, sequence: u64, stamp_ns: i64) -> u32 {
        let counted = if sequence > 0 && last.sequence > 0 {
            sequence.saturating_sub(last.sequence).saturating_sub(1)
        } else {
            0
        };
        let periods = (stamp_ns.saturating_sub(last.stamp_ns)) as f64 * 1e-9 * self.config.rate_hz;
        let by_stamp = if periods > GAP_PERIODS {
            periods.round() as u64 - 1
        } else {
            0
        };
        u32::try_from(counted.max(by_stamp)).unwrap_or(u32::MAX)
    }

    fn publish(
        &mut self,
        wrench: &ConditionedWrench,
        stamp_ns: i64,
        received: &Received<WrenchStamped>,
    ) {
        self.status
            .publish(&self.message(wrench, wrench.validity, stamp_ns));
        self.tool.publish(&WrenchStamped {
            header: Header::in_frame::<Tool>(stamp_ns),
            wrench: (&wrench.wrench).into(),
        });
        self.meters.published.tick();
        self.meters
            .arrival_to_publish
            .record(received.received.elapsed());
        self.meters.tell(
            &self.counts,
            self.rate.hz,
            0.0,
            wrench.bias_age_s,
            self.conditioning.implausible(),
        );
        self.tell_state(wrench.validity);
        let (rate_hz, interval) = (self.config.rate_hz, self.interval as f64);
        self.conditioning.follow_cutoff(rate_hz, interval / rate_hz);
    }

    fn message(
        &self,
        wrench: &ConditionedWrench,
        validity: Validity,
        stamp_ns: i64,
    ) -> WrenchStatus {
        let mut status = WrenchStatus {
            header: Header::in_frame::<Tool>(stamp_ns),
            validity: validity as u8,
            status_text: status_text(validity),
            records: self.counts.records,
            records_lost: self.counts.lost,
            records_out_of_order: self.counts.out_of_order,
            reconnects: self.counts.reconnects,
            rate_hz: self.rate.hz,
            filter_delay_s: wrench.delay_s,
            records_implausible: self.conditioning.implausible(),
            stuck_axes: self.conditioning.stuck_axes(),
            ..WrenchStatus::default()
        };
        tell_zero(wrench, &self.config.conditioning.tare, &mut status);
        status
    }

    /// Reports silence: in the wrench's status each time, in the health message the first time.
    fn silent(&mut self, source: &BusSource, first: bool, seen: &Seen) {
        self.silent = true;
        self.told = None;
        if first && !seen.wrong_frame.load(Ordering::Relaxed) {
            tracing::warn!("no wrench on {}: {}", source.key, source.remedy);
            self.health.fault(format_args!(
                "no wrench on {}: {}",
                source.key, source.remedy
            ));
        }
        if let Some((wrench, _)) = self.newest {
            let stamp_ns = host_clock::now_ns();
            self.status
                .publish(&self.message(&wrench, Validity::Stale, stamp_ns));
        }
    }

    fn tell_frame(&self, frame: &str) {
        let wanted = self.frame.as_deref().unwrap_or_default();
        self.health.fault(format_args!(
            "the wrench is in frame \"{frame}\", [sensor.topic] frame = \"{wanted}\": correct one of them"
        ));
    }

    /// Reports in the health message whether the wrench can be used, when that changes.
    fn tell_state(&mut self, validity: Validity) {
        let wanted_hz = self.config.rate_hz;
        let wrong_rate =
            self.rate.hz > 0.0 && (self.rate.hz / wanted_hz - 1.0).abs() > RATE_TOLERANCE;
        if self.told == Some((validity, wrong_rate)) {
            return;
        }
        self.told = Some((validity, wrong_rate));
        if !validity.is_valid() {
            self.health.degraded(format_args!(
                "the wrench is not usable: {}",
                validity.reason()
            ));
        } else if wrong_rate {
            self.health.degraded(format_args!(
                "{:.0} samples per second, [sensor] rate_hz = {wanted_hz}: the filter's cut-off is wrong by as much; correct rate_hz",
                self.rate.hz
            ));
        } else {
            self.health.running();
        }
    }

    fn since_epoch(&self, instant: Instant) -> Duration {
        instant.saturating_duration_since(self.epoch)
    }
}

/// Time of measurement that the message states, or the time of its publication without one, ns
/// since the Unix epoch.
fn stamp_ns(received: &Received<WrenchStamped>) -> i64 {
    match received.message.header.stamp.to_ns() {
        stamp if stamp > 0 => stamp,
        _ => received.source_time_ns,
    }
}

fn status_text(validity: Validity) -> Text {
    if validity.is_valid() {
        Text::new()
    } else {
        cut(validity.reason())
    }
}

/// Rate of arrivals, measured over windows of [`RATE_WINDOW_S`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct RateMeter {
    /// Rate in the last window, Hz; 0 before its end.
    hz: f64,
    begun_s: Option<f64>,
    count: u32,
}

impl RateMeter {
    fn tick(&mut self, now_s: f64) {
        let begun_s = *self.begun_s.get_or_insert(now_s);
        let since_s = now_s - begun_s;
        if since_s >= RATE_WINDOW_S {
            self.hz = f64::from(self.count) / since_s;
            self.begun_s = Some(now_s);
            self.count = 0;
        }
        self.count += 1;
    }
}
