//! The figures of a report as text for a terminal.

use tangent_control::Verdict;

use crate::comparison;
use crate::figures::Report;
use crate::shown_time::shown_s;
use crate::tasks::TaskEntry;
use crate::{coverage, object, tactile};

/// Force that noise and a payload may leave on the sensor of a free tool, N.
const FREE_NOISE_N: f64 = 0.3;

/// Formats the main figures for a terminal.
pub fn words(report: &Report) -> String {
    let f = &report.figures;
    let mut lines = vec![format!(
        "{}: {:.1} s, {} cycles",
        report.scenario.as_deref().unwrap_or("recording"),
        report.duration_s,
        report.steps,
    )];
    lines.push(format!(
        "task             {}",
        report.events.verdict_words(report.fault.as_deref())
    ));
    if let Some(accepted) = report.accepted {
        let word = if accepted { "ACCEPTED" } else { "REJECTED" };
        lines.push(format!("tolerances       {word}"));
        for one in &report.tolerances {
            let kept = if one.met { "" } else { " NOT KEPT" };
            lines.push(format!("  {}: {}{kept}", one.words, one.figures()));
        }
    }
    if report.tasks.len() > 1 {
        let all: Vec<String> = report.tasks.iter().map(TaskEntry::words).collect();
        lines.push(format!(
            "shown            task {} of {}: {}",
            report.task.unwrap_or_default(),
            report.tasks.len(),
            all.join(", ")
        ));
    }
    for (name, times) in report.events.interruptions() {
        lines.push(format!("{name:<16} {times}"));
    }
    if let Some(e) = f.normal_error_deg {
        lines.push(format!(
            "normal error     {:.2} deg mean, {:.2} deg RMS",
            e.mean, e.rmse
        ));
    }
    if let Some(e) = f.alignment_error_deg {
        lines.push(format!(
            "alignment error  {:.2} deg mean, {:.2} deg RMS",
            e.mean, e.rmse
        ));
    }
    if let (Some(mean), Some(rmse)) = (f.force.mean_n, f.force.rmse_n) {
        lines.push(format!(
            "force            {mean:.2} N of {:.2} N, error {rmse:.3} N RMS",
            f.force.reference_n
        ));
    }
    if let Some(rmse) = f.path.rmse_m {
        lines.push(format!("path error       {:.2} mm RMS", 1e3 * rmse));
    }
    if let Some(fraction) = f.contact.fraction {
        lines.push(format!(
            "contact          {:.2} % of the time, lost {} times",
            100.0 * fraction,
            f.contact.lost_count
        ));
    }
    if let Some(result) = &report.coverage {
        lines.push(format!("coverage         {}", coverage::sentence(result)));
        let details = coverage::details(result);
        lines.extend(details.iter().map(|detail| format!("  {detail}")));
    }
    if let Some(object) = &report.object_pose {
        lines.extend(object::words(object));
    }
    lines.extend(report.tactile.as_ref().and_then(tactile::words));
    let l = &report.r#loop;
    if let Some(q) = l.packet_to_command_us {
        lines.push(format!(
            "packet to command {:.0} us median, {:.0} us p99, {:.0} us max; {} cycles missed",
            q.p50,
            q.p99,
            q.max,
            l.missed_cycles.unwrap_or(0)
        ));
    }
    let count = |n: Option<u64>| n.map_or_else(|| "unknown".to_owned(), |n| n.to_string());
    lines.push(format!(
        "lost             {} sensor records, {} messages",
        count(l.wrench_records_lost),
        count(l.messages_dropped)
    ));
    if let Some(age_s) = l.zero_age_max_s {
        let bound = l.zero_bound_max_n.map_or_else(String::new, |n| {
            format!(": the force may be wrong by {n:.2} N")
        });
        lines.push(format!("sensor's zero    at most {age_s:.0} s old{bound}"));
    }
    if let Some(free_n) = l.force_when_free_n {
        let known_n = l.zero_bound_max_n.unwrap_or(0.0) + FREE_NOISE_N;
        let so = if free_n > known_n {
            ": by as much the forces of this task may be wrong; tare, and check payload and cable"
        } else {
            ""
        };
        lines.push(format!(
            "tool hung free   with {free_n:.2} N on the sensor after the task{so}"
        ));
    }
    for switch in &report.estimator_switches {
        lines.push(format!(
            "normal           at {:.2} s by {} after {}: {}",
            shown_s(switch.time_s),
            switch.to,
            switch.from,
            switch.cause
        ));
    }
    let told = report.events.verdict == Some(Verdict::Faulted);
    if let Some(fault) = report.fault.as_ref().filter(|_| !told) {
        lines.push(format!("fault            {fault}"));
    }
    lines.push(String::new());
    let mut text = lines.join("\n");
    if report.estimators.len() > 1 {
        text += &comparison::words(&report.estimators, report.estimator.as_deref());
    }
    text
}
