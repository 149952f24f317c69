//! Tilt of the camera's mounting, from the way that the tool takes while it slides: on the surface,
//! the tool moves across the true normal.

use nalgebra::{Matrix2, Vector2, Vector3};
use tangent_mechanics::{Base, Pose, Tool};

/// Distance between two corrections, m.
const WAY_M: f64 = 0.002;
/// Error of the tool's height over that distance, standard deviation, m: the contact gives way
/// under a force that varies, and the pad rolls over its rim.
const RISE_SD_M: f64 = 15e-6;
/// Error of the camera's normal that differs between two corrections, standard deviation, rad.
const NORMAL_SD_RAD: f64 = 0.007;
/// Growth of the tilt's variance, rad²/s: an error of the camera that changes slowly.
const DOUBT_PER_S: f64 = 4e-6;
/// Gate for outliers, standard deviations.
const GATE_SD: f64 = 4.0;

/// The estimated tilt. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MountingTilt {
    /// Rotation from the true normal to the one seen, along the tool's x and y axes, rad, and its
    /// covariance, rad²; `None` before the first correction.
    found: Option<(Vector2<f64>, Matrix2<f64>)>,
    last_at: Option<Vector3<f64>>,
    way_m: f64,
    rise_m: f64,
    columns: Vector2<f64>,
}

impl MountingTilt {
    /// Processes one period with the tool in `tool`. `seen` is the camera's normal there while the
    /// tool presses on the surface, without any correction. `sd_rad` is the standard deviation of
    /// the tilt about each axis before anything is known; 0: there is none.
    pub fn step(
        &mut self,
        sd_rad: f64,
        tool: &Pose<Base, Tool>,
        seen: Option<&Vector3<f64>>,
        dt_s: f64,
    ) {
        let at = tool.translation();
        let (Some(normal), true) = (seen, sd_rad > 0.0) else {
            *self = Self {
                found: self.found,
                ..Self::default()
            };
            return;
        };
        if let Some((_, covariance)) = &mut self.found {
            *covariance += Matrix2::identity() * (DOUBT_PER_S * dt_s);
        }
        let moved = at - self.last_at.replace(at).unwrap_or(at);
        self.rise_m += normal.dot(&moved);
        let axes = [tool.rotate(&Vector3::x()), tool.rotate(&Vector3::y())];
        self.columns += Vector2::from(axes.map(|axis| axis.cross(normal).dot(&moved)));
        self.way_m += moved.norm();
        if self.way_m >= WAY_M {
            let prior = (Vector2::zeros(), Matrix2::identity() * (sd_rad * sd_rad));
            let (tilt, covariance) = self.found.unwrap_or(prior);
            let h = self.columns;
            let spread = covariance * h;
            let noise = RISE_SD_M.powi(2) + (NORMAL_SD_RAD * self.way_m).powi(2);
            let total = h.dot(&spread) + noise;
            let innovation = self.rise_m - h.dot(&tilt);
            if innovation * innovation <= GATE_SD * GATE_SD * total {
                let gain = spread / total;
                let left = covariance - gain * spread.transpose();
                self.found = Some((tilt + gain * innovation, (left + left.transpose()) * 0.5));
            }
            (self.way_m, self.rise_m, self.columns) = (0.0, 0.0, Vector2::zeros());
        }
    }

    /// Small rotation (rad, base axes) that takes a normal as seen to the true one.
    pub fn correction(&self, tool: &Pose<Base, Tool>) -> Vector3<f64> {
        let (tilt, _) = self.found.unwrap_or_default();
        tool.rotate(&Vector3::new(-tilt.x, -tilt.y, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// A tool slides circles on a wave, square to it, and the camera is tilted by a constant angle.
    fn found(sd_rad: f64, tilt: Vector2<f64>) -> f64 {
        let mut mounting = MountingTilt::default();
        let (dt, mut error) = (1e-3, 0.0);
        for i in 0..4000 {
            let t = f64::from(i) * dt;
            let (sin, cos) = (2.0 * t).sin_cos();
            let (x, y) = (0.04 * cos, 0.04 * sin + 0.005 * t);
            let normal = Vector3::new(0.0, -0.33 * (16.5 * y).cos(), 1.0).normalize();
            let at = Vector3::new(x, y, 0.02 * (16.5 * y).sin());
            let turn = UnitQuaternion::rotation_between(&Vector3::z(), &-normal)
                .unwrap_or_else(|| UnitQuaternion::from_scaled_axis(Vector3::x() * 3.1));
            let tool = Pose::new(at, turn);
            let tilted = tool.rotate(&Vector3::new(tilt.x, tilt.y, 0.0));
            let seen = (normal + tilted.cross(&normal)).normalize();
            mounting.step(sd_rad, &tool, Some(&seen), dt);
            let corrected = seen + mounting.correction(&tool).cross(&seen);
            error = corrected.angle(&normal);
        }
        error
    }

    #[test]
    fn sliding_shows_the_tilt_of_the_camera() {
        let tilt = Vector2::new(0.04, -0.03);
        assert!(found(0.03, tilt) < 0.004, "{}", found(0.03, tilt));
        assert!(found(0.03, Vector2::zeros()) < 1e-3);
        assert!((found(0.0, tilt) - 0.05).abs() < 1e-3, "switched off");
    }

    #[test]
    fn nothing_is_learnt_in_the_air() {
        let mut mounting = MountingTilt::default();
        for i in 0..1000 {
            let at = Vector3::new(0.0, 0.0, f64::from(i) * 1e-4);
            let tool = Pose::new(at, UnitQuaternion::identity());
            mounting.step(0.03, &tool, None, 1e-3);
        }
        assert_eq!(mounting.correction(&Pose::identity()), Vector3::zeros());
    }
}
