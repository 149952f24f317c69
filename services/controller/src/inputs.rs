//! From what travels on the bus to what the law takes: one input per robot packet, every age judged here.

use std::time::Instant;

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use tangent_control::{ControlInput, EstimateInput, EstimatorName, MAX_ESTIMATORS};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Pose, Tool, Twist, Wrench};
use tangent_runtime::{BaseReader, Latest, Received};
use tangent_schemas::Name;
use tangent_schemas::convert::joints;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, NormalEstimate as NormalMessage, WrenchStatus};
use tangent_sensing::Validity;

use crate::age::{ContentAge, CycleAge};

/// One estimator's topic.
pub struct EstimateReader {
    /// As in `estimate/NAME/normal`.
    pub name: EstimatorName,
    newest: Latest<NormalMessage>,
    age: CycleAge,
}

impl EstimateReader {
    /// Reads `newest`, the topic of the estimator of this name.
    pub fn new(name: EstimatorName, newest: Latest<NormalMessage>) -> Self {
        Self {
            name,
            newest,
            age: CycleAge::default(),
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

    /// A wrench counts only with the status of the same stamp, published just before it: where that was lost on the way, the one
    /// before is used at its age. A status that says no counts at once.
    pub fn read(&mut self) -> WrenchNow {
        self.status.refresh();
        if let Some(new) = self.wrench.take_new() {
            let stamp = new.message.header.stamp.to_ns();
            self.late_s = self.age.take(new.publisher, stamp, new.received);
        }
        let Some((wrench, status)) = self.wrench.get().zip(self.status.get()) else {
            return WrenchNow {
                wrench: Wrench::zero(),
                validity: Validity::Missing,
                age_s: f64::INFINITY,
                delay_s: 0.0,
                bias_age_s: None,
            };
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
        }
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

    /// Also listens to this one; gives it back when there is no room or the name is listened to already.
    pub fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        if self.estimates.iter().any(|own| own.name == reader.name) {
            return Some(reader);
        }
        self.estimates
            .try_push(reader)
            .err()
            .map(|full| full.element())
    }

    /// One cycle's input; none when the arm's state makes no sense (another number of joints, no rotation).
    pub fn gather(
        &mut self,
        arm: &Received<ArmState>,
        names: &[EstimatorName],
        own_id: [u8; 16],
    ) -> Option<ControlInput> {
        let state = &arm.message;
        let base_from_tool: Pose<_, _> = (&state.tool_pose).try_into().ok()?;
        let wrench = self.wrench.read();
        let mut input = ControlInput {
            time_s: arm
                .received
                .saturating_duration_since(self.started)
                .as_secs_f64(),
            dt_s: state.period_s,
            q: joints(&state.q).ok()?,
            qd: joints(&state.qd).ok()?,
            base_from_tool,
            twist: Twist::from(&state.tool_twist),
            speed_scaling: state.speed_scaling,
            // Another controller's arm is not there for this one.
            arm_ready: state.ready && driven_by_another(state, own_id).is_none(),
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            wrench_delay_s: wrench.delay_s,
            bias_age_s: wrench.bias_age_s,
            estimates: [None; MAX_ESTIMATORS],
            base: self.base.at(arm.received),
        };
        for (slot, name) in input.estimates.iter_mut().zip(names) {
            let reader = self
                .estimates
                .iter_mut()
                .find(|reader| reader.name == *name);
            *slot = reader.and_then(|reader| read_estimate(reader, state));
        }
        Some(input)
    }
}

/// Who holds the arm's lease, when that is another publisher than `own_id`.
pub fn driven_by_another(state: &ArmState, own_id: [u8; 16]) -> Option<Name> {
    (!state.commanded_by.is_empty() && state.commander_id != own_id).then_some(state.commanded_by)
}

/// The newest of one estimator with its age; none before its first word.
pub fn read_estimate(reader: &mut EstimateReader, state: &ArmState) -> Option<EstimateInput> {
    let newest = reader.newest.get()?;
    let message = &newest.message;
    let said = (newest.publisher, message.header.stamp.to_ns());
    let age_s = reader.age.of(said, message.cycle, newest.age(), state);
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
