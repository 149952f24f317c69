//! The phases of a task: their table, and their coloured bands behind the plots.

use std::fmt::Write as _;

use plotters::style::RGBColor;
use tangent_control::Phase;

use crate::plot::Band;
use crate::task_run::TaskRun;

/// Table of the phases with their times and descriptions.
pub(super) fn table(task: &TaskRun<'_>) -> String {
    if task.cycles.is_empty() {
        return String::new();
    }
    let mut html = "<h2>Phases</h2>\n<table><tr><th>Phase</th><th>Meaning</th><th>From</th><th>For</th></tr>\n".to_owned();
    for (phase, from, to) in spans(task) {
        let _ = writeln!(
            html,
            "<tr><td>{}{}</td><td>{}</td><td class=\"n\">{:.2} s</td><td class=\"n\">{:.2} s</td></tr>",
            key(phase),
            phase.name(),
            phase_meaning(phase),
            crate::shown_time::shown_s(from),
            crate::shown_time::shown_s(to - from)
        );
    }
    html.push_str("</table>\n");
    html
}

/// Legend of the bands' colours.
pub(super) fn legend() -> String {
    let keys: Vec<String> = Phase::ALL
        .into_iter()
        .filter(|p| phase_colour(*p).is_some())
        .map(|p| format!("{}{}", key(p), p.name()))
        .collect();
    format!(
        "<p class=\"note\">Time runs from the task's start. Drag over a plot to zoom in, double-click to see all. Shades are the phases: {}</p>\n",
        keys.join(" &nbsp; ")
    )
}

/// Coloured bands for a plot over time.
pub(super) fn bands(task: &TaskRun<'_>) -> Vec<Band> {
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

/// Spans of constant phase: phase, from, to, s.
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

fn phase_colour(phase: Phase) -> Option<RGBColor> {
    Some(match phase {
        Phase::Approach => RGBColor(226, 236, 248),
        Phase::Tare => RGBColor(240, 240, 240),
        Phase::Clear => RGBColor(222, 238, 240),
        Phase::Travel => RGBColor(232, 226, 216),
        Phase::Lift => RGBColor(214, 232, 226),
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
        Phase::Contact => "in contact; the force settles",
        Phase::Slide => "following the path",
        Phase::Retract => "moving off the surface",
        Phase::Done => "ended without a fault",
        Phase::Fault => "ended by a fault",
        Phase::Hold => "pressing, at rest",
        Phase::Seek => "contact lost; moving towards the surface again",
        Phase::Tare => "at rest while the sensor's zero is measured",
        Phase::Travel => "moving in joint space to the start pose, or home",
        Phase::Lift => "above the surface, on the way to the next stroke",
        Phase::Clear => "retracting before a tare, since the tool may be in contact",
    }
}

fn key(phase: Phase) -> String {
    phase_colour(phase).map_or_else(String::new, |RGBColor(r, g, b)| {
        format!("<span class=\"key\" style=\"background:rgb({r},{g},{b})\"></span> ")
    })
}
