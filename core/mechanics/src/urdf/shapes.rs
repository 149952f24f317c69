//! Shapes with which the links are drawn. Sizes follow from the distances between the joints, so
//! that any arm looks like an arm.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::Mounted;
use crate::{Chain, Tip};

/// Shortest part that is drawn, m.
const SHORT_M: f64 = 1e-3;
/// Radius of a link near the base, as a share of the arm's reach.
const THICK: f64 = 0.052;
/// Radius of the last link, as a share of the arm's reach.
const THIN: f64 = 0.034;
/// Radius of a tool whose tip is unknown, m.
const TOOL_RADIUS_M: f64 = 0.008;
/// Height of a flat tip, m.
const TIP_HEIGHT_M: f64 = 0.004;
/// Width, height and depth of a camera's housing, m.
const CAMERA_M: [f64; 3] = [0.09, 0.025, 0.025];

/// Material of a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// Tubes between the joints.
    Tube,
    /// Joints.
    Joint,
    /// Sensor and flange.
    Metal,
    /// Tool.
    Tool,
    /// Camera.
    Camera,
}

/// A shape in the frame of its link.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Along z of its own frame, about its middle.
    Cylinder {
        link_from_shape: Isometry3<f64>,
        radius_m: f64,
        length_m: f64,
    },
    /// About the middle.
    Sphere {
        middle_m: Vector3<f64>,
        radius_m: f64,
    },
    /// About the middle, edges along x, y and z of its own frame.
    Box {
        link_from_shape: Isometry3<f64>,
        size_m: Vector3<f64>,
    },
}

/// Radii of the arm's links.
pub struct Sizes {
    radii_m: Vec<f64>,
}

impl Sizes {
    pub fn of(chain: &Chain) -> Self {
        let count = chain.links().len();
        let reach_m: f64 = (0..count).map(|i| chain.far_end(i).norm()).sum();
        // Without any distance between its joints, an arm is still seen.
        let reach_m = reach_m.max(0.1);
        let radii_m = (0..count)
            .map(|i| {
                let share = i as f64 / (count.max(2) - 1) as f64;
                reach_m * (THICK + (THIN - THICK) * share)
            })
            .collect();
        Self { radii_m }
    }

    fn at(&self, i: usize) -> f64 {
        self.radii_m.get(i).copied().unwrap_or(self.last())
    }

    fn last(&self) -> f64 {
        self.radii_m.last().copied().unwrap_or(THIN)
    }
}

/// A tube between two points; nothing if it is too short to be seen.
fn tube(from: Vector3<f64>, to: Vector3<f64>, radius_m: f64) -> Option<Shape> {
    let along = to - from;
    let length_m = along.norm();
    if length_m < SHORT_M {
        return None;
    }
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along)
        // Along -z any half turn will do: a cylinder is symmetric.
        .unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
    Some(Shape::Cylinder {
        link_from_shape: Isometry3::from_parts(Translation3::from((from + to) * 0.5), turn),
        radius_m,
        length_m,
    })
}

/// A disk about a point on z.
fn disk(middle_z_m: f64, radius_m: f64, length_m: f64) -> Shape {
    Shape::Cylinder {
        link_from_shape: Isometry3::translation(0.0, 0.0, middle_z_m),
        radius_m,
        length_m,
    }
}

pub fn base(sizes: &Sizes) -> Vec<(Shape, Colour)> {
    let radius_m = 1.4 * sizes.at(0);
    vec![(
        disk(0.2 * radius_m, radius_m, 0.4 * radius_m),
        Colour::Metal,
    )]
}

/// A joint along its axis, and tubes to the next joint: along the axis first, then beside it.
pub fn link(sizes: &Sizes, chain: &Chain, i: usize) -> Vec<(Shape, Colour)> {
    let radius_m = sizes.at(i);
    let end = chain.far_end(i);
    let knee = Vector3::new(0.0, 0.0, end.z);
    let mut shapes = vec![(disk(0.0, radius_m, 2.2 * radius_m), Colour::Joint)];
    for (from, to) in [(Vector3::zeros(), knee), (knee, end)] {
        if let Some(shape) = tube(from, to, 0.8 * radius_m) {
            shapes.push((shape, Colour::Tube));
        }
    }
    let bends = knee.norm() >= SHORT_M && (end - knee).norm() >= SHORT_M;
    if bends {
        let ball = Shape::Sphere {
            middle_m: knee,
            radius_m: 0.8 * radius_m,
        };
        shapes.push((ball, Colour::Tube));
    }
    shapes
}

/// A thin disk that ends at the flange.
pub fn flange(sizes: &Sizes) -> Vec<(Shape, Colour)> {
    let height_m = 0.2 * sizes.last();
    let shape = disk(-0.5 * height_m, 0.9 * sizes.last(), height_m);
    vec![(shape, Colour::Metal)]
}

/// A body from the flange to the sensor's origin, at least a disk.
pub fn sensor(sizes: &Sizes, flange_from_sensor: &Isometry3<f64>) -> Vec<(Shape, Colour)> {
    let flange = flange_from_sensor.inverse().translation.vector;
    let radius_m = 0.85 * sizes.last();
    let shape = tube(flange, Vector3::zeros(), radius_m)
        .unwrap_or_else(|| disk(0.0, radius_m, 0.3 * radius_m));
    vec![(shape, Colour::Metal)]
}

/// A rod from the sensor, or the flange, to the tip, and the tip as far as its shape is known.
pub fn tool(
    sizes: &Sizes,
    mounted: &Mounted,
    flange_from_tool: &Isometry3<f64>,
) -> Vec<(Shape, Colour)> {
    let mount = mounted
        .flange_from_sensor
        .map_or(Isometry3::identity(), |pose| *pose.isometry());
    let from = (flange_from_tool.inverse() * mount).translation.vector;
    let tip_m = mounted.tip.radius_m();
    let rod_m = tip_m.map_or(TOOL_RADIUS_M, |r| r.clamp(0.003, 0.5 * sizes.last()));
    let mut shapes = Vec::new();
    let end = match mounted.tip {
        Tip::Round { radius_m } => {
            let middle_m = Vector3::new(0.0, 0.0, -radius_m);
            shapes.push((Shape::Sphere { middle_m, radius_m }, Colour::Tool));
            middle_m
        }
        Tip::Flat { radius_m } | Tip::Ring { radius_m } | Tip::Soft { radius_m } => {
            let pad = disk(-0.5 * TIP_HEIGHT_M, radius_m, TIP_HEIGHT_M);
            shapes.push((pad, Colour::Tool));
            Vector3::zeros()
        }
        Tip::Unknown => Vector3::zeros(),
    };
    if let Some(rod) = tube(from, end, 0.7 * rod_m) {
        shapes.push((rod, Colour::Tool));
    }
    if shapes.is_empty() {
        // A tool at the flange itself.
        shapes.push((disk(0.0, rod_m, SHORT_M), Colour::Tool));
    }
    shapes
}

/// A housing behind the optical centre.
pub fn camera() -> Vec<(Shape, Colour)> {
    let size_m = Vector3::from(CAMERA_M);
    let shape = Shape::Box {
        link_from_shape: Isometry3::translation(0.0, 0.0, -0.5 * size_m.z),
        size_m,
    };
    vec![(shape, Colour::Camera)]
}
