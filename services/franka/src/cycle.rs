//! The robot loop: in each cycle one state of the robot is received, wrench and `arm/state` are
//! published, and one answer is sent.
//!
//! The thread waits for the robot's packet, not for a timer. Publishing the state runs a controller
//! of the same process, so that its command is available when publishing returns; it passes the
//! gate and is sent in the same cycle. TCP is served after the answer was sent. While a motion
//! runs, nothing allocates, locks or waits except for the robot.

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_actuation::Command;
use tangent_actuation::torque::{Posture, Trip};
use tangent_mechanics::{Base, Joints, Pose, Tool};
use tangent_runtime::arm_commands::newest_command;
use tangent_runtime::bus::{Publisher, Subscription};
use tangent_runtime::clock;
use tangent_runtime::health::HealthReporter;
use tangent_runtime::robot_loop::{
    ArmReading, ArmStateWriter, Endpoint, Note, Readiness, RobotLoop, run_robot_loop,
};
use tangent_runtime::stop::Stop;
use tangent_runtime::watchdog::Beat;
use tangent_schemas::arm_modes::{
    NO_PROGRAM, PROTECTIVE_STOP, RUNTIME_PLAYING, RUNTIME_STOPPED, SAFEGUARD_STOP, SAFETY_NORMAL,
};
use tangent_schemas::convert::cut_format;
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState, WrenchStatus};

use crate::SERVICE;
use crate::bridge::{Bridge, BridgeError, posture_of};
use crate::estimate::Estimate;
use crate::fci::{COMMAND_BYTES, CodecError, FrameError, PERIOD_S, Reply, RobotMode, RobotState};
use crate::link::{Link, LinkError, is_nothing_yet};
use crate::meters::Meters;
use crate::session::Reason;
use crate::settings::Config;
use crate::shared::Shared;
use crate::wrench::tool_wrench;

/// Silence after which the robot counts as disconnected, s.
const SILENCE_S: f64 = 1.0;

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Lost {
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

/// Topics that the loop publishes.
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
    health: Arc<HealthReporter>,
    meters: Meters,
    stop: Stop,
    start: Instant,
    posture: Posture<7>,
    state: ArmState,
    wrench_status: WrenchStatus,
    /// Pose of the tool in the last state.
    base_from_tool: Pose<Base, Tool>,
    estimate: Estimate,
    tcp_out: Vec<u8>,
    udp_out: Vec<u8>,
    writer: ArmStateWriter<7>,
    readiness: Readiness<Reason>,
    trip_told: Option<Trip>,
    reconnects: u64,
    late: u64,
}

impl Cycle {
    pub fn new(
        config: Arc<Config>,
        outlets: Outlets,
        commands: Subscription<ArmCommand>,
        estimate: Estimate,
        shared: Arc<Shared>,
        health: Arc<HealthReporter>,
        stop: Stop,
    ) -> Self {
        Self {
            bridge: Bridge::new(config.bridge.clone()),
            meters: Meters::new(&health),
            writer: ArmStateWriter::new(config.arm, config.flange_from_tool),
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
            readiness: Readiness::default(),
            trip_told: None,
            reconnects: 0,
            late: 0,
        }
    }

    /// Connects, serves, and connects again, until stopped.
    pub fn run(mut self) {
        let (config, health, stop) = (
            Arc::clone(&self.config),
            Arc::clone(&self.health),
            self.stop.clone(),
        );
        let endpoint = Endpoint {
            service: SERVICE,
            host: &config.host,
            port: config.port,
            connect_timeout: config.connect_timeout,
        };
        run_robot_loop(&mut self, &endpoint, &health, &stop);
    }

    fn now_s(&self, instant: Instant) -> f64 {
        instant.saturating_duration_since(self.start).as_secs_f64()
    }

    /// Answers the robot's states until the connection breaks (an error) or the orderly end is
    /// done.
    fn answer_states(&mut self, link: &mut Link, beat: &Beat) -> Result<(), Lost> {
        let port = link.udp.local_addr()?.port();
        let mut heard = Instant::now();
        self.tcp_out.clear();
        self.bridge.open(port, self.now_s(heard), &mut self.tcp_out);
        loop {
            // A turn waits for the robot's state for at most the socket's timeout, so the watchdog
            // sees a beat in time.
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
                self.answer(arrival);
                if !self.udp_out.is_empty() {
                    link.send(&self.udp_out)?;
                }
                self.account(arrival);
            }
            // The answer was sent; now there is time for the other work.
            self.converse(link, arrival)?;
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

    /// Sends pending requests, and handles replies.
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
                self.shared.notes.push(Note::Info(cut_format(format_args!(
                    "connected to {}: FCI version 5",
                    self.config.host
                ))));
            }
        }
        Ok(())
    }

    /// Publishes state and wrench, takes the command through the gate, and writes the answer into
    /// `udp_out`.
    fn answer(&mut self, arrival: Instant) {
        if self.shared.recover_asked.swap(false, Ordering::AcqRel) {
            self.bridge.recover();
        }
        // If both arrive in one cycle, the stop takes precedence.
        if self.shared.stop_asked.swap(false, Ordering::AcqRel) {
            self.bridge.stop();
        }
        self.fill_state(arrival);
        // The wrench is published first: a controller runs when the state is published, and needs
        // the wrench of this cycle.
        self.publish_wrench(arrival);
        self.outlets.state.publish(&self.state);
        let now_s = self.now_s(Instant::now());
        let bridge = &mut self.bridge;
        let newest = newest_command(&self.commands, |source, activation| {
            bridge.admit(source, activation, now_s)
        });
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
        status.reconnects = self.reconnects;
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
        let reading = ArmReading {
            arrival,
            cycle: self.bridge.cycle(),
            robot_time_s: robot.message_id as f64 * PERIOD_S,
            period_s: PERIOD_S,
            q: Joints::from(robot.q),
            qd: Joints::from(robot.dq),
            qd_target: Joints::from(robot.dq_d),
            packets_lost: self.bridge.packets_lost(),
        };
        let state = &mut self.state;
        let tool = self.writer.fill(state, &reading);
        self.posture = posture_of(robot, tool.base_from_tool.translation(), tool.jacobian);
        self.base_from_tool = tool.base_from_tool;
        state.robot_mode = i32::from(robot.robot_mode);
        state.safety_mode = safety_mode(robot.mode());
        state.runtime_state = if self.bridge.session().is_running() {
            RUNTIME_PLAYING
        } else {
            RUNTIME_STOPPED
        };
        state.program_state = NO_PROGRAM;
        state.speed_scaling = 1.0;
        if let Some(latency_s) = self.bridge.latency_s() {
            state.command_latency_s = latency_s;
        }
        self.readiness.fill(state, self.bridge.reason(now_s));
        let (gate, lease) = (self.bridge.gate(), self.bridge.lease());
        self.writer
            .fill_account(state, &gate.admission, lease, now_s);
        if self.trip_told != gate.trip().copied() {
            self.trip_told = gate.trip().copied();
            if let Some(trip) = gate.trip() {
                let reason = cut_format(format_args!("held, since {trip}"));
                self.writer.overrule(state, reason);
                self.shared.notes.push(Note::Refused(reason));
            }
        }
    }

    /// After the answer was sent: updates figures and reports changes.
    fn account(&mut self, arrival: Instant) {
        let took = arrival.elapsed();
        self.state.packet_to_command_s = took.as_secs_f64();
        self.meters.take(&self.bridge, arrival, took, self.late);
        let now_s = self.now_s(arrival);
        self.readiness.announce(
            self.bridge.reason(now_s),
            self.bridge.lease(),
            now_s,
            &self.health,
            &self.shared.notes,
        );
    }
}

impl RobotLoop for Cycle {
    type Connection = Link;
    type Error = Lost;

    fn connect(&self) -> Result<Link, Lost> {
        let config = &self.config;
        Ok(Link::connect(
            &config.host,
            config.port,
            config.connect_timeout,
        )?)
    }

    fn serve(&mut self, mut link: Link, reconnects: u64, beat: &Beat) -> Result<(), Lost> {
        self.reconnects = reconnects;
        self.answer_states(&mut link, beat)
    }

    fn close(&mut self) {
        self.bridge.close();
        self.readiness.forget();
    }

    fn cycle(&self) -> u64 {
        self.bridge.cycle()
    }
}

/// The robot's mode as `ArmState.safety_mode`.
fn safety_mode(mode: RobotMode) -> i32 {
    match mode {
        RobotMode::Reflex | RobotMode::AutomaticErrorRecovery => PROTECTIVE_STOP,
        RobotMode::UserStopped => SAFEGUARD_STOP,
        _ => SAFETY_NORMAL,
    }
}
