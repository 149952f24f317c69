//! Scenarios by name or by file. Those of `scenarios/` are part of the program, so that it runs
//! from anywhere.

use std::fs;
use std::path::Path;

use anyhow::Result;
use tangent_control::Task;
use tangent_mechanics::names::did_you_mean;
use tangent_simulation::{ObjectScenario, Scenario, TactileScenario};

use crate::output::bad_usage;

macro_rules! builtin {
    ($($name:literal),* $(,)?) => {
        const BUILTIN: &[(&str, &str)] = &[$((
            $name,
            include_str!(concat!("../scenarios/", $name, ".toml")),
        )),*];
    };
}

builtin![
    "cone_ideal",
    "cone_realistic",
    "height_field",
    "pipe_ideal",
    "pipe_moving_base",
    "pipe_realistic",
    "plane",
    "sheet",
    "sphere",
    "torus",
    "touchdown_10kN_per_m",
    "touchdown_1kN_per_m",
    "touchdown_25kN_per_m",
    "touchdown_5kN_per_m",
];

macro_rules! builtin_objects {
    ($($name:literal),* $(,)?) => {
        const BUILTIN_OBJECTS: &[(&str, &str)] = &[$((
            $name,
            include_str!(concat!("../scenarios/lippiello/", $name, ".toml")),
        )),*];
    };
}

// Of kind `object_pose`.
builtin_objects![
    "lippiello_cylinder",
    "lippiello_plane",
    "lippiello_plane_friction",
    "lippiello_realistic",
    "lippiello_sphere",
];

macro_rules! builtin_tactile {
    ($($name:literal),* $(,)?) => {
        const BUILTIN_TACTILE: &[(&str, &str)] = &[$((
            $name,
            include_str!(concat!("../scenarios/karacan/", $name, ".toml")),
        )),*];
    };
}

// Of kind `visuo_tactile`.
builtin_tactile![
    "karacan_dark",
    "karacan_depth",
    "karacan_rough",
    "karacan_wave",
];

/// A system's name and the scenario that `up` plays for it.
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

/// A scenario of any kind that the simulator can play.
#[derive(Clone, Debug)]
pub enum Played {
    /// A velocity-controlled arm on an unmodelled surface.
    Normals(Box<Scenario>),
    /// An arm that takes torques, an object of known shape, a camera.
    Object(Box<ObjectScenario>),
    /// A Franka on an unmodelled surface, by touch alone.
    Tactile(Box<TactileScenario>),
}

impl Played {
    /// By name or file, with overrides.
    ///
    /// # Errors
    /// As [`load`].
    pub fn load(name: &str, overrides: &[String]) -> Result<Self> {
        if let Some(object) = load_object(name, overrides)? {
            return Ok(Self::Object(Box::new(object)));
        }
        if let Some(tactile) = load_tactile(name, overrides)? {
            return Ok(Self::Tactile(Box::new(tactile)));
        }
        Ok(Self::Normals(Box::new(load(name, overrides)?)))
    }

    /// As reports call it.
    pub fn name(&self) -> &str {
        match self {
            Self::Normals(s) => &s.name,
            Self::Object(s) => &s.name,
            Self::Tactile(s) => &s.name,
        }
    }

    /// One sentence on it.
    pub fn title(&self) -> &str {
        match self {
            Self::Normals(s) => &s.title,
            Self::Object(s) => &s.title,
            Self::Tactile(s) => &s.title,
        }
    }

    /// Its own task.
    pub fn task(&self) -> &Task {
        match self {
            Self::Normals(s) => &s.task,
            Self::Object(s) => &s.task,
            Self::Tactile(s) => &s.task,
        }
    }

    /// As a file.
    ///
    /// # Errors
    /// When it cannot be written as TOML.
    pub fn text(&self) -> Result<String> {
        Ok(match self {
            Self::Normals(s) => toml::to_string(s.as_ref())?,
            Self::Object(s) => toml::to_string(s.as_ref())?,
            Self::Tactile(s) => toml::to_string(s.as_ref())?,
        })
    }
}

/// What `up` and a simulator without a scenario play.
pub const DEFAULT: &str = "pipe_realistic";

/// Files that scenarios name, by their name in `scenarios/`.
const BUILTIN_FILES: &[(&str, &str)] = &[(
    "height_field.csv",
    include_str!("../scenarios/height_field.csv"),
)];

/// Names of the built-in scenarios, and their texts.
pub fn builtin() -> &'static [(&'static str, &'static str)] {
    BUILTIN
}

/// Names of the built-in scenarios of kind `object_pose`, and their texts.
pub fn builtin_objects() -> &'static [(&'static str, &'static str)] {
    BUILTIN_OBJECTS
}

/// Names of the built-in scenarios of kind `visuo_tactile`, and their texts.
pub fn builtin_tactile() -> &'static [(&'static str, &'static str)] {
    BUILTIN_TACTILE
}

/// Reads a scenario of kind `visuo_tactile` by its built-in name or its file; none where it is
/// another kind, or no file.
///
/// # Errors
/// A bad key or value: exit code 2.
pub fn load_tactile(name: &str, overrides: &[String]) -> Result<Option<TactileScenario>> {
    let known = BUILTIN_TACTILE.iter().find(|(n, _)| *n == name);
    let text = match known {
        Some((_, text)) => (*text).to_owned(),
        None => match fs::read_to_string(name) {
            Ok(text) if TactileScenario::is_one(&text) => text,
            _ => return Ok(None),
        },
    };
    let scenario = TactileScenario::parse(name, &text, overrides).map_err(bad_usage)?;
    Ok(Some(scenario))
}

/// Reads a scenario of kind `object_pose` by its built-in name or its file; none where it is
/// another kind, or no file.
///
/// # Errors
/// A bad key or value: exit code 2.
pub fn load_object(name: &str, overrides: &[String]) -> Result<Option<ObjectScenario>> {
    let known = BUILTIN_OBJECTS.iter().find(|(n, _)| *n == name);
    let text = match known {
        Some((_, text)) => (*text).to_owned(),
        None => match fs::read_to_string(name) {
            Ok(text) if ObjectScenario::is_one(&text) => text,
            _ => return Ok(None),
        },
    };
    let scenario = ObjectScenario::parse(name, &text, overrides).map_err(bad_usage)?;
    Ok(Some(scenario))
}

/// Reads a scenario by its built-in name or its file, with `KEY=VALUE` overrides.
///
/// # Errors
/// An unknown name, a file that cannot be read, a bad key or value: exit code 2.
pub fn load(name: &str, overrides: &[String]) -> Result<Scenario> {
    if let Some((_, text)) = BUILTIN.iter().find(|(n, _)| *n == name) {
        let read = |file: &str| {
            BUILTIN_FILES
                .iter()
                .find(|(n, _)| *n == file)
                .map(|(_, text)| (*text).to_owned())
                .ok_or_else(|| "not among the built-in files".to_owned())
        };
        return Scenario::parse(name, text, overrides, &read).map_err(bad_usage);
    }
    let path = Path::new(name);
    let text = fs::read_to_string(path).map_err(|e| {
        let names: Vec<_> = BUILTIN
            .iter()
            .chain(BUILTIN_OBJECTS)
            .chain(BUILTIN_TACTILE)
            .map(|(n, _)| *n)
            .collect();
        bad_usage(format!(
            "scenario \"{name}\": not built in{} ({}), and as a file: {e}",
            did_you_mean(name, names.iter().copied()),
            names.join(", ")
        ))
    })?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let read = |file: &str| fs::read_to_string(folder.join(file)).map_err(|e| e.to_string());
    Scenario::parse(name, &text, overrides, &read).map_err(bad_usage)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &str) -> Vec<String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
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
        let names: Vec<&str> = BUILTIN.iter().map(|(name, _)| *name).collect();
        assert_eq!(files("scenarios"), names);
        for name in names {
            load(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(load_object(name, &[]).unwrap().is_none());
        }
        let names: Vec<&str> = BUILTIN_OBJECTS.iter().map(|(name, _)| *name).collect();
        assert_eq!(files("scenarios/lippiello"), names);
        for name in names {
            let object = load_object(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(object.unwrap().name, name);
            assert!(load_tactile(name, &[]).unwrap().is_none());
        }
        let names: Vec<&str> = BUILTIN_TACTILE.iter().map(|(name, _)| *name).collect();
        assert_eq!(files("scenarios/karacan"), names);
        for name in names {
            let tactile = load_tactile(name, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(tactile.unwrap().name, name);
            assert!(load_object(name, &[]).unwrap().is_none());
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
