//! The loop: one robot packet in, one state published, one command out.
//!
//! The thread waits for the robot's packet, never for a timer of its own. Publishing the state runs
//! a controller of the same process, so its command is there when publishing returns; it passes the
//! guard and leaves in the same cycle. Once streaming, nothing here allocates, locks or waits but
//! for the robot.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::{Matrix6, Vector3, Vector6};
use tangent_mechanics::{Aligned, Base, Tool, Twist};
use tangent_runtime::{
    Age, Beat, Counter, Gauge, HealthReporter, Histogram, Publisher, Rate, State, Stop,
    Subscription, clock,
};
use tangent_schemas::convert::{cut_format, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState};

use crate::bridge::{Bridge, BridgeEvent};
use crate::codec::{Framer, PACKAGE_BYTES_MAX};
use crate::link::LinkError;
use crate::robot_setup::resolve;
use crate::settings::Config;
use crate::shared::{Note, Shared, Upload};
use crate::supervisor::Reason;
use tangent_actuation::lease::Source;
use tangent_actuation::velocity::Posture;
use tangent_actuation::{Command, CommandAccount};
use tangent_runtime::watchdog::TURN;

/// First and longest pause between attempts to connect.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(5));
/// The system's resolver may take so long for a name.
const RESOLVE: Duration = Duration::from_secs(60);
/// A state that is late by this many periods is not waited for: the heartbeat goes out.
const LATE_PERIODS: f64 = 1.5;
/// Commands that may wait for a cycle, from all sources together.
pub(crate) const COMMANDS_MAX: usize = 64;
/// A controller that takes no bytes for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_millis(200);

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
enum Lost {
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error("the controller closed the connection")]
    Closed,
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// What the loop measures; read by the health reporter.
pub(crate) struct Meters {
    pub states: Rate,
    pub packet: Age,
    pub packet_to_command: Histogram,
    pub command_latency: Histogram,
    pub heartbeats: Counter,
    pub heartbeats_shown: Gauge,
    pub missed: Counter,
    pub lost: Counter,
    pub refused: Gauge,
    pub refused_others: Gauge,
    pub limited: Gauge,
    pub scaling: Gauge,
    pub stale_max: Gauge,
    pub reconnects: Gauge,
}

impl Meters {
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            states: health.rate("arm_state"),
            packet: health.age("robot_packet"),
            packet_to_command: health.histogram("packet_to_command"),
            command_latency: health.histogram("command_latency"),
            heartbeats: Counter::default(),
            heartbeats_shown: health.gauge("late_states"),
            missed: health.missed_cycles(),
            lost: health.lost(),
            refused: health.gauge("commands_refused"),
            refused_others: health.gauge("commands_refused_other_source"),
            limited: health.gauge("commands_limited"),
            scaling: health.gauge("speed_scaling"),
            stale_max: health.gauge("program_stale_max_cycles"),
            reconnects: health.gauge("reconnects"),
        }
    }
}

pub(crate) struct Cycle {
    config: Arc<Config>,
    bridge: Bridge,
    publisher: Publisher<ArmState>,
    commands: Subscription<ArmCommand>,
    shared: Arc<Shared>,
    health: Arc<HealthReporter>,
    meters: Meters,
    stop: Stop,
    start: Instant,
    posture: Posture<6>,
    state: ArmState,
    out: Vec<u8>,
    account_of_commands: CommandAccount,
    told: Option<(Option<Reason>, Option<Source>)>,
}

impl Cycle {
    pub fn new(
        config: Arc<Config>,
        bridge: Bridge,
        publisher: Publisher<ArmState>,
        commands: Subscription<ArmCommand>,
        shared: Arc<Shared>,
        health: Arc<HealthReporter>,
        stop: Stop,
    ) -> Self {
        Self {
            meters: Meters::new(&health),
            config,
            bridge,
            publisher,
            commands,
            shared,
            health,
            stop,
            start: Instant::now(),
            posture: Posture {
                q: Vector6::zeros(),
                tool_m: Vector3::zeros(),
                tool_jacobian: Matrix6::zeros(),
            },
            state: ArmState::default(),
            out: Vec::with_capacity(4096),
            account_of_commands: CommandAccount::default(),
            told: None,
        }
    }

    /// Connects, serves, and connects again, until stopped.
    pub fn run(mut self) {
        let beat = Beat::new("rtde");
        let mut pause = BACKOFF.0;
        let mut connections = 0u32;
        let mut last = String::new();
        while !self.stop.is_stopped() {
            let cycles = self.bridge.cycle();
            beat.within(self.config.connect_timeout + RESOLVE);
            let ended = self.connect().and_then(|stream| {
                connections += 1;
                self.meters.reconnects.set(f64::from(connections - 1));
                self.serve(stream, &beat)
            });
            self.bridge.close();
            self.told = None;
            if let Err(error) = ended {
                let text = format!("{}:{}: {error}", self.config.host, self.config.rtde_port);
                self.health.fault(format_args!("{text}"));
                // The same reason again and again is one line, not a flood.
                if text == last {
                    tracing::debug!("{text}");
                } else {
                    tracing::warn!("{text}; trying again");
                }
                last = text;
            }
            if self.bridge.cycle() > cycles {
                pause = BACKOFF.0;
                last.clear();
            }
            beat.within(pause + TURN);
            if self.stop.wait(pause) {
                break;
            }
            pause = (pause * 2).min(BACKOFF.1);
        }
        self.shared.ended.store(true, Ordering::Release);
        self.shared.wake_setup();
    }

    fn connect(&self) -> Result<TcpStream, Lost> {
        let address = resolve(&self.config.host, self.config.rtde_port)?;
        let stream = TcpStream::connect_timeout(&address, self.config.connect_timeout)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(stream)
    }

    /// Something to tell; another thread writes it. No lock, no memory, no waiting.
    fn note(&self, note: Note) {
        self.shared.notes.force_push(note);
    }

    fn now_s(&self, instant: Instant) -> f64 {
        instant.saturating_duration_since(self.start).as_secs_f64()
    }

    /// One connection, until it breaks (an error) or the orderly end is done.
    fn serve(&mut self, mut stream: TcpStream, beat: &Beat) -> Result<(), Lost> {
        let mut framer = Framer::new(PACKAGE_BYTES_MAX);
        let mut period_s = self.bridge.period_s();
        let late = |period_s: f64| Duration::from_secs_f64(LATE_PERIODS * period_s);
        stream.set_read_timeout(Some(late(period_s)))?;
        self.out.clear();
        self.bridge
            .open(self.now_s(Instant::now()), &mut self.out)?;
        stream.write_all(&self.out)?;
        loop {
            // A turn waits for the robot's packet no longer than a period and a half: advancing, or
            // waiting for the robot.
            beat.beat();
            self.out.clear();
            let read = stream.read(framer.space());
            let arrival = Instant::now();
            match read {
                Ok(0) => return Err(Lost::Closed),
                Ok(n) => {
                    framer.filled(n);
                    let due = self.packages(&mut framer, arrival)?;
                    if due {
                        self.cycle(arrival)?;
                    }
                    if !self.out.is_empty() {
                        stream.write_all(&self.out)?;
                    }
                    if due {
                        self.account(arrival);
                    }
                }
                Err(error) if is_timeout(&error) => {
                    self.heartbeat(arrival)?;
                    stream.write_all(&self.out)?;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
            if self.bridge.period_s() != period_s {
                period_s = self.bridge.period_s();
                stream.set_read_timeout(Some(late(period_s)))?;
            }
            let now_s = self.now_s(arrival);
            self.bridge.check(now_s)?;
            if self.stop.is_stopped() {
                self.bridge.end(now_s);
            }
            if self.bridge.is_finished() {
                return Ok(());
            }
        }
    }

    /// Takes in every package that is there; true when a cycle is due. Of several states only the
    /// newest is answered.
    fn packages(&mut self, framer: &mut Framer, arrival: Instant) -> Result<bool, Lost> {
        let now_s = self.now_s(arrival);
        let mut due = false;
        while let Some(package) = framer.next_package().map_err(LinkError::from)? {
            match self.bridge.package(package, now_s, &mut self.out)? {
                BridgeEvent::None | BridgeEvent::Finished => {}
                BridgeEvent::Cycle => due = true,
                BridgeEvent::Version(version) => {
                    let protocol = self.bridge.link().protocol().number();
                    self.note(Note::Info(cut_format(format_args!(
                        "connected to {}: software {version}, RTDE protocol {protocol}",
                        self.config.host
                    ))));
                    self.shared.links.fetch_add(1, Ordering::AcqRel);
                    self.shared.wake_setup();
                }
                BridgeEvent::Text(text) => {
                    self.note(Note::Robot(text));
                }
            }
        }
        Ok(due)
    }

    /// State out, command in, guarded, into `out`.
    fn cycle(&mut self, arrival: Instant) -> Result<(), Lost> {
        if self.shared.reset_asked.swap(false, Ordering::AcqRel) {
            self.bridge.reset();
        }
        // Of both in one cycle, the stop has the last word.
        if self.shared.stop_asked.swap(false, Ordering::AcqRel) {
            self.bridge.stop();
        }
        self.bridge
            .set_wrong_model(self.shared.wrong_model.load(Ordering::Acquire));
        self.fill_state(arrival);
        self.publisher.publish(&self.state);
        let now_s = self.now_s(Instant::now());
        // Every one that came, since another source's must not hide the holder's; of the holder's,
        // the newest.
        let mut newest = None;
        for _ in 0..COMMANDS_MAX {
            let Some(received) = self.commands.try_recv() else {
                break;
            };
            let source = Source {
                name: received.message.source,
                publisher: received.publisher,
            };
            let activation = received.message.activation;
            if self.bridge.admit(&source, activation, now_s) {
                newest = Some(received.message);
            }
        }
        let wanted = newest.as_ref().map(Command::from);
        self.bridge
            .command(&self.posture, wanted.as_ref(), now_s, &mut self.out)?;
        if let Some(session) = self.bridge.take_upload() {
            self.shared.upload(Upload {
                session,
                series: self.bridge.link().version().series(),
            });
        }
        Ok(())
    }

    /// A state is overdue: the robot gets its package all the same, and the guard's patience runs.
    fn heartbeat(&mut self, now: Instant) -> Result<(), Lost> {
        if self.bridge.reason() == Some(Reason::NoLink) {
            return Ok(());
        }
        self.meters.heartbeats.add(1);
        let now_s = self.now_s(now);
        self.bridge
            .command(&self.posture, None, now_s, &mut self.out)?;
        Ok(())
    }

    fn fill_state(&mut self, arrival: Instant) {
        let sample = *self.bridge.sample();
        let q = Vector6::from(sample.q);
        let qd = Vector6::from(sample.qd);
        let (base_from_tool, jacobian) = self
            .config
            .arm
            .tool_and_jacobian(&q, &self.config.flange_from_tool);
        self.posture = Posture {
            q,
            tool_m: base_from_tool.translation(),
            tool_jacobian: jacobian,
        };
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * qd));
        let reason = self.bridge.reason();
        let gate = self.bridge.gate();
        let program_there = self.bridge.supervisor().is_present();
        let now_s = self.now_s(arrival);
        let state = &mut self.state;
        state.header = Header::in_frame::<Base>(clock::stamp_ns(arrival));
        state.cycle = self.bridge.cycle();
        state.robot_time_s = sample.timestamp_s;
        state.period_s = self.bridge.period_s();
        state.q = joint_array(&q);
        state.qd = joint_array(&qd);
        state.qd_target = joint_array(&Vector6::from(sample.qd_target));
        state.tool_pose = (&base_from_tool).into();
        state.tool_twist = (&twist).into();
        state.robot_mode = sample.robot_mode;
        state.safety_mode = sample.safety_mode;
        state.runtime_state = sample.runtime_state;
        state.program_state = match u8::try_from(sample.program_state) {
            Ok(number) if program_there => number,
            _ => 255,
        };
        state.stop_cause = u8::try_from(sample.cause).unwrap_or(255);
        state.ready = reason.is_none();
        if self.told.map(|(told, _)| told) != Some(reason) {
            state.not_ready_reason = match reason {
                Some(reason) => cut_format(format_args!("{reason}")),
                None => tangent_schemas::Text::new(),
            };
        }
        state.speed_scaling = sample.scaling();
        state.command_latency_s = self.bridge.latency_s();
        let lease = self.bridge.lease();
        self.account_of_commands
            .fill(state, &gate.admission, lease, now_s);
        state.packets_lost = self.bridge.packets_lost();
    }

    /// After the bytes have left: figures, and what is worth telling.
    fn account(&mut self, arrival: Instant) {
        let took = arrival.elapsed();
        self.state.packet_to_command_s = took.as_secs_f64();
        let gate = self.bridge.gate();
        let meters = &self.meters;
        meters.packet_to_command.record(took);
        meters.states.tick();
        meters.packet.mark_at(arrival);
        meters.missed.set(gate.admission.missed());
        meters.lost.set(self.bridge.packets_lost());
        meters.refused.set(gate.admission.refused() as f64);
        meters
            .refused_others
            .set(self.bridge.lease().refused() as f64);
        meters.limited.set(gate.limited() as f64);
        meters.scaling.set(self.state.speed_scaling);
        meters
            .stale_max
            .set(f64::from(self.bridge.sample().stale_max));
        meters.heartbeats_shown.set(meters.heartbeats.get() as f64);
        if self.bridge.latency_is_new() {
            meters.command_latency.record_s(self.bridge.latency_s());
        }
        let sample = self.bridge.sample();
        self.shared
            .robot_mode
            .store(sample.robot_mode, Ordering::Relaxed);
        self.shared
            .safety_mode
            .store(sample.safety_mode, Ordering::Relaxed);

        let reason = self.bridge.reason();
        let lease = self.bridge.lease();
        let rival = lease.rival(self.now_s(arrival)).copied();
        if self.told != Some((reason, rival)) {
            let ready_before = matches!(self.told, Some((None, _)));
            self.told = Some((reason, rival));
            match (reason, rival) {
                (None, None) => {
                    self.health.running();
                    if !ready_before {
                        let text = cut_format(format_args!("ready"));
                        self.note(Note::Info(text));
                    }
                }
                (None, Some(rival)) => {
                    let text = lease.refusal_of(&rival);
                    self.health.set(State::Degraded, text);
                    self.note(Note::Refused(text));
                }
                (Some(reason), _) => {
                    let state = match reason {
                        Reason::Starting | Reason::NoLink => State::Starting,
                        Reason::ShuttingDown => State::Stopping,
                        _ => State::Degraded,
                    };
                    let text = cut_format(format_args!("{reason}"));
                    self.health.set(state, text);
                    self.note(Note::Warning(text));
                }
            }
        }
    }
}

fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}
