//! A Franka's cell in simulated time: the robot's controller with arm and surface, the bridge, the
//! watch of the wrench estimate, camera and touch, the law. Bytes go to and fro between robot and
//! bridge; there is no socket, clock or thread, so that a fault comes in the very cycle that a test
//! names.

use std::sync::OnceLock;

use nalgebra::Vector3;
use tangent_actuation::Command;
use tangent_actuation::lease::{SILENCE_S, Source};
use tangent_control::{
    Clearance, ControlError, Phase, StateInterval, TorqueInterface, UnifiedForceImpedance,
    UnifiedInput, UnifiedOutput, VisionInput,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator};
use tangent_franka::bridge::{Bridge, posture_of};
use tangent_franka::fci::{Framer, PERIOD_S, Reply, Request, RobotCommand, RobotMode, RobotState};
use tangent_franka::wrench::tool_wrench;
use tangent_mechanics::{Arm, Joints, Pose, Tool, Twist, Wrench};
use tangent_runtime::CellConfig;
use tangent_runtime::config::FRANKA_TORQUE_RATE_SHARE;
use tangent_schemas::Name;
use tangent_sensing::{RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState, Validity};
use tangent_simulation::{NormalCamera, Surface, TactileScenario, Truth, loaded_arm};
use tangent_simulator::fci::{FciConfig, FciRobot, TactileArm};

use crate::fault::Fault;

/// The published wave and the cell that ships for it.
const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");
const CELL: &str = include_str!("../../../../deploy/cell.karacan.toml");
/// Two millimetres above the surface and square to it, on the path soon after the touch, and soon
/// off the surface.
const CHANGES: [&str; 11] = [
    "plant.start.clearance_m=0.002",
    "plant.start.tilt_rad=0.0",
    "plant.start_spread.tilt_rad=0.0",
    "plant.start_spread.position_m=0.0",
    "plant.start_spread.clearance_m=0.0",
    "control.touch.settle_s=0.3",
    "control.touch.tare_s=0.1",
    "control.patience.wrench_jitter_s=0.002",
    "task.end.retract_distance_m=0.02",
    "plant.arm.sub_steps=2",
    "plant.tool.pad.rings=1",
];
/// Longest wait for anything, cycles.
const PATIENCE: u64 = 30_000;
/// Cycles in which the watch of the wrench learns how it lives, and what it has learnt; nothing is
/// judged before.
const LEARNS: u64 = 1_100;
static LEARNT: OnceLock<RecordWatchState> = OnceLock::new();
/// A robot that sends nothing for so long is gone to the bridge, and the pause before it connects
/// again, s.
const GONE_S: f64 = 1.0;
const PAUSE_S: f64 = 0.2;
/// Parts of a newton that a difference of the estimate is seen in.
const COUNTS_PER_UNIT: f64 = 1e6;
/// Readings of a tool that hangs free, kept to be shown again.
const FREE_READINGS: usize = 200;

/// What a controller sends.
#[derive(Clone, Copy, Debug)]
struct Sent {
    cycle: u64,
    kind: u8,
    values: [f64; 7],
    activation: u64,
}

/// A wrench as the controller hears it, and when it was said, s.
#[derive(Clone, Copy, Debug)]
struct Heard {
    wrench: Wrench<Tool>,
    validity: Validity,
    at_s: f64,
}

/// The cell.
pub struct Cell {
    robot: FciRobot,
    surface: Surface,
    camera: NormalCamera,
    scenario: TactileScenario,
    settings: tangent_franka::Config,
    bridge: Bridge,
    connected: bool,
    /// When the bridge may connect again, the pause after that, and how many states it had when it
    /// connected last.
    retry: (f64, f64, u64),
    heard_s: f64,
    tcp: Vec<u8>,
    /// States that nobody took, and the last few of them.
    skipped: u64,
    states: Vec<RobotState>,
    watch: (RecordWatch, RecordWatchState),
    /// The estimate as it stood before a fault of it.
    kept: [f64; 6],
    free: Vec<Wrench<Tool>>,
    wrench: Option<Heard>,
    stated: Arm<7>,
    interval: StateInterval,
    law: UnifiedForceImpedance,
    activation: u64,
    source: Source,
    starts: u8,
    spoke_s: f64,
    touch: Box<dyn NormalEstimator>,
    /// Of the law: the oldest word of touch that it takes, and the lag of the robot's estimate, s.
    patience_s: f64,
    lag_s: f64,
    /// What touch says, and of which cycle of the bridge.
    touched: Option<(NormalEstimate, u64)>,
    seen: Option<VisionInput>,
    last_sent: Option<Sent>,
    held_back: Option<Sent>,
    pub output: Option<UnifiedOutput>,
    pub cycle: u64,
    /// What is wrong now.
    pub faults: Vec<Fault>,
    faults_before: Vec<Fault>,
    /// Where the tool truly is, base axes, m.
    at: Vector3<f64>,
    /// Largest true force since it was set to zero, N.
    pub peak_n: f64,
    /// Something pushes the tool, until the robot stops.
    knocked: bool,
    /// Answers that reached the robot, and the last of them, Nm.
    pub answers: u64,
    pub answered: Joints<7>,
}

fn source(name: &str, id: u8) -> Source {
    Source {
        name: Name::from(name).unwrap(),
        publisher: [id; 16],
    }
}

impl Cell {
    /// Connected, held, with a controller that waits for a task.
    pub fn new() -> Self {
        let changes: Vec<String> = CHANGES.iter().map(|s| (*s).to_owned()).collect();
        let scenario = TactileScenario::parse("karacan_wave", WAVE, &changes).unwrap();
        let config = CellConfig::parse("cell.karacan.toml", CELL).unwrap();
        let settings = tangent_franka::Config::from_cell(&config).unwrap();
        let franka = config.robot.franka();
        let plant = TactileArm::new(&scenario.plant, franka.delay_periods, 1).unwrap();
        let stated = loaded_arm::<7>(&scenario.plant.robot, &scenario.plant.tool, false).unwrap();
        let parameters = scenario.law().unwrap();
        let law = UnifiedForceImpedance::new(
            stated,
            settings.flange_from_tool,
            scenario.limits,
            &parameters,
            &scenario.task,
            TorqueInterface {
                delay_periods: franka.delay_periods,
                gravity_by_arm: true,
                effort_share: franka.torque_share,
                rate_share: FRANKA_TORQUE_RATE_SHARE,
            },
        )
        .unwrap();
        let mut cell = Self {
            surface: plant.surface().clone(),
            camera: NormalCamera::new(&scenario.plant.camera, 1),
            robot: FciRobot::new(&FciConfig::default(), Box::new(plant)).unwrap(),
            bridge: Bridge::new(settings.bridge.clone()),
            connected: false,
            retry: (0.0, PAUSE_S, 0),
            heard_s: 0.0,
            tcp: Vec::new(),
            skipped: 0,
            states: Vec::new(),
            watch: (
                RecordWatch::new(&RecordWatchConfig::default(), 1.0 / PERIOD_S),
                RecordWatchState::default(),
            ),
            kept: [0.0; 6],
            free: Vec::new(),
            wrench: None,
            touch: scenario.touch().unwrap(),
            touched: None,
            patience_s: parameters.patience.estimate_s,
            lag_s: parameters.touch.wrench_lag_s,
            seen: None,
            last_sent: None,
            held_back: None,
            stated,
            interval: StateInterval::default(),
            law,
            activation: 0,
            source: source("controller/cell-1", 1),
            starts: 1,
            spoke_s: 0.0,
            output: None,
            cycle: 0,
            faults: Vec::new(),
            faults_before: Vec::new(),
            at: Vector3::zeros(),
            peak_n: 0.0,
            knocked: false,
            answers: 0,
            answered: Joints::zeros(),
            settings,
            scenario,
        };
        cell.at = cell.truth().base_from_tool.translation();
        // No task was started yet.
        cell.say_clear();
        cell.connect();
        let learnt = LEARNT.get().copied();
        cell.watch.1 = learnt.unwrap_or_default();
        cell.until("the arm is ready", Cell::is_ready);
        if learnt.is_none() {
            cell.steps(LEARNS);
            // Another thread may have been first.
            let _ = LEARNT.set(cell.watch.1);
            return Self::new();
        }
        cell
    }

    /// Starts the task, as the service does with one that is asked for while the arm is ready.
    pub fn start_task(&mut self) -> Result<(), ControlError> {
        let clearance = self.law.clearance();
        self.law
            .check_start(&clearance, &self.tool().translation())?;
        self.law.begin(clearance);
        let latched = self.bridge.gate().admission.activation_latched();
        self.activation = self.activation.max(latched) + 1;
        Ok(())
    }

    /// Ends the task.
    pub fn stop_task(&mut self) {
        self.law.stop();
    }

    /// A person has looked, and says that the tool hangs free.
    pub fn say_clear(&mut self) {
        self.law.begin(Clearance::Assumed);
        self.law.stop();
    }

    /// A person has the robot leave its reflex.
    pub fn recover(&mut self) {
        self.bridge.recover();
    }

    /// A task in this phase, as far as it has come in the first cycle of it.
    pub fn in_phase(phase: Phase) -> Self {
        let mut cell = match phase {
            Phase::Slide => return Self::sliding(),
            Phase::Hold | Phase::Retract | Phase::Clear => Self::sliding(),
            _ => Self::new(),
        };
        match phase {
            Phase::Hold => cell.law.pause(true).unwrap(),
            Phase::Retract => cell.law.stop(),
            Phase::Clear => {
                // A task that ended on the surface.
                cell.faults = vec![Fault::NoCommand];
                cell.steps(400);
                cell.faults.clear();
                cell.until("the task is over", |c| !c.phase().is_active());
                cell.until("the arm is ready", Cell::is_ready);
                cell.start_task().unwrap();
            }
            _ => cell.start_task().unwrap(),
        }
        // A pause keeps the phase that it comes in.
        if phase != Phase::Hold {
            cell.until("it is in the phase", |c| c.phase() == phase);
        }
        cell.peak_n = 0.0;
        cell
    }

    /// On the path.
    pub fn sliding() -> Self {
        let mut cell = Self::new();
        cell.start_task().unwrap();
        cell.until("it slides", |c| {
            c.law.phase() == Phase::Slide && c.tool_speed() > 0.02
        });
        cell.peak_n = 0.0;
        cell
    }

    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.cycle as f64 * PERIOD_S
    }

    pub fn phase(&self) -> Phase {
        self.law.phase()
    }

    pub fn reference_n(&self) -> f64 {
        self.scenario.task.force.reference_n
    }

    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    pub fn mode(&self) -> RobotMode {
        self.robot.mode()
    }

    /// When the newest frame that the law has was taken, s.
    pub fn seen_s(&self) -> f64 {
        self.seen.unwrap().time_s
    }

    pub fn activation(&self) -> u64 {
        self.activation
    }

    /// The torque motion runs, nobody else drives the arm, and a task could move it.
    pub fn is_ready(&self) -> bool {
        let holder = self.bridge.lease().holder();
        self.connected
            && self.bridge.reason(self.now_s()).is_none()
            && holder.is_none_or(|holder| *holder == self.source)
    }

    pub fn truth(&self) -> Truth {
        self.robot.plant().truth().unwrap()
    }

    /// Largest joint speed of the arm, rad/s.
    pub fn robot_speed(&self) -> f64 {
        self.robot.plant().reading().qd.amax()
    }

    fn tool(&self) -> Pose<tangent_mechanics::Base, Tool> {
        let q = self.robot.plant().reading().q;
        self.stated.base_from_flange(&q) * self.settings.flange_from_tool
    }

    fn tool_speed(&self) -> f64 {
        let now = self.robot.plant().reading();
        let (_, jacobian) = self
            .stated
            .tool_and_jacobian(&now.q, &self.settings.flange_from_tool);
        (jacobian * now.qd).fixed_rows::<3>(0).norm()
    }

    /// Cycles until `done`.
    pub fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = self.cycle;
        while !done(self) {
            self.step();
            assert!(
                self.cycle - begun < PATIENCE,
                "never: {what}; {:?}, {:?}, {:?}, {:?}",
                self.law.phase(),
                self.bridge.reason(self.now_s()),
                self.robot.mode(),
                self.output.and_then(|o| o.fault)
            );
        }
    }

    pub fn steps(&mut self, n: u64) {
        for _ in 0..n {
            self.step();
        }
    }

    pub fn has(&self, fault: Fault) -> bool {
        self.faults.contains(&fault)
    }

    /// One period of the robot: it says its state, is answered or not, and moves.
    pub fn step(&mut self) {
        self.cycle += 1;
        self.begin_and_end();
        if self.knocked && self.robot.mode() != RobotMode::Move {
            self.knocked = false;
            self.robot.push([0.0; 3]);
        }
        self.camera.expose(self.now_s(), &self.surface, &self.at);
        let mut datagram = Vec::new();
        self.robot.state().encode(&mut datagram);
        let state = RobotState::decode(&datagram).unwrap();
        let answer = self.exchange(state);
        if let Some(answer) = &answer {
            self.answers += 1;
            self.answered = Joints::from(answer.tau_j_d);
        }
        self.robot.step(answer.as_ref());
        let truth = self.truth();
        self.at = truth.base_from_tool.translation();
        self.peak_n = self.peak_n.max(truth.wrench.force.norm());
    }

    /// What faults do when they begin, and people when they are over.
    fn begin_and_end(&mut self) {
        if self.faults == self.faults_before {
            return;
        }
        let before = std::mem::replace(&mut self.faults_before, self.faults.clone());
        let now = self.faults.clone();
        for fault in now.iter().filter(|fault| !before.contains(fault)) {
            match fault {
                Fault::BridgeDead | Fault::Disconnected => self.lost(),
                Fault::Collision => {
                    self.knocked = true;
                    self.robot.push([0.0, 0.0, 90.0]);
                }
                Fault::UserStop => self.robot.set_user_stop(true),
                _ => {}
            }
        }
        for fault in before.iter().filter(|fault| !now.contains(fault)) {
            match fault {
                Fault::BridgeDead => {
                    self.bridge = Bridge::new(self.settings.bridge.clone());
                    self.start_controller();
                    self.retry = (self.now_s(), PAUSE_S, 0);
                }
                Fault::ControllerDead => self.start_controller(),
                Fault::UserStop => self.robot.set_user_stop(false),
                Fault::CommandSwapped => self.held_back = None,
                _ => {}
            }
        }
    }

    /// Another controller's process: what it keeps is whether the tool may touch.
    fn start_controller(&mut self) {
        self.starts += 1;
        self.source = source("controller/cell-n", self.starts);
        let known = self.law.clearance();
        self.activation = 0;
        // A law without a task does nothing; it is told of the tool when one starts.
        self.law.begin(known);
        self.law.stop();
        self.touch = self.scenario.touch().unwrap();
        (self.touched, self.seen, self.output) = (None, None, None);
    }

    fn connect(&mut self) {
        let now_s = self.now_s();
        self.connected = true;
        self.heard_s = now_s;
        self.retry.2 = self.bridge.cycle();
        self.tcp.clear();
        self.skipped = 0;
        self.states.clear();
        self.bridge.open(4000, now_s, &mut self.tcp);
    }

    /// The connection is gone, to both.
    fn lost(&mut self) {
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

    /// The state's way to the bridge, and the answer's to the robot.
    fn exchange(&mut self, state: RobotState) -> Option<RobotCommand> {
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
        let odd = self.cycle % 2 == 1;
        let arrive = match () {
            () if self.has(Fault::StatesLost) || (self.has(Fault::StatesThinned) && odd) => 0,
            () if self.has(Fault::StateTwice) => 2,
            () => 1,
        };
        let mut arrived = state;
        if self.has(Fault::StateLate) {
            arrived = self.states[0];
        }
        self.spoil(&mut arrived);
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
        if now_s - self.heard_s > GONE_S {
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

    /// What comes of a state by a fault of the robot's estimate.
    fn spoil(&mut self, state: &mut RobotState) {
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

    /// The wrench of this state, watched as the bridge does it, as the controller hears it.
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
            heard.wrench = self.free[self.cycle as usize % self.free.len()];
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

    /// State and wrench out, commands in, guarded.
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
        let mut newest = None;
        for (source, sent) in queue {
            let admitted = self.bridge.admit(&source, sent.activation, now_s);
            let own = source == self.source;
            assert!(
                own || !admitted || now_s - self.spoke_s > SILENCE_S,
                "a second source is let in beside the first"
            );
            if admitted {
                if own {
                    self.spoke_s = now_s;
                }
                newest = Some(sent);
            }
        }
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

    /// What arrives of an answer.
    fn on_the_way(&mut self, mut sent: Sent) -> Vec<Sent> {
        if self.has(Fault::CommandRepeated) {
            return self.last_sent.into_iter().collect();
        }
        self.last_sent = Some(sent);
        if self.has(Fault::CommandNan) {
            sent.values[3] = f64::NAN;
        }
        if self.has(Fault::CommandStrong) {
            sent.values[1] = 500.0;
        }
        if self.has(Fault::CommandOld) {
            sent.cycle = sent.cycle.saturating_sub(1000);
        }
        if self.has(Fault::CommandAhead) {
            sent.cycle += 5;
        }
        if self.has(Fault::CommandSwapped) {
            return match self.held_back.take() {
                Some(older) => vec![sent, older],
                None => {
                    self.held_back = Some(sent);
                    Vec::new()
                }
            };
        }
        vec![sent]
    }

    /// What touch and camera say in this cycle.
    fn look(&mut self, now_s: f64) -> Option<(NormalEstimate, f64)> {
        let silent = self.has(Fault::EstimatesSilent);
        if let Some(mut frame) = self.camera.take(now_s) {
            if self.has(Fault::CameraNan) {
                frame.normal = Vector3::repeat(f64::NAN);
            }
            if self.has(Fault::CameraAskew) {
                let turn = nalgebra::Rotation3::new(Vector3::new(1.0, 0.0, 0.0));
                frame.normal = turn * frame.normal;
            }
            if !self.has(Fault::CameraDark) && !silent {
                self.seen = Some(frame);
            }
        }
        self.touched
            .map(|(said, cycle)| (said, (self.bridge.cycle() - cycle) as f64 * PERIOD_S))
            .filter(|(_, age_s)| *age_s <= self.patience_s)
    }

    /// The controller answers a state.
    fn law_step(&mut self, state: &RobotState, now_s: f64) -> Sent {
        let touch = self.look(now_s);
        let latched = self.bridge.gate().admission.activation_latched();
        // As the service does: a task that the bridge has latched out moves nothing any more.
        let ended = self.law.phase().is_active() && latched >= self.activation;
        let heard = self.wrench;
        let input = UnifiedInput {
            time_s: now_s,
            dt_s: self
                .interval
                .step(state.message_id as f64 * PERIOD_S, PERIOD_S),
            q: Joints::from(state.q),
            qd: Joints::from(state.dq),
            arm_ready: self.is_ready() && !ended,
            wrench: heard.map_or_else(Wrench::zero, |h| h.wrench),
            wrench_validity: heard.map_or(Validity::Missing, |h| h.validity),
            wrench_age_s: heard.map_or(f64::INFINITY, |h| now_s - h.at_s),
            untared: None,
            vision: self.seen,
            touch: touch.map(|(said, _)| said),
            touch_age_s: touch.map_or(f64::INFINITY, |(_, age_s)| age_s),
        };
        let output = self.law.step(&input);
        assert!(output.torque.iter().all(|x| x.is_finite()));
        self.output = Some(output);
        self.feel(&input, &output);
        Sent {
            cycle: self.bridge.cycle(),
            kind: if output.phase.is_active() { 2 } else { 0 },
            values: output.torque.into(),
            activation: self.activation,
        }
    }

    /// The normal by touch for the cycles to come, from the wrench as the law has cleaned it.
    fn feel(&mut self, input: &UnifiedInput, output: &UnifiedOutput) {
        if self.has(Fault::TouchSilent) || self.has(Fault::EstimatesSilent) {
            return;
        }
        let tool = &self.settings.flange_from_tool;
        let (_, jacobian) = self.stated.tool_and_jacobian(&input.q, tool);
        let zeroed = !matches!(output.phase, Phase::Tare | Phase::Clear);
        let felt = output
            .wrench
            .filter(|_| zeroed && input.wrench_validity.is_valid());
        let twist = Twist::from_vector(&(jacobian * input.qd));
        let said = self.touch.update(&ContactSample {
            time_s: input.time_s,
            dt_s: input.dt_s,
            base_from_tool: output.base_from_tool,
            twist,
            twist_commanded: twist,
            wrench: felt.unwrap_or(Wrench::zero()),
            wrench_delay_s: self.lag_s,
            wrench_validity: if felt.is_some() {
                Validity::Valid
            } else {
                Validity::Missing
            },
            wrench_bias_age_s: felt.map(|_| input.time_s),
            base: None,
        });
        self.touched = Some((said, self.bridge.cycle()));
    }
}
