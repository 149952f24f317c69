//! A simulated arm with a torque interface on the bus: `arm/state` and `arm/command` at 1 kHz in
//! one process with the controller, and a camera on the wrist with the delay of a real driver.
//!
//! The service `tangent-simulator` starts a [`SimulatedTorqueArm`] around the plant of an
//! `object_pose` scenario, and puts a Net F/T box beside it. The failure table steps [`TorqueGate`]
//! without bus and clock.
//!
//! One thread simulates the arm. It publishes its state, which the controller answers within the
//! same call, passes the answer through the [`TorqueGate`], and moves by one period. A separate
//! thread renders the images.
//!
//! ```
//! use tangent_mechanics::{Arm, Joints, ModelData};
//! use tangent_torque_arm::TorqueGate;
//!
//! // Without a command the gate holds the arm where it stands.
//! let model = Arm::<6>::new(&ModelData::builtin("ur5")?)?;
//! let q = model.home();
//! let mut gate = TorqueGate::new(model, &q, 0.001);
//! let torque = gate.step(None, 1, &q, &Joints::<6>::zeros());
//! assert!((torque - model.gravity(&q)).amax() < 1e-9);
//! # Ok::<(), tangent_mechanics::ModelError>(())
//! ```

mod arm;
mod fault;
mod gate;
mod images;
mod state;

pub use arm::{SimulatedTorqueArm, TorqueArmError};
pub use gate::TorqueGate;
