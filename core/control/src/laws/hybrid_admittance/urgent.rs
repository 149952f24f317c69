//! Faults that end contact in every phase.

use super::percept::Percept;
use crate::limits::Limits;
use crate::limits::faults::{Excess, Fault};
use crate::limits::wrench_guard::WrenchVerdict;

/// The first of these faults that holds in this cycle.
pub(crate) fn urgent_fault(limits: &Limits, percept: &Percept) -> Option<Fault> {
    if let WrenchVerdict::Retract(reason) = percept.verdict {
        return Some(Fault::Wrench(reason));
    }
    if let Some(wrench) = &percept.wrench {
        if let Some(excess) = Excess::over(wrench.force.norm(), limits.force_max_n) {
            return Some(Fault::ForceLimit(excess));
        }
        if let Some(excess) = Excess::over(wrench.torque.norm(), limits.torque_max_nm) {
            return Some(Fault::TorqueLimit(excess));
        }
    }
    let hidden = |load| limits.is_untared_beyond(load);
    if percept.untared.as_ref().is_some_and(hidden) {
        return Some(Fault::UntaredLimit);
    }
    if percept.out_of_reach {
        return Some(Fault::OutOfReach);
    }
    outside(limits, percept)
}

/// Whether the tool has left the workspace.
pub(crate) fn outside(limits: &Limits, percept: &Percept) -> Option<Fault> {
    let inside = (0..3).all(|i| {
        (limits.workspace_min_m[i]..=limits.workspace_max_m[i])
            .contains(&percept.position_in_base[i])
    });
    (!inside).then_some(Fault::Workspace)
}
