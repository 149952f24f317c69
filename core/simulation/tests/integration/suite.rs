//! The suite `contact`, with few draws: reproducible, and against stored figures.
//!
//! `INSTA_UPDATE=always cargo test --profile ci -p tangent-simulation --test integration suite`
//! stores the figures anew.

use tangent_simulation::suite::{
    ConditionRow, Draw, Figures, Judgement, SuiteReport, SurfaceKind, draw, run,
};

const DRAWS: u64 = 2;
const SEED: u64 = 1;

fn draws() -> Vec<Draw> {
    let numbers = |surface| (0..DRAWS).map(move |number| draw(surface, number, SEED));
    SurfaceKind::ALL.into_iter().flat_map(numbers).collect()
}

fn runs(draws: &[Draw]) -> Vec<Judgement> {
    draws.iter().map(|draw| run(draw).unwrap()).collect()
}

/// Runs a draw with other settings.
fn run_with(draw: &Draw, overrides: &[&str]) -> Judgement {
    let overrides: Vec<_> = overrides.iter().map(|&one| one.to_owned()).collect();
    run(&draw.clone().with_overrides(&overrides).unwrap()).unwrap()
}

/// The true peak of one run is below this share of the other's.
fn assert_lower_peak(draw: &Draw, with: &Judgement, without: &Judgement, share: f64) {
    let (with_n, without_n) = (with.peak_n, without.peak_n);
    assert!(
        with_n < share * without_n,
        "{draw}: {with_n} N, {without_n} N"
    );
}

/// Runs a draw that has to complete its path.
fn completed(draw: &Draw) -> Judgement {
    let run = run(draw).unwrap();
    assert!(run.completed, "{draw}: {:?}", run.fault);
    run
}

#[test]
fn two_draws_of_every_surface_have_their_stored_figures_in_any_order() {
    let draws = draws();
    let forwards = runs(&draws);
    let mut backwards: Vec<Judgement> = forwards.iter().rev().cloned().collect();
    // Some of them once more, after others than before.
    for index in [0, 7, 14, 21] {
        let again = run(&draws[index]).unwrap();
        assert_eq!(again, forwards[index], "{}", draws[index]);
        backwards.swap(index, 3);
    }
    let report = SuiteReport::of(DRAWS, SEED, forwards);
    assert_eq!(report, SuiteReport::of(DRAWS, SEED, backwards));
    assert_eq!(report.rows.len(), SurfaceKind::ALL.len());
    assert_the_conditions_add_up(&report);
    assert_the_csv_has_all_fields(&report);
    assert_json_and_page_have_both_tables(&report);
    let table = report.to_string();
    assert!(
        table.lines().all(|line| line.chars().count() <= 80),
        "{table}"
    );
    insta::assert_snapshot!(table);
}

/// The groups of one kind have all runs, and together the figures of the first row.
fn assert_the_conditions_add_up(report: &SuiteReport) {
    let all = &report.conditions[0];
    assert_eq!((all.kind, all.condition), ("all", "all"));
    assert_eq!(all.figures.draws, report.runs.len());
    for kinds in [
        &["all"] as &[&str],
        &["force, N"],
        &["stiffness of hard tips, kN/m", "tip: soft"],
        &["tip"],
        &["landed off, deg"],
        &["friction"],
        &["speed, mm/s"],
        &["robot"],
    ] {
        let groups = || {
            report.conditions.iter().filter(|row| {
                let name = format!("{}: {}", row.kind, row.condition);
                kinds.contains(&row.kind) || kinds.contains(&name.as_str())
            })
        };
        let sum = |of: fn(&Figures) -> f64| -> f64 {
            let sum_of_group = |row: &ConditionRow| of(&row.figures) * row.figures.draws as f64;
            groups().map(sum_of_group).sum::<f64>() / all.figures.draws as f64
        };
        assert!((sum(|_| 1.0) - 1.0).abs() < 1e-9, "{kinds:?}");
        let completed = sum(|figures| figures.completed_percent);
        assert!(
            (completed - all.figures.completed_percent).abs() < 1e-9,
            "{kinds:?}: {completed}"
        );
        let lost = sum(|figures| figures.lost_mean);
        assert!(
            (lost - all.figures.lost_mean).abs() < 1e-9,
            "{kinds:?}: {lost}"
        );
        // Every run slides: none is missing from the mean.
        let square = |figures: &Figures| figures.force_rmse_percent.unwrap().powi(2);
        let (groups_rms, all_rms) = (sum(square).sqrt(), square(&all.figures).sqrt());
        assert!((groups_rms - all_rms).abs() < 1e-9, "{kinds:?}");
        let peak_n = groups()
            .map(|row| row.figures.peak_n_max)
            .fold(0.0, f64::max);
        assert_eq!(peak_n, all.figures.peak_n_max, "{kinds:?}");
    }
    let surfaces = report.rows.iter().map(|row| row.figures.peak_n_max);
    assert_eq!(surfaces.fold(0.0, f64::max), all.figures.peak_n_max);
    assert!(report.conditions.iter().all(|row| row.figures.draws > 0));
}

/// Number of fields of a line of CSV; commas between quotes separate none.
fn fields(line: &str) -> usize {
    let outside_quotes = line.split('"').step_by(2);
    1 + outside_quotes
        .map(|part| part.matches(',').count())
        .sum::<usize>()
}

fn assert_the_csv_has_all_fields(report: &SuiteReport) {
    let csv = report.csv();
    let header = csv.lines().next().unwrap();
    for column in [
        "reference_n",
        "stiffness_kn_per_m",
        "tip",
        "stated_tip",
        "landed_deg",
        "friction",
        "speed_mm_per_s",
        "robot",
    ] {
        assert_eq!(
            header.split(',').filter(|&name| name == column).count(),
            1,
            "{header}"
        );
    }
    assert_eq!(csv.lines().count(), 1 + report.runs.len());
    for line in csv.lines() {
        assert_eq!(fields(line), fields(header), "{line}");
    }
}

fn assert_json_and_page_have_both_tables(report: &SuiteReport) {
    let json = serde_json::to_value(report).unwrap();
    let keys = |row: &serde_json::Value| -> Vec<String> {
        row.as_object().unwrap().keys().cloned().collect()
    };
    let (surface, drawn) = (&json["rows"][0], &json["conditions"][1]);
    assert_eq!(surface["surface"], "pipe");
    assert_eq!(
        (&drawn["kind"], &drawn["condition"]),
        (&"force, N".into(), &"1-2".into())
    );
    let figures = |row| {
        let names = ["surface", "kind", "condition"];
        let mut keys = keys(row);
        keys.retain(|key| !names.contains(&key.as_str()));
        keys
    };
    assert_eq!(figures(surface), figures(drawn));
    assert!(drawn["worst"].as_str().unwrap().contains("--draw"));
    let page = report.html();
    for row in &report.conditions[1..] {
        let cell = format!("<td>{}: {}</td>", row.kind, row.condition);
        assert!(page.contains(&cell), "{cell}");
    }
}

/// Tools that give sideways by 2 to 4 mm before the tip slides. A filter that takes this motion for
/// one over the surface is 8 to 16° wrong here.
#[test]
fn a_soft_tool_under_high_friction_is_no_slope() {
    for (number, drawn, most_deg) in [
        (13, "3.8 kN/m, friction 0.85, 18.6 N", 5.0),
        (39, "1.1 kN/m, friction 0.88, 7.7 N", 6.0),
        (82, "1.3 kN/m, friction 0.88, 3.5 N", 3.0),
    ] {
        let draw = draw(SurfaceKind::Plane, number, SEED);
        assert!(draw.to_string().contains(drawn), "{draw}");
        let run = completed(&draw);
        let (normal_deg, nees) = (run.normal_mean_deg.unwrap(), run.nees_per_dof.unwrap());
        assert!(
            normal_deg < most_deg && nees < 2.0,
            "{draw}: {normal_deg} deg, {nees}"
        );
    }
}

/// Soft tips that land tilted stiffen while the force grows. With a constant compliance, the filter
/// takes what they give less for a slope: 5 to 32° wrong, and sure of it. Tips of unknown shape may
/// be soft: where none of them was taken to be, 4 to 8° wrong.
#[test]
fn a_tip_that_stiffens_is_no_slope() {
    let (soft, unknown) = ("tip soft", "stated as unknown");
    for (surface, number, tip, drawn, most_deg) in [
        (SurfaceKind::Edge, 15, soft, "friction 0.61, 18.9 N", 12.0),
        (
            SurfaceKind::TorusOutside,
            21,
            soft,
            "friction 0.78, 29.4 N",
            9.0,
        ),
        (SurfaceKind::Plane, 25, soft, "friction 0.63, 24.8 N", 3.0),
        (
            SurfaceKind::Ellipsoid,
            53,
            soft,
            "friction 0.69, 18.8 N",
            3.5,
        ),
        (SurfaceKind::Pipe, 51, unknown, "tip ring 8.7 mm", 3.5),
        (
            SurfaceKind::TorusInside,
            33,
            unknown,
            "tip soft 8.2 mm",
            5.0,
        ),
        (SurfaceKind::Edge, 11, unknown, "tip soft 8.5 mm", 6.0),
    ] {
        let draw = draw(surface, number, SEED);
        assert!(draw.to_string().contains(drawn), "{draw}");
        assert!(draw.to_string().contains(tip), "{draw}");
        let normal_deg = completed(&draw).normal_mean_deg.unwrap();
        assert!(normal_deg < most_deg, "{draw}: {normal_deg} deg");
    }
}

/// A ball in the corner of a step, or over a seam, touches two faces: with one at a time it
/// chattered between them, and the readings jumped as no load can, or the force went beyond its
/// limit.
#[test]
fn a_round_tip_in_a_corner_does_not_chatter() {
    for (surface, number, peak_ratio_max) in [
        (SurfaceKind::Step, 6, 1.0),
        (SurfaceKind::Step, 34, 1.0),
        (SurfaceKind::Step, 48, f64::INFINITY),
        (SurfaceKind::Step, 81, f64::INFINITY),
        (SurfaceKind::Step, 96, 1.0),
        (SurfaceKind::Seam, 40, 1.0),
        (SurfaceKind::Seam, 99, 1.0),
    ] {
        let draw = draw(surface, number, SEED);
        assert!(draw.to_string().contains("tip round"), "{draw}");
        let run = completed(&draw);
        assert!(
            run.peak_ratio < peak_ratio_max,
            "{draw}: {}",
            run.peak_ratio
        );
    }
}

/// Steps that the tool runs into on stiff cells: the answer to a load along the surface takes a
/// fifth to a half of the true peak away, and lets the first of them complete its path. The path
/// keeps the speed of the task, as far as the normal is certain.
#[test]
fn a_ledge_is_not_pushed_as_if_it_were_friction() {
    for (number, drawn) in [
        (15, "31.9 kN/m, friction 0.48, 10.6 N"),
        (72, "26.6 kN/m, friction 0.63, 5.2 N"),
        (95, "54.1 kN/m, friction 0.23, 6.8 N"),
    ] {
        let draw = draw(SurfaceKind::Step, number, SEED);
        assert!(draw.to_string().contains(drawn), "{draw}");
        let fast = "control.pace.hit_share=0.0";
        let without = run_with(&draw, &[fast, "control.pace.side_least_n=0.0"]);
        let with = run_with(&draw, &[fast]);
        assert!(with.completed || number != 15, "{draw}: {:?}", with.fault);
        assert_lower_peak(&draw, &with, &without, 0.8);
    }
}

/// Stiff cells whose tasks ask for more speed than the arm can answer for: a speed below which a
/// ledge or a wave stays within the limit of the force takes a quarter of the true peak away.
#[test]
fn a_path_is_no_faster_than_the_arm_can_answer() {
    for (surface, number) in [
        (SurfaceKind::WavedSheet, 95),
        (SurfaceKind::Step, 94),
        (SurfaceKind::Edge, 5),
    ] {
        let draw = draw(surface, number, SEED);
        let without = run_with(&draw, &["control.pace.hit_share=0.0"]);
        assert_lower_peak(&draw, &completed(&draw), &without, 0.75);
    }
}

/// Landed 18 to 24 degrees off on a stiff surface with much friction, in a cell whose limit is
/// twice the force: the exploring circle leads uphill, and the whole force went beyond the limit
/// while the normal in use showed little more than the reference.
#[test]
fn an_exploration_leaves_room_up_to_the_limit() {
    for number in [15, 46, 48] {
        let draw = draw(SurfaceKind::Cone, number, 5);
        let run = run_with(
            &draw,
            &[
                "task.force.reference_n=15",
                "limits.force_max_n=30",
                "plant.contact.stiffness_n_per_m=50000",
                "plant.contact.friction.coulomb_coefficient=0.6",
                "plant.contact.friction.static_coefficient=0.66",
                "plant.tool.compliance.stiffness_n_per_m=[300000.0,300000.0,300000.0]",
            ],
        );
        assert!(run.completed, "{draw}: {} {:?}", run.phase, run.fault);
    }
}

/// A tool that goes slowly round the rim of a plate, or down its side: its normal turned by 90
/// degrees, and it wiped the side of the plate to the end of the path, or until the force along it
/// counted as a fault of the sensor. Wide soft tips did so without losing contact.
#[test]
fn a_tool_that_goes_round_a_rim_is_at_the_end_of_its_surface() {
    for (number, seed, hit_share) in [
        (3, 23, 0.5),
        (47, SEED, 1.0),
        (50, SEED, 0.7),
        (5, 23, 1.0),
        (73, 7, 0.7),
    ] {
        let draw = draw(SurfaceKind::Edge, number, seed);
        let run = run_with(&draw, &[&format!("control.pace.hit_share={hit_share}")]);
        assert!(run.completed, "{draw}: {} {:?}", run.phase, run.fault);
    }
}

/// The zero was taken in the air, and noise showed a touch beside it: no zero taken in contact.
#[test]
fn a_touch_in_the_air_does_not_withdraw_the_zero() {
    completed(&draw(SurfaceKind::Seam, 89, SEED));
}

/// Flat pads and rings that run into the wall of a step: they cannot climb it, lift over, and go on
/// behind it.
#[test]
fn a_pad_lifts_over_a_ledge_that_it_cannot_climb() {
    for number in [89, 95] {
        let draw = draw(SurfaceKind::Step, number, SEED);
        assert!(!draw.to_string().contains("tip round"), "{draw}");
        let without = run_with(&draw, &["control.pace.over_m=0.0"]);
        completed(&draw);
        assert!(!without.completed, "{draw}");
    }
}

/// Tips that begin softer than a contact is expected to be, pressed with 1 to 2 N by sensors whose
/// zero drifts as much as a tenth of that: no dead sensor.
#[test]
fn a_soft_first_touch_is_no_dead_sensor() {
    for (surface, number) in [
        (SurfaceKind::Pipe, 26),
        (SurfaceKind::Pipe, 35),
        (SurfaceKind::WavedSheet, 38),
        (SurfaceKind::Gap, 61),
    ] {
        let draw = draw(surface, number, SEED);
        assert!(draw.to_string().contains("tip soft"), "{draw}");
        completed(&draw);
    }
}

/// A bias that the filter believed in hid a contact of 1 N, and the estimate was withheld until the
/// task ended.
#[test]
fn a_bias_does_not_hide_a_contact_for_good() {
    completed(&draw(SurfaceKind::Cone, 18, SEED));
}

/// Tools that the last normal led off the surface, with a force too low for the estimator and too
/// high for a lost contact: they slid on at full speed, up to 40 degrees off, until the task ended.
#[test]
fn a_tool_without_an_estimate_waits_until_it_presses() {
    for (surface, number) in [
        (SurfaceKind::Sphere, 6),
        (SurfaceKind::TorusOutside, 47),
        (SurfaceKind::TorusInside, 62),
    ] {
        completed(&draw(surface, number, SEED));
    }
}

/// Soft tips at 1.1 N: the last normal led the tool to half of its force, where the estimator saw
/// no contact, and the path went on at half of its speed, up to 36 degrees off.
#[test]
fn a_tool_without_an_estimate_stands_at_half_of_its_force() {
    for (surface, number, seed) in [
        (SurfaceKind::WavedSheet, 38, SEED),
        (SurfaceKind::Gap, 39, 3),
        (SurfaceKind::Gap, 89, 3),
    ] {
        completed(&draw(surface, number, seed));
    }
}

/// Paths of 70 to 79 mm/s, slowed down to a thirtieth for an uncertain normal, came to a turn,
/// where the path itself is slow: the tool crept at a tenth of the lowest speed for a minute, felt
/// nothing of the slope, and the normal went up to 18 degrees off.
#[test]
fn a_slow_path_does_not_creep_at_its_turns() {
    for (surface, number, seed) in [
        (SurfaceKind::Sphere, 13, SEED),
        (SurfaceKind::WavedSheet, 8, 2),
        (SurfaceKind::Cone, 6, 2),
    ] {
        let draw = draw(surface, number, seed);
        let run = completed(&draw);
        assert!(run.duration_s < 90.0, "{draw}: {} s", run.duration_s);
        assert!(run.normal_mean_deg.unwrap() < 4.0, "{draw}");
    }
}

/// Stiff contacts of 1 to 3 N, landed 7 to 20 degrees off: the tool slid off within a tenth of a
/// millimetre, again and again, and felt nothing of the slope.
#[test]
fn a_tool_that_slides_off_again_and_again_touches_around_the_place() {
    for (surface, number, seed) in [
        (SurfaceKind::Ellipsoid, 70, 12),
        (SurfaceKind::WavedSheet, 59, 12),
        (SurfaceKind::Seam, 77, 12),
        (SurfaceKind::HeightField, 109, 3),
    ] {
        let draw = draw(surface, number, seed);
        let without = run_with(&draw, &["control.pace.hop_m=0.0"]);
        assert!(!without.completed, "{draw}");
        let with = completed(&draw);
        let off_deg = |run: &Judgement| run.normal_mean_deg.unwrap();
        let (with_deg, without_deg) = (off_deg(&with), off_deg(&without));
        assert!(
            with_deg < 0.4 * without_deg,
            "{draw}: {with_deg} {without_deg}"
        );
    }
}

/// A tool that rolls over a rim or falls beside it: the surface ends there, or is lost, and nothing
/// is wrong with the sensor.
#[test]
fn a_force_along_the_surface_at_a_rim_says_that_the_surface_ends() {
    let (ends, lost) = ("surface ends", "surface lost");
    for (number, seed, reason) in [
        (5, SEED, ends),
        (58, SEED, ends),
        (50, SEED, lost),
        (52, SEED, lost),
        (47, 7, lost),
        (31, 11, lost),
        (49, 11, lost),
    ] {
        let draw = draw(SurfaceKind::Edge, number, seed);
        let run = run(&draw).unwrap();
        let why = run.fault.unwrap_or_default();
        assert!(run.completed && why.contains(reason), "{draw}: {why}");
    }
}

/// The turn of the normal ended the task before, and the cause given was a force along the surface.
#[test]
fn a_normal_that_turns_too_far_is_named_as_such() {
    // A tool that lands further off than its normal may turn. A weak one may lose contact before.
    let draws = (0..20).map(|number| draw(SurfaceKind::Sphere, number, SEED));
    let landed_off = draws.filter(|draw| {
        let drawn = draw.conditions();
        drawn.landed_deg > 18.0 && drawn.reference_n > 5.0
    });
    let mut count = 0;
    for draw in landed_off.take(3) {
        let run = run_with(&draw, &["control.normal.turn_max_rad=0.1"]);
        let fault = run.fault.unwrap();
        assert!(
            fault.contains("the normal turned further"),
            "{draw}: {fault}"
        );
        count += 1;
    }
    assert_eq!(count, 3);
}

/// At 1.1 N the drift of the zero and noise reach the force that counts as a touch, above the
/// surface. It is no loss of contact, and the surface does not end there.
#[test]
fn a_touch_in_the_air_does_not_end_the_task() {
    let draw = draw(SurfaceKind::Plane, 86, SEED);
    assert!(draw.to_string().contains("1.1 N"), "{draw}");
    completed(&draw);
}

#[test]
fn a_draw_follows_from_its_name_alone_and_survives_its_file() {
    for surface in SurfaceKind::ALL {
        for number in 0..20 {
            let one = draw(surface, number, SEED);
            assert_eq!(one, draw(surface, number, SEED));
            assert_ne!(one.scenario, draw(surface, number, SEED + 1).scenario);
            assert_ne!(one.scenario, draw(surface, number + 1, SEED).scenario);
            let seed = one.scenario.seed;
            let again = one
                .clone()
                .with_overrides(&[format!("seed={seed}")])
                .unwrap();
            assert_eq!(one, again, "{one}");
        }
        assert_eq!(SurfaceKind::from_name(surface.name()), Some(surface));
    }
}

#[test]
fn an_override_reaches_a_draw_and_a_wrong_one_is_named() {
    let one = || draw(SurfaceKind::Pipe, 0, SEED);
    let quiet = one()
        .with_overrides(&["plant.errors={}".to_owned(), "controller=paper".to_owned()])
        .unwrap();
    assert_eq!(quiet.scenario.plant.errors, Default::default());
    assert_eq!(quiet.scenario.preset(), "paper");
    let error = one().with_overrides(&["plant.errors.arm.speed=1".to_owned()]);
    assert!(error.unwrap_err().to_string().contains("speed"));
}

/// Draws that failed, and the bug that each of them found.
#[test]
fn draws_that_found_a_bug_are_completed() {
    for (surface, number, seed, bug) in [
        (
            SurfaceKind::WavedSheet,
            20,
            1,
            "34 kN/m were taken for 4 while the tool explored a slope, and the loop rang",
        ),
        (
            SurfaceKind::TorusOutside,
            16,
            1,
            "an exploration over a curved surface was taken for a false force",
        ),
        (
            SurfaceKind::TorusInside,
            15,
            1,
            "the path went on at full speed up a slope while the force rose to twice its reference",
        ),
    ] {
        let run = run(&draw(surface, number, seed)).unwrap();
        assert!(
            run.completed,
            "{} {number}: {bug}: {:?}",
            surface.name(),
            run.fault
        );
        assert!(run.peak_ratio <= 1.5, "{bug}: {}", run.peak_n);
    }
}
