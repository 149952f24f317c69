//! A camera on the flange that sees an object's corners: a pinhole model with a frame rate, a delay
//! and an error of its calibration.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_estimation::{CORNERS, CameraFrame, CameraModel, Corner};
use tangent_mechanics::{Base, Camera as CameraFrameAxes, Flange, Object, Pose};
use tangent_sensing::{GreyImage, TargetDetector, TargetDetectorError};

use super::target_image::{self, ImageConfig};
use crate::pose_config::PoseConfig;
use crate::true_value::True;

/// Largest number of frames in transit at once.
const FRAMES_MAX: usize = 16;

/// Source of the corners.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureSource {
    /// Projection of the true corners, with white noise: fast.
    #[default]
    Projection,
    /// Detection in a rendered image.
    Image,
}

/// The `[plant.camera]` table. The estimator knows the calibration stated here; the true one
/// differs from it by errors drawn from the seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Frames per second; 0 for no camera.
    pub rate_hz: f64,
    /// Time from exposure to the arrival of the features, s: one frame.
    pub delay_s: f64,
    /// Stated pose of the camera: origin at the optical centre, z forward, x right, y down in the
    /// image.
    pub flange_from_camera: PoseConfig,
    /// Stated focal length, pixels.
    pub focal_px: f64,
    /// Stated principal point, pixels.
    pub principal_px: [f64; 2],
    /// Width and height of the image, pixels.
    pub image_px: [f64; 2],
    /// Edge length of a pixel on the sensor, m: converts pixels to the paper's metres on the image
    /// plane.
    pub pixel_m: f64,
    /// Source of the corners.
    pub source: FeatureSource,
    /// Settings of the rendered image, if one is rendered.
    pub image: ImageConfig,
    /// Noise of a corner along each image axis, standard deviation, pixels. Unused with rendered
    /// images, which have their own noise.
    pub noise_px: f64,
    /// Largest error of the focal length and of each coordinate of the principal point, as a share
    /// of its value.
    pub intrinsic_error_share: f64,
    /// Largest error of the camera's position along each axis, m.
    pub position_error_m: f64,
    /// Largest error of the camera's orientation about each axis, rad.
    pub orientation_error_rad: f64,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            rate_hz: 50.0,
            delay_s: 0.02,
            flange_from_camera: PoseConfig::default(),
            focal_px: 400.0,
            principal_px: [320.0, 240.0],
            image_px: [640.0, 480.0],
            pixel_m: 8e-6,
            source: FeatureSource::Projection,
            image: ImageConfig::default(),
            noise_px: 0.2,
            intrinsic_error_share: 0.03,
            position_error_m: 0.01,
            orientation_error_rad: 3.0 * std::f64::consts::PI / 180.0,
        }
    }
}

impl CameraConfig {
    /// The stated calibration, in the form used by the estimators.
    pub fn model(&self) -> CameraModel {
        CameraModel {
            flange_from_camera: Pose::from_isometry(self.flange_from_camera.isometry()),
            focal_px: self.focal_px,
            principal_px: Vector2::from(self.principal_px),
            pixel_m: self.pixel_m,
        }
    }
}

/// State of the scene at an exposure: all that is needed to render an image of the target.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// Time of exposure, s.
    pub time_s: f64,
    /// Number of the frame.
    pub sequence: u64,
    /// Pose of the object relative to the camera's true pose.
    pub camera_from_object: Pose<CameraFrameAxes, Object>,
}

/// Renders the images of a camera's exposures, in any thread.
pub struct Imager {
    config: CameraConfig,
    truth: CameraModel,
    corners_m: [Vector3<f64>; CORNERS],
    rng: Pcg64Mcg,
}

impl Imager {
    /// Renders the image of one exposure.
    pub fn draw(&mut self, exposure: &Exposure) -> GreyImage {
        target_image::draw(
            &self.config.image,
            &self.truth,
            self.config.image_px.map(|x| x as u32),
            &exposure.camera_from_object,
            &self.corners_m,
            &mut self.rng,
        )
    }

    /// Time from exposure to the image's arrival, s.
    pub fn delay_s(&self) -> f64 {
        self.config.delay_s
    }
}

/// The camera with its true calibration and the frames in transit.
pub struct Camera {
    config: CameraConfig,
    truth: CameraModel,
    rng: Pcg64Mcg,
    frames_taken: u64,
    under_way: ArrayVec<CameraFrame, FRAMES_MAX>,
    detector: TargetDetector,
    /// Whether the images are rendered elsewhere: the caller then takes exposures instead of
    /// frames.
    elsewhere: bool,
    exposed: Option<Exposure>,
}

impl Camera {
    /// Creates a camera; `seed` determines the errors of its calibration.
    ///
    /// # Errors
    /// The detector of corners cannot be created.
    pub fn new(config: &CameraConfig, seed: u64) -> Result<Self, TargetDetectorError> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0xca3e_7a00_51de_c0de);
        let mut share = || -> f64 { rng.random_range(-1.0..=1.0) };
        let mut vector = |size: f64| Vector3::new(share() * size, share() * size, share() * size);
        let position = vector(config.position_error_m);
        let turn = vector(config.orientation_error_rad);
        let intrinsic = vector(config.intrinsic_error_share);
        let nominal = config.model();
        let stated = nominal.flange_from_camera;
        let truth = CameraModel {
            flange_from_camera: Pose::from_isometry(Isometry3::from_parts(
                (stated.translation() + position).into(),
                UnitQuaternion::from_scaled_axis(turn) * stated.rotation(),
            )),
            focal_px: nominal.focal_px * (1.0 + intrinsic.x),
            principal_px: Vector2::new(
                nominal.principal_px.x * (1.0 + intrinsic.y),
                nominal.principal_px.y * (1.0 + intrinsic.z),
            ),
            pixel_m: nominal.pixel_m,
        };
        Ok(Self {
            config: config.clone(),
            truth,
            rng,
            frames_taken: 0,
            under_way: ArrayVec::new(),
            detector: TargetDetector::new()?,
            elsewhere: false,
            exposed: None,
        })
    }

    /// Hands rendering over to the returned [`Imager`], which takes its input from
    /// [`Camera::take_exposure`]. The camera delivers no more frames itself.
    pub fn hand_over(&mut self, corners_m: [Vector3<f64>; CORNERS]) -> Imager {
        self.elsewhere = true;
        Imager {
            config: self.config.clone(),
            truth: self.truth,
            corners_m,
            rng: self.rng.clone(),
        }
    }

    /// The newest exposure, unless it has been taken already.
    pub fn take_exposure(&mut self) -> Option<Exposure> {
        self.exposed.take()
    }

    /// The true calibration, to compare estimates with.
    pub fn truth(&self) -> True<CameraModel> {
        True::new(self.truth)
    }

    /// Exposes a frame if one is due at `time_s`, of an object's corners (object axes, m).
    pub fn expose(
        &mut self,
        time_s: f64,
        base_from_flange: &Pose<Base, Flange>,
        base_from_object: &Pose<Base, Object>,
        corners_m: &[Vector3<f64>; CORNERS],
    ) {
        if self.config.rate_hz <= 0.0
            || time_s + 1e-9 < self.frames_taken as f64 / self.config.rate_hz
        {
            return;
        }
        let camera_from_object: Pose<CameraFrameAxes, Object> =
            (*base_from_flange * self.truth.flange_from_camera).inverse() * *base_from_object;
        if self.elsewhere {
            self.exposed = Some(Exposure {
                time_s,
                sequence: self.frames_taken,
                camera_from_object,
            });
            self.frames_taken += 1;
            return;
        }
        let corners = match self.config.source {
            FeatureSource::Projection => self.projected(&camera_from_object, corners_m),
            FeatureSource::Image => self.found(&camera_from_object, corners_m),
        };
        let frame = CameraFrame {
            time_s,
            sequence: self.frames_taken,
            corners,
        };
        self.frames_taken += 1;
        if self.under_way.is_full() {
            self.under_way.remove(0);
        }
        self.under_way.push(frame);
    }

    fn found(
        &mut self,
        camera_from_object: &Pose<CameraFrameAxes, Object>,
        corners_m: &[Vector3<f64>; CORNERS],
    ) -> [Option<Corner>; CORNERS] {
        let size = self.config.image_px.map(|x| x as u32);
        let image = target_image::draw(
            &self.config.image,
            &self.truth,
            size,
            camera_from_object,
            corners_m,
            &mut self.rng,
        );
        // The image has the size that the detector was created for.
        let found = self.detector.detect(&image).unwrap_or([None; CORNERS]);
        found.map(|corner| corner.map(|pixel_px| Corner { pixel_px }))
    }

    fn projected(
        &mut self,
        camera_from_object: &Pose<CameraFrameAxes, Object>,
        corners_m: &[Vector3<f64>; CORNERS],
    ) -> [Option<Corner>; CORNERS] {
        let mut corners = [None; CORNERS];
        // A face turned away from the camera is not visible.
        let faces = self.faces(camera_from_object, corners_m);
        for (slot, corner) in corners.iter_mut().zip(corners_m) {
            let noise = Vector2::new(self.normal(), self.normal()) * self.config.noise_px;
            let seen = self
                .truth
                .project(&camera_from_object.transform_point(corner))
                .map(|pixel| pixel + noise)
                .filter(|pixel| {
                    faces && (0..2).all(|i| pixel[i] >= 0.0 && pixel[i] <= self.config.image_px[i])
                });
            *slot = seen.map(|pixel_px| Corner { pixel_px });
        }
        corners
    }

    /// The oldest frame that has arrived by `time_s` and has not been taken.
    pub fn take(&mut self, time_s: f64) -> Option<CameraFrame> {
        let first = self.under_way.first()?;
        (first.time_s + self.config.delay_s <= time_s + 1e-9).then(|| self.under_way.remove(0))
    }

    fn faces(
        &self,
        camera_from_object: &Pose<CameraFrameAxes, Object>,
        corners_m: &[Vector3<f64>; CORNERS],
    ) -> bool {
        let side = corners_m[1] - corners_m[0];
        let out = side.cross(&(corners_m[2] - corners_m[0]));
        let at = camera_from_object.transform_point(&corners_m[0]);
        camera_from_object.rotate(&out).dot(&at) < 0.0
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }
}
