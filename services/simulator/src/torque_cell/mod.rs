//! A simulated arm with a torque interface: `arm/state` and `arm/command` at 1 kHz in one process
//! with the controller, a force sensor behind a Net F/T box, and a camera on the wrist whose images
//! come as a driver's would.
//!
//! One thread is the arm: it publishes its state, in which the controller answers at once, lets the
//! answer through the guard of [`TorqueGate`], and moves by one period. Images are drawn in a
//! thread of their own.

mod gate;
mod images;
mod state;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_actuation::lease::Source;
use tangent_estimation::CORNERS;
use tangent_mechanics::Joints;
use tangent_runtime::clock::{DeadlineClock, now_ns};
use tangent_runtime::realtime::setup_thread;
use tangent_runtime::{
    Bus, BusError, Counter, HealthReporter, Histogram, Publisher, Rate, Stop, Subscription,
};
use tangent_schemas::standard::{Header, PoseStamped};
use tangent_schemas::tangent::{Answer, ArmCommand, ArmState, ContactTruth, Request};
use tangent_schemas::topics::{self, TRUTH_CONTACT, TRUTH_OBJECT};
use tangent_simulation::{ObjectPlant, ObjectPlantConfig, PlantError, loaded_arm};

use crate::cell::StartError;
use crate::config::Ports;
use crate::netb::{BoxSample, NetbBox, SampleFeed};
use crate::service::{FAULT_KEY, truth_message};

pub use gate::TorqueGate;
use images::{Shot, draw_images};
use state::StateMaker;

/// Exposures that may wait to be drawn.
const SHOTS: usize = 2;

/// Commands that may wait for a period, from all sources together.
const COMMANDS_MAX: usize = 64;

/// SCHED_FIFO priority of the image thread: behind everything that is in a hurry, before what the
/// machine does besides.
const IMAGE_PRIORITY: u8 = 20;

/// What the simulated cell is made of.
#[derive(Clone, Debug)]
pub struct TorqueCellConfig {
    /// Address that the sensor's box listens on.
    pub address: std::net::IpAddr,
    /// Its ports.
    pub ports: Ports,
    /// Arm, tool, object, sensor, camera.
    pub plant: ObjectPlantConfig,
    /// Corners of the target, object axes, m.
    pub corners_m: [nalgebra::Vector3<f64>; CORNERS],
    /// Seed of all randomness.
    pub seed: u64,
    /// SCHED_FIFO priority of the arm's and the box's threads; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

/// Why the service ended.
#[derive(Debug, thiserror::Error)]
pub enum TorqueCellError {
    /// The plant's configuration is wrong.
    #[error("simulator: {0}")]
    Plant(#[from] PlantError),
    /// A port cannot be had, or the box cannot start.
    #[error("simulator: {0}")]
    Start(#[from] StartError),
    /// The bus refused a topic.
    #[error("simulator: {0}")]
    Bus(#[from] BusError),
    /// No thread to be had.
    #[error("simulator: starting a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// What tests and people make go wrong.
#[derive(Default)]
struct Faults {
    /// The camera takes no images.
    camera_off: AtomicBool,
    /// The arm says nothing until this time, ns on the wall clock.
    frozen_until_ns: AtomicU64,
    /// Emergency stop.
    stopped: AtomicBool,
}

/// Runs the cell until it is stopped.
///
/// # Errors
/// The configuration is wrong, a port is taken, or the bus refuses.
pub fn run_torque_cell(
    config: &TorqueCellConfig,
    bus: &Bus,
    stop: &Stop,
) -> Result<(), TorqueCellError> {
    let health = HealthReporter::start_only(bus, "simulator")?;
    let mut plant = ObjectPlant::new(&config.plant, config.corners_m, config.seed)?;
    let imager = plant.hand_over_camera();
    let sensor_box = NetbBox::for_sensor(
        config.address,
        config.ports,
        &config.plant.sensor,
        config.realtime_priority,
    )?;
    let faults = Arc::new(Faults::default());
    let (shots, to_draw) = sync_channel::<Shot>(SHOTS);
    let images = bus.publisher(&topics::SIMULATED_IMAGE)?;
    let hurried = config.realtime_priority.is_some();
    let painter = std::thread::Builder::new()
        .name("simulator-image".into())
        .spawn(move || {
            if hurried {
                setup_thread("simulated camera", IMAGE_PRIORITY);
            }
            draw_images(imager, &to_draw, &images);
        })?;
    // What a person would know of the arm: its model with the tool as written down.
    let model = loaded_arm::<6>(&config.plant.robot, &config.plant.tool, false)?;
    let arm = plant.arm();
    let mut cell = TorqueCell {
        gate: TorqueGate::new(model, &arm.q, plant.period_s()),
        state: StateMaker::new(model, plant.flange_from_tool(), plant.period_s()),
        publisher: bus.publisher(&topics::ARM_STATE)?,
        commands: bus.subscribe(&topics::ARM_COMMAND, COMMANDS_MAX)?,
        truth: bus.publisher(&TRUTH_CONTACT)?,
        truth_object: bus.publisher(&TRUTH_OBJECT)?,
        feed: sensor_box.feed(),
        samples: Vec::with_capacity(64),
        shots: Some(shots),
        faults: Arc::clone(&faults),
        meters: Meters::new(&health),
        plant,
        began: Instant::now(),
        cycle: 0,
        answer_s: 0.0,
    };
    let told = Arc::clone(&faults);
    let _answering = bus.answer(FAULT_KEY, move |_, request: Request| {
        provoke(&told, &request)
    })?;
    let (own, priority) = (stop.clone(), config.realtime_priority);
    let thread: JoinHandle<()> = std::thread::Builder::new()
        .name("simulator-arm".into())
        .spawn(move || {
            if let Some(priority) = priority {
                setup_thread("simulator", priority);
            }
            cell.run(&own);
        })?;
    tracing::info!(target: "simulator", "arm on the bus, sensor at {}", sensor_box.rdt_address());
    health.running();
    if thread.join().is_err() {
        tracing::error!(target: "simulator", "the arm's thread failed");
    }
    if painter.join().is_err() {
        tracing::error!(target: "simulator", "the image thread failed");
    }
    Ok(())
}

fn provoke(faults: &Faults, request: &Request) -> Answer {
    let switch = match request.argument.trim() {
        "" | "on" => Some(true),
        "off" => Some(false),
        _ => None,
    };
    let seconds = request.argument.trim().parse::<f64>().ok();
    let done = |message: String| Answer {
        done: true,
        message,
        ..Answer::default()
    };
    match (request.action.as_str(), switch, seconds) {
        ("camera", Some(on), _) => {
            faults.camera_off.store(!on, Ordering::Release);
            done(format!("camera on: {on}"))
        }
        ("emergency_stop", Some(pressed), _) => {
            faults.stopped.store(pressed, Ordering::Release);
            done(format!("emergency stop pressed: {pressed}"))
        }
        ("freeze", _, Some(s)) if (0.0..=3600.0).contains(&s) => {
            let until = now_ns() + (s * 1e9) as i64;
            faults
                .frozen_until_ns
                .store(until.unsigned_abs(), Ordering::Release);
            done(format!("no arm/state for {s} s"))
        }
        (name, ..) => Answer {
            done: false,
            message: format!(
                "\"{name}\" with {:?} is no fault of this cell; there are: camera on|off, emergency_stop on|off, freeze SECONDS (0 to 3600)",
                request.argument
            ),
            ..Answer::default()
        },
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

/// The arm's own thread.
struct TorqueCell {
    plant: ObjectPlant,
    gate: TorqueGate,
    state: StateMaker,
    publisher: Publisher<ArmState>,
    commands: Subscription<ArmCommand>,
    truth: Publisher<ContactTruth>,
    truth_object: Publisher<PoseStamped>,
    feed: SampleFeed,
    samples: Vec<BoxSample>,
    shots: Option<SyncSender<Shot>>,
    faults: Arc<Faults>,
    meters: Meters,
    began: Instant,
    cycle: u64,
    /// From the state's departure to the answer in the last cycle, s.
    answer_s: f64,
}

impl TorqueCell {
    fn run(&mut self, stop: &Stop) {
        let period = Duration::from_secs_f64(self.plant.period_s());
        let mut clock = DeadlineClock::new(period);
        while !stop.is_stopped() {
            self.meters.missed.add(clock.wait());
            self.meters.cycles.tick();
            self.turn();
        }
        // The painter ends with the last shot.
        self.shots = None;
    }

    /// One period: say the state, take the answer, move.
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
            let state = self.state.of(
                &arm,
                self.cycle,
                stamp_ns,
                &self.gate,
                stopped,
                self.answer_s,
            );
            // The controller of this process answers before this returns.
            self.publisher.publish(&state);
        }
        let now_s = self.began.elapsed().as_secs_f64();
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
            if self.gate.admit(&source, received.message.activation, now_s) {
                newest = Some(received.message);
            }
        }
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
        self.feed.play(start, before, records, &mut self.samples);
        if let Some(exposure) = self.plant.take_exposure()
            && !self.faults.camera_off.load(Ordering::Acquire)
            && let Some(shots) = &self.shots
        {
            // The exposure belongs to the end of this period. A painter that is behind leaves one
            // out, as a camera does.
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
