//! Scenarios by name or by file. Those of `scenarios/` are part of the program, so that it runs
//! from anywhere. Every verb that plays or checks a scenario reads it here.

use std::fs;
use std::path::Path;

use tangent_mechanics::names::did_you_mean;
use tangent_runtime::CellConfig;
use tangent_runtime::config::Law;
use tangent_simulation::{FileError, Scenario};

use crate::error::SimulatedCellError;

/// Name and text of each built-in scenario: of system `admittance`, then `object`, then
/// `visuo_tactile`.
pub const BUILTIN: &[(&str, &str)] = &[
    (
        "cone_ideal",
        include_str!("../../../scenarios/cone_ideal.toml"),
    ),
    (
        "cone_realistic",
        include_str!("../../../scenarios/cone_realistic.toml"),
    ),
    (
        "height_field",
        include_str!("../../../scenarios/height_field.toml"),
    ),
    (
        "pipe_ideal",
        include_str!("../../../scenarios/pipe_ideal.toml"),
    ),
    (
        "pipe_moving_base",
        include_str!("../../../scenarios/pipe_moving_base.toml"),
    ),
    (
        "pipe_realistic",
        include_str!("../../../scenarios/pipe_realistic.toml"),
    ),
    (
        "pipe_scan",
        include_str!("../../../scenarios/pipe_scan.toml"),
    ),
    ("plane", include_str!("../../../scenarios/plane.toml")),
    ("sheet", include_str!("../../../scenarios/sheet.toml")),
    ("sphere", include_str!("../../../scenarios/sphere.toml")),
    ("torus", include_str!("../../../scenarios/torus.toml")),
    (
        "touchdown_10kN_per_m",
        include_str!("../../../scenarios/touchdown_10kN_per_m.toml"),
    ),
    (
        "touchdown_1kN_per_m",
        include_str!("../../../scenarios/touchdown_1kN_per_m.toml"),
    ),
    (
        "touchdown_25kN_per_m",
        include_str!("../../../scenarios/touchdown_25kN_per_m.toml"),
    ),
    (
        "touchdown_5kN_per_m",
        include_str!("../../../scenarios/touchdown_5kN_per_m.toml"),
    ),
    (
        "lippiello_cylinder",
        include_str!("../../../scenarios/lippiello/lippiello_cylinder.toml"),
    ),
    (
        "lippiello_plane",
        include_str!("../../../scenarios/lippiello/lippiello_plane.toml"),
    ),
    (
        "lippiello_plane_friction",
        include_str!("../../../scenarios/lippiello/lippiello_plane_friction.toml"),
    ),
    (
        "lippiello_realistic",
        include_str!("../../../scenarios/lippiello/lippiello_realistic.toml"),
    ),
    (
        "lippiello_sphere",
        include_str!("../../../scenarios/lippiello/lippiello_sphere.toml"),
    ),
    (
        "karacan_dark",
        include_str!("../../../scenarios/karacan/karacan_dark.toml"),
    ),
    (
        "karacan_depth",
        include_str!("../../../scenarios/karacan/karacan_depth.toml"),
    ),
    (
        "karacan_rough",
        include_str!("../../../scenarios/karacan/karacan_rough.toml"),
    ),
    (
        "karacan_wave",
        include_str!("../../../scenarios/karacan/karacan_wave.toml"),
    ),
];

/// Files that scenarios name, by their name in `scenarios/`.
const BUILTIN_FILES: &[(&str, &str)] = &[(
    "height_field.csv",
    include_str!("../../../scenarios/height_field.csv"),
)];

/// Scenario that `up` and a simulator without a scenario play.
pub const DEFAULT: &str = "pipe_realistic";

/// Name of each system on the command line, and the scenario that `up` plays for it.
const SYSTEMS: &[(&str, &str)] = &[
    ("tugal", DEFAULT),
    ("lippiello", "lippiello_realistic"),
    ("karacan", "karacan_depth"),
];

/// The scenario of a system by its paper's name.
pub fn of_system(name: &str) -> Option<&'static str> {
    let found = SYSTEMS.iter().find(|(system, _)| *system == name);
    found.map(|(_, scenario)| *scenario)
}

/// Names of all systems on the command line.
pub fn systems() -> Vec<&'static str> {
    SYSTEMS.iter().map(|(system, _)| *system).collect()
}

/// The scenario that fits a cell whose user names none: the one that the file names, or that of the
/// system with this law.
pub fn of_cell(cell: &CellConfig) -> String {
    if let Some(own) = &cell.simulator.scenario {
        return own.display().to_string();
    }
    let system = match cell.controller.law {
        Law::HybridAdmittance => "tugal",
        Law::HybridDynamics => "lippiello",
        Law::UnifiedForceImpedance => "karacan",
    };
    of_system(system).unwrap_or(DEFAULT).to_owned()
}

/// Reads a scenario by its built-in name or its file, with `KEY=VALUE` overrides.
///
/// # Errors
/// An unknown name, a file that cannot be read, or a bad key or value.
pub fn load(name: &str, overrides: &[String]) -> Result<Scenario, SimulatedCellError> {
    if let Some((_, text)) = BUILTIN.iter().find(|(n, _)| *n == name) {
        return Scenario::parse(name, text, overrides, &builtin_file)
            .map_err(SimulatedCellError::Scenario);
    }
    let path = Path::new(name);
    let text = fs::read_to_string(path).map_err(|reason| {
        let names: Vec<_> = BUILTIN.iter().map(|(n, _)| *n).collect();
        SimulatedCellError::NoScenario {
            name: name.to_owned(),
            suggestion: did_you_mean(name, names.iter().copied()),
            known: names.join(", "),
            reason,
        }
    })?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let read = |file: &str| fs::read_to_string(folder.join(file)).map_err(FileError::new);
    Scenario::parse(name, &text, overrides, &read).map_err(SimulatedCellError::Scenario)
}

fn builtin_file(name: &str) -> Result<String, FileError> {
    let found = BUILTIN_FILES.iter().find(|(n, _)| *n == name);
    found
        .map(|(_, text)| (*text).to_owned())
        .ok_or_else(|| FileError::new("not among the built-in files"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &str) -> Vec<String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let folder = root.join(folder);
        let mut files: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "toml"))
            .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
            .collect();
        files.sort();
        files
    }

    #[test]
    fn every_file_of_the_folders_is_built_in_and_loads() {
        let mut of_kind = [Vec::new(), Vec::new(), Vec::new()];
        for (name, _) in BUILTIN {
            let scenario = load(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(scenario.name(), *name);
            let kind = match scenario {
                Scenario::Admittance(_) => 0,
                Scenario::ObjectPose(_) => 1,
                Scenario::VisuoTactile(_) => 2,
            };
            of_kind[kind].push(*name);
        }
        let folders = ["scenarios", "scenarios/lippiello", "scenarios/karacan"];
        for (names, folder) in of_kind.iter().zip(folders) {
            assert_eq!(files(folder), *names);
        }
    }

    #[test]
    fn a_scenario_is_read_again_from_its_own_text() {
        for (name, _) in BUILTIN {
            let scenario = load(name, &[]).unwrap();
            let text = toml::to_string(&scenario).unwrap();
            let again = Scenario::parse(name, &text, &[], &builtin_file).unwrap();
            assert_eq!(again, scenario, "{name}");
        }
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let error = load("pipes", &[]).unwrap_err().to_string();
        assert!(
            error.contains("pipes") && error.contains("pipe_ideal"),
            "{error}"
        );
    }
}
