//! The page that compares two runs.

use std::fmt::Write as _;

use tangent_simulation::metrics::angle_deg;

use super::{escaped, plots};
use crate::difference::{Difference, run_words};
use crate::error::ReportError;
use crate::plot::{Axes, Curve};
use crate::task_run::{Cycle, TaskRun};

pub(super) fn body(
    difference: &Difference,
    a: &TaskRun<'_>,
    b: &TaskRun<'_>,
) -> Result<String, ReportError> {
    let mut html = String::new();
    for (letter, report) in [("A", &difference.a), ("B", &difference.b)] {
        let words = report.events.verdict_words(report.fault.as_deref());
        let _ = writeln!(
            html,
            "<p><b>{letter}</b>: {}<br><span class=\"note\">{}</span></p>",
            escaped(&run_words(report)),
            escaped(&words)
        );
    }
    html += &figures(difference);
    html += &settings(difference);
    html.push_str("<h2>Plots</h2>\n<p class=\"note\">Time runs from the start of each task.</p>\n");
    html += &both(a, b, "Pressing force", "N", |c| c.sample.force_n)?;
    html += &both(a, b, "Tool against the surface", "degrees", |c| {
        let truth = c.sample.truth.filter(|t| t.in_contact);
        let tool = truth.map(|t| angle_deg(&t.normal, &-t.tool_z));
        let estimate = c.sample.estimate.filter(|_| c.sample.in_contact);
        tool.or_else(|| Some(angle_deg(&estimate?.normal, &-c.sample.tool_z)))
    })?;
    html += &both(a, b, "Distance from the path", "mm", |c| {
        let slides = c.sample.phase == tangent_control::Phase::Slide;
        slides.then_some(1e3 * c.sample.path_error_m)
    })?;
    Ok(html)
}

/// Title of the page.
pub(super) fn title(difference: &Difference) -> String {
    let [a, b] = [&difference.a, &difference.b]
        .map(|report| report.task_entry().map_or("no task", |task| &task.name));
    format!("Two runs: {a} and {b}")
}

fn figures(difference: &Difference) -> String {
    let mut html = "<h2>Figures</h2>\n<div class=\"wide\"><table><tr><th></th><th>A</th><th>B</th><th>B - A</th></tr>\n"
        .to_owned();
    for one in &difference.figures {
        let [a, b, change] = one.shown();
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td class=\"n\">{a}</td><td class=\"n\">{b}</td><td class=\"n\">{change}</td></tr>",
            one.title().replace(", us", ", µs")
        );
    }
    html.push_str("</table></div>\n");
    html
}

fn settings(difference: &Difference) -> String {
    if difference.settings.is_empty() {
        return "<h2>Settings</h2>\n<p>No setting differs.</p>\n".to_owned();
    }
    let mut html = "<h2>Settings that differ</h2>\n<div class=\"wide\"><table><tr><th>Where</th><th>Key</th><th>A</th>\
                    <th>B</th></tr>\n"
        .to_owned();
    for setting in &difference.settings {
        let [a, b] = setting.shown().map(escaped);
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td><td>{a}</td><td>{b}</td></tr>",
            escaped(&setting.place),
            escaped(&setting.key)
        );
    }
    html.push_str("</table></div>\n");
    html
}

fn both(
    a: &TaskRun<'_>,
    b: &TaskRun<'_>,
    title: &'static str,
    unit: &'static str,
    value: impl Fn(&Cycle<'_>) -> Option<f64>,
) -> Result<String, ReportError> {
    let axes = Axes {
        title,
        x: "time, s",
        y: unit,
        equal: false,
        reference: None,
        bands: &[],
    };
    let curves: [(&str, Curve); 2] = [
        ("A", plots::curve(a, &value)),
        ("B", plots::curve(b, &value)),
    ];
    plots::figure(&axes, &curves, "")
}
