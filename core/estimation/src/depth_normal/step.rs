//! `depth_normal`: estimates the surface at the tool from one frame.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::ahead::look_ahead;
use super::cells::{Cells, noise_between_neighbours};
use super::config::DepthNormalConfig;
use super::cubics::Cubics;
use super::dense::{Field, PixelNormal};
use super::facets::{Facet, Mesh};
use super::image::{DepthImage, Intrinsics};
use super::patch::{Ground, PatchError, Place};
use super::segments::{NONE, Segments};
use super::visual_normal::{VisualNormal, VisualValidity};
use super::windows::Windows;
use crate::EstimationError;

/// Current or expected contact point of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToolTarget {
    /// A point, camera axes, m.
    Point(Vector3<f64>),
    /// A pixel.
    Pixel([f64; 2]),
}

/// Input of the step: one frame.
#[derive(Clone, Copy, Debug)]
pub struct DepthSample<'a> {
    /// Time of exposure, s.
    pub time_s: f64,
    /// Depth along the optical axis.
    pub image: DepthImage<'a>,
    /// Intrinsics of this image.
    pub intrinsics: Intrinsics,
    /// Place at which the surface is estimated.
    pub target: ToolTarget,
    /// Mask with the size of the image; not zero where the tool itself (or anything else that is
    /// not the surface) is visible.
    pub left_out: Option<&'a [u8]>,
    /// Direction of travel for the map ahead, camera axes, any length.
    pub travel: Option<Vector3<f64>>,
}

/// Checked settings of the step.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_estimation::depth_normal::{
///     DepthImage, DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, Intrinsics,
///     ToolTarget, VisualValidity,
/// };
///
/// // A camera that looks straight at a wall 0.3 m away.
/// let (width, height) = (160, 120);
/// let depth_m = vec![0.3; width * height];
/// let step = DepthNormal::new(&DepthNormalConfig::default())?;
/// let mut state = DepthNormalState::default();
/// let surface = step.update(
///     &mut state,
///     &DepthSample {
///         time_s: 0.0,
///         image: DepthImage::new(width, height, &depth_m).unwrap(),
///         intrinsics: Intrinsics { fx_px: 200.0, fy_px: 200.0, cx_px: 79.5, cy_px: 59.5 },
///         target: ToolTarget::Pixel([80.0, 60.0]),
///         left_out: None,
///         travel: None,
///     },
/// );
/// assert_eq!(surface.validity, VisualValidity::Valid);
/// assert!(surface.normal.angle(&-Vector3::z()) < 1e-3);
/// assert!((surface.point.z - 0.3).abs() < 1e-4);
/// # Ok::<(), tangent_estimation::EstimationError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct DepthNormal {
    config: DepthNormalConfig,
}

/// Work space of the step, kept between frames so that nothing is allocated while the image's size
/// stays the same. A new one is the reset; no frame depends on an earlier one.
#[derive(Clone, Debug, Default)]
pub struct DepthNormalState {
    cells: Cells,
    windows: Windows,
    cubics: Cubics,
    facets: Vec<Facet>,
    segments: Segments,
    mesh: Mesh,
    jump: [f64; 2],
    size_px: [usize; 2],
    differences: Vec<f32>,
}

impl DepthNormal {
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the setting.
    pub fn new(config: &DepthNormalConfig) -> Result<Self, EstimationError> {
        config.check()?;
        Ok(Self { config: *config })
    }

    /// The settings.
    pub fn config(&self) -> &DepthNormalConfig {
        &self.config
    }

    /// Processes one frame. Allocates only if the image's size has changed.
    pub fn update(&self, state: &mut DepthNormalState, sample: &DepthSample<'_>) -> VisualNormal {
        let [width, height] = [sample.image.width(), sample.image.height()];
        let invalid = |validity| VisualNormal::invalid(sample.time_s, validity);
        let pixels = width * height;
        if !sample.intrinsics.is_sound() || sample.left_out.is_some_and(|m| m.len() != pixels) {
            state.forget();
            return invalid(VisualValidity::BadInput);
        }
        state.prepare(&self.config, sample);
        let target = match sample.target {
            ToolTarget::Pixel(px) => Some(px),
            ToolTarget::Point(point) => sample.intrinsics.project(&point),
        };
        let target = target.filter(|px| px.iter().all(|x| x.is_finite()));
        let tool = target.and_then(|[u, v]| {
            let mesh = state.mesh;
            let step = mesh.step[0].max(mesh.step[1]);
            let far = self.config.patch_radius_m[1];
            let place = mesh.place(sample.intrinsics.ray(u, v));
            state
                .segments
                .at(place, &state.facets, |facet| far / (step * facet.point.z))
        });
        state
            .segments
            .grow_segments(&self.config, &state.facets, tool);
        let Some([u, v]) = target else {
            return invalid(VisualValidity::BadInput);
        };
        let inside = u > -0.5 && v > -0.5 && u < width as f64 - 0.5 && v < height as f64 - 0.5;
        if !inside {
            return invalid(VisualValidity::OutOfImage);
        }
        let Some(tool) = tool else {
            return invalid(VisualValidity::NoDepth);
        };
        self.at_target(state, sample, [u, v], tool)
    }

    fn at_target(
        &self,
        state: &DepthNormalState,
        sample: &DepthSample<'_>,
        [u, v]: [f64; 2],
        tool: usize,
    ) -> VisualNormal {
        let invalid = |validity| VisualNormal::invalid(sample.time_s, validity);
        let ground = Ground {
            config: &self.config,
            cells: &state.cells,
            facets: &state.facets,
            body: &state.segments.body,
            mesh: state.mesh,
            noise: state.windows.noise,
        };
        let (body, label) = (state.segments.body[tool], state.segments.segment[tool]);
        if body == NONE {
            return invalid(VisualValidity::TooSteep);
        }
        let ray = sample.intrinsics.ray(u, v);
        let facet = &state.facets[tool];
        let [a, b] = ray;
        let depth_m = plane_depth(facet, ray).unwrap_or(facet.point.z);
        let place = Place {
            point: Vector3::new(a, b, 1.0) * depth_m,
            normal: facet.normal,
            shape: Matrix3::zeros(),
        };
        let patch = match ground.widest(&place, ray, body) {
            Ok(patch) => patch,
            Err(PatchError::TooFew) => return invalid(VisualValidity::TooFew),
            Err(PatchError::OneSided) => return invalid(VisualValidity::Edge),
        };
        let (point, normal) = (patch.place.point, patch.place.normal);
        if -normal.dot(&point) < self.config.steepest_rad.cos() * point.norm() {
            return invalid(VisualValidity::TooSteep);
        }
        let ahead = match sample.travel.filter(|t| t.iter().all(|x| x.is_finite())) {
            Some(travel) => look_ahead(
                &ground,
                &sample.intrinsics,
                state.size_px,
                &patch,
                body,
                &travel,
            ),
            None => Default::default(),
        };
        VisualNormal {
            time_s: sample.time_s,
            validity: VisualValidity::Valid,
            point,
            normal,
            covariance: patch.frame.lift_matrix(&patch.covariance),
            curvature: patch.frame.lift_matrix(&patch.shape),
            principal_curvatures_per_m: principal(&patch.shape),
            tilt_rad: (-normal.z).clamp(-1.0, 1.0).acos().abs(),
            segment: state.segments.shape(label, &state.facets),
            patch_radius_m: patch.radius_m,
            patch_cells: patch.cells,
            segments: usize::from(state.segments.segments),
            noise: state.windows.noise,
            ahead,
        }
    }

    /// Normal of every pixel of the last frame that `state` has processed; `normals` has one entry
    /// per pixel, all zero for a pixel without depth. Returns false and writes nothing if the sizes
    /// do not match.
    pub fn normals(
        &self,
        state: &DepthNormalState,
        image: &DepthImage<'_>,
        normals: &mut [PixelNormal],
    ) -> bool {
        let fits = state.size_px == [image.width(), image.height()]
            && normals.len() == image.depth_m().len();
        if fits {
            let field = Field {
                nodes: &state.windows.nodes,
                columns: state.cells.columns,
                rows: state.cells.rows,
                cell_px: self.config.cell_px,
                mesh: state.mesh,
                jump: state.jump,
                range_m: self.config.range_m,
            };
            field.fill(image, normals);
        }
        fits
    }
}

impl DepthNormalState {
    fn forget(&mut self) {
        self.size_px = [0, 0];
    }

    fn prepare(&mut self, config: &DepthNormalConfig, sample: &DepthSample<'_>) {
        let (width, height) = (sample.image.width(), sample.image.height());
        self.size_px = [width, height];
        self.differences.clear();
        self.differences.reserve(10_000);
        let found = noise_between_neighbours(&sample.image, config.range_m, &mut self.differences);
        let focal_px = sample.intrinsics.fx_px.min(sample.intrinsics.fy_px);
        self.jump = config.jump(focal_px, found);
        self.mesh = Mesh::new(&sample.intrinsics, config.cell_px);
        self.cells.resize(width, height, config.cell_px);
        self.cells
            .fill(config, &sample.image, sample.left_out, self.jump);
        let (columns, rows) = (self.cells.columns, self.cells.rows);
        self.windows.resize(columns, rows);
        self.windows.begin(config, &self.cells);
        self.cubics.resize(columns, rows);
        let variance = self.windows.noise.variance(config);
        self.cubics
            .refine(config, &self.cells, variance, &mut self.windows.nodes);
        self.windows
            .widen(config, &self.cells, |node| !self.cubics.has(node));
        self.facets.resize(columns * rows, Facet::default());
        let cos = config.steepest_rad.cos();
        self.mesh
            .facets(&self.windows.nodes, columns, cos, &mut self.facets);
        self.segments.resize(columns, rows);
        self.segments
            .grow_bodies(config, &self.windows.nodes, &self.facets, self.jump);
    }
}

/// Depth at which a ray meets a facet's plane, m.
fn plane_depth(facet: &Facet, [a, b]: [f64; 2]) -> Option<f64> {
    let along = facet.normal.dot(&Vector3::new(a, b, 1.0));
    let depth = facet.normal.dot(&facet.point) / along;
    (depth.is_finite() && depth > 0.0).then_some(depth)
}

/// Eigenvalues, the larger one first.
fn principal(shape: &Matrix2<f64>) -> [f64; 2] {
    let middle = 0.5 * shape.trace();
    let apart = (0.25 * (shape.m11 - shape.m22).powi(2) + shape.m12 * shape.m21)
        .max(0.0)
        .sqrt();
    [middle + apart, middle - apart]
}
