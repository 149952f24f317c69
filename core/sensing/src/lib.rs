//! Wrench conditioning: from what a force/torque sensor reads to what the environment does to the
//! tool.
//!
//! Called by the `netft` service for every record, and by the closed loop of `evaluate`. A record
//! passes through, in this order: [`SensorWatch`] (records that no load can make), tare ([`Tare`],
//! subtracted on the host and with its age), payload ([`Payload`], by the arm's measured
//! orientation), low-pass ([`LowPass`], with a stated delay), and eq. (2) of Tugal et al. to the
//! tool's frame. [`identify_payload`] finds the payload from static poses, each the mean of a
//! [`PoseAverage`]. Beside it, [`BaseTracker`]: how the base moves that all this stands on.
//!
//! For arms without a sensor at the wrist: [`MomentumObserver`], the environment's torques from the
//! arm's own motion.
//!
//! [`TargetDetector`] finds the corners of a target in an image.

mod base_motion;
mod conditioner;
mod error;
mod identification;
mod low_pass;
mod momentum_observer;
mod motion;
mod payload;
mod pose_average;
mod sensor_watch;
mod tare;
mod target_detector;
mod validity;

pub use base_motion::{BaseConfig, BaseMotion, BasePose, BaseTracker, BaseTrouble};
pub use conditioner::{
    ConditionedWrench, ConditioningConfig, Reading, SensorCondition, WrenchConditioner,
    WrenchConditionerState,
};
pub use error::SensingError;
pub use identification::{IdentificationError, IdentifiedPayload, StaticPose, identify_payload};
pub use low_pass::{LowPass, LowPassState};
pub use momentum_observer::{MomentumObserver, MomentumObserverState, wrench_of_torques};
pub use motion::SensorMotionState;
pub use payload::{Payload, SensorMotion};
pub use pose_average::{PoseAverage, PoseFinder};
pub use sensor_watch::{
    JumpVerdict, JumpWatch, JumpWatchState, RecordVerdict, RecordWatch, RecordWatchConfig,
    RecordWatchState, SensorRecord, SensorWatch, SensorWatchState, StepWatch, StepWatchState,
    Watched, pressing_at,
};
pub use tare::{Tare, TareConfig, TareGround, TareRefusal, ZeroPoint};
pub use target_detector::{GreyImage, TargetDetector, TargetDetectorError};
pub use validity::Validity;
