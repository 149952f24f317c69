//! The simulated robot, the bridge and a torque law in one process, with functions for the tests.

use std::path::Path;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use tangent_franka::Config;
use tangent_franka::fci::RobotMode;
use tangent_runtime::config::{FrankaConfig, RobotDriver};
use tangent_runtime::{Bus, CellConfig, Handle, StateFolder, Stop, Subscription};
use tangent_schemas::tangent::{Answer, ArmCommand, ArmState, Request, WrenchStatus};
use tangent_schemas::topics;
use tangent_simulated_device::Ports;
use tangent_simulated_franka::{FciConfig, FciFault, PlantConfig, SimulatedFranka};

pub const PATIENCE: Duration = Duration::from_secs(60);
pub const STIFFNESS: [f64; 7] = [150.0, 150.0, 120.0, 120.0, 40.0, 30.0, 10.0];
pub const DAMPING: [f64; 7] = [30.0, 30.0, 20.0, 20.0, 4.0, 3.0, 1.0];

/// Behaviour of the controller in the tests.
pub const STILL: u8 = 0;
pub const IMPEDANCE: u8 = 1;
pub const SILENT: u8 = 2;
pub const NAN: u8 = 3;
pub const STEPS: u8 = 4;

pub struct Cell {
    pub simulated: Arc<SimulatedFranka>,
    config: Config,
    pub bus: Bus,
    pub stop: Stop,
    states: Subscription<ArmState>,
    pub act: Arc<AtomicU8>,
    pub activation: Arc<AtomicU64>,
    _controller: Handle,
    pub bridge: Option<JoinHandle<Result<(), tangent_franka::Error>>>,
}

pub fn simulated(plant: PlantConfig) -> SimulatedFranka {
    SimulatedFranka::start(&FciConfig {
        ports: Ports::Ephemeral,
        plant,
        // On a busy machine, time runs slowly instead of losing answers: the only losses are those
        // that a test provokes.
        answer_wait_s: 1.0,
        ..FciConfig::default()
    })
    .unwrap()
}

pub fn config(simulated: &SimulatedFranka) -> Config {
    let mut cell = CellConfig::default_cell();
    cell.robot.model = "panda".into();
    cell.robot.driver = RobotDriver::Franka;
    cell.robot.franka = Some(FrankaConfig {
        fci_port: simulated.address().port(),
        ..FrankaConfig::default()
    });
    cell.sensor.flange_from_sensor.translation_m = [0.0; 3];
    cell.tool.flange_from_tool.translation_m = [0.0, 0.0, 0.12];
    cell.realtime.enabled = false;
    let mut config = Config::from_cell(&cell).unwrap();
    // An average takes time of the robot, which runs slowly on a busy machine, but the answer to a
    // request is due in real time.
    config.tare.duration_s = 0.1;
    config
}

impl Cell {
    pub fn new() -> Self {
        Self::keeping(None)
    }

    /// Starts the rig with a folder for the state that outlasts the bridge.
    pub fn keeping(folder: Option<&Path>) -> Self {
        let simulated = Arc::new(simulated(PlantConfig::default()));
        let mut config = config(&simulated);
        config.state = folder.map(StateFolder::new);
        let bus = Bus::in_process("test");
        let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        let act = Arc::new(AtomicU8::new(STILL));
        let activation = Arc::new(AtomicU64::new(0));
        let controller = controller(&bus, &act, &activation);
        let stop = Stop::new();
        let bridge = start_bridge(&config, &bus, &stop);
        Self {
            simulated,
            config,
            bus,
            stop,
            states,
            act,
            activation,
            _controller: controller,
            bridge: Some(bridge),
        }
    }

    /// Replaces the bridge by another one on a new bus, so that all publishers on the old bus are
    /// silent.
    pub fn again(&mut self) {
        self.stop.trigger();
        self.bridge.take().unwrap().join().unwrap().unwrap();
        self.bus = Bus::in_process("test");
        self.states = self.bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        self._controller = controller(&self.bus, &self.act, &self.activation);
        self.stop = Stop::new();
        self.bridge = Some(start_bridge(&self.config, &self.bus, &self.stop));
    }

    /// Pushes the tool up with `force_n` (N) from now on, and lets the arm settle.
    pub fn push(&self, force_n: f64) {
        self.simulated.fault(FciFault::Push([0.0, 0.0, force_n]));
        self.states(1500);
    }

    pub fn tare(&self, action: &str, argument: &str) -> Answer {
        let request = Request {
            action: action.into(),
            argument: argument.into(),
        };
        self.bus
            .ask(topics::queries::NETFT_TARE, &request, PATIENCE)
            .unwrap()
    }

    /// Force along z at the tool, N, and the status published with it.
    pub fn felt(&self) -> (f64, WrenchStatus) {
        let wrenches = self.bus.subscribe(&topics::WRENCH_TOOL, 1).unwrap();
        let statuses = self.bus.subscribe(&topics::WRENCH_STATUS, 1).unwrap();
        self.states(5);
        let wrench = wrenches.recv_timeout(PATIENCE).unwrap().message;
        let status = statuses.recv_timeout(PATIENCE).unwrap().message;
        (wrench.wrench.force.z, status)
    }

    pub fn until(&self, what: &str, condition: impl Fn(&ArmState) -> bool) -> ArmState {
        let mut last = None;
        for _ in 0..200_000 {
            let Some(received) = self.states.recv_timeout(PATIENCE) else {
                break;
            };
            if condition(&received.message) {
                return received.message;
            }
            last = Some(received.message);
        }
        panic!("{what} never came; last state {last:?}");
    }

    pub fn ready(&self) -> ArmState {
        self.until("ready", |s| s.ready && s.runtime_state == 2)
    }

    pub fn states(&self, n: usize) {
        let first = self.until("states", |_| true).cycle;
        self.until("states", |s| s.cycle >= first + n as u64);
    }

    /// Sets the behaviour of the controller from now on, in a new task.
    pub fn start(&self, act: u8) -> u64 {
        let activation = self.activation.fetch_add(1, Ordering::AcqRel) + 1;
        self.act.store(act, Ordering::Release);
        activation
    }

    pub fn mode(&self) -> RobotMode {
        self.simulated.snapshot().unwrap().state.mode()
    }

    pub fn try_ask(&self, key: &str) -> Answer {
        self.bus.ask(key, &Request::default(), PATIENCE).unwrap()
    }

    pub fn ask(&self, key: &str) -> String {
        let answer = self.try_ask(key);
        assert!(answer.done, "{}", answer.message);
        answer.message
    }

    /// Asserts that no change of the sent torques exceeded the robot's limit.
    pub fn no_step(&self) {
        let step = self.simulated.snapshot().unwrap().torque_step_max_nm;
        assert!(step <= 0.9 + 1e-9, "a step of {step} Nm");
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(bridge) = self.bridge.take() {
            let ended = bridge.join();
            assert!(std::thread::panicking() || ended.unwrap().is_ok());
        }
    }
}

pub fn start_bridge(
    config: &Config,
    bus: &Bus,
    stop: &Stop,
) -> JoinHandle<Result<(), tangent_franka::Error>> {
    let (config, bus, stop) = (config.clone(), bus.clone(), stop.clone());
    std::thread::spawn(move || tangent_franka::run(config, bus, stop))
}

/// Slowly turns the first joint to 0.2 rad and back without end, or does what a test selects.
pub fn controller(bus: &Bus, act: &Arc<AtomicU8>, activation: &Arc<AtomicU64>) -> Handle {
    let commands = bus.publisher(&topics::ARM_COMMAND).unwrap();
    let (act, activation) = (Arc::clone(act), Arc::clone(activation));
    // Start of the present task: its activation, time and position.
    let start: Mutex<Option<(u64, f64, Vec<f64>)>> = Mutex::new(None);
    bus.on(&topics::ARM_STATE, move |received| {
        let state = &received.message;
        let activation = activation.load(Ordering::Acquire);
        let act = act.load(Ordering::Acquire);
        if act == SILENT {
            return;
        }
        let mut start = start.lock().unwrap();
        if start.as_ref().is_none_or(|(of, ..)| *of != activation) {
            *start = Some((activation, state.robot_time_s, state.q.to_vec()));
        }
        let (_, since_s, q_start) = start.as_ref().unwrap();
        let time_s = state.robot_time_s - since_s;
        let mut torque: Vec<f64> = (0..7)
            .map(|i| {
                let swing = if i == 0 {
                    0.1 * (1.0 - (1.5 * time_s).cos())
                } else {
                    0.0
                };
                STIFFNESS[i] * (q_start[i] + swing - state.q[i]) - DAMPING[i] * state.qd[i]
            })
            .collect();
        match act {
            NAN => torque[3] = f64::NAN,
            STEPS => torque[0] = if state.cycle % 80 < 40 { 8.0 } else { -8.0 },
            _ => {}
        }
        commands.publish(&ArmCommand {
            cycle: state.cycle,
            kind: if act == STILL { 0 } else { 2 },
            values: torque.into_iter().collect(),
            activation,
            source: "test/0".try_into().unwrap(),
            ..ArmCommand::default()
        });
    })
    .unwrap()
}
