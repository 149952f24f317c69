//! Certificates and access rules, tested with real sessions over mutual TLS on loopback.
use std::path::Path;
use std::time::Duration;

use crate::common::{PATIENCE, cell, until};
use tangent_live::timed;
use tangent_runtime::bus::answer;
use tangent_runtime::config::TlsConfig;
use tangent_runtime::security::{Authority, Fleet, access, roles};
use tangent_runtime::{Bus, BusError, CellConfig, HealthReporter, Question, Role};
use tangent_schemas::standard::PoseWithCovarianceStamped;
use tangent_schemas::tangent::{ArmCommand, ArmState, Health, NormalEstimate, Request};
use tangent_schemas::topics::{self, queries};

/// Time after which a message that has not arrived counts as refused.
const NOTHING: Duration = Duration::from_millis(500);

/// A cell with keys in `folder`, and its router.
struct Secured {
    config: CellConfig,
    folder: tempfile::TempDir,
    fleet: Fleet,
    router: Bus,
}

fn secured() -> Secured {
    let folder = tempfile::tempdir().unwrap();
    let mut config = cell();
    let name = config.cell.name.clone();
    let mut fleet = Fleet::of(&[&name, "other"]);
    fleet.also = ["x", "y"]
        .map(|host| format!("estimator-{host}.{name}"))
        .to_vec();
    let authority = Authority::open_or_create(folder.path()).unwrap();
    for identity in fleet.identities() {
        authority
            .issue(&identity, &["127.0.0.1".into()], 10)
            .unwrap();
    }
    let rules = folder.path().join("access.json5");
    std::fs::write(&rules, access::text(&fleet)).unwrap();
    let endpoint = config.zenoh.listen[0].replace("tcp/", "quic/");
    config.zenoh.listen = vec![endpoint.clone()];
    config.zenoh.connect = vec![endpoint];
    config.zenoh.access = Some(rules);
    config.zenoh.tls = Some(tls(folder.path()));
    let mut router = config.clone();
    router.zenoh.identify("router");
    Secured {
        router: Bus::open_within(&router, Role::Router, PATIENCE).unwrap(),
        config,
        folder,
        fleet,
    }
}

fn tls(folder: &Path) -> TlsConfig {
    TlsConfig {
        ca: folder.join("ca.pem"),
        certificate: folder.join("{identity}.pem"),
        key: folder.join("{identity}.key"),
        identity: None,
    }
}

impl Secured {
    fn config(&self, role: &str) -> CellConfig {
        let mut config = self.config.clone();
        config
            .zenoh
            .identify(&roles::identity(role, &self.config.cell.name));
        config
    }

    fn join(&self, role: &str) -> Bus {
        Bus::open_within(&self.config(role), Role::Client, PATIENCE).unwrap()
    }
}

fn command(cycle: u64) -> ArmCommand {
    ArmCommand {
        cycle,
        kind: 1,
        ..ArmCommand::default()
    }
}

#[test]
fn only_the_controllers_commands_reach_the_arm() {
    timed(|| {
        let cell = secured();
        let (robot, controller) = (cell.join("rtde"), cell.join("controller"));
        let heard = robot.subscribe(&topics::ARM_COMMAND, 100).unwrap();
        // An identity of another cell that uses this cell's name.
        let mut foreign = cell.config.clone();
        foreign.zenoh.identify("controller.other");
        let foreign = Bus::open_within(&foreign, Role::Client, PATIENCE).unwrap();
        let intruders: Vec<Bus> = [
            "estimator",
            "netft",
            "operator",
            "recorder",
            "viewer",
            "simulator",
        ]
        .iter()
        .map(|role| cell.join(role))
        .chain([foreign])
        .collect();
        let publishers: Vec<_> = intruders
            .iter()
            .map(|bus| {
                bus.raw_publisher(
                    topics::ARM_COMMAND.key(),
                    topics::ARM_COMMAND.message_name(),
                )
                .unwrap()
            })
            .collect();
        let mut bytes = Vec::new();
        tangent_schemas::cdr::encode(&command(666), &mut bytes).unwrap();

        let commands = controller.publisher(&topics::ARM_COMMAND).unwrap();
        until("the bridge listens", || commands.is_read_remotely());
        for cycle in 1..=20 {
            publishers
                .iter()
                .for_each(|publisher| publisher.publish(&bytes));
            commands.publish(&command(cycle));
            assert_eq!(heard.recv_timeout(PATIENCE).unwrap().message.cycle, cycle);
        }
        assert!(
            heard.recv_timeout(NOTHING).is_none(),
            "an intruder's command arrived"
        );
        assert_eq!(heard.counts().received, 20);
    });
}

/// A publisher of the base's pose could move the arm by it.
#[test]
fn only_the_platforms_poses_reach_the_controller() {
    timed(|| {
        let cell = secured();
        let (controller, platform) = (cell.join("controller"), cell.join("base"));
        let heard = controller.subscribe(&topics::BASE_POSE, 100).unwrap();
        let intruders = ["estimator", "rtde", "operator", "simulator", "viewer"].map(|role| {
            let bus = cell.join(role);
            let publisher = bus
                .raw_publisher(topics::BASE_POSE.key(), topics::BASE_POSE.message_name())
                .unwrap();
            (bus, publisher)
        });
        let pose = |x: f64| {
            let mut pose = PoseWithCovarianceStamped::default();
            pose.pose.pose.position.x = x;
            pose
        };
        let mut bytes = Vec::new();
        tangent_schemas::cdr::encode(&pose(666.0), &mut bytes).unwrap();
        let poses = platform.publisher(&topics::BASE_POSE).unwrap();
        until("the controller listens", || poses.is_read_remotely());
        for i in 1..=20 {
            intruders
                .iter()
                .for_each(|(_, publisher)| publisher.publish(&bytes));
            poses.publish(&pose(f64::from(i)));
            let said = heard.recv_timeout(PATIENCE).unwrap().message;
            assert_eq!(said.pose.pose.position.x, f64::from(i));
        }
        assert!(
            heard.recv_timeout(NOTHING).is_none(),
            "an intruder's pose arrived"
        );
    });
}

#[test]
fn a_session_without_a_certificate_is_refused() {
    timed(|| {
        let cell = secured();
        // With the authority's public certificate, and none of its own.
        let file = cell.folder.path().join("unidentified.json5");
        let ca = cell.folder.path().join("ca.pem");
        std::fs::write(
            &file,
            serde_json::json!({"transport": {"link": {"tls": {"root_ca_certificate": ca}}}})
                .to_string(),
        )
        .unwrap();
        let mut unidentified = cell.config.clone();
        unidentified.zenoh.tls = None;
        unidentified.zenoh.file = Some(file);
        let patience = Duration::from_secs(3);
        let refused = Bus::open_within(&unidentified, Role::Client, patience)
            .map(|_| ())
            .unwrap_err();
        assert!(matches!(refused, BusError::NoRouter { .. }), "{refused}");
        assert!(
            refused
                .to_string()
                .contains("rejected this process's certificate"),
            "{refused}"
        );

        // With a certificate of another authority, under a name that is good here.
        let other = tempfile::tempdir().unwrap();
        let name = roles::identity("controller", &cell.config.cell.name);
        Authority::open_or_create(other.path())
            .unwrap()
            .issue(&name, &[], 10)
            .unwrap();
        let mut forged = cell.config.clone();
        forged.zenoh.tls = Some(tls(other.path()));
        forged.zenoh.identify(&name);
        assert!(Bus::open_within(&forged, Role::Client, patience).is_err());

        // In the clear.
        let mut clear = cell.config.clone();
        clear.zenoh.tls = None;
        clear.zenoh.connect = vec![clear.zenoh.connect[0].replace("quic/", "tcp/")];
        assert!(Bus::open_within(&clear, Role::Client, patience).is_err());
    });
}

#[test]
fn tasks_come_from_operators_only_and_answers_from_the_controller_only() {
    timed(|| {
        let cell = secured();
        let (controller, operator, estimator) = (
            cell.join("controller"),
            cell.join("operator"),
            cell.join("estimator"),
        );
        let _task = controller
            .answer(queries::CONTROL_TASK, |_, _| answer::done("started"))
            .unwrap();
        let _show = controller
            .answer(queries::CONTROL_SHOW, |_, _| answer::done("the task"))
            .unwrap();
        let _forged = estimator
            .answer(queries::CONTROL_TASK, |_, _| answer::done("forged"))
            .unwrap();
        let start = Request {
            action: "start".into(),
            argument: String::new(),
        };
        until("the operator's task is answered", || {
            operator
                .ask(queries::CONTROL_TASK, &start, Duration::from_secs(1))
                .is_ok()
        });
        let answers = operator
            .ask_all(queries::CONTROL_TASK, &start, NOTHING)
            .unwrap();
        let words: Vec<&str> = answers
            .iter()
            .map(|(_, answer)| answer.message.as_str())
            .collect();
        assert_eq!(words, ["started"]);
        // The recorder may read the task, but only an operator may start one.
        let recorder = cell.join("recorder");
        until("the recorder is shown the task", || {
            recorder
                .ask(queries::CONTROL_SHOW, &start, Duration::from_secs(1))
                .is_ok()
        });
        for role in ["recorder", "viewer", "netft", "rtde"] {
            let refused = cell.join(role).ask(queries::CONTROL_TASK, &start, NOTHING);
            assert!(
                matches!(refused, Err(BusError::NoAnswer { .. })),
                "{role}: {refused:?}"
            );
        }
    });
}

#[test]
fn readers_receive_the_cells_messages_and_liveliness() {
    timed(|| {
        let cell = secured();
        let name = cell.config.cell.name.clone();
        let (rtde, viewer) = (cell.join("rtde"), cell.join("viewer"));
        let heard = viewer.subscribe(&topics::ARM_STATE, 10).unwrap();
        let all = viewer.subscribe_raw("**", 1000).unwrap();
        let states = rtde.publisher(&topics::ARM_STATE).unwrap();
        let health = HealthReporter::start_only(&rtde, "rtde").unwrap();
        health.running();
        until("a state", || {
            states.publish(&ArmState::default());
            heard.try_recv().is_some()
        });
        until("health", || {
            all.try_recv()
                .is_some_and(|message| &*message.key == "health/rtde")
        });
        // From outside every cell, as `tangent status --all` sees it.
        let network = Bus::open_network(&cell.config("operator").zenoh, PATIENCE).unwrap();
        let seen = network.alive(PATIENCE).unwrap();
        assert!(
            seen.iter()
                .any(|alive| alive.cell == name && alive.service == "rtde"),
            "{seen:?}"
        );
        let healths = network
            .subscribe::<Health>(&topics::HEALTHS.of_cell("*"), 10)
            .unwrap();
        assert_eq!(
            healths
                .recv_timeout(PATIENCE)
                .unwrap()
                .message
                .service
                .as_str(),
            "rtde"
        );

        // A second one is refused, and the error names the host of the first.
        let second = HealthReporter::start_only(&cell.join("robot"), "rtde")
            .map(|_| ())
            .unwrap_err();
        assert!(matches!(second, BusError::Taken { .. }), "{second}");
        let host = tangent_runtime::health::host_name();
        assert!(
            second
                .to_string()
                .contains(&format!("rtde already runs in cell {name}")),
            "{second}"
        );
        assert!(
            second.to_string().contains(&format!("on host {host}")),
            "{second}"
        );
    });
}

#[test]
fn a_router_without_rules_or_with_lax_ones_does_not_start() {
    timed(|| {
        let cell = secured();
        let mut router = cell.config.clone();
        router.zenoh.identify("router");
        router.zenoh.access = None;
        let said = Bus::open_within(&router, Role::Router, PATIENCE)
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("zenoh.access") && said.contains("tangent keys new"),
            "{said}"
        );
        let lax = cell.folder.path().join("lax.json5");
        std::fs::write(&lax, "{access_control: {enabled: true, default_permission: 'allow', rules: [], subjects: [], policies: []}}").unwrap();
        router.zenoh.access = Some(lax);
        let said = Bus::open_within(&router, Role::Router, PATIENCE)
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("lax.json5") && said.contains("deny"),
            "{said}"
        );
    });
}

/// The key of one laptop is lost and its identity revoked. From the router's next start on, its
/// messages are dropped, while the other estimators continue.
#[test]
fn a_revoked_identity_is_locked_out_alone() {
    timed(|| {
        let mut cell = secured();
        let name = cell.config.cell.name.clone();
        let identified = |who: &str| {
            let mut config = cell.config.clone();
            config.zenoh.identify(&format!("estimator-{who}.{name}"));
            Bus::open_within(&config, Role::Client, PATIENCE).unwrap()
        };
        let (controller, lost, kept) = (cell.join("controller"), identified("x"), identified("y"));
        let heard = controller
            .subscribe(&topics::ESTIMATE_NORMALS, 1000)
            .unwrap();
        let estimate = |bus: &Bus| bus.publisher(&topics::estimate_normal("any")).unwrap();
        let say = |cycle: u64| NormalEstimate {
            cycle,
            ..NormalEstimate::default()
        };
        let (lies, truths) = (estimate(&lost), estimate(&kept));
        for (publisher, cycle) in [(&lies, 1), (&truths, 2)] {
            until("both are heard before", || {
                publisher.publish(&say(cycle));
                heard
                    .try_recv()
                    .is_some_and(|received| received.message.cycle == cycle)
            });
        }

        cell.fleet.revoked = vec![format!("estimator-x.{name}")];
        let rules = cell.config.zenoh.access.clone().unwrap();
        std::fs::write(&rules, access::text(&cell.fleet)).unwrap();
        cell.router.close();
        let mut router = cell.config.clone();
        router.zenoh.identify("router");
        let mut again = None;
        until("the router is back", || {
            again = Bus::open_within(&router, Role::Router, PATIENCE).ok();
            again.is_some()
        });
        while heard.try_recv().is_some() {}
        let mut after = 0;
        until("the other one is heard again", || {
            lies.publish(&say(1));
            truths.publish(&say(2));
            while let Some(received) = heard.try_recv() {
                assert_eq!(received.message.cycle, 2, "the revoked one is heard");
                after += 1;
            }
            after > 200
        });
    });
}

#[test]
fn only_a_recorder_requests_old_messages_and_only_their_publisher_answers() {
    timed(|| {
        let cell = secured();
        let (robot, estimator) = (cell.join("rtde"), cell.join("estimator"));
        let states = robot.publisher(&topics::ARM_STATE).unwrap();
        let forged = estimator.publisher(&topics::ARM_STATE).unwrap();
        for _ in 0..10 {
            states.publish(&ArmState::default());
            forged.publish(&ArmState::default());
        }
        let said = |bus: &Bus, patience| {
            let everything = Question {
                others_since_ns: i64::MIN,
                spans: Vec::new(),
            };
            let mut publishers = Vec::new();
            bus.recall("", &everything, patience, |message| {
                publishers.push(message.publisher);
            })
            .unwrap();
            publishers
        };
        let recorder = cell.join("recorder");
        until("the publisher is known", || {
            said(&recorder, PATIENCE).len() >= 10
        });
        assert_eq!(said(&recorder, PATIENCE), [states.id(); 10]);
        for role in ["viewer", "operator", "estimator"] {
            let bus = cell.join(role);
            assert!(said(&bus, NOTHING).is_empty(), "{role}");
        }
    });
}
