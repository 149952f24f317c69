//! Measurements of one fault, and whether they meet its bounds.

use std::collections::BTreeMap;

use crate::catalogue::{Case, Outcome};
use crate::evidence::Control;
use crate::losses::Gap;
use crate::private_cell::REFERENCE_N;

/// Largest force allowed during any fault, N: the larger of twice the reference and 10 N.
pub const FORCE_MAX_N: f64 = if 2.0 * REFERENCE_N > 10.0 {
    2.0 * REFERENCE_N
} else {
    10.0
};
/// Largest difference between the mean force that the controller shows while it slides again and
/// the mean true force, N.
pub const SHOWN_MAX_N: f64 = 0.5;
/// Time after the end of a fault in which losses from it may still become visible, ns.
const AFTER_NS: i64 = 1_000_000_000;

/// Measurements of the task after a fault that ended the one before.
#[derive(Clone, Copy, Debug)]
pub struct Again {
    /// Highest force between its start and its end, N.
    pub peak_force_n: f64,
    /// Mean shown force minus mean true force while it slid, N.
    pub shown_minus_true_n: f64,
    /// Whether its retraction ended off the surface.
    pub retracted: bool,
}

/// Measurements of one fault.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name of the case.
    pub fault: &'static str,
    /// Description of what was done.
    pub what: &'static str,
    /// Service that must detect it.
    pub notices: &'static str,
    /// Required outcome of the task.
    pub outcome: Outcome,
    /// Time from the fault to the first message or motion in answer, ms.
    pub noticed_ms: Option<f64>,
    /// Bound on that time without the allowance, ms.
    pub noticed_bound_ms: Option<f64>,
    /// Time from the fault until the tool no longer slid, ms; `None` if the task continues.
    pub safe_ms: Option<f64>,
    /// Bound on that time without the allowance, ms.
    pub bound_ms: Option<f64>,
    /// Highest force from the beginning of the fault to its end, N.
    pub peak_force_n: f64,
    /// Number of messages missing in the recording during the fault, by topic.
    pub lost: BTreeMap<String, u64>,
    /// Number of messages missing outside of it, since the fault before, by topic.
    pub lost_outside: BTreeMap<String, u64>,
    /// The task after the fault; `None` if the task continues.
    pub again: Option<Again>,
    /// Whether all requirements are met.
    pub met: bool,
    /// Requirements that are not met, or the reason why the fault was skipped.
    pub remark: String,
    /// Whether the fault could not be provoked here.
    pub skipped: bool,
    pub(crate) begun_ns: i64,
    pub(crate) from_ns: i64,
    pub(crate) to_ns: i64,
    /// Time at which the task after the fault had ended, ns since the Unix epoch.
    pub(crate) ended_ns: i64,
    pub(crate) impostor: Option<&'static str>,
}

/// Creates a row without measurements.
pub fn without_figures(case: &Case, skipped: bool, remark: &str) -> Row {
    Row {
        fault: case.name,
        what: case.what,
        notices: case.notices,
        outcome: case.outcome,
        noticed_ms: None,
        noticed_bound_ms: case.seen_within_ms(),
        safe_ms: None,
        bound_ms: case.safe_within_ms(),
        peak_force_n: 0.0,
        lost: BTreeMap::new(),
        lost_outside: BTreeMap::new(),
        again: None,
        met: false,
        remark: remark.to_owned(),
        skipped,
        begun_ns: 0,
        from_ns: 0,
        to_ns: 0,
        ended_ns: 0,
        impostor: None,
    }
}

impl Row {
    fn fail(&mut self, why: &str) {
        self.met = false;
        if !self.remark.is_empty() {
            self.remark.push_str("; ");
        }
        self.remark.push_str(why);
    }

    pub(crate) fn judge(&mut self, case: &Case, went_on: bool, allow_ms: f64) {
        let late = |measured: Option<f64>, bound: Option<f64>| match (measured, bound) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(ms), Some(bound)) => ms > bound + allow_ms,
        };
        if late(self.noticed_ms, self.noticed_bound_ms) {
            self.fail("not detected in time");
        }
        match case.outcome {
            Outcome::GoesOn if !went_on => self.fail("the task did not continue"),
            Outcome::Ends | Outcome::Waits if late(self.safe_ms, self.bound_ms) => {
                self.fail("not safe in time");
            }
            Outcome::Waits if !went_on => self.fail("the path did not continue"),
            _ => {}
        }
        if self.peak_force_n > FORCE_MAX_N {
            self.fail("the force was too large");
        }
    }

    pub(crate) fn judge_again(&mut self, again: &Again, last: &Control) {
        if again.peak_force_n > FORCE_MAX_N {
            self.fail("the force of the next task was too large");
        }
        if again.shown_minus_true_n.is_nan() || again.shown_minus_true_n.abs() > SHOWN_MAX_N {
            self.fail("the force shown in the next task differs from the true one");
        }
        if !again.retracted {
            self.fail(&format!(
                "the next task did not leave the surface, phase {}: {}",
                last.phase.name(),
                last.fault
            ));
        }
    }

    /// Overlap of a gap and the fault, ns; negative if they do not overlap.
    fn common_ns(&self, gap: &Gap) -> i64 {
        if self.to_ns == 0 {
            return i64::MIN;
        }
        gap.to_ns.min(self.to_ns + AFTER_NS) - gap.from_ns.max(self.from_ns)
    }
}

/// Attributes a gap to the fault with the longest overlap; without overlap, to the time before the
/// next fault.
pub fn attribute(gap: &Gap, rows: &mut [Row]) {
    let add = |lost: &mut BTreeMap<String, u64>| {
        *lost.entry(gap.topic.clone()).or_default() += gap.messages;
    };
    let within = rows
        .iter_mut()
        .max_by_key(|row| row.common_ns(gap))
        .filter(|row| row.common_ns(gap) >= 0);
    if let Some(row) = within {
        // An impostor's messages have a counter of their own.
        if !row.impostor.is_some_and(|key| gap.topic.starts_with(key)) {
            add(&mut row.lost);
        }
    } else if let Some(row) = rows
        .iter_mut()
        .find(|row| gap.within(row.begun_ns, row.from_ns) || gap.within(row.to_ns, row.ended_ns))
    {
        add(&mut row.lost_outside);
        if row.met {
            row.fail("messages are missing outside the fault");
        }
    }
}
