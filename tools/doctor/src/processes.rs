//! Processes and their threads, from `/proc`.

use crate::system::System;

/// Number of SCHED_FIFO in `/proc/PID/task/TID/stat`.
pub const FIFO: i64 = 1;

/// One process.
pub struct Process {
    /// Process id.
    pub pid: u32,
}

/// A thread's name and scheduling policy.
pub struct Thread {
    /// Name from `comm`, at most 15 characters.
    pub name: String,
    /// Scheduling policy: 0 normal, 1 FIFO, 2 round robin.
    pub policy: i64,
}

/// All processes with this name, truncated to 15 characters.
pub fn named<'a>(system: &'a System, name: &'a str) -> impl Iterator<Item = Process> + 'a {
    all(system).filter(move |p| p.name(system).as_deref() == Some(name))
}

/// All processes.
pub fn all(system: &System) -> impl Iterator<Item = Process> {
    system
        .names("/proc")
        .into_iter()
        .filter_map(|name| name.parse().ok().map(|pid| Process { pid }))
}

impl Process {
    /// Name of the process, if it can be read.
    pub fn name(&self, system: &System) -> Option<String> {
        system.text(&format!("/proc/{}/comm", self.pid))
    }

    /// Whether the process has this socket open; only root sees the sockets of other users.
    pub fn holds(&self, system: &System, inode: &str) -> bool {
        let folder = format!("/proc/{}/fd", self.pid);
        let wanted = format!("socket:[{inode}]");
        system
            .names(&folder)
            .iter()
            .any(|fd| system.link_name(&format!("{folder}/{fd}")).as_deref() == Some(&wanted))
    }

    /// Threads of the process.
    pub fn threads(&self, system: &System) -> Vec<Thread> {
        let folder = format!("/proc/{}/task", self.pid);
        system
            .names(&folder)
            .iter()
            .filter_map(|tid| thread(&system.text(&format!("{folder}/{tid}/stat"))?))
            .collect()
    }
}

/// Parses the text of `stat`: the name is in brackets and may contain any character; the policy is
/// field 41.
fn thread(stat: &str) -> Option<Thread> {
    let (_, rest) = stat.split_once('(')?;
    let (name, fields) = rest.rsplit_once(')')?;
    Some(Thread {
        name: name.to_owned(),
        policy: fields.split_whitespace().nth(38)?.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_s_policy_is_read_behind_any_name() {
        let own = System::here();
        let here = Process {
            pid: std::process::id(),
        };
        let threads = here.threads(&own);
        assert!(!threads.is_empty() && threads.iter().all(|t| (0..=7).contains(&t.policy)));

        let fields = "S 1 1 1 0 -1 4194304 1 0 0 0 1 2 0 0 -81 0 1 0 100 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 17 0 80 1 0 0 0";
        let found = thread(&format!("7 (rtde (x) loop) {fields}")).unwrap();
        assert_eq!((found.name.as_str(), found.policy), ("rtde (x) loop", FIFO));
        assert!(thread("7 no brackets").is_none());
    }
}
