//! The cell's RTDE server over real sockets, with a client written from the protocol alone.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Instant;

use crate::common::{PATIENCE, cb3, connect, start};
use tangent_live::timed;
use tangent_rtde::codec::{Framer, Protocol, Recipe, Reply, Request, Slot, TextLevel, Value};
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour, SimulatedUr};

/// An RTDE client.
struct Client {
    stream: TcpStream,
    framer: Framer,
    protocol: Protocol,
}

#[derive(Debug, PartialEq)]
enum Answer {
    Version(bool),
    Controller(u32, u32),
    Outputs(Option<u8>, Vec<Slot>),
    Inputs(u8, Vec<Slot>),
    Start(bool),
    Pause(bool),
    Text(TextLevel),
    Data(Vec<u8>),
}

impl Client {
    fn new(cell: &SimulatedUr) -> Self {
        Self {
            stream: connect(cell.endpoints().rtde),
            framer: Framer::new(65_535),
            protocol: Protocol::V1,
        }
    }

    fn v2(cell: &SimulatedUr) -> Self {
        let mut client = Self::new(cell);
        assert_eq!(
            client.ask(&Request::ProtocolVersion(2)),
            Answer::Version(true)
        );
        client.protocol = Protocol::V2;
        client
    }

    fn send(&mut self, request: &Request<'_>) {
        let mut bytes = Vec::new();
        request.encode(self.protocol, &mut bytes).unwrap();
        self.stream.write_all(&bytes).unwrap();
    }

    /// `None` if the controller closes the connection.
    fn next(&mut self) -> Option<Answer> {
        loop {
            if let Some(package) = self.framer.next_package().unwrap() {
                let reply = Reply::decode(package.kind, package.payload, self.protocol).unwrap();
                return Some(match reply {
                    Reply::ProtocolVersion { accepted } => Answer::Version(accepted),
                    Reply::ControllerVersion(v) => Answer::Controller(v.major, v.minor),
                    Reply::SetupOutputs { recipe_id, slots } => Answer::Outputs(recipe_id, slots),
                    Reply::SetupInputs { recipe_id, slots } => Answer::Inputs(recipe_id, slots),
                    Reply::Start { accepted } => Answer::Start(accepted),
                    Reply::Pause { accepted } => Answer::Pause(accepted),
                    Reply::Text(text) => Answer::Text(text.level),
                    Reply::Data(data) => Answer::Data(data.to_vec()),
                });
            }
            let mut buffer = [0; 4096];
            match self.stream.read(&mut buffer) {
                Ok(0) => return None,
                Ok(n) => assert_eq!(self.framer.push(&buffer[..n]), n),
                Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset => return None,
                Err(e) => panic!("no answer: {e}"),
            }
        }
    }

    /// The answer; data packages before it are skipped.
    fn ask(&mut self, request: &Request<'_>) -> Answer {
        self.send(request);
        loop {
            match self.next().unwrap() {
                Answer::Data(_) => {}
                answer => return answer,
            }
        }
    }

    fn outputs(&mut self, frequency_hz: f64, names: &[&str]) -> Answer {
        self.ask(&Request::SetupOutputs {
            frequency_hz: Some(frequency_hz),
            names: names.iter().map(|n| (*n).to_owned()).collect(),
        })
    }

    fn inputs(&mut self, names: &[&str]) -> Answer {
        self.ask(&Request::SetupInputs {
            names: names.iter().map(|n| (*n).to_owned()).collect(),
        })
    }

    /// Streams these outputs; the types come from the controller.
    fn stream_of(&mut self, frequency_hz: f64, names: &[&str]) -> Recipe {
        let Answer::Outputs(id, slots) = self.outputs(frequency_hz, names) else {
            panic!("no recipe");
        };
        let types = slots
            .iter()
            .map(|slot| match slot {
                Slot::Type(t) => *t,
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(self.ask(&Request::Start), Answer::Start(true));
        Recipe::new(id.unwrap_or(0), types).unwrap()
    }

    fn data(&mut self, recipe: &Recipe) -> Vec<Value> {
        let mut values = Vec::new();
        loop {
            if let Answer::Data(data) = self.next().unwrap() {
                match self.protocol {
                    Protocol::V2 => recipe.decode(&data, &mut values).unwrap(),
                    Protocol::V1 => recipe.decode_without_id(&data, &mut values).unwrap(),
                }
                return values;
            }
        }
    }

    fn write(&mut self, recipe: u8, values: &[Value]) {
        let types = values.iter().map(Value::data_type).collect();
        let recipe = Recipe::new(recipe, types).unwrap();
        let mut bytes = Vec::new();
        recipe.encode(values, &mut bytes).unwrap();
        self.stream.write_all(&bytes).unwrap();
    }
}

fn double(value: &Value) -> f64 {
    value.as_double().unwrap()
}

#[test]
fn negotiation_as_every_known_client_does_it() {
    timed(|| {
        let cell = cb3();
        let mut client = Client::new(&cell);
        assert_eq!(
            client.ask(&Request::ProtocolVersion(7)),
            Answer::Version(false)
        );
        assert_eq!(
            client.ask(&Request::ProtocolVersion(2)),
            Answer::Version(true)
        );
        client.protocol = Protocol::V2;
        // Twice, as ur_rtde asks.
        assert_eq!(
            client.ask(&Request::ControllerVersion),
            Answer::Controller(3, 15)
        );
        assert_eq!(
            client.ask(&Request::ControllerVersion),
            Answer::Controller(3, 15)
        );
        assert_eq!(client.ask(&Request::Start), Answer::Start(false));
        // Its list of names ends with a comma, for which no type may come.
        let mut bytes = vec![0, 0, b'O'];
        bytes.extend(125f64.to_be_bytes());
        bytes.extend(b"timestamp,actual_q,runtime_state,");
        bytes[1] = bytes.len() as u8;
        client.stream.write_all(&bytes).unwrap();
        let Answer::Outputs(Some(1), slots) = client.next().unwrap() else {
            panic!();
        };
        assert_eq!(slots.len(), 3);
        let Answer::Outputs(Some(0), slots) =
            client.outputs(125.0, &["timestamp", "ft_raw_wrench"])
        else {
            panic!();
        };
        assert_eq!(slots[1], Slot::NotFound, "no such sensor on CB3");
        assert_eq!(client.ask(&Request::Start), Answer::Start(false));
        assert!(matches!(
            client.outputs(125.0, &["tcp_offset"]),
            Answer::Outputs(Some(1), _)
        ));
        assert_eq!(client.ask(&Request::Start), Answer::Start(true));
        assert_eq!(client.ask(&Request::Pause), Answer::Pause(true));
    });
}

#[test]
fn recipe_numbers_count_from_one_and_inputs_work_before_start() {
    timed(|| {
        let cell = cb3();
        let mut client = Client::v2(&cell);
        for id in 1..=23 {
            let Answer::Inputs(got, _) = client.inputs(&["input_int_register_0"]) else {
                panic!();
            };
            assert_eq!(got, id);
        }
        assert!(matches!(
            client.inputs(&["input_int_register_0", "input_double_register_47"]),
            Answer::Inputs(24, _)
        ));
        assert!(matches!(
            client.inputs(&["no_such_thing"]),
            Answer::Inputs(0, _)
        ));
        // Several packages in one cycle: the last one counts.
        for n in 1..=5 {
            client.write(24, &[Value::Int32(n), Value::Double(0.5 * f64::from(n))]);
        }
        // Read back by another client: reading never conflicts.
        let mut reader = Client::v2(&cell);
        let names = ["input_int_register_0", "input_double_register_47"];
        let recipe = reader.stream_of(125.0, &names);
        let written = [Value::Int32(5), Value::Double(2.5)];
        let deadline = Instant::now() + PATIENCE;
        while reader.data(&recipe) != written {
            assert!(Instant::now() < deadline);
        }
        // Values persist when the client goes; the variable is free again.
        drop(client);
        assert!(cell.wait_for(PATIENCE, |s| s.rtde_clients == 1));
        assert_eq!(reader.data(&recipe), written);
        assert!(matches!(reader.inputs(&names), Answer::Inputs(1, _)));
    });
}

#[test]
fn one_client_owns_an_input() {
    timed(|| {
        let cell = cb3();
        let mut first = Client::v2(&cell);
        let mut second = Client::v2(&cell);
        assert!(matches!(
            first.inputs(&["input_int_register_24"]),
            Answer::Inputs(1, _)
        ));
        let Answer::Inputs(0, slots) =
            second.inputs(&["input_int_register_25", "input_int_register_24"])
        else {
            panic!();
        };
        assert!(matches!(slots[0], Slot::Type(_)));
        assert_eq!(slots[1], Slot::InUse);
        // The valid inputs in the refused recipe were not claimed.
        assert!(matches!(
            first.inputs(&["input_int_register_25"]),
            Answer::Inputs(2, _)
        ));
    });
}

#[test]
fn the_rate_is_divided_and_time_counts_cycles() {
    timed(|| {
        let cell = cb3();
        for (frequency, step) in [(125.0, 0.008), (50.0, 0.016), (10.0, 0.096), (500.0, 0.008)] {
            let mut client = Client::v2(&cell);
            let recipe = client.stream_of(frequency, &["timestamp"]);
            let first = double(&client.data(&recipe)[0]);
            assert!(first > 40.0, "clients wait for the boot's end below that");
            for i in 1..4 {
                let time = double(&client.data(&recipe)[0]);
                assert!((time - first - f64::from(i) * step).abs() < 1e-6);
            }
        }
    });
}

#[test]
fn version_1_has_no_recipe_number() {
    timed(|| {
        let cell = cb3();
        let mut client = Client::new(&cell);
        let recipe = client.stream_of(0.0, &["timestamp", "robot_mode"]);
        assert_eq!(client.data(&recipe)[1], Value::Int32(7));
    });
}

#[test]
fn invalid_bytes_are_answered_or_end_the_connection_and_nothing_else() {
    timed(|| {
        let cell = cb3();
        let mut client = Client::v2(&cell);
        client.stream.write_all(&[0, 4, b'Q', 1]).unwrap();
        assert_eq!(client.next(), Some(Answer::Text(TextLevel::Error)));
        client.write(9, &[Value::Int32(1)]);
        assert_eq!(client.next(), Some(Answer::Text(TextLevel::Error)));
        assert_eq!(
            client.ask(&Request::ControllerVersion),
            Answer::Controller(3, 15)
        );
        client.stream.write_all(&[0, 1, 7, 9, 9]).unwrap();
        assert_eq!(client.next(), None);
        let mut other = Client::v2(&cell);
        assert_eq!(
            other.ask(&Request::ControllerVersion),
            Answer::Controller(3, 15)
        );
    });
}

#[test]
fn a_client_that_does_not_read_is_cut_off_and_no_other() {
    timed(|| {
        let cell = start(ControllerConfig {
            flavour: Flavour::ESeries,
            unread_limit_s: 0.2,
            ..ControllerConfig::default()
        });
        let names: Vec<String> = (0..48)
            .map(|n| format!("output_double_register_{n}"))
            .collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut lazy = Client::v2(&cell);
        // A small window, so that the kernels' buffers do not hold minutes of it.
        nix::sys::socket::setsockopt(&lazy.stream, nix::sys::socket::sockopt::RcvBuf, &4096)
            .unwrap();
        lazy.stream_of(500.0, &names);
        let mut good = Client::v2(&cell);
        let recipe = good.stream_of(500.0, &["timestamp"]);
        assert!(cell.wait_for(PATIENCE, |s| s.rtde_clients == 2));
        let deadline = Instant::now() + PATIENCE;
        while cell.snapshot().unwrap().rtde_clients == 2 {
            good.data(&recipe);
            assert!(Instant::now() < deadline);
        }
        good.data(&recipe);
    });
}

#[test]
fn faults_of_the_stream() {
    timed(|| {
        let cell = cb3();
        let mut client = Client::v2(&cell);
        let recipe = client.stream_of(125.0, &["timestamp"]);
        cell.fault(Fault::DropPackets {
            probability: 0.5,
            burst: 2,
        });
        let mut last = double(&client.data(&recipe)[0]);
        let mut gaps = 0;
        for _ in 0..40 {
            let time = double(&client.data(&recipe)[0]);
            gaps += i32::from(time - last > 0.012);
            last = time;
        }
        assert!(gaps > 3, "{gaps} gaps");
        cell.fault(Fault::DropPackets {
            probability: 0.0,
            burst: 1,
        });
        cell.fault(Fault::Disconnect);
        while client.next().is_some() {}
        let mut client = Client::v2(&cell);
        client.stream_of(125.0, &["timestamp"]);
    });
}

#[test]
fn a_restart_closes_everything_and_comes_back_from_zero() {
    timed(|| {
        let cell = start(ControllerConfig {
            boot_s: 0.2,
            ..ControllerConfig::default()
        });
        let mut client = Client::v2(&cell);
        assert!(matches!(
            client.inputs(&["input_int_register_3"]),
            Answer::Inputs(1, _)
        ));
        client.write(1, &[Value::Int32(99)]);
        cell.fault(Fault::Restart);
        assert_eq!(client.next(), None);
        assert!(cell.wait_for(PATIENCE, |s| s.summary.time_s < 30.0));
        let mut client = Client::v2(&cell);
        let recipe = client.stream_of(125.0, &["timestamp", "input_int_register_3"]);
        let values = client.data(&recipe);
        assert!(double(&values[0]) < 30.0);
        assert_eq!(values[1], Value::Int32(0));
    });
}
