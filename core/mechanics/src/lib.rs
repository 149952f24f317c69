//! Spatial algebra with frames as types, robot models from plain data, kinematics and dynamics.
//!
//! All other crates take their poses, wrenches and arm models from here. Nothing in this crate
//! reads a clock, allocates in a control cycle or does I/O.
//!
//! | for | start with |
//! |---|---|
//! | frames as types | [`World`] to [`Contact`] |
//! | positions and directions in a frame | [`Pose`], [`Point`], [`Direction`] |
//! | velocities and forces in a frame | [`Twist`], [`Wrench`] |
//! | the data of a robot: built in, or read from a file | [`ModelData`] |
//! | kinematics and dynamics of an arm | [`Arm`], computed from a [`ModelData`] once |
//! | joint velocities for a twist, near singularities too | [`DampedLeastSquares`] |
//! | the shape of a tool's tip | [`Tip`] |
//! | the frames of all links by name, for viewers | [`Chain`] |
//! | an arm as a URDF with simple shapes | [`urdf::urdf`] |
//! | joint angles for a pose, outside of the control loop | [`InverseKinematics`] |
//!
//! ```
//! use nalgebra::{UnitQuaternion, Vector3};
//! use tangent_mechanics::{Arm, DampedLeastSquares, Flange, ModelData, Pose, Tool, Twist};
//! use tangent_mechanics::{Aligned, Base};
//!
//! // Joint velocities that move the tip of a 15 cm tool down at 10 mm/s.
//! let arm = Arm::<6>::new(&ModelData::builtin("ur5e")?)?;
//! let flange_from_tool: Pose<Flange, Tool> =
//!     Pose::new(Vector3::new(0.0, 0.0, 0.15), UnitQuaternion::identity());
//! let (_base_from_tool, jacobian) = arm.tool_and_jacobian(&arm.home(), &flange_from_tool);
//! let down: Twist<Aligned<Tool, Base>> =
//!     Twist::new(Vector3::new(0.0, 0.0, -0.01), Vector3::zeros());
//! let qd = DampedLeastSquares::default().solve(&jacobian, &down.vector());
//! assert!((jacobian * qd - down.vector()).norm() < 1e-9);
//! # Ok::<(), tangent_mechanics::ModelError>(())
//! ```

pub mod arm;
pub mod chain;
pub mod damped_least_squares;
pub mod golden;
pub mod inverse_kinematics;
mod joint_friction;
pub mod linear_solve;
pub mod manipulability;
pub mod model;
pub mod names;
pub mod spatial;
mod tip;
pub mod urdf;

pub use arm::{Arm, Limits, Payload};
pub use chain::Chain;
pub use damped_least_squares::{DampedLeastSquares, DampedSolution};
pub use inverse_kinematics::{InverseKinematics, InverseKinematicsError, inverse_kinematics};
pub use joint_friction::JointFriction;
pub use manipulability::{manipulability, smallest_singular_value};
pub use model::{CalibrationError, ModelData, ModelError};
pub use spatial::{
    Aligned, Base, Camera, Contact, Direction, Flange, Frame, Object, Point, Pose, Sensor, Tool,
    Twist, World, Wrench,
};
pub use tip::Tip;

/// Joint vector of an arm with `N` joints: rad, rad/s, rad/s² or Nm, base to flange.
pub type Joints<const N: usize> = nalgebra::SVector<f64, N>;
