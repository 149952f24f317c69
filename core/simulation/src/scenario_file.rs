//! Reads a scenario file of any kind: its `kind`, overrides of single keys, and errors.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use tangent_control::{ControlError, MemoryError};
use tangent_estimation::EstimationError;
use tangent_sensing::SensingError;
use toml::{Spanned, Table, Value};

use crate::overrides::{self, OverrideError};
use crate::plant_error::PlantError;

/// `kind` of a scenario of the `admittance` system. Its files need not state it.
pub(crate) const ADMITTANCE: &str = "admittance";
/// `kind` of a scenario of the `object` system.
pub(crate) const OBJECT_POSE: &str = "object_pose";
/// `kind` of a scenario of the `visuo_tactile` system.
pub(crate) const VISUO_TACTILE: &str = "visuo_tactile";

/// Why a file that a scenario names cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FileError(String);

impl FileError {
    /// Error with a reason in words.
    pub fn new(reason: impl ToString) -> Self {
        Self(reason.to_string())
    }
}

/// Returns the text of a file, given its name as in the scenario.
pub type ReadFile<'a> = &'a dyn Fn(&str) -> Result<String, FileError>;

/// Reader for scenarios that name no other file.
///
/// # Errors
/// Always.
pub fn no_files(_name: &str) -> Result<String, FileError> {
    Err(FileError::new("no other file can be read here"))
}

/// Why a scenario cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// Not TOML, an unknown key or a wrong type.
    #[error("scenario {file}: {message}")]
    Text {
        /// Name of the file or scenario.
        file: String,
        /// Message of the TOML reader: key, line and what is allowed.
        message: String,
    },
    /// The file's kind is unknown or is not the expected one.
    #[error("scenario {file}: `kind` is {}, but must be {allowed}", .kind.as_ref().map_or("absent".to_owned(), |k| format!("\"{k}\"")))]
    Kind {
        /// Name of the file or scenario.
        file: String,
        /// The kind as given, if any.
        kind: Option<String>,
        /// Kinds allowed.
        allowed: &'static str,
    },
    /// A `--set` override cannot be applied.
    #[error(transparent)]
    Override(#[from] OverrideError),
    /// A `--set` override makes the scenario unreadable.
    #[error("--set {text}: {message}")]
    OverrideValue {
        /// The override as given.
        text: String,
        /// Message of the TOML reader.
        message: String,
    },
    /// A file that the scenario names cannot be read.
    #[error("scenario {file}: csv_file \"{name}\": {source}")]
    File {
        /// Name of the file or scenario.
        file: String,
        /// The file it names.
        name: String,
        /// Reason.
        source: FileError,
    },
    /// A number is out of its range.
    #[error("scenario {file}: `{key}` is {value}, but must be {allowed}")]
    Value {
        /// Name of the file or scenario.
        file: String,
        /// Key of the number.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Allowed range.
        allowed: &'static str,
    },
    /// The cell cannot be built.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The control law or the task is not usable.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// What earlier passes learnt cannot be used.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The conditioning of the wrench has a wrong setting.
    #[error(transparent)]
    Sensing(#[from] SensingError),
    /// An estimator is unknown or has a wrong setting.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
}

impl ScenarioError {
    /// Fails unless `ok`.
    pub(crate) fn unless(
        file: &str,
        key: &'static str,
        value: f64,
        allowed: &'static str,
        ok: bool,
    ) -> Result<(), Self> {
        if ok {
            return Ok(());
        }
        Err(Self::Value {
            file: file.to_owned(),
            key,
            value,
            allowed,
        })
    }

    /// Error of `[control]` in a scenario, with the wrong key and the file.
    pub(crate) fn of_settings(file: &str, error: ControlError) -> Self {
        match error {
            ControlError::Syntax(message) => Self::Text {
                file: file.to_owned(),
                message,
            },
            other => Self::Control(other),
        }
    }

    /// Fails unless `duration_s` is an allowed duration of a run.
    pub(crate) fn unless_duration(file: &str, duration_s: f64) -> Result<(), Self> {
        let ok = (0.1..=86_400.0).contains(&duration_s);
        Self::unless(file, "duration_s", duration_s, "0.1 to 86400 s", ok)
    }
}

/// The only key that is read from a file whose kind is not known yet.
#[derive(Deserialize)]
struct Marked {
    kind: Option<Spanned<String>>,
}

/// `kind` of a file and its position in the text; `None` if the text states none or is not TOML.
fn marked(text: &str) -> Option<Spanned<String>> {
    toml::from_str::<Marked>(text).ok()?.kind
}

/// `kind` of a file; `None` if the text states none or is not TOML.
pub(crate) fn kind_of(text: &str) -> Option<String> {
    marked(text).map(Spanned::into_inner)
}

/// Reads a scenario of one kind and applies overrides of single values.
///
/// # Errors
/// The file is of another kind. Otherwise the file or the override, the key, the value and what is
/// allowed.
pub(crate) fn read_with_overrides<T: DeserializeOwned>(
    file: &str,
    kind: &'static str,
    text: &str,
    overrides: &[String],
) -> Result<T, ScenarioError> {
    let bad = |e: toml::de::Error| ScenarioError::Text {
        file: file.to_owned(),
        message: e.to_string(),
    };
    let mark = marked(text);
    let found = mark.as_ref().map(|mark| mark.get_ref().as_str());
    if found.unwrap_or(ADMITTANCE) != kind {
        return Err(ScenarioError::Kind {
            file: file.to_owned(),
            kind: found.map(str::to_owned),
            allowed: kind,
        });
    }
    // The settings of a scenario do not include its kind. It is replaced by blanks, which keeps all
    // line and column numbers for messages.
    let mut settings = text.to_owned();
    if let Some(mark) = &mark {
        let line = text[..mark.span().start].rfind('\n').map_or(0, |i| i + 1);
        let blank = " ".repeat(mark.span().end - line);
        settings.replace_range(line..mark.span().end, &blank);
    }
    // The file is read without overrides first, so that its own errors are reported with their
    // line.
    toml::from_str::<T>(&settings).map_err(bad)?;
    let mut table: Table = toml::from_str(&settings).map_err(bad)?;
    for text in overrides {
        overrides::apply(&mut table, text)?;
        let checked = T::deserialize(Value::Table(table.clone()));
        checked.map_err(|e| ScenarioError::OverrideValue {
            text: text.clone(),
            message: e.message().to_owned(),
        })?;
    }
    T::deserialize(Value::Table(table)).map_err(bad)
}
