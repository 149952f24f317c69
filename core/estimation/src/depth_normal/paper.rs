//! `depth_normal_paper`: the published method, for comparison. Point cloud, voxel grid, principal
//! components of each voxel's neighbours, region growing from the tool, principal components of the
//! segment (Karacan et al., II.B, (14)-(16)).
//!
//! The paper does not state voxel size, neighbours and angles; the defaults are those of the
//! examples of the library it uses.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Camera, Pose};
use tangent_sensing::Validity;

use super::segments::{SegmentShape, shape_of};
use super::step::{DepthSample, ToolTarget};
use super::visual_normal::VisualValidity;
use crate::ranges::check_ranges;
use crate::{EstimationError, NormalEstimate};

/// Settings of `depth_normal_paper`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNormalPaperConfig {
    /// Side of a voxel, m.
    pub voxel_m: f64,
    /// Number of points from which a normal is computed, including the point itself.
    pub neighbours: usize,
    /// Largest angle between neighbouring points of one segment, rad.
    pub segment_step_rad: f64,
    /// Largest angle between a point of a segment and the segment's mean, rad.
    pub segment_spread_rad: f64,
    /// Depths outside this range are treated as missing, m.
    pub range_m: [f64; 2],
}

impl Default for DepthNormalPaperConfig {
    fn default() -> Self {
        Self {
            voxel_m: 0.01,
            neighbours: 20,
            segment_step_rad: 0.14,
            segment_spread_rad: 0.35,
            range_m: [0.05, 2.0],
        }
    }
}

impl DepthNormalPaperConfig {
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the key, the value and what is allowed.
    pub fn check(&self) -> Result<(), EstimationError> {
        let [near, far] = self.range_m;
        check_ranges(&[
            ("depth_normal_paper.voxel_m", self.voxel_m, 1e-3, 1.0),
            (
                "depth_normal_paper.neighbours",
                self.neighbours as f64,
                3.0,
                1000.0,
            ),
            (
                "depth_normal_paper.segment_step_rad",
                self.segment_step_rad,
                1e-3,
                1.6,
            ),
            (
                "depth_normal_paper.segment_spread_rad",
                self.segment_spread_rad,
                1e-3,
                3.2,
            ),
            ("depth_normal_paper.range_m[0]", near, 1e-3, 100.0),
            ("depth_normal_paper.range_m[1]", far, near, 100.0),
        ])
    }
}

/// Result of the paper's pipeline, camera axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentNormal {
    /// Time of exposure, s.
    pub time_s: f64,
    /// Whether the result is usable.
    pub validity: VisualValidity,
    /// The segment; its normal is the paper's `n_s`, its variation that of eq. (16).
    pub segment: Option<SegmentShape>,
    /// Angle between the surface's inward normal and the camera's z axis, eq. (15), rad.
    pub tilt_rad: f64,
    /// Covariance of the normal, rad², from the scatter of the points about the segment's plane.
    /// The paper has none, and the bias on a curved segment is not included.
    pub covariance: Matrix3<f64>,
    /// Number of points in the cloud after the voxel grid.
    pub points: usize,
}

impl SegmentNormal {
    /// The result as published by any estimator; `base_from_camera` is the pose at the time of
    /// exposure.
    pub fn in_base(&self, base_from_camera: &Pose<Base, Camera>) -> NormalEstimate {
        let to = base_from_camera.isometry();
        let turn = to.rotation.to_rotation_matrix();
        let segment = self.segment.filter(|_| self.validity.is_valid());
        let (middle, normal) =
            segment.map_or((Vector3::zeros(), -Vector3::z()), |s| (s.middle, s.normal));
        NormalEstimate {
            point: (to * Point3::from(middle)).coords,
            normal: turn * normal,
            covariance: turn.matrix() * self.covariance * turn.matrix().transpose(),
            validity: Validity::from(self.validity),
            friction: None,
            curvature: None,
        }
    }
}

/// A voxel's mean point and its normal.
#[derive(Clone, Copy, Debug)]
struct Voxel {
    key: [i32; 3],
    point: Vector3<f64>,
    normal: Option<Vector3<f64>>,
}

/// The published pipeline. It allocates in every step, as the number of points varies.
#[derive(Clone, Copy, Debug)]
pub struct DepthNormalPaper {
    config: DepthNormalPaperConfig,
}

impl DepthNormalPaper {
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the setting.
    pub fn new(config: &DepthNormalPaperConfig) -> Result<Self, EstimationError> {
        config.check()?;
        Ok(Self { config: *config })
    }

    /// Processes one frame.
    pub fn update(&self, sample: &DepthSample<'_>) -> SegmentNormal {
        let mut result = SegmentNormal {
            time_s: sample.time_s,
            validity: VisualValidity::BadInput,
            segment: None,
            tilt_rad: 0.0,
            covariance: Matrix3::identity(),
            points: 0,
        };
        let pixels = sample.image.depth_m().len();
        if !sample.intrinsics.is_sound() || sample.left_out.is_some_and(|m| m.len() != pixels) {
            return result;
        }
        let target = match sample.target {
            ToolTarget::Pixel(px) => Some(px),
            ToolTarget::Point(point) => sample.intrinsics.project(&point),
        };
        let Some([u, v]) = target.filter(|px| px.iter().all(|x| x.is_finite())) else {
            return result;
        };
        let mut voxels = self.voxels(sample);
        result.points = voxels.len();
        let [a, b] = sample.intrinsics.ray(u, v);
        self.add_normals(&mut voxels);
        // The point nearest to the ray; if it is not within a few voxels, nothing is visible there.
        let direction = Vector3::new(a, b, 1.0).normalize();
        let aside = |p: &Vector3<f64>| (p - direction * direction.dot(p)).norm();
        let seeds = voxels
            .iter()
            .enumerate()
            .filter(|(_, v)| v.normal.is_some());
        let seed = seeds.min_by(|m, n| aside(&m.1.point).total_cmp(&aside(&n.1.point)));
        let Some((seed, _)) = seed.filter(|(_, v)| aside(&v.point) < 5.0 * self.config.voxel_m)
        else {
            result.validity = VisualValidity::NoDepth;
            return result;
        };
        let members = self.segment(&voxels, seed);
        let n = members.len() as f64;
        let middle = members
            .iter()
            .map(|i| voxels[*i].point)
            .sum::<Vector3<f64>>()
            / n;
        let spread: Matrix3<f64> = members
            .iter()
            .map(|i| (voxels[*i].point - middle) * (voxels[*i].point - middle).transpose())
            .sum::<Matrix3<f64>>()
            / n;
        let shape = (members.len() >= 10)
            .then(|| shape_of(middle, &spread, members.len()))
            .flatten();
        let Some(shape) = shape else {
            result.validity = VisualValidity::TooFew;
            return result;
        };
        result.validity = VisualValidity::Valid;
        result.tilt_rad = (-shape.normal.z).clamp(-1.0, 1.0).acos().abs();
        result.covariance = plane_covariance(&spread, n);
        result.segment = Some(shape);
        result
    }

    fn key(&self, p: &Vector3<f64>) -> [i32; 3] {
        [p.x, p.y, p.z].map(|x| (x / self.config.voxel_m).floor() as i32)
    }

    fn voxels(&self, sample: &DepthSample<'_>) -> Vec<Voxel> {
        let width = sample.image.width();
        let [near, far] = self.config.range_m;
        let mut points = Vec::new();
        for (i, depth) in sample.image.depth_m().iter().enumerate() {
            let z = f64::from(*depth);
            let inside = z >= near && z <= far;
            if !inside || sample.left_out.is_some_and(|m| m[i] != 0) {
                continue;
            }
            let [a, b] = sample
                .intrinsics
                .ray((i % width) as f64, (i / width) as f64);
            let point = Vector3::new(a, b, 1.0) * z;
            points.push((self.key(&point), point));
        }
        // A stable sort, so that the sums are the same on every machine.
        points.sort_by_key(|(key, _)| *key);
        points
            .chunk_by(|m, n| m.0 == n.0)
            .map(|same| Voxel {
                key: same[0].0,
                point: same.iter().map(|(_, p)| p).sum::<Vector3<f64>>() / same.len() as f64,
                normal: None,
            })
            .collect()
    }

    /// Voxels within a distance of two voxels, with their squared distances.
    fn around(voxels: &[Voxel], at: &Voxel, found: &mut Vec<(f64, usize)>) {
        found.clear();
        for x in -2..=2 {
            for y in -2..=2 {
                // The voxels of a column are contiguous.
                let from = [at.key[0] + x, at.key[1] + y, at.key[2] - 2];
                let first = voxels.partition_point(|v| v.key < from);
                for (i, v) in voxels.iter().enumerate().skip(first).take(5) {
                    if v.key[0] != from[0] || v.key[1] != from[1] || v.key[2] > at.key[2] + 2 {
                        break;
                    }
                    found.push(((v.point - at.point).norm_squared(), i));
                }
            }
        }
    }

    fn add_normals(&self, voxels: &mut [Voxel]) {
        let mut found = Vec::new();
        let mut normals = Vec::with_capacity(voxels.len());
        for voxel in &*voxels {
            Self::around(voxels, voxel, &mut found);
            found.sort_by(|m, n| m.0.total_cmp(&n.0));
            found.truncate(self.config.neighbours);
            let n = found.len() as f64;
            let middle = found
                .iter()
                .map(|(_, i)| voxels[*i].point)
                .sum::<Vector3<f64>>()
                / n;
            let spread: Matrix3<f64> = found
                .iter()
                .map(|(_, i)| (voxels[*i].point - middle) * (voxels[*i].point - middle).transpose())
                .sum();
            let shape = (found.len() >= 3)
                .then(|| shape_of(voxel.point, &spread, found.len()))
                .flatten();
            normals.push(shape.map(|s| s.normal));
        }
        for (voxel, normal) in voxels.iter_mut().zip(normals) {
            voxel.normal = normal;
        }
    }

    fn segment(&self, voxels: &[Voxel], seed: usize) -> Vec<usize> {
        let (step, spread) = (
            self.config.segment_step_rad.cos(),
            self.config.segment_spread_rad.cos(),
        );
        let mut taken = vec![false; voxels.len()];
        taken[seed] = true;
        let mut members = vec![seed];
        let mut queue = VecDeque::from([seed]);
        let mut mean = voxels[seed].normal.unwrap_or_default();
        let mut found = Vec::new();
        while let Some(from) = queue.pop_front() {
            Self::around(voxels, &voxels[from], &mut found);
            for (_, to) in &found {
                let (Some(here), Some(there)) = (voxels[from].normal, voxels[*to].normal) else {
                    continue;
                };
                if !taken[*to]
                    && here.dot(&there) >= step
                    && mean.dot(&there) >= spread * mean.norm()
                {
                    taken[*to] = true;
                    mean += there;
                    members.push(*to);
                    queue.push_back(*to);
                }
            }
        }
        members
    }
}

/// Covariance of a plane's normal from the scatter of the points about the plane, rad².
fn plane_covariance(spread: &Matrix3<f64>, n: f64) -> Matrix3<f64> {
    let eigen = spread.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let scatter = eigen.eigenvalues[least].max(0.0);
    (0..3)
        .filter(|i| *i != least)
        .map(|i| {
            let axis: Vector3<f64> = eigen.eigenvectors.column(i).into();
            axis * axis.transpose() * (scatter / (n * eigen.eigenvalues[i].max(1e-12)))
        })
        .sum()
}
