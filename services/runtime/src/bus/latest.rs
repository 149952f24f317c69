//! A reader that keeps the newest message only.

use std::sync::Arc;
use std::time::Duration;

use tangent_schemas::Message;

use super::reader::{Counts, Handle, Output, ReaderCore, Received};

/// The newest message of a topic.
pub struct Latest<M: Message> {
    core: Arc<ReaderCore<M>>,
    output: Output<M>,
    _handle: Handle,
}

impl<M: Message> Latest<M> {
    pub(crate) fn new(core: Arc<ReaderCore<M>>, output: Output<M>, handle: Handle) -> Self {
        Self {
            core,
            output,
            _handle: handle,
        }
    }

    /// Takes in messages since the last call; true if there were any. Takes no lock and allocates
    /// nothing.
    pub fn refresh(&mut self) -> bool {
        self.output.update()
    }

    /// The newest message so far, however old. Takes no lock and allocates nothing.
    pub fn get(&mut self) -> Option<&Received<M>> {
        self.output.read().as_ref()
    }

    /// The newest message, if it arrived within `patience`.
    pub fn fresh(&mut self, patience: Duration) -> Option<&Received<M>> {
        self.get().filter(|received| received.age() <= patience)
    }

    /// The newest message, if it arrived since the last call of any of these methods.
    pub fn take_new(&mut self) -> Option<&Received<M>> {
        if self.refresh() {
            self.output.output_buffer().as_ref()
        } else {
            None
        }
    }

    /// Refuses samples from other processes whose source time is older than `age` when they arrive.
    /// Use it only if the hosts' clocks agree.
    pub fn refuse_older_than(&self, age: Duration) {
        self.core.refuse_older_than(age);
    }

    /// While held, no other publisher replaces the present one, even when that falls silent. For
    /// topics that have one publisher ([`tangent_schemas::topics::Sources::One`]). Takes no lock
    /// and allocates nothing.
    pub fn hold(&self, held: bool) {
        self.core.hold(held);
    }

    /// Counts of this reader's messages, delivered and refused.
    pub fn counts(&self) -> Counts {
        self.core.counts()
    }

    /// Number of messages that never arrived, by sequence number.
    pub fn lost(&self) -> u64 {
        self.counts().missing
    }
}
