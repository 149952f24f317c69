//! Surface-normal estimators, one file each: contact samples in, a normal with its covariance out.
//!
//! Called by the `estimator` service and by the closed loop of `evaluate`.

mod estimator;

pub use estimator::{ContactSample, NormalEstimate, NormalEstimator};
