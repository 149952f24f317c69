//! A Python peer that answers each message, with eclipse-zenoh from PyPI.

use std::process::{Command, Stdio};

/// Sends each message back without decoding it.
const ECHO: &str = r#"
import sys, zenoh
config = zenoh.Config()
for key, value in (("mode", '"client"'), ("namespace", '"bench"'), ("connect/endpoints", f'["{sys.argv[1]}"]'),
                   ("scouting/multicast/enabled", "false")):
    config.insert_json5(key, value)
with zenoh.open(config) as session:
    back = session.declare_publisher("bench/back", priority=zenoh.Priority.REAL_TIME, express=True,
                                     congestion_control=zenoh.CongestionControl.DROP)
    echo = lambda s: back.put(s.payload, encoding=s.encoding, attachment=s.attachment)
    subscriber = session.declare_subscriber("bench/out", zenoh.handlers.Callback(echo, indirect=False))
    sys.stdin.read()
"#;

/// The command that runs the peer.
pub fn echo(python: &str, endpoint: &str) -> Command {
    let mut command = Command::new(python);
    command.args(["-c", ECHO, endpoint]);
    command
}

/// Reason why `python` cannot run it; `None` if it can.
pub fn missing(python: &str) -> Option<String> {
    let tried = Command::new(python)
        .args(["-c", "import zenoh"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    match tried {
        Ok(status) if status.success() => None,
        Ok(_) => Some(format!(
            "{python} has no zenoh: `{python} -m pip install -r tests/interop/requirements.txt`, or choose another \
             interpreter with --python"
        )),
        Err(error) => Some(format!("{python}: {error}")),
    }
}
