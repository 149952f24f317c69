//! Writes the file, after the checks of every service.

use std::fs;
use std::path::Path;

use tangent_check::{FileKind, check_file};

use crate::answers::{NewCell, Sensor, SensorKind, kinds_of};
use crate::error::NewCellError;
use crate::text::text;

/// Writes the file of a cell if it passes all checks, and returns the notes on it. An existing file
/// is kept unless `overwrite`.
///
/// # Errors
/// [`NewCellError`]; then nothing is written.
pub fn write(file: &Path, cell: &NewCell, overwrite: bool) -> Result<Vec<String>, NewCellError> {
    let kinds = kinds_of(&cell.model)?;
    let kind = kind_of(&cell.sensor);
    if !kinds.contains(&kind) {
        let allowed: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
        return Err(NewCellError::Sensor {
            sensor: kind.name(),
            model: cell.model.clone(),
            allowed: allowed.join(" or "),
        });
    }
    if !overwrite && file.exists() {
        return Err(NewCellError::Exists {
            file: file.to_owned(),
        });
    }
    let failed = |source| NewCellError::Write {
        file: file.to_owned(),
        source,
    };
    // Checked under another name, so that a refused cell does not replace an existing file.
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let draft = file.with_file_name(format!(".{name}.draft"));
    fs::write(&draft, text(cell)).map_err(failed)?;
    let (_, findings) = check_file(&draft, Some(FileKind::Cell), None);
    if !findings.errors.is_empty() {
        let _ = fs::remove_file(&draft);
        let shown = draft.display().to_string();
        let errors = findings.errors.iter();
        return Err(NewCellError::Refused {
            errors: errors
                .map(|error| error.replace(&shown, &file.display().to_string()))
                .collect(),
        });
    }
    fs::rename(&draft, file).map_err(failed)?;
    Ok(findings.notes)
}

fn kind_of(sensor: &Sensor) -> SensorKind {
    match sensor {
        Sensor::Netft { .. } => SensorKind::Netft,
        Sensor::Ur { .. } => SensorKind::Ur,
        Sensor::Topic { .. } => SensorKind::Topic,
        Sensor::Joints => SensorKind::Joints,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answers::{Ranges, is_franka, ranges_of};
    use tangent_mechanics::ModelData;
    use tangent_runtime::CellConfig;

    fn cell(model: &str, sensor: Sensor) -> NewCell {
        NewCell {
            name: "kitchen".to_owned(),
            model: model.to_owned(),
            robot_address: "192.168.1.10".to_owned(),
            sensor,
        }
    }

    fn sensor(kind: SensorKind, model: &str) -> Sensor {
        let ranges = ranges_of(model).unwrap_or(Ranges {
            force_n: 80.0,
            torque_nm: 10.0,
        });
        match kind {
            SensorKind::Netft => Sensor::Netft {
                address: "192.168.1.1".to_owned(),
            },
            SensorKind::Ur => Sensor::Ur { ranges },
            SensorKind::Topic => Sensor::Topic {
                key: "my_sensor/wrench".to_owned(),
                rate_hz: 200.0,
                ranges,
            },
            SensorKind::Joints => Sensor::Joints,
        }
    }

    /// Every arm of a supported driver with every sensor that fits it.
    #[test]
    fn every_combination_that_is_offered_passes_the_check() {
        let folder = tempfile::tempdir().unwrap();
        let mut written = 0;
        for model in ModelData::builtin_names() {
            let arm = ModelData::builtin(model).unwrap();
            if !model.starts_with("ur") && !is_franka(model) {
                continue;
            }
            for kind in kinds_of(model).unwrap() {
                let file = folder.path().join(format!("{model}-{}.toml", kind.name()));
                let made = cell(model, sensor(*kind, model));
                write(&file, &made, false).unwrap_or_else(|e| panic!("{model}, {kind:?}: {e}"));
                let read = CellConfig::load(&file).unwrap();
                assert_eq!(read.robot.model, arm.name);
                assert_eq!(read.cell.name, "kitchen");
                written += 1;
            }
        }
        assert!(written > 8, "only {written} files");
    }

    #[test]
    fn a_refused_cell_leaves_no_file_and_an_existing_one_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cell.toml");
        let bad = NewCell {
            name: "my cell".to_owned(),
            ..cell("ur5", sensor(SensorKind::Netft, "ur5"))
        };
        let said = write(&file, &bad, false).unwrap_err().to_string();
        assert!(
            said.contains("cell.name") && said.contains("my cell") && said.contains("cell.toml"),
            "{said}"
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

        let good = cell("ur5", sensor(SensorKind::Netft, "ur5"));
        write(&file, &good, false).unwrap();
        let again = write(&file, &good, false);
        assert!(matches!(again, Err(NewCellError::Exists { .. })));
        write(&file, &good, true).unwrap();
    }

    #[test]
    fn an_unknown_arm_and_a_sensor_that_does_not_fit_are_refused_with_what_there_is() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cell.toml");
        let unknown = cell("ur5f", Sensor::Joints);
        let said = write(&file, &unknown, false).unwrap_err().to_string();
        assert!(
            said.contains("did you mean `ur5") && said.contains("panda"),
            "{said}"
        );
        let misfit = cell("ur5", Sensor::Joints);
        let said = write(&file, &misfit, false).unwrap_err().to_string();
        assert!(
            said.contains("joints") && said.contains("netft or topic"),
            "{said}"
        );
    }
}
