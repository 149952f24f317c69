//! Common parts of the system tests: the built program, folders, free ports.
#![allow(dead_code, clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
pub use tangent_live::ports::offset as port_offset;

/// The program under test.
pub fn tangent() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tangent"));
    command
        .env_remove("TANGENT_CELL")
        .stdin(Stdio::null())
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// Root folder of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

/// The shipped cell file with a sensor at 1 kHz, which leaves a small machine to the estimators.
pub fn with_slower_sensor(cell: &str) -> String {
    let rate = "rate_hz = 0.0                       # records";
    assert!(cell.contains(rate));
    cell.replace(rate, "rate_hz = 1000.0 # records")
}

/// Runs the program to its end and returns its output.
pub fn run(args: &[&str]) -> Output {
    tangent().args(args).output().unwrap()
}

/// The JSON object on standard output.
pub fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| {
        panic!(
            "no JSON ({e}) but: {}\n{}",
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        )
    })
}

/// Runs `tangent up` with the scenario, with recording and report in `folder`. Returns the figures.
pub fn up(scenario: &str, folder: &Path) -> Value {
    up_with(&["--scenario", scenario], folder)
}

/// Runs `tangent up` with the system of a paper, by its name, with recording and report in
/// `folder`. Returns the figures.
pub fn up_system(system: &str, folder: &Path) -> Value {
    up_with(&[system], folder)
}

fn up_with(what: &[&str], folder: &Path) -> Value {
    let offset = port_offset().to_string();
    let folder = folder.to_str().unwrap();
    let mut args = vec!["up"];
    args.extend(what);
    args.extend(["--folder", folder, "--port-offset", &offset, "--json"]);
    let output = run(&args);
    let code = output.status.code();
    // Code 3 is "done, but something was lost": a busy machine may miss a cycle, which these tests
    // do not check.
    assert!(
        code == Some(0) || code == Some(3),
        "{code:?}: {}",
        stderr(&output)
    );
    json(&output)
}

/// Text on standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A child process that is killed at the end of the test.
pub struct Process {
    child: Child,
    name: String,
}

impl Process {
    /// Starts the program with these arguments. Its log goes to the log of the test, its standard
    /// output is discarded.
    pub fn start(name: &str, args: &[&str]) -> Self {
        Self::start_with_log(name, args, Stdio::inherit())
    }

    /// Starts the program with these arguments, with its log to `log`. Its standard output is
    /// discarded.
    pub fn start_with_log(name: &str, args: &[&str], log: impl Into<Stdio>) -> Self {
        Self::start_with_output(name, args, Stdio::null(), log)
    }

    /// Starts the program with these arguments, with its standard output to `output` and its log to
    /// `log`.
    pub fn start_with_output(
        name: &str,
        args: &[&str],
        output: impl Into<Stdio>,
        log: impl Into<Stdio>,
    ) -> Self {
        let child = tangent()
            .args(args)
            .stdout(output)
            .stderr(log)
            .spawn()
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        Self {
            child,
            name: name.to_owned(),
        }
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends SIGKILL and waits for the end of the process.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Sends a signal, given by its name.
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &id])
            .status();
        assert!(sent.unwrap().success(), "kill -{name} {}", self.name);
    }

    /// Exit code, if the process has ended; -1 if a signal ended it.
    pub fn code(&mut self) -> Option<i32> {
        let status = self.child.try_wait().unwrap()?;
        Some(status.code().unwrap_or(-1))
    }

    /// Sends SIGTERM and returns the exit code; panics if the process does not end within
    /// `patience`.
    pub fn terminate(&mut self, patience: Duration) -> Option<i32> {
        self.signal("TERM");
        self.ended(patience)
    }

    /// Exit code; `None` if a signal ended the process. Panics if it does not end within
    /// `patience`.
    pub fn ended(&mut self, patience: Duration) -> Option<i32> {
        let until = Instant::now() + patience;
        while Instant::now() < until {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("{} did not end within {patience:?}", self.name);
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Calls `attempt` until it returns a value; panics if it does not within `patience`.
pub fn wait_for<T>(what: &str, patience: Duration, mut attempt: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + patience;
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(Instant::now() < until, "{what}: not within {patience:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The number at a path in a JSON object.
pub fn number(value: &Value, path: &str) -> f64 {
    value
        .pointer(path)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{path} is no number in {value}"))
}
