//! A tool that presses so weakly that its contact is lost for the estimator.

use nalgebra::{UnitQuaternion, Vector3};
use tangent_estimation::{EstimatorConfig, build};
use tangent_mechanics::{Pose, Twist, Wrench};
use tangent_sensing::Validity;

use crate::noise::gaussian;
use crate::samples::sample;

const DT: f64 = 0.008;
const STIFFNESS: f64 = 20_000.0;

/// A time with a reading (N) along the axis of a tool that stands at a height (m) above where it
/// touches, or moves there.
struct Part {
    reads_n: f64,
    height_m: f64,
    lasts_s: f64,
}

fn part(reads_n: f64, height_m: f64, lasts_s: f64) -> Part {
    Part {
        reads_n,
        height_m,
        lasts_s,
    }
}

/// Whether the tool touches at the end of the parts, after one second in free space.
fn touches_after(parts: &[Part]) -> bool {
    let mut noise = gaussian(1);
    let mut estimator = build("reactive", &EstimatorConfig::default()).unwrap();
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let (mut time_s, mut at_m, mut validity) = (0.0, 0.01, Validity::NoContact);
    let above = part(0.0, 0.01, 1.0);
    for part in std::iter::once(&above).chain(parts) {
        let steps = (part.lasts_s / DT).ceil();
        let to_m = part.height_m - part.reads_n / STIFFNESS;
        let speed = (to_m - at_m) / part.lasts_s;
        for _ in 0..steps as usize {
            time_s += DT;
            at_m += (to_m - at_m).clamp(-speed.abs() * DT, speed.abs() * DT);
            let twist = Twist::new(Vector3::z() * speed, Vector3::zeros());
            let force = Vector3::z() * -part.reads_n;
            let estimate = estimator.update(&sample(
                time_s,
                DT,
                Pose::new(Vector3::z() * at_m, down),
                twist,
                Wrench::new(force.map(|f| f + noise(0.03)), Vector3::zeros()),
            ));
            validity = estimate.validity;
        }
    }
    validity != Validity::NoContact
}

#[test]
fn a_contact_that_was_lost_near_the_surface_needs_less_force_to_come_back() {
    let lost = || [part(1.0, 0.0, 1.0), part(0.15, 0.0, 0.1)];
    let then = |last: Vec<Part>| touches_after(&lost().into_iter().chain(last).collect::<Vec<_>>());
    assert!(then(vec![part(0.5, 0.0, 0.1)]));
    // What is left of a force is no contact, and neither is a drift far from the surface.
    assert!(!then(vec![part(0.25, 0.0, 0.1)]));
    assert!(!then(vec![part(0.0, 0.1, 1.0), part(0.5, 0.1, 0.1)]));
}

/// What presses weakly for seconds is not the sensor's zero: it would hide the next contact.
#[test]
fn a_weak_contact_is_not_taken_for_a_zero() {
    let weak = |lasts_s: f64| {
        touches_after(&[
            part(1.0, 0.0, 1.0),
            part(0.25, 0.0, lasts_s),
            part(0.55, 0.0, 0.2),
        ])
    };
    assert!(weak(0.5));
    assert!(weak(10.0));
}
