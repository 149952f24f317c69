//! Closed forms for every figure.

use nalgebra::{Matrix3, Vector3};

use super::*;

fn cycle(time_s: f64) -> CycleSample {
    CycleSample {
        time_s,
        phase: Phase::Slide,
        estimate: Some(EstimateSample {
            normal: Vector3::z(),
            covariance: Matrix3::identity() * 1e-4,
            valid: true,
        }),
        truth: Some(TruthSample {
            normal: Vector3::z(),
            tool_z: -Vector3::z(),
            in_contact: true,
            force_n: 3.0,
        }),
        tool_position: Vector3::zeros(),
        tool_z: -Vector3::z(),
        force_n: Some(3.0),
        force_reference_n: 3.0,
        in_contact: true,
        path_reference: Vector3::zeros(),
        path_error_m: 0.0,
        joint_speed_rad_per_s: 0.1,
        manipulability: 0.05,
        motion_tank_j: None,
        force_tank_j: None,
    }
}

/// 4 s at 100 Hz.
fn run(change: impl Fn(usize, &mut CycleSample)) -> Figures {
    let samples: Vec<CycleSample> = (0..400)
        .map(|i| {
            let mut sample = cycle(i as f64 * 0.01);
            change(i, &mut sample);
            sample
        })
        .collect();
    Figures::of(&samples)
}

fn turned(angle_deg: f64) -> Vector3<f64> {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    Vector3::new(sin, 0.0, cos)
}

#[test]
fn a_spread_is_the_textbook_one() {
    let s = Spread::of(&mut [4.0, 1.0, 3.0, 2.0]).unwrap();
    assert_eq!((s.mean, s.median, s.max, s.n), (2.5, 2.5, 4.0, 4));
    assert!((s.std - 1.25f64.sqrt()).abs() < 1e-15 && (s.rmse - 7.5f64.sqrt()).abs() < 1e-15);
    assert_eq!(s.p95, 4.0);
    let mut hundred: Vec<f64> = (1..=100).map(f64::from).collect();
    assert_eq!(Spread::of(&mut hundred).unwrap().p95, 95.0);
    assert_eq!(Spread::of(&mut []), None);
}

#[test]
fn angles_are_taken_between_the_right_vectors() {
    let figures = run(|_, s| {
        s.truth.as_mut().unwrap().normal = turned(3.0);
        s.tool_z = -turned(-2.0);
        s.truth.as_mut().unwrap().tool_z = -turned(-1.0);
    });
    assert!((figures.normal_error_deg.unwrap().mean - 3.0).abs() < 1e-12);
    assert!((figures.alignment_error_deg.unwrap().mean - 2.0).abs() < 1e-12);
    assert!((figures.tool_error_deg.unwrap().mean - 4.0).abs() < 1e-12);
}

#[test]
fn small_angles_keep_their_digits() {
    assert!((angle_deg(&Vector3::z(), &turned(1e-9)) - 1e-9).abs() < 1e-20);
}

#[test]
fn settled_figures_leave_out_the_first_second_of_contact() {
    let figures = run(|i, s| {
        if i < 150 {
            s.truth.as_mut().unwrap().normal = turned(10.0);
        }
        if i < 50 {
            s.truth.as_mut().unwrap().in_contact = false;
        }
    });
    assert_eq!(figures.contact.first_s, Some(0.5));
    assert!((figures.normal_error_deg.unwrap().max - 10.0).abs() < 1e-9);
    let settled = figures.normal_error_settled_deg.unwrap();
    assert!(settled.max < 1e-9);
    assert_eq!(settled.n, 250);
}

#[test]
fn the_nees_of_an_error_of_one_sigma_on_both_axes_is_one() {
    let figures = run(|_, s| {
        let tilt: f64 = 0.01;
        let n = Vector3::new(tilt, tilt, 0.0);
        s.truth.as_mut().unwrap().normal = Vector3::new(n.x, n.y, (1.0 - 2.0 * tilt * tilt).sqrt());
    });
    assert!((figures.normal_nees_per_dof.unwrap() - 1.0).abs() < 1e-9);
}

#[test]
fn force_figures_have_closed_forms() {
    // A square wave of 0.2 N about the reference: RMSE, MAD and p95 are all its height.
    let figures = run(|i, s| {
        s.truth.as_mut().unwrap().force_n = if i % 2 == 0 { 3.2 } else { 2.8 };
    });
    let force = figures.force;
    for value in [force.rmse_n, force.mad_n, force.p95_abs_error_n] {
        assert!((value.unwrap() - 0.2).abs() < 1e-12);
    }
    assert!((force.mean_n.unwrap() - 3.0).abs() < 1e-12);
}

#[test]
fn a_force_in_the_retraction_is_part_of_the_peak_and_of_nothing_else() {
    let retracts = |i: usize, s: &mut CycleSample| {
        if i >= 300 {
            s.phase = Phase::Retract;
        }
    };
    let before = run(retracts).force;
    let figures = run(|i, s| {
        retracts(i, s);
        if i == 320 {
            s.truth.as_mut().unwrap().force_n = 173.0;
        }
    })
    .force;
    assert_eq!(figures.peak_n, Some(173.0));
    assert_eq!(figures.rmse_all_n, before.rmse_all_n);
    assert_eq!(figures.overshoot_percent, before.overshoot_percent);
}

#[test]
fn overshoot_and_settling_are_those_of_the_touchdown() {
    // A ramp that reaches 3.9 N after 0.3 s, then 3 N; a later peak is not part of the overshoot.
    let figures = run(|i, s| {
        let t = s.time_s;
        s.phase = if i < 200 {
            Phase::Contact
        } else {
            Phase::Slide
        };
        s.truth.as_mut().unwrap().force_n = match i {
            0..30 => 3.9 * t / 0.3,
            30 => 3.9,
            300 => 6.0,
            _ => 3.0,
        };
    });
    assert!((figures.force.overshoot_percent.unwrap() - 30.0).abs() < 1e-9);
    assert_eq!(figures.force.peak_n, Some(6.0));
    assert!((figures.force.settling_s.unwrap() - 0.31).abs() < 1e-9);
}

#[test]
fn lost_contact_is_counted_and_timed_until_the_retraction() {
    let figures = run(|i, s| {
        let truth = s.truth.as_mut().unwrap();
        truth.in_contact = !(100..110).contains(&i) && !(200..205).contains(&i) && i < 350;
        if i >= 345 {
            s.phase = Phase::Retract;
        }
    });
    assert_eq!(figures.contact.lost_count, 2);
    assert!((figures.contact.lost_s - 0.15).abs() < 1e-9);
    assert!((figures.contact.fraction.unwrap() - 330.0 / 345.0).abs() < 1e-12);
}

#[test]
fn path_figures_are_per_axis_and_in_the_plane() {
    let figures = run(|_, s| {
        s.tool_position = Vector3::new(0.003, -0.004, 0.0);
        s.path_error_m = 0.005;
    });
    assert!((figures.path.rmse_m.unwrap() - 0.005).abs() < 1e-15);
    let [x, y, z] = figures.path.mad_xyz_m.unwrap();
    assert!((x - 0.003).abs() < 1e-15 && (y - 0.004).abs() < 1e-15 && z == 0.0);
}

#[test]
fn without_truth_the_controllers_own_view_counts() {
    let figures = run(|_, s| {
        s.truth = None;
        s.force_n = Some(2.5);
    });
    assert_eq!(figures.normal_error_deg, None);
    assert!((figures.force.rmse_n.unwrap() - 0.5).abs() < 1e-12);
    assert_eq!(figures.contact.fraction, Some(1.0));
}

#[test]
fn a_run_without_contact_has_nulls() {
    let figures = run(|_, s| s.truth.as_mut().unwrap().in_contact = false);
    assert_eq!(figures.normal_error_deg, None);
    assert_eq!(figures.contact.first_s, None);
    assert_eq!(figures.force.rmse_n, None);
}

#[test]
fn a_touchdown_that_bounces_is_judged_by_its_highest_bounce() {
    // Alternately 0.2 s on the surface and 0.1 s off it, harder each time; in contact from 2.1 s
    // on.
    let bouncing = |settles: bool| {
        run(|i, s| {
            let (bounce, inside) = (i / 30, i % 30);
            let done = settles && i >= 210;
            s.phase = if done && i >= 300 {
                Phase::Slide
            } else if done || inside < 20 {
                Phase::Contact
            } else {
                Phase::Seek
            };
            let truth = s.truth.as_mut().unwrap();
            truth.in_contact = done || inside < 20;
            truth.force_n = match (done, truth.in_contact) {
                (true, _) => 3.0,
                (false, true) => 2.0 + bounce as f64 * 0.5,
                (false, false) => 0.0,
            };
        })
        .force
    };
    let settled = bouncing(true);
    assert!((settled.overshoot_percent.unwrap() - 200.0 / 3.0).abs() < 1e-9);
    assert!((settled.settling_s.unwrap() - 2.1).abs() < 1e-9);
    // If the force never settles, the whole span counts.
    let never = bouncing(false);
    assert!((never.overshoot_percent.unwrap() - 550.0 / 3.0).abs() < 1e-9);
    assert_eq!(never.settling_s, None);
}

#[test]
fn a_slide_that_loses_the_surface_at_once_ends_no_touchdown() {
    let figures = run(|i, s| {
        s.phase = match i {
            0..50 | 70..200 => Phase::Contact,
            60..70 => Phase::Seek,
            _ => Phase::Slide,
        };
        let truth = s.truth.as_mut().unwrap();
        truth.in_contact = !(60..70).contains(&i);
        truth.force_n = match i {
            0..60 => 2.0,
            60..70 => 0.0,
            70..80 => 4.5,
            300 => 9.0,
            _ => 3.0,
        };
    });
    assert!((figures.force.overshoot_percent.unwrap() - 50.0).abs() < 1e-9);
}
