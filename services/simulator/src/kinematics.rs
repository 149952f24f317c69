//! The controller's view of the arm: poses as six numbers, forward and inverse kinematics, steps
//! towards a pose.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::{
    Arm, Base, DampedLeastSquares, Flange, InverseKinematics, Joints, ModelData, ModelError, Pose,
    Tool,
};

/// Position (m) and rotation vector (rad), as the controller writes poses.
pub type SixPose = [f64; 6];

/// The transform of a pose.
pub fn isometry(p: &SixPose) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(p[0], p[1], p[2]),
        UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], p[5])),
    )
}

/// The pose of a transform.
pub fn six(t: &Isometry3<f64>) -> SixPose {
    let (p, r) = (t.translation.vector, t.rotation.scaled_axis());
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// `a_from_b * b_from_c`.
pub fn compose(a: &SixPose, b: &SixPose) -> SixPose {
    six(&(isometry(a) * isometry(b)))
}

/// `b_from_a` of `a_from_b`.
pub fn invert(a: &SixPose) -> SixPose {
    six(&isometry(a).inverse())
}

/// Positions subtracted, rotation from `from` to `to` in base axes: `pose_sub`.
pub fn difference(to: &SixPose, from: &SixPose) -> SixPose {
    let (to, from) = (isometry(to), isometry(from));
    let p = to.translation.vector - from.translation.vector;
    let r = (to.rotation * from.rotation.inverse()).scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// Positions added, rotations composed: `pose_add`.
pub fn sum(a: &SixPose, b: &SixPose) -> SixPose {
    let (a, b) = (isometry(a), isometry(b));
    let p = a.translation.vector + b.translation.vector;
    let r = (b.rotation * a.rotation).scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// The arm with the tool centre point that is set.
#[derive(Clone, Debug)]
pub struct Kinematics {
    arm: Arm<6>,
    flange_from_tcp: Pose<Flange, Tool>,
}

impl Kinematics {
    /// A built-in model by name, with the tool centre point at the flange.
    pub fn builtin(name: &str) -> Result<Self, ModelError> {
        Ok(Self {
            arm: Arm::new(&ModelData::builtin(name)?)?,
            flange_from_tcp: Pose::identity(),
        })
    }

    /// The arm.
    pub fn arm(&self) -> &Arm<6> {
        &self.arm
    }

    /// `flange_from_tcp`.
    pub fn tcp(&self) -> SixPose {
        six(self.flange_from_tcp.isometry())
    }

    /// Sets `flange_from_tcp`.
    pub fn set_tcp(&mut self, pose: &SixPose) {
        self.flange_from_tcp = Pose::from_isometry(isometry(pose));
    }

    /// `base_from_tcp`.
    pub fn pose(&self, q: &Joints<6>) -> SixPose {
        six((self.arm.base_from_flange(q) * self.flange_from_tcp).isometry())
    }

    /// `base_from_tcp` with another tool centre point.
    pub fn pose_with(&self, q: &Joints<6>, tcp: &SixPose) -> SixPose {
        six(&(self.arm.base_from_flange(q).isometry() * isometry(tcp)))
    }

    /// Speed of the tool centre point, base axes, m/s and rad/s.
    pub fn speed(&self, q: &Joints<6>, qd: &Joints<6>) -> [f64; 6] {
        let twist = self.arm.jacobian_at(q, &self.flange_from_tcp) * qd;
        std::array::from_fn(|i| twist[i])
    }

    /// Joint positions for a pose, near `near`.
    pub fn inverse(&self, pose: &SixPose, near: &Joints<6>) -> Option<Joints<6>> {
        let target: Pose<Base, Tool> = Pose::from_isometry(isometry(pose));
        // Few starts: a program waits for the answer within a frame.
        let search = InverseKinematics {
            starts_max: 8,
            ..InverseKinematics::default()
        };
        search
            .solve(&self.arm, &self.flange_from_tcp, &target, near)
            .ok()
    }

    /// Joint velocity for a velocity of the tool centre point; small near singularities.
    pub fn joint_velocity(&self, q: &Joints<6>, twist: &Vector6<f64>) -> Joints<6> {
        let jacobian = self.arm.jacobian_at(q, &self.flange_from_tcp);
        let solver = DampedLeastSquares {
            damping_max: 0.05,
            threshold: 0.05,
        };
        solver.solve(&jacobian, twist)
    }
}
