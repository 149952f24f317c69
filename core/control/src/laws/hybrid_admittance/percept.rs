//! Inputs of one cycle, evaluated for the program.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Tool, Wrench};
use tangent_sensing::BaseTrouble;

use crate::estimator_choice::EstimateStatus;
use crate::inputs::UntaredLoad;
use crate::limits::wrench_guard::WrenchVerdict;

/// External requests to a running task.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Requests {
    pub paused: bool,
    pub stopping: bool,
}

/// Evaluated inputs of one cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Percept {
    pub position: Vector3<f64>,
    /// Position of the tool's origin relative to the base of this cycle, base axes, m; the
    /// workspace limits apply to it.
    pub position_in_base: Vector3<f64>,
    /// Why the motion of the base is not known; `None` if it is known or the base does not move.
    pub base: Option<BaseTrouble>,
    /// Whether the arm cannot compensate the motion of the base.
    pub out_of_reach: bool,
    pub z_tool: Vector3<f64>,
    /// Wrench at the tool's origin, base axes; `None` if none is usable.
    pub wrench: Option<Wrench<Aligned<Tool, Base>>>,
    pub verdict: WrenchVerdict,
    /// Reading before any zero is subtracted; `None` if none is usable.
    pub untared: Option<UntaredLoad>,
    /// Pressing force along the normal (before contact: against the approach), N; `None` without a
    /// wrench.
    pub force_n: Option<f64>,
    pub estimate: EstimateStatus,
}
