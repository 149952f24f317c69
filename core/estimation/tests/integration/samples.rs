//! Samples with a fresh, valid wrench, on a base that stands.

use tangent_estimation::ContactSample;
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench};
use tangent_sensing::Validity;

/// A sample of a tool that moves as commanded, with a zero that is as old as the run.
pub(crate) fn sample(
    time_s: f64,
    dt_s: f64,
    base_from_tool: Pose<Base, Tool>,
    twist: Twist<Aligned<Tool, Base>>,
    wrench: Wrench<Tool>,
) -> ContactSample {
    ContactSample {
        time_s,
        dt_s,
        base_from_tool,
        twist,
        twist_commanded: twist,
        wrench,
        wrench_delay_s: 0.0,
        wrench_validity: Validity::Valid,
        wrench_bias_age_s: Some(time_s),
        base: None,
    }
}
