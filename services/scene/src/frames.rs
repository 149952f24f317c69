//! The tree of frames: `world`, `base`, the links, `flange`, and `sensor`, `tool` and `camera` on
//! it; `contact` on the base.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use tangent_mechanics::{Base, Chain, Pose, Tool, World};
use tangent_schemas::convert::cut;
use tangent_schemas::standard::{self, Header, JointState, TFMessage, Transform, TransformStamped};
use tangent_schemas::tangent::ArmState;

use crate::config::SceneConfig;

/// Frames of one arm.
pub struct Frames {
    chain: Chain,
    /// Parent, child and pose of the frames that are fixed to each other.
    fixed: Vec<(String, &'static str, Isometry3<f64>)>,
}

impl Frames {
    pub fn new(config: &SceneConfig) -> Self {
        let chain = config.chain.clone();
        let last = chain.links().last().map_or("base", |link| &link.name);
        let mut fixed = vec![(last.to_owned(), "flange", chain.last_from_flange())];
        let mounted = config.mounted.frames();
        fixed.extend(mounted.map(|(name, pose)| ("flange".to_owned(), name, pose)));
        Self { chain, fixed }
    }

    /// `/tf_static`: the flange on the last link, and what is mounted on it.
    pub fn fixed(&self, stamp: i64) -> TFMessage {
        let transforms = self.fixed.iter();
        TFMessage {
            transforms: transforms
                .map(|(parent, child, pose)| transform(stamp, parent, child, pose))
                .collect(),
        }
    }

    /// Each link in the one before it, at the joint angles `q`, rad.
    pub fn links(&self, stamp: i64, q: &[f64]) -> Vec<TransformStamped> {
        let mut parent = "base";
        let links = self.chain.links().iter().zip(q).enumerate();
        links
            .map(|(i, (link, &angle))| {
                let pose = self.chain.parent_from_link(i, angle);
                let one = transform(stamp, parent, &link.name, &pose);
                parent = &link.name;
                one
            })
            .collect()
    }

    /// `/joint_states`. The efforts are left out: not every arm measures them.
    pub fn joints(&self, arm: &ArmState) -> JointState {
        let links = self.chain.links().iter();
        JointState {
            header: arm.header.clone(),
            name: links.map(|link| link.joint.clone()).collect(),
            position: arm.q.to_vec(),
            velocity: arm.qd.to_vec(),
            effort: Vec::new(),
        }
    }
}

/// The base in the world.
pub fn base(stamp: i64, world_from_base: &Pose<World, Base>) -> TransformStamped {
    transform(stamp, "world", "base", world_from_base.isometry())
}

/// Frame with its origin at the tool, z along the normal in use, and x as near as possible to the
/// tool's x.
pub fn contact(
    stamp: i64,
    base_from_tool: &Pose<Base, Tool>,
    normal: &standard::Vector3,
) -> Option<TransformStamped> {
    let z = Vector3::from(normal).try_normalize(1e-6)?;
    let x = base_from_tool.rotate(&Vector3::x());
    let x = (x - z * x.dot(&z)).try_normalize(1e-6)?;
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let pose = Isometry3::from_parts(
        base_from_tool.translation().into(),
        UnitQuaternion::from_rotation_matrix(&axes),
    );
    Some(transform(stamp, "base", "contact", &pose))
}

fn transform(stamp: i64, parent: &str, child: &str, pose: &Isometry3<f64>) -> TransformStamped {
    TransformStamped {
        header: Header::new(stamp, parent),
        child_frame_id: cut(child),
        transform: Transform {
            translation: (&pose.translation.vector).into(),
            rotation: (&pose.rotation).into(),
        },
    }
}
