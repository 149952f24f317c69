//! The report as one HTML file that needs nothing else: figures in plain words, plots, faults, and what was stored.

use std::fmt::Write as _;

use anyhow::Result;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use plotters::style::RGBColor;
use tangent_control::Phase;
use tangent_simulation::metrics::{Spread, angle_deg};

use super::figures::{Cycle, Report, TaskRun};
use super::plot::{self, Axes, Band, Series};
use super::run::Run;

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; margin-bottom: .2em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; width: 100%; } td, th { padding: .3em .7em; text-align: left; vertical-align: top;
  border-bottom: 1px solid #8884; } td.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
th { font-weight: 600; } .note { opacity: .75; font-size: .92em; } figure { margin: 1.2em 0; background: #fff;
  border: 1px solid #8884; border-radius: 4px; padding: 4px; } figure svg { width: 100%; height: auto; display: block; }
figcaption { font-size: .92em; padding: .2em .8em .5em; color: #333; } pre { overflow-x: auto; background: #8881;
  padding: .8em; border-radius: 4px; font-size: .88em; } .bad { border-left: 4px solid #c33; padding: .3em .8em;
  background: #c331; } .good { border-left: 4px solid #383; padding: .3em .8em; background: #3831; }
.key { display: inline-block; width: .9em; height: .9em; border: 1px solid #8888; vertical-align: -.1em; }";

/// The page.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn page(run: &Run, task: &TaskRun<'_>, report: &Report) -> Result<String> {
    let mut html = String::new();
    let title = title(run, report);
    let _ = write!(
        html,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{0}</title><style>{STYLE}</style></head><body>\n<h1>{0}</h1>\n",
        escaped(&title)
    );
    html.push_str(&introduction(task, report));
    html.push_str(&losses(run, report));
    html.push_str(&headline(report));
    html.push_str(&phases(task));
    html.push_str("<h2>Plots</h2>\n");
    html.push_str(&phase_key());
    html.push_str(&plots(run, task)?);
    html.push_str(&estimators(run, task, report)?);
    html.push_str(&faults(run, task));
    html.push_str(&stored(run));
    html.push_str("</body></html>\n");
    Ok(html)
}

fn title(run: &Run, report: &Report) -> String {
    let name = run
        .control
        .iter()
        .rev()
        .map(|c| c.task.as_str())
        .find(|name| !name.is_empty());
    let cell = run.fact("cell").unwrap_or("cell");
    match (name, &report.scenario) {
        (Some(name), Some(scenario)) => format!("{name} - {cell}, simulated: {scenario}"),
        (Some(name), None) => format!("{name} - {cell}"),
        _ => format!("Recording of {cell}"),
    }
}

fn introduction(task: &TaskRun<'_>, report: &Report) -> String {
    if task.cycles.is_empty() {
        return "<p>No task was started while this was recorded: there are no figures of force, path or normal.</p>\n"
            .to_owned();
    }
    let more = if report.recording.tasks > 1 {
        format!(
            " The recording holds {} tasks; this page is about the last one.",
            report.recording.tasks
        )
    } else {
        String::new()
    };
    let truth = if task.cycles.iter().any(|c| c.truth.is_some()) {
        "The cell was simulated, so what really happened at the contact is known: errors of the normal and the \
         force are against that truth."
    } else {
        "There is no ground truth in this recording: forces are as measured, and the normal can only be compared with \
         the tool's axis."
    };
    format!(
        "<p>A robot pressed a tool on a surface, estimated where the surface faces, kept the tool square to it and \
         followed a path. The task took {:.1} s in {} robot cycles and ended in phase <b>{}</b>. Estimator: <b>{}</b>; \
         control law: preset <b>{}</b>.{more} {truth}</p>\n",
        report.duration_s,
        report.steps,
        report.phase.unwrap_or("unknown"),
        escaped(report.estimator.as_deref().unwrap_or("none")),
        escaped(report.controller.as_deref().unwrap_or("unknown")),
    )
}

fn losses(run: &Run, report: &Report) -> String {
    let mut lines = Vec::new();
    for path in &run.truncated {
        lines.push(format!(
            "{} lacks its end (its recorder was killed or the file was cut): read up to its last whole chunk.",
            path.display()
        ));
    }
    for damage in &run.damages {
        lines.push(format!("{damage}; what follows the damage was not read."));
    }
    if report.recording.undecodable > 0 {
        lines.push(format!(
            "{} messages do not decode: they were recorded by another version or damaged.",
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
        return "<p class=\"good\">Nothing was lost that should be in this recording.</p>\n"
            .to_owned();
    }
    let items: String = lines
        .iter()
        .map(|line| format!("<li>{}</li>", escaped(line)))
        .collect();
    format!("<div class=\"bad\"><b>Something was lost.</b><ul>{items}</ul></div>\n")
}

fn headline(report: &Report) -> String {
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
            "The same once settled",
            "from 1 s after first contact",
            spread(&f.normal_error_settled_deg),
        ),
        (
            "Tool against the surface, mean / RMS",
            "how far the tool really was from square",
            spread(&f.tool_error_deg),
        ),
        (
            "Tool against the estimate, mean / RMS",
            "how well the tool follows what is estimated",
            spread(&f.alignment_error_deg),
        ),
        (
            "Honesty of the estimator",
            "squared error over claimed variance (NEES per degree of freedom): 1 is right, more is overconfident",
            number(f.normal_nees_per_dof, 2, ""),
        ),
        (
            "Force: asked for",
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
            "peak above what was asked for",
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
            "time in which the program answers a robot's packet",
            latency.map(|q| format!("{:.0} / {:.0} / {:.0} µs", q.p50, q.p99, q.max)),
        ),
        (
            "Cycles missed",
            "a command was due and none was fresh",
            report.r#loop.missed_cycles.map(|n| n.to_string()),
        ),
        (
            "Sensor records lost",
            "",
            report.r#loop.wrench_records_lost.map(|n| n.to_string()),
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

fn phase_colour(phase: Phase) -> Option<RGBColor> {
    Some(match phase {
        Phase::Approach => RGBColor(226, 236, 248),
        Phase::Tare => RGBColor(240, 240, 240),
        Phase::Contact => RGBColor(253, 240, 214),
        Phase::Slide => RGBColor(228, 244, 229),
        Phase::Hold => RGBColor(247, 247, 219),
        Phase::Seek => RGBColor(250, 224, 238),
        Phase::Retract => RGBColor(236, 228, 246),
        Phase::Fault => RGBColor(248, 212, 212),
        Phase::Idle | Phase::Done => return None,
    })
}

fn phase_meaning(phase: Phase) -> &'static str {
    match phase {
        Phase::Idle => "nothing to do",
        Phase::Approach => "moving towards the surface",
        Phase::Contact => "touched it; the force settles",
        Phase::Slide => "following the path",
        Phase::Retract => "moving off the surface",
        Phase::Done => "ended as it should",
        Phase::Fault => "ended by a fault",
        Phase::Hold => "pressing, standing still",
        Phase::Seek => "lost the surface, moving towards it again",
        Phase::Tare => "standing still while the sensor's zero is taken",
    }
}

/// Spans of equal phase: phase, from, to, s.
fn spans(task: &TaskRun<'_>) -> Vec<(Phase, f64, f64)> {
    let mut spans: Vec<(Phase, f64, f64)> = Vec::new();
    for cycle in &task.cycles {
        match spans.last_mut() {
            Some((phase, _, to)) if *phase == cycle.sample.phase => *to = cycle.time_s,
            last => {
                if let Some((_, _, to)) = last {
                    *to = cycle.time_s;
                }
                spans.push((cycle.sample.phase, cycle.time_s, cycle.time_s));
            }
        }
    }
    spans
}

fn phases(task: &TaskRun<'_>) -> String {
    if task.cycles.is_empty() {
        return String::new();
    }
    let mut html = "<h2>Phases</h2>\n<table><tr><th>Phase</th><th>What it is</th><th>From</th><th>For</th></tr>\n".to_owned();
    for (phase, from, to) in spans(task) {
        let _ = writeln!(
            html,
            "<tr><td>{}{}</td><td>{}</td><td class=\"n\">{from:.2} s</td><td class=\"n\">{:.2} s</td></tr>",
            key(phase),
            phase.name(),
            phase_meaning(phase),
            to - from
        );
    }
    html.push_str("</table>\n");
    html
}

fn key(phase: Phase) -> String {
    phase_colour(phase).map_or_else(String::new, |RGBColor(r, g, b)| {
        format!("<span class=\"key\" style=\"background:rgb({r},{g},{b})\"></span> ")
    })
}

fn phase_key() -> String {
    let keys: Vec<String> = Phase::ALL
        .into_iter()
        .filter(|p| phase_colour(*p).is_some())
        .map(|p| format!("{}{}", key(p), p.name()))
        .collect();
    format!(
        "<p class=\"note\">Time runs from the task's start. Shades are the phases: {}</p>\n",
        keys.join(" &nbsp; ")
    )
}

fn curve(task: &TaskRun<'_>, value: impl Fn(&Cycle<'_>) -> Option<f64>) -> Vec<(f64, f64)> {
    task.cycles
        .iter()
        .map(|c| (c.time_s, value(c).unwrap_or(f64::NAN)))
        .collect()
}

fn figure(axes: &Axes<'_>, series: &[(&str, Vec<(f64, f64)>)], caption: &str) -> Result<String> {
    let drawn: Vec<Series<'_>> = series
        .iter()
        .zip(plot::PALETTE.iter().cycle())
        .filter(|((_, points), _)| points.iter().any(|p| p.1.is_finite()))
        .map(|((name, points), colour)| Series {
            name,
            points,
            colour: *colour,
        })
        .collect();
    if drawn.is_empty() {
        return Ok(String::new());
    }
    let svg = plot::draw(axes, &drawn)?;
    Ok(format!(
        "<figure>{svg}<figcaption>{caption}</figcaption></figure>\n"
    ))
}

fn plots(run: &Run, task: &TaskRun<'_>) -> Result<String> {
    let bands = bands(task);
    let axes = |title: &'static str, y: &'static str| Axes {
        title,
        x: "time, s",
        y,
        equal: false,
        reference: None,
        bands: &bands,
    };
    let touching = |c: &Cycle<'_>| c.truth.map_or(c.sample.in_contact, |t| t.in_contact);
    let mut html = figure(
        &axes("Pressing force", "N"),
        &[
            ("measured", curve(task, |c| Some(c.control.force_n))),
            (
                "asked for",
                curve(task, |c| Some(c.control.force_reference_n)),
            ),
            ("true", curve(task, |c| Some(c.sample.truth?.force_n))),
        ],
        "Force along the surface normal; positive presses.",
    )?;
    html += &figure(
        &axes("Angles", "degrees"),
        &[
            (
                "estimate against truth",
                curve(task, |c| {
                    let estimate = c.sample.estimate.filter(|_| touching(c))?;
                    Some(angle_deg(&estimate.normal, &c.sample.truth?.normal))
                }),
            ),
            (
                "tool against estimate",
                curve(task, |c| {
                    let estimate = c.sample.estimate.filter(|_| touching(c))?;
                    Some(angle_deg(&estimate.normal, &-c.sample.tool_z))
                }),
            ),
            (
                "tool against truth",
                curve(task, |c| {
                    let truth = c.sample.truth.filter(|t| t.in_contact)?;
                    Some(angle_deg(&truth.normal, &-truth.tool_z))
                }),
            ),
        ],
        "While in contact: how wrong the estimated normal is, and how far the tool is from square to it.",
    )?;
    html += &path(task)?;
    html += &figure(
        &axes("Age of the controller's inputs", "ms"),
        &[
            (
                "wrench",
                curve(task, |c| positive(1e3 * c.control.wrench_age_s)),
            ),
            (
                "estimate",
                curve(task, |c| positive(1e3 * c.control.estimate_age_s)),
            ),
            (
                "arm state",
                curve(task, |c| positive(1e3 * c.control.arm_state_age_s)),
            ),
        ],
        "How old what the controller acted on was when its command left.",
    )?;
    html += &figure(
        &axes("Robot packet to command", "µs"),
        &[(
            "packet to command",
            curve(task, |c| positive(1e6 * c.arm.packet_to_command_s)),
        )],
        "From the arrival of a robot's packet to the departure of the answer.",
    )?;
    let joints: Vec<(String, Vec<(f64, f64)>)> = (0..7)
        .map(|j| {
            let speed = curve(task, |c| c.arm.qd.get(j).copied());
            (format!("joint {}", j + 1), speed)
        })
        .collect();
    let joints: Vec<(&str, Vec<(f64, f64)>)> = joints
        .iter()
        .map(|(name, points)| (name.as_str(), points.clone()))
        .collect();
    html += &figure(&axes("Joint speeds", "rad/s"), &joints, "As measured.")?;
    if run.truth.is_empty() {
        html += "<p class=\"note\">Without a simulator there is no truth to plot against.</p>\n";
    }
    Ok(html)
}

fn bands(task: &TaskRun<'_>) -> Vec<Band> {
    spans(task)
        .into_iter()
        .filter_map(|(phase, from, to)| {
            Some(Band {
                from,
                to,
                colour: phase_colour(phase)?,
            })
        })
        .collect()
}

fn positive(value: f64) -> Option<f64> {
    (value > 0.0 && value.is_finite()).then_some(value)
}

/// The path in the plane that fits its reference best.
fn path(task: &TaskRun<'_>) -> Result<String> {
    let sliding: Vec<&Cycle<'_>> = task
        .cycles
        .iter()
        .filter(|c| matches!(c.sample.phase, Phase::Slide | Phase::Hold))
        .collect();
    if sliding.len() < 2 {
        return Ok(String::new());
    }
    let count = sliding.len() as f64;
    let centre = sliding
        .iter()
        .map(|c| c.sample.path_reference)
        .sum::<Vector3<f64>>()
        / count;
    let covariance: Matrix3<f64> = sliding
        .iter()
        .map(|c| {
            let d = c.sample.path_reference - centre;
            d * d.transpose()
        })
        .sum();
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axis = |i: usize| eigen.eigenvectors.column(order[i]).into_owned();
    let (u, v) = (axis(0), axis(1));
    let flat = |p: Vector3<f64>| {
        let d = p - centre;
        (1e3 * d.dot(&u), 1e3 * d.dot(&v))
    };
    let axes = Axes {
        title: "Path on the surface",
        x: "mm, along the longer side",
        y: "mm, across",
        equal: true,
        reference: None,
        bands: &[],
    };
    let points = |of: fn(&Cycle<'_>) -> Vector3<f64>| sliding.iter().map(|c| flat(of(c))).collect();
    figure(
        &axes,
        &[
            ("wanted", points(|c| c.sample.path_reference)),
            ("tool", points(|c| c.sample.tool_position)),
        ],
        "Seen from above the plane that fits the path best; both axes have the same scale.",
    )
}

fn estimators(run: &Run, task: &TaskRun<'_>, report: &Report) -> Result<String> {
    if report.estimators.is_empty() {
        return Ok(String::new());
    }
    let mut html = "<h2>Estimators side by side</h2>\n<table><tr><th>Estimator</th><th>Error, mean / RMS</th>\
                    <th>Settled, mean / RMS</th><th>Tool against it, mean / RMS</th><th>NEES</th></tr>\n"
        .to_owned();
    let spread = |s: Option<Spread>| {
        s.map_or_else(
            || "-".to_owned(),
            |s| format!("{:.2}° / {:.2}°", s.mean, s.rmse),
        )
    };
    for (name, figures) in &report.estimators {
        let used = if report.estimator.as_ref() == Some(name) {
            " (in use)"
        } else {
            ""
        };
        let _ = writeln!(
            html,
            "<tr><td>{}{used}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td></tr>",
            escaped(name),
            spread(figures.normal_error_deg),
            spread(figures.normal_error_settled_deg),
            spread(figures.alignment_error_deg),
            figures
                .normal_nees_per_dof
                .map_or_else(|| "-".to_owned(), |n| format!("{n:.2}")),
        );
    }
    html.push_str("</table>\n");
    if report.estimators.len() > 1 && task.cycles.iter().any(|c| c.truth.is_some()) {
        let bands = bands(task);
        let axes = Axes {
            title: "Error of each estimator",
            x: "time, s",
            y: "degrees",
            equal: false,
            reference: None,
            bands: &bands,
        };
        let curves: Vec<(&str, Vec<(f64, f64)>)> = report
            .estimators
            .keys()
            .map(|name| {
                let points = task
                    .samples_with(run, name)
                    .iter()
                    .map(|s| {
                        let angle = s.truth.filter(|t| t.in_contact).zip(s.estimate);
                        let angle = angle.map(|(t, e)| angle_deg(&e.normal, &t.normal));
                        (s.time_s, angle.unwrap_or(f64::NAN))
                    })
                    .collect();
                (name.as_str(), points)
            })
            .collect();
        html += &figure(&axes, &curves, "Against the truth, while in contact.")?;
    }
    Ok(html)
}

fn faults(run: &Run, task: &TaskRun<'_>) -> String {
    if run.faults.is_empty() {
        return "<h2>Faults</h2>\n<p>No service reported one.</p>\n".to_owned();
    }
    let mut html =
        "<h2>Faults and notices</h2>\n<table><tr><th>When</th><th>Who and what</th></tr>\n"
            .to_owned();
    /// More is a page that nobody reads; the recording has them all.
    const ROWS: usize = 100;
    for (at_ns, text) in run.faults.iter().take(ROWS) {
        let at_s = (at_ns - task.start_ns) as f64 * 1e-9;
        let _ = writeln!(
            html,
            "<tr><td class=\"n\">{at_s:+.2} s</td><td>{}</td></tr>",
            escaped(text)
        );
    }
    html.push_str("</table>\n");
    if run.faults.len() > ROWS {
        let _ = writeln!(html, "<p>And {} more.</p>", run.faults.len() - ROWS);
    }
    html
}

fn stored(run: &Run) -> String {
    let mut html = "<h2>What the recording holds</h2>\n<table><tr><th>Topic</th><th>Type</th><th>Messages</th></tr>\n".to_owned();
    for (topic, (type_name, count)) in &run.topics {
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{count}</td></tr>",
            escaped(topic),
            escaped(type_name)
        );
    }
    html.push_str("</table>\n");
    for (name, table) in &run.tables {
        let _ = write!(
            html,
            "<details><summary>{}</summary><table>",
            escaped(table_title(name))
        );
        for (key, value) in table {
            let _ = write!(
                html,
                "<tr><td>{}</td><td>{}</td></tr>",
                escaped(key),
                escaped(value)
            );
        }
        html.push_str("</table></details>\n");
    }
    for (name, text) in &run.attachments {
        let _ = writeln!(
            html,
            "<details><summary>{}</summary><pre>{}</pre></details>",
            escaped(name),
            escaped(text)
        );
    }
    let files: Vec<String> = run.files.iter().map(|f| f.display().to_string()).collect();
    let _ = writeln!(
        html,
        "<p class=\"note\">Recorded by tangent {} into {}; this page by tangent {}.</p>",
        escaped(run.fact("version").unwrap_or("of unknown version")),
        escaped(&files.join(", ")),
        env!("CARGO_PKG_VERSION")
    );
    html
}

fn table_title(name: &str) -> &str {
    match name {
        "tangent" => "Version and names",
        "parameters" => "Parameters of all services",
        "losses" => "Messages taken and lost by the recorder",
        "repaired" => "Repair: the file had no end and was mended",
        other => other,
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
