//! The `.msg` files, and the schema text in a recording with which any viewer can read it.

/// 80 equals signs: separator between the definitions of a `ros2msg` schema.
const SEPARATOR: &str =
    "================================================================================";

macro_rules! files {
    ($($package:literal: $($name:literal)*;)*) => {
        /// All messages: `PACKAGE/msg/NAME` and the text of its file.
        pub const FILES: &[(&str, &str)] = &[$($((
            concat!($package, "/msg/", $name),
            include_str!(concat!("../msg/", $package, "/", $name, ".msg")),
        ),)*)*];
    };
}

files! {
    "builtin_interfaces": "Duration" "Time";
    "geometry_msgs": "Point" "Pose" "PoseStamped" "PoseWithCovariance" "PoseWithCovarianceStamped" "Quaternion" "Transform"
        "TransformStamped" "Twist" "Vector3" "Wrench" "WrenchStamped";
    "sensor_msgs": "CameraInfo" "CompressedImage" "Image" "JointState" "RegionOfInterest";
    "std_msgs": "ColorRGBA" "Header" "String";
    "tangent_msgs": "Answer" "ArmCommand" "ArmState" "ContactTruth" "ControlState" "CoverageState" "Feature" "FeatureArray"
        "Health" "NormalEstimate" "ObjectEstimate" "OperatorCommand" "Request" "ShapingState" "SurfaceAhead" "SurfaceSegment"
        "WrenchBatch" "WrenchStatus";
    "tf2_msgs": "TFMessage";
    "visualization_msgs": "Marker" "MarkerArray" "MeshFile" "UVCoordinate";
}

/// All services of our own: `PACKAGE/srv/NAME` and the text of its file.
pub const SERVICES: &[(&str, &str)] = &[
    (
        "tangent_msgs/srv/SelectEstimator",
        include_str!("../msg/tangent_msgs/SelectEstimator.srv"),
    ),
    (
        "tangent_msgs/srv/StartTask",
        include_str!("../msg/tangent_msgs/StartTask.srv"),
    ),
];

/// Text of a service's file.
pub fn service(name: &str) -> Option<&'static str> {
    let mut services = SERVICES.iter();
    services
        .find(|(known, _)| *known == name)
        .map(|(_, text)| *text)
}

/// Text of a message's own file.
pub fn file(name: &str) -> Option<&'static str> {
    FILES
        .iter()
        .find(|(known, _)| *known == name)
        .map(|(_, text)| *text)
}

/// Definition of a message followed, after separators, by those of all messages that it contains:
/// the schema that MCAP requires for the encoding `ros2msg`. `None` for an unknown message.
pub fn definition(name: &str) -> Option<String> {
    let mut text = file(name)?.to_owned();
    let mut known = vec![name.to_owned()];
    let mut next = 0;
    while next < known.len() {
        let current = known[next].clone();
        for field in fields(file(&current)?, package(&current)) {
            let Base::Message(dependency) = field.base else {
                continue;
            };
            if !known.contains(&dependency) {
                text.push_str(&format!(
                    "{SEPARATOR}\nMSG: {}\n{}",
                    dependency.replacen("/msg/", "/", 1),
                    file(&dependency)?
                ));
                known.push(dependency);
            }
        }
        next += 1;
    }
    Some(text)
}

fn package(name: &str) -> &str {
    name.split('/').next().unwrap_or_default()
}

/// Type of one value of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Base {
    /// A number, bool or string, by its name in the file.
    Primitive(String),
    /// Another message, `PACKAGE/msg/NAME`.
    Message(String),
}

/// Number of values of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// One value.
    One,
    /// Fixed number, given in the file.
    Fixed(usize),
    /// Any number.
    Sequence,
}

/// A field: one line of a `.msg` file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name of the field.
    pub name: String,
    /// Type of one value.
    pub base: Base,
    /// Number of values.
    pub count: Count,
}

/// Parses the fields of a `.msg` text; constants, comments and default values are skipped.
pub fn fields(text: &str, package: &str) -> Vec<Field> {
    text.lines()
        .filter_map(|line| field(line.split('#').next().unwrap_or_default(), package))
        .collect()
}

fn field(line: &str, package: &str) -> Option<Field> {
    let (kind, rest) = line.trim().split_once(char::is_whitespace)?;
    if rest.contains('=') {
        return None;
    }
    let name = rest.split_whitespace().next()?.to_owned();
    let (base, count) = match kind.split_once('[') {
        None => (kind, Count::One),
        Some((base, "]")) => (base, Count::Sequence),
        Some((base, length)) => (
            base,
            Count::Fixed(length.trim_end_matches(']').parse().ok()?),
        ),
    };
    let base = match base.split_once('/') {
        Some((package, name)) => Base::Message(format!("{package}/msg/{name}")),
        None if base.starts_with(|c: char| c.is_ascii_uppercase()) => {
            Base::Message(format!("{package}/msg/{base}"))
        }
        None => Base::Primitive(base.to_owned()),
    };
    Some(Field { name, base, count })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definition_holds_everything_it_is_made_of_once() {
        let text = definition("geometry_msgs/msg/WrenchStamped").unwrap();
        let parts: Vec<&str> = text
            .split(SEPARATOR)
            .skip(1)
            .map(|part| part.trim_start().lines().next().unwrap())
            .collect();
        assert_eq!(
            parts,
            [
                "MSG: std_msgs/Header",
                "MSG: geometry_msgs/Wrench",
                "MSG: builtin_interfaces/Time",
                "MSG: geometry_msgs/Vector3"
            ]
        );
        assert!(definition("nobody_msgs/msg/Nothing").is_none());
    }

    #[test]
    fn every_file_can_be_defined() {
        for (name, _) in FILES {
            assert!(definition(name).is_some(), "{name}");
        }
    }
}
