//! The images that are kept: a bounded number, spread over the way of the camera.

use nalgebra::Vector3;
use tangent_estimation::depth_normal::Intrinsics;
use tangent_mechanics::{Base, Camera, Pose};
use tangent_schemas::standard::Image;

/// Most images.
pub(crate) const FRAMES_MAX: usize = 40;
/// Distance at which a turn of the camera counts as a way, m.
const LOOKED_AT_M: f64 = 0.3;
/// Way that a second counts for, m: images of a camera that rests are spread over time.
const SECOND_M: f64 = 0.001;

/// An image, and where it was taken.
#[derive(Debug)]
pub(crate) struct Frame {
    pub at_ns: i64,
    pub base_from_camera: Pose<Base, Camera>,
    pub intrinsics: Intrinsics,
    pub image: Image,
}

impl Frame {
    fn looked_at(&self) -> Vector3<f64> {
        looked_at(&self.base_from_camera)
    }
}

/// A place in front of the camera, in the base, m.
pub(crate) fn looked_at(base_from_camera: &Pose<Base, Camera>) -> Vector3<f64> {
    base_from_camera.transform_point(&Vector3::new(0.0, 0.0, LOOKED_AT_M))
}

/// Images in the order of their stamps.
#[derive(Debug, Default)]
pub(crate) struct Frames(Vec<Frame>);

impl Frames {
    /// Adds an image. If there are too many, leaves out the one whose neighbours are nearest to
    /// each other; the first and the newest stay.
    pub fn add(&mut self, frame: Frame) {
        self.0.push(frame);
        if self.0.len() <= FRAMES_MAX {
            return;
        }
        let apart = |inner: &usize| {
            let (before, after) = (&self.0[inner - 1], &self.0[inner + 1]);
            let way_m = (after.looked_at() - before.looked_at()).norm();
            way_m + SECOND_M * (after.at_ns - before.at_ns) as f64 * 1e-9
        };
        let least = (1..FRAMES_MAX).min_by(|a, b| apart(a).total_cmp(&apart(b)));
        if let Some(inner) = least {
            self.0.remove(inner);
        }
    }

    pub fn all(&self) -> &[Frame] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// The bug that it guards against: an arm that stands for a minute before it moves for two
    /// seconds left one image of the motion.
    #[test]
    fn a_long_rest_does_not_take_the_place_of_a_motion() {
        let mut frames = Frames::default();
        for k in 0..1860_i64 {
            let moved = (k - 1800).max(0) as f64 * 0.005;
            frames.add(Frame {
                at_ns: k * 33_000_000,
                base_from_camera: Pose::new(
                    Vector3::new(moved, 0.0, 0.4),
                    UnitQuaternion::identity(),
                ),
                intrinsics: Intrinsics {
                    fx_px: 1.0,
                    fy_px: 1.0,
                    cx_px: 0.0,
                    cy_px: 0.0,
                },
                image: Image::default(),
            });
        }
        let kept = frames.all();
        assert_eq!(kept.len(), FRAMES_MAX);
        assert!(kept.windows(2).all(|pair| pair[0].at_ns < pair[1].at_ns));
        let moving = kept.iter().filter(|f| f.at_ns > 1800 * 33_000_000).count();
        assert!((15..=38).contains(&moving), "{moving}");
        let way = |pair: &[Frame]| (pair[1].looked_at() - pair[0].looked_at()).norm();
        assert!(kept.windows(2).all(|pair| way(pair) < 0.03));
    }
}
