//! A robot as plain data: Denavit-Hartenberg table, link masses, limits, and where each figure
//! comes from.
//!
//! Built-in robots are the files in `models/`, compiled in; a robot of one's own is one more such
//! file, read by the caller and handed over as text. [`crate::Arm`] is computed from this once.

mod error;
mod validate;

use serde::{Deserialize, Serialize};

pub use error::ModelError;

/// Most joints that a model may have.
pub const DOF_MAX: usize = 8;

const BUILTIN: [(&str, &str); 12] = [
    ("ur3", include_str!("../../models/ur3.toml")),
    ("ur3e", include_str!("../../models/ur3e.toml")),
    ("ur5", include_str!("../../models/ur5.toml")),
    ("ur5e", include_str!("../../models/ur5e.toml")),
    ("ur10", include_str!("../../models/ur10.toml")),
    ("ur10e", include_str!("../../models/ur10e.toml")),
    ("ur16e", include_str!("../../models/ur16e.toml")),
    ("ur20", include_str!("../../models/ur20.toml")),
    ("ur30", include_str!("../../models/ur30.toml")),
    ("panda", include_str!("../../models/panda.toml")),
    (
        "smart3s_substitute",
        include_str!("../../models/smart3s_substitute.toml"),
    ),
    ("planar2", include_str!("../../models/planar2.toml")),
];

/// One robot arm with revolute joints, as its data file says. SI units, radians, joints ordered
/// base to flange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelData {
    /// Short name, as configurations refer to it.
    pub name: String,
    /// Maker and type, for people.
    pub title: String,
    /// Number of joints, 1 to [`DOF_MAX`].
    pub dof: usize,
    /// Names of the joints, base to flange.
    pub joint_names: Vec<String>,
    /// In words: which frame of the robot `Base` is.
    pub base: String,
    /// In words: which frame of the robot `Flange` is.
    pub flange: String,
    /// Acceleration of gravity in base axes, m/s²; (0, 0, -9.81) for an arm on the floor.
    pub gravity_m_per_s2: [f64; 3],
    /// A pose to start from, within the limits.
    pub home_rad: Vec<f64>,
    /// Where the figures come from.
    #[serde(default)]
    pub sources: Vec<String>,
    /// Which figures are somebody's guess.
    #[serde(default)]
    pub assumed: Vec<String>,
    /// What a user of the figures should know.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The geometry.
    pub dh: DhTable,
    /// What the joints may do.
    pub limits: LimitsData,
    /// The moving bodies, base to flange; the fixed base is not one of them.
    pub links: Vec<LinkData>,
    /// Known poses close to a singularity, for tests.
    #[serde(default)]
    pub near_singular: Vec<NearSingular>,
}

/// Which of the two Denavit-Hartenberg conventions a table follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DhConvention {
    /// T(i-1,i) = RotZ(q_i + offset) TransZ(d) TransX(a) RotX(alpha): frame i at the far end of
    /// link i.
    Standard,
    /// T(i-1,i) = RotX(alpha) TransX(a) RotZ(q_i + offset) TransZ(d) (Craig): frame i at joint i.
    Modified,
}

/// base_from_flange = base_from_dh0 · T(0,1) ⋯ T(n-1,n) · dhn_from_flange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhTable {
    /// How a row becomes a transform.
    pub convention: DhConvention,
    /// Homogeneous transform, rows of the matrix; identity if left out.
    #[serde(default = "identity")]
    pub base_from_dh0: [[f64; 4]; 4],
    /// Homogeneous transform, rows of the matrix; identity if left out.
    #[serde(default = "identity")]
    pub dhn_from_flange: [[f64; 4]; 4],
    /// One row per joint.
    pub rows: Vec<DhRow>,
}

/// One joint's Denavit-Hartenberg parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhRow {
    /// Length along x, m.
    pub a_m: f64,
    /// Twist about x, rad.
    pub alpha_rad: f64,
    /// Offset along z, m.
    pub d_m: f64,
    /// Added to the joint's angle, rad.
    #[serde(default)]
    pub theta_offset_rad: f64,
}

/// A rigid body that moves with one joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkData {
    /// The link's name.
    pub name: String,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the DH frame that is fixed to this link, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, axes parallel to that DH frame, kg m².
    pub inertia_kg_m2: [[f64; 3]; 3],
}

/// Limits of the joints; all but position are symmetric. A key that is left out was not published.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitsData {
    /// Lowest angle, rad.
    pub position_lower_rad: Vec<f64>,
    /// Highest angle, rad.
    pub position_upper_rad: Vec<f64>,
    /// Highest speed, rad/s.
    pub velocity_rad_per_s: Vec<f64>,
    /// Highest acceleration, rad/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_rad_per_s2: Option<Vec<f64>>,
    /// Highest jerk, rad/s³.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jerk_rad_per_s3: Option<Vec<f64>>,
    /// Highest torque, Nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort_nm: Option<Vec<f64>>,
    /// Highest change of torque, Nm/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort_rate_nm_per_s: Option<Vec<f64>>,
}

/// A pose close to a singularity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NearSingular {
    /// What is nearly aligned.
    pub id: String,
    /// Joint angles, rad.
    pub q_rad: Vec<f64>,
}

impl ModelData {
    /// Reads and checks a model file's text (TOML).
    pub fn from_toml(text: &str) -> Result<Self, ModelError> {
        let model: Self = toml::from_str(text).map_err(|error| ModelError::Syntax {
            message: error.to_string(),
        })?;
        model.validate()?;
        Ok(model)
    }

    /// A built-in robot by name, one of [`ModelData::builtin_names`].
    pub fn builtin(name: &str) -> Result<Self, ModelError> {
        let (_, text) = BUILTIN
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| ModelError::Unknown {
                name: name.to_owned(),
                known: Self::builtin_names().collect::<Vec<_>>().join(", "),
            })?;
        Self::from_toml(text)
    }

    /// Names of the built-in robots.
    pub fn builtin_names() -> impl Iterator<Item = &'static str> {
        BUILTIN.iter().map(|(name, _)| *name)
    }

    /// The text of a built-in robot's file: a start for a robot of one's own.
    pub fn builtin_text(name: &str) -> Option<&'static str> {
        BUILTIN
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, text)| *text)
    }

    /// Checks what the types cannot: lengths, signs, limits the right way round, inertias of real
    /// bodies.
    pub fn validate(&self) -> Result<(), ModelError> {
        validate::validate(self)
    }
}

fn identity() -> [[f64; 4]; 4] {
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)))
}

#[cfg(test)]
mod tests;
