//! The bus between sessions, over a real router on loopback.
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::bus::answer;
use tangent_runtime::{Bus, BusError, Lane, Reply, Role, Stop};
use tangent_schemas::cdr;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, Request};
use tangent_schemas::topics::{self, queries};

fn state(cycle: u64) -> ArmState {
    ArmState {
        cycle,
        ..ArmState::default()
    }
}

#[test]
fn a_message_arrives_once_in_order_with_its_attachment() {
    timed(|| {
        let config = cell();
        let router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (near, far) = (client(&config), client(&config));
        let here = near.subscribe(&topics::ARM_STATE, 1000).unwrap();
        let there = far.subscribe(&topics::ARM_STATE, 1000).unwrap();
        let at_router = router.subscribe(&topics::ARM_STATE, 1000).unwrap();
        let raw = far.subscribe_raw("**", 1000).unwrap();
        let states = near.publisher(&topics::ARM_STATE).unwrap();
        until("a remote reader", || states.is_read_remotely());
        // The router's reader and the client's are announced apart: wait until one message has
        // reached both.
        let (mut first, mut seen) = (0, 0);
        until("both readers", || {
            first = states.publish(&state(0));
            let arrived = there.try_recv();
            seen = arrived.as_ref().map_or(seen, |r| r.sequence);
            at_router.try_recv().is_some() && arrived.is_some()
        });
        while seen < first {
            seen = there.recv_timeout(PATIENCE).unwrap().sequence;
        }
        for cycle in 1..=200 {
            states.publish(&state(cycle));
            let received = there.recv_timeout(PATIENCE).expect("every message");
            assert_eq!(received.message.cycle, cycle);
            assert_eq!(received.sequence, first + cycle);
            assert_eq!(received.publisher, states.id());
        }
        assert_eq!((there.lost(), near.dropped()), (0, 0));
        // Readers in the sender's own process got each exactly once: the session brought no echo.
        assert_eq!(here.counts().received, first + 200);
        let message = raw.recv_timeout(PATIENCE).expect("an encoded message");
        assert_eq!(
            (&*message.key, &*message.type_name),
            ("arm/state", "tangent_msgs/msg/ArmState")
        );
        assert!(cdr::decode::<ArmState>(&message.payload).is_ok());
    });
}

#[test]
fn cells_do_not_receive_each_other_but_a_network_bus_receives_all() {
    timed(|| {
        let one = cell();
        let mut two = one.clone();
        two.cell.name = format!("{}b", one.cell.name);
        let _router = Bus::open_within(&one, Role::Router, PATIENCE).unwrap();
        let (bus_one, bus_two) = (client(&one), client(&two));
        let network = Bus::open_network(&one.zenoh, PATIENCE).unwrap();
        let all = network
            .subscribe(&topics::WRENCH_TOOL.of_cell("*"), 100)
            .unwrap();
        let other = bus_two.subscribe(&topics::WRENCH_TOOL, 100).unwrap();
        let wrenches = bus_one.publisher(&topics::WRENCH_TOOL).unwrap();
        until("the network's reader", || {
            wrenches.publish(&WrenchStamped::default());
            all.try_recv().is_some()
        });
        assert_eq!(other.counts().received, 0);
        let _token = bus_one.declare_alive("netft", "here-1").unwrap();
        until("the token on the network", || {
            network.alive(PATIENCE).unwrap().iter().any(|alive| {
                alive.cell == one.cell.name
                    && alive.service == "netft"
                    && alive.instance == "here-1"
            })
        });
        assert_eq!(bus_two.alive(PATIENCE).unwrap(), []);
    });
}

#[test]
fn a_request_is_answered_and_a_token_ends_with_its_process() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (service, asker) = (client(&config), client(&config));
        let handle = service
            .answer(queries::CONTROL_TASK, |key, request: Request| {
                answer::done(format!("{key}: {} {}", request.action, request.argument))
            })
            .unwrap();
        let token = service.declare_alive("controller", "x-1").unwrap();
        let request = Request {
            action: "start".into(),
            argument: "wipe".into(),
        };
        until("an answer", || {
            matches!(asker.ask(queries::CONTROL_TASK, &request, PATIENCE),
            Ok(answer) if answer.done && answer.message == "control/task: start wipe")
        });
        let all = asker.ask_all("control/*", &request, PATIENCE).unwrap();
        assert_eq!(all.len(), 1);
        assert_eq!(all[0].0, "control/task");
        until("the token", || asker.alive(PATIENCE).unwrap().len() == 1);
        drop(handle);
        until("silence", || {
            matches!(
                asker.ask(queries::CONTROL_TASK, &request, PATIENCE),
                Err(BusError::NoAnswer { .. })
            )
        });
        drop(token);
        until("the token's end", || {
            asker.alive(PATIENCE).unwrap().is_empty()
        });
    });
}

#[test]
fn after_a_router_restart_everything_goes_on_by_itself() {
    timed(|| {
        let config = cell();
        let router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (near, far) = (client(&config), client(&config));
        let mut there = far.latest(&topics::ARM_STATE).unwrap();
        let states = near.publisher(&topics::ARM_STATE).unwrap();
        let _token = near.declare_alive("rtde", "x-1").unwrap();
        until("data before", || {
            states.publish(&state(1));
            there.take_new().is_some()
        });
        router.close();
        until("the cut", || !states.is_read_remotely());
        // The near lane does not need the network.
        let mut here = near.latest(&topics::ARM_STATE).unwrap();
        states.publish(&state(2));
        assert_eq!(here.get().unwrap().message.cycle, 2);
        let mut again = None;
        until("the port", || {
            again = Bus::open_within(&config, Role::Router, PATIENCE).ok();
            again.is_some()
        });
        until("data after", || {
            states.publish(&state(3));
            there
                .take_new()
                .is_some_and(|received| received.message.cycle == 3)
        });
        until("the token after", || {
            !far.alive(PATIENCE).unwrap().is_empty()
        });
    });
}

#[test]
fn a_busy_port_and_a_missing_router_are_named() {
    timed(|| {
        let config = cell();
        let endpoint = config.zenoh.listen[0].clone();
        let error = Bus::open_within(&config, Role::Client, Duration::from_millis(300))
            .err()
            .expect("no router");
        assert!(matches!(error, BusError::NoRouter { .. }), "{error:?}");
        assert!(error.to_string().contains(&endpoint), "{error}");

        let address = endpoint.trim_start_matches("tcp/");
        let _squatter = TcpListener::bind(address).unwrap();
        let error = Bus::open_within(&config, Role::Router, PATIENCE)
            .err()
            .expect("a busy port");
        assert!(matches!(error, BusError::PortBusy { .. }), "{error:?}");
        assert!(error.to_string().contains(&endpoint), "{error}");
    });
}

#[test]
fn waiting_for_a_router_ends_with_the_service() {
    timed(|| {
        let config = cell();
        let stop = Stop::new();
        let stopping = stop.clone();
        let opening = std::thread::spawn(move || {
            Bus::open_until(&config, Role::Client, None, &stopping).err()
        });
        stop.trigger();
        assert!(matches!(opening.join().unwrap(), Some(BusError::Stopped)));
    });
}

/// After a cut shorter than the lease, seconds of queued samples arrive at once.
#[test]
fn samples_older_than_asked_are_refused_and_counted() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (near, far) = (client(&config), client(&config));
        let strict = far.subscribe(&topics::ARM_STATE, 100).unwrap();
        let open = far.subscribe(&topics::ARM_STATE, 100).unwrap();
        strict.refuse_older_than(Duration::from_nanos(1));
        let states = near.publisher(&topics::ARM_STATE).unwrap();
        until("a sample", || {
            states.publish(&state(1));
            open.try_recv().is_some()
        });
        until("its refusal", || strict.counts().too_old > 0);
        assert_eq!(strict.counts().received, 0);
    });
}

/// A service whose `start` lasts until it is released, on a cell of its own.
struct SlowStart {
    config: tangent_runtime::CellConfig,
    _router: Bus,
    _service: Bus,
    _handles: Vec<tangent_runtime::Handle>,
    /// Arguments of the starts that were carried out.
    started: Arc<Mutex<Vec<String>>>,
    /// One message releases one start.
    go: Sender<()>,
}

fn slow_start() -> SlowStart {
    let config = cell();
    let router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
    let service = client(&config);
    let started = Arc::<Mutex<Vec<String>>>::default();
    let (go, gone) = channel();
    let (log, gone) = (Arc::clone(&started), Mutex::new(gone));
    let task = service
        .answer_in(
            queries::CONTROL_TASK,
            |request| match request.action.as_str() {
                "start" => Lane::Slow,
                "pause" => Lane::Urgent,
                _ => Lane::Prompt,
            },
            move |asked| {
                if asked.request.action == "start" {
                    log.lock().unwrap().push(asked.request.argument);
                    gone.lock().unwrap().recv_timeout(PATIENCE).unwrap();
                }
                answer::done(asked.request.action).into()
            },
        )
        .unwrap();
    let stop = service
        .answer_in(
            queries::CONTROL_STOP,
            |_| Lane::Urgent,
            |_| answer::done("stopped").into(),
        )
        .unwrap();
    let asker = client(&config);
    for (key, action) in [
        (queries::CONTROL_TASK, "status"),
        (queries::CONTROL_STOP, "stop"),
    ] {
        until("the service", || {
            asker.ask(key, &asks(action, ""), PATIENCE).is_ok()
        });
    }
    SlowStart {
        config,
        _router: router,
        _service: service,
        _handles: vec![task, stop],
        started,
        go,
    }
}

fn asks(action: &str, argument: &str) -> Request {
    Request {
        action: action.into(),
        argument: argument.into(),
    }
}

/// The bug: one thread answered all requests, so a stop waited for every earlier start.
#[test]
fn a_stop_is_answered_while_slow_requests_are_still_under_way() {
    timed(|| {
        let cell = slow_start();
        let starting: Vec<_> = (0..8)
            .map(|i| {
                let bus = client(&cell.config);
                std::thread::spawn(move || {
                    bus.ask(
                        queries::CONTROL_TASK,
                        &asks("start", &i.to_string()),
                        PATIENCE,
                    )
                })
            })
            .collect();
        until("the first start", || {
            cell.started.lock().unwrap().len() == 1
        });
        let person = client(&cell.config);
        for (key, action) in [
            (queries::CONTROL_STOP, "stop"),
            (queries::CONTROL_TASK, "pause"),
            (queries::CONTROL_TASK, "status"),
        ] {
            let answer = person.ask(key, &asks(action, ""), PATIENCE).unwrap();
            assert!(answer.done);
            assert!(
                starting.iter().all(|start| !start.is_finished()),
                "{action}"
            );
        }
        for _ in &starting {
            cell.go.send(()).unwrap();
        }
        for start in starting {
            assert!(start.join().unwrap().unwrap().done);
        }
    });
}

/// The bug: a refusal waited behind the requests in progress on the same key.
#[test]
fn what_is_not_allowed_is_refused_while_a_slow_request_of_the_same_key_is_under_way() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let service = client(&config);
        let allowed = Arc::new(AtomicBool::new(true));
        let (begun, began) = channel();
        let (go, gone) = channel::<()>();
        let judged = Arc::new(AtomicUsize::new(0));
        let (permission, count, gone) =
            (Arc::clone(&allowed), Arc::clone(&judged), Mutex::new(gone));
        let _handle = service
            .answer_judged(
                queries::NETFT_TARE,
                move |asked| {
                    count.fetch_add(
                        usize::from(asked.request.action == "tare"),
                        Ordering::SeqCst,
                    );
                    (!permission.load(Ordering::SeqCst)).then(|| answer::refused("it touches"))
                },
                move |asked| {
                    if asked.request.action == "status" {
                        return answer::done("here").into();
                    }
                    begun.send(()).unwrap();
                    gone.lock().unwrap().recv_timeout(PATIENCE).unwrap();
                    answer::done("tared").into()
                },
            )
            .unwrap();
        let person = client(&config);
        until("the service", || {
            person
                .ask(queries::NETFT_TARE, &asks("status", ""), PATIENCE)
                .is_ok()
        });
        let taring: Vec<_> = (0..2)
            .map(|_| {
                let bus = client(&config);
                std::thread::spawn(move || {
                    bus.ask(queries::NETFT_TARE, &asks("tare", ""), PATIENCE)
                })
            })
            .collect();
        began.recv_timeout(PATIENCE).unwrap();
        // The request in progress was judged at its arrival and at its turn, the other at its
        // arrival.
        until("both are judged", || judged.load(Ordering::SeqCst) == 3);
        allowed.store(false, Ordering::SeqCst);
        let asked = Instant::now();
        let refused = person.ask(queries::NETFT_TARE, &asks("tare", ""), PATIENCE);
        println!("refused after {:?}", asked.elapsed());
        let refused = refused.unwrap();
        assert!(!refused.done && refused.message == "it touches");
        assert!(taring.iter().all(|tare| !tare.is_finished()));
        go.send(()).unwrap();
        // The waiting request is judged again at its turn.
        let mut done: Vec<bool> = taring
            .into_iter()
            .map(|tare| tare.join().unwrap().unwrap().done)
            .collect();
        done.sort_unstable();
        assert_eq!(done, [false, true]);
    });
}

/// The bug: the job was carried out long after its sender had given up.
#[test]
fn a_request_whose_sender_has_given_up_has_no_effect() {
    timed(|| {
        let cell = slow_start();
        let (one, two) = (client(&cell.config), client(&cell.config));
        let first = std::thread::spawn(move || {
            one.ask(queries::CONTROL_TASK, &asks("start", "first"), PATIENCE)
        });
        until("the first start", || {
            cell.started.lock().unwrap().len() == 1
        });
        let late = two.ask(
            queries::CONTROL_TASK,
            &asks("start", "late"),
            Duration::from_millis(300),
        );
        let error = late.unwrap_err();
        assert!(matches!(error, BusError::NoAnswer { .. }), "{error:?}");
        assert!(error.to_string().contains("unknown"), "{error}");
        cell.go.send(()).unwrap();
        assert!(first.join().unwrap().unwrap().done);
        cell.go.send(()).unwrap();
        let third = two.ask(queries::CONTROL_TASK, &asks("start", "third"), PATIENCE);
        assert!(third.unwrap().done);
        assert_eq!(*cell.started.lock().unwrap(), ["first", "third"]);
    });
}

/// An outcome that the service does not know is neither done nor refused.
#[test]
fn an_outcome_unknown_to_the_service_is_reported_as_unknown() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (service, asker) = (client(&config), client(&config));
        let _handle = service
            .answer_in(
                "rtde/unlock",
                |_| Lane::Slow,
                |_| Reply::Unknown("the robot did not say".into()),
            )
            .unwrap();
        let ask = |bus: &Bus| bus.ask("rtde/unlock", &asks("", ""), PATIENCE);
        assert!(matches!(ask(&service), Err(BusError::Unknown { .. })));
        until(
            "the service",
            || matches!(ask(&asker), Err(BusError::Unknown { reason, .. }) if reason == "the robot did not say"),
        );
    });
}
