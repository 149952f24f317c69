//! The controller service: one step of the law per robot packet.
//!
//! It processes `arm/state` in the publisher's thread: if the bridge runs in the same process, the
//! whole cycle from packet to command is one call. The wrench and the estimates are read at that
//! time, each with its age. It publishes `arm/command` and `control/state` every cycle, and answers
//! `control/task`, `control/stop` and `control/select`. A side thread requests the tare, writes the
//! log and publishes for the viewers. At its end, the service retracts the tool first.

mod config;
mod cycle;
mod error;
mod inputs;
mod lessons;
mod mailbox;
mod memory;
mod messages;
mod offline;
mod pinned;
mod replies;
mod requests;
mod runner;
mod tasks;
mod watch;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tangent_control::{Controller, EstimatorName, Law, Limits, Parameter, Phase};
use tangent_runtime::{BaseReader, Beat, Bus, HealthReporter, Parameters, Stop};
use tangent_scene::Scene;
use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::{self, queries};
use tangent_sensing::TareGround;

pub use config::Config;
pub use config::torque::TorqueConfig;
pub use error::ControllerError;
pub use offline::refusals;
pub use tasks::start_check::{known_estimators, unknown_estimators};

use config::torque::{TorqueCell, TorqueCells};
use cycle::{Cycle, Outlets};
use inputs::{ArmForceReader, EstimateReader, Inputs, WrenchReader};
use mailbox::{Action, Mailbox, Note, Time};
use memory::Memory;
use requests::{Kind, RequestHandler};
use runner::{Live, Prepared, Runner};
use tasks::hybrid_admittance::Normals;
use tasks::torque::{ServedLaw, TorqueTasks};

/// Name in topics and health messages.
pub const SERVICE: &str = "controller";
/// Period of the side thread.
const SIDE: Duration = Duration::from_millis(50);
/// Timeout of the retraction at the service's end.
const RETRACT_PATIENCE: Duration = Duration::from_secs(12);
/// Age of the arm's state after which the service does not wait for it.
const SILENCE: Duration = Duration::from_millis(500);
/// Interval between two attempts to tare.
const TARE_AGAIN: Duration = Duration::from_millis(200);
/// Timeout of a tare.
const TARE_PATIENCE: Duration = Duration::from_secs(5);

/// Runs the hybrid admittance until `stop`; a running task is then ended with a retraction. Blocks.
///
/// # Errors
/// [`ControllerError`]: only reasons that prevent the service from starting.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), ControllerError> {
    let health = HealthReporter::start_only(&bus, SERVICE)?;
    let scene = Scene::new(&bus, &config.scene)?;
    let mut law = Controller::new(
        config.arm,
        config.flange_from_tool,
        config.limits,
        config.control,
    )?;
    let memory = Memory::open(config.state.clone());
    law.set_clearance(memory.known())?;
    let arm_force = match config.compares_arm_force {
        true => Some(ArmForceReader::new(bus.latest(&topics::ARM_WRENCH)?)),
        false => None,
    };
    let mut inputs = Inputs::new(wrench(&bus)?, Some(BaseReader::new(&bus, &config.base)?))
        .with_arm_force(arm_force);
    for name in &config.estimators {
        if let Ok(short) = EstimatorName::from(name) {
            let newest = bus.latest(&topics::estimate_normal(name))?;
            inputs.listen(EstimateReader::new(short, newest));
        }
    }
    let parameters = Parameters::new(&bus, SERVICE)?;
    let live =
        live_parameters::<_, 6>(
            &law,
            &parameters,
            &config.limits,
            |parameter| match parameter {
                Parameter::ForceReference => 3.0,
                Parameter::Speed => 0.02,
                Parameter::AlignmentGain => config.control.alignment.gain_per_s,
                Parameter::Damping => config.control.force.damping_n_s_per_m,
            },
        );
    let kind = Normals::new(&bus, &config, memory.lessons())?;
    let runner = Runner { law, inputs, live };
    let side = Side { scene, memory };
    serve(&bus, health, runner, kind, side, &stop)
}

/// Runs a torque law until `stop`; a running task is then ended with a retraction. Blocks.
///
/// # Errors
/// [`ControllerError`]: only reasons that prevent the service from starting.
pub fn run_torque(config: TorqueConfig, bus: Bus, stop: Stop) -> Result<(), ControllerError> {
    let health = HealthReporter::start_only(&bus, SERVICE)?;
    match config {
        TorqueConfig::HybridDynamics(TorqueCells::Six(cell)) => torques(bus, health, *cell, &stop),
        TorqueConfig::HybridDynamics(TorqueCells::Seven(cell)) => {
            torques(bus, health, *cell, &stop)
        }
        TorqueConfig::UnifiedForceImpedance(TorqueCells::Six(cell)) => {
            torques(bus, health, *cell, &stop)
        }
        TorqueConfig::UnifiedForceImpedance(TorqueCells::Seven(cell)) => {
            torques(bus, health, *cell, &stop)
        }
    }
}

/// Runs the torque law of a cell until `stop`.
fn torques<C: ServedLaw, const N: usize>(
    bus: Bus,
    health: HealthReporter,
    cell: TorqueCell<C, N>,
    stop: &Stop,
) -> Result<(), ControllerError> {
    let memory = Memory::open(cell.state.clone());
    let scene = Scene::new(&bus, &cell.scene)?;
    let law = C::law(&cell, memory.known())?;
    let parameters = Parameters::new(&bus, SERVICE)?;
    let limits = cell.limits;
    let least = |parameter: Parameter| parameter.range_within(&limits).0;
    let runner = Runner {
        live: live_parameters(&law, &parameters, &limits, least),
        inputs: Inputs::new(wrench(&bus)?, None),
        law,
    };
    let kind = TorqueTasks::new(&bus, cell)?;
    let side = Side { scene, memory };
    serve(&bus, health, runner, kind, side, stop)
}

fn wrench(bus: &Bus) -> Result<WrenchReader, ControllerError> {
    Ok(WrenchReader::new(
        bus.latest(&topics::WRENCH_TOOL)?,
        bus.latest(&topics::WRENCH_STATUS)?,
    ))
}

/// What the side thread works with.
struct Side {
    scene: Scene,
    memory: Memory,
}

/// Runs the loop in each packet of the arm and answers requests until `stop`.
fn serve<L, K, const N: usize>(
    bus: &Bus,
    health: HealthReporter,
    runner: Runner<L, N>,
    kind: K,
    side: Side,
    stop: &Stop,
) -> Result<(), ControllerError>
where
    L: Law<N> + 'static,
    K: Kind<Program = Prepared<L::Config>>,
{
    let health = Arc::new(health);
    let mailbox = Arc::new(Mailbox::default());
    let memory = Arc::new(side.memory);
    let command = bus.publisher(&topics::ARM_COMMAND)?;
    let handler = RequestHandler::new(bus, &mailbox, kind, command.mark(), &memory)?;
    let outlets = Outlets {
        command,
        state: bus.publisher(&topics::CONTROL_STATE)?,
        shaping: L::SHAPES
            .then(|| bus.publisher(&topics::CONTROL_SHAPING))
            .transpose()?,
        coverage: L::COVERS
            .then(|| bus.publisher(&topics::CONTROL_COVERAGE))
            .transpose()?,
        source: cut_format(format_args!("{SERVICE}/{}", health.instance())),
    };
    let mut cycle = Cycle::new(runner, outlets, &mailbox, &health);
    health.running();
    // The loop is not called while the arm is silent; but a cycle that has begun must end.
    let beat = Beat::new(SERVICE);
    beat.rest();
    let _loop = bus.on(&topics::ARM_STATE, move |arm| {
        beat.beat();
        cycle.step(arm);
        beat.rest();
    })?;
    let _answers = handler.open()?;
    beside(bus, &mailbox, &memory, side.scene, stop)
}

/// Runs the side thread's work until `stop`, and then until the arm has left the surface.
fn beside<P: Send>(
    bus: &Bus,
    mailbox: &Mailbox<P>,
    memory: &Memory,
    mut scene: Scene,
    stop: &Stop,
) -> Result<(), ControllerError> {
    std::thread::scope(|scope| -> Result<(), ControllerError> {
        let taring = std::thread::Builder::new()
            .name("controller-tare".into())
            .spawn_scoped(scope, || tare_when_due(bus, mailbox, stop))?;
        // Its own thread, because a write waits for the disk.
        let keeping = std::thread::Builder::new()
            .name("controller-memory".into())
            .spawn_scoped(scope, || memory.follow(mailbox, stop))?;
        while !stop.wait(SIDE) {
            write_notes(mailbox);
            scene.draw(Instant::now());
        }
        retract_first(mailbox, &mut scene);
        let kept = keeping.join();
        // Stores how the retraction ended.
        memory.take(mailbox);
        kept.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        taring
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(())
    })
}

/// The live parameters of the law, each with its value before the first task.
fn live_parameters<L: Law<N>, const N: usize>(
    _: &L,
    parameters: &Parameters,
    limits: &Limits,
    value: impl Fn(Parameter) -> f64,
) -> Live {
    Live::new(L::PARAMETERS.iter().map(|&parameter| {
        let (unit, words) = match parameter {
            Parameter::ForceReference => ("N", "Pressing force of the running task."),
            Parameter::Speed => ("m/s", "Speed along the path of the running task."),
            Parameter::AlignmentGain => {
                ("1/s", "Gain k_R that turns the tool square to the surface.")
            }
            Parameter::Damping => (
                "Ns/m",
                "Damping d_p along the normal; the least one if it follows the stiffness.",
            ),
        };
        let (lower, upper) = parameter.range_within(limits);
        let range = lower..=upper;
        let live = parameters.number(parameter.name(), value(parameter), range, unit, words);
        (parameter, live)
    }))
}

/// Requests the tare outside the loop; the loop sees its effect in the wrench's status.
fn tare_when_due<P>(bus: &Bus, mailbox: &Mailbox<P>, stop: &Stop) {
    while !stop.wait(SIDE / 2) {
        if mailbox.withdraw_due.swap(false, Ordering::AcqRel) {
            withdraw_zero(bus);
        }
        let Some(ground) = mailbox.tare_due.pop() else {
            continue;
        };
        let request = Request {
            action: "tare".into(),
            argument: match ground {
                TareGround::SaidClear => "clear",
                TareGround::Shown => "shown",
                TareGround::Assumed => "",
            }
            .into(),
        };
        mailbox.tare_refusal("");
        // Repeated until it is done, or the phase that waits for it is over.
        let mut said = String::new();
        loop {
            let reason = match bus.ask(queries::NETFT_TARE, &request, TARE_PATIENCE) {
                Ok(answer) if answer.done => {
                    tracing::info!("{}", answer.message);
                    mailbox.tare_refusal("");
                    break;
                }
                Ok(answer) => answer.message,
                Err(error) => error.to_string(),
            };
            let reason = reason.trim_start_matches("not tared: ");
            if reason != said {
                tracing::warn!("no tare before contact: {reason}");
                said = reason.to_owned();
            }
            mailbox.tare_refusal(reason);
            if stop.wait(TARE_AGAIN) || mailbox.phase() != Phase::Tare {
                break;
            }
        }
    }
}

/// Withdraws the zero in force, which turned out to have been taken in contact.
fn withdraw_zero(bus: &Bus) {
    let request = Request {
        action: "withdraw".into(),
        argument: String::new(),
    };
    match bus.ask(queries::NETFT_TARE, &request, TARE_PATIENCE) {
        Ok(answer) => tracing::warn!("{}", answer.message),
        Err(error) => {
            tracing::warn!("the zero that was measured in contact could not be withdrawn: {error}")
        }
    }
}

fn write_notes<P>(mailbox: &Mailbox<P>) {
    while let Some(note) = mailbox.notes.pop() {
        match note {
            Note::Phase(phase, fault) if fault.is_empty() => tracing::info!("{}", phase.name()),
            Note::Phase(phase, fault) => tracing::warn!("{}: {fault}", phase.name()),
            Note::Estimator(name, cause) => tracing::info!("normal by {name}: {cause}"),
        }
    }
}

/// Leaves the surface before the service ends; gives up if the robot is silent.
fn retract_first<P>(mailbox: &Mailbox<P>, scene: &mut Scene) {
    mailbox.close();
    if !mailbox.phase().is_active() {
        return;
    }
    if mailbox.ask(Action::Stop, Time::now()).is_err() {
        tracing::warn!("no state from the robot: ending without a retraction");
        return;
    }
    let deadline = Instant::now() + RETRACT_PATIENCE;
    let mut last = (mailbox.cycles(), Instant::now());
    let pause = Stop::new();
    while mailbox.phase().is_active() && Instant::now() < deadline {
        let cycles = mailbox.cycles();
        if cycles != last.0 {
            last = (cycles, Instant::now());
        } else if last.1.elapsed() > SILENCE {
            tracing::warn!("no state from the robot: ending without a retraction");
            return;
        }
        pause.wait(SIDE);
        write_notes(mailbox);
        scene.draw(Instant::now());
    }
    if mailbox.phase() == Phase::Retract {
        tracing::warn!(
            "the arm did not retract within {} s",
            RETRACT_PATIENCE.as_secs()
        );
    }
}
