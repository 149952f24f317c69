//! Answers to queries, received from other processes and sent by this one.

use std::time::Duration;

use tangent_schemas::{Message, tangent};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::handlers::FifoChannelHandler;
use zenoh::query::{Query, Reply};

/// Answer of a service that does not know whether a request was carried out, with the reason.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UnknownOutcome(pub String);

/// Answers from other processes.
pub(crate) struct Replies {
    replies: FifoChannelHandler<Reply>,
}

impl Replies {
    pub(crate) fn new(replies: FifoChannelHandler<Reply>) -> Self {
        Self { replies }
    }

    /// Key and payload of the next answer; `None` if there are no more, or none in time.
    pub(crate) fn recv_timeout(
        &self,
        timeout: Duration,
    ) -> Option<Result<(String, Vec<u8>), UnknownOutcome>> {
        let reply = self.replies.recv_timeout(timeout).ok()??;
        match reply.into_result() {
            Ok(sample) => Some(Ok((
                sample.key_expr().to_string(),
                sample.payload().to_bytes().into_owned(),
            ))),
            Err(error) => {
                let reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                // Zenoh produces this text itself for a missing answer.
                (reason != TIMEOUT).then_some(Err(UnknownOutcome(reason)))
            }
        }
    }
}

/// Text of the answer that Zenoh produces when a query times out.
const TIMEOUT: &str = "Timeout";

/// Answers that it is not known whether the request was carried out, and why.
pub(crate) fn reply_unknown(query: &Query, key: &str, reason: &str) {
    let result = query
        .reply_err(reason.as_bytes())
        .encoding(Encoding::ZENOH_STRING)
        .wait();
    if let Err(error) = result {
        tracing::warn!("{key}: an answer could not be sent: {error}");
    }
}

/// Sends one answer.
pub(crate) fn reply(query: &Query, key: &str, payload: &[u8]) {
    let result = query
        .reply(key, payload)
        .encoding(Encoding::APPLICATION_CDR.with_schema(tangent::Answer::NAME))
        .wait();
    if let Err(error) = result {
        tracing::warn!("{key}: an answer could not be sent: {error}");
    }
}

/// Sends a batch of messages again.
pub(crate) fn reply_batch(query: &Query, key: &str, payload: &[u8]) {
    if let Err(error) = query.reply(key, payload).wait() {
        tracing::debug!("{key}: an answer could not be sent: {error}");
    }
}
