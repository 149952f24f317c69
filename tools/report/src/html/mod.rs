//! The report as one self-contained HTML file: figures in plain words, plots, faults, and the
//! contents of the recording.

mod contents;
mod figures;
mod interactive;
mod phases;
mod plots;
mod two;

use std::collections::BTreeSet;

use time::OffsetDateTime;

use crate::difference::Difference;
use crate::error::ReportError;
use crate::figures::Report;
use crate::run::Run;
use crate::task_run::TaskRun;

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
.key { display: inline-block; width: .9em; height: .9em; border: 1px solid #8888; vertical-align: -.1em; }
.wide { overflow-x: auto; } h3 { font-size: 1em; margin: .3em .6em; color: #333; } .drawn { color: #333; }
.drawn canvas { touch-action: none; } .surface canvas { display: block; cursor: grab; } .surface select { font: inherit; margin: .4em; }
.scale { margin: .2em .8em; font-size: .92em; } .bar { display: inline-block; width: 9em; height: .8em; vertical-align: -.05em; }
.uplot, .uplot * { font-family: inherit; } td { overflow-wrap: anywhere; } td.n { overflow-wrap: normal; }
@media (max-width: 600px) { body { margin: 1em auto; } td.n { white-space: normal; } td, th { padding: .3em .4em; }
  figure { overflow-x: auto; } figure svg { min-width: 520px; } }
@media (prefers-color-scheme: dark) { figure { background: #1b1b1f; } figure svg { filter: invert(.9) hue-rotate(180deg); }
  figcaption, h3, .drawn { color: #ccc; } }
@media print { body { max-width: none; margin: 0; color: #000; background: #fff; } figure, tr, .good, .bad {
  break-inside: avoid; } h2, .note { break-after: avoid; } figure svg { filter: none; } details { display: none; } }";

/// What is drawn of a task without its figures.
pub struct Drawn {
    surface: String,
    plots: String,
}

/// Draws a task.
///
/// # Errors
/// A plot cannot be drawn.
pub fn draw(run: &Run, task: &TaskRun<'_>) -> Result<Drawn, ReportError> {
    Ok(Drawn {
        surface: interactive::surface(run, task),
        plots: plots::all(run, task)?,
    })
}

/// Generates the page.
///
/// # Errors
/// A plot cannot be drawn.
pub fn page(
    run: &Run,
    task: &TaskRun<'_>,
    report: &Report,
    drawn: &Drawn,
) -> Result<String, ReportError> {
    let mut html = head(&title(run, report), &result(report));
    html.push_str(&when_and_where(run, task));
    html.push_str(&figures::introduction(task, report));
    html.push_str(&figures::losses(run, report));
    html.push_str(&figures::table(report));
    html.push_str(&phases::table(task));
    html.push_str(&drawn.surface);
    html.push_str("<h2>Plots</h2>\n");
    html.push_str(&phases::legend());
    html.push_str(&drawn.plots);
    html.push_str(&plots::estimators(run, task, report)?);
    html.push_str(&contents::faults(run, task));
    html.push_str(&contents::stored(run));
    html.push_str(&end());
    Ok(html)
}

/// Generates the page that compares two runs, each with its task.
///
/// # Errors
/// A plot cannot be drawn.
pub fn two(
    difference: &Difference,
    a: &TaskRun<'_>,
    b: &TaskRun<'_>,
) -> Result<String, ReportError> {
    let mut html = head(&two::title(difference), "");
    html.push_str(&two::body(difference, a, b)?);
    html.push_str(&end());
    Ok(html)
}

/// End of a page.
fn end() -> String {
    format!("{}</body></html>\n", interactive::script())
}

/// Beginning of a page, up to its heading. The operator's page reads the result from it.
fn head(title: &str, result: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"tangent-result\" content=\"{2}\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{0}</title><style>{1}{STYLE}</style></head><body>\n<h1>{0}</h1>\n",
        escaped(title),
        interactive::style(),
        escaped(result)
    )
}

/// Date, hosts, cell and version, as far as the recording holds them.
fn when_and_where(run: &Run, task: &TaskRun<'_>) -> String {
    let mut known = Vec::new();
    if let Ok(began) = OffsetDateTime::from_unix_timestamp_nanos(task.start_ns.into()) {
        known.push(format!(
            "{} {:02}:{:02}:{:02} UTC",
            began.date(),
            began.hour(),
            began.minute(),
            began.second()
        ));
    }
    if let Some(cell) = run.fact("cell") {
        known.push(format!("cell {cell}"));
    }
    let hosts: BTreeSet<&str> = run.health.values().map(|h| h.host.as_str()).collect();
    if !hosts.is_empty() {
        let hosts: Vec<&str> = hosts.into_iter().collect();
        known.push(format!("host {}", hosts.join(", ")));
    }
    if let Some(version) = run.fact("version") {
        known.push(format!("tangent {version}"));
    }
    format!("<p class=\"note\">{}</p>\n", escaped(&known.join(" - ")))
}

/// How the task ended, in one line.
fn result(report: &Report) -> String {
    let verdict = report.events.verdict_words(report.fault.as_deref());
    let name = report.task_entry().map_or("", |task| task.name.as_str());
    let accepted = match report.accepted {
        None => "",
        Some(true) => "; ACCEPTED",
        Some(false) => "; REJECTED",
    };
    format!("{name}: {verdict}{accepted}")
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

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
