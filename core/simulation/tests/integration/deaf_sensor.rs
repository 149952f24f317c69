//! A sensor whose reading no longer responds to load but keeps its noise. Tests how far the true
//! force, from the simulator, goes under each law, and that no working sensor is mistaken for such
//! a one.

// The test prints its results, and reads the scenarios of the repository.
#![allow(clippy::disallowed_macros, clippy::disallowed_methods)]
// A whole file of tests: what fails here is the test.
use crate::three_laws::{Cell, Law};
use tangent_control::{Fault, Phase};
use tangent_sensing::Validity;

const DEAF: Option<Fault> = Some(Fault::Wrench(Validity::Unresponsive));
/// Force beyond which a run is stopped, N.
const ENOUGH_N: f64 = 300.0;
/// Duration of a run after the fault, s.
const WATCHED_S: f64 = 6.0;
/// Time within which a dead sensor is found while the tool slides, s.
const FOUND_S: f64 = 5.0;

/// Name, scenario and keys of a surface under a law.
type World = (&'static str, &'static str, &'static [&'static str]);

const NOISE: &[&str] = &[
    "plant.sensor.noise_n_per_sqrt_hz=0.002",
    "plant.sensor.noise_nm_per_sqrt_hz=6e-5",
];
const FLAT: &[&str] = &["plant.surface.amplitude_m=0.0001"];
const RIPPLED: &[&str] = &[
    "plant.surface.amplitude_m=0.004",
    "plant.surface.wavelength_m=0.15",
];

fn worlds(law: Law) -> [World; 3] {
    match law {
        Law::Velocity => [
            ("pipe", "pipe_ideal", NOISE),
            ("sphere", "sphere", NOISE),
            ("plane", "plane", NOISE),
        ],
        Law::Hybrid => [
            ("plane", "lippiello/lippiello_plane", &[]),
            ("sphere", "lippiello/lippiello_sphere", &[]),
            ("cylinder", "lippiello/lippiello_cylinder", &[]),
        ],
        Law::Unified => [
            ("wave", "karacan/karacan_wave", &[]),
            ("flat", "karacan/karacan_wave", FLAT),
            ("ripple", "karacan/karacan_wave", RIPPLED),
        ],
    }
}

fn keys(world: &World, stiffness: f64) -> Vec<String> {
    let mut set: Vec<String> = world.2.iter().map(|s| (*s).to_owned()).collect();
    set.push(format!("plant.contact.stiffness_n_per_m={stiffness:.1}"));
    set
}

/// Times of first contact and of the start of sliding, s.
fn calm(law: Law, world: &World, stiffness: f64) -> (f64, f64) {
    let mut cell = Cell::new(law, world.1, &keys(world, stiffness));
    let mut contact_s = None;
    loop {
        let seen = cell.step();
        assert!(
            seen.fault.is_none() && seen.time_s < cell.duration_s,
            "{seen:?}"
        );
        if seen.phase == Phase::Contact {
            contact_s.get_or_insert(seen.time_s);
        }
        if seen.phase == Phase::Slide {
            return (contact_s.unwrap(), seen.time_s);
        }
    }
}

/// Largest true pressing force from the fault on (N), the limit of the cell, the fault that ended
/// the task, and the time until the tool began to leave (s).
fn deaf(
    law: Law,
    world: &World,
    stiffness: f64,
    from_s: f64,
    kind: &str,
    watched_s: f64,
) -> (f64, f64, Option<Fault>, f64) {
    let mut set = keys(world, stiffness);
    let table = match law {
        Law::Unified => "external_wrench",
        _ => "sensor",
    };
    set.push(format!(
        "plant.{table}.fault={{ kind = \"deaf\", {kind}, from_s = {from_s:.4} }}"
    ));
    let mut cell = Cell::new(law, world.1, &set);
    let (mut peak_n, mut fault, mut ended_s) = (0.0_f64, None, f64::INFINITY);
    loop {
        let seen = cell.step();
        if seen.time_s >= from_s {
            peak_n = peak_n.max(seen.pressing_n);
        }
        let over_s = seen.time_s - from_s;
        // It also lifts off to prove a zero that seems to have jumped.
        let leaves = seen.fault.is_some() || seen.phase == Phase::Clear;
        if leaves && over_s >= 0.0 {
            ended_s = ended_s.min(over_s);
        }
        fault = fault.or(seen.fault);
        if over_s > watched_s
            || fault.is_some() && over_s > ended_s + 0.5
            || peak_n > ENOUGH_N
            || !seen.phase.is_active()
        {
            return (peak_n, cell.bound_n(), fault, ended_s);
        }
    }
}

fn level(law: Law) -> &'static str {
    match law {
        Law::Velocity => "offset_n = [0.0, 0.0, 1.0]",
        _ => "offset_n = [0.0, 0.0, 6.0]",
    }
}

/// What must hold of a row.
#[derive(Clone, Copy, Debug)]
enum Claim {
    /// The true force stays below the limit of the cell.
    Within,
    /// The sensor is found within [`FOUND_S`], and the true force stays below this one, N.
    Found(f64),
    /// The true force stays below this one, N, whether the sensor is found or not: only in `all`.
    Below(f64),
    Nothing,
}

/// Rows for every surface. Only `all` has those of which nothing is claimed, and of the others
/// every stiffness.
fn table(law: Law, all: bool, claim: impl Fn(&str, f64) -> Claim) {
    let mut wrong = Vec::new();
    for world in worlds(law) {
        for stiffness in [1e3, 5e3, 1e4, 5e4] {
            let (contact_s, slide_s) = calm(law, &world, stiffness);
            for (moment, from_s) in [
                ("builds up", contact_s + 0.1),
                ("slides", slide_s + 0.2),
                ("slides on", slide_s + 2.5),
            ] {
                for kind in ["axis = 2", "offset_n = [0.0, 0.0, 0.0]", level(law)] {
                    let lower = kind == level(law);
                    // That reading would count as no contact at all.
                    if lower && moment == "builds up" {
                        continue;
                    }
                    let claim = claim(moment, stiffness);
                    let skipped = match claim {
                        Claim::Within => false,
                        Claim::Found(_) => stiffness < 1e4,
                        Claim::Below(_) | Claim::Nothing => true,
                    };
                    if skipped && !all {
                        continue;
                    }
                    let (peak_n, bound_n, fault, after_s) =
                        deaf(law, &world, stiffness, from_s, kind, WATCHED_S);
                    let within = if peak_n <= bound_n {
                        "within"
                    } else {
                        "BEYOND"
                    };
                    println!(
                        "{law:?} | {} | {} kN/m | {moment} | {kind} | {peak_n:.1} N | {within} {bound_n} N | {fault:?} after {after_s:.2} s",
                        world.0,
                        1e-3 * stiffness
                    );
                    let holds = match claim {
                        Claim::Within => peak_n <= bound_n,
                        Claim::Found(most_n) => {
                            peak_n <= most_n && fault.is_some() && after_s <= FOUND_S
                        }
                        Claim::Below(most_n) => peak_n <= most_n,
                        Claim::Nothing => true,
                    };
                    if !holds {
                        wrong.push((world.0, stiffness, moment, kind, peak_n, fault));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{law:?}: {wrong:#?}");
}

/// While the tool slides, such a sensor looks like a receding surface, until the reference is
/// lowered.
#[test]
fn under_the_velocity_law() {
    table(Law::Velocity, false, claim_of_velocity);
}

fn claim_of_velocity(moment: &str, stiffness: f64) -> Claim {
    match moment {
        // On 50 kN/m the stiffness is not known yet when the fault begins.
        "builds up" if stiffness < 2e4 => Claim::Within,
        "builds up" => Claim::Nothing,
        _ if stiffness < 2e4 => Claim::Found(75.0),
        _ => Claim::Found(95.0),
    }
}

/// The torque laws do not check the mean: with their published gains the force lags the depth, so a
/// working sensor would be rejected. Their force is bounded because it is commanded, and the
/// reading only corrects it.
fn claim_of_torque(most_n: f64) -> impl Fn(&str, f64) -> Claim {
    move |_, _| Claim::Below(most_n)
}

#[test]
#[ignore = "minutes, in .ci/search: the rows that are not held as well, on every surface"]
fn the_whole_table() {
    table(Law::Velocity, true, claim_of_velocity);
    table(Law::Hybrid, true, claim_of_torque(75.0));
    table(Law::Unified, true, claim_of_torque(40.0));
}

/// In free space such a sensor looks as it should. Only the force that the arm itself feels, or
/// with which its motors push, shows the touch.
#[test]
fn a_sensor_that_died_before_the_first_touch_is_found_by_the_arm() {
    let real: [World; 2] = [
        ("real pipe", "pipe_realistic", &[]),
        ("real cone", "cone_realistic", &[]),
    ];
    let velocity = worlds(Law::Velocity).into_iter().chain(real);
    let cells = (velocity.map(|world| (Law::Velocity, world)))
        .chain(worlds(Law::Hybrid).map(|world| (Law::Hybrid, world)))
        .chain(worlds(Law::Unified).map(|world| (Law::Unified, world)));
    for (law, world) in cells {
        // Their approach is not slowed for a stiff contact.
        let most_n = if law == Law::Hybrid { 60.0 } else { 45.0 };
        for stiffness in [3e3, 1e4, 3e4] {
            let (contact_s, _) = calm(law, &world, stiffness);
            for kind in ["axis = 2", "offset_n = [0.0, 0.0, 0.0]"] {
                let (peak_n, _, fault, after_s) =
                    deaf(law, &world, stiffness, contact_s - 0.2, kind, 30.0);
                println!(
                    "{law:?} | {} | {stiffness} N/m | {kind} | {peak_n:.1} N | {fault:?} after {after_s:.2} s",
                    world.0
                );
                assert_eq!(fault, Some(Fault::ForceUnread), "{law:?} {}", world.0);
                assert!(peak_n < most_n, "{law:?} {} {stiffness}: {peak_n}", world.0);
            }
        }
    }
}

/// Soft and stiff surfaces that recede and rise under the tool.
#[test]
fn a_living_sensor_is_never_taken_for_a_deaf_one() {
    let more: [(Law, World); 4] = [
        (Law::Velocity, ("sheet", "sheet", NOISE)),
        (Law::Velocity, ("cone", "cone_realistic", &[])),
        (Law::Velocity, ("real pipe", "pipe_realistic", &[])),
        (Law::Hybrid, ("real", "lippiello/lippiello_realistic", &[])),
    ];
    let all = [Law::Velocity, Law::Hybrid, Law::Unified]
        .into_iter()
        .flat_map(|law| worlds(law).map(|world| (law, world)))
        .chain(more);
    for (law, world) in all {
        for stiffness in [500.0, 1e3, 5e3, 2.5e4, 5e4] {
            // In series with the tool, no stiffer contact is possible.
            if world.1.ends_with("_realistic") && law == Law::Velocity && stiffness > 3e4 {
                continue;
            }
            let mut cell = Cell::new(law, world.1, &keys(&world, stiffness));
            let (mut ended, mut slid) = (None, false);
            for _ in 0..(cell.duration_s / cell.period_s) as usize {
                let seen = cell.step();
                slid |= seen.phase == Phase::Slide;
                ended = seen.fault.or(ended);
                if !seen.phase.is_active() {
                    break;
                }
            }
            println!(
                "{law:?} | {} | {stiffness} N/m | slid {slid} | {ended:?}",
                world.0
            );
            assert_ne!(ended, DEAF, "{law:?} {} {stiffness}", world.0);
        }
    }
}
