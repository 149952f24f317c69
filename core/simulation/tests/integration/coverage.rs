//! Regions, lifts and coverage that closes, in the closed loop: what `docs/tasks.md` states.

use allocation_counter::measure;
use nalgebra::{Vector2, Vector3};
use tangent_control::{Controller, CoverageResult, Phase, Program};
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, FileError};

/// A plate with a hole, beside the place where the tool touches down.
const OUTLINE: [[f64; 2]; 4] = [[0.0, 0.02], [0.1, 0.02], [0.1, 0.1], [0.0, 0.1]];
const HOLE: [[f64; 2]; 4] = [[0.04, 0.05], [0.07, 0.05], [0.07, 0.08], [0.04, 0.08]];
const RADIUS_M: f64 = 0.008;
/// N*s/cm².
const BAND: [f64; 2] = [0.8, 8.0];
/// Spirals and rings turn in place where they end.
const WIDE_BAND: [f64; 2] = [0.8, 14.0];
/// Cell of the independent map, m.
const CELL_M: f64 = 0.002;

fn scenario(name: &str, path: &str, overrides: &[&str]) -> AdmittanceScenario {
    let file = format!("{}/../../scenarios/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&file).unwrap();
    let (cell, _) = text.split_once("[task.path]").unwrap();
    let text = format!("{cell}{path}");
    let mut set = vec![
        "duration_s=400.0".to_owned(),
        "task.force.reference_n=5.0".to_owned(),
    ];
    set.extend(overrides.iter().map(ToString::to_string));
    let none = |_: &str| Err(FileError::new("no file"));
    AdmittanceScenario::parse(&file, &text, &set, &none).unwrap()
}

fn region(keys: &str) -> String {
    format!(
        "[task.path]\nkind = \"region\"\noutline_m = {OUTLINE:?}\nholes_m = [{HOLE:?}]\n\
         margin_m = 0.003\nspeed_m_per_s = 0.03\n{keys}\n"
    )
}

fn covered(spacing_m: f64, more: &str, band: [f64; 2]) -> String {
    region(&format!("spacing_m = {spacing_m}"))
        + &format!("{more}\n[task.coverage]\nradius_m = {RADIUS_M}\ndose_n_s_per_cm2 = {band:?}\n")
}

/// What a run did, by its true state.
struct Run {
    fault: Option<tangent_control::Fault>,
    end: Phase,
    phases: Vec<Phase>,
    /// Times of contact outside the phases that press, s.
    touched_above_s: f64,
    force_max_n: f64,
    /// Points of the surface and the impulse there: the first touch is the origin, lengths are
    /// along the surface.
    presses: Vec<(Vector2<f64>, f64)>,
    result: Option<CoverageResult>,
}

/// Unrolls a place of the surface into lengths along it from `start`.
fn unrolled(
    name: &str,
    start: &Vector3<f64>,
    at: &Vector3<f64>,
    x: &Vector3<f64>,
    n: &Vector3<f64>,
) -> Vector2<f64> {
    let y = n.cross(x);
    if !name.starts_with("pipe") {
        return Vector2::new((at - start).dot(x), (at - start).dot(&y));
    }
    // The pipe's axis is the y axis of the base.
    let middle = Vector3::new(0.45, 0.0, 0.0);
    let angle = |p: &Vector3<f64>| (p.x - middle.x).atan2(p.z - middle.z);
    let around = 0.25 * (angle(at) - angle(start));
    let along = at.y - start.y;
    let around_axis = Vector3::y().cross(n);
    let flat = around_axis * around + Vector3::y() * along;
    Vector2::new(flat.dot(x), flat.dot(&y))
}

fn run(name: &str, scenario: &AdmittanceScenario) -> Run {
    let mut cell = AdmittanceLoop::new(scenario).unwrap();
    let mut run = Run {
        fault: None,
        end: Phase::Idle,
        phases: Vec::new(),
        touched_above_s: 0.0,
        force_max_n: 0.0,
        presses: Vec::new(),
        result: None,
    };
    let (mut x_axis, mut start) = (None, None);
    let mut off_s = 0.0;
    for _ in 0..(scenario.duration_s / 0.008) as usize {
        cell.step(&mut |c| {
            let tool_x = c.input.base_from_tool.rotate(&Vector3::x());
            let x = *x_axis.get_or_insert(tool_x);
            let phase = c.output.phase;
            if run.phases.last() != Some(&phase) {
                run.phases.push(phase);
            }
            run.fault = c.output.fault;
            run.end = phase;
            let (truth, dt) = (c.truth, c.input.dt_s);
            let force_n = truth.wrench.force.dot(&truth.normal);
            run.force_max_n = run.force_max_n.max(force_n);
            // The contact releases at the beginning of a way off the surface.
            off_s = if phase == Phase::Lift {
                off_s + dt
            } else {
                0.0
            };
            if truth.in_contact && off_s > 0.5 {
                run.touched_above_s += dt;
            }
            if truth.in_contact && phase.is_pressing() {
                let at = truth.base_from_tool.translation();
                let (first, normal) = *start.get_or_insert((at, truth.normal));
                let x = (x - normal * x.dot(&normal)).normalize();
                run.presses
                    .push((unrolled(name, &first, &at, &x, &normal), force_n * dt));
            }
        });
        if !run.end.is_active() && !run.phases.is_empty() && run.end != Phase::Idle {
            break;
        }
    }
    run.result = cell.controller().coverage_result();
    run
}

/// Whether a point is inside a rectangle that is wider by `more_m` on every side.
fn is_in(corners: &[[f64; 2]; 4], more_m: f64, p: &Vector2<f64>) -> bool {
    (corners[0][0] - more_m..corners[2][0] + more_m).contains(&p.x)
        && (corners[0][1] - more_m..corners[2][1] + more_m).contains(&p.y)
}

/// Share of the region whose true dose is within the band. Places of the surface are known to a
/// millimetre or two: as much is left out along the edges.
fn true_share(run: &Run, band: [f64; 2]) -> f64 {
    const EDGE_M: f64 = 0.002;
    let side = 80_usize;
    let middle = |i: usize, j: usize| Vector2::new(i as f64 + 0.5, j as f64 + 0.5) * CELL_M;
    let mut impulses = vec![0.0; side * side];
    for (at, impulse) in &run.presses {
        let reach = (RADIUS_M / CELL_M).ceil() as i64 + 1;
        let (ci, cj) = ((at.x / CELL_M) as i64, (at.y / CELL_M) as i64);
        let share = CELL_M * CELL_M / (std::f64::consts::PI * RADIUS_M * RADIUS_M);
        for i in (ci - reach).max(0)..=(ci + reach).min(side as i64 - 1) {
            for j in (cj - reach).max(0)..=(cj + reach).min(side as i64 - 1) {
                let (i, j) = (i as usize, j as usize);
                if (middle(i, j) - at).norm() < RADIUS_M {
                    impulses[j * side + i] += impulse * share;
                }
            }
        }
    }
    let (mut good, mut all) = (0, 0);
    for j in 0..side {
        for i in 0..side {
            let p = middle(i, j);
            if is_in(&OUTLINE, -EDGE_M, &p) && !is_in(&HOLE, EDGE_M, &p) {
                all += 1;
                let dose = impulses[j * side + i] / (CELL_M * CELL_M * 1e4);
                good += usize::from((band[0]..=band[1]).contains(&dose));
            }
        }
    }
    f64::from(good as u32) / f64::from(all)
}

/// At least 99 % of a region with a hole within the band.
#[test]
fn a_region_with_a_hole_is_covered_on_a_plane_a_pipe_and_a_sheet() {
    for name in ["plane", "pipe_ideal", "sheet", "pipe_realistic"] {
        let run = run(name, &scenario(name, &covered(0.008, "", BAND), &[]));
        let result = run.result.as_ref().unwrap();
        let share = true_share(&run, BAND);
        println!("{name}: {result:?}, true share {share:.4}");
        assert_eq!((run.end, run.fault), (Phase::Done, None), "{name}");
        assert!(result.share >= 0.99, "{name}: {result:?}");
        assert!(share >= 0.99, "{name}: {share}");
        assert!(run.force_max_n < 10.0, "{name}: {}", run.force_max_n);
        assert_eq!(run.touched_above_s, 0.0, "{name}");
        // The tool's middle never comes into the hole, nor far over the edge.
        let outside = |(p, _): &&(Vector2<f64>, f64)| {
            p.norm() > 0.025 && (is_in(&HOLE, 0.0, p) || !is_in(&OUTLINE, 0.0, p))
        };
        let outside: Vec<_> = run.presses.iter().filter(outside).collect();
        assert!(
            outside.is_empty(),
            "{name}: {} {:?}",
            outside.len(),
            outside[0]
        );
    }
}

/// Gaps of the first round become strokes of the second one.
#[test]
fn gaps_between_rows_that_are_too_far_apart_are_closed_in_the_second_round() {
    for name in ["plane", "pipe_ideal", "sheet"] {
        let run = run(name, &scenario(name, &covered(0.02, "", BAND), &[]));
        let result = run.result.as_ref().unwrap();
        let share = true_share(&run, BAND);
        println!("{name}: {result:?}, true share {share:.4}");
        assert_eq!((run.end, run.fault), (Phase::Done, None), "{name}");
        assert!(result.share_by_round[0] < 0.85, "{name}: {result:?}");
        assert!(result.share_by_round[1] >= 0.99, "{name}: {result:?}");
        assert!(share >= 0.99, "{name}: {share}");
    }
}

const STROKES: &str = "[task.path]
kind = \"strokes\"
speed_m_per_s = 0.03
[[task.path.strokes]]
points_m = [[0.0, 0.0], [0.08, 0.0]]
force_n = 4.0
[[task.path.strokes]]
points_m = [[0.08, 0.0], [0.08, 0.06]]
force_n = 8.0
speed_m_per_s = 0.02
[[task.path.strokes]]
points_m = [[0.02, 0.02], [0.06, 0.02], [0.06, 0.04]]
";

#[test]
fn every_stroke_has_its_force_and_its_speed_and_a_new_force_is_ramped() {
    for name in ["plane", "pipe_ideal", "sheet", "pipe_realistic"] {
        let scenario = scenario(name, STROKES, &[]);
        let mut cell = AdmittanceLoop::new(&scenario).unwrap();
        let mut phases = Vec::new();
        // Sum of force and speed, and count, by the reference.
        let mut sums = [[0.0; 3]; 3];
        let (mut fastest_n_per_s, mut before): (f64, Option<f64>) = (0.0, None);
        while phases.last() != Some(&Phase::Done) {
            cell.step(&mut |c| {
                let phase = c.output.phase;
                if phases.last() != Some(&phase) {
                    phases.push(phase);
                }
                let force_n = c.truth.wrench.force.dot(&c.truth.normal);
                if phase != Phase::Slide {
                    before = None;
                    return;
                }
                if let Some(before) = before.replace(force_n) {
                    fastest_n_per_s = fastest_n_per_s.max((force_n - before).abs() / c.input.dt_s);
                }
                let index = [4.0, 8.0, 5.0]
                    .iter()
                    .position(|f: &f64| (f - c.output.force_reference_n).abs() < 1e-9)
                    .unwrap();
                let speed = c.truth.sliding_speed_m_per_s;
                sums[index][0] += force_n;
                sums[index][1] = f64::max(sums[index][1], speed);
                sums[index][2] += 1.0;
            });
            assert!(cell.plant().time_s() < 60.0, "{name}: {phases:?}");
        }
        for (sum, (force_n, speed)) in sums.iter().zip([(4.0, 0.03), (8.0, 0.02), (5.0, 0.03)]) {
            let mean_n = sum[0] / sum[2];
            assert!(
                (mean_n / force_n - 1.0).abs() < 0.12,
                "{name}: {force_n} N: {mean_n}"
            );
            assert!(
                (sum[1] / speed - 1.0).abs() < 0.15,
                "{name}: {speed} m/s: {}",
                sum[1]
            );
        }
        // The ramp of the reference, and the force's own error.
        assert!(fastest_n_per_s < 40.0, "{name}: {fastest_n_per_s}");
        assert_eq!(
            phases.iter().filter(|p| **p == Phase::Lift).count(),
            1,
            "{name}"
        );
    }
}

fn step_until(cell: &mut AdmittanceLoop, phase: Phase) {
    for _ in 0..20_000 {
        if cell.step(&mut |_| ()).phase == phase {
            return;
        }
    }
    panic!("{phase:?} not reached");
}

#[test]
fn a_pause_above_the_surface_stands_still_and_a_stop_retracts() {
    let mut cell = AdmittanceLoop::new(&scenario("pipe_ideal", STROKES, &[])).unwrap();
    step_until(&mut cell, Phase::Lift);
    for _ in 0..200 {
        cell.step(&mut |_| ());
    }
    assert_eq!(cell.controller().phase(), Phase::Lift);
    cell.controller().pause().unwrap();
    for k in 0..200 {
        let sample = cell.step(&mut |_| ());
        assert!(k < 50 || sample.joint_speed_rad_per_s < 1e-4, "{k}");
    }
    cell.controller().resume().unwrap();
    step_until(&mut cell, Phase::Slide);
    step_until(&mut cell, Phase::Done);

    let mut cell = AdmittanceLoop::new(&scenario("pipe_ideal", STROKES, &[])).unwrap();
    step_until(&mut cell, Phase::Lift);
    cell.controller().stop();
    step_until(&mut cell, Phase::Retract);
    step_until(&mut cell, Phase::Done);
    assert!(cell.controller().clearance().is_free());
}

/// A hollow between two strokes: nothing is known of the other side, and the straight way meets it.
#[test]
fn a_touch_on_the_way_leads_further_off_the_surface() {
    let far = "[task.path]
kind = \"strokes\"
speed_m_per_s = 0.03
lift_m = 0.005
[[task.path.strokes]]
points_m = [[0.0, 0.0], [0.02, 0.0]]
[[task.path.strokes]]
points_m = [[0.06, 0.0], [0.08, 0.0]]
";
    let mut touched = 0;
    for start_mm in [340, 360, 380, 400, 420, 440] {
        let near = format!("plant.start.near_m=[0.{start_mm}, -0.04, 0.1]");
        let deep = ["plant.surface.amplitude_m=[0.006, 0.0]", near.as_str()];
        let scenario = scenario("sheet", far, &deep);
        let mut cell = AdmittanceLoop::new(&scenario).unwrap();
        let (mut force_max_n, mut above_s) = (0.0_f64, 0.0);
        let (mut phase, mut fault, mut climbs) = (Phase::Idle, None, 0);
        while phase != Phase::Done {
            cell.step(&mut |c| {
                phase = c.output.phase;
                fault = c.output.fault;
                force_max_n = force_max_n.max(c.truth.wrench.force.norm());
                let above = phase == Phase::Lift && !c.truth.in_contact;
                if phase == Phase::Lift && c.truth.in_contact && above_s > 0.3 {
                    climbs += 1;
                }
                above_s = if above { above_s + 0.008 } else { 0.0 };
            });
            let at_s = cell.plant().time_s();
            assert!(
                phase.is_active() || phase == Phase::Done,
                "{start_mm}: {fault:?} at {at_s} s"
            );
        }
        println!("start at {start_mm} mm: {climbs} touches above, at most {force_max_n:.1} N");
        touched += climbs;
        assert!(force_max_n < 20.0, "{start_mm}: {force_max_n}");
    }
    assert!(touched > 0);
}

#[test]
fn a_task_with_rounds_and_lifts_does_not_allocate_in_its_cycles() {
    let scenario = scenario("pipe_ideal", &covered(0.02, "", BAND), &[]);
    let mut inputs = Vec::new();
    let mut cell = AdmittanceLoop::new(&scenario).unwrap();
    let mut end = Phase::Idle;
    while end != Phase::Done {
        cell.step(&mut |c| {
            inputs.push(*c.input);
            end = c.output.phase;
        });
    }
    let config = scenario.controller_config().unwrap();
    let (arm, tool) = (*cell.plant().model(), cell.plant().flange_from_tool());
    let mut controller = Controller::new(arm, tool, scenario.limits, config).unwrap();
    let program = Program::new(&scenario.task, &config).unwrap();
    controller.start(program, 1).unwrap();
    let (mut most, mut results) = (0, 0);
    for input in &inputs {
        most = most.max(
            measure(|| {
                controller.step(input);
                results += usize::from(controller.take_coverage().is_some());
            })
            .count_total,
        );
    }
    assert_eq!((most, controller.phase()), (0, Phase::Done));
    let result = controller.coverage_result().unwrap();
    assert!(result.rounds >= 2);
    // One at the end of each round.
    assert_eq!(results, result.rounds as usize);
}

#[test]
fn spirals_contours_and_rows_at_an_angle_are_covered() {
    for (pattern, more) in [
        ("spiral", ""),
        ("contour", ""),
        ("raster", "angle_rad = 0.5"),
    ] {
        let keys = format!("pattern = \"{pattern}\"\n{more}");
        let path = covered(0.009, &keys, WIDE_BAND);
        let run = run("sheet", &scenario("sheet", &path, &[]));
        let result = run.result.as_ref().unwrap();
        let share = true_share(&run, WIDE_BAND);
        println!("{pattern}: {result:?}, true share {share:.4}");
        assert_eq!((run.end, run.fault), (Phase::Done, None), "{pattern}");
        assert!(
            result.share >= 0.99 && share >= 0.99,
            "{pattern}: {result:?}"
        );
        assert_eq!(run.touched_above_s, 0.0, "{pattern}");
    }
}
