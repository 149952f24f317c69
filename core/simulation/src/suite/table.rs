//! A suite's report as text, as CSV and as a page.

use std::fmt::{self, Write};

use super::report::{Row, SuiteReport};

/// A figure with `digits` after the point, or a dash.
fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
}

/// Columns of the table, after the surface.
const COLUMNS: [(&str, usize); 13] = [
    ("done", 5),
    ("mean", 5),
    ("p95", 5),
    ("worst", 6),
    ("mm", 5),
    ("mean", 5),
    ("p95", 5),
    ("nees", 5),
    ("slide", 6),
    ("all", 6),
    ("N", 6),
    ("ratio", 6),
    ("lost", 5),
];

impl Row {
    /// Cells of the table, after the surface.
    fn cells(&self) -> [String; 13] {
        [
            format!("{:.0}", self.completed_percent),
            figure(self.normal_deg.mean, 1),
            figure(self.normal_deg.p95, 1),
            figure(self.normal_deg.worst_mean, 1),
            figure(self.settle_mm_p95, 0),
            figure(self.tool_deg.mean, 1),
            figure(self.tool_deg.p95, 1),
            figure(self.nees_per_dof, 1),
            figure(self.force_rmse_percent, 1),
            figure(self.force_rmse_all_percent, 1),
            format!("{:.1}", self.peak_n_max),
            format!("{:.2}", self.peak_ratio_max),
            format!("{:.1}", self.lost_mean),
        ]
    }
}

impl fmt::Display for SuiteReport {
    /// The table, 80 columns wide.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "suite {}: {} draws per surface, seed {}",
            self.suite, self.draws, self.seed
        )?;
        writeln!(
            f,
            "{:<10}{:>5}{:>16}{:>5}{:>10}{:>5}{:>12}{:>12}{:>5}",
            "", "", "normal, deg", "set-", "tool,deg", "", "force rmse,%", "peak", ""
        )?;
        write!(f, "{:<10}", "surface")?;
        for (name, width) in COLUMNS {
            write!(f, "{name:>width$}")?;
        }
        writeln!(f)?;
        for row in &self.rows {
            write!(f, "{:<10}", short(row.surface))?;
            for (cell, (_, width)) in row.cells().iter().zip(COLUMNS) {
                write!(f, "{cell:>width$}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Name of a surface in ten columns with a space behind it.
fn short(name: &str) -> &str {
    match name {
        "torus_outside" => "torus out",
        "torus_inside" => "torus in",
        "waved_sheet" => "waves",
        "height_field" => "heights",
        other => other,
    }
}

impl SuiteReport {
    /// One line per run, with a header.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "surface,draw,completed,phase,landed_deg,normal_mean_deg,tool_mean_deg,settle_mm,nees_per_dof,\
             force_rmse_percent,force_rmse_all_percent,peak_n,peak_ratio,lost,duration_s,fault,digest\n",
        );
        let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.6}"));
        for run in &self.runs {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{:.3},{},{},{},{},{},{},{:.4},{:.4},{},{:.3},\"{}\",{}",
                run.surface.name(),
                run.number,
                run.completed,
                run.phase,
                run.landed_deg,
                number(run.normal_mean_deg),
                number(run.tool_mean_deg),
                number(run.settle_mm),
                number(run.nees_per_dof),
                number(run.force_rmse_percent),
                number(run.force_rmse_all_percent),
                run.peak_n,
                run.peak_ratio,
                run.lost,
                run.duration_s,
                run.fault.unwrap_or_default(),
                run.digest
            );
        }
        text
    }

    /// A page with the table, the commands of the worst draws, and all runs.
    pub fn html(&self) -> String {
        let mut text = String::from(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<title>suite contact</title>\n<style>\
             body{font:14px sans-serif;margin:2em}table{border-collapse:collapse;margin:1em 0}\
             td,th{padding:.2em .6em;border-bottom:1px solid #ccc;text-align:right}\
             td:first-child,th:first-child{text-align:left}.no{background:#fdd}</style>\n",
        );
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "<h1>suite {}</h1>\n<p>{} draws per surface, seed {}, digest {}</p>",
            self.suite, self.draws, self.seed, self.digest
        );
        let heads = [
            "completed, %",
            "normal: mean, deg",
            "p95",
            "worst draw",
            "found after, mm",
            "tool: mean, deg",
            "p95",
            "NEES",
            "force rmse sliding, %",
            "all phases, %",
            "peak, N",
            "peak ratio",
            "lost",
        ];
        text += "<table><tr><th>surface</th>";
        for head in heads {
            let _ = write!(text, "<th>{head}</th>");
        }
        text += "<th>worst draw</th></tr>\n";
        for row in &self.rows {
            let _ = write!(text, "<tr><td>{}</td>", row.surface);
            for cell in row.cells() {
                let _ = write!(text, "<td>{cell}</td>");
            }
            let _ = writeln!(text, "<td><code>{}</code></td></tr>", row.worst);
        }
        text += "</table>\n<h2>Runs</h2>\n<table><tr><th>surface</th><th>draw</th><th>landed, deg</th>\
                 <th>normal, deg</th><th>tool, deg</th><th>peak ratio</th><th>lost</th><th>end</th></tr>\n";
        for run in &self.runs {
            let class = if run.completed { "" } else { " class=\"no\"" };
            let _ = writeln!(
                text,
                "<tr{class}><td>{}</td><td>{}</td><td>{:.1}</td><td>{}</td><td>{}</td><td>{:.2}</td><td>{}</td><td>{}</td></tr>",
                run.surface.name(),
                run.number,
                run.landed_deg,
                figure(run.normal_mean_deg, 2),
                figure(run.tool_mean_deg, 2),
                run.peak_ratio,
                run.lost,
                run.fault.as_deref().unwrap_or(run.phase)
            );
        }
        text += "</table>\n</html>\n";
        text
    }
}
