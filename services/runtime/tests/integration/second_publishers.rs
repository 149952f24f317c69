//! Second publishers of a topic that has one: refused by name and counted, with any id.
use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::{Bus, HealthReporter, Role};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmCommand, ControlState};
use tangent_schemas::topics;
use tangent_schemas::{Message, cdr};

fn wrench(force_z: f64) -> WrenchStamped {
    let mut wrench = WrenchStamped::default();
    wrench.wrench.force.z = force_z;
    wrench
}

fn encoded<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    bytes
}

#[test]
fn the_second_is_refused_and_named_by_its_health() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (sensor, visitor, controller) = (client(&config), client(&config), client(&config));
        // Every service learns the names of the others.
        let _health = HealthReporter::start(&controller, "controller").unwrap();
        let mut reader = controller.latest(&topics::WRENCH_TOOL).unwrap();
        let truth = sensor.publisher(&topics::WRENCH_TOOL).unwrap();
        let lie = visitor.publisher(&topics::WRENCH_TOOL).unwrap();
        until("the true one is heard", || {
            truth.publish(&wrench(3.0));
            reader.take_new().is_some()
        });
        let _visits = HealthReporter::start(&visitor, "visitor").unwrap();
        until("the second is named", || {
            truth.publish(&wrench(3.0));
            lie.publish(&wrench(0.0));
            if let Some(taken) = reader.take_new() {
                assert_eq!(taken.message.wrench.force.z, 3.0);
            }
            controller.refused().iter().any(|refused| {
                let who = refused.who.as_deref().unwrap_or_default();
                refused.topic == "wrench/tool" && who.starts_with("visitor/") && !refused.forged
            })
        });
        assert!(reader.counts().second_source > 0);
        // While held, the reader keeps the first publisher even if that falls silent.
        reader.hold(true);
        let before = reader.counts().second_source;
        let began = std::time::Instant::now();
        until("more than the lease has passed", || {
            lie.publish(&wrench(0.0));
            assert!(
                reader
                    .take_new()
                    .is_none_or(|taken| taken.message.wrench.force.z == 3.0)
            );
            began.elapsed().as_secs_f64() > 2.0 * tangent_actuation::lease::SILENCE_S
        });
        assert!(reader.counts().second_source > before);
        reader.hold(false);
        until("the other one is taken", || {
            lie.publish(&wrench(0.0));
            reader
                .take_new()
                .is_some_and(|taken| taken.message.wrench.force.z == 0.0)
        });
    });
}

/// A second publisher of the control state could have made a tare in contact seem allowed.
#[test]
fn an_impostors_control_state_is_refused_and_a_restarted_controllers_is_not() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (controller, visitor, sensor) = (client(&config), client(&config), client(&config));
        let _health = HealthReporter::start(&sensor, "netft").unwrap();
        let mut reader = sensor.latest(&topics::CONTROL_STATE).unwrap();
        let says = |contact_possible| ControlState {
            contact_possible,
            ..ControlState::default()
        };
        let truth = controller.publisher(&topics::CONTROL_STATE).unwrap();
        until("the controller is heard", || {
            truth.publish(&says(true));
            reader.take_new().is_some()
        });
        let _visits = HealthReporter::start(&visitor, "visitor").unwrap();
        let lie = visitor.publisher(&topics::CONTROL_STATE).unwrap();
        until("the impostor is named", || {
            truth.publish(&says(true));
            lie.publish(&says(false));
            assert!(reader.get().unwrap().message.contact_possible);
            sensor.refused().iter().any(|refused| {
                let who = refused.who.as_deref().unwrap_or_default();
                refused.topic == "control/state" && who.starts_with("visitor/")
            })
        });
        assert!(reader.counts().second_source > 0);
        // Another process takes the controller's place.
        drop((truth, lie));
        controller.close();
        let again = client(&config);
        let restarted = again.publisher(&topics::CONTROL_STATE).unwrap();
        until("the restarted controller is heard", || {
            restarted.publish(&says(false));
            !reader.get().unwrap().message.contact_possible
        });
        until("no publisher is refused any more", || {
            restarted.publish(&says(false));
            sensor.refused().iter().all(|refused| refused.who.is_none())
        });
    });
}

#[test]
fn an_id_of_this_process_never_comes_from_outside() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (robot, visitor) = (client(&config), client(&config));
        let commands = robot.subscribe(&topics::ARM_COMMAND, 64).unwrap();
        let own = robot.publisher(&topics::ARM_COMMAND).unwrap();
        let forged = visitor
            .raw_publisher(topics::ARM_COMMAND.key(), ArmCommand::NAME)
            .unwrap();
        let bytes = encoded(&ArmCommand {
            kind: 1,
            ..ArmCommand::default()
        });
        let mut sequence = 1 << 40;
        until("the forged ones are refused", || {
            sequence += 1;
            forged.publish_as(&bytes, own.id(), sequence);
            own.publish(&ArmCommand::default());
            while let Some(taken) = commands.try_recv() {
                assert_eq!(taken.message.kind, 0, "a forged command was taken");
            }
            commands.counts().second_source >= 20
        });
        assert!(robot.refused()[0].forged);
    });
}

#[test]
fn two_under_one_id_are_refused_until_one_is_left() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (sensor, visitor, controller) = (client(&config), client(&config), client(&config));
        let mut reader = controller.latest(&topics::WRENCH_TOOL).unwrap();
        let truth = sensor.publisher(&topics::WRENCH_TOOL).unwrap();
        until("the true one is heard", || {
            truth.publish(&wrench(3.0));
            reader.take_new().is_some()
        });
        let forged = visitor
            .raw_publisher(topics::WRENCH_TOOL.key(), WrenchStamped::NAME)
            .unwrap();
        // Far ahead of the true count, so that all true messages would have been refused.
        let mut sequence = 1 << 40;
        until("both are refused", || {
            sequence += 1;
            forged.publish_as(&encoded(&wrench(0.0)), truth.id(), sequence);
            truth.publish(&wrench(3.0));
            controller
                .refused()
                .iter()
                .any(|refused| refused.forged && refused.samples > 20)
        });
        while reader.take_new().is_some() {}
        for _ in 0..100 {
            sequence += 1;
            forged.publish_as(&encoded(&wrench(0.0)), truth.id(), sequence);
            truth.publish(&wrench(3.0));
        }
        until("the true one is heard again", || {
            truth.publish(&wrench(3.0));
            reader
                .take_new()
                .is_some_and(|taken| taken.message.wrench.force.z == 3.0)
        });
    });
}
