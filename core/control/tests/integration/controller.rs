//! The composed controller against a small plant with perfect or faulty inputs. Every cycle checks
//! the safety conditions; the finer physics is tested in the closed loop of `evaluate`.

use crate::bench::{Bench, TASK};
use nalgebra::{UnitQuaternion, Vector3};
use tangent_control::{
    Clearance, CommandKind, ControlInput, ControllerConfig, Excess, Fault, Limits, Parameter,
    Phase, Program, SwitchCause, SwitchRefusal, Task, UntaredLoad,
};
use tangent_mechanics::Joints;
use tangent_sensing::Validity;

#[test]
fn a_task_runs_through_its_phases_at_both_rates() {
    for dt in [0.008, 0.002] {
        let mut bench = Bench::at_rate(TASK, dt);
        let mut seen = Vec::new();
        let start = bench.tool();
        loop {
            let output = bench.step(|_| {});
            if seen.last() != Some(&output.phase) {
                seen.push(output.phase);
            }
            if !output.phase.is_active() {
                break;
            }
            assert!(bench.time_s < 60.0, "{seen:?}");
        }
        use Phase::{Approach, Contact, Done, Hold, Retract, Slide};
        assert_eq!(seen, [Approach, Contact, Slide, Hold, Retract, Done]);
        let moved = bench.tool() - start;
        assert!((moved.xy().norm() - 0.04).abs() < 2e-3, "{moved}");
        assert!(moved.z > 0.03);
        // The arm comes to rest, and then no motion is commanded.
        bench.steps(50);
        assert_eq!(bench.last.as_ref().unwrap().kind, CommandKind::Hold);
    }
}

#[test]
fn the_tare_comes_before_anything_moves() {
    let mut bench = Bench::new(&TASK.replace("tare = false", "tare = true"));
    let start = bench.q;
    for _ in 0..100 {
        let output = bench.step(|input| {
            // A possible reading of an untared sensor.
            input.wrench.force = Vector3::new(9.0, 1.0, -7.0);
            input.bias_age_s = Some(100.0);
        });
        assert!(output.tare_requested);
        assert_eq!((output.phase, bench.q), (Phase::Tare, start));
    }
    let output = bench.step(|input| input.bias_age_s = Some(0.0));
    assert_eq!(output.phase, Phase::Approach);
    assert!(!output.in_contact);
    let mut late = Bench::new(&TASK.replace("tare = false", "tare = true"));
    let output = late.run_until(Phase::Fault);
    assert_eq!(output.fault, Some(Fault::NoTare));
    assert_eq!(late.q, start);
}

#[test]
fn a_bad_wrench_stops_within_two_cycles_and_retracts_along_the_normal() {
    type Spoil = fn(&mut ControlInput);
    let cases: [(Spoil, Validity); 5] = [
        (|i| i.wrench.force.z = f64::NAN, Validity::NotFinite),
        (
            |i| i.wrench_validity = Validity::Saturated,
            Validity::Saturated,
        ),
        (
            |i| i.wrench_validity = Validity::SensorError,
            Validity::SensorError,
        ),
        (|i| i.wrench_age_s = 0.05, Validity::Stale),
        (|i| i.wrench_validity = Validity::Missing, Validity::Missing),
    ];
    for (spoil, reason) in cases {
        let mut bench = Bench::sliding(TASK);
        bench.steps(60);
        let at = bench.tool();
        bench.step(spoil);
        let second = bench.step(spoil);
        assert!(
            matches!(second.phase, Phase::Hold | Phase::Retract),
            "{reason:?}: {:?}",
            second.phase
        );
        let mut steps = 0;
        while bench.last.as_ref().unwrap().phase.is_active() {
            bench.step(spoil);
            steps += 1;
            assert!(steps < 1000);
        }
        let last = bench.last.as_ref().unwrap();
        assert_eq!(last.fault, Some(Fault::Wrench(reason)));
        assert_eq!(last.phase, Phase::Fault);
        let away = bench.tool() - at;
        assert!(away.z > 0.04, "{reason:?}: {away}");
        assert!(away.xy().norm() < 5e-3, "{reason:?}: {away}");
    }
}

#[test]
fn a_short_silence_of_the_wrench_is_ridden_out_standing() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(50);
    for _ in 0..8 {
        bench.step(|input| input.wrench_age_s = 0.06);
    }
    assert_eq!(bench.last.as_ref().unwrap().phase, Phase::Hold);
    assert!(bench.speed() < 1e-9);
    assert_eq!(bench.run_until(Phase::Done).fault, None);
}

#[test]
fn a_silent_estimate_stops_sliding_keeps_the_force_then_retracts() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(60);
    let silent = |input: &mut ControlInput| {
        for slot in input.estimates.iter_mut().flatten() {
            slot.age_s = 0.15;
        }
    };
    assert_eq!(bench.step(silent).phase, Phase::Hold);
    for _ in 0..60 {
        bench.step(silent);
    }
    let output = *bench.last.as_ref().unwrap();
    assert_eq!(output.phase, Phase::Hold);
    assert!(bench.speed() < 2e-3);
    assert!(
        (output.force_n.unwrap() - 3.0).abs() < 0.3,
        "{}",
        output.force_n.unwrap()
    );
    while bench.last.as_ref().unwrap().phase == Phase::Hold {
        bench.step(silent);
    }
    let output = bench.last.as_ref().unwrap();
    assert_eq!(output.phase, Phase::Retract);
    assert_eq!(output.fault, Some(Fault::Estimate(Validity::Stale)));
}

#[test]
fn one_estimator_fallen_silent_is_replaced_by_the_next() {
    let mut bench = Bench::sliding(TASK);
    let mut output = bench.step(|_| {});
    while output.phase.is_active() {
        output = bench.step(|input| input.estimates[0] = None);
        assert_eq!(output.estimator, 1);
    }
    assert_eq!((output.phase, output.fault), (Phase::Done, None));
}

#[test]
fn contact_lost_stops_the_path_seeks_and_resumes_there() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(80);
    let progress = bench.last.as_ref().unwrap().path_progress;
    assert!(progress > 0.1);
    bench.plane_m -= 0.005;
    bench.steps(3);
    let output = *bench.last.as_ref().unwrap();
    assert_eq!(output.phase, Phase::Seek);
    let stopped_at = output.path_progress;
    let output = bench.run_until(Phase::Contact);
    assert_eq!(output.contact_lost_count, 1);
    assert_eq!(output.path_progress, stopped_at);
    assert_eq!(bench.run_until(Phase::Done).fault, None);
}

#[test]
fn a_contact_that_keeps_bouncing_ends_the_task() {
    let mut bench = Bench::new(TASK);
    let (mut output, mut cycle) = (bench.step(|_| {}), 0);
    while output.phase.is_active() {
        cycle += 1;
        // A surface that is present in every other 80 ms.
        output = bench.step(|input| {
            if cycle / 10 % 2 == 0 {
                input.wrench.force = Vector3::zeros();
            }
        });
        assert!(cycle < 5000);
    }
    assert_eq!(output.fault, Some(Fault::ContactUnstable));
}

#[test]
fn what_is_not_there_is_not_pushed_for_ever() {
    let mut bench = Bench::new(TASK);
    bench.plane_m = -10.0;
    let start = bench.tool();
    let mut lowest = start.z;
    let mut output = bench.step(|_| {});
    while output.phase.is_active() {
        output = bench.step(|_| {});
        lowest = lowest.min(bench.tool().z);
    }
    assert_eq!(output.fault, Some(Fault::NoSurface));
    assert!(start.z - lowest < 0.085);

    let mut bench = Bench::sliding(TASK);
    let at = bench.tool().z;
    bench.plane_m = -10.0;
    let mut lowest = at;
    let mut output = bench.step(|_| {});
    while output.phase.is_active() {
        output = bench.step(|_| {});
        lowest = lowest.min(bench.tool().z);
    }
    assert_eq!(output.fault, Some(Fault::SurfaceLost));
    assert!(at - lowest < Limits::default().blind_distance_max_m + 0.005);
    // A sensor that reads nothing any more looks the same.
    let seek_m = ControllerConfig::default().contact.seek_distance_max_m;
    assert!(at - lowest < seek_m + 0.005, "{} m", at - lowest);
}

#[test]
fn too_much_force_retracts() {
    let mut bench = Bench::sliding(TASK);
    let mut force_n = 0.0;
    let output = bench.step(|input| {
        input.wrench.force *= 20.0;
        force_n = input.wrench.force.norm();
    });
    // The fault says what was felt, and keeps it while the tool retracts.
    let fault = Fault::ForceLimit(Excess::new(force_n, Limits::default().force_max_n));
    assert_eq!((output.phase, output.fault), (Phase::Retract, Some(fault)));
    assert_eq!(bench.run_until(Phase::Fault).fault, Some(fault));
}

#[test]
fn pause_resume_stop() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(50);
    bench.controller.pause().unwrap();
    bench.steps(100);
    let paused = *bench.last.as_ref().unwrap();
    assert_eq!(paused.phase, Phase::Hold);
    assert!((paused.force_n.unwrap() - 3.0).abs() < 0.2);
    let at = bench.tool();
    bench.steps(200);
    assert!((bench.tool() - at).norm() < 1e-4);
    bench.controller.resume().unwrap();
    assert_eq!(bench.step(|_| {}).phase, Phase::Slide);
    let task: Task = TASK.parse().unwrap();
    assert!(bench.controller.start_task(&task).is_err());
    bench.controller.stop();
    assert_eq!(bench.step(|_| {}).phase, Phase::Retract);
    assert!(bench.controller.pause().is_err());
    assert_eq!(bench.run_until(Phase::Done).fault, None);
    assert!(bench.controller.resume().is_err());
    let before = bench.last.as_ref().unwrap().activation;
    let program = Program::new(&task, &ControllerConfig::default()).unwrap();
    bench.controller.start(program, 17).unwrap();
    let after = bench.step(|_| {}).activation;
    assert!(after > 17 && after > before);
}

#[test]
fn an_arm_that_stops_taking_commands_ends_the_task_without_a_motion() {
    let mut bench = Bench::sliding(TASK);
    let output = bench.step(|input| input.arm_ready = false);
    assert_eq!(output.phase, Phase::Fault);
    assert_eq!(output.kind, CommandKind::Hold);
    bench.steps(100);
    // Ready again, the arm does not resume by itself.
    let output = bench.last.as_ref().unwrap();
    assert_eq!(
        (output.phase, output.kind),
        (Phase::Fault, CommandKind::Hold)
    );
    assert_eq!(output.qd, Joints::<6>::zeros());
}

#[test]
fn a_switch_of_estimators_is_gated_and_bumpless() {
    let mut bench = Bench::sliding(TASK);
    let tilted = |degrees: f64| {
        move |input: &mut ControlInput| {
            if let Some(second) = &mut input.estimates[1] {
                let angle = degrees.to_radians();
                second.estimate.normal = Vector3::new(angle.sin(), 0.0, angle.cos());
            }
        }
    };
    bench.step(tilted(30.0));
    assert!(matches!(
        bench.controller.select_estimator("second", false),
        Err(SwitchRefusal::Disagrees { .. })
    ));
    assert_eq!(
        bench.controller.select_estimator("third", true),
        Err(SwitchRefusal::Unknown)
    );
    bench.step(tilted(15.0));
    bench.controller.select_estimator("second", false).unwrap();
    let mut before = bench.last.as_ref().unwrap().normal;
    let most = bench.controller.config().normal.turn_rate_max_rad_per_s * bench.dt_s;
    for i in 0..30 {
        let output = bench.step(tilted(15.0));
        assert_eq!(output.estimator, 1);
        let turned = before.cross(&output.normal).norm().asin();
        assert!(turned <= most + 1e-9, "cycle {i}: {turned}");
        before = output.normal;
    }
    assert!((before.z.acos().to_degrees() - 15.0).abs() < 5.0);
}

#[test]
fn nonsense_is_left_within_the_patience_with_the_force_held() {
    type Spoil = fn(&mut ControlInput);
    let spoils: [Spoil; 4] = [
        |i| i.estimates[0] = None,
        |i| i.estimates[0].as_mut().unwrap().age_s = 0.5,
        |i| i.estimates[0].as_mut().unwrap().estimate.normal.x = f64::NAN,
        |i| i.estimates[0].as_mut().unwrap().estimate.normal = -Vector3::z(),
    ];
    for spoil in spoils {
        let mut bench = Bench::sliding(TASK);
        bench.steps(60);
        let patience = bench.controller.config().patience.estimate_s;
        let since = bench.time_s;
        let mut output = bench.step(spoil);
        while output.estimator == 0 {
            output = bench.step(spoil);
            assert!(bench.time_s - since < patience + 3.0 * bench.dt_s);
        }
        assert_eq!(output.estimator_switches, 1);
        assert!(matches!(output.estimator_cause, SwitchCause::FellBack(_)));
        while output.phase == Phase::Slide {
            assert!(
                (output.force_n.unwrap() - 3.0).abs() < 0.3,
                "{}",
                output.force_n.unwrap()
            );
            output = bench.step(spoil);
        }
        // When the preferred estimator is good again, the controller returns to it only on request.
        assert_eq!(bench.run_until(Phase::Done).estimator, 1);
    }
}

#[test]
fn the_switch_is_there_in_the_cycle_after_it_was_accepted() {
    let mut bench = Bench::sliding(TASK);
    bench.controller.select_estimator("second", false).unwrap();
    let output = bench.step(|_| {});
    assert_eq!(
        (output.estimator, output.estimator_cause),
        (1, SwitchCause::Asked)
    );
}

#[test]
fn a_live_parameter_comes_into_force_over_a_ramp() {
    let mut bench = Bench::sliding(&TASK.replace("0.04, 0.0", "0.3, 0.0"));
    bench.steps(100);
    bench.controller.set(Parameter::ForceReference, 6.0);
    bench.controller.set(Parameter::Speed, 0.01);
    bench.controller.set(Parameter::AlignmentGain, f64::NAN);
    let mut force = bench.last.as_ref().unwrap().force_n.unwrap();
    for _ in 0..200 {
        let output = bench.step(|_| {});
        assert!(
            (output.force_n.unwrap() - force).abs() < 0.3,
            "{force} -> {}",
            output.force_n.unwrap()
        );
        force = output.force_n.unwrap();
    }
    assert!((force - 6.0).abs() < 0.2, "{force}");
    assert!((bench.speed() - 0.01).abs() < 1e-3, "{}", bench.speed());
    assert!(bench.controller.config().alignment.gain_per_s.is_finite());
}

/// A bench whose tool presses at a start with possible contact: the controller was killed while the
/// tool slid.
fn in_doubt(change: impl FnOnce(&mut Bench)) -> Bench {
    let mut bench = Bench::sliding(TASK);
    bench.steps(50);
    bench.step(|input| input.arm_ready = false);
    bench.steps(20);
    change(&mut bench);
    let task: Task = TASK.parse().unwrap();
    bench.controller.start_task(&task).unwrap();
    bench
}

#[test]
fn a_start_in_doubt_moves_off_along_the_last_normal() {
    let mut bench = in_doubt(|_| {});
    let at = bench.tool();
    assert_eq!(bench.step(|_| {}).phase, Phase::Clear);
    bench.run_until(Phase::Approach);
    let away = bench.tool() - at;
    assert!((0.005..0.01).contains(&away.z), "{away}");
    assert!(away.xy().norm() < 1e-3, "{away}");
    assert_eq!(bench.run_until(Phase::Done).fault, None);
    assert_eq!(bench.controller.clearance(), Clearance::Free);
}

#[test]
fn moving_off_stops_where_it_presses_harder_feels_nothing_or_is_elsewhere() {
    // The surface follows the tool.
    let mut bench = in_doubt(|_| {});
    let mut output = bench.step(|_| {});
    while output.phase == Phase::Clear {
        bench.plane_m += 0.0002;
        output = bench.step(|_| {});
    }
    assert_eq!(output.fault, Some(Fault::NotClear));
    // It gives way to what it has met, and no further.
    let mut rests_n = f64::NAN;
    while output.phase.is_active() {
        assert_eq!(output.phase, Phase::Retract);
        rests_n = output.force_n.unwrap();
        output = bench.step(|_| {});
    }
    assert_eq!(output.phase, Phase::Fault);
    assert_eq!(bench.controller.clearance(), Clearance::Unknown);
    assert!(rests_n < 4.2, "{rests_n} N");
    // Without a wrench there is no motion.
    let mut bench = in_doubt(|_| {});
    let at = bench.tool();
    let mut output = bench.step(|input| input.wrench_validity = Validity::Missing);
    while output.phase == Phase::Clear {
        output = bench.step(|input| input.wrench_validity = Validity::Missing);
    }
    assert_eq!(output.fault, Some(Fault::Wrench(Validity::Missing)));
    assert!((bench.tool() - at).norm() < 1e-4);
    // At another position: refused at the start, and a fault without a motion if the check was
    // skipped.
    let mut bench = in_doubt(|bench| bench.q[0] += 0.1);
    let tool = bench.tool();
    assert!(bench.controller.check_start(&tool).is_err());
    let output = bench.step(|_| {});
    assert_eq!(output.fault, Some(Fault::NotClear));
    // The direction away is not known: no start until a person confirms that the tool is free.
    let mut bench = Bench::new(TASK);
    bench.controller.stop();
    bench.run_until(Phase::Done);
    bench.controller.set_clearance(Clearance::Unknown).unwrap();
    let task: Task = TASK.parse().unwrap();
    let refused = bench.controller.start_task(&task).unwrap_err();
    assert!(refused.to_string().contains("--clear"), "{refused}");
    bench.controller.set_clearance(Clearance::Assumed).unwrap();
    bench.controller.start_task(&task).unwrap();
}

#[test]
fn a_retraction_that_meets_something_stops_there() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(50);
    bench.controller.stop();
    let mut output = bench.step(|_| {});
    let wall = bench.tool().z + 0.01;
    let mut peak = 0.0_f64;
    while output.phase.is_active() {
        let push = (5000.0 * (bench.tool().z - wall)).max(0.0);
        peak = peak.max(push);
        // The tool points down: a wall above pushes along its z axis.
        output = bench.step(|input| input.wrench.force.z += push);
    }
    assert_eq!(output.phase, Phase::Fault);
    assert_eq!(output.fault, Some(Fault::RetractOpposed));
    assert!(peak < 10.0, "{peak} N");
    assert_eq!(bench.controller.clearance(), Clearance::Unknown);
}

#[test]
fn a_retraction_that_feels_nothing_is_slow_and_leaves_a_doubt() {
    let mut bench = Bench::sliding(TASK);
    bench.controller.stop();
    let deaf = |input: &mut ControlInput| input.wrench_age_s = 1.0;
    let mut output = bench.step(deaf);
    let mut fastest = 0.0_f64;
    while output.phase.is_active() {
        output = bench.step(deaf);
        if output.phase == Phase::Retract {
            assert_eq!((output.force_n, output.wrench), (None, None));
            fastest = fastest.max(output.twist_commanded.linear.norm());
        }
    }
    assert!(fastest > 0.005 && fastest < 0.0101, "{fastest} m/s");
    assert!(!bench.controller.clearance().is_free());
}

#[test]
fn no_zero_hides_a_load_and_a_zero_that_is_lost_ends_the_task() {
    let mut bench = Bench::sliding(TASK);
    let output = bench.step(|input| {
        input.untared = Some(UntaredLoad {
            beyond_reference_n: Some(46.0),
            rated_share: None,
        });
    });
    assert_eq!(output.fault, Some(Fault::UntaredLimit));
    let mut bench = Bench::sliding(TASK);
    let output = bench.step(|input| {
        input.untared = Some(UntaredLoad {
            beyond_reference_n: None,
            rated_share: Some(0.8),
        });
    });
    assert_eq!(output.fault, Some(Fault::UntaredLimit));
    let mut bench = Bench::new(&TASK.replace("tare = false", "tare = true"));
    let mut output = bench.step(|input| input.bias_age_s = Some(0.0));
    while output.phase != Phase::Slide {
        output = bench.step(|input| input.bias_age_s = Some(0.0));
    }
    let output = bench.step(|_| {});
    assert_eq!(output.fault, Some(Fault::ZeroLost));
}

/// Lift off, take a new zero, return to the same place, and continue; or end, as the task
/// specifies.
#[test]
fn a_zero_too_old_is_taken_anew_or_ends_the_task() {
    for at_limit in ["stop", "retare"] {
        let task = TASK.replace("tare = false", "tare = true").replace(
            "force.reference_n",
            &format!("zero.error_max_n = 0.04\nzero.at_limit = \"{at_limit}\"\nforce.reference_n"),
        );
        let mut bench = Bench::new(&task);
        let (mut tared_s, mut tares) = (None, 0);
        let (mut phases, mut places) = (Vec::new(), Vec::new());
        let mut last = Phase::Idle;
        while bench.time_s < 60.0 {
            let (now, tool) = (bench.time_s, bench.tool());
            let output = bench.step(|input| {
                input.bias_age_s = tared_s.map(|at| now - at);
                // A drift of 0.6 N per minute.
                input.zero_bound_n = tared_s.map(|at| 0.01 * (now - at));
            });
            if output.phase == Phase::Tare && last != Phase::Tare {
                tares += 1;
            }
            if output.phase == Phase::Tare {
                tared_s = Some(now);
            }
            if output.phase == Phase::Clear && last != Phase::Clear {
                places.push((tool, output.path_progress));
            }
            if output.phase == Phase::Slide && last == Phase::Contact && tares > 1 {
                let (place, progress) = places.pop().unwrap();
                let back = tool - place;
                assert!(back.norm() < 1e-3, "{back}");
                assert!((output.path_progress - progress).abs() < 0.02);
            }
            if last != output.phase {
                phases.push(output.phase);
            }
            last = output.phase;
            if !output.phase.is_active() {
                break;
            }
        }
        let output = bench.last.as_ref().unwrap();
        if at_limit == "stop" {
            assert_eq!(output.fault, Some(Fault::ZeroOld), "{phases:?}");
            assert_eq!(tares, 1);
        } else {
            assert_eq!(
                (output.phase, output.fault),
                (Phase::Done, None),
                "{phases:?}"
            );
            assert!(tares > 1, "{phases:?}");
        }
    }
}

/// A sensor whose zero is too old again when the tool is back ends the task instead of sending the
/// tool to and fro.
#[test]
fn a_zero_that_ages_faster_than_it_is_taken_ends_the_task() {
    let task = TASK.replace("tare = false", "tare = true").replace(
        "force.reference_n",
        "zero.error_max_n = 0.04\nzero.at_limit = \"retare\"\nforce.reference_n",
    );
    let mut bench = Bench::new(&task);
    let (mut tared_s, mut tares) = (None, 0);
    let mut last = Phase::Idle;
    while bench.time_s < 60.0 && (last.is_active() || bench.time_s < 1.0) {
        let now = bench.time_s;
        let output = bench.step(|input| {
            input.bias_age_s = tared_s.map(|at| now - at);
            input.zero_bound_n = tared_s.map(|at| 0.1 * (now - at));
        });
        tares += u32::from(output.phase == Phase::Tare && last != Phase::Tare);
        if output.phase == Phase::Tare {
            tared_s = Some(now);
        }
        last = output.phase;
    }
    let output = bench.last.as_ref().unwrap();
    assert_eq!(output.fault, Some(Fault::ZeroOld));
    assert_eq!(tares, 2);
}

/// The tool lifts off to take a new zero: one that is taken proves that it was the surface, and one
/// that is refused that it was the sensor.
#[test]
fn a_zero_that_seems_to_jump_is_proved_or_ends_the_task() {
    let task = TASK.replace("tare = false", "tare = true");
    for dt_s in [0.008, 0.002] {
        for refused in [false, true] {
            let mut bench = Bench::at_rate(&task, dt_s);
            let (mut tared_s, mut tares, mut slid_s) = (None, 0, 0.0);
            let mut last = Phase::Idle;
            while bench.time_s < 60.0 && (last.is_active() || bench.time_s < 1.0) {
                let now = bench.time_s;
                // The sensor's service reports a jump for 10 ms.
                let jumps = last == Phase::Slide && (0.2..0.21).contains(&slid_s)
                    || last == Phase::Clear && slid_s > 0.2 && slid_s < 0.21;
                let output = bench.step(|input| {
                    input.bias_age_s = tared_s.map(|at| now - at);
                    if jumps {
                        input.wrench_validity = Validity::ZeroJumped;
                    }
                });
                let begins = output.phase == Phase::Tare && last != Phase::Tare;
                tares += u32::from(begins);
                if output.phase == Phase::Tare && !(refused && tares > 1) {
                    tared_s = Some(now);
                }
                slid_s = match output.phase {
                    Phase::Slide | Phase::Clear => slid_s + dt_s,
                    _ => 0.0,
                };
                last = output.phase;
            }
            let output = bench.last.as_ref().unwrap();
            if refused {
                let expected = Fault::Wrench(Validity::ZeroJumped);
                assert_eq!(output.fault, Some(expected), "{dt_s}");
                assert_eq!(tares, 2);
                assert!(!output.in_contact);
            } else {
                assert_eq!((output.phase, output.fault), (Phase::Done, None), "{dt_s}");
                // Once before, and as often as it may prove the zero.
                assert_eq!(tares, 4, "{dt_s}");
            }
        }
    }
    // Without a zero of its own, the task cannot take another.
    let mut bench = Bench::sliding(TASK);
    let output = bench.step(|input| input.wrench_validity = Validity::ZeroJumped);
    let expected = Fault::Wrench(Validity::ZeroJumped);
    assert_eq!(
        (output.phase, output.fault),
        (Phase::Retract, Some(expected))
    );
}

/// A wrench that is late repeatedly, as on a busy host, interrupts the approach without restarting
/// it.
#[test]
fn an_approach_that_is_interrupted_counts_its_way_from_where_it_began() {
    let task = TASK.replace("tare = false", "tare = true");
    let mut bench = Bench::new(&task);
    let tared = |input: &mut ControlInput| input.bias_age_s = Some(0.0);
    let late = |input: &mut ControlInput| {
        input.bias_age_s = Some(0.0);
        input.wrench_age_s = 0.06;
    };
    let (mut output, mut holds) = (bench.step(tared), 0);
    for cycle in 0.. {
        if !output.phase.is_active() {
            break;
        }
        let interrupted = output.phase == Phase::Approach && cycle % 10 < 4;
        output = bench.step(if interrupted { late } else { tared });
        holds += u32::from(interrupted && output.phase == Phase::Hold);
    }
    assert!(holds > 3, "interrupted only {holds} times");
    assert_eq!((output.phase, output.fault), (Phase::Done, None));
}

/// The tool is turned on the flange by a right angle about its axis.
#[test]
fn the_arms_own_force_is_compared_in_the_axes_of_the_tool() {
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let run = |side_n: f64, shown: bool| {
        let mut bench = Bench::with_tool(TASK, 0.008, turned);
        let mut fault = None;
        for k in 0..60 {
            let output = bench.step(|input| {
                let side = Vector3::x() * if k < 30 { 0.0 } else { side_n };
                if shown {
                    input.wrench.force += side;
                }
                input.arm_force =
                    Some(turned * (input.wrench.force + side * f64::from(u8::from(!shown))));
            });
            assert!(matches!(output.phase, Phase::Approach | Phase::Retract));
            fault = output.fault.or(fault);
        }
        fault
    };
    assert_eq!(run(35.0, true), None);
    assert_eq!(run(25.0, false), None);
    assert_eq!(run(36.0, false), Some(Fault::ForceUnread));
}
