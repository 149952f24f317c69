//! What the system tests share: the built program, folders, free ports.
#![allow(dead_code, clippy::unwrap_used)]

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::{Duration, Instant};

use serde_json::Value;

/// The program under test.
pub fn tangent() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tangent"));
    command
        .env_remove("TANGENT_CELL")
        .stdin(Stdio::null())
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

/// The repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

/// Runs to the end and returns what was said.
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

/// A whole `tangent up` of the scenario, recording and report in `folder`; its figures.
pub fn up(scenario: &str, folder: &Path) -> Value {
    up_with(&["--scenario", scenario], folder)
}

/// The same of a system by its paper's name.
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
    // 3 is "done, but something was lost": a busy machine may miss a cycle, which is no matter of these tests.
    assert!(
        code == Some(0) || code == Some(3),
        "{code:?}: {}",
        stderr(&output)
    );
    json(&output)
}

/// What went to standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// An offset at which all ports of a simulated cell are free now.
pub fn port_offset() -> u16 {
    // Tests run side by side, here and in other processes: each looks at offsets of its own.
    static TAKEN: AtomicU16 = AtomicU16::new(0);
    let start = (std::process::id() % 97) as u16;
    for _ in 0..100 {
        let turn = TAKEN.fetch_add(1, Ordering::Relaxed);
        let offset = 100 + (start * 151 + turn * 37) % 15_900;
        let ports = [
            1337, 7447, 8080, 29_999, 30_001, 30_002, 30_003, 30_004, 49_152,
        ];
        let taken = ports_in_use();
        if ports.iter().all(|p| !taken.contains(&(p + offset))) {
            return offset;
        }
    }
    panic!("no free ports on loopback");
}

/// Ports of this host that have a socket. To try one by binding it would take it: a child that another test starts just
/// then holds it until it runs its own program.
fn ports_in_use() -> HashSet<u16> {
    ["tcp", "tcp6", "udp", "udp6"]
        .iter()
        .filter_map(|table| fs::read_to_string(format!("/proc/net/{table}")).ok())
        .flat_map(|text| text.lines().skip(1).map(local_port).collect::<Vec<_>>())
        .flatten()
        .collect()
}

/// `  1: 0100007F:1F90 ...` has port 0x1F90.
fn local_port(line: &str) -> Option<u16> {
    let address = line.split_whitespace().nth(1)?;
    u16::from_str_radix(address.rsplit_once(':')?.1, 16).ok()
}

/// A process that is ended with the test.
pub struct Process {
    child: Child,
    name: String,
}

impl Process {
    /// Starts the program with these arguments; its log goes to the test's.
    pub fn start(name: &str, args: &[&str]) -> Self {
        Self::start_with_log(name, args, Stdio::inherit())
    }

    /// The same, with its log elsewhere.
    pub fn start_with_log(name: &str, args: &[&str], log: impl Into<Stdio>) -> Self {
        Self::start_with_output(name, args, Stdio::null(), log)
    }

    /// The same, with its standard output elsewhere too.
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

    /// SIGKILL, at once.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Sends a signal by its name.
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &id])
            .status();
        assert!(sent.unwrap().success(), "kill -{name} {}", self.name);
    }

    /// Its exit code, if it has ended; -1 when a signal ended it.
    pub fn code(&mut self) -> Option<i32> {
        let status = self.child.try_wait().unwrap()?;
        Some(status.code().unwrap_or(-1))
    }

    /// SIGTERM, and its exit code within `patience`.
    pub fn terminate(&mut self, patience: Duration) -> Option<i32> {
        self.signal("TERM");
        self.ended(patience)
    }

    /// Its exit code, when it ends within `patience`; none when a signal ended it.
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

/// Tries until `attempt` gives something.
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

/// A number deep in a JSON object.
pub fn number(value: &Value, path: &str) -> f64 {
    value
        .pointer(path)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{path} is no number in {value}"))
}
