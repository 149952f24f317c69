//! Where a mesh is in the base of the robot: given as a pose, or by places that are known in both.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Pose};

use crate::error::RegionError;
use crate::mesh::MeshFrame;

/// Least width of the triangle of the places, as a share of its length.
const WIDTH_SHARE: f64 = 0.05;

/// The pose of the mesh in the base from `x, y, z, roll, pitch, yaw` (m and rad, about the fixed
/// axes) or `x, y, z, qx, qy, qz, qw`.
///
/// # Errors
/// Another number of numbers, or one that is not finite.
pub fn pose(numbers: &[f64]) -> Result<Pose<Base, MeshFrame>, RegionError> {
    let refuse = || {
        RegionError::option(
            "--frame",
            format!("{numbers:?}"),
            "x,y,z,roll,pitch,yaw in m and rad, or x,y,z,qx,qy,qz,qw",
        )
    };
    if !numbers.iter().all(|x| x.abs() < 1e3) {
        return Err(refuse());
    }
    let rotation = match numbers {
        [_, _, _, roll, pitch, yaw] => UnitQuaternion::from_euler_angles(*roll, *pitch, *yaw),
        [_, _, _, x, y, z, w] => {
            UnitQuaternion::try_new(Quaternion::new(*w, *x, *y, *z), 1e-3).ok_or_else(refuse)?
        }
        _ => return Err(refuse()),
    };
    Ok(Pose::new(
        Vector3::new(numbers[0], numbers[1], numbers[2]),
        rotation,
    ))
}

/// A place that is known in the mesh (units of the file times the scale, m) and in the base, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// In the mesh, m.
    pub in_mesh: [f64; 3],
    /// In the base, m.
    pub in_base: [f64; 3],
}

/// The pose that brings places of the mesh to those of the base with the least squares of the
/// distances that are left: Kabsch (1976). Also returns the largest of those distances, m.
///
/// # Errors
/// There are fewer than three places, or they lie on a line.
pub fn from_matches(matches: &[Match]) -> Result<(Pose<Base, MeshFrame>, f64), RegionError> {
    if matches.len() < 3 {
        let value = format!("there are {}, and three or more are needed", matches.len());
        return Err(RegionError::Match(value));
    }
    let count = matches.len() as f64;
    let mean = |of: fn(&Match) -> [f64; 3]| {
        matches
            .iter()
            .map(|m| Vector3::from(of(m)))
            .sum::<Vector3<f64>>()
            / count
    };
    let (mesh, base) = (mean(|m| m.in_mesh), mean(|m| m.in_base));
    let (mut across, mut own) = (Matrix3::zeros(), Matrix3::zeros());
    for m in matches {
        let (a, b) = (
            Vector3::from(m.in_mesh) - mesh,
            Vector3::from(m.in_base) - base,
        );
        across += b * a.transpose();
        own += a * a.transpose();
    }
    let mut widths = own.symmetric_eigenvalues().map(|x| x.max(0.0).sqrt());
    widths.as_mut_slice().sort_by(f64::total_cmp);
    if widths[1].is_nan() || widths[1] <= WIDTH_SHARE * widths[2] {
        let words = "they lie on a line: choose places that span a triangle";
        return Err(RegionError::Match(words.to_owned()));
    }
    let svd = across.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(RegionError::Match("they are not finite".to_owned()));
    };
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * mirror * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let pose = Pose::new(base - rotation * mesh, rotation);
    let left = |m: &Match| {
        (pose.transform_point(&Vector3::from(m.in_mesh)) - Vector3::from(m.in_base)).norm()
    };
    let left_m = matches.iter().map(left).fold(0.0, f64::max);
    Ok((pose, left_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_found_from_three_places_and_its_error_is_told() {
        let truth = pose(&[0.4, -0.1, 0.2, 0.3, -0.2, 1.5]).unwrap();
        let places = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.02, 0.08, 0.01]];
        let mut matches = places.map(|p| Match {
            in_mesh: p,
            in_base: truth.transform_point(&p.into()).into(),
        });
        let (found, left_m) = from_matches(&matches).unwrap();
        assert!((found.translation() - truth.translation()).norm() < 1e-9);
        assert!(found.rotation().angle_to(&truth.rotation()) < 1e-9 && left_m < 1e-9);
        matches[0].in_base[2] += 0.003;
        let (_, left_m) = from_matches(&matches).unwrap();
        assert!((0.0005..0.003).contains(&left_m), "{left_m}");
        let line = places.map(|p| Match {
            in_mesh: [p[0], 0.0, 0.0],
            in_base: p,
        });
        assert!(
            from_matches(&line)
                .unwrap_err()
                .to_string()
                .contains("line")
        );
        assert!(from_matches(&matches[..2]).is_err());
    }

    #[test]
    fn a_frame_has_six_or_seven_numbers() {
        let turn = std::f64::consts::FRAC_PI_2;
        let euler = pose(&[0.1, 0.2, 0.3, 0.0, 0.0, turn]).unwrap();
        let half = (0.5 * turn).sin();
        let quaternion = pose(&[0.1, 0.2, 0.3, 0.0, 0.0, half, half]).unwrap();
        assert!(euler.rotation().angle_to(&quaternion.rotation()) < 1e-9);
        for bad in [&[0.0; 5][..], &[0.0; 7], &[f64::NAN; 6]] {
            assert!(pose(bad).unwrap_err().to_string().contains("--frame"));
        }
    }
}
