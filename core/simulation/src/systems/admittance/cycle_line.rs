//! Formats one cycle of the closed loop as a line of text, to find the moment when something goes
//! wrong.

use std::fmt;

use nalgebra::Vector3;

use super::closed_loop::AdmittanceCycle;
use crate::metrics::angle_deg;

impl fmt::Display for AdmittanceCycle<'_> {
    /// Time, phase, forces along the true normal, errors of normal and tool, speeds along and
    /// across the surface, and the law's contact state.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let truth = self.truth;
        let normal_error = self
            .estimate
            .map_or(f64::NAN, |e| angle_deg(&e.normal, &truth.normal));
        let along = |v: &Vector3<f64>| v.dot(&truth.normal) * 1e3;
        // Error of the estimate and its standard deviation, along and across the motion.
        let split = self.estimate.and_then(|e| {
            let velocity = self.input.twist.linear;
            let along =
                (velocity - truth.normal * truth.normal.dot(&velocity)).try_normalize(1e-4)?;
            let across = truth.normal.cross(&along);
            let sd = |v: &Vector3<f64>| v.dot(&(e.covariance * v)).max(0.0).sqrt();
            let error = e.normal - truth.normal;
            Some([
                error.dot(&along),
                sd(&along),
                error.dot(&across),
                sd(&across),
            ])
        });
        write!(
            f,
            "{:7.3} s {:8} force {:6.3} true {:6.3} measured {:5.2} wanted N | normal {:6.2} tool {:6.2} deg | {:6.2} mm/s sliding, \
             normal {:6.2} wanted {:6.2} real mm/s | path {:6.3} mm | d {:5.0} Ns/m k {:6.0} N/m | wrench {:.2?} N | along, across: error and sd {:.1?} deg, friction {:.2} | {}",
            self.arm.time_s,
            self.output.phase.name(),
            truth.wrench.force.dot(&truth.normal),
            self.output.force_n.unwrap_or(f64::NAN),
            self.output.force_reference_n,
            normal_error,
            angle_deg(&truth.normal, &-truth.base_from_tool.z_axis()),
            truth.sliding_speed_m_per_s * 1e3,
            along(&self.output.twist_commanded.linear),
            along(&self.input.twist.linear),
            self.output.path_error_m * 1e3,
            self.output.damping_n_s_per_m,
            self.output.stiffness_n_per_m,
            self.input.wrench.force.as_slice(),
            split.map_or([f64::NAN; 4], |s| s.map(f64::to_degrees)),
            self.estimate.and_then(|e| e.friction).unwrap_or(f64::NAN),
            self.estimate.map_or("no estimate", |e| e.validity.reason()),
        )
    }
}
