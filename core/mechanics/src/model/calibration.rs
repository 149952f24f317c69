//! Factory calibration of one arm: corrections of its Denavit-Hartenberg table.
//!
//! Universal Robots measures every arm and writes the corrections to `calibration.conf` on the
//! controller (`/root/.urcontrol/`, or `/programs/.urcontrol/`). The caller reads the file.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{DhConvention, DhRow, ModelData, ModelError};
use crate::chain::Chain;

/// Section of the file that holds the corrections.
const SECTION: &str = "mounting";
/// Status of corrections that are ready to be added: linearised.
const LINEARISED: &str = "2";
/// Distance between the flange of the calibrated arm and that of the table, at home and with every
/// joint at zero, above which the file is that of another arm, m.
const DISTANCE_MAX_M: f64 = 0.05;

/// Why a calibration was refused. The caller adds the name of the file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// A key is missing.
    #[error("`{key}` is missing in section [{SECTION}]: is this the arm's calibration.conf?")]
    Missing {
        /// The key.
        key: &'static str,
    },
    /// A value is not a list of finite numbers, one per joint.
    #[error("line {line}: `{key}` = {value}: must be a list of {dof} numbers, as [0.1, 0.2, ...]")]
    List {
        /// The line, from 1.
        line: usize,
        /// The key.
        key: &'static str,
        /// The value found.
        value: String,
        /// Number of joints.
        dof: usize,
    },
    /// The corrections are not ready to be added.
    #[error(
        "line {line}: `calibration_status` = {value}: only 2 (linearised) can be used; let Universal Robots' service complete the arm's calibration"
    )]
    Status {
        /// The line, from 1.
        line: usize,
        /// The value found.
        value: String,
    },
    /// The corrections move the flange further than any factory calibration does.
    #[error(
        "moves the flange of a {model} by {distance_m:.3} m, more than {DISTANCE_MAX_M} m: the file is that of another arm"
    )]
    OtherArm {
        /// The model's name.
        model: String,
        /// The distance, m.
        distance_m: f64,
    },
    /// The model's table has another convention.
    #[error(
        "robot model `{model}` has a modified DH table; corrections are those of a standard one"
    )]
    Convention {
        /// The model's name.
        model: String,
    },
    /// The corrected model is not valid.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl ModelData {
    /// This model with the corrections of a `calibration.conf`: its lists `delta_theta`, `delta_a`,
    /// `delta_d` and `delta_alpha` (rad, m) are added to the rows of the table. Bodies keep their
    /// place in the arm.
    ///
    /// Corrections of `d` may be metres: the axes of shoulder, elbow and first wrist joint are
    /// nearly parallel, and where a common perpendicular meets them is a matter of micrometres.
    ///
    /// # Errors
    /// The text is not a calibration, or not one of this arm.
    ///
    /// ```
    /// use tangent_mechanics::ModelData;
    ///
    /// let zeros = "[0, 0, 0, 0, 0, 0]";
    /// let text = format!(
    ///     "[mounting]\ndelta_theta = {zeros}\ndelta_a = [0, 0.0004, 0, 0, 0, 0]\n\
    ///      delta_d = {zeros}\ndelta_alpha = {zeros}\n"
    /// );
    /// let arm = ModelData::builtin("ur5e")?.calibrated(&text)?;
    /// assert_eq!(arm.dh.rows[1].a_m, -0.4246);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn calibrated(&self, text: &str) -> Result<Self, CalibrationError> {
        if self.dh.convention != DhConvention::Standard {
            return Err(CalibrationError::Convention {
                model: self.name.clone(),
            });
        }
        let read = |key| list(text, key, self.dof);
        let (theta, a) = (read("delta_theta")?, read("delta_a")?);
        let (d, alpha) = (read("delta_d")?, read("delta_alpha")?);
        let mut model = self.clone();
        for (i, row) in model.dh.rows.iter_mut().enumerate() {
            row.theta_offset_rad += theta[i];
            row.a_m += a[i];
            row.d_m += d[i];
            row.alpha_rad += alpha[i];
        }
        for (i, link) in model.links.iter_mut().enumerate() {
            let new_from_old = frame(&model.dh.rows[..=i]).inverse() * frame(&self.dh.rows[..=i]);
            let rotation: Matrix3<f64> = new_from_old.rotation.to_rotation_matrix().into_inner();
            let com = new_from_old * nalgebra::Point3::from(link.com_m);
            let inertia = Matrix3::from(link.inertia_kg_m2).transpose();
            let inertia = rotation * inertia * rotation.transpose();
            let inertia = 0.5 * (inertia + inertia.transpose());
            link.com_m = com.coords.into();
            link.inertia_kg_m2 = inertia.transpose().into();
        }
        // Frame i is that of joint i. Its place along nearly parallel axes is arbitrary; the joint's is
        // that of the table.
        model.joint_from_origin_m = (0..self.dof)
            .map(|i| {
                let new_from_old = frame(&model.dh.rows[..i]).inverse() * frame(&self.dh.rows[..i]);
                new_from_old.translation.z
            })
            .collect();
        model
            .notes
            .push("Corrected by the factory calibration of one arm.".to_owned());
        let (table, measured) = (Chain::new(self)?, Chain::new(&model)?);
        let zero = vec![0.0; self.dof];
        for q in [&self.home_rad, &zero] {
            let place = |chain: &Chain| chain.base_from_flange(q).translation.vector;
            let distance_m = (place(&table) - place(&measured)).norm();
            if distance_m > DISTANCE_MAX_M {
                return Err(CalibrationError::OtherArm {
                    model: self.name.clone(),
                    distance_m,
                });
            }
        }
        Ok(model)
    }
}

/// Frame at the end of `rows` in the first frame, with every joint at zero.
fn frame(rows: &[DhRow]) -> Isometry3<f64> {
    rows.iter().fold(Isometry3::identity(), |frame, row| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), row.theta_offset_rad);
        let twist = Rotation3::from_axis_angle(&Vector3::x_axis(), row.alpha_rad);
        frame
            * UnitQuaternion::from_rotation_matrix(&turn)
            * Translation3::new(row.a_m, 0.0, row.d_m)
            * UnitQuaternion::from_rotation_matrix(&twist)
    })
}

/// The list `key` in the section of the corrections.
fn list(text: &str, key: &'static str, dof: usize) -> Result<Vec<f64>, CalibrationError> {
    let mut inside = false;
    let mut found = None;
    for (i, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            inside = name.trim() == SECTION;
            continue;
        }
        let Some((name, value)) = line.split_once('=').filter(|_| inside) else {
            continue;
        };
        let (name, value) = (name.trim(), value.trim());
        if name == "calibration_status" && value != LINEARISED {
            return Err(CalibrationError::Status {
                line: i + 1,
                value: value.to_owned(),
            });
        }
        if name == key {
            found = Some((i + 1, value));
        }
    }
    let (line, value) = found.ok_or(CalibrationError::Missing { key })?;
    let numbers: Option<Vec<f64>> = value
        .strip_prefix('[')
        .and_then(|v| v.strip_suffix(']'))
        .map(|v| v.trim().trim_end_matches(','))
        .and_then(|v| v.split(',').map(|n| n.trim().parse().ok()).collect());
    numbers
        .filter(|n| n.len() == dof && n.iter().all(|n| n.is_finite()))
        .ok_or_else(|| CalibrationError::List {
            line,
            key,
            value: value.to_owned(),
            dof,
        })
}

#[cfg(test)]
mod tests {
    use nalgebra::SVector;

    use super::*;
    use crate::Arm;

    fn conf(theta: &str, a: &str, d: &str, alpha: &str) -> String {
        format!(
            "[mounting]\n# as written by the controller\ncalibration_status = 2 # 2 == Linearised\n\
             delta_theta = [ {theta} ]\ndelta_a = [ {a} ]\ndelta_d = [ {d} ]\n\
             delta_alpha = [ {alpha} ]\njoint_checksum = [ 0x1, 0x2, 0x3, 0x4, 0x5, 0x6 ]\n\
             [other]\ndelta_a = [ 9, 9, 9, 9, 9, 9 ]\n"
        )
    }

    const ZEROS: &str = "0, 0, 0, 0, 0, 0";

    fn poses() -> Vec<SVector<f64, 6>> {
        let mut q = SVector::<f64, 6>::new(0.3, -1.1, 1.4, -0.9, 1.2, 0.5);
        (0..20)
            .map(|k| {
                q = q.map(|x| (x * 1.7 + 0.31 * f64::from(k)).sin() * 2.0);
                q
            })
            .collect()
    }

    /// Parallel axes leave the place of a frame along them open: metres of `d` that cancel are the
    /// same arm, with the same gravity and inertia.
    #[test]
    fn metres_along_parallel_axes_change_nothing() {
        let table = ModelData::builtin("ur5e").unwrap();
        let text = conf(ZEROS, ZEROS, "0, -6.3, 8.6, -2.3, 0, 0", ZEROS);
        let (was, is) = (
            Arm::<6>::new(&table).unwrap(),
            Arm::<6>::new(&table.calibrated(&text).unwrap()).unwrap(),
        );
        for q in poses() {
            let moved =
                was.base_from_flange(&q).translation() - is.base_from_flange(&q).translation();
            assert!(moved.norm() < 1e-9, "{moved}");
            assert!((was.gravity(&q) - is.gravity(&q)).norm() < 1e-9);
            assert!((was.mass_matrix(&q) - is.mass_matrix(&q)).norm() < 1e-8);
        }
    }

    /// The frames that are shown lie in the joints: within millimetres of those of the table, and
    /// with the same flange.
    #[test]
    fn the_frames_of_a_calibrated_arm_lie_in_its_joints() {
        let table = ModelData::builtin("ur5e").unwrap();
        let text = conf(
            "1e-4, -4e-4, 6e-4, -3e-4, 2e-5, -4e-5",
            "4e-5, 4e-4, 1.5e-3, 4e-5, 5e-5, 0",
            "2e-4, -6.3, 8.6, -2.2996, -7e-5, 4e-4",
            "1e-4, 2.3e-4, 1.2e-4, 4.7e-4, -2.3e-4, 0",
        );
        let measured = table.calibrated(&text).unwrap();
        let (was, is) = (Chain::new(&table).unwrap(), Chain::new(&measured).unwrap());
        let arm = Arm::<6>::new(&measured).unwrap();
        for q in poses() {
            let (mut table, mut frame) = (Isometry3::identity(), Isometry3::identity());
            for i in 0..6 {
                table *= was.parent_from_link(i, q[i]);
                frame *= is.parent_from_link(i, q[i]);
                let apart = (table.translation.vector - frame.translation.vector).norm();
                assert!(apart < 0.01, "link {i}: {apart} m");
            }
            let flange = is.base_from_flange(q.as_slice());
            let expected = arm.base_from_flange(&q);
            assert!((flange.translation.vector - expected.translation()).norm() < 1e-9);
        }
    }

    #[test]
    fn corrections_move_the_flange_and_leave_the_bodies_in_place() {
        let table = ModelData::builtin("ur10e").unwrap();
        let text = conf(
            "1e-4, -4e-4, 6e-4, -3e-4, 2e-5, -4e-5",
            "4e-5, 4e-4, 1.5e-3, 4e-5, 5e-5, 0",
            "2e-4, -1.2, 0.9, 0.3004, -7e-5, 4e-4",
            "1e-4, 2.3e-4, 1.2e-4, 4.7e-4, -2.3e-4, 0",
        );
        let measured = table.calibrated(&text).unwrap();
        assert_eq!(measured.dh.rows[2].a_m, table.dh.rows[2].a_m + 1.5e-3);
        let (was, is) = (
            Arm::<6>::new(&table).unwrap(),
            Arm::<6>::new(&measured).unwrap(),
        );
        let home = was.home();
        let moved =
            was.base_from_flange(&home).translation() - is.base_from_flange(&home).translation();
        assert!((1e-4..0.05).contains(&moved.norm()), "{moved}");
        let share = (was.gravity(&home) - is.gravity(&home)).norm() / was.gravity(&home).norm();
        assert!(share < 0.02, "{share}");
    }

    #[test]
    fn what_is_wrong_is_named() {
        let arm = ModelData::builtin("ur5e").unwrap();
        let error = |text: &str| arm.calibrated(text).unwrap_err().to_string();
        assert!(error("").contains("`delta_theta` is missing in section [mounting]"));
        let short = conf("0, 0, 0", ZEROS, ZEROS, ZEROS);
        assert!(error(&short).contains("line 4: `delta_theta` = [ 0, 0, 0 ]: must be a list of 6"));
        let nan = conf(ZEROS, "NaN, 0, 0, 0, 0, 0", ZEROS, ZEROS);
        assert!(error(&nan).contains("`delta_a`"));
        let early = conf(ZEROS, ZEROS, ZEROS, ZEROS).replace("= 2 #", "= 1 #");
        assert!(error(&early).contains("line 3: `calibration_status` = 1"));
        let far = conf(ZEROS, "0.3, 0, 0, 0, 0, 0", ZEROS, ZEROS);
        assert!(error(&far).contains("the file is that of another arm"));
        let panda = ModelData::builtin("panda").unwrap();
        let refused = panda.calibrated(&short).unwrap_err();
        assert!(
            refused
                .to_string()
                .contains("`panda` has a modified DH table")
        );
    }
}
