//! An arm with its sensor, tool and camera as a URDF, drawn with cylinders, spheres and boxes.
//!
//! Published by the services as `/robot_description` and printed by `tangent model urdf`. Frames
//! and joints are those of [`Chain`]; the shapes only show where the links are and are no collision
//! model.

mod shapes;
mod xml;

use nalgebra::Isometry3;

use crate::model::{ModelData, ModelError};
use crate::{Camera, Chain, Flange, Pose, Sensor, Tip, Tool};

use shapes::{Colour, Shape, Sizes};
use xml::Robot;

/// What is mounted on the flange. A part that is `None` has no link.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::urdf::Mounted;
/// use tangent_mechanics::{Pose, Tip};
/// let mounted = Mounted {
///     flange_from_tool: Some(Pose::new(Vector3::z() * 0.15, UnitQuaternion::identity())),
///     tip: Tip::Round { radius_m: 0.01 },
///     ..Mounted::default()
/// };
/// assert!(mounted.flange_from_camera.is_none());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounted {
    /// Pose of the force/torque sensor.
    pub flange_from_sensor: Option<Pose<Flange, Sensor>>,
    /// Pose of the tool: origin at its contact point, z out of the tool.
    pub flange_from_tool: Option<Pose<Flange, Tool>>,
    /// Pose of the camera: z forward, x right and y down in the image.
    pub flange_from_camera: Option<Pose<Flange, Camera>>,
    /// Shape of the tool's tip.
    pub tip: Tip,
}

impl Mounted {
    /// Name and pose on the flange of each part.
    pub fn frames(&self) -> impl Iterator<Item = (&'static str, Isometry3<f64>)> + use<> {
        [
            (
                "sensor",
                self.flange_from_sensor.map(|pose| *pose.isometry()),
            ),
            ("tool", self.flange_from_tool.map(|pose| *pose.isometry())),
            (
                "camera",
                self.flange_from_camera.map(|pose| *pose.isometry()),
            ),
        ]
        .into_iter()
        .filter_map(|(name, pose)| Some((name, pose?)))
    }
}

/// The URDF of an arm and what it carries. The root link is `base`; then follow the links of the
/// model, `flange`, and `sensor`, `tool` and `camera` on it, if they are mounted.
///
/// A joint limit that the manufacturer does not publish is written as -1.
///
/// ```
/// use tangent_mechanics::ModelData;
/// use tangent_mechanics::urdf::{Mounted, urdf};
///
/// let text = urdf(&ModelData::builtin("panda")?, &Mounted::default())?;
/// assert!(text.contains("<link name=\"panda_link7\">"));
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
///
/// # Errors
/// A value of the model is not allowed.
pub fn urdf(model: &ModelData, mounted: &Mounted) -> Result<String, ModelError> {
    let chain = Chain::new(model)?;
    let sizes = Sizes::of(&chain);
    let mut robot = Robot::new(&model.name);
    robot.link("base", &shapes::base(&sizes), None);
    let mut parent = "base";
    for (i, link) in chain.links().iter().enumerate() {
        robot.link(&link.name, &shapes::link(&sizes, &chain, i), Some(link));
        robot.revolute(parent, link, &limit(model, i));
        parent = &link.name;
    }
    robot.link("flange", &shapes::flange(&sizes), None);
    robot.fixed(parent, "flange", &chain.last_from_flange());
    for (name, pose) in mounted.frames() {
        let drawn: Vec<(Shape, Colour)> = match name {
            "sensor" => shapes::sensor(&sizes, &pose),
            "tool" => shapes::tool(&sizes, mounted, &pose),
            _ => shapes::camera(),
        };
        robot.link(name, &drawn, None);
        robot.fixed("flange", name, &pose);
    }
    Ok(robot.finish())
}

/// Limits of one joint: rad, rad/s and Nm.
struct Limit {
    lower: f64,
    upper: f64,
    velocity: f64,
    effort: f64,
}

fn limit(model: &ModelData, i: usize) -> Limit {
    let limits = &model.limits;
    Limit {
        lower: limits.position_lower_rad[i],
        upper: limits.position_upper_rad[i],
        velocity: limits.velocity_rad_per_s[i],
        effort: limits.effort_nm.as_ref().map_or(-1.0, |effort| effort[i]),
    }
}

#[cfg(test)]
mod tests;
