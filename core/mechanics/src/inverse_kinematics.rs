//! Joint angles for a pose of the tool, for start poses: not for the loop.
use crate::{Arm, Base, Flange, Joints, Pose, Tool};

/// Why no joint angles were found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InverseKinematicsError {
    /// No start led to the target within the joints' limits.
    #[error("unreachable")]
    Unreachable,
}
/// Settings of the search.
pub struct InverseKinematics;
/// Joint angles (rad).
pub fn inverse_kinematics<const N: usize>(
    _arm: &Arm<N>,
    _flange_from_tool: &Pose<Flange, Tool>,
    _target: &Pose<Base, Tool>,
    _seed: &Joints<N>,
) -> Result<Joints<N>, InverseKinematicsError> {
    Err(InverseKinematicsError::Unreachable)
}
