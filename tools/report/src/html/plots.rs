//! The plots: forces, angles, the path, delays, joints, and the estimators side by side.

use std::fmt::Write as _;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use tangent_simulation::metrics::{Spread, angle_deg};

use super::phases::bands;
use super::{escaped, interactive};
use crate::error::ReportError;
use crate::figures::Report;
use crate::object;
use crate::plot::{self, Axes, Curve, Series};
use crate::run::Run;
use crate::tactile;
use crate::task_run::{Cycle, TaskRun};

/// All plots of the task.
pub(super) fn all(run: &Run, task: &TaskRun<'_>) -> Result<String, ReportError> {
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
            ("measured", curve(task, |c| c.sample.force_n)),
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
        "In contact: error of the estimated normal, and angle of the tool to it.",
    )?;
    html += &path(task)?;
    if let Some((samples, _)) = object::samples(run, task) {
        object::draw_all(&samples, |(_, title, unit, _), curves| {
            html += &figure(
                &axes(title, unit),
                curves,
                "As in the paper's figures: the estimate against the true object, or the load of the contact on the wrist.",
            )?;
            Ok(())
        })?;
    }
    let shaped = tactile::samples(run, task);
    if !shaped.is_empty() {
        tactile::draw_all(&shaped, |plot, curves| {
            let time = if plot.x == "time, s" { &bands[..] } else { &[] };
            html += &figure(
                &Axes {
                    title: plot.title,
                    x: plot.x,
                    y: plot.y,
                    equal: plot.equal,
                    reference: None,
                    bands: time,
                },
                curves,
                plot.caption,
            )?;
            Ok(())
        })?;
    }
    let tank = |energy: fn(&Cycle<'_>) -> f64| {
        let held = move |c: &Cycle<'_>| Some(energy(c)).filter(|j| *j > 0.0);
        curve(task, held)
    };
    html += &figure(
        &axes("Energy tanks", "J"),
        &[
            ("motion", tank(|c| c.control.motion_tank_j)),
            ("force", tank(|c| c.control.force_tank_j)),
        ],
        "Energy that the law may still put into motion and force; with an empty tank it releases the tool.",
    )?;
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
            (
                "base pose",
                curve(task, |c| positive(1e3 * c.control.base_age_s)),
            ),
        ],
        "Age of the controller's inputs when its command was sent.",
    )?;
    html += &figure(
        &axes("Robot packet to command", "µs"),
        &[(
            "packet to command",
            curve(task, |c| positive(1e6 * c.arm.packet_to_command_s)),
        )],
        "From the arrival of a robot's packet to the departure of the answer.",
    )?;
    let joints: Vec<(String, Curve)> = (0..7)
        .map(|j| {
            let speed = curve(task, |c| c.arm.qd.get(j).copied());
            (format!("joint {}", j + 1), speed)
        })
        .collect();
    let joints: Vec<(&str, Curve)> = joints
        .iter()
        .map(|(name, points)| (name.as_str(), points.clone()))
        .collect();
    html += &figure(&axes("Joint speeds", "rad/s"), &joints, "As measured.")?;
    if run.truth.is_empty() {
        html += "<p class=\"note\">Without a simulator the truth is not known.</p>\n";
    }
    Ok(html)
}

/// The value of each cycle over time; a gap where there is none.
pub(super) fn curve(task: &TaskRun<'_>, value: impl Fn(&Cycle<'_>) -> Option<f64>) -> Curve {
    task.cycles
        .iter()
        .map(|c| (c.time_s, value(c).unwrap_or(f64::NAN)))
        .collect()
}

/// A plot with its caption; empty if no curve has a point.
pub(super) fn figure(
    axes: &Axes<'_>,
    series: &[(&str, Curve)],
    caption: &str,
) -> Result<String, ReportError> {
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
    let data = interactive::plot(axes, &drawn);
    Ok(format!(
        "<figure>{svg}{data}<figcaption>{caption}</figcaption></figure>\n"
    ))
}

fn positive(value: f64) -> Option<f64> {
    (value > 0.0 && value.is_finite()).then_some(value)
}

/// Plot of the path in the plane that fits its reference best.
fn path(task: &TaskRun<'_>) -> Result<String, ReportError> {
    let sliding = task.sliding();
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
        "Projected onto the plane that fits the path best; both axes have the same scale.",
    )
}

/// Table and plot of all recorded estimators.
pub(super) fn estimators(
    run: &Run,
    task: &TaskRun<'_>,
    report: &Report,
) -> Result<String, ReportError> {
    if report.estimators.is_empty() {
        return Ok(String::new());
    }
    let mut html = "<h2>Comparison of the estimators</h2>\n<div class=\"wide\"><table><tr><th>Estimator</th><th>Rate, Hz</th>\
                    <th>Age at use, mean / 95 %</th><th>From the one in use, mean / 95 %</th><th>Error, mean / RMS</th>\
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
             <td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            escaped(name),
            figures
                .rate_hz
                .map_or_else(|| "-".to_owned(), |hz| format!("{hz:.1}")),
            figures.age_ms.map_or_else(
                || "-".to_owned(),
                |s| format!("{:.1} / {:.1} ms", s.mean, s.p95)
            ),
            figures.from_active_deg.map_or_else(
                || "-".to_owned(),
                |s| format!("{:.2}° / {:.2}°", s.mean, s.p95)
            ),
            spread(figures.normal_error_deg),
            spread(figures.normal_error_settled_deg),
            spread(figures.alignment_error_deg),
            figures
                .normal_nees_per_dof
                .map_or_else(|| "-".to_owned(), |n| format!("{n:.2}")),
        );
    }
    html.push_str("</table></div>\n");
    for switch in &report.estimator_switches {
        let _ = writeln!(
            html,
            "<p>At {:.2} s the normal came from {} after {}: {}.</p>",
            crate::shown_time::shown_s(switch.time_s),
            escaped(&switch.to),
            escaped(&switch.from),
            escaped(&switch.cause)
        );
    }
    if report.estimators.len() > 1 {
        html += &from_active(run, task, report)?;
    }
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
        let curves: Vec<(&str, Curve)> = report
            .estimators
            .keys()
            .map(|name| {
                let own = task.estimates_of(run, name);
                let points = own.iter().zip(&task.cycles).map(|(own, cycle)| {
                    let truth = cycle.sample.truth.as_ref().filter(|t| t.in_contact);
                    let angle = truth.zip(own.as_ref());
                    let angle = angle.map(|(t, e)| angle_deg(&e.normal, &t.normal));
                    (cycle.time_s, angle.unwrap_or(f64::NAN))
                });
                (name.as_str(), points.collect())
            })
            .collect();
        html += &figure(&axes, &curves, "Relative to the truth, while in contact.")?;
    }
    Ok(html)
}

/// Plot of the angle of each estimator to the one in use.
fn from_active(run: &Run, task: &TaskRun<'_>, report: &Report) -> Result<String, ReportError> {
    let bands = bands(task);
    let axes = Axes {
        title: "Each estimator against the one in use",
        x: "time, s",
        y: "degrees",
        equal: false,
        reference: None,
        bands: &bands,
    };
    let curve = |name: &String| {
        let own = task.estimates_of(run, name);
        let points = own.iter().zip(&task.cycles).map(|(own, cycle)| {
            let pressing = cycle.sample.phase.is_pressing();
            let active = (cycle.sample.estimate.as_ref()).filter(|_| pressing);
            let angle = own.as_ref().zip(active);
            let angle = angle.map(|(own, active)| angle_deg(&own.normal, &active.normal));
            (cycle.time_s, angle.unwrap_or(f64::NAN))
        });
        points.collect::<Vec<_>>()
    };
    let curves: Vec<(&str, Curve)> = report
        .estimators
        .keys()
        .map(|name| (name.as_str(), curve(name)))
        .collect();
    figure(
        &axes,
        &curves,
        "While pressing; 0 for the one in use itself.",
    )
}
