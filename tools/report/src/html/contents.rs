//! Sections of the page on faults and on the contents of the recording.

use std::fmt::Write as _;

use super::escaped;
use crate::run::Run;
use crate::task_run::TaskRun;

pub(super) fn faults(run: &Run, task: &TaskRun<'_>) -> String {
    if run.faults.is_empty() {
        return "<h2>Faults</h2>\n<p>No service reported one.</p>\n".to_owned();
    }
    let mut html =
        "<h2>Faults and notices</h2>\n<table><tr><th>When</th><th>Service and message</th></tr>\n"
            .to_owned();
    /// Largest number of rows in a table of the page; the recording has all of them.
    const ROWS: usize = 100;
    for (at_ns, text) in run.faults.iter().take(ROWS) {
        let at_s = crate::shown_time::shown_s((at_ns - task.start_ns) as f64 * 1e-9);
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

pub(super) fn stored(run: &Run) -> String {
    let mut html = "<h2>What the recording holds</h2>\n<div class=\"wide\"><table><tr><th>Topic</th><th>Type</th><th>Messages</th></tr>\n".to_owned();
    for (topic, (type_name, count)) in &run.topics {
        let _ = writeln!(
            html,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{count}</td></tr>",
            escaped(topic),
            escaped(type_name)
        );
    }
    html.push_str("</table></div>\n");
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
        "losses" => "Messages recorded and lost by the recorder",
        "repaired" => "Repair: the file had no end and was repaired",
        other => other,
    }
}
