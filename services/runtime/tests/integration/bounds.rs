//! The memory that a process on the network can make others use is bounded.
use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::{Bus, Role};
use tangent_schemas::standard::Image;
use tangent_schemas::topics::{Delivery, Topic};

fn image(bytes: usize) -> Image {
    Image {
        data: vec![7; bytes],
        ..Image::default()
    }
}

/// A message that is too large for the cell is not delivered; one that fits is.
#[test]
fn a_message_beyond_the_bound_is_not_taken() {
    timed(|| {
        const HUGE: Topic<Image> = Topic::new("camera/huge", Delivery::Bulk);
        let mut config = cell();
        config.zenoh.message_max_mb = 0.5;
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let reader = client(&config);
        let heard = reader.subscribe(&HUGE, 16).unwrap();
        // A process of the cell, and one without a bound.
        let mut lax = config.clone();
        lax.zenoh.message_max_mb = 1000.0;
        for config in [&config, &lax] {
            let sender = client(config);
            let publisher = sender.publisher(&HUGE).unwrap();
            until("a small one comes after each large one", || {
                publisher.publish(&image(2_000_000));
                publisher.publish(&image(100_000));
                let mut came = false;
                while let Some(received) = heard.try_recv() {
                    assert_eq!(received.message.data.len(), 100_000);
                    came = true;
                }
                came
            });
        }
    });
}

/// With 3000 invented keys, a reader of all keys follows some, counts the others, reports it, and
/// still receives the arm's state.
#[test]
fn invented_keys_do_not_fill_a_reader_of_patterns() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (recorder, other) = (client(&config), client(&config));
        let all = recorder.subscribe_raw("**", 100_000).unwrap();
        let probe = other
            .raw_publisher("estimate/probe/normal", "x/msg/X")
            .unwrap();
        until("the other session is seen", || {
            probe.publish(&[0; 8]);
            all.try_recv().is_some()
        });
        let mut keys = std::collections::BTreeSet::new();
        for i in 0..3000 {
            let key = format!("estimate/e{i}/normal");
            other
                .raw_publisher(&key, "x/msg/X")
                .unwrap()
                .publish(&[0; 8]);
        }
        let arm = other.raw_publisher("arm/state", "x/msg/X").unwrap();
        until("the arm is heard after all of them", || {
            arm.publish(&[0; 8]);
            while let Some(message) = all.try_recv() {
                keys.insert(message.key.to_string());
            }
            keys.contains("arm/state")
        });
        assert!(keys.len() <= 257, "{} keys", keys.len());
        assert!(all.counts().new_keys > 0);
        let said = recorder.remarks().concat();
        assert!(said.contains("keys that are not followed"), "{said}");
    });
}
