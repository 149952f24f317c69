//! The receiving thread: reads every datagram, publishes every record, and conditions the newest
//! one.

use std::time::{Duration, Instant};

use tangent_mechanics::{Sensor, Tool, Wrench};
use tangent_runtime::{
    Beat, Bus, HealthReporter, Publisher, RealtimeReport, Stop, clock as host_clock, realtime,
};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::WrenchStatus;
use tangent_schemas::topics;
use tangent_sensing::Validity;

use crate::box_config::BoxConfig;
use crate::clock::ClockRecovery;
use crate::codec::{self, Command, DATAGRAM_MAX, FT_RATE_HZ, Record};
use crate::conditioning::{Conditioning, WrenchSample};
use crate::config::Config;
use crate::connection::{Connection, Newest};
use crate::meters::Meters;
use crate::socket::RdtSocket;
use crate::stream::{Kind, Stream, StreamCounts};
use crate::{NetftError, SERVICE};

/// Largest number of datagrams read before the newest is published, so that a backlog after a stall
/// does not delay the present for long.
const BATCH: usize = 512;
/// Silence after which the box may have been replaced by another one.
const GONE: Duration = Duration::from_secs(2);
/// Interval between two reports of silence.
const SILENCE_PERIOD: Duration = Duration::from_millis(50);

/// Reason why receiving ended.
pub(crate) enum Ended {
    Stopped,
    Silent,
    Restarted,
}

/// State of the receiving thread.
pub(crate) struct Receiver {
    config: Config,
    raw: Publisher<WrenchStamped>,
    tool: Publisher<WrenchStamped>,
    status: Publisher<WrenchStatus>,
    conditioning: Conditioning,
    epoch: Instant,
    counts: StreamCounts,
    health: HealthReporter,
    meters: Meters,
}

impl Receiver {
    pub(crate) fn new(
        config: Config,
        bus: &Bus,
        conditioning: Conditioning,
        health: HealthReporter,
    ) -> Result<Self, NetftError> {
        Ok(Self {
            raw: bus.publisher(&topics::WRENCH_RAW)?,
            tool: bus.publisher(&topics::WRENCH_TOOL)?,
            status: bus.publisher(&topics::WRENCH_STATUS)?,
            conditioning,
            epoch: Instant::now(),
            counts: StreamCounts::default(),
            meters: Meters::new(&health),
            health,
            config,
        })
    }

    pub(crate) fn config(&self) -> &Config {
        &self.config
    }

    /// Requests real-time scheduling, as far as it is granted.
    pub(crate) fn setup_thread(&self) {
        let report = match self.config.realtime_priority {
            Some(priority) => realtime::setup_thread(SERVICE, priority),
            None => RealtimeReport::not_asked(SERVICE),
        };
        self.health.realtime(&report);
    }

    /// Reports that the web server answers, but no records arrive.
    pub(crate) fn report_silence(&self) {
        self.health.fault(format_args!(
            "{} answers over HTTP but sends no records: another client may have its stream, or a firewall blocks UDP",
            self.config.address
        ));
    }

    pub(crate) fn report_fault(&self, error: &NetftError) {
        tracing::warn!("{error}");
        self.health.fault(format_args!("{error}"));
    }

    /// Receives until stopped, or until the box is lost or has been replaced.
    pub(crate) fn receive(
        &mut self,
        found: &BoxConfig,
        stop: &Stop,
        beat: &Beat,
    ) -> Result<Ended, NetftError> {
        let rate_hz = found.rate_hz.unwrap_or(self.config.rate_hz);
        let patience = patience(self.config.patience, rate_hz);
        let socket = RdtSocket::connect(
            &self.config.address,
            self.config.rdt_port,
            self.config.socket_buffer_bytes,
            patience.min(Duration::from_millis(20)) / 2,
        )?;
        tracing::info!(
            "{} {} at {}, {} Hz; {}",
            found.product,
            found.serial,
            self.config.address,
            rate_hz,
            socket.buffer_words(rate_hz, self.config.socket_buffer_bytes)
        );
        self.meters
            .socket_buffer_records
            .set(socket.buffer_records() as f64);
        self.conditioning.adopt_rate(&self.config, rate_hz)?;
        let now_s = self.epoch.elapsed().as_secs_f64();
        self.conditioning
            .adopt_sensor(&self.config, &found.serial, now_s);
        let command = match self.config.buffer_records {
            None => Command::RealTime,
            Some(_) => Command::Buffered,
        };
        let mut connection = Connection {
            scales: found.scales(),
            stream: Stream::new(command, rate_hz, patience).with_counts(self.counts),
            clock: ClockRecovery::new(1.0 / FT_RATE_HZ),
            interval: (FT_RATE_HZ / self.config.tool_rate_hz).round().max(1.0) as i64,
            published: i64::MIN / 2,
            raw_interval: self
                .config
                .raw_rate_hz
                .map(|hz| (FT_RATE_HZ / hz).round().max(1.0) as i64),
            raw_published: i64::MIN / 2,
            newest: None,
            restarted: false,
            rate_hz,
            told: None,
            tare: self.config.conditioning.tare.clone(),
        };
        let ended = self.stream(&socket, &mut connection, stop, beat);
        self.counts = *connection.stream.counts();
        Ok(ended)
    }

    fn stream(
        &mut self,
        socket: &RdtSocket,
        connection: &mut Connection,
        stop: &Stop,
        beat: &Beat,
    ) -> Ended {
        // One byte more than the longest datagram, so that a longer one is detected, not truncated.
        let mut buffer = [0; DATAGRAM_MAX + 1];
        let begun = self.epoch.elapsed();
        let mut silence_told = begun;
        let mut was_silent = None;
        loop {
            beat.beat();
            if stop.is_stopped() {
                socket.send(codec::Request {
                    command: Command::Stop,
                    sample_count: 0,
                });
                return Ended::Stopped;
            }
            let now = self.epoch.elapsed();
            if let Some(request) = connection.stream.poll(now) {
                socket.send(request);
            }
            if let Some(datagram) = socket.wait(&mut buffer) {
                let offset_ns = self.unix_offset_ns();
                self.conditioning.refresh_pose();
                self.datagram(connection, datagram, offset_ns);
                for _ in 0..BATCH {
                    match socket.next(&mut buffer) {
                        Some(datagram) => self.datagram(connection, datagram, offset_ns),
                        None => break,
                    }
                }
                if connection.restarted {
                    return Ended::Restarted;
                }
                self.publish_newest(connection);
            }
            let now = self.epoch.elapsed();
            let silent = connection.stream.is_silent(now);
            if was_silent != Some(silent) {
                was_silent = Some(silent);
                self.tell_silence(connection, silent);
            }
            if silent {
                if now.saturating_sub(silence_told) >= SILENCE_PERIOD {
                    silence_told = now;
                    self.publish_silence(connection);
                }
                let since = connection
                    .stream
                    .silence(now)
                    .unwrap_or(now.saturating_sub(begun));
                if since >= GONE {
                    return Ended::Silent;
                }
            }
        }
    }

    /// Unix time of this thread's epoch, ns; measured for every batch, so that stamps follow
    /// the host's clock.
    fn unix_offset_ns(&self) -> i64 {
        host_clock::now_ns() - nanoseconds(self.epoch.elapsed())
    }

    fn datagram(&mut self, connection: &mut Connection, datagram: &[u8], offset_ns: i64) {
        let arrival = self.epoch.elapsed();
        let Ok(records) = codec::records(datagram) else {
            connection.stream.malformed();
            return;
        };
        self.meters.record_age.mark();
        let mut records = records.peekable();
        while let Some(record) = records.next() {
            let is_last = records.peek().is_none();
            self.record(connection, &record, arrival, is_last, offset_ns);
        }
    }

    /// Handles one record: counts it, stamps it, publishes it raw, and conditions it.
    fn record(
        &mut self,
        connection: &mut Connection,
        record: &Record,
        arrival: Duration,
        is_last: bool,
        offset_ns: i64,
    ) {
        let (sequence, kind) = connection.stream.take(record, arrival);
        let arrival_ns = nanoseconds(arrival);
        let missed = match kind {
            Kind::Double => return,
            Kind::First => {
                // The very first record is not a restart.
                connection.restarted |= connection.newest.is_some();
                connection.clock.restart();
                self.conditioning.restart();
                0
            }
            Kind::Next { missed } => missed,
            Kind::Late => 0,
        };
        // Only the last record of a datagram was sent as soon as it was measured.
        let stamp_ns = if is_last && kind != Kind::Late {
            connection.clock.observe(sequence, arrival_ns)
        } else {
            connection.clock.stamp(sequence, arrival_ns)
        };
        let wrench = Wrench::<Sensor>::from_vector(
            &std::array::from_fn::<f64, 6, _>(|i| {
                f64::from(record.counts[i]) * connection.scales[i]
            })
            .into(),
        );
        if connection.raw_is_due(sequence) {
            self.raw.publish(&WrenchStamped {
                header: Header::in_frame::<Sensor>(offset_ns + stamp_ns),
                wrench: (&wrench).into(),
            });
        }
        self.meters.records.tick();
        if kind == Kind::Late {
            return;
        }
        let sample = WrenchSample {
            counts: record.counts,
            wrench,
            condition: record.status.condition(),
            missed,
            time_s: stamp_ns as f64 * 1e-9,
            arrival_s: arrival.as_secs_f64(),
        };
        let Some(wrench) = self.conditioning.take(&self.config, &sample) else {
            return;
        };
        let turned_bad = wrench.validity != Validity::Valid
            && connection
                .newest
                .is_some_and(|newest| newest.wrench.validity != wrench.validity);
        connection.newest = Some(Newest {
            sequence,
            record: *record,
            stamp_ns: offset_ns + stamp_ns,
            wrench,
            arrival,
            implausible: self.conditioning.implausible(),
            stuck_axes: self.conditioning.stuck_axes(),
        });
        if turned_bad {
            // A status error is published at once: without decimation, and before the records that
            // have come since.
            connection.published = i64::MIN / 2;
            self.publish_newest(connection);
        }
    }

    /// Publishes the status, then the wrench, when they are due.
    fn publish_newest(&mut self, connection: &mut Connection) {
        let Some(newest) = connection.newest else {
            return;
        };
        let since = newest.sequence - connection.published;
        if since < connection.interval {
            return;
        }
        // Keeps in step with the sensor's clock, unless the stream has just begun or paused.
        connection.published = if since < 2 * connection.interval {
            connection.published + connection.interval
        } else {
            newest.sequence
        };
        let validity = newest.wrench.validity;
        self.status
            .publish(&connection.status(&newest, validity, newest.stamp_ns));
        self.tool.publish(&WrenchStamped {
            header: Header::in_frame::<Tool>(newest.stamp_ns),
            wrench: (&newest.wrench.wrench).into(),
        });
        let delay = self.epoch.elapsed().saturating_sub(newest.arrival);
        self.meters.arrival_to_publish.record(delay);
        self.meters.published.tick();
        self.tell_validity(connection, validity);
        self.tell_figures(connection, &newest);
        let dt_s = connection.interval as f64 / FT_RATE_HZ;
        self.conditioning.follow_cutoff(connection.rate_hz, dt_s);
    }

    fn publish_silence(&self, connection: &Connection) {
        if let Some(newest) = &connection.newest {
            let now_ns = host_clock::now_ns();
            self.status
                .publish(&connection.status(newest, Validity::Stale, now_ns));
        }
    }

    fn tell_silence(&self, connection: &mut Connection, silent: bool) {
        // After the stream returns, the next wrench reports its validity again.
        connection.told = None;
        if silent && connection.newest.is_some() {
            self.health.fault(format_args!(
                "{} sends no records: another client may have taken its stream, or it lost power or network; requesting again",
                self.config.address
            ));
        }
    }

    fn tell_figures(&self, connection: &Connection, newest: &Newest) {
        self.meters.tell(
            connection.stream.counts(),
            connection.rate_measured_hz(),
            connection.clock.residual_s(),
            newest.wrench.bias_age_s,
            newest.implausible,
        );
    }

    /// Reports in the health message whether the wrench can be used, when that changes.
    fn tell_validity(&self, connection: &mut Connection, validity: Validity) {
        if connection.told == Some(validity) {
            return;
        }
        connection.told = Some(validity);
        if validity.is_valid() {
            self.health.running();
        } else {
            self.health.degraded(format_args!(
                "the wrench is not usable: {}",
                validity.reason()
            ));
        }
    }
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

/// Silence after which a stream at `rate_hz` is reported: `asked`, or three record periods if that
/// is longer, so that a slow stream does not count as silent.
pub(crate) fn patience(asked: Duration, rate_hz: f64) -> Duration {
    let three = Duration::try_from_secs_f64(3.0 / rate_hz);
    asked.max(three.unwrap_or(asked))
}
