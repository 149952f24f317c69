//! Markers of single shapes.

use nalgebra::Vector3;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::{ColorRGBA, Header, Marker};

/// Kinds of `visualization_msgs/msg/Marker`.
pub mod kind {
    pub const ARROW: i32 = 0;
    pub const LINE_STRIP: i32 = 4;
    pub const CUBE_LIST: i32 = 6;
    pub const SPHERE_LIST: i32 = 7;
    pub const TRIANGLE_LIST: i32 = 11;
}

/// `visualization_msgs/msg/Marker`'s DELETE.
const DELETE: i32 = 2;

/// A marker without points, in a frame.
pub fn marker(stamp: i64, frame: &str, name: &str, kind: i32, [r, g, b]: [f32; 3]) -> Marker {
    let mut marker = Marker {
        header: Header::new(stamp, frame),
        ns: cut(name),
        r#type: kind,
        color: ColorRGBA { r, g, b, a: 1.0 },
        ..Marker::default()
    };
    marker.pose.orientation.w = 1.0;
    marker
}

/// An order to remove a marker.
pub fn removed(stamp: i64, name: &str, id: i32) -> Marker {
    let mut marker = marker(stamp, "world", name, kind::ARROW, [0.0; 3]);
    marker.id = id;
    marker.action = DELETE;
    marker
}

/// An arrow in base axes.
pub fn arrow(
    stamp: i64,
    name: &str,
    from: Vector3<f64>,
    along: Vector3<f64>,
    color: [f32; 3],
) -> Marker {
    let mut arrow = marker(stamp, "base", name, kind::ARROW, color);
    arrow.scale.x = 0.004;
    arrow.scale.y = 0.009;
    arrow.points = vec![(&from).into(), (&(from + along)).into()];
    arrow
}
