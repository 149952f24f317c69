//! From what travels on the bus to what the law takes: one input per robot packet, every age judged
//! here.

use std::time::{Duration, Instant};

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use tangent_control::{ControlInput, EstimateInput, EstimatorName, MAX_ESTIMATORS, UntaredLoad};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Pose, Tool, Twist, Wrench};
use tangent_runtime::{BaseReader, Latest, Received};
use tangent_schemas::Name;
use tangent_schemas::convert::joints;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, NormalEstimate as NormalMessage, WrenchStatus};
use tangent_sensing::Validity;

use crate::age::{ContentAge, CycleAge};

/// One packet of the arm.
#[derive(Clone, Copy, Debug)]
pub struct Packet<'a> {
    /// As it came.
    pub arm: &'a Received<ArmState>,
    /// Time since the one before, s, by the robot's clock.
    pub dt_s: f64,
    /// Whether a command of the running task would move the arm now.
    pub arm_ready: bool,
}

/// One estimator's topic.
pub struct EstimateReader {
    /// As in `estimate/NAME/normal`.
    pub name: EstimatorName,
    newest: Latest<NormalMessage>,
    age: CycleAge,
    /// As read in this cycle.
    now: Option<EstimateInput>,
}

/// Age of an estimate as it is published: -1 where there is none, or where it is too old for a
/// number.
pub fn age_told(age_s: Option<f64>) -> f64 {
    age_s.filter(|age_s| age_s.is_finite()).unwrap_or(-1.0)
}

impl EstimateReader {
    /// Reads `newest`, the topic of the estimator of this name.
    pub fn new(name: EstimatorName, newest: Latest<NormalMessage>) -> Self {
        Self {
            name,
            newest,
            age: CycleAge::default(),
            now: None,
        }
    }
}

/// The wrench with its status.
pub struct WrenchReader {
    wrench: Latest<WrenchStamped>,
    status: Latest<WrenchStatus>,
    age: ContentAge,
    late_s: f64,
    /// The newest wrench whose status came with it; it grows old like any other.
    paired: Option<Paired>,
}

#[derive(Clone, Copy, Debug)]
struct Paired {
    wrench: Wrench<Tool>,
    received: Instant,
    late_s: f64,
    delay_s: f64,
}

/// The wrench as the loop sees it now.
#[derive(Clone, Copy, Debug)]
pub struct WrenchNow {
    /// Tool axes.
    pub wrench: Wrench<Tool>,
    /// Whether to use it.
    pub validity: Validity,
    /// s
    pub age_s: f64,
    /// Of its filter, s.
    pub delay_s: f64,
    /// Age of the tare, s; none without one.
    pub bias_age_s: Option<f64>,
    /// Error of the zero that its age implies, N; none where that is not known.
    pub zero_bound_n: Option<f64>,
    /// The reading before the zero is taken off; none where the service does not tell.
    pub untared: Option<UntaredLoad>,
}

impl WrenchNow {
    /// Before the first reading.
    pub fn missing() -> Self {
        Self {
            wrench: Wrench::zero(),
            validity: Validity::Missing,
            age_s: f64::INFINITY,
            delay_s: 0.0,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
        }
    }
}

impl WrenchReader {
    /// Reads from these.
    pub fn new(wrench: Latest<WrenchStamped>, status: Latest<WrenchStatus>) -> Self {
        Self {
            wrench,
            status,
            age: ContentAge::default(),
            late_s: 0.0,
            paired: None,
        }
    }

    /// While held, no other publisher of the wrench takes the place of the present one.
    pub fn hold(&self, held: bool) {
        self.wrench.hold(held);
        self.status.hold(held);
    }

    /// A wrench counts only with the status of the same stamp, published just before it: where that
    /// was lost on the way, the one before is used at its age. A status that says no counts at
    /// once.
    pub fn read(&mut self) -> WrenchNow {
        self.status.refresh();
        if let Some(new) = self.wrench.take_new() {
            let stamp = new.message.header.stamp.to_ns();
            self.late_s = self.age.take(new.publisher, stamp, new.received);
        }
        let Some((wrench, status)) = self.wrench.get().zip(self.status.get()) else {
            return WrenchNow::missing();
        };
        let validity = Validity::from(status.message.validity);
        let said = wrench.message.header.stamp.to_ns();
        let about = status.message.header.stamp.to_ns();
        let newest = Paired {
            wrench: Wrench::from(&wrench.message.wrench),
            received: wrench.received,
            late_s: self.late_s,
            delay_s: status.message.filter_delay_s.clamp(0.0, 1.0),
        };
        if about >= said || !validity.is_valid() {
            self.paired = Some(newest);
        }
        let bias_age_s = (status.message.bias_age_s >= 0.0)
            .then(|| status.message.bias_age_s + status.age().as_secs_f64());
        let used = self.paired.unwrap_or(newest);
        WrenchNow {
            wrench: used.wrench,
            age_s: used.late_s + used.received.elapsed().as_secs_f64(),
            delay_s: used.delay_s,
            validity: if self.paired.is_some() {
                validity
            } else {
                Validity::Stale
            },
            bias_age_s,
            zero_bound_n: (status.message.bias_bound_n >= 0.0)
                .then_some(status.message.bias_bound_n),
            untared: Some(untared_load(&status.message)),
        }
    }
}

/// What the reading says before any zero is taken off.
fn untared_load(status: &WrenchStatus) -> UntaredLoad {
    let force = |w: &tangent_schemas::standard::Wrench| Vector3::from(&w.force);
    let beyond = (force(&status.untared) - force(&status.reference)).norm();
    UntaredLoad {
        beyond_reference_n: (status.reference_age_s >= 0.0).then_some(beyond),
        rated_share: (status.rated_share >= 0.0).then_some(status.rated_share),
    }
}

/// All inputs but the arm's state, which calls.
pub struct Inputs {
    wrench: WrenchReader,
    base: BaseReader,
    estimates: ArrayVec<EstimateReader, MAX_READERS>,
    started: Instant,
}

/// Estimators that can be listened to; a task names at most [`MAX_ESTIMATORS`] of them.
pub const MAX_READERS: usize = 16;

impl Inputs {
    /// Reads from these.
    pub fn new(wrench: WrenchReader, base: BaseReader) -> Self {
        Self {
            wrench,
            base,
            estimates: ArrayVec::new(),
            started: Instant::now(),
        }
    }

    /// While held, no other publisher takes the place of the present one of the wrench, nor of the
    /// base's pose.
    pub fn hold(&self, held: bool) {
        self.wrench.hold(held);
        self.base.hold(held);
    }

    /// Also listens to this one; gives it back when there is no room or the name is listened to
    /// already.
    pub fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        if self.estimates.iter().any(|own| own.name == reader.name) {
            return Some(reader);
        }
        self.estimates
            .try_push(reader)
            .err()
            .map(|full| full.element())
    }

    /// One cycle's input; none when the arm's state makes no sense (another number of joints, no
    /// rotation).
    pub fn gather(&mut self, packet: &Packet<'_>, names: &[EstimatorName]) -> Option<ControlInput> {
        let arm = packet.arm;
        let state = &arm.message;
        let base_from_tool: Pose<_, _> = (&state.tool_pose).try_into().ok()?;
        for reader in &mut self.estimates {
            reader.now = read_estimate(reader, state, arm.received.elapsed());
        }
        let wrench = self.wrench.read();
        let mut input = ControlInput {
            time_s: arm
                .received
                .saturating_duration_since(self.started)
                .as_secs_f64(),
            dt_s: packet.dt_s,
            q: joints(&state.q).ok()?,
            qd: joints(&state.qd).ok()?,
            base_from_tool,
            twist: Twist::from(&state.tool_twist),
            speed_scaling: state.speed_scaling,
            arm_ready: packet.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            wrench_delay_s: wrench.delay_s,
            bias_age_s: wrench.bias_age_s,
            zero_bound_n: wrench.zero_bound_n,
            untared: wrench.untared,
            estimates: [None; MAX_ESTIMATORS],
            base: self.base.at(arm.received),
        };
        for (slot, name) in input.estimates.iter_mut().zip(names) {
            let reader = self.estimates.iter().find(|reader| reader.name == *name);
            *slot = reader.and_then(|reader| reader.now);
        }
        Some(input)
    }

    /// Every estimator that is read, with its newest estimate's age in this cycle, s; -1 without
    /// one.
    pub fn ages(&self) -> impl Iterator<Item = (EstimatorName, f64)> {
        self.estimates
            .iter()
            .map(|reader| (reader.name, age_told(reader.now.map(|now| now.age_s))))
    }
}

/// Who holds the arm's lease, when that is another publisher than `own_id`.
pub fn driven_by_another(state: &ArmState, own_id: [u8; 16]) -> Option<Name> {
    (!state.commanded_by.is_empty() && state.commander_id != own_id).then_some(state.commanded_by)
}

/// The newest of one estimator with its age, `since_packet` after the robot's newest packet `arm`
/// came; none before its first word.
pub fn read_estimate(
    reader: &mut EstimateReader,
    arm: &ArmState,
    since_packet: Duration,
) -> Option<EstimateInput> {
    let newest = reader.newest.get()?;
    let message = &newest.message;
    let said = (newest.publisher, message.header.stamp.to_ns());
    let age_s = reader
        .age
        .of(said, message.cycle, newest.age(), arm, since_packet);
    Some(EstimateInput {
        estimate: normal_estimate(message),
        age_s,
    })
}

/// What a message says.
pub fn normal_estimate(message: &NormalMessage) -> NormalEstimate {
    let shape = Matrix3::from_row_slice(&message.curvature);
    NormalEstimate {
        point: Vector3::from(&message.point),
        normal: Vector3::from(&message.normal),
        covariance: Matrix3::from_row_slice(&message.covariance),
        validity: Validity::from(message.validity),
        friction: (message.friction >= 0.0).then_some(message.friction),
        curvature: (shape != Matrix3::zeros()).then_some(shape),
    }
}
