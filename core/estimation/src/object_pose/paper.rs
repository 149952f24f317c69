//! `object_pose_paper`: the extended Kalman filter as published. Constant velocity over 20 ms, eq.
//! (27); features, normal and offset as measurements, eq. (28), the last two in contact only; the
//! paper's Π and Q; the stated calibration is assumed to be exact.

use nalgebra::{Matrix6, SMatrix, SVector, Vector2, Vector3};
use tangent_mechanics::{Base, Camera, Object, Pose, Twist};
use tangent_sensing::Validity;

use super::arm_history::{ArmHistory, ArmMoment};
use super::contact::TouchDetector;
use super::paper_jacobians::{
    PoseVector, feature, feature_jacobian, normal, normal_jacobian, offset, offset_jacobian, pose,
    screw_from_rate, vector,
};
use super::{
    CORNERS, CalibrationEstimate, CameraFrame, CameraModel, FrameCounts, ImplicitSurface,
    Measurements, ObjectEstimate, ObjectPoseConfig, ObjectPoseEstimator, ObjectSample,
    PlanarTarget,
};
use crate::EstimationError;

const STATES: usize = 14;
const ROWS: usize = 12;

/// Period T_s, s.
const PERIOD_S: f64 = 0.02;
/// Variance Π of the features f, on the image plane, m².
const FEATURE_VARIANCE_M2: f64 = 625e-11;
/// Variance Π of the normal n_h.
const NORMAL_VARIANCE: f64 = 1e-5;
/// Variance Π of the offset δ_hq, m².
const OFFSET_VARIANCE_M2: f64 = 1e-6;
/// Diagonal of Q per step; the positions' entries are zero.
const Q: [f64; STATES] = [
    0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5e-11, 5e-11, 0.5e-11, 1e-9, 1e-8, 1e-8, 1e-8,
];
/// Uncertainty of the first pose, which the paper does not state: 1 cm and 3°, like its
/// calibration.
const START_POSITION_SD_M: f64 = 0.01;
const START_QUATERNION_SD: f64 = 0.026;
/// Standard deviation of the initial velocities, per second.
const START_RATE_SD: f64 = 1e-4;

/// The published filter.
pub struct ObjectPosePaper {
    config: ObjectPoseConfig,
    camera: CameraModel,
    surface: Box<dyn ImplicitSurface>,
    target: PlanarTarget,
    corners: [Vector3<f64>; CORNERS],
    /// State w = [x_o; ẋ_o] and its covariance.
    state: Option<(SVector<f64, STATES>, SMatrix<f64, STATES, STATES>)>,
    time_s: f64,
    history: ArmHistory,
    detector: TouchDetector,
    frame: Option<CameraFrame>,
    last_frame_s: f64,
    counts: FrameCounts,
    covariance: Matrix6<f64>,
}

/// One set of measurements, eq. (28). The row of a missing measurement is zero and has no effect.
struct Measured {
    innovation: SVector<f64, ROWS>,
    jacobian: SMatrix<f64, ROWS, 7>,
    variance: SVector<f64, ROWS>,
}

impl ObjectPosePaper {
    /// Estimator for a shape that can be named in a file.
    ///
    /// # Errors
    /// A setting is out of its range.
    pub fn new(config: &ObjectPoseConfig, camera: &CameraModel) -> Result<Self, EstimationError> {
        config.check()?;
        let corners = config.target.corners();
        Ok(Self {
            target: PlanarTarget::new(&corners).ok_or(EstimationError::CollinearCorners)?,
            config: config.clone(),
            camera: *camera,
            surface: Box::new(config.target.surface),
            corners,
            state: None,
            time_s: 0.0,
            history: ArmHistory::default(),
            detector: TouchDetector::default(),
            frame: None,
            last_frame_s: f64::NEG_INFINITY,
            counts: FrameCounts::default(),
            covariance: Matrix6::identity(),
        })
    }

    /// The image in metres, and the camera that took it.
    fn start(&mut self, frame: &CameraFrame, base_from_camera: &Pose<Base, Camera>) -> bool {
        let mut image = [Vector2::zeros(); CORNERS];
        for (slot, corner) in image.iter_mut().zip(&frame.corners) {
            let Some(corner) = corner else {
                return false;
            };
            *slot = self.camera.normalised(&corner.pixel_px);
        }
        let rms_max = self.config.start_rms_max_px / self.camera.focal_px;
        let Ok(found) = self.target.pose(&image, rms_max) else {
            return false;
        };
        let mut w = SVector::<f64, STATES>::zeros();
        w.fixed_rows_mut::<7>(0)
            .copy_from(&vector(&(*base_from_camera * found)));
        let sd = SVector::<f64, STATES>::from_fn(|i, _| match i {
            0..3 => START_POSITION_SD_M,
            3..7 => START_QUATERNION_SD,
            _ => START_RATE_SD,
        });
        self.state = Some((w, SMatrix::from_diagonal(&sd.component_mul(&sd))));
        true
    }

    fn step(&mut self, sample: &ObjectSample) {
        let frame = self.frame.take();
        let seen = frame.and_then(|frame| {
            let moment = self.history.at(frame.time_s);
            if moment.is_none() {
                self.counts.out_of_time += 1;
            }
            Some((
                frame,
                moment?.base_from_flange * self.camera.flange_from_camera,
            ))
        });
        if self.state.is_none() {
            let Some((frame, base_from_camera)) = &seen else {
                return;
            };
            if !self.start(frame, base_from_camera) {
                self.counts.starts_refused += 1;
                return;
            }
        }
        let Some((w, p)) = &mut self.state else {
            return;
        };
        // Eq. (27).
        let rate = w.fixed_rows::<7>(7).into_owned();
        let mut x = w.fixed_rows_mut::<7>(0);
        x += rate * PERIOD_S;
        for i in 0..7 {
            for j in 0..STATES {
                p[(i, j)] += PERIOD_S * p[(i + 7, j)];
            }
        }
        for i in 0..STATES {
            for j in 0..7 {
                p[(i, j)] += PERIOD_S * p[(i, j + 7)];
            }
        }
        for (i, q) in Q.iter().enumerate() {
            p[(i, i)] += q;
        }
        normalise(w);
        let x: PoseVector = w.fixed_rows::<7>(0).into_owned();
        let mut measured = Measured {
            innovation: SVector::zeros(),
            jacobian: SMatrix::zeros(),
            variance: SVector::repeat(1.0),
        };
        if let Some((frame, base_from_camera)) = &seen {
            let used = measured.see(&x, frame, base_from_camera, &self.camera, &self.corners);
            if used {
                self.counts.used += 1;
                self.last_frame_s = frame.time_s;
            }
        }
        let touch_normal = normal(&x, &*self.surface, &sample.base_from_tool.translation());
        let touch = self
            .detector
            .step(&self.config.contact, sample, &touch_normal);
        if let (Some(touch), Measurements::All) = (touch, self.config.measurements) {
            let tip = sample.base_from_tool.translation();
            measured.feel(&x, &touch.direction, &tip, &*self.surface);
        }
        correct(w, p, &measured);
        normalise(w);
        let l = screw_from_rate(&w.fixed_rows::<7>(0).into_owned());
        self.covariance = l * p.fixed_view::<7, 7>(0, 0) * l.transpose();
    }
}

impl Measured {
    fn see(
        &mut self,
        x: &PoseVector,
        frame: &CameraFrame,
        base_from_camera: &Pose<Base, Camera>,
        camera: &CameraModel,
        corners: &[Vector3<f64>; CORNERS],
    ) -> bool {
        let focal = camera.focal_m();
        let mut used = false;
        for (i, (point, seen)) in corners.iter().zip(&frame.corners).enumerate() {
            let expected = feature(x, base_from_camera, point, focal);
            let (Some(seen), Some(expected)) = (seen, expected) else {
                continue;
            };
            let innovation = camera.normalised(&seen.pixel_px) * focal - expected;
            if !innovation.iter().all(|x| x.is_finite()) {
                continue;
            }
            self.innovation
                .fixed_rows_mut::<2>(2 * i)
                .copy_from(&innovation);
            self.jacobian
                .fixed_view_mut::<2, 7>(2 * i, 0)
                .copy_from(&feature_jacobian(x, base_from_camera, point, focal));
            self.variance
                .fixed_rows_mut::<2>(2 * i)
                .fill(FEATURE_VARIANCE_M2);
            used = true;
        }
        used
    }

    fn feel(
        &mut self,
        x: &PoseVector,
        direction: &Vector3<f64>,
        tip: &Vector3<f64>,
        surface: &dyn ImplicitSurface,
    ) {
        self.innovation
            .fixed_rows_mut::<3>(8)
            .copy_from(&(direction - normal(x, surface, tip)));
        self.jacobian
            .fixed_view_mut::<3, 7>(8, 0)
            .copy_from(&normal_jacobian(x, surface, tip));
        self.variance.fixed_rows_mut::<3>(8).fill(NORMAL_VARIANCE);
        self.innovation[11] = direction.dot(tip) - offset(x, surface, tip);
        self.jacobian
            .fixed_view_mut::<1, 7>(11, 0)
            .copy_from(&offset_jacobian(x, surface, tip));
        self.variance[11] = OFFSET_VARIANCE_M2;
    }
}

fn normalise(w: &mut SVector<f64, STATES>) {
    let mut quaternion = w.fixed_rows_mut::<4>(3);
    let size = quaternion.norm();
    quaternion /= size;
}

fn correct(
    w: &mut SVector<f64, STATES>,
    p: &mut SMatrix<f64, STATES, STATES>,
    measured: &Measured,
) {
    // C = [∂g/∂x_o, O]
    let c = &measured.jacobian;
    let to_states = p.fixed_columns::<7>(0) * c.transpose();
    let mut total = c * to_states.fixed_rows::<7>(0);
    for i in 0..ROWS {
        total[(i, i)] += measured.variance[i];
    }
    let Some(factor) = total.cholesky() else {
        return;
    };
    let gain = factor.solve(&to_states.transpose()).transpose();
    *w += gain * measured.innovation;
    *p -= gain * to_states.transpose();
    *p = (*p + p.transpose()) * 0.5;
}

impl ObjectPoseEstimator for ObjectPosePaper {
    fn name(&self) -> &'static str {
        "object_pose_paper"
    }

    fn update(&mut self, sample: &ObjectSample) -> ObjectEstimate {
        if !sample.is_placed() {
            return ObjectEstimate::invalid(Validity::NotFinite);
        }
        let now = sample.time_s;
        self.history.push(ArmMoment {
            time_s: now,
            base_from_flange: sample.base_from_flange,
            yielding_n: Vector3::zeros(),
        });
        if let Some(frame) = sample.frame {
            let newest = self.frame.map_or(self.last_frame_s, |f| f.time_s);
            if frame.time_s > newest {
                self.frame = Some(frame);
            } else {
                self.counts.out_of_order += 1;
            }
        }
        if self.state.is_none() || now - self.time_s >= PERIOD_S - 1e-9 {
            self.time_s = now;
            self.step(sample);
        }
        let Some((w, _)) = &self.state else {
            return ObjectEstimate::invalid(Validity::Missing);
        };
        let x: PoseVector = w.fixed_rows::<7>(0).into_owned();
        let screw = screw_from_rate(&x) * w.fixed_rows::<7>(7);
        let tip = sample.base_from_tool.translation();
        let force = sample.base_from_tool.rotate(&sample.wrench.force);
        let vision_age_s = now - self.last_frame_s;
        ObjectEstimate {
            base_from_object: pose(&x),
            twist: Twist::from_vector(&screw),
            covariance: self.covariance,
            validity: if !screw.iter().all(|x| x.is_finite()) {
                Validity::NotFinite
            } else if vision_age_s > self.config.vision_patience_s {
                Validity::Stale
            } else {
                Validity::Valid
            },
            vision_age_s,
            in_contact: self.detector.touching(),
            force_n: force.dot(&normal(&x, &*self.surface, &tip)),
        }
    }

    fn reset(&mut self) {
        self.state = None;
        self.time_s = 0.0;
        self.history.clear();
        self.detector = TouchDetector::default();
        self.frame = None;
        self.last_frame_s = f64::NEG_INFINITY;
        self.counts = FrameCounts::default();
    }

    fn frames(&self) -> FrameCounts {
        self.counts
    }

    fn calibration(&self) -> Option<CalibrationEstimate> {
        None
    }

    fn nees(&self, _: &Pose<Base, Object>, _: &CameraModel) -> Option<f64> {
        None
    }
}
