//! Checks the network path to robot and sensor: which network card it uses, and whether the card
//! delays or loses packets.

use std::net::{IpAddr, Ipv4Addr, ToSocketAddrs};
use std::time::Duration;

use tangent_netft::{RdtSocket, SOCKET_BUFFER_BYTES};
use tangent_runtime::CellConfig;

use crate::cell_arm::CellArm;
use crate::ethtool;
use crate::finding::Finding;
use crate::system::System;

/// Interrupt delay of a card from which a warning is given, µs.
const COALESCING_US: u32 = 50;
/// Share of faulty packets from which a warning is given.
const ERRORS: f64 = 1e-4;

/// Checks the network cards that lead to the cell's devices, and the sensor's socket.
pub fn check(system: &System, config: &CellConfig) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut seen = Vec::new();
    let box_there = CellArm::of(config).has_sensor_box(config);
    for (device, host) in [
        ("robot", Some(&config.robot.address)),
        ("sensor", box_there.then_some(&config.sensor.address)),
    ] {
        let Some(host) = host else {
            continue;
        };
        // The check of the device reports a name that does not resolve.
        let Some(IpAddr::V4(address)) = resolve(host) else {
            continue;
        };
        match interface(system, address) {
            Some(card) if seen.contains(&card) => {}
            Some(card) => {
                findings.extend(judge(system, &card, ethtool::receive_delay_us(&card)));
                seen.push(card);
            }
            None => findings.push(Finding::problem(
                "network card",
                format!("no route to the {device} at {address}"),
                "it cannot be reached from this machine",
                "give a network card of this machine an address in the same network, `ip address add ADDRESS/24 dev CARD`",
            )),
        }
    }
    if box_there {
        findings.extend(sensor_socket(config));
    }
    findings
}

/// Whether a host is this machine, by its loopback address.
pub fn is_this_machine(host: &str) -> bool {
    resolve(host).is_some_and(|address| address.is_loopback())
}

fn resolve(host: &str) -> Option<IpAddr> {
    (host, 0)
        .to_socket_addrs()
        .ok()?
        .map(|a| a.ip())
        .find(IpAddr::is_ipv4)
}

/// The network card for `address`: the longest matching prefix in the kernel's routing table.
fn interface(system: &System, address: Ipv4Addr) -> Option<String> {
    if address.is_loopback() || address.is_unspecified() {
        return Some("lo".to_owned());
    }
    let wanted = u32::from_le_bytes(address.octets());
    let table = system.text("/proc/net/route")?;
    table
        .lines()
        .skip(1)
        .filter_map(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let hex = |i: usize| u32::from_str_radix(fields.get(i)?, 16).ok();
            let (network, mask) = (hex(1)?, hex(7)?);
            (wanted & mask == network)
                .then(|| Some((mask.count_ones(), (*fields.first()?).to_owned())))?
        })
        .max()
        .map(|(_, card)| card)
}

fn judge(system: &System, card: &str, receive_delay_us: Option<u32>) -> Vec<Finding> {
    const CHECK: &str = "network card";
    let file = |name: &str| format!("/sys/class/net/{card}/{name}");
    if card == "lo" {
        return vec![Finding::ok(CHECK, "lo: the device is on this machine")];
    }
    let mut findings = vec![link(system, card)];
    if let Some(us) = receive_delay_us {
        let found = format!("{card} waits up to {us} us for more packets before it interrupts");
        findings.push(if us <= COALESCING_US {
            Finding::ok("interrupt delay", found)
        } else {
            Finding::warning(
                "interrupt delay",
                found,
                "every packet of robot and sensor arrives later by this time",
                format!("ethtool -C {card} adaptive-rx off rx-usecs 0"),
            )
        });
    }
    let count = |name| system.number(&file(&format!("statistics/{name}")));
    if let (Some(packets), Some(errors), Some(dropped)) =
        (count("rx_packets"), count("rx_errors"), count("rx_dropped"))
    {
        let bad = (errors + dropped) as f64 / packets.max(1) as f64;
        let found =
            format!("{card}: {errors} faulty and {dropped} dropped of {packets} packets received");
        findings.push(if bad <= ERRORS {
            Finding::ok("received packets", found)
        } else {
            Finding::warning(
                "received packets",
                found,
                "records of the sensor and states of the robot go missing",
                "try another cable or switch port; `ethtool -S` shows which kind of fault",
            )
        });
    }
    findings
}

fn link(system: &System, card: &str) -> Finding {
    const CHECK: &str = "network card";
    let file = |name: &str| format!("/sys/class/net/{card}/{name}");
    let driver = system
        .link_name(&file("device/driver"))
        .unwrap_or_else(|| "virtual".to_owned());
    if system.exists(&file("wireless")) || system.exists(&file("phy80211")) {
        return Finding::problem(
            CHECK,
            format!("{card} is wireless ({driver})"),
            "pauses of 100 ms and more are normal there: the robot stops each time",
            "a cable, to the robot's side at least; estimators and the recorder may be wireless",
        );
    }
    if system.number(&file("carrier")) == Some(0) {
        return Finding::problem(
            CHECK,
            format!("{card} has no link ({driver})"),
            "nothing is connected, or the connected device is off",
            "check cable and switch",
        );
    }
    let speed = system.number(&file("speed")).filter(|mbps| *mbps > 0);
    let duplex = system.text(&file("duplex")).unwrap_or_default();
    let found = match speed {
        Some(mbps) => format!("{card} ({driver}): {mbps} Mbit/s, {duplex} duplex"),
        None => format!("{card} ({driver})"),
    };
    if speed.is_some_and(|mbps| mbps < 100) || duplex == "half" {
        Finding::warning(
            CHECK,
            found,
            "packets delay one another",
            "let both ends negotiate (no fixed speed), and change the cable",
        )
    } else {
        Finding::ok(CHECK, found)
    }
}

/// Longest pause of the sensor's reader without losing a record.
fn sensor_socket(config: &CellConfig) -> Option<Finding> {
    const CHECK: &str = "socket buffer";
    let sensor = &config.sensor;
    let port = sensor.rdt_port.checked_add(sensor.port_offset)?;
    let wait = Duration::from_millis(1);
    let socket = RdtSocket::connect(&sensor.address, port, SOCKET_BUFFER_BYTES, wait).ok()?;
    let seconds = socket.buffer_records() as f64 / sensor.rate_max_hz();
    let found = format!("holds {seconds:.2} s of the sensor's records");
    Some(if seconds >= 0.25 {
        Finding::ok(CHECK, found)
    } else {
        Finding::warning(
            CHECK,
            found,
            "a longer pause of this machine loses records; they are counted",
            format!(
                "sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}, and the same in /etc/sysctl.d/tangent.conf"
            ),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use crate::system::tests::machine;

    const ROUTES: &str = "Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT\n\
        eth0\t00000000\t0100A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n\
        eth1\t0001A8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n";

    #[test]
    fn the_card_is_the_one_that_the_kernel_sends_by() {
        let (_folder, system) = machine(&[("/proc/net/route", ROUTES)]);
        let card = |a: [u8; 4]| interface(&system, Ipv4Addr::from(a));
        assert_eq!(card([192, 168, 1, 10]).as_deref(), Some("eth1"));
        assert_eq!(card([10, 0, 0, 1]).as_deref(), Some("eth0"));
        assert_eq!(card([127, 0, 0, 9]).as_deref(), Some("lo"));
        let (_folder, alone) = machine(&[("/proc/net/route", "Iface\n")]);
        assert_eq!(interface(&alone, Ipv4Addr::new(10, 0, 0, 1)), None);
    }

    fn card(files: &[(&str, &str)], delay_us: Option<u32>) -> Vec<Finding> {
        let files: Vec<(String, &str)> = files
            .iter()
            .map(|(name, text)| (format!("/sys/class/net/e/{name}"), *text))
            .collect();
        let files: Vec<(&str, &str)> = files.iter().map(|(p, t)| (p.as_str(), *t)).collect();
        judge(&machine(&files).1, "e", delay_us)
    }

    #[test]
    fn cards_are_judged() {
        let good = [("carrier", "1"), ("speed", "1000"), ("duplex", "full")];
        assert_eq!(card(&good, None)[0].level, Level::Ok);
        assert_eq!(card(&[("carrier", "0")], None)[0].level, Level::Problem);
        assert_eq!(card(&[("wireless/x", "")], None)[0].level, Level::Problem);
        let slow = [("carrier", "1"), ("speed", "10"), ("duplex", "full")];
        assert_eq!(card(&slow, None)[0].level, Level::Warning);
        // A virtual card reports -1.
        assert_eq!(
            card(&[("carrier", "1"), ("speed", "-1")], None)[0].level,
            Level::Ok
        );
        assert_eq!(card(&good, Some(3))[1].level, Level::Ok);
        let late = &card(&good, Some(200))[1];
        assert_eq!(late.level, Level::Warning);
        assert!(late.advice.contains("rx-usecs 0"), "{}", late.advice);
        let lossy = [
            ("carrier", "1"),
            ("statistics/rx_packets", "1000"),
            ("statistics/rx_errors", "7"),
            ("statistics/rx_dropped", "0"),
        ];
        assert_eq!(card(&lossy, None)[1].level, Level::Warning);
    }
}
