//! Third-party clients of the sensor box from PyPI. Skipped if Python or a package is missing.

use std::net::{IpAddr, Ipv4Addr};
use std::process::Command;

use tangent_live::interop::{python, root};
use tangent_live::timed;
use tangent_simulated_netft::{BoxSample, NetbBox, NetbConfig};

/// Third-party clients from PyPI read the simulated box.
#[test]
fn clients_from_pypi_read_the_box() {
    timed(|| {
        // `netft` supports only the standard port, so the box has a loopback address of its own.
        let address = Ipv4Addr::new(127, 0, 49, 152);
        let simulated = NetbBox::start(NetbConfig {
            address: IpAddr::V4(address),
            rdt_port: 49152,
            ..NetbConfig::default()
        })
        .unwrap();
        simulated.feed().hold(BoxSample {
            counts: [1_000_000, -2_000_000, 3_000_000, 4, -5, 6],
            saturated: false,
        });
        let python = python();
        let output = Command::new(&python)
            .arg(root().join("tests/interop/netft_client.py"))
            .arg(address.to_string())
            .arg(simulated.http_address().port().to_string())
            .output();
        let required = std::env::var_os("TANGENT_REQUIRE_INTEROP").is_some();
        let output = match output {
            Ok(output) => output,
            Err(error) => {
                assert!(!required, "{}: {error}", python.display());
                println!(
                    "skipped, because {} cannot be run: {error}",
                    python.display()
                );
                return;
            }
        };
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.code() == Some(77) {
            assert!(!required, "{said}");
            println!("skipped, because {}", said.trim());
            return;
        }
        assert!(output.status.success(), "{said}\n{errors}");
        println!("{said}");
        assert!(said.contains("netft: ok"), "{said}");
        assert!(
            said.contains("pynetft: ok") || (said.contains("pynetft: missing") && !required),
            "{said}"
        );
    });
}
