//! Pose of a flat target from one image of its four corners: a homography, then least squares on
//! the image.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use tangent_mechanics::{Camera, Object, Pose};

use super::CORNERS;

/// Reason why an image gives no pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanarPoseError {
    /// The corners lie on a line, or no homography exists.
    Degenerate,
    /// The corners run in the opposite direction: a mirrored target, or one seen from behind.
    Mirrored,
    /// No pose fits the corners: a wrong correspondence or an outlier.
    Residual {
        /// Root mean square residual, in units of the normalised image.
        rms: f64,
    },
}

/// Four coplanar corners, counter-clockwise seen from outside (object axes, m).
#[derive(Clone, Copy, Debug)]
pub struct PlanarTarget {
    corners: [Vector3<f64>; CORNERS],
    /// Rotation from the target's own axes to object axes: x along the first edge, z out of the
    /// target.
    axes: Rotation3<f64>,
    flat: [Vector2<f64>; CORNERS],
}

impl PlanarTarget {
    /// Target with these corners; `None` if they lie on a line.
    pub fn new(corners: &[Vector3<f64>; CORNERS]) -> Option<Self> {
        let x = (corners[1] - corners[0]).try_normalize(1e-9)?;
        let z = x.cross(&(corners[2] - corners[0])).try_normalize(1e-9)?;
        let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        let flat = corners.map(|c| (axes.inverse() * (c - corners[0])).xy());
        Some(Self {
            corners: *corners,
            axes,
            flat,
        })
    }

    /// Pose from `[x/z, y/z]` of all corners; `rms_max` bounds the residual in the same units.
    ///
    /// # Errors
    /// The reason why these corners cannot be the target's.
    pub fn pose(
        &self,
        image: &[Vector2<f64>; CORNERS],
        rms_max: f64,
    ) -> Result<Pose<Camera, Object>, PlanarPoseError> {
        let start = self.homography_pose(image)?;
        let (pose, rms) = self.refined(start, image);
        // Seen nearly face on, the tilt may have either sign, so the other sign is tried too.
        let (other, other_rms) = self.refined(self.tilted_back(&pose), image);
        let (pose, rms) = if other_rms < rms {
            (other, other_rms)
        } else {
            (pose, rms)
        };
        if rms.is_nan() || rms > rms_max {
            return Err(PlanarPoseError::Residual { rms });
        }
        let out = pose.rotate(&(self.axes * Vector3::z()));
        if out.dot(&pose.transform_point(&self.corners[0])) >= 0.0 {
            return Err(PlanarPoseError::Mirrored);
        }
        Ok(pose)
    }

    fn homography_pose(
        &self,
        image: &[Vector2<f64>; CORNERS],
    ) -> Result<Pose<Camera, Object>, PlanarPoseError> {
        let mut system = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for (i, (p, m)) in self.flat.iter().zip(image).enumerate() {
            for axis in 0..2 {
                let row = 2 * i + axis;
                system[(row, 3 * axis)] = p.x;
                system[(row, 3 * axis + 1)] = p.y;
                system[(row, 3 * axis + 2)] = 1.0;
                system[(row, 6)] = -m[axis] * p.x;
                system[(row, 7)] = -m[axis] * p.y;
                right[row] = m[axis];
            }
        }
        let h = system
            .lu()
            .solve(&right)
            .filter(|h| h.iter().all(|x| x.is_finite()))
            .ok_or(PlanarPoseError::Degenerate)?;
        // The third entry of the last column is 1: the origin lies in front of the camera.
        let (h1, h2) = (
            Vector3::new(h[0], h[3], h[6]),
            Vector3::new(h[1], h[4], h[7]),
        );
        let scale = 1.0 / (h1.norm() * h2.norm()).sqrt();
        let x = h1.try_normalize(1e-9).ok_or(PlanarPoseError::Degenerate)?;
        let z = x
            .cross(&h2)
            .try_normalize(1e-9)
            .ok_or(PlanarPoseError::Degenerate)?;
        let rotation =
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        let origin = Vector3::new(h[2], h[5], 1.0) * scale;
        Ok(self.object_pose(origin, rotation))
    }

    fn object_pose(&self, origin: Vector3<f64>, rotation: Rotation3<f64>) -> Pose<Camera, Object> {
        let rotation = rotation * self.axes.inverse();
        Pose::new(
            origin - rotation * self.corners[0],
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    fn tilted_back(&self, pose: &Pose<Camera, Object>) -> Pose<Camera, Object> {
        let centre = self.corners.iter().sum::<Vector3<f64>>() / CORNERS as f64;
        let at = pose.transform_point(&centre);
        let out = pose.rotate(&(self.axes * Vector3::z()));
        let ray = at.normalize();
        // Rotation that maps the normal to its mirror image about the ray.
        let mirrored = ray * (2.0 * out.dot(&ray)) - out;
        let turn = UnitQuaternion::rotation_between(&out, &mirrored)
            .unwrap_or_else(UnitQuaternion::identity);
        let rotation = turn * pose.rotation();
        Pose::new(at - rotation * centre, rotation)
    }

    /// Gauss-Newton on the image. The remaining root mean square is NaN if a corner came behind the
    /// camera.
    fn refined(
        &self,
        start: Pose<Camera, Object>,
        image: &[Vector2<f64>; CORNERS],
    ) -> (Pose<Camera, Object>, f64) {
        let mut pose = start;
        let mut rms = f64::NAN;
        for _ in 0..20 {
            let mut jacobian = SMatrix::<f64, 8, 6>::zeros();
            let mut residual = SVector::<f64, 8>::zeros();
            for (i, (corner, m)) in self.corners.iter().zip(image).enumerate() {
                let arm = pose.rotate(corner);
                let p = pose.translation() + arm;
                if p.z <= 1e-3 {
                    return (pose, f64::NAN);
                }
                let (x, y) = (p.x / p.z, p.y / p.z);
                let project = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -x, 0.0, 1.0, -y) * (1.0 / p.z);
                jacobian
                    .fixed_view_mut::<2, 3>(2 * i, 0)
                    .copy_from(&project);
                jacobian
                    .fixed_view_mut::<2, 3>(2 * i, 3)
                    .copy_from(&(project * -arm.cross_matrix()));
                residual[2 * i] = m.x - x;
                residual[2 * i + 1] = m.y - y;
            }
            rms = (residual.norm_squared() / residual.len() as f64).sqrt();
            let normal = jacobian.tr_mul(&jacobian);
            let Some(step) = normal
                .cholesky()
                .map(|c| c.solve(&jacobian.tr_mul(&residual)))
            else {
                return (pose, f64::NAN);
            };
            pose = Pose::new(
                pose.translation() + step.fixed_rows::<3>(0),
                UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned())
                    * pose.rotation(),
            );
            if step.norm() < 1e-12 {
                break;
            }
        }
        (pose, rms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square() -> [Vector3<f64>; CORNERS] {
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|[x, y]| Vector3::new(0.05 * x, 0.05 * y, 0.0))
    }

    /// Pose of the target for a camera that looks down on it from `height`, rotated by `turn`.
    fn seen(height: f64, at: [f64; 2], turn: [f64; 3]) -> Pose<Camera, Object> {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        Pose::new(
            Vector3::new(at[0], at[1], height),
            UnitQuaternion::from_scaled_axis(Vector3::from(turn)) * down,
        )
    }

    fn image(pose: &Pose<Camera, Object>) -> [Vector2<f64>; CORNERS] {
        square().map(|c| {
            let p = pose.transform_point(&c);
            p.xy() / p.z
        })
    }

    proptest! {
        #[test]
        fn the_pose_behind_the_image_is_found(height in 0.2f64..0.8, at in prop::array::uniform2(-0.15f64..0.15), turn in prop::array::uniform3(-0.5f64..0.5)) {
            let truth = seen(height, at, turn);
            let target = PlanarTarget::new(&square()).unwrap();
            let found = target.pose(&image(&truth), 1e-6).unwrap();
            prop_assert!((found.matrix() - truth.matrix()).amax() < 1e-6);
        }
    }

    #[test]
    fn a_mirrored_or_crossed_square_is_refused() {
        let target = PlanarTarget::new(&square()).unwrap();
        let good = image(&seen(0.4, [0.02, -0.03], [0.1, -0.2, 0.3]));
        let mirrored = [good[3], good[2], good[1], good[0]];
        assert_eq!(target.pose(&mirrored, 0.01), Err(PlanarPoseError::Mirrored));
        let crossed = [good[1], good[0], good[2], good[3]];
        assert!(target.pose(&crossed, 0.01).is_err());
        let mut jumped = good;
        jumped[2].x += 0.05;
        assert!(matches!(
            target.pose(&jumped, 0.002),
            Err(PlanarPoseError::Residual { .. })
        ));
        let line = [0.0, 0.1, 0.2, 0.3].map(|x| Vector2::new(x, 0.5 * x));
        assert!(target.pose(&line, 0.01).is_err());
        assert!(
            target
                .pose(&[Vector2::new(f64::NAN, 0.0); 4], 0.01)
                .is_err()
        );
    }
}
