//! The start pose: the tool above the place where it touches down, square to the surface there.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tangent_mechanics::{Arm, Flange, InverseKinematics, Joints, ModelData, Pose, Tool};

use crate::error::RegionError;
use crate::plane::TaskPlane;

/// Directions of the tool's x axis that are tried.
const TURNS: u32 = 8;

/// Joint positions (rad) with the tool `clearance_m` above the origin of the plane, its axis
/// against `outwards` (unit, base axes).
///
/// # Errors
/// The arm cannot reach it.
pub(crate) fn above(
    model: &ModelData,
    flange_from_tool: &Pose<Flange, Tool>,
    plane: &TaskPlane,
    outwards: &Vector3<f64>,
    clearance_m: f64,
) -> Result<Vec<f64>, RegionError> {
    match model.dof {
        6 => of_arm::<6>(model, flange_from_tool, plane, outwards, clearance_m),
        _ => of_arm::<7>(model, flange_from_tool, plane, outwards, clearance_m),
    }
}

fn of_arm<const N: usize>(
    model: &ModelData,
    flange_from_tool: &Pose<Flange, Tool>,
    plane: &TaskPlane,
    outwards: &Vector3<f64>,
    clearance_m: f64,
) -> Result<Vec<f64>, RegionError> {
    let arm = Arm::<N>::new(model)?;
    let home = arm.home();
    let place = plane.origin + plane.normal * clearance_m;
    let z = -outwards;
    let x = (plane.x - z * plane.x.dot(&z)).normalize();
    let square = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let square = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(square));
    let search = InverseKinematics {
        position_tolerance_m: 1e-6,
        angle_tolerance_rad: 1e-6,
        ..InverseKinematics::default()
    };
    let mut best: Option<(f64, Joints<N>)> = None;
    let mut failed = None;
    for turn in 0..TURNS {
        let angle = std::f64::consts::TAU * f64::from(turn) / f64::from(TURNS);
        let turned = square * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        match search.solve(&arm, flange_from_tool, &Pose::new(place, turned), &home) {
            Ok(q) => {
                let away = (q - home).amax();
                if best.as_ref().is_none_or(|(least, _)| away < *least) {
                    best = Some((away, q));
                }
            }
            Err(error) => failed = Some(error),
        }
    }
    match (best, failed) {
        (Some((_, q)), _) => Ok(q.as_slice().to_vec()),
        (None, Some(source)) => Err(RegionError::NoStart {
            clearance_m,
            at_m: plane.origin.into(),
            source,
        }),
        (None, None) => Ok(Vec::new()),
    }
}
