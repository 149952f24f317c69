//! The bus within one process: order, threads, losses, types.
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tangent_live::timed;
use tangent_runtime::{Bus, BusError};
use tangent_schemas::tangent::{ArmCommand, ArmState, NormalEstimate, Request};
use tangent_schemas::topics::{self, Delivery, Topic};
use tangent_schemas::{Message, cdr};

const PATIENCE: Duration = Duration::from_secs(10);

fn state(cycle: u64) -> ArmState {
    ArmState {
        cycle,
        ..ArmState::default()
    }
}

/// The loop of robot bridge and controller: state goes out, the command is there when `publish`
/// returns.
#[test]
fn a_callback_answers_within_publish_in_the_senders_thread() {
    timed(|| {
        let bus = Bus::in_process("test");
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        let mut commands = bus.latest(&topics::ARM_COMMAND).unwrap();
        let out = bus.publisher(&topics::ARM_COMMAND).unwrap();
        let thread = Arc::new(Mutex::new(None));
        let seen = Arc::clone(&thread);
        let _controller = bus
            .on(&topics::ARM_STATE, move |state| {
                *seen.lock().unwrap() = Some(std::thread::current().id());
                out.publish(&ArmCommand {
                    cycle: state.message.cycle,
                    ..ArmCommand::default()
                });
            })
            .unwrap();
        for cycle in 1..=100 {
            states.publish(&state(cycle));
            let command = commands.take_new().expect("an answer in the same cycle");
            assert_eq!(command.message.cycle, cycle);
            assert_eq!(command.sequence, cycle);
        }
        assert_eq!(*thread.lock().unwrap(), Some(std::thread::current().id()));
    });
}

#[test]
fn callbacks_run_in_the_order_of_registration_before_the_slots() {
    timed(|| {
        let bus = Bus::in_process("test");
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut latest = bus.latest(&topics::ARM_STATE).unwrap();
        let handles: Vec<_> = ["estimator", "controller"]
            .into_iter()
            .map(|name| {
                let order = Arc::clone(&order);
                bus.on(&topics::ARM_STATE, move |_| {
                    order.lock().unwrap().push(name);
                })
                .unwrap()
            })
            .collect();
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        states.publish(&state(1));
        assert_eq!(*order.lock().unwrap(), ["estimator", "controller"]);
        assert!(latest.take_new().is_some());
        drop(handles);
        states.publish(&state(2));
        assert_eq!(order.lock().unwrap().len(), 2, "dropped handles are silent");
        assert_eq!(latest.get().unwrap().message.cycle, 2);
    });
}

#[test]
fn a_queue_keeps_order_drops_the_oldest_and_counts_it() {
    timed(|| {
        let bus = Bus::in_process("test");
        let queue = bus.subscribe(&topics::ARM_STATE, 8).unwrap();
        let mut latest = bus.latest(&topics::ARM_STATE).unwrap();
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        for cycle in 1..=20 {
            states.publish(&state(cycle));
        }
        let cycles: Vec<u64> = std::iter::from_fn(|| queue.try_recv())
            .map(|received| received.message.cycle)
            .collect();
        assert_eq!(cycles, (13..=20).collect::<Vec<_>>());
        assert_eq!(queue.lost(), 12);
        assert_eq!(queue.counts().received, 20);
        assert_eq!(latest.get().unwrap().message.cycle, 20);
        assert_eq!(latest.lost(), 0, "only the newest was wanted");
        assert!(latest.take_new().is_none());
        assert!(latest.fresh(Duration::ZERO).is_none());
        assert!(latest.fresh(PATIENCE).is_some());
    });
}

#[test]
fn nothing_is_lost_between_threads_while_the_queue_has_room() {
    timed(|| {
        let bus = Bus::in_process("test");
        let queue = bus.subscribe(&topics::ARM_STATE, 100_000).unwrap();
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        let sender = std::thread::spawn(move || {
            for cycle in 1..=20_000 {
                states.publish(&state(cycle));
            }
        });
        for cycle in 1..=20_000 {
            let received = queue.recv_timeout(PATIENCE).expect("every message");
            assert_eq!(received.message.cycle, cycle);
        }
        sender.join().unwrap();
        assert_eq!(queue.lost(), 0);
    });
}

/// Otherwise, a callback that publishes the topic it subscribes to would wait for itself without
/// end.
#[test]
fn a_callback_is_not_called_from_within_itself() {
    timed(|| {
        let bus = Bus::in_process("test");
        let again = bus.publisher(&topics::ARM_STATE).unwrap();
        let calls = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&calls);
        let _handle = bus
            .on(&topics::ARM_STATE, move |received| {
                counted.fetch_add(1, Ordering::Relaxed);
                again.publish(&received.message);
            })
            .unwrap();
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        states.publish(&state(1));
        states.publish(&state(2));
        assert_eq!(calls.load(Ordering::Relaxed), 2);
    });
}

#[test]
fn wildcards_read_every_estimator_and_cannot_be_published() {
    timed(|| {
        let bus = Bus::in_process("test");
        let all = bus.subscribe(&topics::ESTIMATE_NORMALS, 8).unwrap();
        let one = bus.publisher(&topics::estimate_normal("one")).unwrap();
        let two = bus.publisher(&topics::estimate_normal("two")).unwrap();
        one.publish(&NormalEstimate::default());
        two.publish(&NormalEstimate::default());
        let publishers: Vec<_> = std::iter::from_fn(|| all.try_recv())
            .map(|received| received.publisher)
            .collect();
        assert_eq!(publishers, [one.id(), two.id()]);
        assert!(matches!(
            bus.publisher(&topics::ESTIMATE_NORMALS),
            Err(BusError::Key { .. })
        ));
    });
}

#[test]
fn one_topic_has_one_type() {
    timed(|| {
        let bus = Bus::in_process("test");
        let _states = bus.publisher(&topics::ARM_STATE).unwrap();
        let wrong: Topic<ArmCommand> = Topic::new("arm/state", Delivery::Stream);
        let error = bus.latest(&wrong).err().expect("a refusal");
        assert_eq!(
            error.to_string(),
            "`arm/state` carries tangent_msgs/msg/ArmState in this process, not tangent_msgs/msg/ArmCommand: \
         one topic has one message type"
        );
        assert!(matches!(
            bus.latest(&Topic::<ArmState>::new("/arm//state", Delivery::Stream)),
            Err(BusError::Key { .. })
        ));
    });
}

#[test]
fn a_recorder_in_the_same_process_gets_the_bytes() {
    timed(|| {
        let bus = Bus::in_process("test");
        let raw = bus.subscribe_raw("**", 100).unwrap();
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        for cycle in 1..=3 {
            states.publish(&state(cycle));
        }
        for cycle in 1..=3 {
            let message = raw.recv_timeout(PATIENCE).expect("every message");
            assert_eq!(&*message.key, "arm/state");
            assert_eq!(message.type_name, ArmState::NAME);
            assert_eq!(message.sequence, cycle);
            assert_eq!(message.publisher, states.id());
            let decoded: ArmState = cdr::decode(&message.payload).unwrap();
            assert_eq!(decoded, state(cycle));
        }
        assert_eq!((raw.lost(), bus.dropped()), (0, 0));
    });
}

#[test]
fn replayed_bytes_reach_typed_readers_and_bad_ones_are_counted() {
    timed(|| {
        let bus = Bus::in_process("test");
        let mut latest = bus.latest(&topics::ARM_STATE).unwrap();
        let replay = bus.raw_publisher("arm/state", ArmState::NAME).unwrap();
        let mut bytes = Vec::new();
        cdr::encode(&state(7), &mut bytes).unwrap();
        replay.publish(&bytes);
        assert_eq!(latest.get().unwrap().message.cycle, 7);
        replay.publish(&bytes[..40]);
        bus.raw_publisher("arm/state", "other_msgs/msg/Other")
            .unwrap()
            .publish(&bytes);
        assert_eq!(latest.counts().undecodable, 2);
        assert_eq!(latest.counts().received, 1);
    });
}

#[test]
fn a_missing_service_is_reported_at_once() {
    timed(|| {
        let bus = Bus::in_process("test");
        let error = bus
            .ask(
                "control/task",
                &Request::default(),
                Duration::from_millis(1),
            )
            .unwrap_err();
        assert!(
            error.to_string().contains("no answer on `control/task`"),
            "{error}"
        );
    });
}
