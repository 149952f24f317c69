//! The loop: one state of the robot in, wrench and `arm/state` published, one answer out.
//!
//! The thread waits for the robot's packet, never for a timer of its own. Publishing the state runs
//! a controller of the same process, so its command is there when publishing returns; it passes the
//! guard and leaves in the same cycle. The TCP side is looked at after the answer has left. Once a
//! motion runs, nothing here allocates, locks or waits but for the robot.

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use tangent_actuation::lease::Source;
use tangent_mechanics::{Aligned, Base, Joints, Pose, Tool, Twist};
use tangent_runtime::watchdog::TURN;
use tangent_runtime::{Beat, Publisher, State, Stop, Subscription, clock};
use tangent_schemas::convert::{cut_format, joint_array};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState, WrenchStatus};

use crate::bridge::{Bridge, BridgeError, posture_of};
use crate::estimate::Estimate;
use crate::fci::{COMMAND_BYTES, CodecError, FrameError, PERIOD_S, Reply, RobotMode, RobotState};
use crate::link::{Link, LinkError, is_nothing_yet};
use crate::meters::Meters;
use crate::session::Reason;
use crate::settings::Config;
use crate::shared::{Note, Shared};
use crate::wrench::tool_wrench;
use tangent_actuation::torque::{Posture, Trip};
use tangent_actuation::{Command, CommandAccount};

/// First and longest pause between attempts to connect.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(5));
/// The system's resolver may take so long for a name.
const RESOLVE: Duration = Duration::from_secs(60);
/// A robot that sends nothing for so long is gone, s.
const SILENCE_S: f64 = 1.0;
/// Commands that may wait for a cycle, from all sources together.
pub(crate) const COMMANDS_MAX: usize = 64;

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
enum Lost {
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error(
        "the robot closed the connection (another client may hold it, or FCI is not activated)"
    )]
    Closed,
    #[error("the robot has sent no state for {SILENCE_S} s")]
    Silent,
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error(transparent)]
    Codec(#[from] CodecError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Bridge(#[from] BridgeError),
}

/// What the loop says on the bus.
pub(crate) struct Outlets {
    pub state: Publisher<ArmState>,
    pub wrench: Publisher<WrenchStamped>,
    pub wrench_status: Publisher<WrenchStatus>,
}

pub(crate) struct Cycle {
    config: Arc<Config>,
    bridge: Bridge,
    outlets: Outlets,
    commands: Subscription<ArmCommand>,
    shared: Arc<Shared>,
    health: Arc<tangent_runtime::HealthReporter>,
    meters: Meters,
    stop: Stop,
    start: Instant,
    posture: Posture<7>,
    state: ArmState,
    wrench_status: WrenchStatus,
    /// Of the last state.
    base_from_tool: Pose<Base, Tool>,
    estimate: Estimate,
    tcp_out: Vec<u8>,
    udp_out: Vec<u8>,
    account_of_commands: CommandAccount,
    told: Option<(Option<Reason>, Option<Source>)>,
    trip_told: Option<Trip>,
    connections: u32,
    late: u64,
}

impl Cycle {
    pub fn new(
        config: Arc<Config>,
        outlets: Outlets,
        commands: Subscription<ArmCommand>,
        estimate: Estimate,
        shared: Arc<Shared>,
        health: Arc<tangent_runtime::HealthReporter>,
        stop: Stop,
    ) -> Self {
        Self {
            bridge: Bridge::new(config.bridge.clone()),
            meters: Meters::new(&health),
            config,
            outlets,
            commands,
            shared,
            health,
            stop,
            start: Instant::now(),
            posture: posture_of(
                &RobotState::default(),
                Vector3::zeros(),
                nalgebra::SMatrix::zeros(),
            ),
            state: ArmState::default(),
            wrench_status: WrenchStatus::default(),
            base_from_tool: Pose::identity(),
            estimate,
            tcp_out: Vec::with_capacity(1024),
            udp_out: Vec::with_capacity(COMMAND_BYTES),
            account_of_commands: CommandAccount::default(),
            told: None,
            trip_told: None,
            connections: 0,
            late: 0,
        }
    }

    /// Connects, serves, and connects again, until stopped.
    pub fn run(mut self) {
        let beat = Beat::new("franka");
        let mut pause = BACKOFF.0;
        let mut last = String::new();
        while !self.stop.is_stopped() {
            let cycles = self.bridge.cycle();
            beat.within(self.config.connect_timeout + RESOLVE);
            let ended = self.connect().and_then(|link| {
                self.connections += 1;
                self.meters.reconnects.set(f64::from(self.connections - 1));
                self.serve(link, &beat)
            });
            self.bridge.close();
            self.told = None;
            if let Err(error) = ended {
                let text = format!("{}:{}: {error}", self.config.host, self.config.port);
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
    }

    fn connect(&self) -> Result<Link, Lost> {
        let config = &self.config;
        Ok(Link::connect(
            &config.host,
            config.port,
            config.connect_timeout,
        )?)
    }

    /// Something to tell; another thread writes it. No lock, no memory, no waiting.
    fn note(&self, note: Note) {
        self.shared.notes.force_push(note);
    }

    fn now_s(&self, instant: Instant) -> f64 {
        instant.saturating_duration_since(self.start).as_secs_f64()
    }

    /// One connection, until it breaks (an error) or the orderly end is done.
    fn serve(&mut self, mut link: Link, beat: &Beat) -> Result<(), Lost> {
        let port = link.udp.local_addr()?.port();
        let mut heard = Instant::now();
        self.tcp_out.clear();
        self.bridge.open(port, self.now_s(heard), &mut self.tcp_out);
        loop {
            // A turn waits for the robot's state no longer than the socket's patience: advancing,
            // or waiting for the robot.
            beat.beat();
            let received = link.receive()?;
            let arrival = Instant::now();
            let mut due = false;
            if let Some((state, skipped)) = received {
                heard = arrival;
                self.late += skipped;
                let now_s = self.now_s(arrival);
                due = self
                    .bridge
                    .state(&state, skipped, now_s, &mut self.tcp_out)?;
            }
            if due {
                self.cycle(arrival);
                if !self.udp_out.is_empty() {
                    link.send(&self.udp_out)?;
                }
                self.account(arrival);
            }
            // The answer has left; now there is time for the rest.
            self.converse(&mut link, arrival)?;
            if arrival.saturating_duration_since(heard).as_secs_f64() > SILENCE_S {
                return Err(Lost::Silent);
            }
            if self.stop.is_stopped() {
                self.bridge.end(self.now_s(arrival));
            }
            if self.bridge.is_finished() {
                return Ok(());
            }
        }
    }

    /// Sends what is to be asked, takes in what was answered.
    fn converse(&mut self, link: &mut Link, arrival: Instant) -> Result<(), Lost> {
        if !self.tcp_out.is_empty() {
            link.tcp.set_nonblocking(false)?;
            link.tcp.write_all(&self.tcp_out)?;
            link.tcp.set_nonblocking(true)?;
            self.tcp_out.clear();
        }
        let mut bytes = [0; 1024];
        match link.tcp.read(&mut bytes) {
            Ok(0) => return Err(Lost::Closed),
            Ok(n) => link.framer.push(&bytes[..n]),
            Err(error) if is_nothing_yet(&error) => return Ok(()),
            Err(error) => return Err(error.into()),
        }
        let now_s = self.now_s(arrival);
        while let Some(message) = link.framer.next_message()? {
            let reply = Reply::decode(&message)?;
            let connected = self.bridge.session().is_connected();
            self.bridge.reply(&reply, now_s)?;
            if !connected && self.bridge.session().is_connected() {
                self.note(Note::Info(cut_format(format_args!(
                    "connected to {}: FCI version 5",
                    self.config.host
                ))));
            }
        }
        Ok(())
    }

    /// State and wrench out, command in, guarded, into `udp_out`.
    fn cycle(&mut self, arrival: Instant) {
        if self.shared.recover_asked.swap(false, Ordering::AcqRel) {
            self.bridge.recover();
        }
        // Of both in one cycle, the stop has the last word.
        if self.shared.stop_asked.swap(false, Ordering::AcqRel) {
            self.bridge.stop();
        }
        self.fill_state(arrival);
        // The wrench first: a controller is called when the state is published, and wants the
        // wrench of this cycle.
        self.publish_wrench(arrival);
        self.outlets.state.publish(&self.state);
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
        self.udp_out.clear();
        self.bridge.command(
            &self.posture,
            wanted.as_ref(),
            now_s,
            &mut self.tcp_out,
            &mut self.udp_out,
        );
    }

    fn publish_wrench(&mut self, arrival: Instant) {
        let now_s = self.now_s(arrival);
        let raw = tool_wrench(self.bridge.robot(), &self.config.flange_from_tool);
        let felt = self.estimate.take(&raw, &self.base_from_tool, now_s);
        let header = Header::in_frame::<Tool>(clock::stamp_ns(arrival));
        let status = &mut self.wrench_status;
        status.header = header.clone();
        self.estimate.tell(&felt, status);
        status.records = self.bridge.cycle();
        status.records_lost = self.bridge.packets_lost();
        status.reconnects = u64::from(self.connections.saturating_sub(1));
        status.rdt_sequence = self.bridge.robot().message_id as u32;
        status.rate_hz = 1.0 / PERIOD_S;
        self.outlets.wrench_status.publish(status);
        self.outlets.wrench.publish(&WrenchStamped {
            header,
            wrench: (&felt.wrench).into(),
        });
    }

    fn fill_state(&mut self, arrival: Instant) {
        let now_s = self.now_s(arrival);
        let robot = self.bridge.robot();
        let q = Joints::from(robot.q);
        let qd = Joints::from(robot.dq);
        let (base_from_tool, jacobian) = self
            .config
            .arm
            .tool_and_jacobian(&q, &self.config.flange_from_tool);
        self.posture = posture_of(robot, base_from_tool.translation(), jacobian);
        self.base_from_tool = base_from_tool;
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * qd));
        let reason = self.bridge.reason(now_s);
        let gate = self.bridge.gate();
        let state = &mut self.state;
        state.header = Header::in_frame::<Base>(clock::stamp_ns(arrival));
        state.cycle = self.bridge.cycle();
        state.robot_time_s = robot.message_id as f64 * PERIOD_S;
        state.period_s = PERIOD_S;
        state.q = joint_array(&q);
        state.qd = joint_array(&qd);
        state.qd_target = joint_array(&Joints::from(robot.dq_d));
        state.tool_pose = (&base_from_tool).into();
        state.tool_twist = (&twist).into();
        state.robot_mode = i32::from(robot.robot_mode);
        state.safety_mode = safety_mode(robot.mode());
        state.runtime_state = if self.bridge.session().is_running() {
            RUNTIME_PLAYING
        } else {
            RUNTIME_STOPPED
        };
        state.program_state = NO_PROGRAM;
        state.ready = reason.is_none();
        if self.told.map(|(told, _)| told) != Some(reason) {
            state.not_ready_reason = match reason {
                Some(reason) => cut_format(format_args!("{reason}")),
                None => tangent_schemas::Text::new(),
            };
        }
        state.speed_scaling = 1.0;
        if let Some(latency_s) = self.bridge.latency_s() {
            state.command_latency_s = latency_s;
        }
        let lease = self.bridge.lease();
        self.account_of_commands
            .fill(state, &gate.admission, lease, now_s);
        if self.trip_told != gate.trip().copied() {
            self.trip_told = gate.trip().copied();
            if let Some(trip) = gate.trip() {
                state.refusal_reason = cut_format(format_args!("held, since {trip}"));
                self.shared
                    .notes
                    .force_push(Note::Refused(state.refusal_reason));
            }
        }
        state.packets_lost = self.bridge.packets_lost();
    }

    /// After the bytes have left: figures, and what is worth telling.
    fn account(&mut self, arrival: Instant) {
        let took = arrival.elapsed();
        self.state.packet_to_command_s = took.as_secs_f64();
        self.meters.take(&self.bridge, arrival, took, self.late);
        let now_s = self.now_s(arrival);
        let reason = self.bridge.reason(now_s);
        let lease = self.bridge.lease();
        let rival = lease.rival(now_s).copied();
        if self.told == Some((reason, rival)) {
            return;
        }
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
                    Reason::NoLink | Reason::SettingUp | Reason::Starting => State::Starting,
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

/// `ArmState.runtime_state` counts as RTDE does.
const RUNTIME_STOPPED: u32 = 1;
const RUNTIME_PLAYING: u32 = 2;
/// There is no program of ours on the robot.
const NO_PROGRAM: u8 = 255;

/// `ArmState.safety_mode` counts as RTDE does: 1 normal, 3 protective stop, 5 safeguard stop.
fn safety_mode(mode: RobotMode) -> i32 {
    match mode {
        RobotMode::Reflex | RobotMode::AutomaticErrorRecovery => 3,
        RobotMode::UserStopped => 5,
        _ => 1,
    }
}
