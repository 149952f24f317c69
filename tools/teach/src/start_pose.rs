//! The start pose above the first point: the pose that was shown there, moved back along the tool's
//! axis.

use nalgebra::Vector3;
use tangent_mechanics::{Arm, Flange, InverseKinematics, Joints, ModelData, Pose, Tool};

use crate::error::TeachError;
use crate::lesson::Shown;

/// Steps in which the tool is moved back: the posture of the arm stays the one that was shown.
const STEP_M: f64 = 0.005;

/// Joint positions (rad) with the tool `clearance_m` above `shown`, in the same posture.
///
/// # Errors
/// The arm cannot reach it, or its joints are not those of `model`.
pub(crate) fn above(
    model: &ModelData,
    flange_from_tool: &Pose<Flange, Tool>,
    shown: &Shown,
    clearance_m: f64,
) -> Result<Vec<f64>, TeachError> {
    match model.dof {
        6 => of_arm::<6>(model, flange_from_tool, shown, clearance_m),
        _ => of_arm::<7>(model, flange_from_tool, shown, clearance_m),
    }
}

fn of_arm<const N: usize>(
    model: &ModelData,
    flange_from_tool: &Pose<Flange, Tool>,
    shown: &Shown,
    clearance_m: f64,
) -> Result<Vec<f64>, TeachError> {
    if shown.joints_rad.len() != N {
        return Err(TeachError::Joints {
            read: shown.joints_rad.len(),
            model: N,
        });
    }
    let arm = Arm::<N>::new(model)?;
    let mut q = Joints::<N>::from_column_slice(&shown.joints_rad);
    let at = arm.base_from_flange(&q) * *flange_from_tool;
    // A search from other postures would turn joints around.
    let search = InverseKinematics {
        position_tolerance_m: 1e-6,
        angle_tolerance_rad: 1e-6,
        starts_max: 1,
        ..InverseKinematics::default()
    };
    let steps = (clearance_m / STEP_M).ceil().max(1.0);
    for step in 1..=steps as usize {
        let back_m = clearance_m * step as f64 / steps;
        let place = at.translation() - at.rotate(&Vector3::z()) * back_m;
        let target = Pose::new(place, at.rotation());
        q = search
            .solve(&arm, flange_from_tool, &target, &q)
            .map_err(|source| TeachError::NoStart {
                clearance_m,
                source,
            })?;
    }
    Ok(q.as_slice().to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn the_tool_stands_above_the_point_in_the_same_posture() {
        let model = ModelData::builtin("ur5").unwrap();
        let arm = Arm::<6>::new(&model).unwrap();
        let tool = Pose::new(Vector3::new(0.0, 0.0, 0.165), UnitQuaternion::identity());
        let q = Joints::<6>::from([0.3, -1.6, 1.7, -1.67, -1.57, 0.4]);
        let shown = Shown {
            joints_rad: q.as_slice().to_vec(),
            base_from_tool: arm.base_from_flange(&q) * tool,
        };
        let found = above(&model, &tool, &shown, 0.03).unwrap();
        let found = Joints::<6>::from_column_slice(&found);
        let pose = arm.base_from_flange(&found) * tool;
        let moved = shown
            .base_from_tool
            .unrotate(&(pose.translation() - shown.base_from_tool.translation()));
        assert!((moved + Vector3::z() * 0.03).norm() < 1e-5, "{moved}");
        assert!(pose.rotation().angle_to(&shown.base_from_tool.rotation()) < 1e-5);
        assert!((found - q).amax() < 0.2);
        let error = above(&model, &tool, &shown, 3.0).unwrap_err().to_string();
        assert!(error.contains("--clearance-m"), "{error}");
    }
}
