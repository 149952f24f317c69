//! Start pose of the tool: above the surface with a gap and a tilt. Inverse kinematics gives the
//! joints.

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Arm, Base, Flange, Joints, Pose, Tool, inverse_kinematics};

use crate::plant_error::{PlantError, StartError};
use crate::surfaces::Surface;

/// Start pose of the tool, relative to the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartConfig {
    /// The tool starts above the surface point closest to this point, base axes, m.
    pub near_m: [f64; 3],
    /// Gap between the tool's origin and the surface, m.
    #[serde(default = "default_clearance")]
    pub clearance_m: f64,
    /// Angle between `-z_tool` and the normal, rad.
    #[serde(default)]
    pub tilt_rad: f64,
    /// Direction of the tilt, about the tool's z axis from its x axis, rad.
    #[serde(default)]
    pub tilt_direction_rad: f64,
    /// Rotation of the tool about its own z axis, rad; at 0 its x axis is as close to the base's as
    /// possible.
    #[serde(default)]
    pub yaw_rad: f64,
    /// Joint positions from which inverse kinematics starts, one per joint, rad; the model's home
    /// position when absent.
    #[serde(default)]
    pub seed_rad: Option<Vec<f64>>,
}

fn default_clearance() -> f64 {
    0.01
}

/// The tool's start pose.
pub fn tool_pose(start: &StartConfig, surface: &Surface) -> Pose<Base, Tool> {
    let at = surface.query(&Vector3::from(start.near_m));
    let z = -at.normal;
    // The tool's x axis is as close to the base's x axis as possible; on a surface that faces along
    // x, to y.
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
    // A tilt towards a direction is a rotation about the axis perpendicular to it.
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
/// The seed does not have one entry per joint, or the pose cannot be reached from it.
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
