//! A retraction that is obstructed, under each law: it stops, and the true force stays bounded as
//! far as physics allows.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
use crate::three_laws::{Cell, Law};
use nalgebra::Vector3;
use tangent_control::{Clearance, Fault, Limits, Phase};
use tangent_simulation::Obstacle;

/// Stiffnesses, N/m, and speeds of the retraction, m/s.
const STIFFNESSES: [f64; 5] = [5e3, 1e4, 2.5e4, 5e4, 1e5];
const SPEEDS: [f64; 2] = [0.02, 0.08];
const CELLS: [(Law, &str); 3] = [
    (Law::Velocity, "plane"),
    (Law::Hybrid, "lippiello/lippiello_realistic"),
    (Law::Unified, "karacan/karacan_wave"),
];

/// Stiffest contact that the velocity-controlled arm expects, N/m.
const EXPECTED_N_PER_M: f64 = 5e4;

/// Largest force with which the tool may rest at what it met, N.
const RESTS_MAX_N: f64 = 8.0;
/// Largest force with which the tool of a torque law may rest whose normal was wrong, as a share of
/// the force of the task: the arm then rests where it pressed with that force.
const RESTS_SHARE: f64 = 1.2;

/// Obstruction of a retraction.
#[derive(Clone, Copy, Debug)]
enum Met {
    /// A wall as stiff as the surface, 3 mm behind the tool.
    Wall,
    /// The normal along which the tool retracts points into the surface.
    WrongNormal,
}

/// What an obstructed retraction came to.
struct Retracted {
    /// Largest true force since its start, and the one with which the tool rests, N.
    peak_n: f64,
    rests_n: f64,
    /// Force of the task, and bound on the true force, N.
    reference_n: f64,
    bound_n: f64,
    /// What ended the task.
    fault: Option<Fault>,
}

/// Slides for a second, stops the task, and obstructs the tool from then on.
fn retract(law: Law, path: &str, stiffness: f64, speed_m_per_s: f64, met: Met) -> Retracted {
    let mut set = vec![
        format!("plant.contact.stiffness_n_per_m={stiffness:.1}"),
        format!("task.end.retract_speed_m_per_s={speed_m_per_s}"),
    ];
    if law == Law::Velocity {
        set.push("plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned());
        set.push("plant.sensor.noise_nm_per_sqrt_hz=6e-5".to_owned());
    }
    let mut cell = Cell::new(law, path, &set);
    let (mut slid_s, mut normal) = (0.0, Vector3::z());
    while slid_s < 1.0 {
        let seen = cell.step();
        assert!(
            seen.time_s < cell.duration_s && seen.fault.is_none(),
            "{seen:?}"
        );
        normal = seen.normal;
        slid_s += f64::from(u8::from(seen.phase == Phase::Slide)) * cell.period_s;
    }
    match met {
        Met::Wall => {
            cell.stop();
            cell.put_in_the_way(Obstacle {
                gap_m: 0.003,
                stiffness_n_per_m: stiffness,
            });
        }
        Met::WrongNormal => cell.stop_along(-normal),
    }
    let mut peak_n = 0.0_f64;
    for _ in 0..(20.0 / cell.period_s) as usize {
        let seen = cell.step();
        peak_n = peak_n.max(seen.force_n);
        if !seen.phase.is_active() {
            let known = seen.clearance == Clearance::Unknown;
            assert!(
                known || seen.fault.is_none(),
                "{law:?}: {:?}",
                seen.clearance
            );
            // The result shows whether the arm still moves.
            let mut rests_n = 0.0;
            for _ in 0..(0.5 / cell.period_s) as usize {
                rests_n = cell.step().force_n;
                peak_n = peak_n.max(rests_n);
            }
            return Retracted {
                peak_n,
                rests_n,
                reference_n: cell.reference_n,
                bound_n: cell.bound_n(),
                fault: seen.fault,
            };
        }
    }
    panic!("{law:?}: still on its way");
}

/// Force that the arm may reach while it detects the contact and stops, N: the default limit of a
/// cell. A velocity-controlled arm may exceed it by a fifth, because delays vary, and with
/// something stiffer than expected by as much as that is stiffer.
fn until_it_stands_n(law: Law, stiffness: f64, speed_m_per_s: f64) -> f64 {
    let force_max_n = Limits::default().force_max_n;
    match law {
        Law::Velocity => {
            let stiffer = (stiffness / EXPECTED_N_PER_M).max(1.0);
            (3.0 + 5.0 + speed_m_per_s * 0.05 * stiffness).min(1.2 * stiffer * force_max_n)
        }
        // The arm itself is compliant: only a fast one may exceed the bound of the task.
        Law::Hybrid | Law::Unified if speed_m_per_s > SPEEDS[0] => force_max_n,
        Law::Hybrid | Law::Unified => 0.0,
    }
}

fn table(met: Met) {
    let mut wrong = Vec::new();
    for (law, path) in CELLS {
        for (stiffness, speed) in STIFFNESSES.iter().flat_map(|k| SPEEDS.map(|v| (*k, v))) {
            let Retracted {
                peak_n,
                rests_n,
                reference_n,
                bound_n,
                fault,
            } = retract(law, path, stiffness, speed, met);
            let rests_max_n = match (law, met) {
                (Law::Hybrid | Law::Unified, Met::WrongNormal) => {
                    RESTS_MAX_N.max(RESTS_SHARE * reference_n)
                }
                _ => RESTS_MAX_N,
            };
            println!(
                "{met:?} {law:?} {stiffness} N/m {speed} m/s: {peak_n:.1} N of {bound_n} N, rests with {rests_n:.1} N, {fault:?}"
            );
            if fault != Some(Fault::RetractOpposed)
                || peak_n > until_it_stands_n(law, stiffness, speed).max(bound_n)
                || rests_n > rests_max_n
            {
                wrong.push((law, stiffness, speed, peak_n, rests_n, fault));
            }
        }
    }
    assert!(wrong.is_empty(), "{met:?}: {wrong:?}");
}

/// A stop in any phase, with any force and without an obstacle: the task ends as done, with a tool
/// that hangs free.
#[test]
fn a_stop_with_nothing_in_the_way_ends_done() {
    let mut wrong = Vec::new();
    for (law, path) in CELLS {
        for (phase, waits) in [
            (Phase::Approach, vec![0.5]),
            (Phase::Contact, vec![0.0, 0.1]),
            (
                Phase::Slide,
                vec![0.0, 0.05, 0.2, 0.9, 1.0, 1.3, 1.537, 1.9, 2.411],
            ),
        ] {
            for wait_s in waits {
                for share in [1.0, 0.6] {
                    let mut cell = Cell::new(law, path, &[]);
                    let mut in_s = 0.0;
                    let mut seen = cell.step();
                    while seen.phase != phase || in_s < wait_s {
                        assert!(seen.phase.is_active(), "{law:?} {phase:?} {seen:?}");
                        if seen.phase == phase {
                            in_s += cell.period_s;
                            // The force reference changes at its limited rate while the tool
                            // slides.
                            if (0.5..0.5 + cell.period_s).contains(&in_s) {
                                cell.press(share * cell.reference_n);
                            }
                        }
                        seen = cell.step();
                    }
                    cell.stop();
                    let mut peak_n = 0.0_f64;
                    while seen.phase.is_active() {
                        seen = cell.step();
                        peak_n = peak_n.max(seen.force_n);
                    }
                    println!("{law:?} {phase:?} {wait_s} s {share}: {peak_n:.1} N");
                    if seen.fault.is_some() || !seen.clearance.is_free() {
                        wrong.push((law, phase, wait_s, share, seen.fault, seen.clearance));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_wall_behind_the_tool_stops_it() {
    table(Met::Wall);
}

#[test]
fn a_wrong_normal_stops_at_once() {
    table(Met::WrongNormal);
}
