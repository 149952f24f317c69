//! The running robot: one thread that paces it by absolute deadlines, and its two sockets.
//!
//! A cycle takes in requests, sends the state, gives the client a moment to answer and steps the
//! robot. A cycle that comes late is not made up for: simulated time then runs slow, but no client
//! ever sees two states in a burst.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_franka::fci::{
    COMMAND_BYTES, ConnectStatus, Framer, PERIOD_S, PORT, Reply, ReplyBody, Request, RobotCommand,
    RobotState, STATE_BYTES,
};
use tangent_mechanics::ModelError;
use tangent_runtime::clock::DeadlineClock;
use tangent_runtime::realtime::setup_thread;
use tangent_simulation::Truth;

use super::bench::BenchPlant;
use super::config::FciConfig;
use super::fault::FciFault;
use super::plant::TorquePlant;
use super::robot::FciRobot;
use crate::config::Ports;

/// Between two looks for an answer.
const LOOK: Duration = Duration::from_micros(50);
/// A client that does not take its replies for so long is cut off.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

/// Why a robot cannot start.
#[derive(Debug, thiserror::Error)]
pub enum FciStartError {
    /// The model is broken.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A port cannot be had.
    #[error(
        "cannot listen on {address} for FCI: {reason}; another simulator may hold it: use another address or port offset"
    )]
    Port {
        /// Address and port.
        address: String,
        /// The system's reason.
        reason: io::Error,
    },
    /// The offset leads past the last port.
    #[error("port offset {offset} leads past port 65535 for FCI; the most is 64198")]
    Offset {
        /// As configured.
        offset: u16,
    },
    /// No thread to be had.
    #[error("cannot start the robot's thread: {0}")]
    Thread(io::Error),
}

/// What the robot did in its last cycle.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Cycles since the start.
    pub cycles: u64,
    /// Deadlines that passed without a cycle.
    pub missed: u64,
    /// As sent, or as it would have been.
    pub state: RobotState,
    /// Answers that were due and did not come, since the start.
    pub answers_lost: u64,
    /// Most that a joint's torque changed from one answer to the next since the start, Nm.
    pub torque_step_max_nm: f64,
    /// A client is connected.
    pub connected: bool,
    /// Connections since the start.
    pub connections: u64,
    /// The contact, if there is a surface.
    pub truth: Option<Truth>,
}

/// Told the truth about the contact once per cycle, in the robot's thread.
pub type FciTruthListener = Box<dyn FnMut(&Truth) + Send>;

/// A robot under way. Dropping it stops it.
pub struct SimulatedFranka {
    address: SocketAddr,
    faults: Sender<FciFault>,
    snapshot: Arc<Mutex<Option<Snapshot>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl std::fmt::Debug for SimulatedFranka {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimulatedFranka")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl SimulatedFranka {
    /// With the arm and plane of `config`.
    ///
    /// # Errors
    /// A port is taken.
    pub fn start(config: &FciConfig) -> Result<Self, FciStartError> {
        let plant = BenchPlant::new(&config.plant)?;
        Self::start_with(config, Box::new(plant), None)
    }

    /// Around any plant; `truth` is told about its contact.
    ///
    /// # Errors
    /// A port is taken.
    pub fn start_with(
        config: &FciConfig,
        plant: Box<dyn TorquePlant>,
        truth: Option<FciTruthListener>,
    ) -> Result<Self, FciStartError> {
        let (listener, udp) = bind(config.address, config.ports)?;
        let refused = |reason| FciStartError::Port {
            address: config.address.to_string(),
            reason,
        };
        let address = listener.local_addr().map_err(refused)?;
        listener.set_nonblocking(true).map_err(refused)?;
        udp.set_nonblocking(true).map_err(refused)?;
        let (faults, receiver) = channel();
        let snapshot = Arc::new(Mutex::new(None));
        let stop = Arc::new(AtomicBool::new(false));
        let mut server = Server {
            robot: FciRobot::new(config, plant)?,
            listener,
            udp,
            client: None,
            faults: receiver,
            snapshot: Arc::clone(&snapshot),
            stop: Arc::clone(&stop),
            truth,
            wait: Duration::from_secs_f64(config.answer_wait_s.clamp(0.0, 10.0)),
            drop_states: 0,
            drop_answers: 0,
            frozen_until: None,
            cycles: 0,
            missed: 0,
            answers_lost: 0,
            connections: 0,
            torque_step_max_nm: 0.0,
            torque_before: None,
            datagram: Vec::with_capacity(STATE_BYTES),
        };
        let priority = config.realtime_priority;
        let thread = std::thread::Builder::new()
            .name("simulated franka".into())
            .spawn(move || {
                if let Some(priority) = priority {
                    setup_thread("simulated robot", priority);
                }
                server.run();
            })
            .map_err(FciStartError::Thread)?;
        Ok(Self {
            address,
            faults,
            snapshot,
            stop,
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Provokes (or ends) a fault in the next cycle.
    pub fn fault(&self, fault: FciFault) {
        // A robot that has ended has no faults left.
        let _ = self.faults.send(fault);
    }

    /// A sender of faults for other threads.
    pub fn faults(&self) -> impl Fn(FciFault) + Send + Sync + use<> {
        let faults = self.faults.clone();
        move |fault| {
            let _ = faults.send(fault);
        }
    }

    /// What it did in its last cycle; `None` before the first.
    pub fn snapshot(&self) -> Option<Snapshot> {
        self.snapshot
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Waits until `condition` holds, looking once per millisecond; false when it does not within
    /// `at_most`.
    pub fn wait_for(&self, at_most: Duration, condition: impl Fn(&Snapshot) -> bool) -> bool {
        let deadline = Instant::now() + at_most;
        loop {
            if self.snapshot().is_some_and(|s| condition(&s)) {
                return true;
            }
            if Instant::now() >= deadline {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Its thread has ended by itself, which it never should.
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends it and waits for it.
    pub fn stop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!(target: "simulator", "the robot's thread failed");
        }
    }
}

impl Drop for SimulatedFranka {
    fn drop(&mut self) {
        self.stop();
    }
}

/// TCP and UDP on the same number.
fn bind(address: IpAddr, ports: Ports) -> Result<(TcpListener, UdpSocket), FciStartError> {
    let offset = match ports {
        Ports::Offset(offset) => offset,
        Ports::Ephemeral => 0,
    };
    let port = ports.of(PORT).ok_or(FciStartError::Offset { offset })?;
    let wanted = SocketAddr::new(address, port);
    let refused = |reason| FciStartError::Port {
        address: wanted.to_string(),
        reason,
    };
    let mut attempts = 0;
    loop {
        attempts += 1;
        let listener = TcpListener::bind(wanted).map_err(refused)?;
        let same = listener.local_addr().map_err(refused)?;
        match UdpSocket::bind(same) {
            Ok(udp) => return Ok((listener, udp)),
            // Somebody has that number on UDP; where any will do, another is drawn.
            Err(_) if port == 0 && attempts < 20 => {}
            Err(reason) => return Err(refused(reason)),
        }
    }
}

struct Client {
    stream: TcpStream,
    framer: Framer,
    /// Where states go, once it has connected.
    states: Option<SocketAddr>,
}

struct Server {
    robot: FciRobot,
    listener: TcpListener,
    udp: UdpSocket,
    client: Option<Client>,
    faults: Receiver<FciFault>,
    snapshot: Arc<Mutex<Option<Snapshot>>>,
    stop: Arc<AtomicBool>,
    truth: Option<FciTruthListener>,
    wait: Duration,
    drop_states: u32,
    drop_answers: u32,
    frozen_until: Option<Instant>,
    cycles: u64,
    missed: u64,
    answers_lost: u64,
    connections: u64,
    torque_step_max_nm: f64,
    torque_before: Option<[f64; 7]>,
    datagram: Vec<u8>,
}

impl Server {
    fn run(&mut self) {
        let mut clock = DeadlineClock::new(Duration::from_secs_f64(PERIOD_S));
        while !self.stop.load(Ordering::Acquire) {
            self.missed += clock.wait();
            while let Ok(fault) = self.faults.try_recv() {
                self.apply(fault);
            }
            if let Some(until) = self.frozen_until {
                if Instant::now() < until {
                    continue;
                }
                self.frozen_until = None;
            }
            self.cycle();
        }
    }

    fn cycle(&mut self) {
        self.accept();
        self.hear_requests();
        let state = self.robot.state();
        self.send(&state);
        let mut answer = self.answer_to(state.message_id);
        if self.drop_answers > 0 && self.robot.wants_answer() {
            self.drop_answers -= 1;
            answer = None;
        }
        if self.robot.wants_answer() {
            match &answer {
                Some(answer) => self.measure(answer),
                None => self.answers_lost += 1,
            }
        } else {
            self.torque_before = None;
        }
        self.robot.step(answer.as_ref());
        self.reply();
        self.cycles += 1;
        let truth = self.robot.plant().truth();
        if let (Some(listener), Some(truth)) = (&mut self.truth, &truth) {
            listener(truth);
        }
        self.show(state, truth);
    }

    fn accept(&mut self) {
        let Ok((stream, _)) = self.listener.accept() else {
            return;
        };
        let ready = stream
            .set_nonblocking(true)
            .and_then(|()| stream.set_nodelay(true))
            .is_ok();
        // One client at a time: a second one finds the door closed.
        if ready && self.client.is_none() {
            self.connections += 1;
            self.client = Some(Client {
                stream,
                framer: Framer::new(),
                states: None,
            });
        }
    }

    fn hear_requests(&mut self) {
        let Some(client) = &mut self.client else {
            return;
        };
        let mut bytes = [0; 2048];
        let mut gone = false;
        loop {
            match client.stream.read(&mut bytes) {
                Ok(0) => gone = true,
                Ok(n) => {
                    client.framer.push(&bytes[..n]);
                    if n == bytes.len() {
                        continue;
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(_) => gone = true,
            }
            break;
        }
        loop {
            match client.framer.next_message() {
                Ok(None) => break,
                Ok(Some(message)) => match Request::decode(&message) {
                    Ok(request) => {
                        if let Request::Connect { version, udp_port } = request
                            && version == tangent_franka::fci::VERSION
                            && let Ok(peer) = client.stream.peer_addr()
                        {
                            client.states = Some(SocketAddr::new(peer.ip(), udp_port));
                        } else if client.states.is_none()
                            && !matches!(request, Request::Connect { .. })
                        {
                            tracing::warn!(target: "simulator", "a client asks before it connects");
                            gone = true;
                            break;
                        }
                        self.robot.request(message.id, &request);
                    }
                    Err(error) => {
                        tracing::warn!(target: "simulator", "a client sends what is no FCI: {error}");
                        gone = true;
                        break;
                    }
                },
                Err(error) => {
                    tracing::warn!(target: "simulator", "a client sends what is no FCI: {error}");
                    gone = true;
                    break;
                }
            }
        }
        if gone {
            self.lose_client();
        }
    }

    fn lose_client(&mut self) {
        self.client = None;
        self.robot.disconnect();
    }

    fn send(&mut self, state: &RobotState) {
        if self.drop_states > 0 {
            self.drop_states -= 1;
            return;
        }
        let Some(to) = self.client.as_ref().and_then(|client| client.states) else {
            return;
        };
        self.datagram.clear();
        state.encode(&mut self.datagram);
        // A client that is not there does not hear it.
        let _ = self.udp.send_to(&self.datagram, to);
    }

    /// The answer to this cycle's state, if it comes in time.
    fn answer_to(&mut self, message_id: u64) -> Option<RobotCommand> {
        let from = self.client.as_ref().and_then(|client| client.states)?;
        let deadline = Instant::now() + self.wait;
        let mut bytes = [0; COMMAND_BYTES + 1];
        loop {
            match self.udp.recv_from(&mut bytes) {
                Ok((n, sender)) if sender == from => {
                    if let Ok(answer) = RobotCommand::decode(&bytes[..n])
                        && answer.message_id == message_id
                    {
                        return Some(answer);
                    }
                }
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    if !self.robot.wants_answer()
                        || Instant::now() >= deadline
                        || self.stop.load(Ordering::Acquire)
                    {
                        return None;
                    }
                    std::thread::sleep(LOOK);
                    // A long wait must not outlast the client, nor what it asks for meanwhile.
                    let mut waiting = [0];
                    let client = self.client.as_ref()?;
                    if client.stream.peek(&mut waiting).is_ok() {
                        return None;
                    }
                }
                Err(_) => return None,
            }
        }
    }

    fn measure(&mut self, answer: &RobotCommand) {
        let before = self.torque_before.unwrap_or([0.0; 7]);
        for (now, before) in answer.tau_j_d.iter().zip(before) {
            let step = (now - before).abs();
            // Not a number counts as the largest step there is.
            if step.is_nan() || step > self.torque_step_max_nm {
                self.torque_step_max_nm = if step.is_nan() { f64::INFINITY } else { step };
            }
        }
        self.torque_before = Some(answer.tau_j_d);
    }

    fn reply(&mut self) {
        let replies = self.robot.take_replies();
        if replies.is_empty() {
            return;
        }
        let mut bytes = Vec::new();
        let mut refused = false;
        for reply in &replies {
            reply.encode(&mut bytes);
            refused |= matches!(
                reply,
                Reply {
                    body: ReplyBody::Connect(ConnectStatus::IncompatibleVersion, _),
                    ..
                }
            );
        }
        let Some(client) = &mut self.client else {
            return;
        };
        let sent = client
            .stream
            .set_nonblocking(false)
            .and_then(|()| client.stream.set_write_timeout(Some(WRITE_TIMEOUT)))
            .and_then(|()| client.stream.write_all(&bytes))
            .and_then(|()| client.stream.set_nonblocking(true));
        if sent.is_err() || refused {
            self.lose_client();
        }
    }

    fn apply(&mut self, fault: FciFault) {
        match fault {
            FciFault::UserStop(pressed) => self.robot.set_user_stop(pressed),
            FciFault::Guiding(on) => self.robot.set_guiding(on),
            FciFault::Push(force_n) => self.robot.push(force_n),
            FciFault::DropStates(n) => self.drop_states = n,
            FciFault::DropAnswers(n) => self.drop_answers = n,
            FciFault::Freeze(s) => {
                self.frozen_until =
                    Some(Instant::now() + Duration::from_secs_f64(s.clamp(0.0, 3600.0)));
            }
            FciFault::Disconnect => self.lose_client(),
        }
    }

    fn show(&mut self, state: RobotState, truth: Option<Truth>) {
        let snapshot = Snapshot {
            cycles: self.cycles,
            missed: self.missed,
            state,
            answers_lost: self.answers_lost,
            torque_step_max_nm: self.torque_step_max_nm,
            connected: self.client.as_ref().is_some_and(|c| c.states.is_some()),
            connections: self.connections,
            truth,
        };
        // A reader of the last state must not delay the robot: it gets the next one.
        match self.snapshot.try_lock() {
            Ok(mut shown) => *shown = Some(snapshot),
            Err(TryLockError::Poisoned(shown)) => *shown.into_inner() = Some(snapshot),
            Err(TryLockError::WouldBlock) => {}
        }
    }
}
