//! Marks a value as that of the plant, for the compiler: see `stated`.

/// A value as it is in the simulated cell.
///
/// No law, estimator or conditioning takes it:
///
/// ```compile_fail
/// use tangent_estimation::object_pose::{ObjectPoseConfig, build_object_estimator};
/// use tangent_simulation::{Camera, CameraConfig};
///
/// let camera = Camera::new(&CameraConfig::default(), 1).unwrap();
/// let config = ObjectPoseConfig::default();
/// build_object_estimator("object_pose", &config, &camera.truth()).unwrap();
/// ```
///
/// A figure that compares an estimate with the truth says so with [`True::to_compare`]:
///
/// ```
/// use tangent_simulation::{Camera, CameraConfig};
///
/// let config = CameraConfig::default();
/// let camera = Camera::new(&config, 1).unwrap();
/// assert_ne!(camera.truth().to_compare().focal_px, config.model().focal_px);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct True<T>(T);

impl<T> True<T> {
    /// Marks a value of the plant.
    pub(crate) fn new(value: T) -> Self {
        Self(value)
    }

    /// The value, for the plant itself and to compare an estimate with.
    pub fn to_compare(&self) -> &T {
        &self.0
    }
}
