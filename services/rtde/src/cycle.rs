//! The robot loop: in each cycle one robot packet is received, one state published, one command
//! sent.
//!
//! The thread waits for the robot's packet, not for a timer. Publishing the state runs a controller
//! of the same process, so that its command is available when publishing returns; it passes the
//! gate and is sent in the same cycle. While streaming, nothing allocates, locks or waits except
//! for the robot.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::{Matrix6, Vector3};
use tangent_actuation::Command;
use tangent_actuation::velocity::Posture;
use tangent_mechanics::{Flange, Joints};
use tangent_runtime::arm_commands::newest_command;
use tangent_runtime::bus::{Publisher, Subscription};
use tangent_runtime::health::HealthReporter;
use tangent_runtime::meter::Gauge;
use tangent_runtime::robot_loop::{
    ArmReading, ArmStateWriter, CycleFigures, Endpoint, LoopMeters, Note, Readiness, RobotLoop,
    run_robot_loop,
};
use tangent_runtime::stop::Stop;
use tangent_runtime::watchdog::Beat;
use tangent_schemas::arm_modes::NO_PROGRAM;
use tangent_schemas::convert::cut_format;
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState};

use crate::bridge::{Bridge, BridgeEvent};
use crate::codec::{Framer, PACKAGE_BYTES_MAX};
use crate::link_error::LinkError;
use crate::own_sensor::flange_wrench;
use crate::reason::Reason;
use crate::robot_setup::resolve;
use crate::settings::Config;
use crate::shared::{Shared, Upload};

/// Lateness of a state, in periods, after which the heartbeat is sent without it.
const LATE_PERIODS: f64 = 1.5;
/// Time after which a controller that accepts no bytes counts as disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_millis(200);

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Lost {
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error("the controller closed the connection")]
    Closed,
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// Figures that only this loop measures, besides those of every robot loop.
struct Meters {
    common: LoopMeters,
    scaling: Gauge,
    stale_max: Gauge,
    states_force: Gauge,
}

impl Meters {
    fn new(health: &HealthReporter) -> Self {
        Self {
            common: LoopMeters::new(health),
            scaling: health.gauge("speed_scaling"),
            stale_max: health.gauge("program_stale_max_cycles"),
            states_force: health.gauge("arm_states_force"),
        }
    }
}

/// Publishers of the loop.
pub(crate) struct Outlets {
    pub state: Publisher<ArmState>,
    /// Reading of the robot's own force/torque sensor, if the cell uses it.
    pub wrench: Option<Publisher<WrenchStamped>>,
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
    posture: Posture<6>,
    state: ArmState,
    out: Vec<u8>,
    writer: ArmStateWriter<6>,
    readiness: Readiness<Reason>,
    heartbeats: u64,
}

impl Cycle {
    pub fn new(
        config: Arc<Config>,
        bridge: Bridge,
        outlets: Outlets,
        commands: Subscription<ArmCommand>,
        shared: Arc<Shared>,
        health: Arc<HealthReporter>,
        stop: Stop,
    ) -> Self {
        Self {
            meters: Meters::new(&health),
            writer: ArmStateWriter::new(config.arm, config.flange_from_tool),
            config,
            bridge,
            outlets,
            commands,
            shared,
            health,
            stop,
            start: Instant::now(),
            posture: Posture {
                q: Joints::zeros(),
                tool_m: Vector3::zeros(),
                tool_jacobian: Matrix6::zeros(),
            },
            state: ArmState::default(),
            out: Vec::with_capacity(4096),
            readiness: Readiness::default(),
            heartbeats: 0,
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
            service: "rtde",
            host: &config.host,
            port: config.rtde_port,
            connect_timeout: config.connect_timeout,
        };
        run_robot_loop(&mut self, &endpoint, &health, &stop);
        self.shared.ended.store(true, Ordering::Release);
        self.shared.wake_setup();
    }

    fn now_s(&self, instant: Instant) -> f64 {
        instant.saturating_duration_since(self.start).as_secs_f64()
    }

    /// Serves one connection, until it breaks (an error) or the orderly end is done.
    fn answer_packets(&mut self, mut stream: TcpStream, beat: &Beat) -> Result<(), Lost> {
        let mut framer = Framer::new(PACKAGE_BYTES_MAX);
        let mut period_s = self.bridge.period_s();
        let late = |period_s: f64| Duration::from_secs_f64(LATE_PERIODS * period_s);
        stream.set_read_timeout(Some(late(period_s)))?;
        self.out.clear();
        self.bridge
            .open(self.now_s(Instant::now()), &mut self.out)?;
        stream.write_all(&self.out)?;
        loop {
            // A turn waits for the robot's packet for at most a period and a half, so the watchdog
            // sees a beat in time.
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
                        self.answer(arrival)?;
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

    /// Handles every received package; true if a cycle is due. Of several states only the newest is
    /// answered.
    fn packages(&mut self, framer: &mut Framer, arrival: Instant) -> Result<bool, Lost> {
        let now_s = self.now_s(arrival);
        let mut due = false;
        while let Some(package) = framer.next_package().map_err(LinkError::from)? {
            match self.bridge.package(package, now_s, &mut self.out)? {
                BridgeEvent::None | BridgeEvent::Finished => {}
                BridgeEvent::Cycle => due = true,
                BridgeEvent::Version(version) => {
                    let protocol = self.bridge.link().protocol().number();
                    self.shared.notes.push(Note::Info(cut_format(format_args!(
                        "connected to {}: software {version}, RTDE protocol {protocol}",
                        self.config.host
                    ))));
                    self.shared.links.fetch_add(1, Ordering::AcqRel);
                    self.shared.wake_setup();
                }
                BridgeEvent::Text(text) => {
                    self.shared.notes.push(Note::Robot(text));
                }
            }
        }
        Ok(due)
    }

    /// Publishes the state, takes the command through the gate, and writes it into `out`.
    fn answer(&mut self, arrival: Instant) -> Result<(), Lost> {
        if self.shared.reset_asked.swap(false, Ordering::AcqRel) {
            self.bridge.reset();
        }
        // If both arrive in one cycle, the stop takes precedence.
        if self.shared.stop_asked.swap(false, Ordering::AcqRel) {
            self.bridge.stop();
        }
        let now_s = self.now_s(arrival);
        self.shared.guide.serve(&mut self.bridge, now_s);
        self.bridge
            .set_wrong_model(self.shared.wrong_model.load(Ordering::Acquire));
        self.fill_state(arrival);
        // The wrench is published first: a controller runs when the state is published, and needs
        // the wrench of this cycle.
        self.publish_wrench();
        self.outlets.state.publish(&self.state);
        let now_s = self.now_s(Instant::now());
        let bridge = &mut self.bridge;
        let newest = newest_command(&self.commands, |source, activation| {
            bridge.admit(source, activation, now_s)
        });
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

    /// Handles an overdue state: the robot still gets its package, and the gate's patience
    /// continues to run.
    fn heartbeat(&mut self, now: Instant) -> Result<(), Lost> {
        if self.bridge.reason() == Some(Reason::NoLink) {
            return Ok(());
        }
        self.heartbeats += 1;
        let now_s = self.now_s(now);
        self.bridge
            .command(&self.posture, None, now_s, &mut self.out)?;
        Ok(())
    }

    /// Publishes the force that the robot itself feels, with the stamp of the state that came in
    /// the same packet.
    fn publish_wrench(&self) {
        let sample = self.bridge.sample();
        let read = self.config.bridge.wrench.zip(sample.wrench);
        if let Some(((own, values), publisher)) = read.zip(self.outlets.wrench.as_ref()) {
            let q = Joints::from(sample.q);
            publisher.publish(&WrenchStamped {
                header: Header::in_frame::<Flange>(self.state.header.stamp.to_ns()),
                wrench: (&flange_wrench(own.reading, &values, &self.config.arm, &q)).into(),
            });
        }
    }

    fn fill_state(&mut self, arrival: Instant) {
        let sample = *self.bridge.sample();
        let reading = ArmReading {
            arrival,
            cycle: self.bridge.cycle(),
            robot_time_s: sample.timestamp_s,
            period_s: self.bridge.period_s(),
            q: Joints::from(sample.q),
            qd: Joints::from(sample.qd),
            qd_target: Joints::from(sample.qd_target),
            packets_lost: self.bridge.packets_lost(),
        };
        let now_s = self.now_s(arrival);
        let state = &mut self.state;
        let tool = self.writer.fill(state, &reading);
        self.posture = Posture {
            q: reading.q,
            tool_m: tool.base_from_tool.translation(),
            tool_jacobian: tool.jacobian,
        };
        state.robot_mode = sample.robot_mode;
        state.safety_mode = sample.safety_mode;
        state.runtime_state = sample.runtime_state;
        state.program_state = match u8::try_from(sample.program_state) {
            Ok(number) if self.bridge.supervisor().is_present() => number,
            _ => NO_PROGRAM,
        };
        state.stop_cause = u8::try_from(sample.cause).unwrap_or(255);
        state.speed_scaling = sample.scaling();
        state.command_latency_s = self.bridge.latency_s();
        self.readiness.fill(state, self.bridge.reason());
        let (gate, lease) = (self.bridge.gate(), self.bridge.lease());
        self.writer
            .fill_account(state, &gate.admission, lease, now_s);
    }

    /// After the bytes were sent: updates figures and reports changes.
    fn account(&mut self, arrival: Instant) {
        let took = arrival.elapsed();
        self.state.packet_to_command_s = took.as_secs_f64();
        let (bridge, meters) = (&self.bridge, &self.meters);
        let sample = bridge.sample();
        let figures = CycleFigures {
            arrival,
            took,
            latency_s: bridge.latency_is_new().then(|| bridge.latency_s()),
            packets_lost: bridge.packets_lost(),
            late: self.heartbeats,
            limited: bridge.gate().limited(),
        };
        meters
            .common
            .take(&figures, &bridge.gate().admission, bridge.lease());
        meters.scaling.set(self.state.speed_scaling);
        meters.stale_max.set(f64::from(sample.stale_max));
        meters
            .states_force
            .set(f64::from(u8::from(sample.wrench.is_some())));
        self.shared
            .robot_mode
            .store(sample.robot_mode, Ordering::Relaxed);
        self.shared
            .safety_mode
            .store(sample.safety_mode, Ordering::Relaxed);
        let now_s = self.now_s(arrival);
        self.readiness.announce(
            bridge.reason(),
            bridge.lease(),
            now_s,
            &self.health,
            &self.shared.notes,
        );
    }
}

impl RobotLoop for Cycle {
    type Connection = TcpStream;
    type Error = Lost;

    fn connect(&self) -> Result<TcpStream, Lost> {
        let address = resolve(&self.config.host, self.config.rtde_port)?;
        let stream = TcpStream::connect_timeout(&address, self.config.connect_timeout)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(stream)
    }

    fn serve(&mut self, stream: TcpStream, _reconnects: u64, beat: &Beat) -> Result<(), Lost> {
        self.answer_packets(stream, beat)
    }

    fn close(&mut self) {
        self.bridge.close();
        self.readiness.forget();
    }

    fn cycle(&self) -> u64 {
        self.bridge.cycle()
    }
}

fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}
