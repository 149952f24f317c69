//! What a frame says about the surface at the tool.

use nalgebra::{Matrix3, Point3, Vector3};
use tangent_mechanics::{Base, Camera, Pose};
use tangent_sensing::Validity;

use super::ahead::SurfaceAhead;
use super::segments::SegmentShape;
use super::windows::FrameNoise;
use crate::NormalEstimate;

/// Whether to use a visual normal, and if not, why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VisualValidity {
    /// Use it.
    Valid,
    /// No frame was seen yet.
    #[default]
    Missing,
    /// Intrinsics, target or mask cannot be used.
    BadInput,
    /// The tool touches outside the image.
    OutOfImage,
    /// No depth around the tool: blocked, dark, or out of range.
    NoDepth,
    /// Too little of the surface is seen for a fit.
    TooFew,
    /// The surface is seen on one side of the tool only.
    Edge,
    /// The surface is seen too flatly.
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
            Self::TooFew => "too little of the surface is seen",
            Self::Edge => "the surface is seen on one side of the tool only",
            Self::TooSteep => "the surface is seen too flatly",
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

/// The surface at the tool, camera axes of the time of exposure.
#[derive(Clone, Debug)]
pub struct VisualNormal {
    /// Time of exposure, s, as the sample said.
    pub time_s: f64,
    /// Whether to use what follows.
    pub validity: VisualValidity,
    /// On the surface, on the ray to the tool's target, m.
    pub point: Vector3<f64>,
    /// Unit, out of the material.
    pub normal: Vector3<f64>,
    /// Of the normal, rad²; singular along it.
    pub covariance: Matrix3<f64>,
    /// Shape operator, 1/m: moving by `dp` turns the normal by `curvature dp`; positive for a
    /// convex body.
    pub curvature: Matrix3<f64>,
    /// Its eigenvalues in the tangent plane, the larger first, 1/m.
    pub principal_curvatures_per_m: [f64; 2],
    /// (15): between the surface's inward normal and the camera's z axis, rad.
    pub tilt_rad: f64,
    /// Principal components of the tool's segment: the paper's normal, and its curvature (16).
    pub segment: Option<SegmentShape>,
    /// Radius of the patch that the fit used, m.
    pub patch_radius_m: f64,
    /// Cells of the patch.
    pub patch_cells: usize,
    /// Segments in the image.
    pub segments: usize,
    /// Noise found in the frame.
    pub noise: FrameNoise,
    /// The map ahead, where a direction of travel was given.
    pub ahead: SurfaceAhead,
}

impl VisualNormal {
    /// A result that says only why there is none: the surface facing the camera, and no idea of it.
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

    /// As any estimator publishes it; `base_from_camera` of the time of exposure.
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
