//! Whether the result of a task keeps the tolerances of its task file.

use serde::Serialize;
use tangent_control::{Tolerances, Verdict};
use tangent_simulation::metrics::Figures;

use crate::events::Events;
use crate::run::Run;
use crate::task_run::TaskRun;

/// One tolerance, and what the run has.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Key in the task's `tolerances`.
    pub key: &'static str,
    /// What it bounds, in words.
    #[serde(skip)]
    pub words: &'static str,
    /// Value of the run, in the key's unit; null if it was not measured.
    pub value: Option<f64>,
    /// Limit in the task file, in the same unit.
    pub limit: f64,
    /// Whether the limit is kept.
    pub met: bool,
    #[serde(skip)]
    shown: Shown,
}

/// How values of a tolerance are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shown {
    factor: f64,
    digits: usize,
    unit: &'static str,
    least: bool,
}

const NEWTONS: Shown = Shown {
    factor: 1.0,
    digits: 3,
    unit: " N",
    least: false,
};
const DEGREES: Shown = Shown {
    factor: 180.0 / std::f64::consts::PI,
    digits: 2,
    unit: "°",
    least: false,
};
const MILLIMETRES: Shown = Shown {
    factor: 1e3,
    digits: 2,
    unit: " mm",
    least: false,
};
const PERCENT: Shown = Shown {
    factor: 100.0,
    digits: 2,
    unit: " %",
    least: true,
};

impl Judged {
    /// The value and its limit: `0.612 N, at most 0.500 N`.
    pub fn figures(&self) -> String {
        let shown = self.shown;
        let number =
            |value: f64| format!("{:.*}{}", shown.digits, value * shown.factor, shown.unit);
        let bound = if shown.least { "at least" } else { "at most" };
        let value = self.value.map_or_else(|| "not measured".to_owned(), number);
        format!("{value}, {bound} {}", number(self.limit))
    }
}

/// Tolerances in the task file of this task; empty if the recording has none.
pub(crate) fn tolerances(run: &Run, task: &TaskRun<'_>) -> Tolerances {
    let of_file = || {
        let table = task.file(run)?;
        table.get("tolerances")?.clone().try_into().ok()
    };
    of_file().unwrap_or_default()
}

/// Compares the figures with every tolerance that is given.
pub(crate) fn judge(tolerances: &Tolerances, figures: &Figures) -> Vec<Judged> {
    let angle = figures.tool_error_deg.or(figures.alignment_error_deg);
    let all = [
        (
            "force_rmse_n",
            "RMS error of the force",
            figures.force.rmse_n,
            tolerances.force_rmse_n,
            NEWTONS,
        ),
        (
            "force_p95_n",
            "error of the force that 5 % of the time exceeds",
            figures.force.p95_abs_error_n,
            tolerances.force_p95_n,
            NEWTONS,
        ),
        (
            "force_peak_n",
            "highest force",
            figures.force.peak_n,
            tolerances.force_peak_n,
            NEWTONS,
        ),
        (
            "tool_angle_rad",
            "mean angle between tool and surface normal",
            angle.map(|spread| spread.mean.to_radians()),
            tolerances.tool_angle_rad,
            DEGREES,
        ),
        (
            "path_rmse_m",
            "RMS distance from the path",
            figures.path.rmse_m,
            tolerances.path_rmse_m,
            MILLIMETRES,
        ),
        (
            "contact_share_min",
            "share of the time in contact",
            figures.contact.fraction,
            tolerances.contact_share_min,
            PERCENT,
        ),
    ];
    all.into_iter()
        .filter_map(|(key, words, value, limit, shown)| {
            let limit = limit?;
            let kept = |value: f64| {
                if shown.least {
                    value >= limit
                } else {
                    value <= limit
                }
            };
            Some(Judged {
                key,
                words,
                value,
                limit,
                met: value.is_some_and(kept),
                shown,
            })
        })
        .collect()
}

/// Whether the part is accepted: the whole path was followed, nothing of it passed over, and every
/// tolerance is kept. `None` if the task has no tolerances.
pub(crate) fn accepted(judged: &[Judged], events: &Events) -> Option<bool> {
    let followed = events.verdict == Some(Verdict::Completed) && events.passed_over.is_none();
    (!judged.is_empty()).then(|| followed && judged.iter().all(|one| one.met))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::PassedOver;

    #[test]
    fn a_limit_is_kept_up_to_itself_and_what_was_not_measured_is_not_kept() {
        let mut figures = Figures::of(&[]);
        figures.force.rmse_n = Some(0.5);
        figures.contact.fraction = Some(0.98);
        let tolerances = Tolerances {
            force_rmse_n: Some(0.5),
            path_rmse_m: Some(0.002),
            contact_share_min: Some(0.99),
            ..Tolerances::default()
        };
        let judged = judge(&tolerances, &figures);
        let met: Vec<(&str, bool)> = judged.iter().map(|one| (one.key, one.met)).collect();
        assert_eq!(
            met,
            [
                ("force_rmse_n", true),
                ("path_rmse_m", false),
                ("contact_share_min", false)
            ]
        );
        assert_eq!(judged[0].figures(), "0.500 N, at most 0.500 N");
        assert_eq!(judged[1].figures(), "not measured, at most 2.00 mm");
        assert_eq!(judged[2].figures(), "98.00 %, at least 99.00 %");
        let ended = |verdict| Events {
            verdict: Some(verdict),
            ..Events::default()
        };
        let completed = ended(Verdict::Completed);
        assert_eq!(accepted(&judged, &completed), Some(false));
        assert_eq!(accepted(&judged[..1], &completed), Some(true));
        assert_eq!(
            accepted(&judged[..1], &ended(Verdict::Stopped)),
            Some(false)
        );
        assert_eq!(accepted(&[], &completed), None);
        let passed_over = Events {
            passed_over: Some(PassedOver {
                times: 1,
                path_share: None,
            }),
            ..completed
        };
        assert_eq!(accepted(&judged[..1], &passed_over), Some(false));
    }
}
