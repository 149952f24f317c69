//! Data of the page's script: plots to zoom into, and the surface in 3D. Without the script, the
//! page shows the plots as pictures.

use std::fmt::Write as _;

use nalgebra::Vector3;
use serde_json::{Value, json};
use tangent_control::CoverageSpec;
use tangent_mechanics::{Base, Pose, Tip, Tool, World};
use tangent_page_libraries::{UPLOT, UPLOT_STYLE};
use tangent_runtime::CellConfig;
use tangent_scene::dose::{Cell, DoseMap};
use tangent_scene::{Pressed, cover_radius_m};
use tangent_simulation::metrics::angle_deg;

use crate::plot::{Axes, Series};
use crate::run::Run;
use crate::task_run::{Cycle, TaskRun};

const SCRIPT: &str = include_str!("page.js");
/// Parts of a plot of which each keeps its least and its greatest values.
const PARTS: usize = 1500;
/// Most points of the path in 3D.
const PATH_POINTS: usize = 6000;
/// Decimal places of positions in millimetres.
const MM_DIGITS: i32 = 2;

/// Style of uPlot, for the head of a page.
pub(super) fn style() -> &'static str {
    UPLOT_STYLE
}

/// The script with the library it draws with, for the end of a page.
pub(super) fn script() -> String {
    let library = UPLOT.trim_end();
    let library = library
        .strip_suffix("export { uPlot as default };")
        .unwrap_or(library);
    format!("<script type=\"module\">\n{library}\n{SCRIPT}</script>\n")
}

/// Data of a plot over time; empty if its curves do not share their times.
pub(super) fn plot(axes: &Axes<'_>, series: &[Series<'_>]) -> String {
    let Some(first) = series.first() else {
        return String::new();
    };
    let same = |one: &Series<'_>| {
        let times = one.points.iter().map(|p| p.0);
        times.eq(first.points.iter().map(|p| p.0))
    };
    if axes.equal || !axes.x.starts_with("time") || !series.iter().all(same) {
        return String::new();
    }
    let rows = kept_rows(series);
    let column = |one: &Series<'_>, pick: fn(&(f64, f64)) -> f64| -> Vec<Value> {
        rows.iter()
            .map(|&i| short(pick(&one.points[i]), 5))
            .collect()
    };
    let curves: Vec<Value> = series
        .iter()
        .map(|one| {
            let (r, g, b) = (one.colour.0, one.colour.1, one.colour.2);
            json!({ "name": one.name, "colour": [r, g, b], "y": column(one, |p| p.1) })
        })
        .collect();
    let bands: Vec<Value> = axes
        .bands
        .iter()
        .map(|band| {
            let (r, g, b) = (band.colour.0, band.colour.1, band.colour.2);
            json!([short(band.from, 6), short(band.to, 6), [r, g, b]])
        })
        .collect();
    data(&json!({
        "title": axes.title, "unit": axes.y, "x": column(first, |p| p.0), "curves": curves,
        "bands": bands,
    }))
}

/// Rows of a plot that are kept: in each part of it, those with the least and the greatest value of
/// any curve, so that no peak is lost.
fn kept_rows(series: &[Series<'_>]) -> Vec<usize> {
    let count = series.first().map_or(0, |one| one.points.len());
    if count <= 2 * PARTS {
        return (0..count).collect();
    }
    let mut kept = Vec::new();
    let width = count.div_ceil(PARTS);
    for from in (0..count).step_by(width) {
        let part = from..(from + width).min(count);
        kept.push(from);
        for one in series {
            let value = |i: &usize| one.points[*i].1;
            let finite = || part.clone().filter(|i| value(i).is_finite());
            let by = |a: &usize, b: &usize| value(a).total_cmp(&value(b));
            kept.extend(finite().min_by(by));
            kept.extend(finite().max_by(by));
            // A gap stays a gap.
            kept.extend(part.clone().find(|i| !value(i).is_finite()));
        }
    }
    kept.push(count - 1);
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// The path of the tool and the dose of pressure on the surface, in 3D; empty if the tool did not
/// slide.
pub(super) fn surface(run: &Run, task: &TaskRun<'_>) -> String {
    let sliding = task.sliding();
    if sliding.len() < 2 {
        return String::new();
    }
    let cell_file = cell_file(run);
    let tip = (cell_file.as_ref()).map_or(Tip::Unknown, |cell| cell.tool.tip.tip());
    let coverage = coverage(run, task);
    let band = coverage
        .as_ref()
        .and_then(|coverage| coverage.dose_n_s_per_cm2)
        .or_else(|| cell_file.and_then(|cell| cell.ui.dose_band_n_s_per_cm2));
    let radius_m =
        (coverage.and_then(|coverage| coverage.radius_m)).unwrap_or_else(|| cover_radius_m(&tip));
    let map = dose(task, &tip, radius_m);
    let stride = sliding.len().div_ceil(PATH_POINTS);
    let shown: Vec<&Cycle<'_>> = sliding.iter().step_by(stride).copied().collect();
    let of = |value: &dyn Fn(&Cycle<'_>) -> Option<f64>| -> Vec<Value> {
        let value = |c: &&Cycle<'_>| short(value(c).unwrap_or(f64::NAN), 4);
        shown.iter().map(value).collect()
    };
    let values = [
        ("force", "N", of(&|c| c.sample.pressing_n())),
        (
            "error of the force",
            "N",
            of(&|c| Some(c.sample.pressing_n()? - c.sample.force_reference_n)),
        ),
        ("tool against the surface", "°", of(&tool_angle)),
        (
            "distance from the path",
            "mm",
            of(&|c| Some(1e3 * c.sample.path_error_m)),
        ),
    ];
    let values: Vec<Value> = values
        .into_iter()
        .filter(|(_, _, values)| values.iter().any(|v| !v.is_null()))
        .map(|(name, unit, values)| json!({ "name": name, "unit": unit, "v": values }))
        .collect();
    let judged = map.judge(band);
    let cells: Vec<Value> = map.cells().iter().map(cell).collect();
    let holes: Vec<Value> = judged.holes.iter().map(place).collect();
    let path: Vec<Value> = shown
        .iter()
        .map(|c| place(&c.sample.tool_position))
        .collect();
    let wanted: Vec<Value> = shown
        .iter()
        .map(|c| place(&c.sample.path_reference))
        .collect();
    let good = match band {
        Some([least, most]) => format!("{least} to {most} N s/cm²"),
        None => "half to twice the median dose".to_owned(),
    };
    let words = format!(
        "{:.1} N s pressed onto {:.1} cm², {:.0} % of it with {good}; {} {}.",
        map.impulse_n_s(),
        judged.area_cm2,
        100.0 * judged.good_cm2 / judged.area_cm2.max(f64::MIN_POSITIVE),
        judged.holes.len(),
        if judged.holes.len() == 1 {
            "cell is a hole"
        } else {
            "cells are holes"
        },
    );
    let data = data(&json!({
        "path": path, "wanted": wanted, "values": values, "cells": cells, "holes": holes,
        "cell": short(1e3 * map.cell_m(), 4), "band": judged.band.map(|b| short(b, 4)),
    }));
    format!(
        "<h2>The surface</h2>\n<figure class=\"surface\">{data}<figcaption>Dose of pressure: {words} Axes of the base; \
         drag to turn, scroll to zoom, double-click to reset.</figcaption></figure>\n"
    )
}

/// Angle of the tool to the true normal, else to the estimated one, degrees.
fn tool_angle(cycle: &Cycle<'_>) -> Option<f64> {
    let sample = &cycle.sample;
    match sample.truth {
        Some(truth) => Some(angle_deg(&truth.normal, &-truth.tool_z)),
        None => Some(angle_deg(&sample.estimate?.normal, &-sample.tool_z)),
    }
}

/// The cell file of the recording.
fn cell_file(run: &Run) -> Option<CellConfig> {
    CellConfig::parse("cell.toml", run.attachments.get("cell.toml")?).ok()
}

/// `[coverage]` of the task.
fn coverage(run: &Run, task: &TaskRun<'_>) -> Option<CoverageSpec> {
    task.file(run)?.get("coverage")?.clone().try_into().ok()
}

/// Dose of the whole task.
fn dose(task: &TaskRun<'_>, tip: &Tip, radius_m: f64) -> DoseMap {
    let mut map = DoseMap::new(radius_m);
    for pair in task.cycles.windows(2) {
        let [before, now] = [&pair[0], &pair[1]];
        let Ok(base_from_tool) = Pose::<Base, Tool>::try_from(&now.arm.tool_pose) else {
            continue;
        };
        let world = Pose::<World, Base>::identity();
        if let Some(pressed) = Pressed::of(now.control, &base_from_tool, &world, tip) {
            map.press(&pressed, now.time_s - before.time_s);
        }
    }
    map
}

fn cell(cell: &Cell) -> Value {
    json!([
        place(&cell.point),
        place_of(&cell.normal, 1.0, 3),
        short(cell.dose(), 4)
    ])
}

fn place(point: &Vector3<f64>) -> Value {
    place_of(point, 1e3, MM_DIGITS)
}

fn place_of(point: &Vector3<f64>, factor: f64, digits: i32) -> Value {
    let round = |x: f64| {
        let scale = 10.0_f64.powi(digits);
        (x * factor * scale).round() / scale
    };
    json!([round(point.x), round(point.y), round(point.z)])
}

/// The number with this many significant digits; null if it is not finite.
fn short(value: f64, digits: usize) -> Value {
    let text = format!("{value:.*e}", digits.saturating_sub(1));
    text.parse::<f64>()
        .map_or(Value::Null, |value| json!(value))
}

/// Data for the script within an element of the page.
fn data(value: &Value) -> String {
    let mut html = String::from("<script type=\"application/json\">");
    // No text within may end the element.
    let _ = write!(html, "{}", value.to_string().replace("</", "<\\/"));
    html.push_str("</script>");
    html
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::BLUE;

    #[test]
    fn a_thinned_plot_keeps_its_peaks_and_gaps() {
        let mut points: Vec<(f64, f64)> = (0..80_000)
            .map(|i| (f64::from(i), f64::from(i % 7)))
            .collect();
        points[12_345].1 = 99.0;
        points[54_321].1 = -99.0;
        points[40_000].1 = f64::NAN;
        let series = [Series {
            name: "f",
            points: &points,
            colour: BLUE,
        }];
        let rows = kept_rows(&series);
        assert!(rows.len() < 5 * PARTS, "{}", rows.len());
        for row in [0, 12_345, 40_000, 54_321, 79_999] {
            assert!(rows.contains(&row), "{row}");
        }
        assert!(rows.is_sorted());
    }

    #[test]
    fn data_cannot_end_its_element_and_numbers_are_short() {
        let text = data(&json!({ "name": "</script><b>" }));
        assert_eq!(text.matches("</script>").count(), 1);
        assert_eq!(short(1.234_567, 4), json!(1.235));
        assert_eq!(short(f64::NAN, 4), Value::Null);
        assert_eq!(short(f64::INFINITY, 4), Value::Null);
    }

    #[test]
    fn the_library_of_the_script_exports_nothing() {
        assert!(!script().contains("export {"));
    }
}
