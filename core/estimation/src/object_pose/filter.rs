//! `object_pose`: an error-state filter for the object's pose that also calibrates the camera.
//!
//! A frame is processed with the arm's state and the object's pose at its exposure. The force gives
//! the normal, eqs. (18)-(22). The joints give the position of the tip, which lies on the surface;
//! this replaces eqs. (23)-(26). The compliance of the object and of the spot under the tip,
//! friction, the error of the tip's position and the tilt of the measured force are states.

use nalgebra::{Matrix6, SMatrix, SVector, Vector2, Vector3, Vector6};
use tangent_mechanics::{Base, Object, Pose, Twist};
use tangent_sensing::Validity;

use super::arm_history::{ArmHistory, ArmMoment};
use super::contact::{SlideTracker, Touch, TouchDetector};
use super::filter_measurements::{TipPose, expected_corner, touch_direction, touch_point};
use super::filter_state::{
    CAMERA_POSITION, CAMERA_TURN, COMPLIANCE, FOCAL, FilterState, LOCAL, STATES, TURN,
};
use super::{
    CORNERS, CalibrationEstimate, CameraFrame, CameraModel, FrameCounts, ImplicitSurface,
    Measurements, ObjectEstimate, ObjectPoseConfig, ObjectPoseEstimator, ObjectSample,
    PlanarTarget,
};
use crate::EstimationError;

/// The consistent estimator of an object's pose.
pub struct ObjectPose {
    config: ObjectPoseConfig,
    stated: CameraModel,
    surface: Box<dyn ImplicitSurface>,
    target: PlanarTarget,
    corners: [Vector3<f64>; CORNERS],
    state: Option<FilterState>,
    /// Time of `state`, s.
    time_s: f64,
    history: ArmHistory,
    detector: TouchDetector,
    slide: SlideTracker,
    last_frame_s: f64,
    last_used_s: f64,
    refused_in_a_row: u32,
    counts: FrameCounts,
    covariance: Matrix6<f64>,
    yielding_n: Vector3<f64>,
    force_n: f64,
}

impl ObjectPose {
    /// Estimator for a shape that can be named in a file.
    ///
    /// # Errors
    /// A setting is out of its range.
    pub fn new(config: &ObjectPoseConfig, camera: &CameraModel) -> Result<Self, EstimationError> {
        Self::with_surface(config, camera, Box::new(config.target.surface))
    }

    /// Estimator for any surface; the one named in `config` is not used.
    ///
    /// # Errors
    /// A setting is out of its range.
    pub fn with_surface(
        config: &ObjectPoseConfig,
        camera: &CameraModel,
        surface: Box<dyn ImplicitSurface>,
    ) -> Result<Self, EstimationError> {
        config.check()?;
        let corners = config.target.corners();
        Ok(Self {
            target: PlanarTarget::new(&corners).ok_or(EstimationError::CollinearCorners)?,
            config: config.clone(),
            stated: *camera,
            surface,
            corners,
            state: None,
            time_s: 0.0,
            history: ArmHistory::default(),
            detector: TouchDetector::default(),
            slide: SlideTracker::default(),
            last_frame_s: f64::NEG_INFINITY,
            last_used_s: f64::NEG_INFINITY,
            refused_in_a_row: 0,
            counts: FrameCounts::default(),
            covariance: Matrix6::identity(),
            yielding_n: Vector3::zeros(),
            force_n: 0.0,
        })
    }

    fn advance(&mut self, time_s: f64) {
        if let Some(state) = &mut self.state {
            let dt = time_s - self.time_s;
            if dt > 0.0 {
                state.predict(&self.config, dt);
                self.time_s = time_s;
            }
        } else {
            self.time_s = time_s;
        }
    }

    fn see(&mut self, frame: &CameraFrame, now_s: f64) {
        let in_order = frame.time_s > self.last_frame_s;
        if !in_order {
            self.counts.out_of_order += 1;
            return;
        }
        let Some(moment) = self.history.at(frame.time_s) else {
            self.counts.out_of_time += 1;
            return;
        };
        self.last_frame_s = frame.time_s;
        if self.state.is_none() {
            if self.start(frame, &moment, now_s) {
                self.counts.used += 1;
                self.last_used_s = frame.time_s;
            } else {
                self.counts.starts_refused += 1;
            }
            return;
        }
        self.advance(now_s);
        let noise = self.state.as_ref().map_or(0.0, |state| {
            corner_variance(&self.config, &self.stated, state)
        });
        let variance = Vector2::repeat(noise);
        let mut used = 0;
        for (corner, seen) in self.corners.iter().zip(&frame.corners) {
            let (Some(seen), Some(state)) = (seen, &mut self.state) else {
                continue;
            };
            let age = now_s - frame.time_s;
            let pixel = self.stated.normalised(&seen.pixel_px);
            let accepted =
                expected_corner(state, &moment, age, corner).is_some_and(|(expected, columns)| {
                    state.correct(
                        &columns,
                        &(pixel - expected),
                        &variance,
                        self.config.gate_sd,
                    )
                });
            if accepted {
                used += 1;
            } else {
                self.counts.corners_refused += 1;
            }
        }
        if used > 0 {
            self.counts.used += 1;
            self.last_used_s = frame.time_s;
            self.refused_in_a_row = 0;
        } else if frame.corners.iter().any(Option::is_some) {
            self.refused_in_a_row += 1;
            // In contact, the force and joints are more reliable than the camera.
            if self.refused_in_a_row >= self.config.restart_frames && !self.detector.touching() {
                self.state = None;
                self.refused_in_a_row = 0;
                self.counts.restarts += 1;
            }
        }
    }

    /// Computes the first pose: a point to linearise at, then an update with all corners, given the
    /// errors of the calibration. All corners use one linearisation: a single corner does not
    /// determine the tilt, which could move far away.
    fn start(&mut self, frame: &CameraFrame, moment: &ArmMoment, now_s: f64) -> bool {
        let mut image = [Vector2::zeros(); CORNERS];
        for (slot, corner) in image.iter_mut().zip(&frame.corners) {
            let Some(corner) = corner else {
                return false;
            };
            *slot = self.stated.normalised(&corner.pixel_px);
        }
        let rms_max = self.config.start_rms_max_px / self.stated.focal_px;
        let Ok(camera_from_object) = self.target.pose(&image, rms_max) else {
            return false;
        };
        let rest = moment.base_from_flange * self.stated.flange_from_camera * camera_from_object;
        let mut state = FilterState::new(&self.config, &self.stated, rest);
        self.time_s = now_s;
        let variance = Vector2::repeat(corner_variance(&self.config, &self.stated, &state));
        let mut change = SVector::<f64, STATES>::zeros();
        for (corner, seen) in self.corners.iter().zip(&image) {
            let Some((expected, columns)) = expected_corner(&state, moment, 0.0, corner) else {
                return false;
            };
            let innovation = seen - expected - columns.tr_mul(&change);
            let Some(step) = state.change(&columns, &innovation, &variance, f64::INFINITY) else {
                return false;
            };
            change += step;
        }
        state.apply(&change);
        self.state = Some(state);
        true
    }

    /// Updates with force and joints, using the arm's state at the time of the wrench.
    fn feel(&mut self, touch: &Touch, tip: &TipPose, now_s: f64) {
        let first = self.slide.last_s().is_none();
        let sliding = self.slide.step(now_s, &tip.position);
        self.advance(now_s);
        let Some(state) = &mut self.state else {
            return;
        };
        let noise = &self.config.contact;
        touch_point(state, &*self.surface, touch, tip, noise.tip_sd_m);
        let mut sd = noise
            .force_sd_n
            .hypot(noise.direction_sd_rad * touch.force_n)
            / touch.force_n;
        if noise.friction_sd > 0.0 {
            // At rest, the direction of friction is unknown and constant: another update would only
            // repeat the first.
            if sliding.is_none() && !first {
                return;
            }
            // While sliding, friction is a state, but it varies over the surface.
            let left = if sliding.is_some() { 0.1 } else { 1.0 };
            sd = sd.hypot(left * noise.friction_sd);
        }
        touch_direction(state, &*self.surface, touch, tip, sliding, sd);
    }

    fn normal(&self, tip: &Vector3<f64>, fallback: &Vector3<f64>) -> Vector3<f64> {
        self.state.as_ref().map_or(*fallback, |state| {
            let in_object = state.rest.inverse().transform_point(tip);
            state.rest.rotate(&self.surface.normal(&in_object))
        })
    }

    /// Computes the published covariance: that of the object's pose including its deflection.
    fn refresh_covariance(&mut self) {
        let Some(state) = &self.state else {
            return;
        };
        let mut map = SMatrix::<f64, 6, STATES>::zeros();
        map.fixed_view_mut::<6, 6>(0, 0).fill_with_identity();
        let yielded = self.yielding_n * state.compliance;
        map.fixed_view_mut::<3, 3>(0, TURN)
            .copy_from(&yielded.cross_matrix());
        map.fixed_view_mut::<3, 1>(0, COMPLIANCE)
            .copy_from(&-self.yielding_n);
        self.covariance = map * state.covariance * map.transpose() + self.arm_covariance();
    }

    /// Covariance of the object's pose from the arm's own errors, which no measurement shows.
    fn arm_covariance(&self) -> Matrix6<f64> {
        let prior = &self.config.prior;
        let (position, turn) = (prior.arm_position_sd_m, prior.arm_turn_sd_rad);
        Matrix6::from_diagonal(&Vector6::from_fn(|i, _| {
            if i < 3 {
                position * position
            } else {
                turn * turn
            }
        }))
    }

    /// Squared error of the filter's own state, divided by covariance and degrees of freedom, to
    /// assess consistency. The reference is the object without load and the true camera.
    pub fn nees_per_dof(&self, rest: &Pose<Base, Object>, camera: &CameraModel) -> Option<f64> {
        let state = self.state.as_ref()?;
        let mut error = SVector::<f64, 15>::zeros();
        let turn = |a: &nalgebra::UnitQuaternion<f64>, b: &nalgebra::UnitQuaternion<f64>| {
            (a * b.inverse()).scaled_axis()
        };
        let (seen, truth) = (&state.flange_from_camera, &camera.flange_from_camera);
        error
            .fixed_rows_mut::<3>(0)
            .copy_from(&(rest.translation() - state.rest.translation()));
        error
            .fixed_rows_mut::<3>(3)
            .copy_from(&turn(&rest.rotation(), &state.rest.rotation()));
        error
            .fixed_rows_mut::<3>(6)
            .copy_from(&(truth.translation() - seen.translation()));
        error
            .fixed_rows_mut::<3>(9)
            .copy_from(&turn(&truth.rotation(), &seen.rotation()));
        error[12] = camera.focal_px / self.stated.focal_px - state.focal;
        let principal = (camera.principal_px - self.stated.principal_px) / self.stated.focal_px
            - state.principal;
        error.fixed_rows_mut::<2>(13).copy_from(&principal);
        let index = |i: usize| if i < 6 { i } else { i + CAMERA_POSITION - 6 };
        let mut covariance =
            SMatrix::<f64, 15, 15>::from_fn(|i, j| state.covariance[(index(i), index(j))]);
        let mut pose = covariance.fixed_view_mut::<6, 6>(0, 0);
        pose += self.arm_covariance();
        let solved = covariance.cholesky()?.solve(&error);
        Some(error.dot(&solved) / 15.0)
    }
}

impl ObjectPoseEstimator for ObjectPose {
    fn name(&self) -> &'static str {
        "object_pose"
    }

    fn update(&mut self, sample: &ObjectSample) -> ObjectEstimate {
        if !sample.is_placed() {
            return ObjectEstimate::invalid(Validity::NotFinite);
        }
        let now = sample.time_s;
        let tip_now = sample.base_from_tool.translation();
        let normal = self.normal(&tip_now, &-sample.base_from_tool.z_axis());
        let touch = self.detector.step(&self.config.contact, sample, &normal);
        self.force_n = touch.map_or(0.0, |t| t.force_n * t.direction.dot(&normal));
        self.yielding_n = normal * self.force_n;
        self.history.push(ArmMoment {
            time_s: now,
            base_from_flange: sample.base_from_flange,
            yielding_n: self.yielding_n,
        });

        let mut changed = false;
        if let Some(frame) = &sample.frame {
            self.see(frame, now);
            changed = true;
        }
        let use_touch = self.config.measurements == Measurements::All;
        if let Some(touch) = touch.filter(|_| use_touch) {
            let due = self
                .slide
                .last_s()
                .is_none_or(|at| now - at >= self.config.contact.period_s - 1e-9);
            let flange_from_tool = sample.base_from_flange.inverse() * sample.base_from_tool;
            let then = self.history.at(now - sample.wrench_delay_s.max(0.0));
            if let (true, Some(then)) = (due, then) {
                let tool = then.base_from_flange * flange_from_tool;
                let tip = TipPose {
                    position: tool.translation(),
                    flange: then.base_from_flange.rotation(),
                    tool: tool.rotation(),
                };
                self.feel(&touch, &tip, now);
                changed = true;
            }
        } else {
            self.slide = SlideTracker::default();
        }
        if changed {
            self.refresh_covariance();
        }

        let Some(state) = &self.state else {
            return ObjectEstimate::invalid(Validity::Missing);
        };
        let ahead = state.rest_at(now - self.time_s);
        let yielded = self.yielding_n * state.compliance;
        let vision_age_s = now - self.last_used_s;
        ObjectEstimate {
            base_from_object: Pose::new(ahead.translation() - yielded, ahead.rotation()),
            twist: Twist::new(state.velocity, state.spin),
            covariance: self.covariance,
            validity: if vision_age_s > self.config.vision_patience_s {
                Validity::Stale
            } else {
                Validity::Valid
            },
            vision_age_s,
            in_contact: self.detector.touching(),
            force_n: self.force_n,
        }
    }

    fn reset(&mut self) {
        self.state = None;
        self.history.clear();
        self.detector = TouchDetector::default();
        self.slide = SlideTracker::default();
        self.last_frame_s = f64::NEG_INFINITY;
        self.last_used_s = f64::NEG_INFINITY;
        self.refused_in_a_row = 0;
        self.counts = FrameCounts::default();
    }

    fn frames(&self) -> FrameCounts {
        self.counts
    }

    fn calibration(&self) -> Option<CalibrationEstimate> {
        let state = self.state.as_ref()?;
        Some(CalibrationEstimate {
            camera: state.camera(&self.stated),
            covariance: state
                .covariance
                .fixed_view::<6, 6>(CAMERA_POSITION, CAMERA_POSITION)
                .into_owned(),
            focal_sd_share: state.covariance[(FOCAL, FOCAL)].sqrt(),
            compliance_m_per_n: (
                state.compliance,
                state.covariance[(COMPLIANCE, COMPLIANCE)].sqrt(),
            ),
            local_compliance_m_per_n: (state.local, state.covariance[(LOCAL, LOCAL)].sqrt()),
        })
    }

    fn nees(&self, rest: &Pose<Base, Object>, camera: &CameraModel) -> Option<f64> {
        self.nees_per_dof(rest, camera)
    }
}

/// Noise of a corner, including the error of the linear model while the camera's rotation is
/// uncertain by σ: up to σ²/2 of the ray, constant from frame to frame. Without this term the
/// filter becomes overconfident about errors of its linearisation.
fn corner_variance(config: &ObjectPoseConfig, camera: &CameraModel, state: &FilterState) -> f64 {
    let noise = config.corner_sd_px / camera.focal_px;
    let doubt: f64 = (CAMERA_TURN..CAMERA_TURN + 3)
        .map(|i| state.covariance[(i, i)])
        .sum();
    noise * noise + (0.5 * doubt * config.curvature_weight).powi(2)
}
