//! The running service: real sockets and threads on loopback, with a scripted controller.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use tangent_runtime::{Bus, CellConfig, Stop, Subscription};
use tangent_schemas::arm_modes::PROTECTIVE_STOP;
use tangent_schemas::tangent::{ArmCommand, ArmState, Request};
use tangent_schemas::topics;

use crate::codec::ControllerVersion;
use crate::scripted_robot::Robot;
use crate::settings::Config;
use crate::{queries, run};

const PATIENCE: Duration = Duration::from_secs(60);

/// Sockets around a scripted robot; each connection to RTDE restarts it.
struct Controller {
    config: Config,
    robot: Arc<Mutex<Robot>>,
    /// Received programs, in order.
    programs: Receiver<String>,
    /// Cuts the present RTDE connection.
    cut: Sender<()>,
}

fn controller() -> Controller {
    let rtde = TcpListener::bind("127.0.0.1:0").unwrap();
    let script = TcpListener::bind("127.0.0.1:0").unwrap();
    let dashboard = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut cell = CellConfig::default_cell();
    cell.robot.rtde_port = rtde.local_addr().unwrap().port();
    cell.robot.script_port = script.local_addr().unwrap().port();
    cell.robot.dashboard_port = dashboard.local_addr().unwrap().port();
    cell.robot.power_on = false;
    cell.realtime.enabled = false;
    let version = ControllerVersion::new(3, 15, 8);
    let robot = Arc::new(Mutex::new(Robot::new(version)));
    let (told, programs) = channel();
    let (cut, cuts) = channel::<()>();

    let shared = Arc::clone(&robot);
    std::thread::spawn(move || {
        for stream in script.incoming() {
            let (shared, told) = (Arc::clone(&shared), told.clone());
            std::thread::spawn(move || take_programs(stream.unwrap(), &shared, &told));
        }
    });
    let shared = Arc::clone(&robot);
    std::thread::spawn(move || {
        for stream in rtde.incoming() {
            let mut stream = stream.unwrap();
            *shared.lock().unwrap() = Robot::new(version);
            serve(&mut stream, &shared, &cuts);
        }
    });
    std::thread::spawn(move || {
        for stream in dashboard.incoming() {
            let mut stream = stream.unwrap();
            stream
                .write_all(b"Connected: Universal Robots Dashboard Server\n")
                .unwrap();
            let mut bytes = [0; 256];
            while let Ok(n) = stream.read(&mut bytes) {
                let answer: &[u8] = match bytes[..n].trim_ascii() {
                    b"" => break,
                    b"get robot model" => b"UR5\n",
                    b"unlock protective stop" => b"Protective stop releasing\n",
                    b"close safety popup" => b"closing safety popup\n",
                    _ => b"could not understand\n",
                };
                stream.write_all(answer).unwrap();
            }
        }
    });
    Controller {
        config: Config::from_cell(&cell).unwrap(),
        robot,
        programs,
        cut,
    }
}

/// Reads programs up to their last line and starts them.
fn take_programs(mut stream: std::net::TcpStream, robot: &Mutex<Robot>, told: &Sender<String>) {
    let (mut text, mut bytes) = (String::new(), [0; 4096]);
    while let Ok(n @ 1..) = stream.read(&mut bytes) {
        text.push_str(std::str::from_utf8(&bytes[..n]).unwrap());
        if text.ends_with("\nend\n") {
            // The token is in the line in which the program compares its session.
            let (_, rest) = text.split_once("(session == ").unwrap();
            let session = rest.split(')').next().unwrap().parse().unwrap();
            robot.lock().unwrap().upload(session);
            let _ = told.send(std::mem::take(&mut text));
        }
    }
}

/// Runs a cycle every 2 ms; the robot's clock advances by 8 ms per cycle, which does not matter
/// here.
fn serve(stream: &mut std::net::TcpStream, robot: &Mutex<Robot>, cuts: &Receiver<()>) {
    stream.set_nodelay(true).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_millis(2)))
        .unwrap();
    let mut bytes = [0; 4096];
    while cuts.try_recv().is_err() {
        let mut out = Vec::new();
        {
            let mut robot = robot.lock().unwrap();
            match stream.read(&mut bytes) {
                Ok(0) => return,
                Ok(n) => robot.receive(&bytes[..n], &mut out),
                Err(_) => {}
            }
            robot.cycle(&mut out);
        }
        if stream.write_all(&out).is_err() {
            return;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

struct Service {
    bus: Bus,
    stop: Stop,
    states: Subscription<ArmState>,
    thread: JoinHandle<Result<(), crate::Error>>,
}

fn service(config: &Config) -> Service {
    let bus = Bus::in_process("test");
    let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
    let stop = Stop::new();
    let (b, s, c) = (bus.clone(), stop.clone(), config.clone());
    let thread = std::thread::spawn(move || run(c, b, s));
    Service {
        bus,
        stop,
        states,
        thread,
    }
}

impl Service {
    fn until(&self, what: &str, condition: impl Fn(&ArmState) -> bool) -> ArmState {
        let mut last = None;
        for _ in 0..100_000 {
            let Some(received) = self.states.recv_timeout(PATIENCE) else {
                break;
            };
            if condition(&received.message) {
                return received.message;
            }
            last = Some(received.message);
        }
        panic!("{what} never came; last state: {last:?}");
    }

    fn ask(&self, key: &str) -> String {
        let answer = self.bus.ask(key, &Request::default(), PATIENCE).unwrap();
        assert!(answer.done, "{key}: {}", answer.message);
        answer.message
    }

    /// A controller in the same process: answers each state within its publish call.
    fn controller(&self, activation: u64) -> tangent_runtime::Handle {
        let commands = self.bus.publisher(&topics::ARM_COMMAND).unwrap();
        self.bus
            .on(&topics::ARM_STATE, move |received| {
                let state = &received.message;
                // Holds still until this controller has the lease; then its task starts.
                let mine = state.commander_id == commands.mark();
                let command = ArmCommand {
                    cycle: state.cycle,
                    kind: u8::from(mine),
                    values: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().collect(),
                    activation: if mine { activation } else { 0 },
                    source: "test/0".try_into().unwrap(),
                    ..ArmCommand::default()
                };
                commands.publish(&command);
            })
            .unwrap()
    }
}

#[test]
fn from_the_first_packet_to_motion_to_an_orderly_end() {
    let controller = controller();
    let service = service(&controller.config);
    let ready = service.until("ready", |s| s.ready);
    assert_eq!(ready.program_state, 1);
    assert!(
        controller
            .programs
            .recv_timeout(PATIENCE)
            .unwrap()
            .starts_with("def tangent_bridge():")
    );
    // The tool is where the model places it for q = 0, and does not move.
    let arm = &controller.config.arm;
    let (pose, _) = arm.tool_and_jacobian(
        &nalgebra::Vector6::zeros(),
        &controller.config.flange_from_tool,
    );
    assert_eq!(ready.tool_pose, (&pose).into());

    let task = service.controller(ready.activation_latched + 1);
    let moving = service.until("motion", |s| s.qd_target.first() == Some(&0.1));
    assert!(moving.command_latency_s > 0.0 && moving.packet_to_command_s > 0.0);
    // The answer to a state is in the bytes of the same cycle.
    service.until("an answer within its cycle", |s| {
        s.command_cycle_accepted + 1 == s.cycle
    });
    drop(task);
    let latched = service.until("silence", |s| {
        s.activation_latched > ready.activation_latched
    });
    assert!(latched.missed_cycles > 2);

    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
    let robot = controller.robot.lock().unwrap();
    assert!(robot.paused);
    assert_eq!((robot.sample.program_state, robot.sample.cause), (9, 3));
}

#[test]
fn a_second_source_is_refused_by_name_and_takes_over_after_silence_without_moving() {
    let controller = controller();
    let service = service(&controller.config);
    let health = service.bus.subscribe(&topics::health("rtde"), 64).unwrap();
    let ready = service.until("ready", |s| s.ready);
    let first = service.controller(ready.activation_latched + 1);
    service.until("motion", |s| s.qd_target.first() == Some(&0.1));

    // It always commands the opposite motion, with a newer activation, and before the first source
    // in each cycle.
    let commands = service.bus.publisher(&topics::ARM_COMMAND).unwrap();
    let intruder = service
        .bus
        .on(&topics::ARM_STATE, move |received| {
            commands.publish(&ArmCommand {
                cycle: received.message.cycle,
                kind: 1,
                values: [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().collect(),
                activation: 1000,
                source: "controller/elsewhere-7".try_into().unwrap(),
                ..ArmCommand::default()
            });
        })
        .unwrap();
    let begun = service.until("a refusal", |s| s.commands_refused > 0);
    let words = "controller/elsewhere-7 is refused: test/0 drives this arm";
    assert_eq!(begun.refusal_reason.as_str(), words);
    let mut state = begun.clone();
    let (mut seen, mut at_speed) = (0, 0);
    while state.commands_refused < begun.commands_refused + 200 {
        assert_eq!(state.commanded_by.as_str(), "test/0");
        // Commands that the machine makes late slow the arm down, never backwards.
        let first = state.qd_target.first().unwrap();
        assert!((0.0..=0.1).contains(first), "{state:?}");
        seen += 1;
        at_speed += u32::from(*first == 0.1);
        state = service.until("a state", |_| true);
    }
    // The refused commands do not hold it up, unless silence has ended the task.
    let is_latched = state.activation_latched > begun.activation_latched;
    assert!(2 * at_speed > seen || is_latched, "{at_speed} of {seen}");
    loop {
        let told = health.recv_timeout(PATIENCE).expect("health").message;
        if told.fault == words {
            assert_eq!(told.state, tangent_runtime::State::Degraded as u8);
            break;
        }
    }

    drop(first);
    let taken = service.until("the second has the arm", |s| {
        s.commanded_by.as_str() == "controller/elsewhere-7"
    });
    // Its present activation does not move the arm: it has to start a new task.
    assert_eq!(taken.activation_latched, 1000);
    for _ in 0..100 {
        let state = service.until("a state", |_| true);
        assert!(state.qd_target.iter().all(|v| *v == 0.0), "{state:?}");
    }
    drop(intruder);
    let _third = service.controller(1001);
    service.until("motion", |s| s.qd_target.first() == Some(&0.1));
    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
}

#[test]
fn it_comes_back_after_a_lost_connection_and_does_not_move() {
    let controller = controller();
    let service = service(&controller.config);
    let ready = service.until("ready", |s| s.ready);
    let activation = ready.activation_latched + 1;
    let task = service.controller(activation);
    service.until("motion", |s| s.qd_target.first() == Some(&0.1));
    controller.cut.send(()).unwrap();
    let again = service.until("ready again", |s| {
        s.ready && s.activation_latched == activation
    });
    assert!(again.qd_target.iter().all(|v| *v == 0.0));
    let later = service.until("refusals", |s| {
        s.commands_refused > again.commands_refused + 20
    });
    assert!(later.qd_target.iter().all(|v| *v == 0.0));
    assert!(
        later.refusal_reason.contains("latched out"),
        "{}",
        later.refusal_reason
    );
    drop(task);
    let _task = service.controller(activation + 1);
    service.until("motion", |s| s.qd_target.first() == Some(&0.1));
    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
}

#[test]
fn queries_reach_the_robot() {
    let controller = controller();
    let service = service(&controller.config);
    service.until("ready", |s| s.ready);
    service.ask(queries::STOP);
    service.until("latched or armed again", |s| {
        s.stop_cause == 3 || s.program_state == 4
    });
    service.until("ready", |s| s.ready);
    controller.robot.lock().unwrap().sample.safety_mode = PROTECTIVE_STOP;
    // When the second one arrives, all readers have received the first one.
    for _ in 0..2 {
        service.until("the stop", |s| s.safety_mode == PROTECTIVE_STOP);
    }
    assert_eq!(service.ask(queries::UNLOCK), "Protective stop releasing");
    controller.robot.lock().unwrap().sample.safety_mode = 1;
    service.until("ready", |s| s.ready);
    let refused = service
        .bus
        .ask(queries::POWER_OFF, &Request::default(), PATIENCE)
        .unwrap();
    assert!(!refused.done && refused.message.contains("refused `power off`"));
    controller.robot.lock().unwrap().sample.ident = 77;
    service.until("replaced", |s| {
        s.not_ready_reason.contains("replaced by another")
    });
    service.ask(queries::RESET);
    service.until("ready", |s| s.ready);
    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
}

#[test]
fn one_client_at_a_time_guides_the_arm() {
    let controller = controller();
    let service = service(&controller.config);
    let guide = |action: &str, who: &str| {
        let request = Request {
            action: action.into(),
            argument: who.into(),
        };
        let answer = service.bus.ask(queries::GUIDE, &request, PATIENCE).unwrap();
        (answer.done, answer.message)
    };
    let ready = service.until("ready", |s| s.ready);
    assert!(!guide("begin", "").0 && !guide("free", "teach/1").0);
    let (done, words) = guide("keep", "teach/1");
    assert!(!done && words.contains("ended on request"), "{words}");

    assert!(guide("begin", "teach/1").0);
    let free = service.until("free", |s| s.program_state == 5);
    assert!(!free.ready && free.not_ready_reason.contains("a hand guides the arm"));
    assert!(guide("keep", "teach/1").0);
    let second = guide("begin", "teach/2");
    assert_eq!(second, (false, "teach/1 guides the arm".into()));
    // Nothing moves it meanwhile.
    let task = service.controller(ready.activation_latched + 1);
    let still = service.until("a latched task", |s| {
        s.activation_latched > ready.activation_latched
    });
    assert!(still.qd_target.iter().all(|v| *v == 0.0));
    drop(task);
    assert!(guide("end", "anybody").0);
    service.until("ready again", |s| s.ready);

    let task = service.controller(ready.activation_latched + 2);
    service.until("motion", |s| s.qd_target.first() == Some(&0.1));
    let (done, words) = guide("begin", "teach/2");
    assert!(!done && words.contains("a task uses the arm"), "{words}");
    drop(task);
    // Without a sign of life, it ends by itself.
    service.until("ready", |s| s.ready && s.program_state == 1);
    assert!(guide("begin", "teach/2").0);
    service.until("free", |s| s.program_state == 5);
    service.until("held again", |s| s.ready);
    let (done, words) = guide("keep", "teach/2");
    assert!(!done && words.contains("fell silent"), "{words}");
    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
}

#[test]
fn without_a_robot_it_waits_and_ends_at_once_on_a_stop() {
    let mut config = controller().config;
    config.rtde_port = 1;
    let service = service(&config);
    let health = service.bus.subscribe(&topics::health("rtde"), 16).unwrap();
    loop {
        let told = health.recv_timeout(PATIENCE).unwrap().message;
        if told.fault.contains("127.0.0.1:1:") {
            break;
        }
    }
    service.stop.trigger();
    service.thread.join().unwrap().unwrap();
}
