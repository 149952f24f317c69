//! Comparison of the arm models with numbers that another program computed.
//!
//! `tangent model check FILE` reads a file and passes its text to [`compare`], which returns a row
//! per model and quantity. The format is that of `tests/golden/golden.json`.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, SMatrix};
use serde::{Deserialize, Serialize};

use crate::{Arm, Joints, ModelData, ModelError};

/// Largest difference of one quantity of one model over all cases of a file.
///
/// ```
/// use tangent_mechanics::golden::compare;
/// // Arm `planar2` with both links stretched along x.
/// let text = r#"{"format_version": 1, "models": {"planar2": [
///     {"id": "stretched", "q": [0.0, 0.0], "gravity": [22.0725, 2.4525]}
/// ]}}"#;
/// let rows = compare(text, &[])?;
/// assert!(rows.iter().all(|row| row.agrees()));
/// # Ok::<(), tangent_mechanics::golden::GoldenError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The model's name.
    pub name: String,
    /// Key of the quantity in the file.
    pub quantity: &'static str,
    /// Largest absolute difference in a case, divided by the larger of 1 and its largest entry.
    pub max_relative_difference: f64,
    /// Number of cases compared.
    #[serde(skip)]
    pub cases: usize,
}

impl Row {
    /// Tolerance for rounding errors: 1e-10, and 1e-9 for `fd_qdd`, which is solved with a mass
    /// matrix of condition number up to 3e4.
    pub fn tolerance(&self) -> f64 {
        if self.quantity == "fd_qdd" {
            1e-9
        } else {
            1e-10
        }
    }

    /// Whether the difference is within [`Row::tolerance`].
    pub fn agrees(&self) -> bool {
        self.max_relative_difference <= self.tolerance()
    }
}

/// Why a file could not be compared. The caller adds the file's name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GoldenError {
    /// The file is not JSON, or has another structure.
    #[error("not a file of golden values: {message}")]
    Syntax {
        /// Message of the parser, with line and column.
        message: String,
    },
    /// The file has another version of the format.
    #[error("`format_version` is {found}; this program reads version 1")]
    Version {
        /// The version found.
        found: u64,
    },
    /// The file contains no quantity to compare.
    #[error("the file compares nothing: `models` holds no case with any of {QUANTITY_NAMES}")]
    Empty,
    /// A case does not fit its model.
    #[error("model `{model}`, case `{case}`: `{key}` {problem}")]
    Case {
        /// The model's name.
        model: String,
        /// The case's id.
        case: String,
        /// The key in the case.
        key: &'static str,
        /// The problem, and what is allowed.
        problem: String,
    },
    /// The file names a model that is neither built in nor given, or a given model is bad.
    #[error(transparent)]
    Model(#[from] ModelError),
}

const QUANTITY_NAMES: &str = "base_from_flange, jacobian, jdot_qd, mass_matrix, gravity, coriolis, tau, fd_qdd, kinetic_energy";

/// A file of golden values. Keys that are not compared, such as the source of the numbers, are
/// ignored.
#[derive(Deserialize)]
struct File {
    format_version: u64,
    models: BTreeMap<String, Vec<Case>>,
}

/// One pose and the quantities that were computed there. A quantity that is left out is not
/// compared.
#[derive(Deserialize)]
struct Case {
    id: String,
    q: Vec<f64>,
    qd: Option<Vec<f64>>,
    qdd: Option<Vec<f64>>,
    base_from_flange: Option<Vec<Vec<f64>>>,
    jacobian: Option<Vec<Vec<f64>>>,
    jdot_qd: Option<Vec<f64>>,
    mass_matrix: Option<Vec<Vec<f64>>>,
    gravity: Option<Vec<f64>>,
    coriolis: Option<Vec<f64>>,
    tau: Option<Vec<f64>>,
    fd_tau: Option<Vec<f64>>,
    fd_qdd: Option<Vec<f64>>,
    kinetic_energy: Option<f64>,
}

/// Compares every case of a file with the built-in models, or with those of the same name in `own`.
///
/// The rows are in the order of the models' names, then of the quantities.
///
/// # Errors
/// The text is not a file of golden values, or a case does not match its model.
pub fn compare(text: &str, own: &[ModelData]) -> Result<Vec<Row>, GoldenError> {
    let file: File = serde_json::from_str(text).map_err(|error| GoldenError::Syntax {
        message: error.to_string(),
    })?;
    if file.format_version != 1 {
        return Err(GoldenError::Version {
            found: file.format_version,
        });
    }
    let mut rows = Vec::new();
    for (name, cases) in &file.models {
        let model = match own.iter().find(|model| model.name == *name) {
            Some(model) => model.clone(),
            None => ModelData::builtin(name)?,
        };
        rows.extend(compare_model(&model, cases)?);
    }
    if rows.is_empty() {
        return Err(GoldenError::Empty);
    }
    Ok(rows)
}

fn compare_model(model: &ModelData, cases: &[Case]) -> Result<Vec<Row>, GoldenError> {
    match model.dof {
        1 => compare_cases::<1>(model, cases),
        2 => compare_cases::<2>(model, cases),
        3 => compare_cases::<3>(model, cases),
        4 => compare_cases::<4>(model, cases),
        5 => compare_cases::<5>(model, cases),
        6 => compare_cases::<6>(model, cases),
        7 => compare_cases::<7>(model, cases),
        _ => compare_cases::<8>(model, cases),
    }
}

fn compare_cases<const N: usize>(
    model: &ModelData,
    cases: &[Case],
) -> Result<Vec<Row>, GoldenError> {
    let arm = Arm::<N>::new(model)?;
    let mut rows = Vec::new();
    for case in cases {
        Comparison {
            arm: &arm,
            model: &model.name,
            case,
            rows: &mut rows,
        }
        .run()?;
    }
    // A case may hold more quantities than the first one did; the order stays that of the list.
    rows.sort_by_key(|row: &Row| QUANTITY_NAMES.find(row.quantity));
    Ok(rows)
}

struct Comparison<'a, const N: usize> {
    arm: &'a Arm<N>,
    model: &'a str,
    case: &'a Case,
    rows: &'a mut Vec<Row>,
}

impl<const N: usize> Comparison<'_, N> {
    fn run(&mut self) -> Result<(), GoldenError> {
        let (arm, case) = (self.arm, self.case);
        let q = self.joints("q", Some(&case.q))?;
        if let Some(rows) = &case.base_from_flange {
            let pose = arm.base_from_flange(&q).matrix();
            self.row("base_from_flange", &pose, rows)?;
        }
        if let Some(rows) = &case.jacobian {
            self.row("jacobian", &arm.jacobian(&q), rows)?;
        }
        if let Some(values) = &case.jdot_qd {
            let qd = self.joints("qd", case.qd.as_ref())?;
            self.row("jdot_qd", &arm.jacobian_dot_qd(&q, &qd), &column(values))?;
        }
        if let Some(rows) = &case.mass_matrix {
            self.row("mass_matrix", &arm.mass_matrix(&q), rows)?;
        }
        if let Some(values) = &case.gravity {
            self.row("gravity", &arm.gravity(&q), &column(values))?;
        }
        if let Some(values) = &case.coriolis {
            let qd = self.joints("qd", case.qd.as_ref())?;
            self.row("coriolis", &arm.coriolis(&q, &qd), &column(values))?;
        }
        if let Some(values) = &case.tau {
            let qd = self.joints("qd", case.qd.as_ref())?;
            let qdd = self.joints("qdd", case.qdd.as_ref())?;
            let tau = arm.inverse_dynamics(&q, &qd, &qdd);
            self.row("tau", &tau, &column(values))?;
        }
        if let Some(values) = &case.fd_qdd {
            let qd = self.joints("qd", case.qd.as_ref())?;
            let tau = self.joints("fd_tau", case.fd_tau.as_ref())?;
            let qdd = arm.forward_dynamics(&q, &qd, &tau);
            self.row("fd_qdd", &qdd, &column(values))?;
        }
        if let Some(value) = case.kinetic_energy {
            let qd = self.joints("qd", case.qd.as_ref())?;
            let energy = SMatrix::<f64, 1, 1>::new(arm.kinetic_energy(&q, &qd));
            self.row("kinetic_energy", &energy, &[vec![value]])?;
        }
        Ok(())
    }

    fn problem(&self, key: &'static str, problem: impl Into<String>) -> GoldenError {
        GoldenError::Case {
            model: self.model.to_owned(),
            case: self.case.id.clone(),
            key,
            problem: problem.into(),
        }
    }

    fn joints(
        &self,
        key: &'static str,
        values: Option<&Vec<f64>>,
    ) -> Result<Joints<N>, GoldenError> {
        let values =
            values.ok_or_else(|| self.problem(key, "is missing; a quantity here needs it"))?;
        if values.len() != N {
            let problem = format!("has {} entries; the model has {N} joints", values.len());
            return Err(self.problem(key, problem));
        }
        Ok(Joints::from_column_slice(values))
    }

    fn row<const R: usize, const C: usize>(
        &mut self,
        quantity: &'static str,
        here: &SMatrix<f64, R, C>,
        there: &[Vec<f64>],
    ) -> Result<(), GoldenError> {
        if there.len() != R || there.iter().any(|row| row.len() != C) {
            let problem = format!("must be {R} rows of {C}");
            return Err(self.problem(quantity, problem));
        }
        let there = DMatrix::from_fn(R, C, |i, j| there[i][j]);
        let scale = there.amax().max(1.0);
        let mut largest = 0.0_f64;
        for (a, b) in here.iter().zip(there.iter()) {
            let difference = (a - b).abs() / scale;
            if !difference.is_finite() {
                let problem = format!("cannot be compared: {a} here, {b} in the file");
                return Err(self.problem(quantity, problem));
            }
            largest = largest.max(difference);
        }
        match self.rows.iter_mut().find(|row| row.quantity == quantity) {
            Some(row) => {
                row.max_relative_difference = row.max_relative_difference.max(largest);
                row.cases += 1;
            }
            None => self.rows.push(Row {
                name: self.model.to_owned(),
                quantity,
                max_relative_difference: largest,
                cases: 1,
            }),
        }
        Ok(())
    }
}

/// A vector as a matrix of one column; a scalar's worth of shape checks for all.
fn column(values: &[f64]) -> Vec<Vec<f64>> {
    values.iter().map(|value| vec![*value]).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    const FILE: &str = include_str!("../tests/golden/golden.json");
    const UR_FILE: &str = include_str!("../tests/golden/golden_ur.json");

    #[test]
    fn every_model_agrees_in_every_quantity() {
        let mut compared = BTreeSet::new();
        for (file, models, cases) in [(FILE, 5, 15), (UR_FILE, 11, 10)] {
            let rows = compare(file, &[]).unwrap();
            assert_eq!(rows.len(), models * 9);
            for row in &rows {
                assert_eq!(row.cases, cases, "{row:?}");
                assert!(row.agrees(), "{row:?}");
            }
            compared.extend(rows.into_iter().map(|row| row.name));
        }
        let builtin: BTreeSet<_> = ModelData::builtin_names().map(str::to_owned).collect();
        assert_eq!(compared, builtin, "a built-in arm without reference values");
    }

    #[test]
    fn a_wrong_mass_shows_in_the_dynamics_and_only_there() {
        let mut own = ModelData::builtin("ur5").unwrap();
        own.links[2].mass_kg *= 1.001;
        for row in compare(FILE, &[own]).unwrap() {
            let kinematic = ["base_from_flange", "jacobian", "jdot_qd"].contains(&row.quantity);
            assert_eq!(row.agrees(), row.name != "ur5" || kinematic, "{row:?}");
        }
    }

    #[test]
    fn one_wrong_digit_in_the_file_is_found() {
        let mut wrong: serde_json::Value = serde_json::from_str(FILE).unwrap();
        let entry = &mut wrong["models"]["panda"][14]["mass_matrix"][6][6];
        *entry = (entry.as_f64().unwrap() + 1e-9).into();
        let wrong = wrong.to_string();
        let bad: Vec<_> = compare(&wrong, &[])
            .unwrap()
            .into_iter()
            .filter(|row| !row.agrees())
            .map(|row| (row.name, row.quantity))
            .collect();
        assert_eq!(bad, [("panda".to_owned(), "mass_matrix")]);
    }

    #[test]
    fn bad_files_are_named() {
        let case = |text: &str| {
            compare(
                &format!(r#"{{"format_version": 1, "models": {text}}}"#),
                &[],
            )
            .unwrap_err()
            .to_string()
        };
        assert!(
            compare("{", &[])
                .unwrap_err()
                .to_string()
                .contains("line 1")
        );
        assert!(case("{}").contains("compares nothing"));
        assert!(case(r#"{"kuka": []}"#).contains("no robot model is called `kuka`"));
        let short = case(r#"{"planar2": [{"id": "a", "q": [0], "gravity": [0, 0]}]}"#);
        assert_eq!(
            short,
            "model `planar2`, case `a`: `q` has 1 entries; the model has 2 joints"
        );
        let shape = case(r#"{"planar2": [{"id": "a", "q": [0, 0], "mass_matrix": [[1, 2]]}]}"#);
        assert!(
            shape.contains("`mass_matrix` must be 2 rows of 2"),
            "{shape}"
        );
        let missing = case(r#"{"planar2": [{"id": "a", "q": [0, 0], "coriolis": [1, 2]}]}"#);
        assert!(missing.contains("`qd` is missing"), "{missing}");
        let version = compare(r#"{"format_version": 2, "models": {}}"#, &[]).unwrap_err();
        assert_eq!(version, GoldenError::Version { found: 2 });
    }
}
