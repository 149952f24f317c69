//! Mass, centre of mass and mounting of the payload from readings in static poses.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3, Vector4};
use tangent_mechanics::{Sensor, Wrench};

use crate::Payload;

/// Smallest number of poses: four unknowns per force row, and some redundancy for a check.
pub const POSES_MIN: usize = 6;

/// Rotation between the first and the last pose below which they count as the same pose, rad.
const SAME_POSE_RAD: f64 = 0.01;

/// Smallest spread of the gravity directions: standard deviation along the axis of least variation,
/// as a share of gravity.
const SPREAD_MIN: f64 = 0.15;

/// A pose of the arm at rest and without contact, with the sensor's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaticPose {
    /// Rotation from flange axes to base axes, as measured.
    pub base_from_flange: UnitQuaternion<f64>,
    /// Mean reading, before tare: N and Nm, sensor axes.
    pub wrench: Wrench<Sensor>,
}

/// Payload and sensor parameters identified from static poses.
#[derive(Clone, Debug, PartialEq)]
pub struct IdentifiedPayload {
    /// Mass and centre of mass. Readings at rest do not contain the inertia.
    pub payload: Payload,
    /// Rotation from sensor axes to flange axes.
    pub flange_from_sensor: UnitQuaternion<f64>,
    /// Standard error of the mass, kg: jackknife over the poses. Infinite if a fit without one of
    /// the poses is not possible.
    pub mass_sd_kg: f64,
    /// Standard error of the centre of mass, per sensor axis, m: jackknife over the poses.
    pub com_sd_m: [f64; 3],
    /// The sensor's zero over these poses, N and Nm.
    pub bias: Wrench<Sensor>,
    /// Deviation of the free 3×3 fit from a rotation times a mass: spread of its singular values,
    /// relative. A large value means wrong units, a wrong calibration, or contact with the tool.
    pub anisotropy: f64,
    /// Root mean square error of the force that a fit of all other poses predicts for each pose, N.
    pub left_out_force_rms_n: f64,
    /// Root mean square error of the torque that a fit of all other poses predicts for each pose,
    /// Nm.
    pub left_out_torque_rms_nm: f64,
    /// Reading of the last pose minus that of the first: the drift in between. `None` if they are
    /// not the same pose.
    pub drift: Option<Wrench<Sensor>>,
}

/// Why the payload cannot be identified from the poses.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum IdentificationError {
    /// There are too few poses.
    #[error(
        "{found} poses are too few: take at least {POSES_MIN}, well spread, and the first one again at the end"
    )]
    TooFew {
        /// Number of poses given.
        found: usize,
    },
    /// A reading or an orientation is NaN or infinite.
    #[error("pose {} has a number that is not finite", .index + 1)]
    NotFinite {
        /// Index of the pose, from 0.
        index: usize,
    },
    /// The directions of gravity vary too little along some axis.
    #[error(
        "the poses are too much alike: along one axis gravity varies by only {spread:.3} of its magnitude, {SPREAD_MIN} \
         is needed; turn the tool up, down and to all sides"
    )]
    TooMuchAlike {
        /// Standard deviation along the axis of least variation, as a share of gravity.
        spread: f64,
    },
    /// The fit is a reflection.
    #[error(
        "the readings fit a mirrored sensor (determinant {determinant:.3}): an axis of the sensor has the wrong sign, or \
         the poses are of another arm"
    )]
    Mirrored {
        /// Determinant of the orthogonal part of the free 3×3 fit.
        determinant: f64,
    },
    /// The mass is too small to be measured.
    #[error("the payload weighs {mass_kg:.4} kg, too little to be measured")]
    NoMass {
        /// Mass of the fit, kg.
        mass_kg: f64,
    },
}

/// Parameters of one fit.
struct PayloadFit {
    mass: f64,
    sensor_from_flange: Rotation3<f64>,
    com: Vector3<f64>,
    bias: Wrench<Sensor>,
    anisotropy: f64,
}

impl PayloadFit {
    /// Reading expected with gravity `gravity` in flange axes, m/s².
    fn predict(&self, gravity: &Vector3<f64>) -> Wrench<Sensor> {
        let force = self.sensor_from_flange * gravity * self.mass;
        self.bias + Wrench::new(force, self.com.cross(&force))
    }
}

/// Identifies the payload and the mounting of the sensor; `gravity_in_base` in m/s².
///
/// Fits `force = bias + G g(R)` with a free 3×3 matrix `G`. The rotation is its polar
/// decomposition, and the mass its scale. The centre of mass follows from the torques.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Sensor, Wrench};
/// use tangent_sensing::{Payload, StaticPose, identify_payload};
///
/// let truth = Payload { mass_kg: 1.2, com_in_sensor_m: [0.01, 0.0, 0.05], ..Payload::default() };
/// let gravity = Vector3::new(0.0, 0.0, -9.81);
/// let turns = [[0.0, 0.0], [1.5, 0.0], [-1.5, 0.0], [0.0, 1.5], [0.0, -1.5], [3.0, 0.0]];
/// let poses = turns.map(|[roll, pitch]| {
///     let base_from_flange = UnitQuaternion::from_euler_angles(roll, pitch, 0.0);
///     let in_sensor = base_from_flange.inverse() * gravity;
///     StaticPose { base_from_flange, wrench: truth.wrench(&in_sensor, None) }
/// });
/// let found = identify_payload(&poses, &gravity)?;
/// assert!((found.payload.mass_kg - 1.2).abs() < 1e-9);
/// assert!((found.payload.com_in_sensor_m[2] - 0.05).abs() < 1e-9);
/// # let _: Wrench<Sensor> = found.bias;
/// # Ok::<(), tangent_sensing::IdentificationError>(())
/// ```
///
/// # Errors
/// Too few poses, poses too much alike, numbers that are not finite, a mirrored sensor, or no mass.
pub fn identify_payload(
    poses: &[StaticPose],
    gravity_in_base: &Vector3<f64>,
) -> Result<IdentifiedPayload, IdentificationError> {
    if poses.len() < POSES_MIN {
        return Err(IdentificationError::TooFew { found: poses.len() });
    }
    for (index, pose) in poses.iter().enumerate() {
        if !pose.wrench.is_finite() || !pose.base_from_flange.coords.iter().all(|x| x.is_finite()) {
            return Err(IdentificationError::NotFinite { index });
        }
    }
    let rows: Vec<(Vector3<f64>, Wrench<Sensor>)> = poses
        .iter()
        .map(|pose| {
            (
                pose.base_from_flange
                    .inverse_transform_vector(gravity_in_base),
                pose.wrench,
            )
        })
        .collect();
    let all = fit(rows.iter())?;

    let (mut force, mut torque, mut n) = (0.0, 0.0, 0.0);
    let (mut sum, mut squares) = (Vector4::zeros(), Vector4::zeros());
    for (left_out, (gravity, reading)) in rows.iter().enumerate() {
        let others = rows
            .iter()
            .enumerate()
            .filter(|(i, _)| *i != left_out)
            .map(|(_, row)| row);
        // Without this pose, the others are too much alike for a fit: the pose does not enter the
        // errors.
        let Ok(fit) = fit(others) else { continue };
        let residual = *reading - fit.predict(gravity);
        force += residual.force.norm_squared();
        torque += residual.torque.norm_squared();
        n += 1.0;
        // Relative to the fit of all poses, so that large values do not cancel the digits of the
        // scatter.
        let off = (fit.com - all.com).insert_row(0, fit.mass - all.mass);
        sum += off;
        squares += off.component_mul(&off);
    }
    // Each fit lacks one pose: their scatter, times n - 1, is the variance of the fit of all.
    let sd = if n == rows.len() as f64 {
        let variance = (squares - sum.component_mul(&sum) / n) * ((n - 1.0) / n);
        variance.map(|v| v.max(0.0).sqrt())
    } else {
        Vector4::repeat(f64::INFINITY)
    };
    let rms = |sum: f64| {
        if n > 0.0 {
            (sum / n).sqrt()
        } else {
            f64::INFINITY
        }
    };

    let (first, last) = (&poses[0], &poses[poses.len() - 1]);
    let came_back = first.base_from_flange.angle_to(&last.base_from_flange) < SAME_POSE_RAD;
    Ok(IdentifiedPayload {
        payload: Payload {
            mass_kg: all.mass,
            com_in_sensor_m: all.com.into(),
            inertia_kg_m2: [0.0; 3],
        },
        flange_from_sensor: UnitQuaternion::from_rotation_matrix(&all.sensor_from_flange.inverse()),
        mass_sd_kg: sd[0],
        com_sd_m: [sd[1], sd[2], sd[3]],
        bias: all.bias,
        anisotropy: all.anisotropy,
        left_out_force_rms_n: rms(force),
        left_out_torque_rms_nm: rms(torque),
        drift: came_back.then(|| last.wrench - first.wrench),
    })
}

fn fit<'a>(
    rows: impl Iterator<Item = &'a (Vector3<f64>, Wrench<Sensor>)> + Clone,
) -> Result<PayloadFit, IdentificationError> {
    let n = rows.clone().count() as f64;
    let mean_g = rows.clone().map(|(g, _)| *g).sum::<Vector3<f64>>() / n;
    let mean_f = rows.clone().map(|(_, w)| w.force).sum::<Vector3<f64>>() / n;

    // Centred normal equations: the bias drops out.
    let mut gg = Matrix3::zeros();
    let mut fg = Matrix3::zeros();
    for (g, w) in rows.clone() {
        let g = g - mean_g;
        gg += g * g.transpose();
        fg += (w.force - mean_f) * g.transpose();
    }
    let scale = rows.clone().map(|(g, _)| g.norm()).sum::<f64>() / n;
    let least = gg.symmetric_eigenvalues().min().max(0.0);
    let spread = (least / n).sqrt() / scale;
    let inverse = gg.try_inverse().filter(|_| spread >= SPREAD_MIN);
    let Some(inverse) = inverse else {
        return Err(IdentificationError::TooMuchAlike { spread });
    };
    let matrix = fg * inverse;

    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(IdentificationError::NoMass { mass_kg: 0.0 });
    };
    let mass = svd.singular_values.sum() / 3.0;
    if mass < 1e-3 {
        return Err(IdentificationError::NoMass { mass_kg: mass });
    }
    let determinant = (u * v_t).determinant();
    if determinant < 0.0 {
        return Err(IdentificationError::Mirrored { determinant });
    }
    let anisotropy = (svd.singular_values.max() - svd.singular_values.min()) / mass;
    let sensor_from_flange = Rotation3::from_matrix_unchecked(u * v_t);
    let force_bias = mean_f - sensor_from_flange * mean_g * mass;

    // torque = torque_bias + com × weight, linear in both.
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SVector::<f64, 6>::zeros();
    for (g, w) in rows {
        let weight = sensor_from_flange * g * mass;
        let mut row = SMatrix::<f64, 3, 6>::zeros();
        row.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        row.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-weight.cross_matrix());
        normal += row.transpose() * row;
        right += row.transpose() * w.torque;
    }
    let Some(solution) = normal.cholesky().map(|c| c.solve(&right)) else {
        return Err(IdentificationError::TooMuchAlike { spread });
    };
    Ok(PayloadFit {
        mass,
        sensor_from_flange,
        com: solution.fixed_rows::<3>(3).into_owned(),
        bias: Wrench::new(force_bias, solution.fixed_rows::<3>(0).into_owned()),
        anisotropy,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.80665);

    struct Truth {
        payload: Payload,
        flange_from_sensor: UnitQuaternion<f64>,
        bias: Wrench<Sensor>,
    }

    fn truth() -> Truth {
        Truth {
            payload: Payload {
                mass_kg: 0.437,
                com_in_sensor_m: [0.003, -0.006, 0.052],
                inertia_kg_m2: [0.0; 3],
            },
            flange_from_sensor: UnitQuaternion::new(Vector3::new(0.02, -0.01, 0.8)),
            bias: Wrench::new(Vector3::new(2.0, -1.0, 4.0), Vector3::new(0.1, -0.2, 0.05)),
        }
    }

    impl Truth {
        fn read(&self, base_from_flange: UnitQuaternion<f64>) -> StaticPose {
            let base_from_sensor = base_from_flange * self.flange_from_sensor;
            let gravity = base_from_sensor.inverse_transform_vector(&GRAVITY);
            StaticPose {
                base_from_flange,
                wrench: self.payload.wrench(&gravity, None) + self.bias,
            }
        }
    }

    fn poses() -> Vec<UnitQuaternion<f64>> {
        let quarter = std::f64::consts::FRAC_PI_2;
        [
            [0.0, 0.0, 0.0],
            [quarter, 0.0, 0.0],
            [-quarter, 0.3, 0.0],
            [0.0, quarter, 0.2],
            [0.1, -quarter, 0.0],
            [2.8, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [-0.8, 0.7, 1.0],
            [0.0, 0.0, 0.0],
        ]
        .map(|v| UnitQuaternion::new(v.into()))
        .to_vec()
    }

    #[test]
    fn exact_readings_give_the_payload_back() {
        let truth = truth();
        let readings: Vec<_> = poses().into_iter().map(|p| truth.read(p)).collect();
        let found = identify_payload(&readings, &GRAVITY).unwrap();
        assert!((found.payload.mass_kg - 0.437).abs() < 1e-12);
        let com = Vector3::from(found.payload.com_in_sensor_m)
            - Vector3::from(truth.payload.com_in_sensor_m);
        assert!(com.norm() < 1e-12);
        assert!(found.flange_from_sensor.angle_to(&truth.flange_from_sensor) < 1e-7);
        assert!((found.bias - truth.bias).vector().norm() < 1e-11);
        assert!(found.left_out_force_rms_n < 1e-11 && found.anisotropy < 1e-12);
        assert!(found.mass_sd_kg < 1e-12 && found.com_sd_m.iter().all(|sd| *sd < 1e-12));
        assert_eq!(found.drift, Some(Wrench::zero()));
    }

    proptest! {
        #[test]
        fn readings_of_a_gamma_meet_the_aim(noise in prop::collection::vec(-1.0f64..1.0, 54)) {
            // Half a resolution step either way, as means of many quantised readings are at worst.
            let truth = truth();
            let mut noise = noise.into_iter();
            let mut draw = |size: f64| Vector3::from_fn(|_, _| noise.next().unwrap() * size);
            let readings: Vec<_> = poses()
                .into_iter()
                .map(|p| {
                    let mut pose = truth.read(p);
                    pose.wrench.force += draw(0.0125);
                    pose.wrench.torque += draw(0.000_625);
                    pose
                })
                .collect();
            let found = identify_payload(&readings, &GRAVITY).unwrap();
            prop_assert!((found.payload.mass_kg - 0.437).abs() < 0.005);
            let com = Vector3::from(found.payload.com_in_sensor_m) - Vector3::from(truth.payload.com_in_sensor_m);
            prop_assert!(com.amax() < 3e-4, "{com}");
            prop_assert!(found.left_out_force_rms_n < 0.07 && found.left_out_torque_rms_nm < 3e-3);
        }
    }

    /// Over many draws of noise, the errors are as large as the standard errors state.
    #[test]
    fn standard_errors_are_honest() {
        use rand::{RngExt, SeedableRng};
        let truth = truth();
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let (mut mass, mut com) = (0.0, 0.0);
        let draws = 400;
        for _ in 0..draws {
            let readings: Vec<_> = poses()
                .into_iter()
                .map(|p| {
                    let mut pose = truth.read(p);
                    pose.wrench.force += Vector3::from_fn(|_, _| random.random_range(-0.05..0.05));
                    pose.wrench.torque +=
                        Vector3::from_fn(|_, _| random.random_range(-0.002..0.002));
                    pose
                })
                .collect();
            let found = identify_payload(&readings, &GRAVITY).unwrap();
            mass += ((found.payload.mass_kg - 0.437) / found.mass_sd_kg).powi(2);
            let off = found.payload.com_in_sensor_m[0] - truth.payload.com_in_sensor_m[0];
            com += (off / found.com_sd_m[0]).powi(2);
        }
        // Rms of error over claimed error. A jackknife of nine poses is itself uncertain, and errs
        // to the safe side.
        for rms in [mass, com].map(|sum| (sum / f64::from(draws)).sqrt()) {
            assert!((0.5..1.6).contains(&rms), "{rms}");
        }
    }

    #[test]
    fn drift_between_first_and_last_is_shown() {
        let truth = truth();
        let mut readings: Vec<_> = poses().into_iter().map(|p| truth.read(p)).collect();
        readings[8].wrench.force.x += 0.1;
        let found = identify_payload(&readings, &GRAVITY).unwrap();
        assert!((found.drift.unwrap().force.x - 0.1).abs() < 1e-12);
        assert_eq!(
            identify_payload(&readings[..8], &GRAVITY).unwrap().drift,
            None
        );
    }

    #[test]
    fn what_cannot_be_identified_says_why() {
        let truth = truth();
        let readings: Vec<_> = poses().into_iter().map(|p| truth.read(p)).collect();
        let error = |poses: &[StaticPose]| identify_payload(poses, &GRAVITY).unwrap_err();
        assert_eq!(
            error(&readings[..5]),
            IdentificationError::TooFew { found: 5 }
        );
        let alike: Vec<_> = (0..8)
            .map(|i| {
                truth.read(UnitQuaternion::new(Vector3::new(
                    0.01 * f64::from(i),
                    0.0,
                    0.0,
                )))
            })
            .collect();
        assert!(matches!(
            error(&alike),
            IdentificationError::TooMuchAlike { .. }
        ));
        let mut mirrored = readings.clone();
        for pose in &mut mirrored {
            pose.wrench.force.x = -pose.wrench.force.x;
        }
        assert!(matches!(
            error(&mirrored),
            IdentificationError::Mirrored { .. }
        ));
        let mut broken = readings.clone();
        broken[3].wrench.torque.y = f64::NAN;
        assert_eq!(error(&broken), IdentificationError::NotFinite { index: 3 });
        assert_eq!(
            error(&broken).to_string(),
            "pose 4 has a number that is not finite"
        );
        for pose in &mut broken {
            pose.wrench = truth.bias;
        }
        assert!(matches!(error(&broken), IdentificationError::NoMass { .. }));
    }
}
