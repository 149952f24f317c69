//! A router that other hosts can reach without certificates starts only if the cell file permits
//! it, and reports this while it runs.
use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::{Bus, BusError, CellConfig, HealthReporter, Role, State};
use tangent_schemas::topics;

fn beyond_this_host() -> CellConfig {
    let mut config = cell();
    config.zenoh.listen = vec![config.zenoh.connect[0].replace("127.0.0.1", "0.0.0.0")];
    config
}

#[test]
fn a_router_beyond_this_host_in_the_clear_is_refused() {
    timed(|| {
        let config = beyond_this_host();
        let error = Bus::open_within(&config, Role::Router, PATIENCE)
            .map(|_| ())
            .unwrap_err();
        assert!(matches!(error, BusError::Open { .. }), "{error}");
        let said = error.to_string();
        for words in [
            config.zenoh.listen[0].as_str(),
            "127.0.0.1",
            "tangent keys new",
            "insecure = true",
        ] {
            assert!(said.contains(words), "{words} is not in: {said}");
        }
        // A file that was written for the router serves its clients too.
        let mut router = config.clone();
        router.zenoh.insecure = true;
        let _router = Bus::open_within(&router, Role::Router, PATIENCE).unwrap();
        let joined = client(&config);
        assert!(joined.remarks().is_empty());
    });
}

#[test]
fn an_insecure_router_says_so_in_its_health() {
    timed(|| {
        let mut config = beyond_this_host();
        config.zenoh.insecure = true;
        let router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let health = HealthReporter::start(&router, "router").unwrap();
        health.running();
        let operator = client(&config);
        let healths = operator.subscribe(&topics::health("router"), 16).unwrap();
        let mut told = None;
        until("the router's health", || {
            told = healths.try_recv().map(|received| received.message);
            told.as_ref()
                .is_some_and(|health| health.state == State::Running as u8)
        });
        let told = told.unwrap();
        assert_eq!(told.fault, "", "it is no fault");
        let remark = &told.remarks[0];
        assert!(
            remark.contains("insecure") && remark.contains(&config.zenoh.listen[0]),
            "{remark}"
        );

        // On loopback there is no remark.
        let near = cell();
        let quiet = Bus::open_within(&near, Role::Router, PATIENCE).unwrap();
        assert!(quiet.remarks().is_empty());
    });
}
