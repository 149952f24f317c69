//! Eq. (3): the tool's twist as joint velocities, damped near singularities and inside every
//! joint's limits.
//!
//! Called by the controller each cycle, last. Where the arm cannot make the whole twist, the speed
//! along the normal of a pressing tool comes first and the rest gives way: a path that is not
//! followed waits, but a wrong speed along the normal is a wrong force.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::{Aligned, Arm, Base, Flange, Joints, Pose, Tool, Twist, manipulability};

use crate::limits::Limits;

/// Turns twists into joint velocities. Its state is the last velocities it returned.
#[derive(Clone, Copy, Debug)]
pub struct JointVelocity<const N: usize> {
    last: Joints<N>,
}

impl<const N: usize> Default for JointVelocity<N> {
    fn default() -> Self {
        Self {
            last: Joints::zeros(),
        }
    }
}

impl<const N: usize> JointVelocity<N> {
    /// Joint velocities (rad/s) for `twist`, which the arm at `q` makes `lead_s` from now, and the
    /// manipulability there. Limits of speed and of acceleration keep the direction of motion; near
    /// an end stop only that joint slows down. `normal` (unit, base axes) is the direction in which
    /// the tool presses: its speed is kept.
    #[expect(
        clippy::too_many_arguments,
        reason = "the arm, its limits and one cycle's state, each with its own owner"
    )]
    pub fn step(
        &mut self,
        arm: &Arm<N>,
        flange_from_tool: &Pose<Flange, Tool>,
        limits: &Limits,
        q: &Joints<N>,
        lead_s: f64,
        twist: &Twist<Aligned<Tool, Base>>,
        normal: Option<&Vector3<f64>>,
        dt_s: f64,
    ) -> (Joints<N>, f64) {
        // Until then, the arm makes the commands that are under way.
        let then = q + self.last * lead_s;
        let jacobian = arm.jacobian_at(&then, flange_from_tool);
        let mut wanted = limits.singularity.solve(&jacobian, &twist.vector());
        if !wanted.iter().all(|x| x.is_finite()) {
            wanted = Joints::zeros();
        }
        let bounds = arm.limits();
        let fastest = bounds.velocity * limits.joint_speed_share;
        let first = normal.map_or_else(Joints::zeros, |normal| {
            let speed = twist.linear.dot(normal);
            let lost = speed - normal.dot(&(jacobian * wanted).fixed_rows::<3>(0));
            let damping = limits.singularity.damping_max;
            wanted += along_normal(&jacobian, normal, lost, damping);
            let pressing = along_normal(&jacobian, normal, speed, damping);
            pressing * share_within(&Joints::zeros(), &pressing, &fastest)
        });
        let rest = wanted - first;
        wanted = first + rest * share_within(&first, &rest, &fastest);
        let most = limits.joint_acceleration_max_rad_per_s2;
        let change = most * dt_s;
        // All joints change by the same share of the way. If each one were bounded by itself, the
        // tool would leave its direction where the arm folds, and be thrown along the surface.
        let way = wanted - self.last;
        let longest = way.amax().max(change).max(f64::MIN_POSITIVE);
        wanted = self.last + way * (change / longest);
        for i in 0..N {
            // Slow enough to stop before the end stop: v² = 2 a s. Half the acceleration leaves
            // room for the arm's delay.
            let brake = |room: f64| (most * room.max(0.0)).sqrt();
            let upper = brake(bounds.position_upper[i] - limits.joint_margin_rad - q[i]);
            let lower = -brake(q[i] - bounds.position_lower[i] - limits.joint_margin_rad);
            self.last[i] = wanted[i].max(lower).min(upper);
        }
        (self.last, manipulability(&jacobian))
    }

    /// The last joint velocities, rad/s.
    pub fn last(&self) -> &Joints<N> {
        &self.last
    }

    /// Takes over joint velocities (rad/s) that were commanded without a twist.
    pub fn follow(&mut self, qd: &Joints<N>) {
        self.last = *qd;
    }

    /// Slows every joint down as fast as allowed; returns true once all are at rest.
    pub fn slow_down(&mut self, limits: &Limits, dt_s: f64) -> (Joints<N>, bool) {
        let change = limits.joint_acceleration_max_rad_per_s2 * dt_s;
        for speed in self.last.iter_mut() {
            *speed -= speed.clamp(-change, change);
        }
        (self.last, self.last.iter().all(|v| *v == 0.0))
    }
}

/// Smallest joint velocities (rad/s) that move the tool at `speed` (m/s) along `normal`. In a pose
/// in which no joint moves it there, `damping` bounds them.
fn along_normal<const N: usize>(
    jacobian: &SMatrix<f64, 6, N>,
    normal: &Vector3<f64>,
    speed: f64,
    damping: f64,
) -> Joints<N> {
    let row = jacobian.fixed_rows::<3>(0).tr_mul(normal);
    // Damped only where the whole row is small: elsewhere the speed is met exactly.
    let square = row.norm_squared();
    row * (speed / square.max(damping * damping))
}

/// Largest share, 0 to 1, of `rest` that keeps `first + share * rest` within `fastest`.
fn share_within<const N: usize>(first: &Joints<N>, rest: &Joints<N>, fastest: &Joints<N>) -> f64 {
    (0..N).fold(1.0, |share: f64, i| {
        let bound = fastest[i].copysign(rest[i]);
        let room = (bound - first[i]) / rest[i];
        if room.is_finite() {
            share.min(room.max(0.0))
        } else {
            share
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;
    use tangent_mechanics::ModelData;

    fn ur5() -> Arm<6> {
        Arm::new(&ModelData::builtin("ur5").unwrap()).unwrap()
    }

    #[test]
    fn a_limit_of_acceleration_keeps_the_direction_of_the_change() {
        let (arm, limits) = (ur5(), Limits::default());
        let (q, tool) = (arm.home(), Pose::identity());
        let twist = |x: f64| Twist::from_vector(&Vector6::new(x, 0.1 * x, -x, x, 0.0, 2.0 * x));
        let mut law = JointVelocity::default();
        let mut step = |x: f64, dt_s: f64| {
            law.step(&arm, &tool, &limits, &q, 0.0, &twist(x), None, dt_s)
                .0
        };
        let from = step(0.1, 10.0);
        let to = JointVelocity::default()
            .step(&arm, &tool, &limits, &q, 0.0, &twist(-0.1), None, 10.0)
            .0;
        let change = step(-0.1, 0.004) - from;
        let most = limits.joint_acceleration_max_rad_per_s2 * 0.004;
        assert!((change.amax() / most - 1.0).abs() < 1e-9, "{change}");
        assert!(
            (change.normalize() - (to - from).normalize()).norm() < 1e-9,
            "{change}"
        );
        // Two states at the same time change nothing, and leave nothing that is not a number.
        assert_eq!(step(-0.1, 0.0), from + change);
    }

    /// An arm that makes every command 40 ms later than it is given, while the tool moves sideways
    /// and turns.
    #[test]
    fn a_late_arm_makes_the_twist_where_it_then_is() {
        let (arm, limits, tool) = (ur5(), Limits::default(), Pose::identity());
        let twist = Twist::from_vector(&Vector6::new(0.0, 0.15, 0.0, 0.4, 0.0, 0.3));
        let (dt_s, late) = (0.008, 5);
        // Largest error of the velocity made, m/s, after the first half second.
        let error = |lead_s: f64| {
            let mut law = JointVelocity::default();
            let mut q = arm.home();
            let mut under_way = vec![Joints::zeros(); late];
            let mut worst = 0.0f64;
            for k in 0..150 {
                let (qd, _) = law.step(&arm, &tool, &limits, &q, lead_s, &twist, None, dt_s);
                under_way.push(qd);
                let makes = under_way.remove(0);
                if k > 60 {
                    let made = arm.jacobian_at(&q, &tool) * makes - twist.vector();
                    worst = worst.max(made.fixed_rows::<3>(0).norm());
                }
                q += makes * dt_s;
            }
            worst
        };
        let (late_m_per_s, compensated) = (error(0.0), error(0.04));
        assert!(late_m_per_s > 1e-3, "{late_m_per_s}");
        assert!(
            compensated < 0.1 * late_m_per_s,
            "{compensated} {late_m_per_s}"
        );
    }

    proptest! {
        #[test]
        fn joint_limits_hold_for_any_twist_and_pose(q in prop::array::uniform6(-7.0f64..7.0), v in prop::array::uniform6(-5.0f64..5.0)) {
            let (arm, limits) = (ur5(), Limits::default());
            let mut law = JointVelocity::default();
            let (q, dt) = (Joints::from(q), 0.008);
            let mut before = Joints::zeros();
            for _ in 0..200 {
                let (qd, _) = law.step(&arm, &Pose::identity(), &limits, &q, 0.05, &Twist::from_vector(&Vector6::from(v)), Some(&Vector3::z()), dt);
                for i in 0..6 {
                    prop_assert!(qd[i].abs() <= arm.limits().velocity[i] * limits.joint_speed_share + 1e-9);
                    let room = arm.limits().position_upper[i] - limits.joint_margin_rad - q[i];
                    if room < 0.0 { prop_assert!(qd[i] <= 0.0); }
                    if room > 0.1 && q[i] > arm.limits().position_lower[i] + limits.joint_margin_rad + 0.1 {
                        prop_assert!((qd[i] - before[i]).abs() <= limits.joint_acceleration_max_rad_per_s2 * dt + 1e-9);
                    }
                }
                before = qd;
            }
        }
    }

    #[test]
    fn the_tool_moves_as_asked_away_from_singularities() {
        let (arm, limits) = (ur5(), Limits::default());
        let q = arm.home();
        let flange_from_tool = Pose::identity();
        let twist = Twist::from_vector(&Vector6::new(0.02, -0.01, 0.005, 0.1, 0.0, -0.05));
        let mut law = JointVelocity::default();
        let mut qd = Joints::zeros();
        for _ in 0..100 {
            qd = law
                .step(
                    &arm,
                    &flange_from_tool,
                    &limits,
                    &q,
                    0.0,
                    &twist,
                    None,
                    0.008,
                )
                .0;
        }
        let moved = arm.jacobian_at(&q, &flange_from_tool) * qd;
        assert!((moved - twist.vector()).norm() < 1e-9, "{moved}");
    }

    /// The elbow nearly stretched: the arm hardly moves the tool along its reach.
    #[test]
    fn near_a_singularity_the_speed_along_the_normal_is_kept() {
        let (arm, limits) = (ur5(), Limits::default());
        let q = Joints::from([0.3, -0.6, 0.08, -1.1, -1.55, 0.0]);
        let mut kept = 0;
        for (normal, along) in [
            (Vector3::z(), Vector3::x()),
            (Vector3::new(-0.6, 0.0, 0.8), Vector3::new(0.8, 0.0, 0.6)),
        ] {
            let linear = along * 0.08 - normal * 0.005;
            let twist = Twist::new(linear, Vector3::new(0.0, 0.3, 0.0));
            let made = |normal: Option<&Vector3<f64>>| {
                let mut law = JointVelocity::default();
                let mut qd = Joints::zeros();
                for _ in 0..200 {
                    qd = law
                        .step(
                            &arm,
                            &Pose::identity(),
                            &limits,
                            &q,
                            0.0,
                            &twist,
                            normal,
                            0.008,
                        )
                        .0;
                }
                (arm.jacobian_at(&q, &Pose::identity()) * qd)
                    .fixed_rows::<3>(0)
                    .into_owned()
            };
            let with = made(Some(&normal)).dot(&normal);
            assert!((with + 0.005).abs() < 1e-4, "{with}");
            kept += usize::from((made(None).dot(&normal) + 0.005).abs() > 2e-3);
        }
        assert!(kept > 0, "no pose was singular enough to show a difference");
    }
}
