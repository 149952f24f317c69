//! The files of a private cell: a cell file per host, and the scenario that its simulator plays.

use std::path::Path;

use tangent_simulation::AdmittanceScenario;

use crate::error::Result;
use crate::host_clock::Host;
use crate::layout::Layout;

/// The shipped pipe scenario.
const PIPE: &str = include_str!("../../../scenarios/pipe_realistic.toml");
/// The shipped plate scenario, whose surface is replaced.
const PLANE: &str = include_str!("../../../scenarios/plane.toml");

/// Name of the cell file for the services on a host.
pub fn host_file(host: Host) -> String {
    format!("{host:?}.toml").to_lowercase()
}

/// Name of the cell, unique on this machine.
pub fn cell_name() -> String {
    format!("faults-{}", std::process::id())
}

/// Text of the shipped simulated cell at `port_offset`, with its router at port `router` and its
/// sensor at port `rdt`.
///
/// # Errors
/// A shipped file is not TOML, which is a defect.
pub fn cell_text(folder: &Path, port_offset: u16, router: u16, rdt: u16) -> Result<String> {
    let mut cell: toml::Table = tangent_runtime::config::DEFAULT_CELL.parse()?;
    let endpoint = format!("tcp/127.0.0.1:{router}");
    let mut set = |section: &str, key: &str, value: toml::Value| {
        let table = cell
            .entry(section)
            .or_insert_with(|| toml::Table::new().into());
        if let Some(table) = table.as_table_mut() {
            table.insert(key.to_owned(), value);
        }
    };
    set("cell", "name", cell_name().into());
    set("robot", "port_offset", i64::from(port_offset).into());
    set("sensor", "rdt_port", i64::from(rdt).into());
    set("sensor", "http_port", i64::from(8080 + port_offset).into());
    // Most of the processor time of a cell goes into passing records on, and some layouts pass each
    // on several times.
    set("sensor", "rate_hz", 500.0.into());
    set("zenoh", "connect", vec![endpoint.clone()].into());
    set("zenoh", "listen", vec![endpoint].into());
    let recordings = folder.join("recordings");
    set(
        "recorder",
        "folder",
        recordings.display().to_string().into(),
    );
    Ok(cell.to_string())
}

/// The shipped pipe with its realistic sensor and the tool near the surface; or a plate with a
/// ledge across the path.
///
/// # Errors
/// A shipped scenario cannot be read, which is a defect.
pub fn scenario(layout: Layout, seed: u64) -> Result<AdmittanceScenario> {
    let near = "plant.start.clearance_m=0.002".to_owned();
    let seed = format!("seed={seed}");
    if layout != Layout::Ledge {
        return parse("pipe_realistic", PIPE, &[near, seed]);
    }
    // A table of 4 cm, with the floor 6 mm below: the tool reaches the edge in every direction.
    let grid: Vec<f64> = (-35..=35).map(|i| 0.004 * f64::from(i)).collect();
    let mut rows = String::from("y\\x");
    for x in &grid {
        rows.push_str(&format!(",{x:.3}"));
    }
    for y in &grid {
        rows.push_str(&format!("\n{y:.3}"));
        for x in &grid {
            let on_table = x.abs().max(y.abs()) < 0.021;
            rows.push_str(if on_table { ",0.0" } else { ",-0.006" });
        }
    }
    parse(
        "plane",
        PLANE,
        &[
            near,
            seed,
            format!(
                "plant.surface={{ shape = \"height_field\", csv = {rows:?}, position_m = [0.42, 0.0, 0.1] }}"
            ),
            "plant.start.near_m=[0.42, 0.0, 0.1]".to_owned(),
        ],
    )
}

fn parse(name: &str, text: &str, overrides: &[String]) -> Result<AdmittanceScenario> {
    Ok(AdmittanceScenario::parse(
        name,
        text,
        overrides,
        &tangent_simulation::no_files,
    )?)
}
