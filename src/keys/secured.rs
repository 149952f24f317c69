//! The cell file that goes with a folder of keys: the given one, with the network's section for
//! certificates.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use tangent_runtime::CellConfig;

use crate::output::bad_usage;

/// Where `tangent keys new` has no cell file to start from.
const TEMPLATE: &str = include_str!("../../deploy/cell.real.toml");
/// The router's port.
const PORT: u16 = 7447;

/// The text of `NAME.toml` in the folder of keys: that of `from`, or a real cell to begin with,
/// under this name and with certificates. Paths in it are taken from the folder in which it stands.
///
/// # Errors
/// A file that cannot be read, or that is no cell file.
pub fn cell_file(from: Option<&Path>, name: &str, hosts: &[String]) -> Result<String> {
    let text = match from {
        Some(path) => {
            fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?
        }
        None => TEMPLATE.to_owned(),
    };
    let file = from.map_or("deploy/cell.real.toml".into(), |p| p.display().to_string());
    let given = CellConfig::parse(&file, &text).map_err(bad_usage)?;
    let text = text.replacen(
        &format!("name = \"{}\"", given.cell.name),
        &format!("name = \"{name}\""),
        1,
    );
    let secured = with_section(&text, &section(hosts));
    CellConfig::parse(&file, &secured).map_err(bad_usage)?;
    Ok(secured)
}

/// `[zenoh]` for certificates beside the file. The first host besides loopback is dialled, and then
/// listened for.
fn section(hosts: &[String]) -> String {
    let far = hosts
        .iter()
        .find(|host| !host.starts_with("127.") && *host != "localhost");
    let (dialled, listening) = match far {
        Some(host) if host.contains(':') => (format!("[{host}]"), "[::]"),
        Some(host) => (host.clone(), "0.0.0.0"),
        None => ("127.0.0.1".to_owned(), "127.0.0.1"),
    };
    format!(
        "[zenoh]\n\
         connect = [\"quic/{dialled}:{PORT}\"]\n\
         listen = [\"quic/{listening}:{PORT}\"]\n\
         access = \"access.json5\"                # read by the router\n\n\
         [zenoh.tls]                           # beside this file; {{identity}}: who the process is\n\
         ca = \"ca.pem\"\n\
         certificate = \"{{identity}}.pem\"\n\
         key = \"{{identity}}.key\"\n"
    )
}

/// The text with this in place of its own tables `[zenoh]` and `[zenoh.*]`.
fn with_section(text: &str, section: &str) -> String {
    let mut inside = false;
    let mut kept = String::new();
    for line in text.lines() {
        if let Some(header) = line.trim_start().strip_prefix('[') {
            let name = header.trim_start_matches('[').split([']', '.']).next();
            inside = name.is_some_and(|name| name.trim() == "zenoh");
        }
        if !inside {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    format!("{}\n\n{section}", kept.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_is_replaced_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cell.toml");
        let shipped = tangent_runtime::config::DEFAULT_CELL;
        fs::write(&path, shipped).unwrap();
        let hosts = ["localhost", "127.0.0.1", "router.local"].map(str::to_owned);
        let text = cell_file(Some(&path), "left", &hosts).unwrap();
        let secured: toml::Table = text.parse().unwrap();
        let mut expected: toml::Table = shipped.parse().unwrap();
        expected["cell"]["name"] = "left".into();
        expected["zenoh"] = secured["zenoh"].clone();
        assert_eq!(secured, expected);
        let config = CellConfig::parse("left.toml", &text).unwrap();
        assert_eq!(config.zenoh.connect, ["quic/router.local:7447"]);
        assert_eq!(config.zenoh.listen, ["quic/0.0.0.0:7447"]);
        assert!(config.zenoh.tls.is_some() && config.zenoh.open_to_anybody().is_none());
    }

    #[test]
    fn without_other_hosts_it_stays_on_loopback() {
        let text = cell_file(None, "a", &["localhost".into(), "127.0.0.1".into()]).unwrap();
        let config = CellConfig::parse("a.toml", &text).unwrap();
        assert_eq!(config.cell.name, "a");
        assert_eq!(config.zenoh.listen, ["quic/127.0.0.1:7447"]);
        let six = section(&["fd00::7".into()]);
        assert!(six.contains("quic/[fd00::7]:7447") && six.contains("quic/[::]:7447"));
    }
}
