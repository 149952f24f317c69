//! A depth camera above the plane z = 0 of the base, and the messages of its cell.

use nalgebra::Vector3;
use tangent_estimation::depth_normal::Intrinsics;
use tangent_mechanics::{Base, Camera, Pose};
use tangent_runtime::CellConfig;
use tangent_schemas::standard::{CameraInfo, Header, Image};
use tangent_schemas::tangent::ArmState;

use crate::fuse::Fuse;
use crate::mounting::Mounting;

/// Start of the messages, ns since the Unix epoch.
pub const START_NS: i64 = 1_795_260_245_000_000_000;
pub const WIDTH: u32 = 64;
pub const HEIGHT: u32 = 48;
/// Height of the camera, m.
const ABOVE_M: f64 = 0.3;

/// A cell with such a camera.
pub fn cell() -> CellConfig {
    let mut cell = CellConfig::default_cell();
    let camera = "kind = \"depth\"\nsize_px = [64, 48]\nfocal_px = 60.0\nprincipal_px = [31.5, 23.5]\n\
                  flange_from_camera = { translation_m = [0.05, 0.0, 0.0] }";
    cell.camera = Some(toml::from_str(camera).unwrap());
    cell.cell.name = "scanned".to_owned();
    cell
}

pub fn fuse() -> Fuse {
    Fuse::new(Mounting::from_cell(&cell()).unwrap())
}

pub fn info() -> CameraInfo {
    CameraInfo {
        width: WIDTH,
        height: HEIGHT,
        k: [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0],
        ..CameraInfo::default()
    }
}

/// The arm at a time after the start, ms, with its camera at x, m, looking down.
pub fn state(at_ms: i64, x_m: f64) -> ArmState {
    let mounting = Mounting::from_cell(&cell()).unwrap();
    let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let at = Vector3::new(x_m, 0.0, ABOVE_M);
    let base_from_camera: Pose<Base, Camera> = Pose::new(at, down);
    let base_from_tool = base_from_camera * mounting.tool_from_camera.inverse();
    ArmState {
        header: Header::new(START_NS + at_ms * 1_000_000, "base"),
        tool_pose: (&base_from_tool).into(),
        ..ArmState::default()
    }
}

/// An image of the plane.
pub fn image(at_ms: i64) -> Image {
    image_of(at_ms, |_| ABOVE_M)
}

/// An image with this depth at each pixel, m.
pub fn image_of(at_ms: i64, depth_m: impl Fn(usize) -> f64) -> Image {
    Image {
        header: Header::new(START_NS + at_ms * 1_000_000, "camera"),
        height: HEIGHT,
        width: WIDTH,
        encoding: "32FC1".into(),
        is_bigendian: 0,
        step: 4 * WIDTH,
        data: (0..(WIDTH * HEIGHT) as usize)
            .flat_map(|k| (depth_m(k) as f32).to_le_bytes())
            .collect(),
    }
}

/// Intrinsics of the camera.
pub fn intrinsics() -> Intrinsics {
    Intrinsics {
        fx_px: 60.0,
        fy_px: 60.0,
        cx_px: 31.5,
        cy_px: 23.5,
    }
}
