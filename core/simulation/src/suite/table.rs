//! A suite's report as text, as CSV and as a page.

use std::fmt::{self, Write};

use super::figures::Figures;
use super::report::{ConditionRow, SuiteReport};

/// A figure with `digits` after the point, or a dash.
fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |x| format!("{x:.digits$}"))
}

/// Columns of both tables, after the name.
const COLUMNS: [(&str, usize); 13] = [
    ("done", 6),
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

impl Figures {
    /// Cells of a row, after its name.
    fn cells(&self) -> [String; 13] {
        [
            format!("{:.1}", self.completed_percent),
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
    /// Both tables, 80 columns wide.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "suite {}: {} draws per surface, seed {}",
            self.suite, self.draws, self.seed
        )?;
        write_head(f, "surface")?;
        for row in &self.rows {
            write_row(f, short(row.surface), &row.figures)?;
        }
        writeln!(f, "\nthe same runs by what was drawn")?;
        write_head(f, "drawn")?;
        let mut kind = "";
        for row in &self.conditions {
            if row.is_of_all() {
                write_row(f, row.condition, &row.figures)?;
                continue;
            }
            if row.kind != kind {
                kind = row.kind;
                writeln!(f, "{kind}")?;
            }
            write_row(f, &format!(" {}", row.condition), &row.figures)?;
        }
        Ok(())
    }
}

/// The two lines above a table, with a name for its first column.
fn write_head(f: &mut fmt::Formatter<'_>, first: &str) -> fmt::Result {
    let blank = "";
    writeln!(
        f,
        "{blank:15}{:>16}{:>5}{:>10}{blank:5}{:>12}{:>12}",
        "normal, deg", "set-", "tool,deg", "force rmse,%", "peak"
    )?;
    write!(f, "{first:<9}")?;
    for (name, width) in COLUMNS {
        write!(f, "{name:>width$}")?;
    }
    writeln!(f)
}

fn write_row(f: &mut fmt::Formatter<'_>, name: &str, figures: &Figures) -> fmt::Result {
    write!(f, "{name:<9}")?;
    for (cell, (_, width)) in figures.cells().iter().zip(COLUMNS) {
        write!(f, "{cell:>width$}")?;
    }
    writeln!(f)
}

/// Name of a surface in nine columns.
fn short(name: &str) -> &str {
    match name {
        "torus_outside" => "torus out",
        "torus_inside" => "torus in",
        "waved_sheet" => "waves",
        "height_field" => "heights",
        other => other,
    }
}

impl ConditionRow {
    /// Whether the row is that of all runs.
    fn is_of_all(&self) -> bool {
        self.kind == self.condition
    }

    /// Name of the row on a page.
    fn name(&self) -> String {
        if self.is_of_all() {
            return self.condition.to_owned();
        }
        format!("{}: {}", self.kind, self.condition)
    }
}

impl SuiteReport {
    /// One line per run, with a header.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "surface,draw,completed,phase,reference_n,stiffness_kn_per_m,tip,stated_tip,landed_deg,\
             friction,speed_mm_per_s,robot,normal_mean_deg,tool_mean_deg,settle_mm,nees_per_dof,\
             force_rmse_percent,force_rmse_all_percent,peak_n,peak_ratio,lost,duration_s,fault,digest\n",
        );
        let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.6}"));
        for run in &self.runs {
            let drawn = &run.conditions;
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "{},{},{},{},{:.4},{:.4},{},{},{:.3},{:.4},{:.3},{},",
                run.surface.name(),
                run.number,
                run.completed,
                run.phase,
                drawn.reference_n,
                drawn.stiffness_kn_per_m,
                drawn.tip,
                drawn.stated_tip,
                drawn.landed_deg,
                drawn.friction,
                drawn.speed_mm_per_s,
                drawn.robot
            );
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{:.4},{:.4},{},{:.3},\"{}\",{}",
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

    /// A page with both tables, the commands of the worst draws, and all runs.
    pub fn html(&self) -> String {
        let mut text = String::from(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<title>suite contact</title>\n<style>\
             body{font:14px sans-serif;margin:2em}table{border-collapse:collapse;margin:1em 0}\
             td,th{padding:.2em .6em;border-bottom:1px solid #ccc;text-align:right}\
             td:first-child,th:first-child{text-align:left}code{white-space:nowrap}.no{background:#fdd}</style>\n",
        );
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "<h1>suite {}</h1>\n<p>{} draws per surface, seed {}, digest {}</p>",
            self.suite, self.draws, self.seed, self.digest
        );
        let rows = self.rows.iter();
        write_table(
            &mut text,
            "surface",
            rows.map(|row| (row.surface.to_owned(), &row.figures)),
        );
        text += "<h2>The same runs by what was drawn</h2>\n";
        let rows = self.conditions.iter();
        write_table(
            &mut text,
            "drawn",
            rows.map(|row| (row.name(), &row.figures)),
        );
        text += "<h2>Runs</h2>\n<table><tr><th>surface</th><th>draw</th><th>landed, deg</th>\
                 <th>normal, deg</th><th>tool, deg</th><th>peak ratio</th><th>lost</th><th>end</th></tr>\n";
        for run in &self.runs {
            let class = if run.completed { "" } else { " class=\"no\"" };
            let _ = writeln!(
                text,
                "<tr{class}><td>{}</td><td>{}</td><td>{:.1}</td><td>{}</td><td>{}</td><td>{:.2}</td><td>{}</td><td>{}</td></tr>",
                run.surface.name(),
                run.number,
                run.conditions.landed_deg,
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

/// A table of a page, with a name for its first column.
fn write_table<'a>(
    text: &mut String,
    first: &str,
    rows: impl Iterator<Item = (String, &'a Figures)>,
) {
    let heads = [
        "draws",
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
        "worst draw",
    ];
    // Writing to a string cannot fail.
    let _ = write!(text, "<table><tr><th>{first}</th>");
    for head in heads {
        let _ = write!(text, "<th>{head}</th>");
    }
    *text += "</tr>\n";
    for (name, figures) in rows {
        let _ = write!(text, "<tr><td>{name}</td><td>{}</td>", figures.draws);
        for cell in figures.cells() {
            let _ = write!(text, "<td>{cell}</td>");
        }
        let _ = writeln!(text, "<td><code>{}</code></td></tr>", figures.worst);
    }
    *text += "</table>\n";
}
