//! Normals from depth images: the segment under the tool, its normal and curvature with covariance,
//! and the map ahead.
//!
//! Karacan et al., "Visuo-Tactile Exploration of Unknown Rigid 3D Curvatures", (14)-(16).
//! `depth_normal` builds no point cloud: for a plane, inverse depth is linear in the pixel
//! coordinates, so fits of planes of any size follow from summed tables. Called with each frame by
//! the receiver of the camera's frames, and by the closed loop of `evaluate`.

mod ahead;
mod cells;
mod config;
mod cubics;
mod dense;
mod encoding;
mod facets;
mod image;
mod inverse_depth;
mod paper;
mod patch;
mod rod;
mod segments;
mod step;
mod visual_normal;
mod windows;

pub use ahead::{AheadEnd, STATIONS_MAX, SurfaceAhead, SurfaceStation};
pub use config::DepthNormalConfig;
pub use dense::PixelNormal;
pub use encoding::{DepthEncoding, DepthEncodingError, DepthLayout, metres_from_millimetres};
pub use image::{DepthImage, Intrinsics};
pub use inverse_depth::InverseDepth;
pub use paper::{DepthNormalPaper, DepthNormalPaperConfig, SegmentNormal};
pub use rod::leave_out_rod;
pub use segments::SegmentShape;
pub use step::{DepthNormal, DepthNormalState, DepthSample, ToolTarget};
pub use visual_normal::{VisualNormal, VisualValidity};
pub use windows::FrameNoise;

/// Name of the estimator, as in `estimate/NAME/normal`.
pub const DEPTH_NORMAL: &str = "depth_normal";
