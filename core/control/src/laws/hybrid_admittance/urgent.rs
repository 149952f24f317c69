//! Faults that end contact in every phase.

use super::percept::Percept;
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;

/// The first of these faults that holds in this cycle.
pub(crate) fn urgent_fault(limits: &Limits, percept: &Percept) -> Option<Fault> {
    if let WrenchVerdict::Retract(reason) = percept.verdict {
        return Some(Fault::Wrench(reason));
    }
    let overload = (percept.wrench.as_ref())
        .and_then(|wrench| limits.overload(wrench.force.norm(), wrench.torque.norm()));
    if overload.is_some() {
        return overload;
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
