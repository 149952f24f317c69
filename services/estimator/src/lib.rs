//! The estimator service: subscribes to the arm's state, the wrench and the camera's features,
//! steps one or more estimators of the surface's normal or of an object's pose, and publishes each
//! on topics of its own.
//!
//! Runs in a separate thread, in any process and on any host; the control loop's thread only puts a
//! message into a queue. The newest state is used; skipped ones are counted.

mod config;
mod depth;
mod depth_start;
mod depth_watch;
mod error;
mod host;
mod message;
mod objects;
mod sample;

use std::time::{Duration, Instant};

use tangent_control::Phase;
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_estimation::estimator_names;
use tangent_estimation::object_pose::OBJECT_ESTIMATORS;
use tangent_runtime::config::WrenchSource;
use tangent_runtime::{
    Age, BaseReader, Beat, Bus, Counter, Gauge, HealthReporter, Histogram, Latest, Parameter,
    Parameters, Rate, RealtimeReport, Stop, Subscription, realtime,
};
use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, ControlState, WrenchStatus};
use tangent_schemas::topics;
use tangent_sensing::{BaseTrouble, Validity};

pub use config::{
    ALL, Config, DepthChoice, DepthPlan, DepthSettings, EstimatorChoice, ObjectChoice, ToolInView,
};
use depth_watch::{DepthTrouble, DepthWatch};
pub use error::EstimatorError;
use host::Host;
use objects::Objects;
use sample::{CommandedTwist, NewestWrench, SampleBuilder, commanded_twist};

/// Name in topics and health messages.
pub const SERVICE: &str = "estimator";
/// Interval between two checks for a stop while no arm state arrives.
const LOOK: Duration = Duration::from_millis(50);
/// Silence of the arm's state after which it is reported, s.
const ARM_PATIENCE_S: f64 = 0.5;

/// Runs until `stop`. Blocks.
///
/// # Errors
/// An estimator or setting is unknown, the arm model is not supported, or the bus refuses a topic.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), EstimatorError> {
    let mut service = Service::new(&config, &bus)?;
    if let Some(plan) = &config.depth {
        let place = config.flange_from_tool;
        let depth = depth_start::start(plan, place, &bus, &stop, &service.health)?;
        service.depth = Some(depth);
    }
    service.health.realtime(&match config.realtime_priority {
        Some(priority) => realtime::setup_thread(SERVICE, priority),
        None => RealtimeReport::not_asked(SERVICE),
    });
    let beat = Beat::new(SERVICE);
    while !stop.is_stopped() {
        beat.beat();
        service.turn(LOOK);
    }
    drop(beat);
    match service.depth.take() {
        Some(depth) => depth.join(),
        None => Ok(()),
    }
}

struct Service {
    arm: Subscription<ArmState>,
    wrench: Latest<WrenchStamped>,
    status: Latest<WrenchStatus>,
    control: Latest<ControlState>,
    base: BaseReader,
    activation: u64,
    commanded: CommandedTwist,
    wrench_source: WrenchSource,
    builder: SampleBuilder,
    host: Host,
    objects: Option<Objects>,
    depth: Option<DepthWatch>,
    wrench_patience: Parameter,
    meters: Meters,
    trouble: Trouble,
    said: Option<(Trouble, Option<DepthTrouble>)>,
    health: HealthReporter,
    _parameters: Parameters,
}

struct Meters {
    cycles: Rate,
    skipped: Gauge,
    arm_age: Age,
    wrench_age: Age,
    update: Histogram,
    lost: Counter,
}

/// Why there is no estimate, or no valid one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    None,
    NoArm,
    BadArm,
    Wrench(Validity),
    Base(BaseTrouble),
    NoCamera,
}

impl Service {
    fn new(config: &Config, bus: &Bus) -> Result<Self, EstimatorError> {
        let health = HealthReporter::start(bus, SERVICE)?;
        let parameters = Parameters::new(bus, SERVICE)?;
        if config.estimators.is_empty() && config.objects.is_empty() && config.depth.is_none() {
            let names = [&estimator_names()[..], &OBJECT_ESTIMATORS, &[DEPTH_NORMAL]].concat();
            return Err(EstimatorError::NoEstimators(names.join(", ")));
        }
        let wrench_patience = parameters.number(
            "wrench_patience_s",
            config.wrench_patience_s,
            0.01..=1.0,
            "s",
            "Age at which a wrench is no longer used.",
        );
        Ok(Self {
            host: Host::new(&config.estimators, bus, &parameters)?,
            objects: Objects::new(
                &config.objects,
                config.camera.as_ref(),
                &config.flange_from_tool,
                bus,
                &health,
            )?,
            depth: None,
            commanded: commanded_twist(&config.model, config.flange_from_tool)?,
            // Holds several states, so that a thread that was pre-empted finds the newest and sees
            // how many it missed.
            arm: bus.subscribe(&topics::ARM_STATE, 8)?,
            wrench: bus.latest(&topics::WRENCH_TOOL)?,
            status: bus.latest(&topics::WRENCH_STATUS)?,
            control: bus.latest(&topics::CONTROL_STATE)?,
            base: BaseReader::new(bus, &config.base)?,
            activation: 0,
            builder: SampleBuilder::default(),
            wrench_source: config.wrench_source,
            wrench_patience,
            meters: Meters {
                cycles: health.rate("arm_state"),
                skipped: health.gauge("arm_states_skipped"),
                arm_age: health.age("arm_state"),
                wrench_age: health.age("wrench_tool"),
                update: health.histogram("update"),
                lost: health.lost(),
            },
            trouble: Trouble::None,
            said: None,
            health,
            _parameters: parameters,
        })
    }

    /// Handles one arm state: the newest one that waits, or the next to arrive.
    fn turn(&mut self, patience: Duration) {
        if let Some(trouble) = self.step(patience) {
            self.trouble = trouble;
        }
        self.say();
    }

    /// The present problem; `None` if no message arrived that would show one.
    fn step(&mut self, patience: Duration) -> Option<Trouble> {
        let Some(mut newest) = self.arm.recv_timeout(patience) else {
            let age = self.meters.arm_age.seconds();
            return (!(0.0..=ARM_PATIENCE_S).contains(&age)).then_some(Trouble::NoArm);
        };
        while let Some(newer) = self.arm.try_recv() {
            self.meters.skipped.set(self.meters.skipped.get() + 1.0);
            newest = newer;
        }
        self.meters.cycles.tick();
        self.meters.arm_age.mark_at(newest.received);
        self.meters.lost.set(self.arm.lost());
        let arm = newest.message;
        self.reset_on_new_task();

        let patience = Duration::from_secs_f64(self.wrench_patience.get());
        let built = match self.wrench_source {
            WrenchSource::Measured => {
                self.status.refresh();
                self.wrench.refresh();
                let pair = self.wrench.get().zip(self.status.get()).map(|(w, s)| {
                    self.meters.wrench_age.mark_at(w.received);
                    NewestWrench {
                        wrench: &w.message,
                        status: &s.message,
                        age: w.age(),
                    }
                });
                self.builder.build(&arm, &self.commanded, pair, patience)
            }
            WrenchSource::Law => {
                let used = self.control.get().map(|control| {
                    self.meters.wrench_age.mark_at(control.received);
                    (wrench_of_law(&control.message), control.age())
                });
                let pair = used.as_ref().map(|((wrench, status), age)| NewestWrench {
                    wrench,
                    status,
                    age: *age,
                });
                self.builder.build(&arm, &self.commanded, pair, patience)
            }
        };
        let Some(mut built) = built else {
            return Some(Trouble::BadArm);
        };
        if built.restarted {
            tracing::info!("the robot's clock restarted: all estimators are reset");
            self.reset();
        }
        built.sample.base = self.base.at(newest.received);
        let begin = Instant::now();
        self.host.step(&built.sample, &arm);
        if let Some(objects) = &mut self.objects {
            objects.step(&built.sample, &arm);
        }
        self.meters.update.record(begin.elapsed());
        let adrift = built.sample.base.and_then(|base| base.trouble);
        Some(match (built.sample.wrench_validity, adrift) {
            (Validity::Valid, None) if self.objects.as_ref().is_some_and(Objects::is_blind) => {
                Trouble::NoCamera
            }
            (Validity::Valid, None) => Trouble::None,
            (Validity::Valid, Some(why)) => Trouble::Base(why),
            (why, _) => Trouble::Wrench(why),
        })
    }

    /// A new task may be on another surface.
    fn reset_on_new_task(&mut self) {
        let Some(control) = self.control.get() else {
            return;
        };
        if control.message.activation != self.activation {
            self.activation = control.message.activation;
            self.reset();
        }
    }

    fn reset(&mut self) {
        self.host.reset();
        if let Some(objects) = &mut self.objects {
            objects.reset();
        }
    }

    /// Reports a change of the problem. That of the depth camera takes precedence, as the touch
    /// estimators report none unless the tool presses.
    fn say(&mut self) {
        let eye = self.depth.as_mut().and_then(DepthWatch::trouble);
        let now = (self.trouble, eye);
        if self.said == Some(now) {
            return;
        }
        self.said = Some(now);
        let words = self.trouble.words();
        match (eye, self.trouble) {
            (Some(DepthTrouble::Failed), _) => self.health.fault(format_args!(
                "the thread of depth_normal has ended, which is a defect; the other estimators continue"
            )),
            (None, Trouble::None) => self.health.running(),
            // Without the arm's state, other problems are not reported.
            (None, _) | (Some(_), Trouble::NoArm) => self.health.degraded(format_args!("{words}")),
            (Some(eye), Trouble::None) => self.health.degraded(format_args!("{}", eye.words())),
            (Some(eye), _) => {
                self.health.degraded(format_args!("{}; {words}", eye.words()));
            }
        }
    }
}

impl Trouble {
    fn words(self) -> Text {
        match self {
            Self::None => Text::new(),
            Self::NoArm => cut_format(format_args!(
                "no arm/state for more than {ARM_PATIENCE_S} s: is the robot bridge running?"
            )),
            Self::BadArm => cut("arm/state has no usable tool pose or robot time"),
            Self::Wrench(why) => cut_format(format_args!("wrench not usable: {}", why.reason())),
            Self::NoCamera => cut(
                "no camera/features for more than 0.5 s: is the camera service running, and its driver?",
            ),
            Self::Base(why) => cut(why.reason()),
        }
    }
}

/// The wrench as corrected by the law, with the law's own zero; `None` while it takes that zero, or
/// if no task runs.
fn wrench_of_law(control: &ControlState) -> (WrenchStamped, WrenchStatus) {
    let phase = Phase::from_code(control.phase).unwrap_or_default();
    let usable = phase.is_active() && !phase.is_before_approach() && control.force_n.is_finite();
    let wrench = WrenchStamped {
        header: control.header.clone(),
        wrench: control.wrench.clone(),
    };
    let status = WrenchStatus {
        header: control.header.clone(),
        validity: if usable {
            Validity::Valid
        } else {
            Validity::Missing
        } as u8,
        ..WrenchStatus::default()
    };
    (wrench, status)
}

#[cfg(test)]
mod tests;
