//! The running arm: its threads, and one period of it.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_actuation::CommandAccount;
use tangent_mechanics::Joints;
use tangent_runtime::arm_commands::{COMMANDS_MAX, newest_command};
use tangent_runtime::clock::{DeadlineClock, now_ns};
use tangent_runtime::realtime::setup_thread;
use tangent_runtime::{
    Bus, BusError, Counter, Handle, HealthReporter, Histogram, Publisher, Rate, Stop, Subscription,
};
use tangent_schemas::standard::{Header, PoseStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState, ContactTruth, Request};
use tangent_schemas::topics::{self, TRUTH_CONTACT, TRUTH_OBJECT};
use tangent_simulated_device::{FAULT_KEY, RecordListener, truth_message};
use tangent_simulation::{ObjectPlant, ObjectPlantConfig, PlantError, stated_arm};

use crate::fault::Faults;
use crate::gate::TorqueGate;
use crate::images::{Shot, draw_images};
use crate::state::StateMaker;

/// Largest number of exposures that wait to be rendered.
const SHOTS: usize = 2;

/// SCHED_FIFO priority of the image thread: below all time-critical threads, above ordinary load.
const IMAGE_PRIORITY: u8 = 20;

/// Reasons why the arm cannot start.
#[derive(Debug, thiserror::Error)]
pub enum TorqueArmError {
    /// The model of the arm or of its tool is not valid.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The bus refused a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A thread could not be started.
    #[error("starting a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// A running arm. It stops when its [`Stop`] is triggered.
pub struct SimulatedTorqueArm {
    arm: JoinHandle<()>,
    painter: JoinHandle<()>,
    _answering: Handle,
}

impl SimulatedTorqueArm {
    /// Starts the threads of arm and camera around `plant`, which was made from `config`. `records`
    /// gets the records of the force sensor, once per period. `realtime_priority` is the SCHED_FIFO
    /// priority of the arm's thread; `None` for normal scheduling.
    ///
    /// # Errors
    /// The arm's model is wrong, or the bus refuses a topic.
    pub fn start(
        config: &ObjectPlantConfig,
        mut plant: ObjectPlant,
        realtime_priority: Option<u8>,
        records: RecordListener,
        (bus, health, stop): (&Bus, &HealthReporter, &Stop),
    ) -> Result<Self, TorqueArmError> {
        let imager = plant.hand_over_camera();
        let faults = Arc::new(Faults::default());
        let (shots, to_draw) = sync_channel::<Shot>(SHOTS);
        let images = bus.publisher(&topics::SIMULATED_IMAGE)?;
        let hurried = realtime_priority.is_some();
        let painter = std::thread::Builder::new()
            .name("simulator-image".into())
            .spawn(move || {
                if hurried {
                    setup_thread("simulated camera", IMAGE_PRIORITY);
                }
                draw_images(imager, &to_draw, &images);
            })?;
        // The nominal model of the arm, with the tool as configured.
        let model = stated_arm::<6>(&config.robot, &config.tool)?;
        let start = plant.arm();
        let mut cell = ArmThread {
            gate: TorqueGate::new(model, &start.q, plant.period_s()),
            state: StateMaker::new(model, plant.flange_from_tool(), plant.period_s()),
            account: CommandAccount::default(),
            publisher: bus.publisher(&topics::ARM_STATE)?,
            commands: bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?,
            truth: bus.publisher(&TRUTH_CONTACT)?,
            truth_object: bus.publisher(&TRUTH_OBJECT)?,
            records,
            shots: Some(shots),
            faults: Arc::clone(&faults),
            meters: Meters::new(health),
            plant,
            began: Instant::now(),
            cycle: 0,
            answer_s: 0.0,
        };
        let told = Arc::clone(&faults);
        let answering = bus.answer(FAULT_KEY, move |_, request: Request| told.answer(&request))?;
        let own = stop.clone();
        let arm = std::thread::Builder::new()
            .name("simulator-arm".into())
            .spawn(move || {
                if let Some(priority) = realtime_priority {
                    setup_thread("simulator", priority);
                }
                cell.run(&own);
            })?;
        Ok(Self {
            arm,
            painter,
            _answering: answering,
        })
    }

    /// Waits until the arm has ended.
    pub fn join(self) {
        if self.arm.join().is_err() {
            tracing::error!(target: "simulator", "the arm's thread failed");
        }
        if self.painter.join().is_err() {
            tracing::error!(target: "simulator", "the image thread failed");
        }
    }
}

struct Meters {
    cycles: Rate,
    missed: Counter,
    answer: Histogram,
}

impl Meters {
    fn new(health: &HealthReporter) -> Self {
        Self {
            cycles: health.rate("cycles"),
            missed: health.missed_cycles(),
            answer: health.histogram("packet_to_command"),
        }
    }
}

/// State of the arm's thread.
struct ArmThread {
    plant: ObjectPlant,
    gate: TorqueGate,
    state: StateMaker,
    account: CommandAccount,
    publisher: Publisher<ArmState>,
    commands: Subscription<ArmCommand>,
    truth: Publisher<ContactTruth>,
    truth_object: Publisher<PoseStamped>,
    records: RecordListener,
    shots: Option<SyncSender<Shot>>,
    faults: Arc<Faults>,
    meters: Meters,
    began: Instant,
    cycle: u64,
    /// Time from publishing the state to the answer in the last cycle, s.
    answer_s: f64,
}

impl ArmThread {
    fn run(&mut self, stop: &Stop) {
        let period = Duration::from_secs_f64(self.plant.period_s());
        let mut clock = DeadlineClock::new(period);
        while !stop.is_stopped() {
            self.meters.missed.add(clock.wait());
            self.meters.cycles.tick();
            self.turn();
        }
        // The image thread ends when its queue is closed.
        self.shots = None;
    }

    /// Runs one period: publishes the state, takes the answer, moves.
    fn turn(&mut self) {
        let start = Instant::now();
        let stamp_ns = now_ns();
        self.cycle += 1;
        let arm = self.plant.arm();
        if self.faults.stopped.load(Ordering::Acquire) {
            self.gate.forbid();
        }
        let frozen = stamp_ns.unsigned_abs() < self.faults.frozen_until_ns.load(Ordering::Acquire);
        if !frozen {
            let stopped = self.faults.stopped.load(Ordering::Acquire);
            let mut state = self
                .state
                .of(&arm, self.cycle, stamp_ns, stopped, self.answer_s);
            self.account.fill(
                &mut state,
                self.gate.admission(),
                self.gate.lease(),
                self.began.elapsed().as_secs_f64(),
            );
            // A controller in this process answers before this call returns.
            self.publisher.publish(&state);
        }
        let now_s = self.began.elapsed().as_secs_f64();
        let gate = &mut self.gate;
        let newest = newest_command(&self.commands, |source, activation| {
            gate.admit(source, activation, now_s)
        });
        let answered = newest.is_some();
        let torque: Joints<6> = self.gate.step(newest.as_ref(), self.cycle, &arm.q, &arm.qd);
        if answered {
            let took = start.elapsed();
            self.answer_s = took.as_secs_f64();
            self.meters.answer.record(took);
        }
        let before = self.plant.time_s();
        self.plant.step(&torque);
        let records = self.plant.sensor_samples();
        (self.records)(start, before, records);
        if let Some(exposure) = self.plant.take_exposure()
            && !self.faults.camera_off.load(Ordering::Acquire)
            && let Some(shots) = &self.shots
        {
            // The exposure belongs to the end of this period. If the image thread is behind, an
            // exposure is left out, as in a real camera.
            let stamp_ns = stamp_ns + (self.plant.period_s() * 1e9) as i64;
            let _ = shots.try_send(Shot { exposure, stamp_ns });
        }
        self.truth.publish(&truth_message(&self.plant.truth()));
        self.truth_object.publish(&PoseStamped {
            header: Header::new(stamp_ns, "base"),
            pose: (&self.plant.base_from_object()).into(),
        });
    }
}
