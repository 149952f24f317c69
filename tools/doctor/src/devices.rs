//! Checks robot and sensor: whether they are reachable, of the right kind, and set up as the cell
//! file states.

use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use tangent_netft::BoxConfig;
use tangent_rtde::codec::ControllerVersion;
use tangent_rtde::dashboard::{Dashboard, DashboardError, ur_size};
use tangent_rtde::inquiry::controller_version;
use tangent_runtime::CellConfig;

use crate::finding::Finding;

/// Timeout of the sensor's web server.
const HTTP_TIMEOUT: Duration = Duration::from_secs(2);

/// Checks the robot: its ports, software, model, mode and remote control.
pub fn robot(config: &CellConfig) -> Vec<Finding> {
    const CHECK: &str = "robot";
    let settings = match tangent_rtde::Config::from_cell(config) {
        Ok(settings) => settings,
        Err(error) => {
            return vec![Finding::problem(
                CHECK,
                error.to_string(),
                "the bridge does not start",
                "correct the cell file",
            )];
        }
    };
    let timeout = settings.connect_timeout;
    let mut findings = Vec::new();
    match controller_version(&settings.host, settings.rtde_port, timeout) {
        Ok(version) => findings.push(software(&settings, version)),
        Err(error) => {
            findings.push(Finding::problem(
                CHECK,
                format!("{}:{}: {error}", settings.host, settings.rtde_port),
                "RTDE does not answer: the bridge cannot connect",
                "is the controller on, the cable connected, [robot] address right, RTDE enabled (Settings, Security, Services)? For a simulated \
                 cell: `tangent run router simulator`",
            ));
            return findings;
        }
    }
    if let Err(error) = reach(&settings.host, settings.script_port, timeout) {
        findings.push(Finding::problem(
            "robot's script port",
            format!("{}:{}: {error}", settings.host, settings.script_port),
            "the bridge cannot send its program",
            "enable the primary client interface (Settings, Security, Services), and check firewalls",
        ));
    }
    match dashboard(&settings.host, settings.dashboard_port, timeout)
        .and_then(|mut dashboard| conversation(&mut dashboard, config))
    {
        Ok(told) => findings.extend(told),
        Err(error) => findings.push(Finding::warning(
            "robot's dashboard",
            error.to_string(),
            "model and remote mode are not known, and the bridge cannot power the arm or leave a protective stop",
            "enable the dashboard server (Settings, Security, Services)",
        )),
    }
    findings
}

fn software(settings: &tangent_rtde::Config, version: ControllerVersion) -> Finding {
    const CHECK: &str = "robot's software";
    let expected = settings.bridge.series;
    if let Some(expected) = expected
        && expected != version.series()
    {
        return Finding::problem(
            CHECK,
            format!(
                "{version} is {}, but [robot] model = \"{}\" is {}",
                version.series(),
                settings.bridge.model,
                expected
            ),
            "not the robot that the cell file names: the bridge refuses it",
            "correct [robot] model or address",
        );
    }
    if !version.has_upper_registers() {
        return Finding::problem(
            CHECK,
            format!("{version}"),
            "registers 24 to 47 are closed to RTDE before 3.9 and 5.3: the bridge refuses it",
            "update PolyScope",
        );
    }
    Finding::ok(
        CHECK,
        format!("{version}, {} Hz", version.series().rate_hz()),
    )
}

fn addresses(host: &str, port: u16) -> std::io::Result<std::net::SocketAddr> {
    (host, port).to_socket_addrs()?.next().ok_or_else(|| {
        std::io::Error::new(
            std::io::ErrorKind::NotFound,
            format!("{host} has no address"),
        )
    })
}

fn reach(host: &str, port: u16, timeout: Duration) -> std::io::Result<()> {
    TcpStream::connect_timeout(&addresses(host, port)?, timeout).map(drop)
}

fn dashboard(host: &str, port: u16, timeout: Duration) -> Result<Dashboard, DashboardError> {
    let address = addresses(host, port).map_err(|error| DashboardError::Connection {
        address: std::net::SocketAddr::from(([0, 0, 0, 0], port)),
        reason: error.to_string(),
    })?;
    Dashboard::connect(address, timeout)
}

fn conversation(
    dashboard: &mut Dashboard,
    config: &CellConfig,
) -> Result<Vec<Finding>, DashboardError> {
    let mut findings = Vec::new();
    let model = dashboard.robot_model()?;
    let (here, there) = (
        ur_size(&config.robot.model),
        model.as_deref().and_then(ur_size),
    );
    findings.extend(model.map(|model| {
        if here.is_some() && here != there {
            Finding::problem(
                "robot's model",
                format!("{model}, but [robot] model = \"{}\"", config.robot.model),
                "its kinematics are those of another arm: the bridge does not move it",
                "correct [robot] model or address",
            )
        } else {
            Finding::ok("robot's model", model)
        }
    }));
    findings.push(match dashboard.is_in_remote_control()? {
        Some(false) => Finding::problem(
            "remote control",
            "off",
            "the controller accepts no program from the network",
            "switch the pendant to Remote Control",
        ),
        Some(true) => Finding::ok("remote control", "on"),
        None => Finding::ok("remote control", "this controller has no such mode"),
    });
    let mode = dashboard.robot_mode()?;
    findings.push(if mode == "RUNNING" {
        Finding::ok("robot's mode", mode)
    } else if config.robot.power_on {
        Finding::ok(
            "robot's mode",
            format!("{mode}; the bridge powers it on ([robot] power_on)"),
        )
    } else {
        Finding::warning(
            "robot's mode",
            mode,
            "the arm does not move",
            "power on and release the brakes at the pendant, or set [robot] power_on = true",
        )
    });
    Ok(findings)
}

/// Checks the sensor's own configuration, over HTTP.
pub fn sensor(config: &CellConfig) -> Vec<Finding> {
    let sensor = &config.sensor;
    let port = sensor.http_port.saturating_add(sensor.port_offset);
    match BoxConfig::fetch(&sensor.address, port, HTTP_TIMEOUT) {
        Ok(found) => judge(config, &found),
        Err(error) => vec![Finding::problem(
            "sensor",
            error.to_string(),
            "without its units and scales no record can be used",
            "is the box on, the cable connected, [sensor] address right (192.168.1.1 as delivered, DIP switch 9), \
             http_port 80 for a real box?",
        )],
    }
}

fn judge(config: &CellConfig, found: &BoxConfig) -> Vec<Finding> {
    let sensor = &config.sensor;
    let mut findings = vec![Finding::ok(
        "sensor",
        format!(
            "{} {} {}: {:.3e} N and {:.3e} Nm per count",
            found.product,
            found.serial,
            found.calibration,
            found.newton_per_count,
            found.newton_metre_per_count
        )
        .replace("  ", " "),
    )];
    findings.push(match (found.rate_hz, sensor.rate_stated_hz()) {
        (Some(rate), Some(asked)) if (rate - asked).abs() > 0.5 => Finding::warning(
            "sensor's rate",
            format!("{rate} Hz, and [sensor] rate_hz = {asked}"),
            "netft sets the box's rate when it starts, for every client of the box, and puts it back when it ends",
            "nothing, if this cell is its only client; else remove rate_hz from [sensor]",
        ),
        (Some(rate), _) => Finding::ok("sensor's rate", format!("{rate} Hz")),
        (None, _) => Finding::ok("sensor's rate", "the box does not report it"),
    });
    findings.push(match found.filter {
        Some(0) => Finding::ok("sensor's filter", "off"),
        Some(number) => Finding::warning(
            "sensor's filter",
            format!("low-pass filter number {number} is on"),
            "it delays every record, and this delay is not accounted for",
            "switch it off on the box's web page (Settings); netft filters, with a delay that it reports",
        ),
        None => Finding::ok("sensor's filter", "the box does not report it"),
    });
    if found.transformed {
        findings.push(Finding::problem(
            "sensor's transform",
            "the box transforms its readings into another frame",
            "payload and tool frame of the cell file are then wrong: gravity appears as contact",
            "clear the tool transform on the box's web page (Configurations)",
        ));
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    fn sensor_box(extra: &str) -> BoxConfig {
        BoxConfig::parse(&format!(
            "<netft><prodname>Net F/T</prodname><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt><scfgfu>N</scfgfu>\
             <scfgtu>N-m</scfgtu><comrdtrate>7000</comrdtrate>{extra}</netft>"
        ))
        .unwrap()
    }

    fn level(extra: &str, check: &str) -> Option<Level> {
        judge(&CellConfig::default_cell(), &sensor_box(extra))
            .into_iter()
            .find(|f| f.check == check)
            .map(|f| f.level)
    }

    #[test]
    fn a_box_with_a_filter_or_a_tool_transform_is_reported() {
        assert_eq!(level("", "sensor's rate"), Some(Level::Ok));
        let filter = "<setuserfilter>2</setuserfilter>";
        assert_eq!(level(filter, "sensor's filter"), Some(Level::Warning));
        assert_eq!(level("", "sensor's transform"), None);
        let turned = "<cfgtfx>0;0;0;0;0;45</cfgtfx>";
        assert_eq!(level(turned, "sensor's transform"), Some(Level::Problem));
    }
}
