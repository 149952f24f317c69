//! Third-party clients from PyPI: the Python that has them, and the folder of their scripts.

use std::path::{Path, PathBuf};

/// Root folder of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The Python interpreter that has the clients, if they are installed: `TANGENT_PYTHON`, else that
/// of `.venv`, else the system's.
pub fn python() -> PathBuf {
    if let Some(path) = std::env::var_os("TANGENT_PYTHON") {
        return path.into();
    }
    let local = root().join(".venv/bin/python3");
    if local.exists() {
        local
    } else {
        "python3".into()
    }
}
