//! Requests and answers: a client sends a request on a key, and the service answers that it is
//! done, or why not.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_schemas::tangent::{Answer, Request};
use zenoh::key_expr::OwnedKeyExpr;

use super::budget::Budget;

/// Answer to a request that was carried out.
pub fn done(message: impl Into<String>) -> Answer {
    Answer {
        done: true,
        message: message.into(),
        data: String::new(),
    }
}

/// Answer to a request that was carried out, with its result as JSON.
pub fn done_with<T: Serialize + ?Sized>(message: impl Into<String>, data: &T) -> Answer {
    match serde_json::to_string(data) {
        Ok(data) => Answer {
            done: true,
            message: message.into(),
            data,
        },
        Err(error) => refused(format!("the answer cannot be written as JSON: {error}")),
    }
}

/// Answer to a request that was not carried out, with the reason.
pub fn refused(reason: impl Into<String>) -> Answer {
    Answer {
        done: false,
        message: reason.into(),
        data: String::new(),
    }
}

/// A request as a service receives it.
#[derive(Clone, Debug)]
pub struct Asked {
    /// Key to which the request was sent.
    pub key: String,
    /// The request itself.
    pub request: Request,
    /// Time of arrival in this process.
    pub received: Instant,
    /// No work for the request may begin after this time.
    pub deadline: Instant,
}

impl Asked {
    /// A request from this process itself, whose sender waits for `patience`.
    pub fn now(key: &str, request: &Request, patience: Duration) -> Self {
        let received = Instant::now();
        Self {
            key: key.to_owned(),
            request: request.clone(),
            received,
            deadline: Budget::within(patience).deadline(received),
        }
    }

    /// The refusal of a request whose deadline has passed; `None` before that.
    pub fn late(&self) -> Option<Answer> {
        let over = Instant::now().checked_duration_since(self.deadline)?;
        Some(refused(format!(
            "the request's budget was exceeded by {:.2} s: nothing was done, send it again",
            over.as_secs_f64()
        )))
    }
}

/// Outcome of a request, as the service reports it.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// Done, or refused without any effect.
    Answered(Answer),
    /// It is not known whether the request was carried out; with the reason, for instance a device
    /// that did not answer.
    Unknown(String),
}

impl From<Answer> for Reply {
    fn from(answer: Answer) -> Self {
        Self::Answered(answer)
    }
}

pub(crate) type Handler = Arc<dyn Fn(Asked) -> Reply + Send + Sync>;

/// Returns the reason for refusing a request, without waiting; `None` if it may be carried out.
pub(crate) type Judge = Arc<dyn Fn(&Asked) -> Option<Answer> + Send + Sync>;

/// Key of the answer: the requested key, or the answering service's own if the request has
/// wildcards.
pub(super) fn reply_key(asked: &str, pattern: &OwnedKeyExpr) -> String {
    if asked.contains('*') {
        pattern.to_string()
    } else {
        asked.to_owned()
    }
}
