//! Robot, bridge and controller, with the bytes and commands between them.

use tangent_actuation::Command;
use tangent_control::{Law, Phase, TorqueLaw};
use tangent_franka::bridge::posture_of;
use tangent_franka::fci::{Framer, Reply, Request, RobotCommand, RobotState};
use tangent_franka::wrench::tool_wrench;
use tangent_mechanics::{Joints, Wrench};
use tangent_sensing::{RecordVerdict, Validity};

use super::{COUNTS_PER_UNIT, Cell, FREE_READINGS, Heard, PAUSE_S, STATE_TIMEOUT_S, Sent};
use crate::fault::Fault;
use crate::table::arrivals::{Way, newest};
use crate::table::{TableCell, source};

impl Cell {
    /// Starts a new controller process; it only knows whether the tool may be in contact.
    pub(super) fn start_controller(&mut self) {
        self.starts += 1;
        self.source = source("controller/cell-n", self.starts);
        let known = self.law.clearance();
        self.activation = 0;
        // A law without a task does nothing; it receives this state of the tool when one starts.
        self.law.begin(known);
        self.law.stop();
        self.touch = self.scenario.touch().unwrap();
        (self.touched, self.seen, self.output) = (None, None, None);
    }

    pub(super) fn connect(&mut self) {
        let now_s = self.now_s();
        self.connected = true;
        self.heard_s = now_s;
        self.retry.2 = self.bridge.cycle();
        self.tcp.clear();
        self.skipped = 0;
        self.states.clear();
        self.bridge.open(4000, now_s, &mut self.tcp);
    }

    /// Both sides lose the connection.
    pub(super) fn lost(&mut self) {
        if !self.connected {
            return;
        }
        self.connected = false;
        self.bridge.close();
        self.robot.disconnect();
        let (_, pause_s, cycles) = self.retry;
        let pause_s = if self.bridge.cycle() > cycles {
            PAUSE_S
        } else {
            pause_s
        };
        self.retry = (self.now_s() + pause_s, 2.0 * pause_s, cycles);
    }

    /// Passes the state to the bridge, and the answer to the robot.
    pub(super) fn exchange(&mut self, state: RobotState) -> Option<RobotCommand> {
        if self.has(Fault::BridgeDead) || self.has(Fault::Disconnected) {
            return None;
        }
        let now_s = self.now_s();
        if !self.connected {
            if now_s >= self.retry.0 {
                self.connect();
            }
            return None;
        }
        self.states.push(state);
        if self.states.len() > 3 {
            self.states.remove(0);
        }
        if self.has(Fault::BridgeHung) {
            self.skipped += 1;
            return None;
        }
        let odd = self.trial.cycle % 2 == 1;
        let arrive = match () {
            () if self.has(Fault::StatesLost) || (self.has(Fault::StatesThinned) && odd) => 0,
            () if self.has(Fault::StateTwice) => 2,
            () => 1,
        };
        let mut arrived = state;
        if self.has(Fault::StateLate) {
            arrived = self.states[0];
        }
        self.corrupt(&mut arrived);
        let mut answer = None;
        for _ in 0..arrive {
            self.heard_s = now_s;
            let skipped = std::mem::take(&mut self.skipped);
            match self.bridge.state(&arrived, skipped, now_s, &mut self.tcp) {
                Ok(true) => answer = self.answer(&arrived, now_s),
                Ok(false) => {}
                Err(_) => {
                    self.lost();
                    return None;
                }
            }
        }
        self.converse(now_s);
        if now_s - self.heard_s > STATE_TIMEOUT_S {
            self.lost();
        }
        let lost = self.has(Fault::AnswersLost) || (self.has(Fault::AnswersThinned) && odd);
        answer.filter(|_| !lost)
    }

    fn converse(&mut self, now_s: f64) {
        let mut framer = Framer::new();
        framer.push(&self.tcp);
        self.tcp.clear();
        while let Some(message) = framer.next_message().unwrap() {
            let request = Request::decode(&message).unwrap();
            self.robot.request(message.id, &request);
        }
        let mut bytes = Vec::new();
        for reply in self.robot.take_replies() {
            reply.encode(&mut bytes);
        }
        framer.clear();
        framer.push(&bytes);
        while let Some(message) = framer.next_message().unwrap() {
            let reply = Reply::decode(&message).unwrap();
            self.bridge.reply(&reply, now_s).unwrap();
        }
    }

    /// Publishes state and wrench, and reads commands with the bridge's checks.
    fn answer(&mut self, state: &RobotState, now_s: f64) -> Option<RobotCommand> {
        self.sense(state, now_s);
        let (q, tool) = (Joints::from(state.q), &self.settings.flange_from_tool);
        let (pose, jacobian) = self.settings.arm.tool_and_jacobian(&q, tool);
        let posture = posture_of(state, pose.translation(), jacobian);
        let mut queue = Vec::new();
        if self.has(Fault::SecondSource) {
            let sent = Sent {
                cycle: self.bridge.cycle(),
                kind: 2,
                values: [1.0; 7],
                activation: 99,
            };
            queue.push((source("controller/other-2", 200), sent));
        }
        if !self.has(Fault::NoCommand) && !self.has(Fault::ControllerDead) {
            let sent = self.law_step(state, now_s);
            let arriving = self.on_the_way(sent);
            queue.extend(arriving.into_iter().map(|sent| (self.source, sent)));
        }
        let (bridge, spoke_s) = (&mut self.bridge, &mut self.spoke_s);
        let newest = newest(queue, &self.source, spoke_s, now_s, |source, sent| {
            bridge.admit(source, sent.activation, now_s)
        });
        let wanted = newest.as_ref().map(|sent| Command {
            cycle: sent.cycle,
            kind: sent.kind,
            values: &sent.values,
            acceleration: 0.0,
            activation: sent.activation,
        });
        let mut udp = Vec::new();
        self.bridge
            .command(&posture, wanted.as_ref(), now_s, &mut self.tcp, &mut udp);
        RobotCommand::decode(&udp).ok()
    }

    /// The commands that arrive when the controller sends `sent`.
    fn on_the_way(&mut self, sent: Sent) -> Vec<Sent> {
        let way = match () {
            () if self.has(Fault::CommandRepeated) => Way::Repeated,
            () if self.has(Fault::CommandSwapped) => Way::Swapped,
            () => Way::Open,
        };
        let faults = &self.trial.faults;
        self.arrivals.pass(way, sent, |sent| {
            if faults.contains(&Fault::CommandNan) {
                sent.values[3] = f64::NAN;
            }
            if faults.contains(&Fault::CommandStrong) {
                sent.values[1] = 500.0;
            }
            if faults.contains(&Fault::CommandOld) {
                sent.cycle = sent.cycle.saturating_sub(1000);
            }
            if faults.contains(&Fault::CommandAhead) {
                sent.cycle += 5;
            }
        })
    }

    /// Changes a state according to the faults of the robot's estimate.
    fn corrupt(&mut self, state: &mut RobotState) {
        let felt = &mut state.k_f_ext_hat_k;
        if self.has(Fault::WrenchFrozen) {
            *felt = self.kept;
        } else if self.has(Fault::AxisStuck) {
            felt[2] = self.kept[2];
        } else {
            self.kept = *felt;
        }
        if self.has(Fault::StateNan) {
            felt[2] = f64::NAN;
        }
    }

    /// The wrench of this state as the controller receives it, watched as in the bridge.
    fn sense(&mut self, state: &RobotState, now_s: f64) {
        let raw = tool_wrench(state, &self.settings.flange_from_tool);
        let vector = raw.vector();
        let counts = std::array::from_fn(|i| (vector[i] * COUNTS_PER_UNIT).round() as i32);
        let (watch, memory) = &mut self.watch;
        let found = match watch.take(memory, &counts, None) {
            RecordVerdict::Plausible => Validity::Valid,
            RecordVerdict::Frozen => Validity::Frozen,
            RecordVerdict::AxisStuck(_) => Validity::AxisStuck,
        };
        let mut heard = Heard {
            wrench: raw,
            validity: found,
            at_s: now_s,
        };
        if self.has(Fault::ContactLost) && !self.free.is_empty() {
            heard.wrench = self.free[self.trial.cycle as usize % self.free.len()];
        } else if self.law.phase() == Phase::Tare && self.free.len() < FREE_READINGS {
            self.free.push(raw);
        }
        if self.has(Fault::WrenchNan) {
            heard.wrench = Wrench::from_vector(&nalgebra::Vector6::repeat(f64::NAN));
        }
        if self.has(Fault::WrenchError) {
            heard.validity = Validity::SensorError;
        }
        if !self.has(Fault::WrenchSilent) {
            self.wrench = Some(heard);
        }
    }
}
