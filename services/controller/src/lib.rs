//! The controller service: one step of the law per robot packet.
//!
//! It listens to `arm/state` in the publisher's thread, so that beside the bridge the whole cycle,
//! packet to command, is one call. The wrench and the estimates are read as they are then, each
//! with its age. It says `arm/command` and `control/state` every cycle; it answers `control/task`,
//! `control/stop` and `control/select`; a side thread asks for the tare, writes the log and draws
//! for the viewers. At its own end it retracts first.

mod age;
mod config;
mod cycle;
mod error;
mod inputs;
mod mailbox;
mod memory;
mod messages;
mod normals;
mod offline;
mod pinned;
mod requests;
mod runner;
mod start_check;
mod torque;
mod velocity;
mod viewer;
mod watch;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tangent_control::{Controller, EstimatorName, Parameter, Phase};
use tangent_runtime::{BaseReader, Beat, Bus, HealthReporter, Parameters, Stop};
use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::{self, queries};
use tangent_sensing::TareGround;

pub use config::Config;
pub use error::ControllerError;
pub use offline::refusals;
pub use start_check::{known_estimators, unknown_estimators};

pub use torque::{TorqueConfig, run_torque};

use cycle::{Cycle, Outlets};
use inputs::{EstimateReader, Inputs, WrenchReader};
use mailbox::{Action, Mailbox, Note, Time};
use memory::Memory;
use normals::Normals;
use requests::{Kind, RequestHandler};
use runner::Runner;
use velocity::{Live, VelocityRunner};
use viewer::Viewer;

/// Name in topics and health messages.
pub const SERVICE: &str = "controller";
/// Period of the side thread.
const SIDE: Duration = Duration::from_millis(50);
/// How long the end waits for the arm to retract.
const RETRACT_PATIENCE: Duration = Duration::from_secs(12);
/// Silence of the arm's state after which nothing is waited for.
const SILENCE: Duration = Duration::from_millis(500);
/// Between two attempts to tare.
const TARE_AGAIN: Duration = Duration::from_millis(200);
/// How long a tare may take.
const TARE_PATIENCE: Duration = Duration::from_secs(5);

/// Runs until `stop`; a running task is then ended with a retraction. Blocks.
///
/// # Errors
/// [`ControllerError`]: only what prevents it from starting.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), ControllerError> {
    let health = Arc::new(HealthReporter::start_only(&bus, SERVICE)?);
    let parameters = Parameters::new(&bus, SERVICE)?;
    let mailbox = Arc::new(Mailbox::default());
    let mut inputs = Inputs::new(
        WrenchReader::new(
            bus.latest(&topics::WRENCH_TOOL)?,
            bus.latest(&topics::WRENCH_STATUS)?,
        ),
        BaseReader::new(&bus, &config.base)?,
    );
    for name in &config.estimators {
        if let Ok(short) = EstimatorName::from(name) {
            let newest = bus.latest(&topics::estimate_normal(name))?;
            inputs.listen(EstimateReader::new(short, newest));
        }
    }
    let command = bus.publisher(&topics::ARM_COMMAND)?;
    let own_id = command.mark();
    let normals = Normals::new(&bus, &config)?;
    let memory = Arc::new(Memory::open(config.state.clone()));
    let handler = RequestHandler::new(&bus, &mailbox, normals, own_id, &memory)?;
    let mut controller = Controller::new(
        config.arm,
        config.flange_from_tool,
        config.limits,
        config.control,
    )?;
    controller.set_clearance(memory.known())?;
    let runner = VelocityRunner {
        controller,
        inputs,
        live: Live::new(live_parameters(&parameters, &config)),
    };
    let outlets = Outlets {
        command,
        state: bus.publisher(&topics::CONTROL_STATE)?,
        shaping: None,
        source: cut_format(format_args!("{SERVICE}/{}", health.instance())),
    };
    let cycle = Cycle::new(runner, outlets, &mailbox, &health);
    serve(&bus, cycle, handler, &mailbox, &memory, &health, &stop)
}

/// Runs the loop in each packet of the arm and answers requests until `stop`.
fn serve<R: Runner + 'static, K: Kind<Program = R::Program>>(
    bus: &Bus,
    mut cycle: Cycle<R>,
    handler: Arc<RequestHandler<K>>,
    mailbox: &Mailbox<R::Program>,
    memory: &Memory,
    health: &HealthReporter,
    stop: &Stop,
) -> Result<(), ControllerError> {
    health.running();
    // It is not called while the arm is silent; a cycle that has begun has to end.
    let beat = Beat::new(SERVICE);
    beat.rest();
    let _loop = bus.on(&topics::ARM_STATE, move |arm| {
        beat.beat();
        cycle.step(arm);
        beat.rest();
    })?;
    let _answers = handler.open()?;
    beside(bus, mailbox, memory, stop)
}

/// What goes on beside the loop until `stop`, and then until the arm has left the surface.
fn beside<P: Send>(
    bus: &Bus,
    mailbox: &Mailbox<P>,
    memory: &Memory,
    stop: &Stop,
) -> Result<(), ControllerError> {
    let mut viewer = Viewer::new(bus)?;
    std::thread::scope(|scope| -> Result<(), ControllerError> {
        let taring = std::thread::Builder::new()
            .name("controller-tare".into())
            .spawn_scoped(scope, || tare_when_due(bus, mailbox, stop))?;
        // Its own thread: a write waits for the disk.
        let keeping = std::thread::Builder::new()
            .name("controller-memory".into())
            .spawn_scoped(scope, || memory.follow(mailbox, stop))?;
        while !stop.wait(SIDE) {
            write_notes(mailbox);
            viewer.draw();
        }
        retract_first(mailbox, &mut viewer);
        let kept = keeping.join();
        // How that retraction ended.
        memory.take(mailbox);
        kept.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        taring
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(())
    })
}

fn live_parameters(parameters: &Parameters, config: &Config) -> [tangent_runtime::Parameter; 4] {
    Parameter::ALL.map(|parameter| {
        let (unit, words, default) = match parameter {
            Parameter::ForceReference => ("N", "Pressing force of the running task.", 3.0),
            Parameter::Speed => ("m/s", "Speed along the path of the running task.", 0.02),
            Parameter::AlignmentGain => (
                "1/s",
                "Gain k_R that turns the tool square to the surface.",
                config.control.alignment.gain_per_s,
            ),
            Parameter::Damping => (
                "Ns/m",
                "Damping d_p along the normal; the least one where it follows the stiffness.",
                config.control.force.damping_n_s_per_m,
            ),
        };
        let (lower, upper) = parameter.range_within(&config.limits);
        parameters.number(parameter.name(), default, lower..=upper, unit, words)
    })
}

/// The tare is asked for outside the loop; the loop sees its effect in the wrench's status.
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
        // Asked again until it is done, or the phase that waits for it is over.
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

/// The zero in force turned out to be taken in contact: it must not be used.
fn withdraw_zero(bus: &Bus) {
    let request = Request {
        action: "withdraw".into(),
        argument: String::new(),
    };
    match bus.ask(queries::NETFT_TARE, &request, TARE_PATIENCE) {
        Ok(answer) => tracing::warn!("{}", answer.message),
        Err(error) => tracing::warn!("the zero that was taken in contact stands: {error}"),
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

/// Leaves the surface before the service goes; gives up when the robot is silent.
fn retract_first<P>(mailbox: &Mailbox<P>, viewer: &mut Viewer) {
    mailbox.close();
    if !mailbox.phase().is_active() {
        return;
    }
    if mailbox.ask(Action::Stop, Time::now()).is_err() {
        tracing::warn!("the robot is silent: ending without a retraction");
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
            tracing::warn!("the robot is silent: ending without a retraction");
            return;
        }
        pause.wait(SIDE);
        write_notes(mailbox);
        viewer.draw();
    }
    if mailbox.phase() == Phase::Retract {
        tracing::warn!("the arm did not retract within {RETRACT_PATIENCE:?}");
    }
}
