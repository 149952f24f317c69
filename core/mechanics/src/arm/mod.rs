//! An arm with `N` revolute joints: kinematics and dynamics of fixed size, computed from
//! [`ModelData`] once.
//!
//! Used by control, simulation and the robot bridges. No method allocates.

mod dynamics;
mod kinematics;

use nalgebra::{Matrix3, Vector3};

use crate::Joints;
use crate::model::{DhConvention, DhRow, ModelData, ModelError};

/// Rotation and origin: a fixed transform of the chain, or a frame in base axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    pub(crate) rotation: Matrix3<f64>,
    pub(crate) origin: Vector3<f64>,
}

/// Mass properties of one moving body in its joint's frame (or of several, in base axes, while they
/// are summed).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Body {
    pub(crate) mass: f64,
    pub(crate) com: Vector3<f64>,
    /// Inertia about `com`, kg m².
    pub(crate) inertia: Matrix3<f64>,
}

/// Limits of an arm's joints. All except those of position are symmetric. A limit is `None` if the
/// manufacturer does not publish it.
///
/// ```
/// use tangent_mechanics::{Arm, Joints, ModelData};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let far = Joints::<6>::repeat(100.0);
/// assert!(!arm.limits().contains(&far));
/// assert_eq!(arm.limits().clamp(&far), arm.limits().position_upper);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<const N: usize> {
    /// Lowest angle, rad.
    pub position_lower: Joints<N>,
    /// Highest angle, rad.
    pub position_upper: Joints<N>,
    /// Highest speed, rad/s.
    pub velocity: Joints<N>,
    /// Highest acceleration, rad/s².
    pub acceleration: Option<Joints<N>>,
    /// Highest jerk, rad/s³.
    pub jerk: Option<Joints<N>>,
    /// Highest torque, Nm.
    pub effort: Option<Joints<N>>,
    /// Highest rate of change of torque, Nm/s.
    pub effort_rate: Option<Joints<N>>,
}

impl<const N: usize> Limits<N> {
    /// Whether every joint's angle (rad) is within its limits; false for NaN.
    pub fn contains(&self, q: &Joints<N>) -> bool {
        (0..N).all(|i| q[i] >= self.position_lower[i] && q[i] <= self.position_upper[i])
    }

    /// Nearest joint angles (rad) within the limits.
    pub fn clamp(&self, q: &Joints<N>) -> Joints<N> {
        Joints::from_fn(|i, _| q[i].clamp(self.position_lower[i], self.position_upper[i]))
    }
}

/// A body fixed to the flange: a tool, a sensor, or an object in a gripper.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use tangent_mechanics::{Arm, ModelData, Payload};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
/// let gripper = Payload {
///     mass_kg: 0.9,
///     com_in_flange_m: Vector3::new(0.0, 0.0, 0.06),
///     inertia_kg_m2: Matrix3::zeros(),
/// };
/// let bare = arm.gravity(&arm.home());
/// let loaded = arm.with_payload(&gripper).gravity(&arm.home());
/// assert!((loaded - bare).norm() > 1.0);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in flange axes, from the flange's origin, m.
    pub com_in_flange_m: Vector3<f64>,
    /// Inertia about the centre of mass, flange axes, kg m²; zero for a point mass.
    pub inertia_kg_m2: Matrix3<f64>,
}

/// Kinematics and dynamics of one arm. Joint vectors are ordered base to flange.
///
/// The frame of link `i` lies in joint `i`, with z along its axis, and turns with it. Both
/// Denavit-Hartenberg conventions are converted to that form, so the rest of the code does not
/// depend on the convention.
///
/// ```
/// use tangent_mechanics::{Arm, Joints, ModelData};
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5")?)?;
/// let q = arm.home();
/// assert!(arm.base_from_flange(&q).translation().norm() < 1.0);
/// // An arm that is held against gravity does not accelerate.
/// let qdd = arm.forward_dynamics(&q, &Joints::zeros(), &arm.gravity(&q));
/// assert!(qdd.norm() < 1e-9);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arm<const N: usize> {
    /// From link i-1's frame (the base's for the first) to joint i at angle zero.
    steps: [Step; N],
    /// From the last link's frame to the flange.
    flange: Step,
    bodies: [Body; N],
    offsets: Joints<N>,
    gravity: Vector3<f64>,
    limits: Limits<N>,
    home: Joints<N>,
}

impl<const N: usize> Arm<N> {
    /// Checks `model` and computes the arm from it.
    ///
    /// # Errors
    /// A value of the model is not allowed, or the model does not have `N` joints.
    pub fn new(model: &ModelData) -> Result<Self, ModelError> {
        model.validate()?;
        if model.dof != N {
            return Err(ModelError::Dof {
                model: model.name.clone(),
                found: model.dof,
                expected: N,
            });
        }
        let joints = |values: &Vec<f64>| Joints::<N>::from_fn(|i, _| values[i]);
        let (links, flange) = links_of(model);
        let limits = &model.limits;
        Ok(Self {
            steps: std::array::from_fn(|i| links[i].0),
            flange,
            bodies: std::array::from_fn(|i| links[i].1),
            offsets: Joints::from_fn(|i, _| model.dh.rows[i].theta_offset_rad),
            gravity: Vector3::from(model.gravity_m_per_s2),
            limits: Limits {
                position_lower: joints(&limits.position_lower_rad),
                position_upper: joints(&limits.position_upper_rad),
                velocity: joints(&limits.velocity_rad_per_s),
                acceleration: limits.acceleration_rad_per_s2.as_ref().map(joints),
                jerk: limits.jerk_rad_per_s3.as_ref().map(joints),
                effort: limits.effort_nm.as_ref().map(joints),
                effort_rate: limits.effort_rate_nm_per_s.as_ref().map(joints),
            },
            home: joints(&model.home_rad),
        })
    }

    /// Arm with a body fixed to its flange. The kinematics do not change.
    pub fn with_payload(mut self, payload: &Payload) -> Self {
        let body = Body {
            mass: payload.mass_kg,
            com: payload.com_in_flange_m,
            inertia: payload.inertia_kg_m2,
        }
        .placed_in(&self.flange);
        if let Some(last) = self.bodies.last_mut() {
            *last = last.joined_with(&body);
        }
        self
    }

    /// Arm with another gravity, as when mounted on a wall or a ceiling: `gravity` is its
    /// acceleration in base axes, m/s².
    pub fn with_gravity(mut self, gravity: Vector3<f64>) -> Self {
        self.gravity = gravity;
        self
    }

    /// Limits of the joints.
    pub fn limits(&self) -> &Limits<N> {
        &self.limits
    }

    /// Default start pose of the model, rad.
    pub fn home(&self) -> Joints<N> {
        self.home
    }

    /// Acceleration of gravity in base axes, m/s².
    pub fn gravity_in_base(&self) -> Vector3<f64> {
        self.gravity
    }
}

/// Of each link, the step from the frame before it to its joint at angle zero, without the joint's
/// offset, and its body in the joint's frame; then the step from the last link to the flange. The
/// model must have passed its check.
pub(crate) fn links_of(model: &ModelData) -> (Vec<(Step, Body)>, Step) {
    let dh = &model.dh;
    let mut reached = Step::from_rows(&dh.base_from_dh0);
    let mut links = Vec::with_capacity(model.dof);
    for (row, link) in dh.rows.iter().zip(&model.links) {
        // From joint i, already turned, to DH frame i: what follows the rotation about z in either
        // convention.
        let (before, after) = match dh.convention {
            DhConvention::Standard => (
                Step::IDENTITY,
                Step::along_z(row.d_m).then(&Step::about_x(row)),
            ),
            DhConvention::Modified => (Step::about_x(row), Step::along_z(row.d_m)),
        };
        let inertia =
            Matrix3::from_fn(|r, c| 0.5 * (link.inertia_kg_m2[r][c] + link.inertia_kg_m2[c][r]));
        let body = Body {
            mass: link.mass_kg,
            com: Vector3::from(link.com_m),
            inertia,
        };
        links.push((reached.then(&before), body.placed_in(&after)));
        reached = after;
    }
    (links, reached.then(&Step::from_rows(&dh.dhn_from_flange)))
}

impl Step {
    const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        origin: Vector3::new(0.0, 0.0, 0.0),
    };

    fn from_rows(rows: &[[f64; 4]; 4]) -> Self {
        Self {
            rotation: Matrix3::from_fn(|i, j| rows[i][j]),
            origin: Vector3::from_fn(|i, _| rows[i][3]),
        }
    }

    fn along_z(distance: f64) -> Self {
        Self {
            origin: Vector3::new(0.0, 0.0, distance),
            ..Self::IDENTITY
        }
    }

    /// TransX(a) RotX(alpha); the two commute.
    fn about_x(row: &DhRow) -> Self {
        let (s, c) = row.alpha_rad.sin_cos();
        Self {
            rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
            origin: Vector3::new(row.a_m, 0.0, 0.0),
        }
    }

    fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            origin: self.origin + self.rotation * next.origin,
        }
    }
}

impl Body {
    const NONE: Self = Self {
        mass: 0.0,
        com: Vector3::new(0.0, 0.0, 0.0),
        inertia: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// This body in the frame in which `frame` is given.
    fn placed_in(&self, frame: &Step) -> Self {
        Self {
            mass: self.mass,
            com: frame.origin + frame.rotation * self.com,
            inertia: frame.rotation * self.inertia * frame.rotation.transpose(),
        }
    }

    /// Both bodies as one. The parallel-axis theorem with the reduced mass avoids the cancellation
    /// of large terms.
    fn joined_with(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass <= 0.0 {
            return *self;
        }
        let apart = other.com - self.com;
        let reduced = self.mass * (other.mass / mass);
        Self {
            mass,
            com: self.com + apart * (other.mass / mass),
            inertia: self.inertia
                + other.inertia
                + (Matrix3::from_diagonal_element(apart.norm_squared())
                    - apart * apart.transpose())
                    * reduced,
        }
    }
}
