//! Events that must neither end a process silently nor block it: a sensor box with invalid answers,
//! and a log that no process reads.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::time::Duration;

use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::wait_for;
use tangent_live::live_beside_others;

/// A box whose web server answers `rate` for its records per second, as long as the process lives.
fn box_with_rate(port: u16, rate: &'static str) {
    let listener = TcpListener::bind(("127.0.0.1", port)).unwrap();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            let Ok(mut client) = client else { return };
            let _ = client.read(&mut [0; 4096]);
            let body = format!(
                "<?xml version=\"1.0\"?><netft><prodname>Net F/T</prodname><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>\
                 <scfgfu>N</scfgfu><scfgtu>N-m</scfgtu><comrdtrate>{rate}</comrdtrate></netft>"
            );
            let _ = write!(
                client,
                "HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
                body.len()
            );
        }
    });
}

/// The bug: the rate was converted to a duration of 3e30 s, and the thread died: `status` showed
/// nothing from then on.
#[test]
fn a_box_with_an_impossible_rate_is_refused_by_name_and_tried_again() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        box_with_rate(8080 + cell.port_offset(), "1e-30");
        cell.start_all(&["router netft"]);
        let fault = wait_for("status names what is wrong", PATIENCE, || {
            let output = cell.cli(&["status", "--json"]);
            let status: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
            let services = status["services"].as_array()?;
            let netft = services.iter().find(|s| s["name"] == "netft")?;
            let fault = netft["fault"].as_str()?;
            fault.contains("comrdtrate").then(|| fault.to_owned())
        });
        assert!(
            fault.contains("from 1 to 7000 records per second"),
            "{fault}"
        );
        cell.assert_running(&["router netft"]);
        let names = ["router netft"];
        let code = cell.process(names[0]).terminate(PATIENCE);
        assert_eq!(code, Some(0));
    });
}

/// The bug: with its log on a full pipe that no process reads, the loop was blocked for as long as
/// the pipe was full.
#[test]
fn a_log_without_a_reader_blocks_no_thread() {
    live_beside_others(|| {
        let (reader, writer) = std::io::pipe().unwrap();
        let mut filler = writer.try_clone().unwrap();
        // Writes until the pipe is full, and then until the reader has closed it.
        let filling = std::thread::spawn(move || while filler.write_all(&[b'.'; 4096]).is_ok() {});
        let mut cell = Cell::new(|_| {});
        cell.start_all(&["router simulator netft", "estimator"]);
        cell.start_into("rtde controller", writer);
        let observer = Observer::join(&cell);
        observer.slide(&cell, &cell.long_task());
        // A fault, which causes many log lines, and the task after it.
        let before = now_ns();
        cell.process("estimator").kill();
        observer.phase("fault", before);
        let cycles = observer.arm().map_or(0, |arm| arm.cycle);
        let later = wait_for("cycles go on", PATIENCE, || {
            let now = observer.arm().map_or(0, |arm| arm.cycle);
            (now > cycles + 500).then_some(now)
        });
        assert!(later > cycles);
        let ended = cell
            .process("rtde controller")
            .terminate(Duration::from_secs(60));
        assert_eq!(ended, Some(0));
        drop(reader);
        filling.join().unwrap();
    });
}
