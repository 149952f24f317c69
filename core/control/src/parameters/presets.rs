//! Complete sets of a law's parameters by name, and single changes to them.

use serde::{Serialize, de::DeserializeOwned};

use crate::error::ControlError;
use crate::parameters::law_config::LawConfig;
use crate::parameters::overlay::with_changes;

/// Parameters of a law with the presets that every law has: `default`, the law as it is used, and
/// `paper`, as it was published.
///
/// ```
/// use tangent_control::{ControllerConfig, Presets};
///
/// let changes: toml::Table = "force.damping_n_s_per_m = 400.0".parse()?;
/// let config = ControllerConfig::preset_with("paper", &changes)?;
/// assert_eq!(config.force.damping_n_s_per_m, 400.0);
/// // Everything else is as published.
/// assert_eq!(config.alignment, ControllerConfig::paper().alignment);
///
/// assert!(ControllerConfig::preset("fast").is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Presets: LawConfig + Default + Serialize + DeserializeOwned {
    /// Names that [`Presets::preset`] knows.
    const PRESETS: [&'static str; 2] = ["default", "paper"];

    /// The law as it was published.
    fn paper() -> Self;

    /// A complete set of parameters by name.
    ///
    /// # Errors
    /// [`ControlError::UnknownPreset`] with the name.
    fn preset(name: &str) -> Result<Self, ControlError> {
        match name {
            "default" => Ok(Self::default()),
            "paper" => Ok(Self::paper()),
            other => Err(ControlError::UnknownPreset { name: other.into() }),
        }
    }

    /// A preset with single parameters changed, checked; `changes` as in `[controller.settings]` of
    /// a cell file.
    ///
    /// # Errors
    /// An unknown name or parameter, or a value out of its range.
    fn preset_with(name: &str, changes: &toml::Table) -> Result<Self, ControlError> {
        let config = with_changes(Self::preset(name)?, changes)?;
        config.check()?;
        Ok(config)
    }
}
