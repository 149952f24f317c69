//! The thread of the running robot, paced by absolute deadlines, with its TCP and UDP sockets.
//!
//! A cycle reads requests, sends the state, waits briefly for the client's answer and steps the
//! robot. A late cycle is not made up for: simulated time then runs slowly, but no client receives
//! two states in a burst.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use tangent_franka::fci::{
    COMMAND_BYTES, ConnectStatus, Framer, PERIOD_S, Reply, ReplyBody, Request, RobotCommand,
    RobotState, STATE_BYTES,
};
use tangent_runtime::clock::DeadlineClock;
use tangent_simulated_device::DeviceLink;
use tangent_simulation::Truth;

use crate::fault::FciFault;
use crate::robot::FciRobot;

/// Polling interval for an answer.
const LOOK: Duration = Duration::from_micros(50);
/// Longest wait for the answer to the first state of a motion. libfranka waits for the second state
/// before it answers, and gives up after 1 s without a state.
const FIRST_WAIT: Duration = Duration::from_millis(300);
/// Time without progress after which a client that does not read its replies is disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

/// State of the robot after its last cycle.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Number of cycles since the start.
    pub cycles: u64,
    /// Number of deadlines that passed without a cycle.
    pub missed: u64,
    /// State as sent, or as it would have been sent.
    pub state: RobotState,
    /// Number of answers that were due and did not arrive, since the start.
    pub answers_lost: u64,
    /// Largest change of a joint's torque from one answer to the next since the start, Nm.
    pub torque_step_max_nm: f64,
    /// Whether a client is connected.
    pub connected: bool,
    /// Number of connections since the start.
    pub connections: u64,
    /// True state of the contact, if there is a surface.
    pub truth: Option<Truth>,
}

/// Callback with the ground truth of the contact, called once per cycle in the robot's thread.
pub type FciTruthListener = Box<dyn FnMut(&Truth) + Send>;

struct Client {
    stream: TcpStream,
    framer: Framer,
    /// Address for the states, once the client has connected.
    states: Option<SocketAddr>,
}

/// The robot with its sockets, in the thread that paces it.
pub(crate) struct Server {
    robot: FciRobot,
    listener: TcpListener,
    udp: UdpSocket,
    client: Option<Client>,
    link: DeviceLink<FciFault, Snapshot>,
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
    /// Creates the server. `wait`: longest wait for the answer to a state while a motion runs.
    pub fn new(
        robot: FciRobot,
        listener: TcpListener,
        udp: UdpSocket,
        wait: Duration,
        link: DeviceLink<FciFault, Snapshot>,
        truth: Option<FciTruthListener>,
    ) -> Self {
        Self {
            robot,
            listener,
            udp,
            client: None,
            link,
            truth,
            wait,
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
        }
    }

    /// Runs until the handle stops it.
    pub fn run(&mut self) {
        let mut clock = DeadlineClock::new(Duration::from_secs_f64(PERIOD_S));
        while !self.link.is_stopped() {
            self.missed += clock.wait();
            while let Some(fault) = self.link.next_fault() {
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
        // Only one client at a time: a second connection is refused.
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
                        tracing::warn!(target: "simulator", "a client sends data that is not FCI: {error}");
                        gone = true;
                        break;
                    }
                },
                Err(error) => {
                    tracing::warn!(target: "simulator", "a client sends data that is not FCI: {error}");
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
        // If the client has gone, the datagram is lost.
        let _ = self.udp.send_to(&self.datagram, to);
    }

    /// Returns the answer to this cycle's state, if it arrives in time.
    fn answer_to(&mut self, message_id: u64) -> Option<RobotCommand> {
        let from = self.client.as_ref().and_then(|client| client.states)?;
        let wait = if self.robot.begins_motion() {
            self.wait.min(FIRST_WAIT)
        } else {
            self.wait
        };
        let deadline = Instant::now() + wait;
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
                        || self.link.is_stopped()
                    {
                        return None;
                    }
                    std::thread::sleep(LOOK);
                    // A long wait must end if the client disconnects or sends a request.
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
            // A step that is not a number counts as the largest.
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
        self.link.show(snapshot);
    }
}
