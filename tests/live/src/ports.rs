//! Ports on loopback that no other test of this machine takes.

use std::collections::{HashSet, VecDeque};
use std::fs::{self, File};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU16, Ordering};

/// First of the ports that [`free`] returns, and how many they are. They lie below the ports that
/// the system gives to outgoing connections, and beside those of simulated devices.
const RANGE: (u16, u16) = (11_000, 18_000);

/// Lock files of the ports that this process has taken.
static TAKEN: Mutex<Vec<File>> = Mutex::new(Vec::new());

/// A port without a TCP or UDP socket. It is reserved for this process until the process ends.
///
/// # Panics
/// If all ports are in use, or the folder for temporary files cannot be written.
pub fn free() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let (first, count) = RANGE;
    let start = std::process::id().wrapping_mul(7919);
    let in_use = in_use();
    for _ in 0..count {
        let turn = u32::from(NEXT.fetch_add(1, Ordering::Relaxed));
        let port = first + (start.wrapping_add(turn) % u32::from(count)) as u16;
        if in_use.contains(&port) {
            continue;
        }
        if let Some(file) = reserve("port", port) {
            TAKEN.lock().expect("nothing panics with it").push(file);
            return port;
        }
    }
    panic!("no free port on loopback");
}

/// Ports of a simulated cell without an offset.
const OF_A_CELL: [u16; 9] = [
    1337, 7447, 8080, 29_999, 30_001, 30_002, 30_003, 30_004, 49_152,
];

/// More than the offsets whose cells start at the same time in one process.
const OFFSETS_MAX: usize = 8;

/// Lock files of the offsets that this process took last, the oldest first.
static OFFSETS: Mutex<VecDeque<File>> = Mutex::new(VecDeque::new());

/// An offset at which all ports of a simulated cell are free now, and which no other test takes
/// before the cell has opened them.
///
/// # Panics
/// If no offset is free, or the folder for temporary files cannot be written.
pub fn offset() -> u16 {
    // Tests run concurrently, here and in other processes: each tries offsets of its own.
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let start = (std::process::id() % 97) as u16;
    for _ in 0..100 {
        let turn = NEXT.fetch_add(1, Ordering::Relaxed);
        // The robot's ports stay below those that the system gives to outgoing connections, which
        // would take one between this look and the simulator's start.
        let offset = 100 + (start + turn) % 70 * 37;
        let Some(reserved) = reserve("ports", offset) else {
            continue;
        };
        let in_use = in_use();
        if OF_A_CELL.iter().all(|p| !in_use.contains(&(p + offset))) {
            let mut all = OFFSETS.lock().expect("nothing panics with it");
            all.push_back(reserved);
            while all.len() > OFFSETS_MAX {
                all.pop_front();
            }
            return offset;
        }
    }
    panic!("no free ports on loopback");
}

/// Takes the lock file of a port or an offset; `None` if another process, or this one, has it. A
/// cell opens its ports a moment after its offset was chosen.
fn reserve(what: &str, number: u16) -> Option<File> {
    let path = std::env::temp_dir().join(format!("tangent-test-{what}.{number}.lock"));
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
        .expect("the folder for temporary files can be written");
    file.try_lock().ok().map(|()| file)
}

/// Ports of this host that have a socket. Binding a port as a trial would occupy it: a child
/// process that another test starts at that moment inherits the socket until it runs its own
/// program.
pub fn in_use() -> HashSet<u16> {
    ["tcp", "tcp6", "udp", "udp6"]
        .iter()
        .filter_map(|table| fs::read_to_string(format!("/proc/net/{table}")).ok())
        .flat_map(|text| text.lines().skip(1).map(local_port).collect::<Vec<_>>())
        .flatten()
        .collect()
}

/// Port of a line such as `  1: 0100007F:1F90 ...`, here 0x1F90.
fn local_port(line: &str) -> Option<u16> {
    let address = line.split_whitespace().nth(1)?;
    u16::from_str_radix(address.rsplit_once(':')?.1, 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_returned_once() {
        let ports: HashSet<u16> = (0..20).map(|_| free()).collect();
        assert_eq!(ports.len(), 20);
    }

    #[test]
    fn an_offset_is_returned_once_while_its_cell_starts() {
        let offsets: HashSet<u16> = (0..OFFSETS_MAX).map(|_| offset()).collect();
        assert_eq!(offsets.len(), OFFSETS_MAX);
    }

    #[test]
    fn a_port_with_a_socket_is_in_use() {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").expect("loopback is there");
        let port = socket.local_addr().expect("it is bound").port();
        assert!(in_use().contains(&port));
    }
}
