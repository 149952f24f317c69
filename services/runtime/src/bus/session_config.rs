//! Zenoh configuration of a session: the cell file's section, certificates, access rules, and
//! values found by measurement.

use std::time::Duration;

use serde_json::json;
use zenoh::Config;

use super::error::BusError;
use super::role::Role;
use crate::clock;
use crate::config::{TlsConfig, ZenohConfig};
use crate::places::without_places;
use crate::security;

/// The router sends every message of more than half a packet with this priority. A ROS 2 bridge
/// sends images with the priority of measurements, whose queue holds two packets; a reliable image
/// would close the link of a slow reader.
const IMAGES_BEHIND: &str = r#"[{
    id: "images behind the measurements",
    messages: ["put"],
    flows: ["ingress"],
    payload_size: "32768..1073741824",
    overwrite: { priority: "data_low", congestion_control: "drop" },
}]"#;

/// Configuration of the session. Beyond the cell file it sets only values whose effect on control
/// loops was measured.
pub(crate) fn session_config(
    config: &ZenohConfig,
    namespace: Option<&str>,
    role: Role,
    patience: Option<Duration>,
) -> Result<Config, BusError> {
    let mut zenoh_config = match &config.file {
        Some(path) => Config::from_file(path).map_err(|error| BusError::Configuration {
            key: "zenoh.file".into(),
            value: path.display().to_string(),
            reason: without_places(&error.to_string()).into_owned(),
        })?,
        None => Config::default(),
    };
    if let Some(tls) = &config.tls {
        secure(&mut zenoh_config, config, tls, role)?;
    }
    // Rules in a user's own file are kept.
    let has_rules = zenoh_config
        .get_json("qos/network")
        .is_ok_and(|rules| rules != "[]");
    let mut set = |key: &str, value: String| insert(&mut zenoh_config, key, value);
    if let Some(namespace) = namespace {
        set("namespace", to_json(namespace))?;
    }
    match role {
        Role::Client => {
            set("mode", to_json("client"))?;
            set("connect/endpoints", to_json(&config.connect))?;
            let timeout_ms = patience.map_or(-1, |p| i64::try_from(p.as_millis()).unwrap_or(-1));
            set("connect/timeout_ms", timeout_ms.to_string())?;
            set("connect/exit_on_failure", patience.is_some().to_string())?;
        }
        Role::Router => {
            set("mode", to_json("router"))?;
            set("listen/endpoints", to_json(&config.listen))?;
            set("listen/exit_on_failure", "true".into())?;
            set("connect/endpoints", "[]".into())?;
            if !has_rules {
                set("qos/network", IMAGES_BEHIND.into())?;
            }
        }
    }
    let fixed = [
        // Reconnects within half a second after a router restart.
        (
            "connect/retry",
            "{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 }",
        ),
        // Processes connect only to configured addresses.
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("timestamping/enabled", "false"),
        // With the default of 2, express messages were lost under CPU load.
        ("transport/link/tx/queue/size/real_time", "16"),
        // Images are sent in fragments of 64 KiB: with a queue of 2, no image would arrive whole.
        // 16 is the maximum, and holds 1 MB.
        ("transport/link/tx/queue/size/data_low", "16"),
        // A message waits only briefly before it is dropped, as the next one is newer. The time
        // doubles with each fragment sent: the 17th of an image may wait until the deadline below,
        // and a depth image of 1.6 MB has 25.
        (
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
            "100",
        ),
        (
            "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
            "50000",
        ),
        // A stalled peer is disconnected after half a second, not five.
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            "500000",
        ),
    ];
    for (key, value) in fixed {
        set(key, value.into())?;
    }
    set("transport/link/tx/lease", config.lease_ms.to_string())?;
    set(
        "transport/link/tx/keep_alive",
        config.keep_alive.to_string(),
    )?;
    // The receiver holds the fragments of a message in memory.
    set(
        "transport/link/rx/max_message_size",
        config.message_max_bytes().to_string(),
    )?;
    set(
        "transport/unicast/max_sessions",
        config.sessions_max.to_string(),
    )?;
    Ok(zenoh_config)
}

fn insert(zenoh_config: &mut Config, key: &str, value: String) -> Result<(), BusError> {
    zenoh_config
        .insert_json5(key, &value)
        .map_err(|error| BusError::Configuration {
            key: key.to_owned(),
            value,
            reason: without_places(&error.to_string()).into_owned(),
        })
}

/// Mutual TLS over QUIC on every link; a router reads its access rules from their file.
fn secure(
    zenoh_config: &mut Config,
    config: &ZenohConfig,
    tls: &TlsConfig,
    role: Role,
) -> Result<(), BusError> {
    let found = security::check(tls, clock::now_ns() / 1_000_000_000)?;
    let (own_key, own_certificate) = match role {
        Role::Client => ("connect_private_key", "connect_certificate"),
        Role::Router => ("listen_private_key", "listen_certificate"),
    };
    let mut settings = serde_json::Map::new();
    settings.insert("root_ca_certificate".into(), json!(found.ca));
    settings.insert(own_key.into(), json!(found.key));
    settings.insert(own_certificate.into(), json!(found.certificate));
    settings.insert("enable_mtls".into(), json!(true));
    settings.insert("verify_name_on_connect".into(), json!(true));
    let mut set = |key: &str, value: String| insert(zenoh_config, key, value);
    set("transport/link/tls", json!(settings).to_string())?;
    set("transport/link/protocols", json!(["quic"]).to_string())?;
    if role == Role::Router {
        set("access_control", access_rules(config)?)?;
    }
    Ok(())
}

/// Checks that a router would accept the cell's access rules as they are now.
///
/// # Errors
/// A defect of the rules.
pub(super) fn check_access(config: &ZenohConfig) -> Result<(), BusError> {
    access_rules(config).map(|_| ())
}

/// Text of the access rules, after a check that they deny everything they do not name.
fn access_rules(config: &ZenohConfig) -> Result<String, BusError> {
    let refused = |value: String, reason: &str| BusError::Configuration {
        key: "zenoh.access".into(),
        value,
        reason: without_places(reason).into_owned(),
    };
    let Some(path) = &config.access else {
        return Err(refused(
            "nothing".into(),
            "a router with [zenoh.tls] needs access rules, or every certificate could command the arm; \
             `tangent keys new` writes access.json5",
        ));
    };
    let shown = path.display().to_string();
    let file =
        Config::from_file(path).map_err(|error| refused(shown.clone(), &error.to_string()))?;
    let text = file
        .get_json("access_control")
        .map_err(|error| refused(shown.clone(), &error.to_string()))?;
    let rules: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| refused(shown.clone(), &error.to_string()))?;
    if rules["enabled"] != json!(true) || rules["default_permission"] != json!("deny") {
        return Err(refused(
            shown,
            "its access_control must have enabled: true and default_permission: \"deny\"",
        ));
    }
    Ok(text)
}

fn to_json<T: serde::Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zenoh_accepts_the_configuration_and_applies_it() {
        let config = ZenohConfig::default();
        for role in [Role::Client, Role::Router] {
            let taken = session_config(&config, Some("cell1"), role, None).unwrap();
            let get = |key: &str| taken.get_json(key).unwrap();
            assert_eq!(get("namespace"), "\"cell1\"");
            assert_eq!(get("scouting/multicast/enabled"), "false");
            assert_eq!(get("transport/link/tx/lease"), "1000");
            assert_eq!(get("transport/link/tx/queue/size/real_time"), "16");
            assert_eq!(get("transport/link/rx/max_message_size"), "8000000");
            assert_eq!(get("transport/unicast/max_sessions"), "128");
            assert_eq!(
                get("transport/link/tx/queue/congestion_control/drop/wait_before_drop"),
                "100"
            );
            let rules = get("qos/network");
            assert_eq!(rules.contains("data_low"), role == Role::Router, "{rules}");
        }
        let client = session_config(&config, Some("cell1"), Role::Client, None).unwrap();
        assert_eq!(client.get_json("connect/timeout_ms").unwrap(), "-1");
        assert_eq!(client.get_json("mode").unwrap(), "\"client\"");
    }

    #[test]
    fn a_bad_endpoint_is_named() {
        let config = ZenohConfig {
            connect: vec!["nonsense".into()],
            ..ZenohConfig::default()
        };
        let error = session_config(&config, None, Role::Client, None).unwrap_err();
        assert!(error.to_string().contains("nonsense"), "{error}");
    }
}
