//! Clients of the script ports that behave like many people's scripts: they write and never read,
//! or vanish.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};

use nix::sys::socket::{setsockopt, sockopt};

use crate::common::{PATIENCE, cb3, connect, rtde_answer, rtde_request, start};
use tangent_live::timed;
use tangent_simulated_ur::{ControllerConfig, Flavour, SimulatedUr};

/// A cell that would soon disconnect a client of RTDE that does not read.
fn impatient() -> SimulatedUr {
    start(ControllerConfig {
        flavour: Flavour::ESeries,
        unread_limit_s: 0.2,
        ..ControllerConfig::default()
    })
}

/// A connection whose buffers are soon full.
fn connect_narrow(address: SocketAddr) -> TcpStream {
    let stream = connect(address);
    setsockopt(&stream, sockopt::RcvBuf, &4096).unwrap();
    stream
}

/// Waits for this number of further cycles.
fn wait_cycles(cell: &SimulatedUr, cycles: u64) {
    assert!(cell.wait_for(PATIENCE, |_| true));
    let until = cell.snapshot().unwrap().cycles + cycles;
    assert!(cell.wait_for(PATIENCE, |s| s.cycles >= until));
}

fn runs(cell: &SimulatedUr, name: &str) -> bool {
    cell.wait_for(PATIENCE, |s| s.program.as_deref() == Some(name))
}

/// ur_rtde sends its script over 30003 and reads nothing there.
#[test]
fn a_client_that_only_writes_keeps_its_connection() {
    timed(|| {
        let cell = impatient();
        let endpoints = *cell.endpoints();
        let mut clients: Vec<TcpStream> =
            [endpoints.primary, endpoints.secondary, endpoints.realtime]
                .map(connect_narrow)
                .into();
        // 4 s: the buffers of the real-time client are full after 0.2 s.
        wait_cycles(&cell, 2000);
        for (n, client) in clients.iter_mut().enumerate() {
            let text = format!("def late_{n}():\n  while True:\n    sync()\n  end\nend\n");
            client.write_all(text.as_bytes()).unwrap();
            assert!(runs(&cell, &format!("late_{n}")));
        }
    });
}

#[test]
fn a_slow_reader_gets_whole_packages_and_then_the_present() {
    timed(|| {
        let cell = impatient();
        let mut slow = connect_narrow(cell.endpoints().realtime);
        wait_cycles(&cell, 1000);
        let now = cell.snapshot().unwrap().summary.time_s;
        let mut last = 0.0;
        let mut largest_gap: f64 = 0.0;
        while last < now {
            let mut package = [0; 1220];
            slow.read_exact(&mut package).unwrap();
            assert_eq!(package[..4], 1220u32.to_be_bytes(), "a torn package");
            let time = f64::from_be_bytes(package[4..12].try_into().unwrap());
            assert!(time > last);
            if last > 0.0 {
                largest_gap = largest_gap.max(time - last);
            }
            last = time;
        }
        assert!(largest_gap > 0.5, "{largest_gap} s left out");
    });
}

/// What ur_rtde does after a crash of the program before it: it stops what runs, twice, and uploads
/// its own script. It gives up if the dashboard does not answer `Stopped`.
#[test]
fn the_successor_of_a_crashed_client_connects_every_time() {
    timed(|| {
        let cell = cb3();
        for n in 0..4 {
            let mut dashboard = BufReader::new(connect(cell.endpoints().dashboard));
            let mut line = String::new();
            dashboard.read_line(&mut line).unwrap();
            let mut script = connect(cell.endpoints().realtime);
            let mut rtde = connect(cell.endpoints().rtde);
            rtde.write_all(&rtde_request(b'V', &[0, 2])).unwrap();
            rtde.write_all(&rtde_request(b'I', b"input_int_register_0"))
                .unwrap();
            // The version is accepted, and the register is free: an INT32.
            assert_eq!(rtde_answer(&mut rtde), (b'V', vec![1]));
            assert_eq!(
                rtde_answer(&mut rtde),
                (b'I', [&[1], &b"INT32"[..]].concat())
            );

            script.write_all(b"stop program\n").unwrap();
            assert!(cell.wait_for(PATIENCE, |s| s.program.is_none()));
            dashboard.get_mut().write_all(b"stop\n").unwrap();
            line.clear();
            dashboard.read_line(&mut line).unwrap();
            assert_eq!(line, "Stopped\n");
            let text = format!("def crash_{n}():\n  while True:\n    sync()\n  end\nend\n");
            script.write_all(text.as_bytes()).unwrap();
            assert!(runs(&cell, &format!("crash_{n}")));
            // The process dies: unread states turn the end of every connection into a reset.
        }
    });
}

/// Its kernel answers the unread stream with a reset, and the program counts all the same.
#[test]
fn a_client_that_leaves_at_once_has_started_its_program() {
    timed(|| {
        let cell = impatient();
        for (n, address) in [cell.endpoints().secondary, cell.endpoints().realtime]
            .into_iter()
            .enumerate()
        {
            let mut client = connect(address);
            // Something to leave unread.
            client.read_exact(&mut [0; 4]).unwrap();
            let text = format!("def short_{n}():\n  while True:\n    sync()\n  end\nend\n");
            client.write_all(text.as_bytes()).unwrap();
            drop(client);
            assert!(runs(&cell, &format!("short_{n}")));
        }
    });
}
