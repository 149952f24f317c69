//! Converts bus messages to the law's input: one input per robot packet, with the age of all its
//! data.

pub mod age;
mod arm_force;
mod normals;
mod objects;
mod vision;
mod wrench;

use std::time::Instant;

use arrayvec::ArrayVec;
use nalgebra::UnitQuaternion;
use tangent_control::{EstimatorName, LawInput, MAX_ESTIMATORS};
use tangent_mechanics::{Base, Pose, Tool, Twist};
use tangent_runtime::{BaseReader, Received};
use tangent_schemas::Name;
use tangent_schemas::convert::joints;
use tangent_schemas::tangent::ArmState;

pub use arm_force::ArmForceReader;
pub use normals::EstimateReader;
pub use objects::ObjectReader;
pub use vision::VisionReader;
pub use wrench::WrenchReader;

/// One packet of the arm.
#[derive(Clone, Copy, Debug)]
pub struct Packet<'a> {
    /// The packet as received.
    pub arm: &'a Received<ArmState>,
    /// Time since the previous packet, s, by the robot's clock.
    pub dt_s: f64,
    /// Whether a command of the running task would move the arm now.
    pub arm_ready: bool,
}

/// Age of an estimate as published, s: -1 if there is none, or if its age is not finite.
pub fn age_told(age_s: Option<f64>) -> f64 {
    age_s.filter(|age_s| age_s.is_finite()).unwrap_or(-1.0)
}

/// Readers of the estimates that a law uses.
#[derive(Default)]
pub struct Readers {
    /// Estimates of the surface's normal.
    pub normals: ArrayVec<EstimateReader, MAX_READERS>,
    /// Estimates of an object's pose.
    pub objects: ArrayVec<ObjectReader, MAX_ESTIMATORS>,
    /// Reader of the camera's estimate of the surface.
    pub vision: Option<VisionReader>,
}

/// All inputs except the arm's state, whose arrival starts the cycle.
pub struct Inputs {
    wrench: WrenchReader,
    /// `None` for an arm whose own sensor is the one in use.
    arm_force: Option<ArmForceReader>,
    /// `None` for a law that does not support a moving base.
    base: Option<BaseReader>,
    readers: Readers,
    started: Instant,
}

/// Maximum number of estimators that can be subscribed to; a task names at most [`MAX_ESTIMATORS`]
/// of them.
pub const MAX_READERS: usize = 16;

impl Inputs {
    /// Inputs from these readers.
    pub fn new(wrench: WrenchReader, base: Option<BaseReader>) -> Self {
        Self {
            wrench,
            arm_force: None,
            base,
            readers: Readers::default(),
            started: Instant::now(),
        }
    }

    /// Reads the force that the arm itself feels, too.
    pub fn with_arm_force(mut self, reader: Option<ArmForceReader>) -> Self {
        self.arm_force = reader;
        self
    }

    /// While held, no other publisher of the wrench or of the base's pose replaces the present one.
    pub fn hold(&self, held: bool) {
        self.wrench.hold(held);
        if let Some(arm_force) = &self.arm_force {
            arm_force.hold(held);
        }
        if let Some(base) = &self.base {
            base.hold(held);
        }
    }

    /// Takes the readers of a new task, and returns those of the previous task.
    pub fn swap(&mut self, readers: &mut Readers) {
        std::mem::swap(&mut self.readers, readers);
    }

    /// Adds this reader; returns it if there is no room or the name is already read.
    pub fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        let normals = &mut self.readers.normals;
        if normals.iter().any(|own| own.name == reader.name) {
            return Some(reader);
        }
        normals.try_push(reader).err().map(|full| full.element())
    }

    /// The input of one cycle, with the estimates in the order of `names`; `None` if the arm's
    /// state is not usable (another number of joints, or no valid tool pose where the law needs
    /// it).
    pub fn gather<const N: usize>(
        &mut self,
        packet: &Packet<'_>,
        names: &[EstimatorName],
    ) -> Option<LawInput<N>> {
        let arm = packet.arm;
        let state = &arm.message;
        let since_packet = arm.received.elapsed();
        let base_from_tool = tool_pose(state, self.base.is_some())?;
        let readers = &mut self.readers;
        for reader in &mut readers.normals {
            reader.read(state, since_packet);
        }
        for reader in &mut readers.objects {
            reader.read(state, since_packet);
        }
        let time_s = arm
            .received
            .saturating_duration_since(self.started)
            .as_secs_f64();
        let wrench = self.wrench.read();
        let mut input = LawInput {
            time_s,
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
            arm_force: self.arm_force.as_mut().and_then(|own| own.with(state)),
            estimates: [None; MAX_ESTIMATORS],
            objects: [None; MAX_ESTIMATORS],
            vision: readers
                .vision
                .as_mut()
                .and_then(|vision| vision.look(state, time_s)),
            base: self.base.as_mut().and_then(|base| base.at(arm.received)),
        };
        for (slot, name) in input.estimates.iter_mut().zip(names) {
            let reader = readers.normals.iter().find(|reader| reader.name == *name);
            *slot = reader.and_then(EstimateReader::now);
        }
        for (slot, name) in input.objects.iter_mut().zip(names) {
            let reader = readers.objects.iter().find(|reader| reader.name == *name);
            *slot = reader.and_then(ObjectReader::now);
        }
        Some(input)
    }

    /// Every estimator that is read, with the age of its newest estimate in this cycle, s; -1
    /// without one.
    pub fn ages(&self) -> impl Iterator<Item = (EstimatorName, f64)> {
        let normals = self.readers.normals.iter();
        let normals = normals.map(|reader| (reader.name, reader.now().map(|now| now.age_s)));
        let objects = self.readers.objects.iter();
        let objects = objects.map(|reader| (reader.name, reader.now().map(|now| now.age_s)));
        normals
            .chain(objects)
            .map(|(name, age_s)| (name, age_told(age_s)))
    }
}

/// The tool's pose as the arm reports it. A torque law (without a base) computes its own, and
/// treats an invalid rotation as a missing pose.
fn tool_pose(state: &ArmState, required: bool) -> Option<Pose<Base, Tool>> {
    match Pose::try_from(&state.tool_pose) {
        Ok(pose) => Some(pose),
        Err(_) if required => None,
        Err(_) => Some(Pose::new(
            (&state.tool_pose.position).into(),
            UnitQuaternion::identity(),
        )),
    }
}

/// The holder of the arm's lease, if it is another publisher than `own_id`.
pub fn driven_by_another(state: &ArmState, own_id: [u8; 16]) -> Option<Name> {
    (!state.commanded_by.is_empty() && state.commander_id != own_id).then_some(state.commanded_by)
}
