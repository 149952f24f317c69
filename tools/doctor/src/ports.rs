//! Checks the router's ports: free, used by the cell's own router, or used by another process.

use std::io::ErrorKind;
use std::net::{TcpListener, ToSocketAddrs};

use tangent_runtime::CellConfig;

use crate::finding::Finding;
use crate::processes;
use crate::system::System;

/// State of a listening socket in `/proc/net/tcp`.
const LISTENING: &str = "0A";

/// Returns one finding per endpoint on which the cell's router listens, and one on who may connect.
pub fn check(system: &System, config: &CellConfig) -> Vec<Finding> {
    let listen = config.zenoh.listen.iter();
    listen
        .filter_map(|endpoint| one(system, endpoint))
        .chain([who_may_join(config)])
        .collect()
}

fn who_may_join(config: &CellConfig) -> Finding {
    const CHECK: &str = "who may join";
    const REMEDY: &str = "[zenoh] listen = [\"tcp/127.0.0.1:7447\"], or certificates: `tangent keys new`, docs/security.md";
    let zenoh = &config.zenoh;
    match zenoh.open_to_anybody() {
        None if zenoh.tls.is_some() => {
            Finding::ok(CHECK, "clients with a certificate of the cell's authority")
        }
        None => Finding::ok(CHECK, "processes of the router's host"),
        Some(endpoint) if zenoh.insecure => Finding::warning(
            CHECK,
            format!("any client that reaches {endpoint}: insecure = true, no certificates"),
            "any client on that network can start tasks and impersonate the sensor",
            REMEDY,
        ),
        Some(endpoint) => Finding::problem(
            CHECK,
            format!("{endpoint} is reachable from other hosts, and there are no certificates"),
            "the router refuses to start with this configuration",
            REMEDY,
        ),
    }
}

fn one(system: &System, endpoint: &str) -> Option<Finding> {
    const CHECK: &str = "router's port";
    let address = endpoint.split_once('/')?.1.split(['?', '#']).next()?;
    let port: u16 = address.rsplit_once(':')?.1.parse().ok()?;
    let Ok(targets) = address.to_socket_addrs() else {
        return Some(Finding::warning(
            CHECK,
            format!("{endpoint}: the name has no address here"),
            "the router cannot listen there on this machine",
            "correct if the router runs on another machine; otherwise change [zenoh] listen",
        ));
    };
    let targets: Vec<_> = targets.collect();
    let error = match TcpListener::bind(&targets[..]) {
        Ok(_) => return Some(Finding::ok(CHECK, format!("{endpoint} is free"))),
        Err(error) => error,
    };
    Some(match error.kind() {
        ErrorKind::AddrInUse => held(endpoint, holder(system, port)),
        ErrorKind::AddrNotAvailable => Finding::warning(
            CHECK,
            format!("{endpoint} is not an address of this machine"),
            "the router cannot listen there",
            "correct if the router runs on another machine; otherwise change [zenoh] listen",
        ),
        _ => Finding::problem(
            CHECK,
            format!("{endpoint}: {error}"),
            "the router cannot listen there",
            "ports from 1024 up need no privilege: choose one in [zenoh] listen and connect",
        ),
    })
}

fn held(endpoint: &str, holder: Option<(u32, String)>) -> Finding {
    const CHECK: &str = "router's port";
    match holder {
        Some((pid, name)) if name == "tangent" => Finding::ok(
            CHECK,
            format!("{endpoint} is held by a running tangent (process {pid})"),
        ),
        // A container engine forwards the port to a router in a container.
        Some((pid, name)) if name == "docker-proxy" => Finding::ok(
            CHECK,
            format!("{endpoint} leads into a container (docker-proxy, process {pid})"),
        ),
        holder => Finding::problem(
            CHECK,
            match holder {
                Some((pid, name)) => format!("{endpoint} is held by {name} (process {pid})"),
                None => format!("{endpoint} is held by another user's process"),
            },
            "the router cannot listen there",
            format!(
                "stop that process, or give this cell another port in [zenoh] listen and connect; `ss -ltnp sport = :{}` \
                 as root shows more",
                endpoint.rsplit(':').next().unwrap_or_default()
            ),
        ),
    }
}

/// Process id and name of the process that listens on a TCP port.
fn holder(system: &System, port: u16) -> Option<(u32, String)> {
    let inodes: Vec<String> = ["/proc/net/tcp", "/proc/net/tcp6"]
        .iter()
        .filter_map(|file| system.text(file))
        .flat_map(|text| listeners(&text, port))
        .collect();
    processes::all(system)
        .find(|process| inodes.iter().any(|inode| process.holds(system, inode)))
        .map(|process| (process.pid, process.name(system).unwrap_or_default()))
}

/// Inodes of the sockets that listen on a port, from `/proc/net/tcp`.
fn listeners(table: &str, port: u16) -> Vec<String> {
    let wanted = format!("{port:04X}");
    table
        .lines()
        .skip(1)
        .filter_map(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let local = fields.get(1)?.rsplit_once(':')?.1;
            (local == wanted && *fields.get(3)? == LISTENING)
                .then(|| fields.get(9).map(|inode| (*inode).to_owned()))?
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    #[test]
    fn who_holds_a_port_is_named() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let system = System::here();
        let (pid, name) = holder(&system, port).expect("this process");
        assert_eq!(pid, std::process::id());
        let finding = one(&system, &endpoint).unwrap();
        assert_eq!(finding.level, Level::Problem, "{finding:?}");
        assert!(finding.found.contains(&name), "{finding:?}");
        drop(listener);
        assert_eq!(one(&system, &endpoint).unwrap().level, Level::Ok);
    }

    #[test]
    fn the_cell_s_own_router_may_hold_it() {
        let own = Some((12, "tangent".to_owned()));
        assert_eq!(held("tcp/127.0.0.1:7447", own).level, Level::Ok);
        let unknown = held("tcp/127.0.0.1:7447", None);
        assert_eq!(unknown.level, Level::Problem);
        assert!(unknown.advice.contains(":7447"), "{}", unknown.advice);
    }

    #[test]
    fn who_may_connect_is_reported() {
        let mut config = CellConfig::default_cell();
        assert_eq!(who_may_join(&config).level, Level::Ok);
        config.zenoh.listen = vec!["tcp/0.0.0.0:7447".into()];
        let refused = who_may_join(&config);
        assert_eq!(refused.level, Level::Problem);
        assert!(
            refused.advice.contains("tangent keys new"),
            "{}",
            refused.advice
        );
        config.zenoh.insecure = true;
        let open = who_may_join(&config);
        assert_eq!(open.level, Level::Warning);
        assert!(open.found.contains("tcp/0.0.0.0:7447"), "{}", open.found);
    }

    #[test]
    fn an_address_of_another_machine_is_reported() {
        let finding = one(&System::here(), "tcp/192.0.2.1:7447").unwrap();
        assert_eq!(finding.level, Level::Warning);
    }
}
