//! The standard ROS 2 messages in use, with the same fields.

use serde::{Deserialize, Serialize};

use crate::covariance::Covariance;
use crate::{FrameId, message};

message! {
    /// A point in time since the Unix epoch.
    pub struct Time: "builtin_interfaces/msg/Time" {
        pub sec: i32,
        pub nanosec: u32,
    }
}

message! {
    /// Time of measurement and frame.
    pub struct Header: "std_msgs/msg/Header" {
        pub stamp: Time,
        pub frame_id: FrameId,
    }
}

message! {
    /// Free vector.
    pub struct Vector3: "geometry_msgs/msg/Vector3" {
        pub x: f64,
        pub y: f64,
        pub z: f64,
    }
}

message! {
    /// Position, m.
    pub struct Point: "geometry_msgs/msg/Point" {
        pub x: f64,
        pub y: f64,
        pub z: f64,
    }
}

message! {
    /// Unit quaternion, w ≥ 0.
    pub struct Quaternion: "geometry_msgs/msg/Quaternion" {
        pub x: f64,
        pub y: f64,
        pub z: f64,
        pub w: f64,
    }
}

message! {
    /// Position and orientation.
    pub struct Pose: "geometry_msgs/msg/Pose" {
        pub position: Point,
        pub orientation: Quaternion,
    }
}

message! {
    /// A pose with its time and frame.
    pub struct PoseStamped: "geometry_msgs/msg/PoseStamped" {
        pub header: Header,
        pub pose: Pose,
    }
}

message! {
    /// A pose with its covariance.
    pub struct PoseWithCovariance: "geometry_msgs/msg/PoseWithCovariance" {
        pub pose: Pose,
        /// Row-major; x, y, z (m), then small rotations about the fixed axes x, y, z (rad).
        pub covariance: Covariance,
    }
}

message! {
    /// A pose with its covariance, time and frame.
    pub struct PoseWithCovarianceStamped: "geometry_msgs/msg/PoseWithCovarianceStamped" {
        pub header: Header,
        pub pose: PoseWithCovariance,
    }
}

message! {
    /// Velocity: linear m/s, angular rad/s.
    pub struct Twist: "geometry_msgs/msg/Twist" {
        pub linear: Vector3,
        pub angular: Vector3,
    }
}

message! {
    /// Force N, torque Nm.
    pub struct Wrench: "geometry_msgs/msg/Wrench" {
        pub force: Vector3,
        pub torque: Vector3,
    }
}

message! {
    /// A wrench with its time and frame.
    pub struct WrenchStamped: "geometry_msgs/msg/WrenchStamped" {
        pub header: Header,
        pub wrench: Wrench,
    }
}

message! {
    /// Rigid transform.
    pub struct Transform: "geometry_msgs/msg/Transform" {
        pub translation: Vector3,
        pub rotation: Quaternion,
    }
}

message! {
    /// Pose of `child_frame_id` in `header.frame_id`.
    pub struct TransformStamped: "geometry_msgs/msg/TransformStamped" {
        pub header: Header,
        pub child_frame_id: FrameId,
        pub transform: Transform,
    }
}

message! {
    /// Message of `/tf`.
    pub struct TFMessage: "tf2_msgs/msg/TFMessage" {
        pub transforms: Vec<TransformStamped>,
    }
}

message! {
    /// Colour; each component from 0 to 1.
    pub struct ColorRGBA: "std_msgs/msg/ColorRGBA" {
        pub r: f32,
        pub g: f32,
        pub b: f32,
        pub a: f32,
    }
}

message! {
    /// Duration.
    pub struct Duration: "builtin_interfaces/msg/Duration" {
        pub sec: i32,
        pub nanosec: u32,
    }
}

message! {
    /// One object to draw. Kinds: 0 arrow, 2 sphere, 4 line strip, 5 line list, 6 cubes, 7 spheres,
    /// 9 text, 11 triangles.
    pub struct Marker: "visualization_msgs/msg/Marker" {
        pub header: Header,
        pub ns: FrameId,
        pub id: i32,
        pub r#type: i32,
        /// Action: 0 add or change, 2 delete, 3 delete all.
        pub action: i32,
        pub pose: Pose,
        /// Metres; for an arrow by points: shaft diameter, head diameter, head length.
        pub scale: Vector3,
        pub color: ColorRGBA,
        /// Lifetime; zero for unlimited.
        pub lifetime: Duration,
        pub frame_locked: bool,
        pub points: Vec<Point>,
        pub colors: Vec<ColorRGBA>,
        pub texture_resource: String,
        pub texture: CompressedImage,
        pub uv_coordinates: Vec<UVCoordinate>,
        pub text: String,
        pub mesh_resource: String,
        pub mesh_file: MeshFile,
        pub mesh_use_embedded_materials: bool,
    }
}

message! {
    /// Objects for a viewer to draw.
    pub struct MarkerArray: "visualization_msgs/msg/MarkerArray" {
        pub markers: Vec<Marker>,
    }
}

message! {
    /// Part of a marker; empty here.
    pub struct CompressedImage: "sensor_msgs/msg/CompressedImage" {
        pub header: Header,
        pub format: String,
        pub data: Vec<u8>,
    }
}

message! {
    /// An image; the stamp is the time of exposure.
    pub struct Image: "sensor_msgs/msg/Image" {
        pub header: Header,
        /// Number of rows.
        pub height: u32,
        /// Number of columns.
        pub width: u32,
        /// Encoding of a pixel: `mono8`, `16UC1`, `32FC1`.
        pub encoding: String,
        /// 1 if numbers of several bytes begin with the most significant byte.
        pub is_bigendian: u8,
        /// Bytes per row.
        pub step: u32,
        /// Pixels, `step * height` bytes.
        #[serde(with = "serde_bytes")]
        pub data: Vec<u8>,
    }
}

message! {
    /// A part of an image; all zero for the whole image.
    pub struct RegionOfInterest: "sensor_msgs/msg/RegionOfInterest" {
        pub x_offset: u32,
        pub y_offset: u32,
        pub height: u32,
        pub width: u32,
        pub do_rectify: bool,
    }
}

message! {
    /// A camera's calibration, pixels.
    pub struct CameraInfo: "sensor_msgs/msg/CameraInfo" {
        pub header: Header,
        pub height: u32,
        pub width: u32,
        pub distortion_model: String,
        /// Distortion; empty for none.
        pub d: Vec<f64>,
        /// Row-major, `[fx 0 cx, 0 fy cy, 0 0 1]`.
        pub k: [f64; 9],
        /// Rectification; identity for a single camera.
        pub r: [f64; 9],
        /// Projection, 3 × 4, row-major.
        pub p: [f64; 12],
        pub binning_x: u32,
        pub binning_y: u32,
        pub roi: RegionOfInterest,
    }
}

message! {
    /// Part of a marker; unused here.
    pub struct UVCoordinate: "visualization_msgs/msg/UVCoordinate" {
        pub u: f32,
        pub v: f32,
    }
}

message! {
    /// Part of a marker; empty here.
    pub struct MeshFile: "visualization_msgs/msg/MeshFile" {
        pub filename: String,
        pub data: Vec<u8>,
    }
}

message! {
    /// Joint positions rad, velocities rad/s, efforts Nm, by name.
    pub struct JointState: "sensor_msgs/msg/JointState" {
        pub header: Header,
        pub name: Vec<String>,
        pub position: Vec<f64>,
        pub velocity: Vec<f64>,
        pub effort: Vec<f64>,
    }
}

message! {
    /// A text: `std_msgs/msg/String`.
    pub struct StdString: "std_msgs/msg/String" {
        pub data: String,
    }
}
