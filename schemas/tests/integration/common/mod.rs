//! Shared by the tests: the list of all messages, and the shape of a type in serde.
#![allow(dead_code, unused_macros, unused_imports)]

pub mod sample;
pub mod trace;

/// Calls a generic function once for each message type.
macro_rules! for_every_message {
    ($check:ident, $argument:expr) => {
        $crate::common::for_every_message!(@ $check, $argument,
            tangent_schemas::standard: Time Duration Header ColorRGBA Vector3 Point Quaternion Pose PoseStamped
                PoseWithCovariance PoseWithCovarianceStamped Twist Wrench WrenchStamped Transform TransformStamped TFMessage CompressedImage Image CameraInfo RegionOfInterest JointState UVCoordinate MeshFile
                Marker MarkerArray StdString;
            tangent_schemas::tangent: ArmState ArmCommand WrenchBatch WrenchStatus NormalEstimate ObjectEstimate SurfaceSegment SurfaceAhead Feature FeatureArray ControlState CoverageState ShapingState Health ContactTruth OperatorCommand
                Request Answer;
        )
    };
    (@ $check:ident, $argument:expr, $($a:ident::$b:ident: $($name:ident)*;)*) => {
        $($($check::<$a::$b::$name>($argument);)*)*
    };
}
pub(crate) use for_every_message;
