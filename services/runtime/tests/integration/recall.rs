//! Resending of messages that a recorder missed: real sessions on loopback.
use std::time::Duration;

use crate::common::{PATIENCE, cell, until};
use tangent_live::timed;
use tangent_runtime::{Bus, Question, RawMessage, Role, Span};
use tangent_schemas::standard::Image;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{cdr, topics};

fn state(cycle: u64) -> ArmState {
    ArmState {
        cycle,
        ..ArmState::default()
    }
}

fn recall(bus: &Bus, question: &Question) -> Vec<RawMessage> {
    let mut all = Vec::new();
    bus.recall("", question, PATIENCE, |message| all.push(message))
        .unwrap();
    all
}

fn since(since_ns: i64) -> Question {
    Question {
        others_since_ns: since_ns,
        spans: Vec::new(),
    }
}

fn span(publisher: [u8; 16], from: u64, to: u64) -> Question {
    Question {
        others_since_ns: i64::MAX,
        spans: vec![Span {
            publisher,
            from,
            to,
            since_ns: i64::MIN,
        }],
    }
}

#[test]
fn messages_without_a_subscriber_can_be_requested() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let robot = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let states = robot.publisher(&topics::ARM_STATE).unwrap();
        let images = robot.publisher(&topics::CAMERA_IMAGE).unwrap();
        assert!(!states.is_read_remotely());
        for cycle in 1..=5000 {
            states.publish(&state(cycle));
            if cycle % 100 == 0 {
                // The publishing thread's queue holds one second of messages, not all of them.
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        images.publish(&Image::default());

        let recorder = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let mut all = Vec::new();
        until("the publisher is known", || {
            all = recall(&recorder, &since(i64::MIN));
            all.len() >= 5000
        });
        assert_eq!(all.len(), 5000, "images are not kept");
        for (message, sequence) in all.iter().zip(1..) {
            assert_eq!(&*message.key, "arm/state");
            assert_eq!(message.type_name, topics::ARM_STATE.message_name());
            assert_eq!(
                (message.sequence, message.publisher),
                (sequence, states.id())
            );
            let decoded: ArmState = cdr::decode(&message.payload).unwrap();
            assert_eq!(decoded.cycle, sequence);
        }
        // Only the requested messages.
        let middle = recall(&recorder, &span(states.id(), 1000, 1002));
        let sequences: Vec<u64> = middle.iter().map(|m| m.sequence).collect();
        assert_eq!(sequences, [1000, 1001, 1002]);
        assert_eq!(recall(&recorder, &span([0; 16], 1, u64::MAX)).len(), 0);
        let later = all[4000].source_time_ns;
        assert!(recall(&recorder, &since(later)).len() < 1100);
        // In the publisher's own process too.
        assert_eq!(recall(&robot, &span(states.id(), 7, 7)).len(), 1);
        // A publisher that was dropped sends nothing again.
        let id = states.id();
        drop(states);
        until("it is gone", || {
            recall(&recorder, &span(id, 1, u64::MAX)).is_empty()
        });
    });
}

#[test]
fn a_flood_of_questions_holds_no_publisher_up() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let robot = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let reader = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let states = robot.publisher(&topics::ARM_STATE).unwrap();
        let heard = reader.subscribe(&topics::ARM_STATE, 4096).unwrap();
        until("a reader", || states.is_read_remotely());
        for cycle in 0..2000 {
            states.publish(&state(cycle));
            assert!(heard.recv_timeout(PATIENCE).is_some());
        }
        let clients: Vec<_> = (0..8)
            .map(|_| {
                let config = config.clone();
                std::thread::spawn(move || {
                    let bus = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
                    for _ in 0..50 {
                        bus.recall("", &since(i64::MIN), Duration::from_millis(20), |_| {})
                            .unwrap();
                    }
                })
            })
            .collect();
        let mut cycle = 2000;
        while clients.iter().any(|client| !client.is_finished()) {
            states.publish(&state(cycle));
            let received = heard.recv_timeout(PATIENCE).unwrap();
            assert_eq!(received.message.cycle, cycle);
            cycle += 1;
        }
        for client in clients {
            client.join().unwrap();
        }
        assert_eq!(heard.lost(), 0);
        // The publisher answers again.
        until("an answer", || {
            recall(&reader, &span(states.id(), cycle - 10, cycle - 1)).len() == 10
        });
    });
}
