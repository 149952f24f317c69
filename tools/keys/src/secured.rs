//! The cell file for a folder of keys: the given cell file with a network section for certificates.

use std::fs;
use std::path::Path;

use tangent_runtime::CellConfig;

use crate::error::KeysError;

/// Cell file that `tangent keys new` uses if none is given.
const TEMPLATE: &str = include_str!("../../../deploy/cell.real.toml");
/// The router's TCP port.
const PORT: u16 = 7447;

/// Returns the text of `NAME.toml` in the folder of keys: that of `from`, or of the template, with
/// this cell name and with certificates. Relative paths in it refer to the folder of the file.
///
/// # Errors
/// The file cannot be read, or is not a cell file.
pub fn cell_file(from: Option<&Path>, name: &str, hosts: &[String]) -> Result<String, KeysError> {
    let text = match from {
        Some(path) => fs::read_to_string(path).map_err(|source| KeysError::Read {
            path: path.to_owned(),
            source,
        })?,
        None => TEMPLATE.to_owned(),
    };
    let file = from.map_or("deploy/cell.real.toml".into(), |p| p.display().to_string());
    let given = CellConfig::parse(&file, &text).map_err(KeysError::usage)?;
    let text = text.replacen(
        &format!("name = \"{}\"", given.cell.name),
        &format!("name = \"{name}\""),
        1,
    );
    let secured = with_section(&text, &section(hosts));
    CellConfig::parse(&file, &secured).map_err(KeysError::usage)?;
    Ok(secured)
}

/// Returns the section `[zenoh]` for certificates next to the file. Services connect to the first
/// host that is not loopback; if there is one, the router listens on all interfaces.
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

/// Returns the text with `section` in place of its own tables `[zenoh]` and `[zenoh.*]`.
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
