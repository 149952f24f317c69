//! Checks of a robot model that its types cannot make.

use nalgebra::{Matrix3, Matrix4};

use super::{DOF_MAX, ModelData, ModelError};

/// Largest asymmetry of an inertia tensor, relative to its largest entry.
const ASYMMETRY_MAX: f64 = 1e-9;
/// Largest deviation of a rotation matrix from orthonormal. Files are often rounded to six digits.
const RIGID_MAX: f64 = 1e-6;

struct Check<'a>(&'a ModelData);

pub(super) fn validate(model: &ModelData) -> Result<(), ModelError> {
    let check = Check(model);
    if model.name.trim().is_empty() {
        return Err(check.error("name", "\"\"", "needs at least one letter"));
    }
    if !(1..=DOF_MAX).contains(&model.dof) {
        return Err(check.error("dof", model.dof, "must be a number of joints from 1 to 8"));
    }
    check.count("joint_names", model.joint_names.len())?;
    check.numbers("gravity_m_per_s2", &model.gravity_m_per_s2)?;
    check.dh()?;
    check.links()?;
    check.limits()?;
    check.poses()
}

impl Check<'_> {
    fn error(
        &self,
        key: impl Into<String>,
        value: impl ToString,
        allowed: &'static str,
    ) -> ModelError {
        ModelError::Value {
            model: self.0.name.clone(),
            key: key.into(),
            value: value.to_string(),
            allowed,
        }
    }

    fn count(&self, key: &str, found: usize) -> Result<(), ModelError> {
        if found == self.0.dof {
            return Ok(());
        }
        Err(ModelError::Length {
            model: self.0.name.clone(),
            key: key.to_owned(),
            found,
            dof: self.0.dof,
        })
    }

    fn numbers(&self, key: &str, values: &[f64]) -> Result<(), ModelError> {
        match values.iter().position(|x| !x.is_finite()) {
            None => Ok(()),
            Some(i) => Err(self.error(format!("{key}[{i}]"), values[i], "must be a finite number")),
        }
    }

    fn positive(&self, key: &str, values: &[f64]) -> Result<(), ModelError> {
        self.count(key, values.len())?;
        match values.iter().position(|x| !(x.is_finite() && *x > 0.0)) {
            None => Ok(()),
            Some(i) => Err(self.error(
                format!("{key}[{i}]"),
                values[i],
                "must be a finite number above 0",
            )),
        }
    }

    fn dh(&self) -> Result<(), ModelError> {
        let dh = &self.0.dh;
        self.count("dh.rows", dh.rows.len())?;
        for (i, row) in dh.rows.iter().enumerate() {
            let values = [row.a_m, row.alpha_rad, row.d_m, row.theta_offset_rad];
            self.numbers(&format!("dh.rows[{i}]"), &values)?;
        }
        self.rigid("dh.base_from_dh0", &dh.base_from_dh0)?;
        self.rigid("dh.dhn_from_flange", &dh.dhn_from_flange)
    }

    fn rigid(&self, key: &str, rows: &[[f64; 4]; 4]) -> Result<(), ModelError> {
        let matrix = Matrix4::from_fn(|i, j| rows[i][j]);
        let rotation = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        let error = (rotation.transpose() * rotation - Matrix3::identity()).amax();
        // Written so that NaN fails.
        let good = matrix.iter().all(|x| x.is_finite())
            && error <= RIGID_MAX
            && rotation.determinant() > 0.0
            && rows[3] == [0.0, 0.0, 0.0, 1.0];
        if good {
            return Ok(());
        }
        Err(self.error(
            key,
            format!("{rows:?}"),
            "must be a rigid transform: an orthonormal right-handed rotation, a translation, and last row 0, 0, 0, 1",
        ))
    }

    fn links(&self) -> Result<(), ModelError> {
        self.count("links", self.0.links.len())?;
        for (i, link) in self.0.links.iter().enumerate() {
            if !(link.mass_kg.is_finite() && link.mass_kg > 0.0) {
                return Err(self.error(
                    format!("links[{i}].mass_kg"),
                    link.mass_kg,
                    "must be a finite number above 0",
                ));
            }
            self.numbers(&format!("links[{i}].com_m"), &link.com_m)?;
            let key = format!("links[{i}].inertia_kg_m2");
            let inertia = Matrix3::from_fn(|r, c| link.inertia_kg_m2[r][c]);
            let shown = format!("{:?}", link.inertia_kg_m2);
            if inertia.iter().any(|x| !x.is_finite()) {
                return Err(self.error(key, shown, "must be finite numbers"));
            }
            if (inertia - inertia.transpose()).amax() > ASYMMETRY_MAX * inertia.amax() {
                return Err(self.error(
                    key,
                    shown,
                    "must be symmetric: entry [i][j] equal to entry [j][i]",
                ));
            }
            // Sylvester's criterion.
            let minor = inertia.fixed_view::<2, 2>(0, 0).determinant();
            if !(inertia[(0, 0)] > 0.0 && minor > 0.0 && inertia.determinant() > 0.0) {
                return Err(self.error(
                    key,
                    shown,
                    "must be positive definite, about the centre of mass (not about the joint)",
                ));
            }
        }
        Ok(())
    }

    fn limits(&self) -> Result<(), ModelError> {
        let limits = &self.0.limits;
        let (lower, upper) = (&limits.position_lower_rad, &limits.position_upper_rad);
        self.count("limits.position_lower_rad", lower.len())?;
        self.count("limits.position_upper_rad", upper.len())?;
        self.numbers("limits.position_lower_rad", lower)?;
        self.numbers("limits.position_upper_rad", upper)?;
        if let Some(i) = (0..self.0.dof).find(|&i| lower[i] >= upper[i]) {
            return Err(self.error(
                format!("limits.position_lower_rad[{i}]"),
                format!("{} (upper limit {})", lower[i], upper[i]),
                "must be below position_upper_rad of the same joint",
            ));
        }
        self.positive("limits.velocity_rad_per_s", &limits.velocity_rad_per_s)?;
        let optional = [
            (
                "limits.acceleration_rad_per_s2",
                &limits.acceleration_rad_per_s2,
            ),
            ("limits.jerk_rad_per_s3", &limits.jerk_rad_per_s3),
            ("limits.effort_nm", &limits.effort_nm),
            ("limits.effort_rate_nm_per_s", &limits.effort_rate_nm_per_s),
        ];
        for (key, values) in optional {
            if let Some(values) = values {
                self.positive(key, values)?;
            }
        }
        Ok(())
    }

    fn poses(&self) -> Result<(), ModelError> {
        let (limits, home) = (&self.0.limits, &self.0.home_rad);
        self.count("home_rad", home.len())?;
        for (i, q) in home.iter().enumerate() {
            if !(limits.position_lower_rad[i]..=limits.position_upper_rad[i]).contains(q) {
                return Err(self.error(
                    format!("home_rad[{i}]"),
                    q,
                    "must be within the position limits of its joint",
                ));
            }
        }
        for (i, pose) in self.0.near_singular.iter().enumerate() {
            let key = format!("near_singular[{i}].q_rad");
            self.count(&key, pose.q_rad.len())?;
            self.numbers(&key, &pose.q_rad)?;
        }
        Ok(())
    }
}
