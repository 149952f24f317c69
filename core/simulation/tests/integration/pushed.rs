//! A person pushes the tool aside while it wipes: the tool gives way within limits, keeps its
//! force, and goes on afterwards.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
use nalgebra::Vector3;
use tangent_control::{Fault, Phase};
use tangent_sensing::Validity;
use tangent_simulation::{AdmittanceLoop, AdmittanceScenario, no_files};

/// What a push did.
#[derive(Debug)]
struct Pushed {
    /// Farthest way of the tool along the push, from where it was when it began, m.
    gave_m: f64,
    /// Highest true force of the surface on the tool along the normal while the hand pushed, N.
    pressed_n: f64,
    fastest_m_per_s: f64,
    lifted: bool,
    end: (Phase, Option<Fault>),
}

/// Slides for 2 s, then pushes with `force` (base axes, N) for `for_s`, and lets the task end.
fn push(scenario: &str, set: &[String], force: Vector3<f64>, for_s: f64) -> Pushed {
    let file = format!(
        "{}/../../scenarios/{scenario}.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    let text = std::fs::read_to_string(file).unwrap();
    let scenario = AdmittanceScenario::parse(scenario, &text, set, &no_files).unwrap();
    let mut cell = AdmittanceLoop::new(&scenario).unwrap();
    let along = force.normalize();
    let (mut slid_s, mut begins) = (0.0, None::<(f64, Vector3<f64>)>);
    let mut pushed = Pushed {
        gave_m: 0.0,
        pressed_n: 0.0,
        fastest_m_per_s: 0.0,
        lifted: false,
        end: (Phase::Idle, None),
    };
    let period_s = cell.plant().period_s();
    for _ in 0..(scenario.duration_s / period_s) as usize {
        let mut seen = None;
        let _ = cell.step(&mut |c| {
            let at = c.input.base_from_tool.translation();
            let speed = c.input.twist.linear.dot(&along);
            let presses_n = c.truth.wrench.force.dot(&c.truth.normal);
            seen = Some((
                c.input.time_s,
                c.output.phase,
                c.output.fault,
                at,
                speed,
                presses_n,
            ));
        });
        let (time_s, phase, fault, at, speed, presses_n) = seen.unwrap();
        pushed.end = (phase, fault);
        if begins.is_some() && !phase.is_active() {
            break;
        }
        slid_s += f64::from(u8::from(phase == Phase::Slide)) * period_s;
        match begins {
            None if slid_s > 2.0 => {
                begins = Some((time_s, at));
                cell.push_by_hand(force);
            }
            Some((from_s, from)) if time_s - from_s < for_s => {
                pushed.gave_m = pushed.gave_m.max((at - from).dot(&along));
                pushed.pressed_n = pushed.pressed_n.max(presses_n);
                pushed.fastest_m_per_s = pushed.fastest_m_per_s.max(speed);
                pushed.lifted |= phase == Phase::Lift;
            }
            Some(_) => cell.push_by_hand(Vector3::zeros()),
            None => {}
        }
    }
    pushed
}

/// Along the path, against it and across it.
fn directions() -> [Vector3<f64>; 4] {
    [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()]
}

#[test]
fn a_short_push_moves_the_tool_aside_and_the_task_goes_on() {
    for scenario in ["plane", "pipe_realistic"] {
        for along in directions() {
            let pushed = push(scenario, &[], along * 15.0, 0.6);
            println!("{scenario} {along:?}: {pushed:?}");
            assert_eq!(pushed.end, (Phase::Done, None), "{along:?}: {pushed:?}");
            assert!(pushed.gave_m > 1e-3, "{along:?}: {pushed:?}");
            assert!(pushed.pressed_n < 10.0, "{along:?}: {pushed:?}");
            assert!(pushed.fastest_m_per_s < 0.06, "{along:?}: {pushed:?}");
        }
    }
}

/// Other tools, surfaces, landings and arms than those of the scenarios.
#[test]
fn a_short_push_is_answered_on_other_cells() {
    for keys in [
        &["plant.contact.stiffness_n_per_m=5e3"][..],
        &["plant.contact.stiffness_n_per_m=5e4"],
        &["plant.tool.tip={ shape = \"round\", radius_m = 0.006 }"],
        &["plant.start.tilt_rad=0.25"],
        &["task.force.reference_n=10.0"],
        &[
            "plant.contact.friction.coulomb_coefficient=0.8",
            "plant.contact.friction.static_coefficient=0.9",
        ],
        &["plant.arm.input_delay_cycles=3"],
    ] {
        let set: Vec<String> = keys.iter().map(|key| (*key).to_owned()).collect();
        let pushed = push("plane", &set, Vector3::y() * 15.0, 0.6);
        println!("{keys:?}: {pushed:?}");
        assert_eq!(pushed.end, (Phase::Done, None), "{keys:?}: {pushed:?}");
        assert!(pushed.pressed_n < 20.0, "{keys:?}: {pushed:?}");
        assert!(pushed.fastest_m_per_s < 0.06, "{keys:?}: {pushed:?}");
    }
}

/// A hand that stays, like anything else in the way, makes the tool lift off and land further on.
#[test]
fn a_long_push_lifts_the_tool_off() {
    for along in directions() {
        let pushed = push("plane", &[], along * 15.0, 2.0);
        println!("{along:?}: {pushed:?}");
        assert!(pushed.lifted, "{along:?}: {pushed:?}");
        assert_eq!(pushed.end, (Phase::Done, None), "{along:?}: {pushed:?}");
        assert!(pushed.pressed_n < 10.0, "{along:?}: {pushed:?}");
        assert!(pushed.fastest_m_per_s < 0.06, "{along:?}: {pushed:?}");
    }
}

/// A hand that stays even then, or a zero that has jumped: the task ends, with the tool off the
/// surface.
#[test]
fn a_push_without_end_ends_the_task() {
    let pushed = push("plane", &[], Vector3::y() * 15.0, 20.0);
    println!("{pushed:?}");
    let aside = Fault::Wrench(Validity::Misdirected);
    assert_eq!(pushed.end, (Phase::Fault, Some(aside)), "{pushed:?}");
    assert!(pushed.gave_m < 0.05, "{pushed:?}");
    assert!(pushed.pressed_n < 10.0, "{pushed:?}");
}
