//! Third-party clients from PyPI: the Python that has them, and their scripts in `tests/interop`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Exit code of a script whose clients are not installed.
const MISSING: i32 = 77;

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

/// Whether a client that is missing is a failure: `TANGENT_REQUIRE_INTEROP` is set.
pub fn is_required() -> bool {
    std::env::var_os("TANGENT_REQUIRE_INTEROP").is_some()
}

/// What a script of `tests/interop` prints. `None`, and the reason is printed, if Python or one of
/// its clients is missing.
///
/// # Panics
/// The script fails, or something is missing and [`is_required`].
pub fn output_of(script: &str, arguments: &[impl AsRef<OsStr>]) -> Option<String> {
    output(&python(), script, arguments)
}

/// What a script of `tests/interop` prints under a Python that has ROS 2 and the built packages of
/// messages: `TANGENT_ROS2_PYTHON`, else the one that `tests/interop/ros2/build` makes. `None`, and
/// the reason is printed, if it is missing.
///
/// # Panics
/// The script fails, or Python is missing and [`is_required`].
pub fn output_with_ros2(script: &str, arguments: &[impl AsRef<OsStr>]) -> Option<String> {
    let python = match std::env::var_os("TANGENT_ROS2_PYTHON") {
        Some(path) => path.into(),
        None => root().join(".ros2/python"),
    };
    output(&python, script, arguments)
}

fn output(python: &Path, script: &str, arguments: &[impl AsRef<OsStr>]) -> Option<String> {
    let output = Command::new(python)
        .arg(root().join("tests/interop").join(script))
        .args(arguments)
        .output();
    let missing = match output {
        Err(error) => format!("{} cannot be run: {error}", python.display()),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            if output.status.code() != Some(MISSING) {
                let errors = String::from_utf8_lossy(&output.stderr);
                assert!(output.status.success(), "{said}\n{errors}");
                return Some(said);
            }
            said
        }
    };
    assert!(!is_required(), "{missing}");
    println!("skipped, because {}", missing.trim());
    None
}
