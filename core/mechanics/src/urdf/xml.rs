//! The text of a URDF, element by element.

use std::fmt::Write;

use nalgebra::{Isometry3, Vector3};

use super::Limit;
use super::shapes::{Colour, Shape};
use crate::chain::ChainLink;

/// A URDF that grows.
pub struct Robot {
    text: String,
}

impl Robot {
    /// The head and the materials.
    pub fn new(name: &str) -> Self {
        let mut robot = Self {
            text: String::new(),
        };
        robot.line("<?xml version=\"1.0\"?>");
        robot.line(&format!("<robot name=\"{}\">", escaped(name)));
        for colour in Colour::ALL {
            let [r, g, b] = colour.rgb();
            robot.line(&format!(
                "  <material name=\"{}\"><color rgba=\"{r} {g} {b} 1\"/></material>",
                colour.name()
            ));
        }
        robot
    }

    /// A link with its shapes, and its mass if it is known.
    pub fn link(&mut self, name: &str, shapes: &[(Shape, Colour)], body: Option<&ChainLink>) {
        self.line(&format!("  <link name=\"{}\">", escaped(name)));
        if let Some(body) = body {
            self.inertial(body);
        }
        for (shape, colour) in shapes {
            self.visual(shape, *colour);
        }
        self.line("  </link>");
    }

    fn inertial(&mut self, body: &ChainLink) {
        let i = &body.inertia_kg_m2;
        self.line(&format!(
            "    <inertial><origin xyz=\"{}\"/><mass value=\"{}\"/><inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" \
             iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/></inertial>",
            vector(&body.com_m),
            body.mass_kg,
            i[(0, 0)],
            i[(0, 1)],
            i[(0, 2)],
            i[(1, 1)],
            i[(1, 2)],
            i[(2, 2)]
        ));
    }

    fn visual(&mut self, shape: &Shape, colour: Colour) {
        let (at, geometry) = match shape {
            Shape::Cylinder {
                link_from_shape,
                radius_m,
                length_m,
            } => (
                *link_from_shape,
                format!(
                    "<cylinder radius=\"{}\" length=\"{}\"/>",
                    short(*radius_m),
                    short(*length_m)
                ),
            ),
            Shape::Sphere { middle_m, radius_m } => (
                Isometry3::from_parts((*middle_m).into(), nalgebra::UnitQuaternion::identity()),
                format!("<sphere radius=\"{}\"/>", short(*radius_m)),
            ),
            Shape::Box {
                link_from_shape,
                size_m,
            } => (
                *link_from_shape,
                format!("<box size=\"{}\"/>", vector(size_m)),
            ),
        };
        self.line(&format!(
            "    <visual>{}<geometry>{geometry}</geometry><material name=\"{}\"/></visual>",
            shape_origin(&at),
            colour.name()
        ));
    }

    /// The joint that carries a link of the arm.
    pub fn revolute(&mut self, parent: &str, link: &ChainLink, limit: &Limit) {
        self.joint(
            "revolute",
            &link.joint,
            (parent, &link.name),
            &link.parent_from_link,
        );
        self.line(&format!(
            "    <axis xyz=\"0 0 1\"/><limit lower=\"{}\" upper=\"{}\" velocity=\"{}\" effort=\"{}\"/>",
            limit.lower, limit.upper, limit.velocity, limit.effort
        ));
        self.line("  </joint>");
    }

    /// A part that is fixed to a link.
    pub fn fixed(&mut self, parent: &str, child: &str, parent_from_child: &Isometry3<f64>) {
        let name = format!("{parent}_to_{child}");
        self.joint("fixed", &name, (parent, child), parent_from_child);
        self.line("  </joint>");
    }

    fn joint(
        &mut self,
        kind: &str,
        name: &str,
        (parent, child): (&str, &str),
        origin: &Isometry3<f64>,
    ) {
        let (roll, pitch, yaw) = origin.rotation.euler_angles();
        self.line(&format!(
            "  <joint name=\"{}\" type=\"{kind}\">",
            escaped(name)
        ));
        self.line(&format!(
            "    <parent link=\"{}\"/><child link=\"{}\"/>",
            escaped(parent),
            escaped(child)
        ));
        self.line(&format!(
            "    <origin xyz=\"{}\" rpy=\"{roll} {pitch} {yaw}\"/>",
            vector(&origin.translation.vector)
        ));
    }

    /// The whole text.
    pub fn finish(mut self) -> String {
        self.line("</robot>");
        self.text
    }

    fn line(&mut self, line: &str) {
        writeln!(self.text, "{line}").expect("a string grows without an error");
    }
}

/// Where a shape lies in its link, to a micrometre and a microradian; nothing at the origin.
fn shape_origin(at: &Isometry3<f64>) -> String {
    let (roll, pitch, yaw) = at.rotation.euler_angles();
    let xyz = at.translation.vector;
    if [xyz.x, xyz.y, xyz.z, roll, pitch, yaw]
        .iter()
        .all(|x| x.abs() < 1e-9)
    {
        return String::new();
    }
    let list = |a: [f64; 3]| a.map(short).join(" ");
    let (xyz, rpy) = (list(xyz.into()), list([roll, pitch, yaw]));
    format!("<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>")
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{} {} {}", v.x, v.y, v.z)
}

/// With six digits behind the point, without trailing zeros.
fn short(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

impl Colour {
    const ALL: [Self; 5] = [
        Self::Tube,
        Self::Joint,
        Self::Metal,
        Self::Tool,
        Self::Camera,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Tube => "tube",
            Self::Joint => "joint",
            Self::Metal => "metal",
            Self::Tool => "tool",
            Self::Camera => "camera",
        }
    }

    fn rgb(self) -> [f64; 3] {
        match self {
            Self::Tube => [0.82, 0.84, 0.86],
            Self::Joint => [0.22, 0.36, 0.48],
            Self::Metal => [0.55, 0.56, 0.58],
            Self::Tool => [0.90, 0.62, 0.16],
            Self::Camera => [0.12, 0.12, 0.14],
        }
    }
}
