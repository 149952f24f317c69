//! Sections of the page in words and numbers: the task, the losses, and the table of figures.

use std::fmt::Write as _;

use tangent_control::{CoverageOutcome, Verdict};
use tangent_simulation::metrics::Spread;

use super::escaped;
use crate::coverage;
use crate::figures::Report;
use crate::run::Run;
use crate::task_run::TaskRun;
use crate::tasks::TaskEntry;

pub(super) fn introduction(task: &TaskRun<'_>, report: &Report) -> String {
    if task.cycles.is_empty() {
        return "<p>No task was started while this was recorded: there are no figures of force, path or normal.</p>\n"
            .to_owned();
    }
    let others: Vec<String> = report
        .tasks
        .iter()
        .filter(|other| Some(other.number) != report.task)
        .map(TaskEntry::words)
        .collect();
    let more = if others.is_empty() {
        String::new()
    } else {
        format!(
            " This page is about task {} of {} in the recording; the others, to be shown with <code>--task</code>, are {}.",
            report.task.unwrap_or_default(),
            report.tasks.len(),
            escaped(&others.join(", "))
        )
    };
    let truth = if task.cycles.iter().any(|c| c.truth.is_some()) {
        "The cell was simulated, so the true contact is known: errors of the normal and the force are relative to it."
    } else {
        "There is no ground truth in this recording: forces are as measured, and the normal can only be compared with \
         the tool's axis."
    };
    format!(
        "<p>A robot pressed a tool on a surface, estimated the surface normal, kept the tool square to the surface and \
         followed a path. The task took {:.1} s in {} robot cycles. Estimator: <b>{}</b>; control law: preset \
         <b>{}</b>.{more} {truth}</p>\n{}{}",
        report.duration_s,
        report.steps,
        escaped(report.estimator.as_deref().unwrap_or("none")),
        escaped(report.controller.as_deref().unwrap_or("unknown")),
        verdict(report),
        covered(report)
    )
}

/// What the controller has covered; empty for a task without `[coverage]`.
fn covered(report: &Report) -> String {
    let Some(result) = &report.coverage else {
        return String::new();
    };
    let class = match result.outcome {
        CoverageOutcome::Met => "good",
        _ => "bad",
    };
    let items: String = coverage::details(result)
        .iter()
        .map(|detail| format!("<li>{}</li>", escaped(detail)))
        .collect();
    format!(
        "<div class=\"{class}\"><b>Coverage by the controller: {}</b><ul>{items}</ul></div>\n",
        escaped(&coverage::sentence(result))
    )
}

/// How the task ended, and what interrupted it.
fn verdict(report: &Report) -> String {
    let class = match report.events.verdict {
        Some(Verdict::Completed) => "good",
        _ => "bad",
    };
    let items: String = report
        .events
        .interruptions()
        .iter()
        .map(|(name, times)| format!("<li>{name}: {}</li>", escaped(times)))
        .collect();
    let list = if items.is_empty() {
        items
    } else {
        format!("<ul>{items}</ul>")
    };
    format!(
        "<div class=\"{class}\"><b>Task {}</b>{list}</div>\n{}",
        escaped(&report.events.verdict_words(report.fault.as_deref())),
        acceptance(report)
    )
}

/// Whether the result keeps the task's tolerances, and each of them.
fn acceptance(report: &Report) -> String {
    let Some(accepted) = report.accepted else {
        return "<p class=\"note\">The task file has no <code>[tolerances]</code>, so the result is not judged.</p>\n"
            .to_owned();
    };
    let (class, word) = if accepted {
        ("good", "ACCEPTED: every tolerance of the task is kept")
    } else if report.tolerances.iter().all(|one| one.met) {
        ("bad", "REJECTED: the path was not followed to its end")
    } else {
        ("bad", "REJECTED: a tolerance of the task is not kept")
    };
    let rows: String = report
        .tolerances
        .iter()
        .map(|one| {
            format!(
                "<tr><td>{}</td><td class=\"n\">{}</td><td>{}</td></tr>\n",
                one.words,
                one.figures(),
                if one.met { "kept" } else { "<b>NOT KEPT</b>" }
            )
        })
        .collect();
    format!("<div class=\"{class}\"><b>{word}</b><table>{rows}</table></div>\n")
}

pub(super) fn losses(run: &Run, report: &Report) -> String {
    let mut lines = Vec::new();
    for path in &run.truncated {
        lines.push(format!(
            "{} has no end (its recorder was killed or the file was cut): read up to its last whole chunk.",
            path.display()
        ));
    }
    for damage in &run.damages {
        lines.push(format!("{damage}; what follows the damage was not read."));
    }
    if report.recording.undecodable > 0 {
        lines.push(format!(
            "{} messages cannot be decoded: they were recorded by another version, or are damaged.",
            report.recording.undecodable
        ));
    }
    if let Some(n) = report.r#loop.messages_dropped.filter(|n| *n > 0) {
        lines.push(format!("{n} messages are missing in the recording."));
    }
    if let Some(n) = report.r#loop.wrench_records_lost.filter(|n| *n > 0) {
        lines.push(format!("{n} records of the force sensor were lost."));
    }
    if lines.is_empty() {
        return "<p class=\"good\">This recording is complete: nothing was lost.</p>\n".to_owned();
    }
    let items: String = lines
        .iter()
        .map(|line| format!("<li>{}</li>", escaped(line)))
        .collect();
    format!("<div class=\"bad\"><b>Something was lost.</b><ul>{items}</ul></div>\n")
}

/// The table of figures.
pub(super) fn table(report: &Report) -> String {
    let f = &report.figures;
    let spread = |s: &Option<Spread>| s.map(|s| format!("{:.2}° / {:.2}°", s.mean, s.rmse));
    let number =
        |v: Option<f64>, digits: usize, unit: &str| v.map(|v| format!("{v:.digits$} {unit}"));
    let milli = |v: Option<f64>| number(v.map(|v| v * 1e3), 2, "mm");
    let latency = report.r#loop.packet_to_command_us;
    let rows = [
        (
            "Error of the estimated normal, mean / RMS",
            "estimate against truth, while in contact",
            spread(&f.normal_error_deg),
        ),
        (
            "Error of the estimated normal once settled, mean / RMS",
            "from 1 s after first contact",
            spread(&f.normal_error_settled_deg),
        ),
        (
            "Tool against the surface, mean / RMS",
            "true angle between the tool and the surface normal",
            spread(&f.tool_error_deg),
        ),
        (
            "Tool against the estimate, mean / RMS",
            "angle between the tool and the estimated normal",
            spread(&f.alignment_error_deg),
        ),
        (
            "Consistency of the estimator",
            "squared error over stated variance (NEES per degree of freedom): 1 is consistent, more is overconfident",
            number(f.normal_nees_per_dof, 2, ""),
        ),
        (
            "Force: reference",
            "",
            Some(format!("{:.2} N", f.force.reference_n)),
        ),
        (
            "Force: mean / RMS error",
            "sliding and holding, from 1 s after first contact",
            f.force
                .mean_n
                .zip(f.force.rmse_n)
                .map(|(mean, rmse)| format!("{mean:.2} N / {rmse:.3} N")),
        ),
        (
            "Force: 95 % of the time the error is below",
            "",
            number(f.force.p95_abs_error_n, 3, "N"),
        ),
        (
            "Force: highest",
            "of the whole task",
            number(f.force.peak_n, 2, "N"),
        ),
        (
            "Touchdown: overshoot",
            "peak above the reference",
            number(f.force.overshoot_percent, 1, "%"),
        ),
        (
            "Touchdown: settled after",
            "within 10 % for half a second",
            number(f.force.settling_s, 2, "s"),
        ),
        (
            "Path: RMS / largest error",
            "along the surface, while sliding",
            milli(f.path.rmse_m)
                .zip(milli(f.path.max_m))
                .map(|(rmse, max)| format!("{rmse} / {max}")),
        ),
        (
            "Contact",
            "share of the time between first contact and retraction",
            f.contact
                .fraction
                .map(|x| format!("{:.2} %, lost {} times", 100.0 * x, f.contact.lost_count)),
        ),
        (
            "Joints: highest speed",
            "",
            number(f.joints.speed_peak_rad_per_s, 3, "rad/s"),
        ),
        (
            "Joints: least manipulability",
            "0 is a singular pose",
            number(f.joints.manipulability_min, 4, ""),
        ),
        (
            "Robot packet to command, median / 99 % / largest",
            "time from a robot's packet to the answer of this program",
            latency.map(|q| format!("{:.0} / {:.0} / {:.0} µs", q.p50, q.p99, q.max)),
        ),
        (
            "Cycles missed",
            "cycles in which a command was due and none was fresh",
            report.r#loop.missed_cycles.map(|n| n.to_string()),
        ),
        (
            "Sensor records lost",
            "",
            report.r#loop.wrench_records_lost.map(|n| n.to_string()),
        ),
        (
            "Age of the sensor's zero, at most",
            "the zero drifts with time: the force shown may be wrong by as much as stated",
            report.r#loop.zero_age_max_s.map(|age_s| {
                let bound = report.r#loop.zero_bound_max_n;
                let bound = bound.map_or_else(String::new, |n| format!(" / {n:.2} N"));
                format!("{age_s:.0} s{bound}")
            }),
        ),
        (
            "Force on the free tool after the task",
            "what the sensor still showed at the end of the retraction: its zero has moved, or the payload is not the stated one",
            report.r#loop.force_when_free_n.map(|n| format!("{n:.2} N")),
        ),
        (
            "Messages missing in the recording",
            "",
            report.r#loop.messages_dropped.map(|n| n.to_string()),
        ),
    ];
    let mut html = "<h2>Figures</h2>\n<table>\n".to_owned();
    for (name, meaning, value) in rows {
        let meaning = if meaning.is_empty() {
            String::new()
        } else {
            format!("<br><span class=\"note\">{meaning}</span>")
        };
        let _ = writeln!(
            html,
            "<tr><td>{name}{meaning}</td><td class=\"n\">{}</td></tr>",
            value.as_deref().unwrap_or("not recorded")
        );
    }
    html.push_str("</table>\n");
    html
}
