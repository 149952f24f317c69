//! A person at a terminal, in front of a command that asks for keys.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Child, Output, Stdio};

use crate::cell::Cell;
use crate::common::tangent;

/// A running command: keys go in line by line, words come out, and one JSON object at the end.
pub struct Terminal {
    pub child: Child,
    log: PathBuf,
}

impl Terminal {
    /// Starts `command` for this cell.
    pub fn start(cell: &Cell, command: &[&str], args: &[&str]) -> Self {
        let log = cell.file().with_file_name(format!("{}.log", command[0]));
        let child = tangent()
            .args(command)
            .args(["--json", "--cell"])
            .arg(cell.file())
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(fs::File::create(&log).unwrap())
            .spawn()
            .unwrap();
        Self { child, log }
    }

    /// What the command has said so far.
    pub fn said(&self) -> String {
        fs::read_to_string(&self.log).unwrap()
    }

    /// Enters a line.
    pub fn enter(&mut self, line: &str) {
        let stdin = self.child.stdin.as_mut().unwrap();
        stdin.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    /// Ends the input, and waits for the command to end. Returns what it said, too.
    pub fn ended(mut self) -> (Output, String) {
        drop(self.child.stdin.take());
        let output = self.child.wait_with_output().unwrap();
        let said = fs::read_to_string(&self.log).unwrap();
        (output, said)
    }
}
