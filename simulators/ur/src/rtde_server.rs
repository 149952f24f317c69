//! RTDE, the controller's side: negotiation, recipes, ownership of inputs, the stream of outputs.
//!
//! [`Session`] is one client's conversation without its socket; [`RtdeServer`] puts sockets around
//! sessions. The cell's thread polls it once per control cycle, so that inputs count in the cycle
//! they arrive in.

use std::collections::HashMap;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use tangent_rtde::codec::{
    ControllerVersion, Framer, Protocol, Recipe, Reply, Request, Slot, TextLevel, TextMessage,
    Value, input_field, output_cycles, output_field,
};

use crate::connection::{Connection, accept};
use crate::controller::{Controller, Summary};

/// Largest package taken from a client, bytes.
const PACKAGE_BYTES_MAX: usize = 4096;
/// Input recipes of one client.
const INPUT_RECIPES_MAX: usize = 255;

/// Owner of each input: one client per variable.
#[derive(Debug, Default)]
pub struct Ownership {
    owners: HashMap<String, (u64, Option<Instant>)>,
}

impl Ownership {
    fn is_free(&self, name: &str, client: u64) -> bool {
        self.owners
            .get(name)
            .is_none_or(|(owner, _)| *owner == client)
    }

    fn claim(&mut self, names: &[String], client: u64) {
        for name in names {
            self.owners.insert(name.clone(), (client, None));
        }
    }

    fn release(&mut self, client: u64, now: Instant) {
        for (owner, gone) in self.owners.values_mut() {
            if *owner == client {
                *gone = Some(now);
            }
        }
    }

    fn expire(&mut self, now: Instant, linger: Duration) {
        self.owners
            .retain(|_, (_, gone)| gone.is_none_or(|gone| now - gone < linger));
    }
}

/// One client's conversation.
#[derive(Debug)]
pub struct Session {
    client: u64,
    version: ControllerVersion,
    protocol: Protocol,
    outputs: Option<(Recipe, Vec<String>, u32)>,
    inputs: Vec<Option<(Recipe, Vec<String>)>>,
    started: bool,
    values: Vec<Value>,
}

/// Effect of a request besides its answer.
#[derive(Debug, PartialEq)]
pub enum Effect {
    /// Nothing more.
    None,
    /// Input fields and their values.
    Inputs(Vec<String>, Vec<Value>),
    /// A line for the log.
    Log(String),
}

impl Session {
    /// Creates the session of a new client. `client` identifies it.
    pub fn new(client: u64, version: ControllerVersion) -> Self {
        Self {
            client,
            version,
            protocol: Protocol::V1,
            outputs: None,
            inputs: Vec::new(),
            started: false,
            values: Vec::new(),
        }
    }

    /// Answers one package into `out`.
    pub fn handle(
        &mut self,
        kind: u8,
        payload: &[u8],
        ownership: &mut Ownership,
        out: &mut Vec<u8>,
    ) -> Effect {
        let request = match Request::decode(kind, payload, self.protocol) {
            Ok(request) => request,
            Err(error) => {
                self.complain(&error.to_string(), out);
                return Effect::None;
            }
        };
        let reply = match request {
            Request::ProtocolVersion(number) => {
                let wanted = Protocol::from_number(number);
                self.protocol = wanted.unwrap_or(self.protocol);
                Reply::ProtocolVersion {
                    accepted: wanted.is_some(),
                }
            }
            Request::ControllerVersion => Reply::ControllerVersion(self.version),
            Request::Text(text) => {
                return Effect::Log(format!("{} (from {})", text.message, text.source));
            }
            Request::SetupOutputs {
                frequency_hz,
                names,
            } => self.setup_outputs(frequency_hz, names),
            Request::SetupInputs { names } => self.setup_inputs(names, ownership),
            Request::Start => {
                self.started = self.outputs.is_some();
                Reply::Start {
                    accepted: self.started,
                }
            }
            Request::Pause => {
                self.started = false;
                Reply::Pause { accepted: true }
            }
            Request::Data(data) => return self.data(data, out),
        };
        // An answer that cannot be encoded is longer than any client requested.
        if let Err(error) = reply.encode(self.protocol, out) {
            self.complain(&error.to_string(), out);
        }
        Effect::None
    }

    fn complain(&self, message: &str, out: &mut Vec<u8>) {
        let text = TextMessage {
            message: message.to_owned(),
            source: "RTDE".to_owned(),
            level: TextLevel::Error,
        };
        // A text message is cut to fit, so it can always be encoded.
        let _ = Reply::Text(text).encode(self.protocol, out);
    }

    fn setup_outputs(&mut self, frequency_hz: Option<f64>, names: Vec<String>) -> Reply<'static> {
        let slots: Vec<Slot> = names
            .iter()
            .map(|name| match output_field(name) {
                Some(field) if field.exists_on(&self.version) => Slot::Type(field.data_type),
                _ => Slot::NotFound,
            })
            .collect();
        self.started = false;
        self.outputs = recipe(1, &slots).map(|recipe| {
            let series = self.version.series();
            let rate = frequency_hz.unwrap_or_else(|| series.rate_hz());
            (recipe, names, output_cycles(series, rate))
        });
        Reply::SetupOutputs {
            recipe_id: Some(u8::from(self.outputs.is_some())),
            slots,
        }
    }

    fn setup_inputs(&mut self, names: Vec<String>, ownership: &mut Ownership) -> Reply<'static> {
        let slots: Vec<Slot> = names
            .iter()
            .map(|name| match input_field(name) {
                Some(field) if field.exists_on(&self.version) => {
                    if ownership.is_free(name, self.client) {
                        Slot::Type(field.data_type)
                    } else {
                        Slot::InUse
                    }
                }
                _ => Slot::NotFound,
            })
            .collect();
        let room = self.inputs.len() < INPUT_RECIPES_MAX;
        let id = (self.inputs.len() + 1) as u8;
        let recipe_id = match recipe(id, &slots) {
            Some(recipe) if room => {
                ownership.claim(&names, self.client);
                self.inputs.push(Some((recipe, names)));
                id
            }
            _ => 0,
        };
        Reply::SetupInputs { recipe_id, slots }
    }

    fn data(&mut self, data: &[u8], out: &mut Vec<u8>) -> Effect {
        let id = data.first().copied().unwrap_or(0);
        let found = usize::from(id)
            .checked_sub(1)
            .and_then(|n| self.inputs.get(n)?.as_ref());
        let Some((recipe, names)) = found else {
            self.complain(&format!("there is no input recipe {id}"), out);
            return Effect::None;
        };
        match recipe.decode(data, &mut self.values) {
            Ok(()) => Effect::Inputs(names.clone(), self.values.clone()),
            Err(error) => {
                self.complain(&error.to_string(), out);
                Effect::None
            }
        }
    }

    /// The output package of a cycle, if one is due.
    pub fn package(&mut self, cycle: u64, controller: &Controller, summary: &Summary) -> Vec<u8> {
        let mut out = Vec::new();
        let Some((recipe, names, cycles)) = self.outputs.as_ref().filter(|_| self.started) else {
            return out;
        };
        if !cycle.is_multiple_of(u64::from(*cycles)) {
            return out;
        }
        self.values.clear();
        self.values
            .extend(names.iter().map(|name| controller.output(name, summary)));
        let written = match self.protocol {
            Protocol::V1 => recipe.encode_without_id(&self.values, &mut out),
            Protocol::V2 => recipe.encode(&self.values, &mut out),
        };
        if let Err(error) = written {
            tracing::error!(target: "simulator", "RTDE output: {error}");
        }
        out
    }
}

fn linger(controller: &Controller) -> Duration {
    Duration::from_secs_f64(controller.config().ownership_linger_s.max(0.0))
}

/// `None` if a slot has no type, or there is no slot.
fn recipe(id: u8, slots: &[Slot]) -> Option<Recipe> {
    let types: Option<Vec<_>> = slots
        .iter()
        .map(|slot| match slot {
            Slot::Type(t) => Some(*t),
            Slot::NotFound | Slot::InUse => None,
        })
        .collect();
    Recipe::new(id, types.filter(|t| !t.is_empty())?).ok()
}

/// Injected disturbance of the stream of outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StreamFaults {
    /// Packages arrive later by this time, s.
    pub delay_s: f64,
    /// No package is sent.
    pub frozen: bool,
    /// Leaves this cycle's package out.
    pub skip: bool,
}

/// All RTDE clients.
#[derive(Debug)]
pub struct RtdeServer {
    listener: TcpListener,
    clients: Vec<(Connection, Framer, Session)>,
    ownership: Ownership,
    next_client: u64,
    incoming: Vec<u8>,
}

impl RtdeServer {
    /// Creates a server for a non-blocking listener.
    pub fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            clients: Vec::new(),
            ownership: Ownership::default(),
            next_client: 1,
            incoming: Vec::new(),
        }
    }

    /// Present number of clients.
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Disconnects all clients.
    pub fn disconnect_all(&mut self) {
        self.clients.clear();
        self.ownership = Ownership::default();
    }

    /// Accepts new clients, answers requests, passes inputs to the controller.
    pub fn poll(&mut self, controller: &mut Controller, now: Instant) {
        let version = controller.config().flavour.version();
        let linger = linger(controller);
        for connection in accept(&self.listener, self.clients.len()) {
            let framer = Framer::new(PACKAGE_BYTES_MAX);
            let session = Session::new(self.next_client, version);
            self.next_client += 1;
            self.clients.push((connection, framer, session));
        }
        let mut answers = Vec::new();
        for (connection, framer, session) in &mut self.clients {
            self.incoming.clear();
            connection.read(&mut self.incoming);
            let mut bytes = self.incoming.as_slice();
            answers.clear();
            loop {
                let taken = framer.push(bytes);
                bytes = &bytes[taken..];
                let package = match framer.next_package() {
                    Ok(Some(package)) => package,
                    Ok(None) if bytes.is_empty() => break,
                    Ok(None) => continue,
                    Err(error) => {
                        tracing::info!(target: "simulator", "{}: {error}", connection.peer());
                        connection.close();
                        break;
                    }
                };
                let effect = session.handle(
                    package.kind,
                    package.payload,
                    &mut self.ownership,
                    &mut answers,
                );
                match effect {
                    Effect::None => {}
                    Effect::Inputs(names, values) => controller.write_inputs(&names, &values),
                    Effect::Log(line) => controller.log_line(&line),
                }
                // No client needs so many answers within a cycle.
                if answers.len() > 1 << 20 {
                    connection.close();
                    break;
                }
            }
            if !answers.is_empty() {
                connection.send(&answers, now);
            }
            // Its successor may already be among the clients of this cycle.
            if connection.is_closed() {
                self.ownership.release(session.client, now);
                self.ownership.expire(now, linger);
            }
        }
    }

    /// Sends the outputs of a cycle and removes clients that have disconnected.
    pub fn publish(
        &mut self,
        controller: &Controller,
        cycle: u64,
        now: Instant,
        faults: &StreamFaults,
    ) {
        let config = controller.config();
        let limit = Duration::from_secs_f64(config.unread_limit_s.max(0.0));
        let linger = linger(controller);
        let delay = Duration::from_secs_f64(faults.delay_s.clamp(0.0, 60.0));
        let silent = faults.frozen || faults.skip;
        if !self.clients.is_empty() {
            let summary = controller.summary();
            for (connection, _, session) in &mut self.clients {
                if !silent {
                    let package = session.package(cycle, controller, &summary);
                    if !package.is_empty() {
                        connection.send_later(&package, now, delay);
                    }
                }
                connection.tend(now, Some(limit));
            }
        }
        let ownership = &mut self.ownership;
        self.clients.retain(|(connection, _, session)| {
            if connection.is_closed() {
                ownership.release(session.client, now);
            }
            !connection.is_closed()
        });
        ownership.expire(now, linger);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{Framer, Ownership, Protocol, Reply, Session};
    use crate::config::Flavour;
    use crate::rig::Rig;

    /// A package of a kind that exists, with any payload.
    fn package() -> impl Strategy<Value = (u8, Vec<u8>)> {
        let kind = prop::sample::select(b"VvMUOISP?".to_vec());
        let names = "[a-z_0-9,]{0,60}".prop_map(String::into_bytes);
        let real = prop::sample::select(vec![
            "input_int_register_0,",
            "timestamp,actual_q",
            ",,,,",
            "speed_slider_mask,speed_slider_fraction",
        ]);
        let real = real.prop_map(|s| s.as_bytes().to_vec());
        let payload = prop_oneof![
            prop::collection::vec(any::<u8>(), 0..80),
            names,
            real.clone(),
            (any::<f64>(), real).prop_map(|(f, names)| [f.to_be_bytes().to_vec(), names].concat()),
            Just(vec![0, 2]),
        ];
        (kind, payload)
    }

    proptest! {
        /// Random and malformed packages: no panic, and the next well-formed request is answered.
        #[test]
        fn any_packages(packages in prop::collection::vec(package(), 0..30)) {
            let mut rig = Rig::cb3();
            let mut ownership = Ownership::default();
            let mut session = Session::new(1, Flavour::Cb3.version());
            let mut out = Vec::new();
            for (kind, payload) in &packages {
                session.handle(*kind, payload, &mut ownership, &mut out);
                rig.cycle();
                let summary = rig.controller.summary();
                session.package(1, &rig.controller, &summary);
            }
            out.clear();
            session.handle(b'v', &[], &mut ownership, &mut out);
            let mut framer = Framer::new(65_535);
            framer.push(&out);
            let package = framer.next_package().unwrap().unwrap();
            let reply = Reply::decode(package.kind, package.payload, Protocol::V2).unwrap();
            prop_assert_eq!(reply, Reply::ControllerVersion(Flavour::Cb3.version()));
        }
    }
}
