//! One cycle as the program sees it.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Tool, Wrench};
use tangent_sensing::BaseTrouble;

use crate::UntaredLoad;
use crate::estimator_choice::EstimateStatus;
use crate::wrench_guard::WrenchVerdict;

/// What was asked of a running task from outside.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Requests {
    pub paused: bool,
    pub stopping: bool,
}

/// One cycle as perceived.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Percept {
    pub position: Vector3<f64>,
    /// The same from the base of this cycle: what the workspace is drawn in.
    pub position_in_base: Vector3<f64>,
    /// Why the motion of the base is not known.
    pub base: Option<BaseTrouble>,
    /// The arm cannot make up for the base's motion.
    pub out_of_reach: bool,
    pub z_tool: Vector3<f64>,
    /// At the tool's origin, base axes; none when there is none to use.
    pub wrench: Option<Wrench<Aligned<Tool, Base>>>,
    pub verdict: WrenchVerdict,
    /// The reading before any zero is taken off; none when there is none to use.
    pub untared: Option<UntaredLoad>,
    /// Pressing force along the normal (before contact: against the approach), N; none without a wrench.
    pub force_n: Option<f64>,
    pub estimate: EstimateStatus,
}
