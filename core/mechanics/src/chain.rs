//! An arm's links as a chain of named frames, for programs that show or describe an arm.
//!
//! The frames of `/tf` and the links of the URDF are both taken from here, so that their names and
//! poses agree. The number of joints is known at run time only; control uses [`crate::Arm`].

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::arm::{Step, links_of};
use crate::model::{ModelData, ModelError};

/// Names of the frames of a cell, which no link of an arm may have.
pub const CELL_FRAMES: [&str; 8] = [
    "world", "base", "flange", "sensor", "tool", "contact", "camera", "object",
];
/// Longest name of a frame in a message, bytes.
const NAME_MAX: usize = 32;

/// One moving link and the joint that carries it. The link's frame lies in the joint, with z along
/// its axis, and turns with it.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainLink {
    /// Name of the link's frame: that of the model, as far as a frame may have it.
    pub name: String,
    /// Name of the joint.
    pub joint: String,
    /// Pose of the link's frame in the frame before it, at joint angle zero.
    pub parent_from_link: Isometry3<f64>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, link frame, m.
    pub com_m: Vector3<f64>,
    /// Inertia about the centre of mass, axes of the link frame, kg m².
    pub inertia_kg_m2: Matrix3<f64>,
}

/// The frames of an arm from the base to the flange.
///
/// ```
/// use tangent_mechanics::{Arm, Chain, ModelData};
///
/// let model = ModelData::builtin("ur5e")?;
/// let (chain, arm) = (Chain::new(&model)?, Arm::<6>::new(&model)?);
/// assert_eq!(chain.links()[2].name, "forearm_link");
///
/// let home = arm.home();
/// let flange = chain.base_from_flange(home.as_slice());
/// let expected = arm.base_from_flange(&home);
/// assert!((flange.translation.vector - expected.translation()).norm() < 1e-9);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    links: Vec<ChainLink>,
    last_from_flange: Isometry3<f64>,
}

impl Chain {
    /// Checks `model` and computes its frames.
    ///
    /// # Errors
    /// A value of the model is not allowed.
    pub fn new(model: &ModelData) -> Result<Self, ModelError> {
        model.validate()?;
        let (steps, flange) = links_of(model);
        let mut links: Vec<ChainLink> = Vec::with_capacity(steps.len());
        // A frame that moves along its joint's axis describes the same arm.
        let joint_z_m = |i: usize| model.joint_from_origin_m.get(i).copied().unwrap_or(0.0);
        let mut before_m = 0.0;
        for (i, (step, body)) in steps.iter().enumerate() {
            let offset = Vector3::z() * model.dh.rows[i].theta_offset_rad;
            let at_zero = along_z(-before_m)
                * isometry(step)
                * UnitQuaternion::from_scaled_axis(offset)
                * along_z(joint_z_m(i));
            before_m = joint_z_m(i);
            // The body is given in the joint's frame after its turn, which includes the offset.
            links.push(ChainLink {
                name: frame_name(&model.links[i].name, i, &links),
                joint: plain(&model.joint_names[i]),
                parent_from_link: at_zero,
                mass_kg: body.mass,
                com_m: body.com - Vector3::z() * before_m,
                inertia_kg_m2: body.inertia,
            });
        }
        Ok(Self {
            links,
            last_from_flange: along_z(-before_m) * isometry(&flange),
        })
    }

    /// The links, base to flange.
    pub fn links(&self) -> &[ChainLink] {
        &self.links
    }

    /// Pose of link `i` in the frame before it at the angle `q` (rad) of its joint. Links are
    /// counted from 0; the frame before the first is the base.
    ///
    /// # Panics
    /// There is no such link.
    pub fn parent_from_link(&self, i: usize, q: f64) -> Isometry3<f64> {
        self.links[i].parent_from_link * UnitQuaternion::from_scaled_axis(Vector3::z() * q)
    }

    /// Pose of the flange in the last link's frame.
    pub fn last_from_flange(&self) -> Isometry3<f64> {
        self.last_from_flange
    }

    /// Pose of the flange at the joint angles `q`, rad. Missing angles count as zero.
    pub fn base_from_flange(&self, q: &[f64]) -> Isometry3<f64> {
        let links = (0..self.links.len())
            .map(|i| self.parent_from_link(i, q.get(i).copied().unwrap_or(0.0)))
            .fold(Isometry3::identity(), |base, link| base * link);
        links * self.last_from_flange
    }

    /// Where the next joint, or the flange, lies in the frame of link `i`, m.
    pub(crate) fn far_end(&self, i: usize) -> Vector3<f64> {
        match self.links.get(i + 1) {
            Some(next) => next.parent_from_link.translation.vector,
            None => self.last_from_flange.translation.vector,
        }
    }
}

fn isometry(step: &Step) -> Isometry3<f64> {
    // Files are often rounded to six digits; the nearest rotation is meant.
    let rotation = Rotation3::from_matrix(&step.rotation);
    Isometry3::from_parts(
        Translation3::from(step.origin),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

fn along_z(distance_m: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, distance_m)
}

/// The name with every character that a name in an XML file or a topic may not have replaced.
fn plain(name: &str) -> String {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    name.chars()
        .map(|c| if good(c) { c } else { '_' })
        .collect()
}

/// The link's own name, if no other frame has it and it fits into a message.
fn frame_name(name: &str, i: usize, others: &[ChainLink]) -> String {
    let name = plain(name);
    let taken = CELL_FRAMES.contains(&name.as_str()) || others.iter().any(|o| o.name == name);
    if name.is_empty() || taken || name.len() > NAME_MAX {
        format!("arm_link_{}", i + 1)
    } else {
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_clash_or_do_not_fit_are_replaced() {
        let mut model = ModelData::builtin("ur5e").unwrap();
        model.links[1].name = "tool".to_owned();
        model.links[2].name = model.links[0].name.clone();
        model.links[3].name = "x".repeat(33);
        model.links[4].name = "wrist 2 <b>".to_owned();
        let chain = Chain::new(&model).unwrap();
        let names: Vec<&str> = chain.links().iter().map(|l| l.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "shoulder_link",
                "arm_link_2",
                "arm_link_3",
                "arm_link_4",
                "wrist_2__b_",
                "wrist_3_link"
            ]
        );
    }

    /// The built-in models have no names that must be replaced.
    #[test]
    fn built_in_links_keep_their_names() {
        for name in ModelData::builtin_names() {
            let model = ModelData::builtin(name).unwrap();
            let chain = Chain::new(&model).unwrap();
            for (link, data) in chain.links().iter().zip(&model.links) {
                assert_eq!(link.name, data.name, "{name}");
            }
        }
    }
}
