//! Disturbances of a closed loop for tests: inputs changed before they arrive, and pushes on the
//! tool.

use nalgebra::Vector6;
use tangent_control::{UnifiedInput, VisionInput};
use tangent_estimation::CameraFrame;
use tangent_sensing::ConditionedWrench;

/// Changes the inputs of a closed loop before they arrive, to test failures. Each method's doc
/// states the system in which it is called.
pub trait Disturbance<const N: usize = 7> {
    /// `object`: a frame before the estimator receives it; `None` for a lost one.
    fn frame(&mut self, _time_s: f64, frame: Option<CameraFrame>) -> Option<CameraFrame> {
        frame
    }

    /// `object`: alters the conditioned wrench and its age (s) before estimator and law receive
    /// them.
    fn wrench(&mut self, _time_s: f64, _input: &mut ConditionedWrench, _age_s: &mut f64) {}

    /// `visuo_tactile`: a normal before the law receives it; `None` for a lost frame.
    fn vision(&mut self, _time_s: f64, normal: VisionInput) -> Option<VisionInput> {
        Some(normal)
    }

    /// `visuo_tactile`: alters all other inputs of the law.
    fn input(&mut self, _input: &mut UnifiedInput<N>) {}

    /// `visuo_tactile`: external wrench on the tool, base axes, N and Nm.
    fn push(&mut self, _time_s: f64) -> Vector6<f64> {
        Vector6::zeros()
    }
}

/// A disturbance that changes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Undisturbed;

impl<const N: usize> Disturbance<N> for Undisturbed {}
