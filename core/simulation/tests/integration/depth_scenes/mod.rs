//! Scenes for testing normals from depth: a pipe, a waved sheet and a cone in front of a table,
//! seen from 0.3 to 0.6 m.

#[allow(dead_code)]
pub mod pcl;
#[allow(dead_code)]
pub mod table;

use nalgebra::{UnitQuaternion, Vector3};
use tangent_estimation::depth_normal::{DepthImage, PixelNormal, metres_from_millimetres};
use tangent_mechanics::{Base, Flange, Pose};
use tangent_simulation::depth_camera::{
    DepthCamera, DepthCameraConfig, DepthFrame, DepthNoiseConfig, Thing,
};
use tangent_simulation::{PoseConfig, ShapeConfig, Surface};

/// A surface, the camera's settings, and the camera's pose.
pub struct DepthScene {
    pub name: &'static str,
    pub surface: Surface,
    pub camera: DepthCameraConfig,
    pub base_from_flange: Vec<Pose<Base, Flange>>,
}

/// Name, shape, orientation, and bounding box.
type Placed = (&'static str, ShapeConfig, [f64; 3], [[f64; 3]; 2]);

/// `image_px` and `focal_px` of the camera; `errors` are its noise, holes and edges.
pub fn scenes(image_px: [usize; 2], focal_px: f64, errors: DepthNoiseConfig) -> Vec<DepthScene> {
    let lying = [0.0, std::f64::consts::FRAC_PI_2, 0.4];
    let shapes: [Placed; 3] = [
        (
            "cylinder",
            ShapeConfig::Cylinder { radius_m: 0.12 },
            lying,
            [[-0.12, -0.12, -0.25], [0.12, 0.12, 0.25]],
        ),
        (
            "sheet",
            ShapeConfig::Sheet {
                amplitude_m: [0.0, 0.02],
                wavelength_m: [1.0, 0.38],
            },
            [0.0; 3],
            [[-0.3, -0.3, -0.2], [0.3, 0.3, 0.1]],
        ),
        (
            "cone",
            ShapeConfig::Cone {
                height_m: 0.45,
                base_radius_m: 0.16,
            },
            [0.0, 1.2, -0.3],
            [[-0.2, -0.2, 0.0], [0.2, 0.2, 0.46]],
        ),
    ];
    shapes
        .into_iter()
        .map(|(name, shape, roll_pitch_yaw_rad, extent)| {
            let at = if name == "cone" {
                [-0.2, 0.06, 0.0]
            } else {
                [0.0; 3]
            };
            let pose = PoseConfig {
                position_m: at,
                roll_pitch_yaw_rad,
            };
            let surface = Surface::new(&shape, &pose).expect("a sound surface");
            let camera = DepthCameraConfig {
                image_px,
                focal_px,
                extent_m: Some(extent),
                table_height_m: Some(-0.3),
                noise: errors,
                ..DepthCameraConfig::default()
            };
            let top = if name == "sheet" { 0.0 } else { 0.12 };
            let views = [
                (0.30, 0.0, 0.0),
                (0.36, 0.25, -0.1),
                (0.42, -0.2, 0.2),
                (0.48, 0.1, 0.3),
                (0.54, -0.3, 0.0),
                (0.60, 0.2, -0.2),
            ];
            let base_from_flange = views
                .into_iter()
                .map(|(far, roll, pitch)| {
                    let down =
                        UnitQuaternion::from_euler_angles(std::f64::consts::PI + roll, pitch, 0.3);
                    let middle = Vector3::new(0.0, 0.0, top);
                    Pose::new(middle - down * Vector3::z() * far, down)
                })
                .collect();
            DepthScene {
                name,
                surface,
                camera,
                base_from_flange,
            }
        })
        .collect()
}

/// True normal of every pixel of a frame, camera axes; all zero where there is no reading or no
/// smooth face.
pub fn true_normals(
    camera: &DepthCamera,
    scene: &DepthScene,
    base_from_flange: &Pose<Base, Flange>,
    frame: &DepthFrame,
) -> Vec<PixelNormal> {
    let seen = camera.scene(base_from_flange, &scene.surface);
    (0..frame.depth_mm.len())
        .map(|i| {
            if frame.depth_mm[i] == 0 {
                return [0.0; 3];
            }
            let (u, v) = (i % frame.width, i / frame.width);
            let ray = frame.intrinsics.ray(u as f64, v as f64);
            let met = seen.cast(ray);
            let normal = (met.0 == Thing::Surface)
                .then(|| seen.normal(ray, met))
                .flatten();
            normal.map_or([0.0; 3], |n| [n.x as f32, n.y as f32, n.z as f32])
        })
        .collect()
}

/// Depths of a frame, m.
pub fn metres(frame: &DepthFrame) -> Vec<f32> {
    let mut depth_m = Vec::new();
    metres_from_millimetres(&frame.depth_mm, &mut depth_m);
    depth_m
}

/// A frame in the form used by the estimators.
pub fn image<'a>(frame: &DepthFrame, depth_m: &'a [f32]) -> DepthImage<'a> {
    DepthImage::new(frame.width, frame.height, depth_m).expect("a frame fits itself")
}

/// Angles between `found` and `truth` where both exist, degrees.
pub fn errors_deg(found: &[PixelNormal], truth: &[PixelNormal]) -> Vec<f64> {
    let there = |n: &PixelNormal| *n != [0.0; 3];
    let pairs = found
        .iter()
        .zip(truth)
        .filter(|(f, t)| there(f) && there(t));
    pairs
        .map(|(f, t)| {
            let (f, t) = (Vector3::from(*f), Vector3::from(*t));
            f64::from(f.cross(&t).norm().atan2(f.dot(&t))).to_degrees()
        })
        .collect()
}

pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
