//! Requests and answers: somebody asks on a key, the service behind it says done, or why not.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_schemas::tangent::{Answer, Request};
use zenoh::key_expr::OwnedKeyExpr;

use super::budget::Budget;

/// It was done.
pub fn done(message: impl Into<String>) -> Answer {
    Answer {
        done: true,
        message: message.into(),
        data: String::new(),
    }
}

/// It was done, and this came of it, as JSON.
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

/// It was not done, and why.
pub fn refused(reason: impl Into<String>) -> Answer {
    Answer {
        done: false,
        message: reason.into(),
        data: String::new(),
    }
}

/// A request as a service gets it.
#[derive(Clone, Debug)]
pub struct Asked {
    /// Key that was asked.
    pub key: String,
    /// What is asked.
    pub request: Request,
    /// When it came to this process.
    pub received: Instant,
    /// Nothing may be begun for it after this.
    pub deadline: Instant,
}

impl Asked {
    /// A request of this process's own, whose asker waits for `patience`.
    pub fn now(key: &str, request: &Request, patience: Duration) -> Self {
        let received = Instant::now();
        Self {
            key: key.to_owned(),
            request: request.clone(),
            received,
            deadline: Budget::within(patience).deadline(received),
        }
    }

    /// The refusal of a request whose time is up.
    pub fn late(&self) -> Option<Answer> {
        let over = Instant::now().checked_duration_since(self.deadline)?;
        Some(refused(format!(
            "the request came or waited too long, by {:.2} s: nothing was done, ask again",
            over.as_secs_f64()
        )))
    }
}

/// What a service says to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// Done, or refused without an effect.
    Answered(Answer),
    /// Whether it was done is not known, and why: a device did not answer, for
    /// instance.
    Unknown(String),
}

impl From<Answer> for Reply {
    fn from(answer: Answer) -> Self {
        Self::Answered(answer)
    }
}

pub(crate) type Handler = Arc<dyn Fn(Asked) -> Reply + Send + Sync>;

/// Says at once why a request is refused; none where it may be carried out.
pub(crate) type Judge = Arc<dyn Fn(&Asked) -> Option<Answer> + Send + Sync>;

/// The key an answer goes out under: the one asked, or for a question to many the answerer's own.
pub(super) fn reply_key(asked: &str, pattern: &OwnedKeyExpr) -> String {
    if asked.contains('*') {
        pattern.to_string()
    } else {
        asked.to_owned()
    }
}
