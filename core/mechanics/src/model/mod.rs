//! A robot as plain data: Denavit-Hartenberg table, link masses, limits, and the sources of the
//! figures.
//!
//! Built-in robots are the files in `models/`, compiled in. Another robot is one more such file,
//! which the caller reads and passes as text. An [`Arm`](crate::Arm) is computed from this once.

mod calibration;
mod error;
mod validate;

use serde::{Deserialize, Serialize};

pub use calibration::CalibrationError;
pub use error::ModelError;

/// Largest number of joints of a model.
pub const DOF_MAX: usize = 8;

const BUILTIN: [(&str, &str); 16] = [
    ("ur3", include_str!("../../models/ur3.toml")),
    ("ur3e", include_str!("../../models/ur3e.toml")),
    ("ur5", include_str!("../../models/ur5.toml")),
    ("ur5e", include_str!("../../models/ur5e.toml")),
    ("ur7e", include_str!("../../models/ur7e.toml")),
    ("ur10", include_str!("../../models/ur10.toml")),
    ("ur10e", include_str!("../../models/ur10e.toml")),
    ("ur12e", include_str!("../../models/ur12e.toml")),
    ("ur15", include_str!("../../models/ur15.toml")),
    ("ur16e", include_str!("../../models/ur16e.toml")),
    ("ur18", include_str!("../../models/ur18.toml")),
    ("ur20", include_str!("../../models/ur20.toml")),
    ("ur30", include_str!("../../models/ur30.toml")),
    ("panda", include_str!("../../models/panda.toml")),
    (
        "smart3s_substitute",
        include_str!("../../models/smart3s_substitute.toml"),
    ),
    ("planar2", include_str!("../../models/planar2.toml")),
];

/// Data of a robot arm with revolute joints, as in its file. SI units, radians, joints ordered base
/// to flange.
///
/// ```
/// use tangent_mechanics::ModelData;
///
/// let ur5e = ModelData::builtin("ur5e")?;
/// assert_eq!(ur5e.dof, 6);
/// assert_eq!(ur5e.dh.rows.len(), ur5e.links.len());
/// assert!(ur5e.limits.effort_nm.is_some());
///
/// // A custom robot starts from the text of a built-in one.
/// let text = ModelData::builtin_text("ur5e").expect("is built in");
/// let custom = ModelData::from_toml(&text.replace("name = \"ur5e\"", "name = \"my_arm\""))?;
/// assert_eq!(custom.name, "my_arm");
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelData {
    /// Short name, used in configurations.
    pub name: String,
    /// Manufacturer and type, for display.
    pub title: String,
    /// Number of joints, 1 to [`DOF_MAX`].
    pub dof: usize,
    /// Names of the joints, base to flange.
    pub joint_names: Vec<String>,
    /// Description of the frame that [`Base`](crate::Base) stands for.
    pub base: String,
    /// Description of the frame that [`Flange`](crate::Flange) stands for.
    pub flange: String,
    /// Acceleration of gravity in base axes, m/s²; (0, 0, -9.81) for an arm on the floor.
    pub gravity_m_per_s2: [f64; 3],
    /// Default start pose, within the limits.
    pub home_rad: Vec<f64>,
    /// Sources of the figures.
    #[serde(default)]
    pub sources: Vec<String>,
    /// Figures that are assumptions.
    #[serde(default)]
    pub assumed: Vec<String>,
    /// Notes for users of the figures.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Geometry.
    pub dh: DhTable,
    /// Limits of the joints.
    pub limits: LimitsData,
    /// Moving bodies, base to flange, without the fixed base.
    pub links: Vec<LinkData>,
    /// Known poses close to a singularity, for tests.
    #[serde(default)]
    pub near_singular: Vec<NearSingular>,
    /// Distance along each joint's axis from the origin of its frame to the joint itself, m. Empty
    /// or zero, except after a factory calibration: [`calibrated`](Self::calibrated) sets it.
    #[serde(skip)]
    pub joint_from_origin_m: Vec<f64>,
}

/// Denavit-Hartenberg convention of a table.
///
/// ```
/// use tangent_mechanics::ModelData;
/// use tangent_mechanics::model::DhConvention;
/// assert_eq!(ModelData::builtin("ur5e")?.dh.convention, DhConvention::Standard);
/// assert_eq!(ModelData::builtin("panda")?.dh.convention, DhConvention::Modified);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DhConvention {
    /// T(i-1,i) = RotZ(q_i + offset) TransZ(d) TransX(a) RotX(alpha): frame i at the far end of
    /// link i.
    Standard,
    /// T(i-1,i) = RotX(alpha) TransX(a) RotZ(q_i + offset) TransZ(d) (Craig): frame i at joint i.
    Modified,
}

/// Denavit-Hartenberg table: `base_from_flange = base_from_dh0 · T(0,1) ⋯ T(n-1,n) ·
/// dhn_from_flange`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhTable {
    /// Convention by which a row becomes a transform.
    pub convention: DhConvention,
    /// Homogeneous transform from the first DH frame to the base, row by row; identity if left out.
    #[serde(default = "identity")]
    pub base_from_dh0: [[f64; 4]; 4],
    /// Homogeneous transform from the flange to the last DH frame, row by row; identity if left
    /// out.
    #[serde(default = "identity")]
    pub dhn_from_flange: [[f64; 4]; 4],
    /// One row per joint.
    pub rows: Vec<DhRow>,
}

/// Denavit-Hartenberg parameters of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhRow {
    /// Length along x, m.
    pub a_m: f64,
    /// Twist about x, rad.
    pub alpha_rad: f64,
    /// Offset along z, m.
    pub d_m: f64,
    /// Offset that is added to the joint's angle, rad.
    #[serde(default)]
    pub theta_offset_rad: f64,
}

/// A rigid body that moves with one joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkData {
    /// Name of the link.
    pub name: String,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the DH frame that is fixed to this link, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, axes parallel to that DH frame, kg m².
    pub inertia_kg_m2: [[f64; 3]; 3],
}

/// Limits of the joints. All except those of position are symmetric. A key is left out if the
/// manufacturer does not publish the limit.
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
    /// Highest rate of change of torque, Nm/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort_rate_nm_per_s: Option<Vec<f64>>,
}

/// A pose close to a singularity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NearSingular {
    /// Name: what is nearly aligned.
    pub id: String,
    /// Joint angles, rad.
    pub q_rad: Vec<f64>,
}

impl ModelData {
    /// Reads and checks the text of a model file (TOML).
    ///
    /// # Errors
    /// The text is not a model file, or a value is not allowed.
    pub fn from_toml(text: &str) -> Result<Self, ModelError> {
        let model: Self = toml::from_str(text).map_err(|error| ModelError::Syntax {
            message: error.to_string(),
        })?;
        model.validate()?;
        Ok(model)
    }

    /// Built-in robot by name, one of [`ModelData::builtin_names`].
    ///
    /// # Errors
    /// There is no such robot.
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

    /// Text of the file of a built-in robot: a template for a custom one. `None` if there is no
    /// such robot.
    pub fn builtin_text(name: &str) -> Option<&'static str> {
        BUILTIN
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, text)| *text)
    }

    /// Checks what the types cannot: lengths, signs, order of the limits, and inertias that a rigid
    /// body can have.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), ModelError> {
        validate::validate(self)
    }
}

fn identity() -> [[f64; 4]; 4] {
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)))
}

#[cfg(test)]
mod tests;
