//! Lanes of requests from other processes: a slow request of one service does not delay others, and
//! nothing holds up a stop.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Instant;

use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::{Message, cdr};
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::query::Query;

use super::answer::{Asked, Handler, Judge, Reply, reply_key};
use super::budget::{BUDGET_UNNAMED, Budget};
use super::replies;
use crate::realtime::setup_thread;

/// Requests that may wait in one lane; further ones are refused.
const WAITING_MAX: usize = 64;

/// Selects the thread in which a request from another process is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Answered at once without waiting for anything: one thread for all keys of the process.
    Prompt,
    /// May wait for a device, the loop or another service: a thread for this key alone.
    Slow,
    /// Brings the arm to rest, or judges whether a request is allowed: a thread for this key alone,
    /// with the bus's real-time priority. Waits for the loop at most.
    Urgent,
}

/// The lane of each request of a key.
pub(super) type LaneOf = Arc<dyn Fn(&Request) -> Lane + Send + Sync>;

/// A request from another process on its way to a lane.
pub(super) struct Job {
    query: Query,
    pattern: OwnedKeyExpr,
    handler: Handler,
    request: Request,
    received: Instant,
    deadline: Instant,
    /// Set for a request that must be judged first: the judge, and the lane for an allowed request.
    judged: Option<(Judge, Jobs)>,
}

/// Sends jobs to the thread of one lane. The thread ends when the last of these senders is dropped.
pub(super) type Jobs = SyncSender<Job>;

/// Starts the thread of a lane, with real-time priority `priority` if there is one.
pub(super) fn start(name: &str, priority: Option<u8>) -> Jobs {
    let (sender, receiver) = sync_channel(WAITING_MAX);
    let role = name.to_owned();
    let spawned = std::thread::Builder::new()
        .name(name.into())
        .spawn(move || {
            if let Some(priority) = priority {
                setup_thread(&role, priority);
            }
            answer_all(&receiver);
        });
    if let Err(error) = spawned {
        tracing::error!("no answering thread ({error}): requests are refused");
    }
    sender
}

/// Routes the requests of one key into the lanes.
pub(super) struct Entrance {
    pub pattern: OwnedKeyExpr,
    pub handler: Handler,
    pub lane: LaneOf,
    /// Judges each request in the urgent lane before it goes to its own.
    pub judge: Option<Judge>,
    pub prompt: Jobs,
    pub slow: std::sync::OnceLock<Jobs>,
    pub urgent: std::sync::OnceLock<Jobs>,
    pub priority: Option<u8>,
}

impl Entrance {
    /// Accepts one query or refuses it. Runs in Zenoh's thread, so it never waits.
    pub fn take(&self, query: Query) {
        let received = Instant::now();
        let payload = query.payload().map(|payload| payload.to_bytes());
        let request = match cdr::decode::<Request>(payload.as_deref().unwrap_or_default()) {
            Ok(request) => request,
            Err(error) => {
                let reason = format!("the request cannot be read as {}: {error}", Request::NAME);
                return self.refuse(&query, reason);
            }
        };
        drop(payload);
        let budget = query
            .attachment()
            .map_or(Ok(None), |bytes| Budget::from_bytes(&bytes.to_bytes()));
        let budget = match budget {
            Ok(budget) => budget,
            Err(error) => return self.refuse(&query, format!("{error}: nothing was done")),
        };
        let deadline = budget.map_or(received + BUDGET_UNNAMED, |b| b.deadline(received));
        let lane = self.jobs((self.lane)(&request));
        let judged = self.judge.clone().map(|judge| (judge, lane.clone()));
        let jobs = match judged {
            Some(_) => self.jobs(Lane::Urgent),
            None => lane,
        };
        hand_on(
            jobs,
            Job {
                query,
                pattern: self.pattern.clone(),
                handler: Arc::clone(&self.handler),
                request,
                received,
                deadline,
                judged,
            },
        );
    }

    fn jobs(&self, lane: Lane) -> &Jobs {
        match lane {
            Lane::Prompt => &self.prompt,
            Lane::Slow => self.slow.get_or_init(|| start("bus-slow", None)),
            Lane::Urgent => self
                .urgent
                .get_or_init(|| start("bus-urgent", self.priority)),
        }
    }

    fn refuse(&self, query: &Query, reason: String) {
        refuse(query, &self.pattern, reason);
    }
}

/// Puts a job into a lane, or refuses it if the lane is full. Never waits.
fn hand_on(jobs: &Jobs, job: Job) {
    match jobs.try_send(job) {
        Ok(()) => {}
        Err(TrySendError::Full(job)) => {
            let reason = format!(
                "{WAITING_MAX} requests already wait on {}: nothing was done, send it again",
                job.pattern
            );
            refuse(&job.query, &job.pattern, reason);
        }
        Err(TrySendError::Disconnected(job)) => {
            let reason = "the service has no answering thread".to_owned();
            refuse(&job.query, &job.pattern, reason);
        }
    }
}

fn refuse(query: &Query, pattern: &OwnedKeyExpr, reason: String) {
    tracing::warn!("{pattern}: {reason}");
    let reply = super::answer::refused(reason).into();
    send(query, pattern, &reply, &mut Vec::new());
}

fn answer_all(jobs: &Receiver<Job>) {
    let mut scratch = Vec::new();
    for mut job in jobs {
        let asked = Asked {
            key: job.query.key_expr().to_string(),
            request: std::mem::take(&mut job.request),
            received: job.received,
            deadline: job.deadline,
        };
        let reply = match (asked.late(), job.judged.take()) {
            (Some(answer), _) => answer.into(),
            (None, None) => (job.handler)(asked),
            (None, Some((judge, lane))) => match judge(&asked) {
                Some(answer) => answer.into(),
                None => {
                    job.request = asked.request;
                    hand_on(&lane, job);
                    continue;
                }
            },
        };
        send(&job.query, &job.pattern, &reply, &mut scratch);
    }
}

fn send(query: &Query, pattern: &OwnedKeyExpr, reply: &Reply, scratch: &mut Vec<u8>) {
    let key = reply_key(query.key_expr().as_str(), pattern);
    match reply {
        Reply::Answered(answer) => match cdr::encode::<Answer>(answer, scratch) {
            Ok(()) => replies::reply(query, &key, scratch),
            Err(error) => tracing::warn!("{key}: an answer cannot be encoded: {error}"),
        },
        Reply::Unknown(reason) => replies::reply_unknown(query, &key, reason),
    }
}
