//! The report as one self-contained HTML file: figures in plain words, plots, faults, and the
//! contents of the recording.

mod contents;
mod figures;
mod phases;
mod plots;

use std::fmt::Write as _;

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
.key { display: inline-block; width: .9em; height: .9em; border: 1px solid #8888; vertical-align: -.1em; }";

/// Generates the page.
///
/// # Errors
/// A plot cannot be drawn.
pub fn page(run: &Run, task: &TaskRun<'_>, report: &Report) -> Result<String, ReportError> {
    let mut html = String::new();
    let title = title(run, report);
    let _ = write!(
        html,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{0}</title><style>{STYLE}</style></head><body>\n<h1>{0}</h1>\n",
        escaped(&title)
    );
    html.push_str(&figures::introduction(task, report));
    html.push_str(&figures::losses(run, report));
    html.push_str(&figures::table(report));
    html.push_str(&phases::table(task));
    html.push_str("<h2>Plots</h2>\n");
    html.push_str(&phases::legend());
    html.push_str(&plots::all(run, task)?);
    html.push_str(&plots::estimators(run, task, report)?);
    html.push_str(&contents::faults(run, task));
    html.push_str(&contents::stored(run));
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

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
