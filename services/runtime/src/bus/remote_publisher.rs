//! A publisher of the Zenoh session: sends one topic to other processes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use zenoh::Wait;

use super::attachment::Attachment;

/// A declared publisher, and whether any other process reads it.
pub(crate) struct RemotePublisher {
    publisher: zenoh::pubsub::Publisher<'static>,
    matching: Arc<AtomicBool>,
    /// Receives questions for recent messages, which are kept for that purpose.
    questions: Option<zenoh::query::Queryable<()>>,
    message_max: usize,
    /// Whether a message was too large; the warning is logged once.
    too_large: AtomicBool,
}

impl RemotePublisher {
    /// `matching` is kept up to date with whether any process reads the topic. Messages of
    /// `message_max` bytes or more are not sent.
    pub(crate) fn new(
        publisher: zenoh::pubsub::Publisher<'static>,
        matching: Arc<AtomicBool>,
        questions: Option<zenoh::query::Queryable<()>>,
        message_max: usize,
    ) -> Self {
        Self {
            publisher,
            matching,
            questions,
            message_max,
            too_large: AtomicBool::new(false),
        }
    }

    pub(crate) fn matches(&self) -> bool {
        self.matching.load(Ordering::Acquire)
    }

    /// Whether its messages are to be kept.
    pub(crate) fn keeps(&self) -> bool {
        self.questions.is_some()
    }

    pub(crate) fn put(&self, payload: &[u8], attachment: Attachment) {
        if payload.len() >= self.message_max {
            if !self.too_large.swap(true, Ordering::Relaxed) {
                tracing::warn!(
                    "{}: a message of {:.1} MB is not sent, since it would be rejected: zenoh.message_max_mb is {:.1} (logged once)",
                    self.publisher.key_expr(),
                    payload.len() as f64 * 1e-6,
                    self.message_max as f64 * 1e-6
                );
            }
            return;
        }
        let result = self
            .publisher
            .put(payload)
            .attachment(attachment.to_bytes())
            .wait();
        if let Err(error) = result {
            // The session is closed; readers notice the silence.
            tracing::debug!("{}: {error}", self.publisher.key_expr());
        }
    }
}
