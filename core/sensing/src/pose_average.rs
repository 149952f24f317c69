//! Static poses for payload identification: the mean reading while the arm is at rest.

use nalgebra::UnitQuaternion;
use tangent_mechanics::{Base, Flange, Pose, Sensor, Tool, Wrench};

use crate::tare::averaging::Averaging;
use crate::{StaticPose, TareConfig, TareRefusal};

/// Smallest rotation between two poses that count as different, rad.
pub const ANOTHER_POSE_RAD: f64 = 0.2;

/// Averages the readings of one static pose. Each pose needs a new one.
#[derive(Clone, Debug)]
pub struct PoseAverage {
    config: TareConfig,
    averaging: Averaging,
    base_from_flange: UnitQuaternion<f64>,
    started: bool,
}

impl PoseAverage {
    /// Average over `config.duration_s` of readings at `rate_hz`. It is refused under the same
    /// conditions as a tare.
    pub fn new(config: &TareConfig, rate_hz: f64) -> Self {
        Self {
            averaging: Averaging::new((config.duration_s * rate_hz).round().max(2.0) as u32),
            config: config.clone(),
            base_from_flange: UnitQuaternion::identity(),
            started: false,
        }
    }

    /// Takes one reading (before tare and payload) with the arm's pose at that time. Returns `Some`
    /// when the average is complete or refused.
    pub fn take(
        &mut self,
        reading: &Wrench<Sensor>,
        base_from_tool: &Pose<Base, Tool>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) -> Option<Result<StaticPose, TareRefusal>> {
        if !self.started {
            self.started = true;
            self.base_from_flange =
                base_from_tool.rotation() * flange_from_tool.rotation().inverse();
        }
        let done = self
            .averaging
            .take(&self.config, reading, Some(base_from_tool), 0.0)?;
        Some(done.map(|mean| StaticPose {
            base_from_flange: self.base_from_flange,
            wrench: mean.bias,
        }))
    }
}

/// Finds the static poses in a stream of readings, such as a recording: each orientation in which
/// the arm is at rest for long enough, once in a row.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::{Pose, Sensor, Wrench};
/// use tangent_sensing::{PoseFinder, TareConfig};
///
/// let mut finder = PoseFinder::new(&TareConfig::default(), 100.0);
/// for (i, roll) in [0.0, 0.5, 1.0].into_iter().enumerate() {
///     let base_from_tool = Pose::new(
///         Vector3::new(0.4, 0.0, 0.3),
///         UnitQuaternion::new(Vector3::x() * roll),
///     );
///     let reading = Wrench::<Sensor>::new(Vector3::repeat(i as f64), Vector3::zeros());
///     for _ in 0..200 {
///         finder.take(&reading, &base_from_tool, &Pose::identity());
///     }
/// }
/// assert_eq!(finder.found().len(), 3);
/// ```
#[derive(Clone, Debug)]
pub struct PoseFinder {
    config: TareConfig,
    rate_hz: f64,
    current: PoseAverage,
    found: Vec<StaticPose>,
}

impl PoseFinder {
    /// Finder for readings at `rate_hz`, averaged over `config.duration_s` per pose.
    pub fn new(config: &TareConfig, rate_hz: f64) -> Self {
        Self {
            config: config.clone(),
            rate_hz,
            current: PoseAverage::new(config, rate_hz),
            found: Vec::new(),
        }
    }

    /// Takes the next reading with the arm's pose at that time.
    pub fn take(
        &mut self,
        reading: &Wrench<Sensor>,
        base_from_tool: &Pose<Base, Tool>,
        flange_from_tool: &Pose<Flange, Tool>,
    ) {
        let Some(done) = self.current.take(reading, base_from_tool, flange_from_tool) else {
            return;
        };
        self.current = PoseAverage::new(&self.config, self.rate_hz);
        if let Ok(pose) = done {
            let another = self.found.last().is_none_or(|last| {
                last.base_from_flange.angle_to(&pose.base_from_flange) > ANOTHER_POSE_RAD
            });
            if another {
                self.found.push(pose);
            }
        }
    }

    /// All poses so far, in order.
    pub fn found(&self) -> &[StaticPose] {
        &self.found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn turned(angle: f64) -> Pose<Base, Tool> {
        Pose::new(
            Vector3::new(0.4, 0.0, 0.3),
            UnitQuaternion::new(Vector3::x() * angle),
        )
    }

    #[test]
    fn each_stand_is_one_pose_and_motion_is_none() {
        let flange_from_tool = Pose::new(Vector3::zeros(), UnitQuaternion::new(Vector3::z() * 0.5));
        let mut finder = PoseFinder::new(&TareConfig::default(), 100.0);
        let reading = |angle: f64| Wrench::new(Vector3::new(angle, 0.0, 1.0), Vector3::zeros());
        for angle in [0.0, 0.8, 1.6] {
            for _ in 0..200 {
                finder.take(&reading(angle), &turned(angle), &flange_from_tool);
            }
            for step in 0..100 {
                let way = angle + 0.008 * f64::from(step);
                finder.take(&reading(way), &turned(way), &flange_from_tool);
            }
        }
        let found = finder.found();
        assert_eq!(found.len(), 3);
        for (pose, angle) in found.iter().zip([0.0, 0.8, 1.6]) {
            assert!((pose.wrench.force.x - angle).abs() < 1e-9);
            let flange = turned(angle).rotation() * flange_from_tool.rotation().inverse();
            assert!(pose.base_from_flange.angle_to(&flange) < 1e-7);
        }
    }

    #[test]
    fn a_pose_that_shakes_is_refused_with_the_reason() {
        let flange_from_tool = Pose::identity();
        let mut average = PoseAverage::new(&TareConfig::default(), 100.0);
        let refused = (0..)
            .find_map(|i| {
                let force = Vector3::z() * if i % 2 == 0 { 2.0 } else { -2.0 };
                average.take(
                    &Wrench::new(force, Vector3::zeros()),
                    &turned(0.0),
                    &flange_from_tool,
                )
            })
            .unwrap();
        assert!(matches!(refused, Err(TareRefusal::Scattered { .. })));
    }
}
