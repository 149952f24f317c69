//! Requests to guide the arm by hand, `rtde/guide`: begin, keep, end. The loop answers each in the
//! cycle in which it takes it, so that the outcome is known.

use std::sync::{Arc, Mutex, PoisonError};

use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::{Asked, Bus, BusError, Handle, Lane};
use tangent_schemas::tangent::Answer;

use crate::guide_mailbox::{Guide, GuideMailbox, Outcome};
use crate::guiding::KEEP_ALIVE_S;
use crate::queries;
use crate::shared::Shared;

/// Starts to answer requests.
pub(crate) fn answers(bus: &Bus, shared: &Arc<Shared>) -> Result<Handle, BusError> {
    let shared = Arc::clone(shared);
    // Name of the client that guides; requests are answered one after another.
    let guide = Mutex::new(String::new());
    bus.answer_in(
        queries::GUIDE,
        |_| Lane::Slow,
        move |asked| {
            let mut guide = guide.lock().unwrap_or_else(PoisonError::into_inner);
            answer(&asked, &shared.guide, &mut guide).into()
        },
    )
}

fn answer(asked: &Asked, mailbox: &GuideMailbox, guide: &mut String) -> Answer {
    let name = asked.request.argument.as_str();
    if name.is_empty() || name.len() > 64 {
        return refused("name the client that guides the arm, in 1 to 64 bytes, as the argument");
    }
    let request = match asked.request.action.as_str() {
        "begin" => Guide::Begin,
        "keep" => Guide::Keep,
        "end" => Guide::End,
        other => return refused(format!("unknown action `{other}`: begin, keep or end")),
    };
    // Any client may end it. Only the one that began may keep it; another one waits for its end.
    if !guide.is_empty() && guide != name && request != Guide::End {
        match mailbox.ask(Guide::Look) {
            Some(Outcome::Done) => return refused(format!("{guide} guides the arm")),
            _ => guide.clear(),
        }
    }
    match mailbox.ask(request) {
        None => refused("no packet from the robot: is the bridge connected to it?"),
        Some(Outcome::Refused(refusal)) => refused(refusal.to_string()),
        Some(Outcome::Ended(why)) => {
            guide.clear();
            refused(format!("the arm is not guided any more: {}", why.text()))
        }
        Some(Outcome::Done) if request == Guide::End => {
            guide.clear();
            done("the arm holds itself")
        }
        Some(Outcome::Done) => {
            name.clone_into(guide);
            done(format!(
                "a hand can guide the arm; without `keep` it holds itself again after {KEEP_ALIVE_S} s"
            ))
        }
    }
}
