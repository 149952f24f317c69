//! Estimate of the surface at the tool from one frame.

use nalgebra::{Matrix3, Point3, Vector3};
use tangent_mechanics::{Base, Camera, Pose};
use tangent_sensing::Validity;

use super::ahead::SurfaceAhead;
use super::segments::SegmentShape;
use super::windows::FrameNoise;
use crate::NormalEstimate;

/// Validity of a visual normal, with the reason if it is not usable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VisualValidity {
    /// The normal is usable.
    Valid,
    /// No frame has been processed yet.
    #[default]
    Missing,
    /// Intrinsics, target or mask are not usable.
    BadInput,
    /// The contact point is outside the image.
    OutOfImage,
    /// There is no depth around the tool: blocked, dark, or out of range.
    NoDepth,
    /// Too little of the surface is visible for a fit.
    TooFew,
    /// The surface is visible on only one side of the tool.
    Edge,
    /// The surface is seen at too flat an angle.
    TooSteep,
}

impl VisualValidity {
    /// True only for [`VisualValidity::Valid`].
    pub fn is_valid(self) -> bool {
        self == Self::Valid
    }

    /// The reason in words an operator understands.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::Missing => "no frame received yet",
            Self::BadInput => "intrinsics, mask or tool point cannot be used",
            Self::OutOfImage => "the tool touches outside the image",
            Self::NoDepth => "no depth around the tool",
            Self::TooFew => "too little of the surface is visible",
            Self::Edge => "the surface is visible on one side of the tool only",
            Self::TooSteep => "the surface is seen at too flat an angle",
        }
    }
}

impl From<VisualValidity> for Validity {
    fn from(visual: VisualValidity) -> Self {
        match visual {
            VisualValidity::Valid => Self::Valid,
            VisualValidity::Missing | VisualValidity::NoDepth | VisualValidity::OutOfImage => {
                Self::Missing
            }
            VisualValidity::BadInput => Self::NotFinite,
            VisualValidity::TooFew | VisualValidity::Edge | VisualValidity::TooSteep => {
                Self::Degenerate
            }
        }
    }
}

/// The surface at the tool, camera axes at the time of exposure.
#[derive(Clone, Debug)]
pub struct VisualNormal {
    /// Time of exposure, s, as in the sample.
    pub time_s: f64,
    /// Whether the estimate is usable.
    pub validity: VisualValidity,
    /// Point of the surface on the ray to the tool's target, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, rad²; singular along the normal.
    pub covariance: Matrix3<f64>,
    /// Shape operator, 1/m: moving by `dp` turns the normal by `curvature dp`; positive for a
    /// convex body.
    pub curvature: Matrix3<f64>,
    /// Eigenvalues of `curvature` in the tangent plane, the larger one first, 1/m.
    pub principal_curvatures_per_m: [f64; 2],
    /// Angle between the surface's inward normal and the camera's z axis, eq. (15), rad.
    pub tilt_rad: f64,
    /// Principal components of the tool's segment: the paper's normal, and its variation, eq. (16).
    pub segment: Option<SegmentShape>,
    /// Radius of the patch that the fit used, m.
    pub patch_radius_m: f64,
    /// Number of cells in the patch.
    pub patch_cells: usize,
    /// Number of segments in the image.
    pub segments: usize,
    /// Noise measured in the frame.
    pub noise: FrameNoise,
    /// The map ahead, if a direction of travel was given.
    pub ahead: SurfaceAhead,
}

impl VisualNormal {
    /// A result without an estimate, with its reason: the surface faces the camera, with a
    /// covariance that means unknown.
    pub fn invalid(time_s: f64, validity: VisualValidity) -> Self {
        Self {
            time_s,
            validity,
            point: Vector3::zeros(),
            normal: -Vector3::z(),
            covariance: Matrix3::identity(),
            curvature: Matrix3::zeros(),
            principal_curvatures_per_m: [0.0; 2],
            tilt_rad: 0.0,
            segment: None,
            patch_radius_m: 0.0,
            patch_cells: 0,
            segments: 0,
            noise: FrameNoise::default(),
            ahead: SurfaceAhead::default(),
        }
    }

    /// The estimate as published by any estimator; `base_from_camera` is the pose at the time of
    /// exposure.
    pub fn in_base(&self, base_from_camera: &Pose<Base, Camera>) -> NormalEstimate {
        let to = base_from_camera.isometry();
        let turn = to.rotation.to_rotation_matrix();
        let turned = |m: &Matrix3<f64>| turn.matrix() * m * turn.matrix().transpose();
        NormalEstimate {
            point: (to * Point3::from(self.point)).coords,
            normal: turn * self.normal,
            covariance: turned(&self.covariance),
            validity: self.validity.into(),
            friction: None,
            curvature: self.validity.is_valid().then(|| turned(&self.curvature)),
        }
    }
}
