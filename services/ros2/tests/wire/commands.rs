//! Commands: one outcome for each request, and nothing for what is not listed or not whole.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tangent_ros2::{SelectEstimatorRequest, StartTaskRequest, TriggerResponse};
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::{Handle, Lane};
use tangent_schemas::cdr;
use tangent_schemas::tangent::{Answer, Request};
use zenoh::Wait;
use zenoh::query::QueryTarget;

use crate::common::{Cell, PATIENCE, attachment};

const TRIGGER: &str = "std_srvs/srv/Trigger";
const EMPTY: [u8; 5] = [0, 1, 0, 0, 0];
const GID: [u8; 16] = *b"0123456789abcdef";

/// Asks as rmw_zenoh does. Returns each reply's payload and attachment.
fn ask(cell: &Cell, key: &str, payload: &[u8], from: Option<Vec<u8>>) -> Vec<(Vec<u8>, Vec<u8>)> {
    let get = cell
        .ros
        .get(key)
        .payload(payload)
        .target(QueryTarget::AllComplete)
        .consolidation(zenoh::query::ConsolidationMode::None)
        .timeout(PATIENCE);
    let get = match from {
        Some(from) => get.attachment(from),
        None => get,
    };
    get.wait()
        .unwrap()
        .iter()
        .map(|reply| {
            let sample = reply.into_result().unwrap();
            let attachment = sample.attachment().unwrap().to_bytes().into_owned();
            (sample.payload().to_bytes().into_owned(), attachment)
        })
        .collect()
}

fn trigger(cell: &Cell, service: &str, sequence: i64) -> TriggerResponse {
    let key = cell.service_key(service, TRIGGER);
    let replies = ask(cell, &key, &EMPTY, Some(attachment(sequence, 7, GID)));
    let [(payload, from)] = &replies[..] else {
        panic!("{} replies", replies.len());
    };
    assert_eq!(from[..8], sequence.to_le_bytes(), "the request's number");
    assert_eq!(from[16], 16);
    assert_eq!(from[17..], GID, "the client's id");
    cdr::decode(payload).unwrap()
}

/// Answers on `key` and keeps the requests.
fn answerer(cell: &Cell, key: &str, answer: Answer) -> (Handle, Arc<Mutex<Vec<Request>>>) {
    let asked = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&asked);
    let handle = cell.bus.answer(key, move |_, request| {
        kept.lock().unwrap().push(request);
        answer.clone()
    });
    (handle.unwrap(), asked)
}

#[test]
fn a_stop_is_passed_on_once_and_answered() {
    let cell = Cell::start("", "");
    let (_handle, asked) = answerer(&cell, "control/stop", done("retracting"));
    let response = trigger(&cell, "stop", 1);
    assert!(response.success);
    assert_eq!(response.message, "retracting");
    // The copy of a request is answered, and not carried out.
    let copy = trigger(&cell, "stop", 1);
    assert!(!copy.success && copy.message.contains("twice"), "{copy:?}");
    let asked = asked.lock().unwrap();
    assert_eq!(asked.len(), 1);
    assert_eq!(asked[0].action.as_str(), "stop");
}

#[test]
fn the_reason_of_a_refusal_reaches_ros() {
    let cell = Cell::start("commands = [\"start\", \"select\"]", "");
    let (_task, tasks) = answerer(&cell, "control/task", refused("no wrench"));
    let (_select, selected) = answerer(&cell, "control/select", done("quadratic"));
    let mut bytes = Vec::new();
    let start = StartTaskRequest {
        task: "name = \"line\"".to_owned(),
        clear: true,
    };
    cdr::encode(&start, &mut bytes).unwrap();
    let key = cell.service_key("start", "tangent_msgs/srv/StartTask");
    let replies = ask(&cell, &key, &bytes, Some(attachment(1, 0, GID)));
    let answer: Answer = cdr::decode(&replies[0].0).unwrap();
    assert_eq!((answer.done, answer.message.as_str()), (false, "no wrench"));
    let task = tasks.lock().unwrap()[0].clone();
    assert_eq!(task.action.as_str(), "start_clear");
    assert_eq!(task.argument, start.task);

    let select = SelectEstimatorRequest {
        estimator: "quadratic".to_owned(),
        force: false,
    };
    cdr::encode(&select, &mut bytes).unwrap();
    let key = cell.service_key("select", "tangent_msgs/srv/SelectEstimator");
    let replies = ask(&cell, &key, &bytes, Some(attachment(1, 0, GID)));
    let answer: Answer = cdr::decode(&replies[0].0).unwrap();
    assert!(answer.done);
    assert_eq!(selected.lock().unwrap()[0].argument, "quadratic");
}

#[test]
fn nothing_is_done_for_a_request_that_is_not_whole_not_listed_or_for_everybody() {
    let cell = Cell::start("commands = [\"start\", \"stop\"]", "");
    let (_task, tasks) = answerer(&cell, "control/task", done("started"));
    let (_stop, stops) = answerer(&cell, "control/stop", done("stopped"));
    let key = cell.service_key("start", "tangent_msgs/srv/StartTask");
    let mut whole = Vec::new();
    let start = StartTaskRequest {
        task: "name = \"line\"".to_owned(),
        clear: false,
    };
    cdr::encode(&start, &mut whole).unwrap();
    let hostile: [&[u8]; 6] = [
        &[],
        &whole[..4],
        &whole[..whole.len() - 1],
        &[0, 0, 0, 0],
        // A text that claims four gigabytes.
        &[0, 1, 0, 0, 255, 255, 255, 255, 1, 2, 3, 4],
        &[0xff; 64],
    ];
    for (sequence, payload) in (1..).zip(hostile) {
        let replies = ask(&cell, &key, payload, Some(attachment(sequence, 0, GID)));
        let answer: Answer = cdr::decode(&replies[0].0).unwrap();
        assert!(
            !answer.done && answer.message.contains("cannot be read"),
            "{answer:?}"
        );
    }
    let replies = ask(&cell, &key, &whole, None);
    let answer: Answer = cdr::decode(&replies[0].0).unwrap();
    assert!(
        !answer.done && answer.message.contains("without a number"),
        "{answer:?}"
    );
    // A resume is not offered; a request with wildcards is for nobody.
    let resume = cell.service_key("resume", TRIGGER);
    for key in [resume.as_str(), "0/**", &format!("0/{}/*/**", cell.name)] {
        let replies = ask(&cell, key, &EMPTY, Some(attachment(99, 0, GID)));
        assert!(replies.is_empty(), "{key}");
    }
    assert!(tasks.lock().unwrap().is_empty());
    assert!(stops.lock().unwrap().is_empty());
    let fault = |health: &tangent_schemas::tangent::Health| health.fault.contains("start");
    cell.until_health("the refusal", fault);
}

#[test]
fn an_outcome_that_nobody_knows_is_called_so() {
    let cell = Cell::start("", "");
    // No controller runs.
    let response = trigger(&cell, "pause", 1);
    assert!(!response.success);
    assert!(
        response.message.contains("outcome is unknown"),
        "{response:?}"
    );
}

/// A tare that waits for its sensor holds up other commands, and no stop.
#[test]
fn a_stop_does_not_wait_for_a_tare() {
    let cell = Cell::start("commands = [\"stop\", \"tare\"]", "");
    let (release, held) = channel::<()>();
    let held = Mutex::new(held);
    let begun = Arc::new(AtomicU64::new(0));
    let counting = Arc::clone(&begun);
    let _tare = cell
        .bus
        .answer_in(
            "netft/tare",
            |_| Lane::Slow,
            move |_| {
                counting.fetch_add(1, Ordering::SeqCst);
                let _ = held.lock().unwrap().recv_timeout(Duration::from_secs(8));
                done("zero set").into()
            },
        )
        .unwrap();
    let (_stop, stops) = answerer(&cell, "control/stop", done("retracting"));
    std::thread::scope(|scope| {
        let tare = scope.spawn(|| trigger(&cell, "tare", 1));
        crate::common::until("the tare", || begun.load(Ordering::SeqCst) == 1);
        assert!(trigger(&cell, "stop", 2).success);
        assert_eq!(stops.lock().unwrap().len(), 1);
        assert!(!tare.is_finished(), "the tare is still held");
        release.send(()).unwrap();
        assert!(tare.join().unwrap().success);
    });
}
