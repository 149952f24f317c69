//! Settings of the service.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tangent_mechanics::ModelData;
use tangent_runtime::CellConfig;
use tangent_runtime::config::OnLostPage;
use tangent_scene::SceneConfig;

use crate::UiError;
use crate::access::Tokens;
use crate::tasks::SaveError;

/// Settings of [`crate::run`].
#[derive(Clone, Debug)]
pub struct Config {
    /// Name of the cell.
    pub cell: String,
    /// Address to listen at; port 0 is any free one.
    pub address: SocketAddr,
    /// Names of this host that a browser may use.
    pub hosts: Vec<String>,
    /// Who may command the cell.
    pub tokens: Tokens,
    /// Folder with the task files.
    pub tasks: PathBuf,
    /// Folder of the cell for its own task files, if it does not exist: nothing is saved then.
    pub missing_tasks: Option<PathBuf>,
    /// Folder with the recordings.
    pub recordings: PathBuf,
    /// Reaction to the loss of the page.
    pub on_lost_page: OnLostPage,
    /// Time without a sign of life after which a page counts as lost.
    pub lost_page_after: Duration,
    /// Wanted dose, N*s/cm².
    pub dose_band: Option<[f64; 2]>,
    /// Limit of the force, N.
    pub force_max_n: f64,
    /// The arm, its tool and the estimators.
    pub scene: SceneConfig,
}

impl Config {
    /// The folder in which task files are saved.
    ///
    /// # Errors
    /// The cell has none.
    pub fn saved_tasks(&self) -> Result<&Path, SaveError> {
        match &self.missing_tasks {
            Some(missing) => Err(SaveError::NoFolder(missing.clone())),
            None => Ok(&self.tasks),
        }
    }

    /// From a cell's `[ui]` section. Reads the file of the tokens.
    ///
    /// # Errors
    /// The page may not be served at its address, the file of the tokens is not usable, or the
    /// model is not valid.
    pub fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, UiError> {
        let section = &cell.ui;
        section.may_listen().map_err(|allowed| UiError::Address {
            address: section.address,
            allowed,
        })?;
        let tokens = match &section.tokens {
            Some(file) => Tokens::read(file)?,
            None => Tokens::default(),
        };
        // Without a folder of its own, the built-in cell uses the tasks that ship.
        let (tasks, missing_tasks) = match section.tasks.is_dir() {
            true => (section.tasks.clone(), None),
            false => (PathBuf::from("deploy/tasks"), Some(section.tasks.clone())),
        };
        Ok(Self {
            cell: cell.cell.name.clone(),
            address: section.address,
            hosts: section.hosts.clone(),
            tokens,
            tasks,
            missing_tasks,
            recordings: cell.recorder.folder.clone(),
            on_lost_page: section.on_lost_page,
            lost_page_after: Duration::from_secs_f64(section.lost_page_after_s),
            dose_band: section.dose_band_n_s_per_cm2,
            force_max_n: cell.limits.force_max_n,
            scene: SceneConfig::from_cell(cell, model)?,
        })
    }
}
