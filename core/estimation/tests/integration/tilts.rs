//! A pad that stands tilted on a surface, and turns as its estimate says.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use tangent_estimation::{EstimatorConfig, NormalEstimate, build};
use tangent_mechanics::{Pose, Tip, Twist, Wrench};
use tangent_sensing::Validity;

use crate::noise::gaussian;
use crate::samples::sample;

const DT: f64 = 0.008;
const RADIUS_M: f64 = 0.01;
const RING: Tip = Tip::Ring { radius_m: RADIUS_M };
/// Tilt at which one side of the pad lifts, per newton, rad.
const LIFTS_RAD_PER_N: f64 = 1e-3;
/// Rate with which the tool turns to what it takes for the normal, per second, and its bound,
/// rad/s.
const GAIN_PER_S: f64 = 2.0;
const TURN_MAX_RAD_PER_S: f64 = 0.4;

/// A tool on a plane, whose normal is the z axis.
struct Cell {
    tip: Tip,
    force_n: f64,
    /// Error of the stated frames: the centre of pressure seems to be so far aside, tool axes, m.
    aside_m: Vector2<f64>,
    /// What a support of less than the pad does to the centre of pressure, from a time on (s): it
    /// is there, tool axes, m.
    ledge: Option<(f64, Vector2<f64>)>,
    /// Speed along the surface after two seconds, m/s.
    speed_m_per_s: f64,
    lasts_s: f64,
}

impl Default for Cell {
    fn default() -> Self {
        Self {
            tip: RING,
            force_n: 10.0,
            aside_m: Vector2::zeros(),
            ledge: None,
            speed_m_per_s: 0.0,
            lasts_s: 3.0,
        }
    }
}

/// What is left after a run.
struct End {
    estimate: NormalEstimate,
    /// Angle between the estimated and the true normal, rad.
    off_rad: f64,
    /// Largest angle between the tool's axis and the normal after half of the time, rad.
    tilt_rad: f64,
}

impl Cell {
    /// Presses for `lasts_s` with a tool that is tilted by `tilt_rad` about `axis` (unit, in the
    /// plane).
    fn run(&self, tilt_rad: f64, axis: &Vector3<f64>, seed: u64) -> End {
        let mut noise = gaussian(seed);
        let mut config = EstimatorConfig::default();
        config.contact.tip = self.tip;
        let mut estimator = build("reactive", &config).unwrap();
        let down = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(
            1.0, -1.0, -1.0,
        )));
        let mut rotation = Rotation3::from_scaled_axis(axis * tilt_rad) * down;
        let mut position = Vector3::new(0.0, 0.0, 0.001);
        let mut last = None;
        let mut worst_rad = 0.0f64;
        for step in 0..(self.lasts_s / DT) as usize {
            let time_s = step as f64 * DT;
            let outward: Vector3<f64> = -rotation.matrix().column(2);
            let turn = last
                .as_ref()
                .map_or(Vector3::zeros(), |estimate: &NormalEstimate| {
                    let turn = outward.cross(&estimate.normal) * GAIN_PER_S;
                    turn * (TURN_MAX_RAD_PER_S / turn.norm().max(TURN_MAX_RAD_PER_S))
                });
            let presses = time_s > 0.3;
            let load_n = if presses {
                self.force_n * ((time_s - 0.3) / 0.2).min(1.0)
            } else {
                0.0
            };
            let speed = if time_s > 2.0 {
                self.speed_m_per_s
            } else {
                0.0
            };
            let velocity = Vector3::x() * speed;
            position += velocity * DT;
            position.z = if presses { 0.0 } else { 0.001 };
            // The side towards which the outward axis leans is pressed harder.
            let in_tool = rotation.inverse() * outward.xy().push(0.0);
            let lifts_rad = LIFTS_RAD_PER_N * load_n.max(0.1);
            let centre = match self.ledge {
                Some((from_s, at)) if time_s > from_s => at,
                _ => in_tool.xy() * (RADIUS_M / in_tool.xy().norm().max(lifts_rad)) + self.aside_m,
            };
            let force = Vector3::z() * -load_n;
            let torque = centre.push(0.0).cross(&force);
            let twist = Twist::new(velocity, turn);
            let estimate = estimator.update(&sample(
                time_s,
                DT,
                Pose::new(position, UnitQuaternion::from_rotation_matrix(&rotation)),
                twist,
                Wrench::new(
                    force.map(|f| f + noise(0.05)),
                    torque.map(|t| t + noise(0.003)),
                ),
            ));
            if estimate.validity != Validity::NoContact {
                last = Some(estimate);
            }
            rotation = Rotation3::from_scaled_axis(turn * DT) * rotation;
            if time_s > 0.5 * self.lasts_s {
                worst_rad = worst_rad.max(outward.angle(&Vector3::z()));
            }
        }
        let estimate = last.unwrap();
        End {
            off_rad: estimate.normal.angle(&Vector3::z()),
            tilt_rad: worst_rad,
            estimate,
        }
    }
}

fn axis(angle_rad: f64) -> Vector3<f64> {
    Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0)
}

#[test]
fn a_standing_pad_is_squared_by_its_torque() {
    for tip in [RING, Tip::Flat { radius_m: RADIUS_M }] {
        for (i, tilt_rad) in [0.1, 0.2, 0.3, 0.4].into_iter().enumerate() {
            let cell = Cell {
                tip,
                lasts_s: 6.0,
                ..Cell::default()
            };
            let end = cell.run(tilt_rad, &axis(1.3 * i as f64), i as u64);
            assert!(end.off_rad < 0.03, "{tip:?} {tilt_rad}: {}", end.off_rad);
            assert!(end.tilt_rad < 0.05, "{tip:?} {tilt_rad}: {}", end.tilt_rad);
            let sd_rad = (0.5 * end.estimate.covariance.trace()).sqrt();
            assert!(
                end.off_rad < 3.0 * sd_rad,
                "{tip:?}: {} {sd_rad}",
                end.off_rad
            );
        }
    }
}

#[test]
fn a_pad_that_presses_weakly_says_nothing_of_its_tilt() {
    let cell = Cell {
        force_n: 1.0,
        aside_m: Vector2::new(0.003, 0.0),
        ..Cell::default()
    };
    let end = cell.run(0.0, &axis(0.0), 1);
    assert!(end.off_rad < 0.03, "{}", end.off_rad);
}

#[test]
fn a_tip_of_another_shape_says_nothing_of_its_tilt() {
    for tip in [
        Tip::Round { radius_m: RADIUS_M },
        Tip::Soft { radius_m: RADIUS_M },
        Tip::Unknown,
    ] {
        let cell = Cell {
            tip,
            ..Cell::default()
        };
        let end = cell.run(0.2, &axis(0.0), 1);
        assert!((end.off_rad - 0.2).abs() < 0.02, "{tip:?}: {}", end.off_rad);
    }
}

/// A flush pad that hangs over the edge of a workpiece presses on one side without being tilted.
#[test]
fn a_pad_at_an_edge_stays_square() {
    for side in [-1.0, 1.0] {
        let cell = Cell {
            ledge: Some((4.0, Vector2::new(0.8 * RADIUS_M * side, 0.0))),
            speed_m_per_s: 0.02,
            lasts_s: 6.0,
            ..Cell::default()
        };
        let end = cell.run(0.1, &axis(0.5), 3);
        assert!(end.tilt_rad < 0.03, "{}", end.tilt_rad);
    }
}
