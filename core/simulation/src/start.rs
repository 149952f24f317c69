//! Where the tool starts: over the surface, by a gap, with a tilt; joints by inverse kinematics.

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use tangent_mechanics::{Arm, Base, Flange, Joints, Pose, Tool, inverse_kinematics};

use crate::plant_config::StartConfig;
use crate::plant_error::{PlantError, StartError};
use crate::surfaces::Surface;

/// The tool's start pose.
pub fn tool_pose(start: &StartConfig, surface: &Surface) -> Pose<Base, Tool> {
    let at = surface.query(&Vector3::from(start.near_m));
    let z = -at.normal;
    // The tool's x axis as near to the base's x as it can be; on a surface that faces along x, as
    // near to y.
    let seed = if z.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = (seed - z * z.dot(&seed)).normalize();
    let square = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let square = UnitQuaternion::from_rotation_matrix(&square);
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), start.yaw_rad);
    let (sin, cos) = start.tilt_direction_rad.sin_cos();
    // Tilting towards a direction is a turn about the axis across it.
    let tilt_axis = Unit::new_unchecked(Vector3::new(-sin, cos, 0.0));
    let tilt = UnitQuaternion::from_axis_angle(&tilt_axis, start.tilt_rad);
    Pose::new(
        at.point + at.normal * start.clearance_m,
        square * yaw * tilt,
    )
}

/// Joint positions for that pose, rad.
///
/// # Errors
/// When the seed has not one entry per joint, or the pose is out of reach from it.
pub fn joints<const N: usize>(
    arm: &Arm<N>,
    flange_from_tool: &Pose<Flange, Tool>,
    target: &Pose<Base, Tool>,
    start: &StartConfig,
) -> Result<Joints<N>, PlantError> {
    let seed = match &start.seed_rad {
        None => arm.home(),
        Some(seed) => {
            let count = seed.len();
            let key = "start.seed_rad (entries)";
            PlantError::unless(key, count as f64, "one entry per joint", count == N)?;
            Joints::from_fn(|i, _| seed[i])
        }
    };
    inverse_kinematics(arm, flange_from_tool, target, &seed).map_err(|source| {
        let p = target.translation();
        PlantError::Start(StartError {
            x: p.x,
            y: p.y,
            z: p.z,
            source,
        })
    })
}
