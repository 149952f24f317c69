//! Third-party clients of the sensor box from PyPI. Skipped if Python or a package is missing.

use std::net::{IpAddr, Ipv4Addr};

use tangent_live::interop::{is_required, output_of};
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
        let http_port = simulated.http_address().port();
        let arguments = [address.to_string(), http_port.to_string()];
        let Some(said) = output_of("netft_client.py", &arguments) else {
            return;
        };
        println!("{said}");
        assert!(said.contains("netft: ok"), "{said}");
        assert!(
            said.contains("pynetft: ok") || (said.contains("pynetft: missing") && !is_required()),
            "{said}"
        );
    });
}
