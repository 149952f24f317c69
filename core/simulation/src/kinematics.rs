//! The arm models that the plant can move.

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::{Base, Flange, Joints, Pose, Tool};

/// A six-joint arm by its standard Denavit-Hartenberg rows.
#[derive(Clone, Debug)]
pub struct Arm6 {
    a: [f64; 6],
    d: [f64; 6],
    cos_alpha: [f64; 6],
    sin_alpha: [f64; 6],
}

impl Arm6 {
    /// A built-in model by name.
    pub fn builtin(name: &str) -> Result<Self, String> {
        let (a, d) = match name {
            "ur5" => (
                [0.0, -0.425, -0.39225, 0.0, 0.0, 0.0],
                [0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823],
            ),
            "ur5e" => (
                [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0],
                [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996],
            ),
            _ => return Err("not known; `ur5` and `ur5e` are".to_owned()),
        };
        Ok(Self {
            a,
            d,
            cos_alpha: [0.0, 1.0, 1.0, 0.0, 0.0, 1.0],
            sin_alpha: [1.0, 0.0, 0.0, 1.0, -1.0, 0.0],
        })
    }

    pub fn home(&self) -> Joints<6> {
        Joints::<6>::from([0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0])
    }

    pub fn limits(&self) -> (Joints<6>, Joints<6>, Joints<6>) {
        let tau = std::f64::consts::TAU;
        (
            Joints::<6>::repeat(-tau),
            Joints::<6>::repeat(tau),
            Joints::<6>::repeat(std::f64::consts::PI),
        )
    }

    fn chain(
        &self,
        q: &Joints<6>,
        mut each: impl FnMut(usize, &Vector3<f64>, &Vector3<f64>),
    ) -> Isometry3<f64> {
        let mut rotation = nalgebra::Matrix3::identity();
        let mut origin = Vector3::zeros();
        for i in 0..6 {
            each(i, &origin, &rotation.column(2).into_owned());
            let (s, c) = q[i].sin_cos();
            let (sa, ca) = (self.sin_alpha[i], self.cos_alpha[i]);
            origin += rotation * Vector3::new(self.a[i] * c, self.a[i] * s, self.d[i]);
            rotation *= nalgebra::Matrix3::new(c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca);
        }
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(rotation);
        Isometry3::from_parts(
            origin.into(),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    pub fn base_from_flange(&self, q: &Joints<6>) -> Pose<Base, Flange> {
        Pose::from_isometry(self.chain(q, |_, _, _| ()))
    }

    pub fn jacobian_at(
        &self,
        q: &Joints<6>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> Matrix6<f64> {
        let tool = (self.base_from_flange(q) * *flange_from_tool).translation();
        let mut jacobian = Matrix6::zeros();
        self.chain(q, |i, origin, axis| {
            let linear = axis.cross(&(tool - origin));
            jacobian.set_column(
                i,
                &Vector6::new(linear.x, linear.y, linear.z, axis.x, axis.y, axis.z),
            );
        });
        jacobian
    }

    pub fn inverse(
        &self,
        flange_from_tool: &Pose<Flange, Tool>,
        target: &Pose<Base, Tool>,
        seed: &Joints<6>,
    ) -> Result<Joints<6>, String> {
        let mut q = *seed;
        for _ in 0..500 {
            let now = self.base_from_flange(&q) * *flange_from_tool;
            let linear = target.translation() - now.translation();
            let angular = (target.rotation() * now.rotation().inverse()).scaled_axis();
            let error = Vector6::new(
                linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
            );
            if error.norm() < 1e-12 {
                return Ok(q);
            }
            let j = self.jacobian_at(&q, flange_from_tool);
            let damped =
                j.transpose() * j + Matrix6::identity() * (1e-9 + 1e-4 * error.norm_squared());
            let Some(factor) = damped.cholesky() else {
                break;
            };
            let step = factor.solve(&(j.transpose() * error));
            q += step * (0.3 / step.amax()).min(1.0);
        }
        Err("inverse kinematics did not converge".to_owned())
    }
}
