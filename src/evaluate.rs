//! `tangent evaluate`: runs a scenario in a closed loop, in one thread and without a bus.

use std::time::Instant;

use anyhow::Result;
use serde_json::json;
use tangent_report::coverage;
use tangent_simulated_cell::scenarios;
use tangent_simulation::metrics::Spread;
use tangent_simulation::metrics::object::ObjectFigures;
use tangent_simulation::metrics::visuo_tactile::VisuoTactileFigures;
use tangent_simulation::{Evaluation, evaluate_admittance_passes};

use crate::cli::Evaluate;
use crate::output::{Outcome, bad_usage, or_dash, print_json};
use crate::table::Columns;

/// Runs one scenario and prints its figures.
///
/// # Errors
/// The scenario, an override, the estimator or the preset is invalid.
pub fn run(scenario: &str, args: &Evaluate, json: bool) -> Result<Outcome> {
    if scenario == "list" {
        return list(json);
    }
    let mut set = overrides(args);
    if let Some(seed) = args.seed {
        set.push(format!("seed={seed}"));
    }
    if let Some(passes) = args.passes {
        return repeat(scenario, &set, passes, json);
    }
    show(&once(scenario, &set)?, json)
}

/// Runs a scenario `passes` times with what the passes learn, and prints one row per pass.
fn repeat(name: &str, overrides: &[String], passes: u32, json: bool) -> Result<Outcome> {
    let scenario = scenarios::load(name, overrides)?
        .into_admittance()
        .ok_or_else(|| {
            bad_usage(format!(
                "--passes {passes}: the law of scenario {name} does not learn; allowed are \
                 scenarios of velocity-controlled arms"
            ))
        })?;
    let list = evaluate_admittance_passes(&scenario, passes).map_err(bad_usage)?;
    let is_done = list.iter().all(|pass| pass.evaluation.phase == "done");
    if json {
        print_json(&json!({ "scenario": scenario.name, "passes": list }))?;
    } else {
        let mut table = Columns::new(&[
            "pass",
            "seed",
            "ended in",
            ">force rmse, N",
            ">as measured, N",
            ">peak, N",
            ">normal, deg",
            ">tool, deg",
            ">path, s",
            ">memory",
        ]);
        for pass in &list {
            let (e, f) = (&pass.evaluation, &pass.evaluation.figures);
            let mean = |spread: Option<Spread>| or_dash(spread.map(|s| s.mean), 3);
            table.row([
                pass.pass.to_string().as_str(),
                e.seed.to_string().as_str(),
                e.phase,
                or_dash(f.force.rmse_n, 4).as_str(),
                or_dash(pass.force_measured_rmse_n, 4).as_str(),
                or_dash(f.force.peak_n, 3).as_str(),
                mean(f.normal_error_settled_deg).as_str(),
                mean(f.tool_error_deg).as_str(),
                format!("{:.1}", pass.path_time_s).as_str(),
                format!("{:.2}", pass.memory_weight).as_str(),
            ]);
        }
        table.print(0);
    }
    Ok(if is_done {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

/// Prints the figures of one run.
///
/// # Errors
/// Standard output is not usable.
pub fn show(evaluation: &Evaluation, json: bool) -> Result<Outcome> {
    if json {
        print_json(evaluation)?;
    } else {
        print(evaluation);
    }
    Ok(if evaluation.phase == "done" {
        Outcome::Done
    } else {
        Outcome::Failed
    })
}

fn list(json: bool) -> Result<Outcome> {
    let mut rows = Vec::new();
    for (name, _) in scenarios::BUILTIN {
        rows.push((name, scenarios::load(name, &[])?.title().to_owned()));
    }
    if json {
        let rows: Vec<_> = rows
            .iter()
            .map(|(name, title)| json!({"name": name, "title": title}))
            .collect();
        print_json(&json!({ "scenarios": rows }))?;
    } else {
        let mut table = Columns::new(&["scenario", "what it is"]);
        rows.iter()
            .for_each(|(name, title)| table.row([**name, title.as_str()]));
        table.print(0);
    }
    Ok(Outcome::Done)
}

/// Converts the options of the command line, but for the seed, to overrides of the scenario.
pub fn overrides(args: &Evaluate) -> Vec<String> {
    let mut set = args.set.clone();
    if let Some(name) = &args.estimator {
        set.push(format!("task.estimators=[\"{name}\"]"));
    }
    if let Some(name) = &args.controller {
        set.push(format!("controller=\"{name}\""));
    }
    set
}

/// Runs a scenario by name with overrides, and measures the time.
///
/// # Errors
/// The scenario or an override is invalid.
pub fn once(scenario: &str, overrides: &[String]) -> Result<Evaluation> {
    let scenario = scenarios::load(scenario, overrides)?;
    let start = Instant::now();
    let evaluation = scenario.evaluate().map_err(bad_usage)?;
    Ok(evaluation.with_wall_time(start.elapsed().as_secs_f64()))
}

fn print(e: &Evaluation) {
    println!(
        "{}: {:.1} s simulated with estimator {} and preset {}, seed {}",
        e.scenario, e.duration_s, e.estimator, e.controller, e.seed
    );
    let mut table = Columns::new(&["", ""]);
    let mut row = |name: &str, text: String| table.row([name, text.as_str()]);
    let fault = e
        .fault
        .map_or_else(String::new, |fault| format!(": {fault}"));
    row("ended in phase", format!("{}{fault}", e.phase));
    let f = &e.figures;
    for (name, spread) in [
        ("normal against truth", &f.normal_error_deg),
        ("from 1 s after contact", &f.normal_error_settled_deg),
        ("normal against the tool", &f.alignment_error_deg),
        ("tool against truth", &f.tool_error_deg),
    ] {
        if let Some(s) = spread {
            row(
                name,
                format!(
                    "mean {:.3}  rmse {:.3}  p95 {:.3}  max {:.3} deg",
                    s.mean, s.rmse, s.p95, s.max
                ),
            );
        }
    }
    if let Some(nees) = f.normal_nees_per_dof {
        row(
            "normal's consistency",
            format!("{nees:.2} per degree of freedom"),
        );
    }
    let or_dash = |x| or_dash(x, 3);
    row(
        "force",
        format!(
            "reference {:.3}  mean {}  rmse {}  peak {} N  overshoot {} %",
            f.force.reference_n,
            or_dash(f.force.mean_n),
            or_dash(f.force.rmse_n),
            or_dash(f.force.peak_n),
            or_dash(f.force.overshoot_percent)
        ),
    );
    row(
        "path",
        format!(
            "rmse {} mm  max {} mm",
            or_dash(f.path.rmse_m.map(|x| x * 1e3)),
            or_dash(f.path.max_m.map(|x| x * 1e3))
        ),
    );
    row(
        "contact",
        format!(
            "first at {} s, lost {} times for {} s",
            or_dash(f.contact.first_s),
            f.contact.lost_count,
            or_dash(Some(f.contact.lost_s))
        ),
    );
    if let Some(c) = &e.coverage {
        row("coverage", coverage::sentence(c));
        for detail in coverage::details(c) {
            row("", detail);
        }
    }
    if let Some(o) = &e.object_pose {
        print_object(o, &mut row);
    }
    if let Some(t) = &e.tactile {
        print_tactile(e, t, &mut row);
    }
    if let Some(factor) = e.real_time_factor {
        row("speed", format!("{factor:.0} x real time"));
    }
    row("digest", e.state_digest.clone());
    table.print(2);
}

fn print_tactile(e: &Evaluation, t: &VisuoTactileFigures, row: &mut impl FnMut(&str, String)) {
    let or_dash = |x| or_dash(x, 3);
    if let (Some(mad), Some(rmse)) = (e.figures.path.mad_xyz_m, e.figures.path.rmse_xyz_m) {
        let mm = |v: [f64; 3]| v.map(|x| format!("{:.2}", x * 1e3)).join(", ");
        row(
            "path by x, y, z",
            format!("mean absolute {} mm, rmse {} mm", mm(mad), mm(rmse)),
        );
    }
    if let Some(tanks) = &e.figures.tanks {
        row(
            "tanks",
            format!(
                "motion {:.2} to {:.2} J, force {:.2} to {:.2} J, short of {:.1e} J",
                tanks.motion_min_j.unwrap_or_default(),
                tanks.motion_max_j.unwrap_or_default(),
                tanks.force_min_j,
                tanks.force_max_j,
                t.short_j.unwrap_or_default()
            ),
        );
    }
    row(
        "shaping",
        format!(
            "rho_align from {}, rho_frc from {}, C at most {} of its margin",
            or_dash(t.rho_align_min),
            or_dash(t.rho_force_min),
            or_dash(t.monitor_share_max)
        ),
    );
    row(
        "camera",
        format!(
            "{:.1} frames a second, {} of the sliding without a normal",
            t.vision_rate_hz,
            or_dash(t.blind_share)
        ),
    );
}

fn print_object(o: &ObjectFigures, row: &mut impl FnMut(&str, String)) {
    let number = |x: Option<f64>, scale: f64| or_dash(x.map(|x| x * scale), 3);
    row(
        "object, 1 s after contact",
        format!(
            "along the normal {} mm, across {} mm, about the surface {} deg",
            number(o.along_normal_settled_m, 1e3),
            number(o.across_normal_settled_m, 1e3),
            number(o.about_surface_settled_deg, 1.0)
        ),
    );
    row(
        "path on the object, rmse",
        format!(
            "against the estimate {} mm, against the true object {} mm",
            number(o.path_on_estimate_rmse_m, 1e3),
            number(o.path_on_object_rmse_m, 1e3)
        ),
    );
    row(
        "force and moment",
        format!(
            "peak at contact {} N, sliding rmse {} N, across the tool {} N, moment {} Nm",
            number(o.peak_at_contact_n, 1.0),
            number(o.sliding_force_rmse_n, 1.0),
            number(o.lateral_force_max_n, 1.0),
            number(o.moment_max_nm, 1.0)
        ),
    );
    if let (Some(stated), Some(last)) = (&o.calibration_stated, &o.calibration_final) {
        row(
            "camera's calibration error",
            format!(
                "{:.2} to {:.2} mm along the normal, {:.3} to {:.3} deg about the surface",
                stated.along_normal_m * 1e3,
                last.along_normal_m * 1e3,
                stated.about_surface_deg,
                last.about_surface_deg
            ),
        );
    }
    if let Some(nees) = o.nees_per_dof {
        row(
            "pose's consistency",
            format!("{nees:.2} per degree of freedom"),
        );
    }
}
