//! What was measured of one fault, and whether it is as it has to be.

use std::collections::BTreeMap;

use super::catalogue::{Case, Outcome};
use super::evidence::Control;
use super::losses::Gap;
use super::private_cell::REFERENCE_N;

/// No fault may press harder: the larger of twice the reference and 10 N.
pub const FORCE_MAX_N: f64 = if 2.0 * REFERENCE_N > 10.0 {
    2.0 * REFERENCE_N
} else {
    10.0
};
/// Force that the controller may show more or less than is true while it slides again, in the mean,
/// N.
pub const SHOWN_MAX_N: f64 = 0.5;
/// After a fault has ended, what was lost in it may still come to light for so long, ns.
const AFTER_NS: i64 = 1_000_000_000;

/// What was measured of the task after a fault that ended one.
#[derive(Clone, Copy, Debug)]
pub struct Again {
    /// Highest force from its start to its end, N.
    pub peak_force_n: f64,
    /// Force shown less the true one while it slid, in the mean, N.
    pub shown_minus_true_n: f64,
    /// Its retraction ended off the surface.
    pub retracted: bool,
}

/// What was measured of one fault.
#[derive(Clone, Debug)]
pub struct Row {
    /// The case's name.
    pub fault: &'static str,
    /// What was done.
    pub what: &'static str,
    /// Who has to notice.
    pub notices: &'static str,
    /// What has to become of the task.
    pub outcome: Outcome,
    /// From the fault to the first word or move in answer, ms.
    pub noticed_ms: Option<f64>,
    /// The bound on that without the allowance, ms.
    pub noticed_bound_ms: Option<f64>,
    /// From the fault until the tool slid no more, ms; none where the task goes on.
    pub safe_ms: Option<f64>,
    /// The bound on that without the allowance, ms.
    pub bound_ms: Option<f64>,
    /// Highest force from the fault to its end, N.
    pub peak_force_n: f64,
    /// Messages that the recording lacks within the fault, by topic.
    pub lost: BTreeMap<String, u64>,
    /// And outside of it, since the fault before.
    pub lost_outside: BTreeMap<String, u64>,
    /// The task after it; none where the task goes on.
    pub again: Option<Again>,
    /// Everything as it has to be.
    pub met: bool,
    /// What is not; or why it was skipped.
    pub remark: String,
    /// It could not be provoked here.
    pub skipped: bool,
    pub(super) begun_ns: i64,
    pub(super) from_ns: i64,
    pub(super) to_ns: i64,
    /// When the task after it had ended.
    pub(super) ended_ns: i64,
    pub(super) impostor: Option<&'static str>,
}

/// A row without figures.
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

    pub(super) fn judge(&mut self, case: &Case, went_on: bool, allow_ms: f64) {
        let late = |measured: Option<f64>, bound: Option<f64>| match (measured, bound) {
            (_, None) => false,
            (None, Some(_)) => true,
            (Some(ms), Some(bound)) => ms > bound + allow_ms,
        };
        if late(self.noticed_ms, self.noticed_bound_ms) {
            self.fail("not noticed in time");
        }
        match case.outcome {
            Outcome::GoesOn if !went_on => self.fail("the task did not go on"),
            Outcome::Ends | Outcome::Waits if late(self.safe_ms, self.bound_ms) => {
                self.fail("not safe in time");
            }
            Outcome::Waits if !went_on => self.fail("the path did not go on"),
            _ => {}
        }
        if self.peak_force_n > FORCE_MAX_N {
            self.fail("pressed too hard");
        }
    }

    pub(super) fn judge_again(&mut self, again: &Again, last: &Control) {
        if again.peak_force_n > FORCE_MAX_N {
            self.fail("the task after it pressed too hard");
        }
        if again.shown_minus_true_n.is_nan() || again.shown_minus_true_n.abs() > SHOWN_MAX_N {
            self.fail("the task after it shows another force than is true");
        }
        if !again.retracted {
            self.fail(&format!(
                "the task after it did not leave the surface, phase {}: {}",
                last.phase.name(),
                last.fault
            ));
        }
    }

    /// Longest stretch that a hole and the fault have in common, ns.
    fn common_ns(&self, gap: &Gap) -> i64 {
        if self.to_ns == 0 {
            return i64::MIN;
        }
        gap.to_ns.min(self.to_ns + AFTER_NS) - gap.from_ns.max(self.from_ns)
    }
}

/// Writes a hole down where it belongs: to the fault that it shares the longest time with, else to
/// the time before the next.
pub fn attribute(gap: &Gap, rows: &mut [Row]) {
    let add = |lost: &mut BTreeMap<String, u64>| {
        *lost.entry(gap.topic.clone()).or_default() += gap.messages;
    };
    let within = rows
        .iter_mut()
        .max_by_key(|row| row.common_ns(gap))
        .filter(|row| row.common_ns(gap) >= 0);
    if let Some(row) = within {
        // An impostor's messages have a count of their own.
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
