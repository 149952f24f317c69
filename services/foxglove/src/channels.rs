//! One channel per topic, as in a recording: the same name, schema and bytes.

use std::collections::HashMap;
use std::sync::{Arc, mpsc};

use foxglove::{ChannelId, Context, PartialMetadata, RawChannel, Schema, SinkId};
use tangent_recorder::{Definitions, matches_any};
use tangent_runtime::RawMessage;
use tangent_schemas::topics;
use tokio::runtime::Handle;

use crate::Config;

/// The channels of all keys seen so far. Their number is bounded by that of the keys that the bus
/// follows.
pub struct Channels {
    context: Arc<Context>,
    viewers: Handle,
    include: Vec<String>,
    exclude: Vec<String>,
    by_key: HashMap<Arc<str>, Channel>,
    definitions: Definitions,
}

struct Channel {
    type_name: String,
    channel: Arc<RawChannel>,
    /// Newest message, if it holds until the next one.
    latched: Option<RawMessage>,
}

impl Channels {
    /// No channel yet; `viewers` is the runtime that serves the viewers, with one thread.
    pub fn new(context: &Arc<Context>, viewers: &Handle, config: &Config) -> Self {
        Self {
            context: Arc::clone(context),
            viewers: viewers.clone(),
            include: config.include.clone(),
            exclude: config.exclude.clone(),
            by_key: HashMap::new(),
            definitions: Definitions::default(),
        }
    }

    /// Passes a message to the viewers that have subscribed to it. Returns whether it is forwarded
    /// at all.
    pub fn forward(&mut self, message: &RawMessage) -> bool {
        let known = self.by_key.get(&message.key);
        if known.is_none_or(|channel| channel.type_name != message.type_name)
            && !(self.wants(&message.key) && self.open(message))
        {
            return false;
        }
        let Some(channel) = self.by_key.get_mut(&message.key) else {
            return false;
        };
        if topics::is_latched(&message.key) {
            channel.latched = Some(message.clone());
        }
        channel
            .channel
            .log_with_meta(&message.payload, meta(message));
        true
    }

    fn wants(&self, key: &str) -> bool {
        matches_any(&self.include, key) && !matches_any(&self.exclude, key)
    }

    /// Opens the channel of a key, in place of one with another type; false if it cannot be opened.
    fn open(&mut self, message: &RawMessage) -> bool {
        // The protocol requires a schema: for an unknown type one with a name and no text, as in a
        // recording.
        let (encoding, text) = match self.definitions.of(&message.type_name) {
            Some(text) => ("ros2msg", text.as_bytes().to_vec()),
            None => ("", Vec::new()),
        };
        let schema = Schema::new(message.type_name.to_string(), encoding, text);
        let builder = self.context.channel_builder(format!("/{}", message.key));
        let builder = builder.message_encoding("cdr").schema(schema);
        // The server advertises a channel before it notes that it has: from any other thread, a
        // viewer that subscribes at once may be told that there is no such channel.
        let (tell, told) = mpsc::channel();
        self.viewers
            .spawn(async move { tell.send(builder.build_raw()) });
        let channel = match told.recv() {
            Ok(Ok(channel)) => channel,
            Ok(Err(error)) => {
                tracing::error!("{}: {error}", message.key);
                return false;
            }
            Err(_) => {
                tracing::error!("{}: the thread that serves viewers has ended", message.key);
                return false;
            }
        };
        let opened = Channel {
            type_name: message.type_name.to_string(),
            channel,
            latched: None,
        };
        if let Some(old) = self.by_key.insert(Arc::clone(&message.key), opened) {
            old.channel.close();
        }
        true
    }

    /// Sends a viewer that has just subscribed to a channel what holds there.
    pub fn send_latched(&self, channel: ChannelId, viewer: SinkId) {
        let of = |one: &&Channel| one.channel.id() == channel;
        if let Some(one) = self.by_key.values().find(of)
            && let Some(message) = &one.latched
        {
            one.channel
                .log_with_meta_to_sink(&message.payload, meta(message), Some(viewer));
        }
    }
}

fn meta(message: &RawMessage) -> PartialMetadata {
    PartialMetadata {
        log_time: u64::try_from(message.received_ns).ok(),
    }
}
