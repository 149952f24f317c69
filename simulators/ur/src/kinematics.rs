//! The controller's view of the arm: forward and inverse kinematics with the tool centre point that
//! is set.

use nalgebra::Vector6;
use tangent_mechanics::{
    Arm, Base, DampedLeastSquares, Flange, InverseKinematics, Joints, ModelData, ModelError, Pose,
    Tool,
};
use tangent_urscript::pose::{SixPose, isometry, six};

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
        // Few start values: a program waits for the answer within a frame.
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
