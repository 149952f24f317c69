//! Queries a robot over FCI: the handshake and some of its states. It sets nothing, starts no
//! motion and answers no state, so the arm is not affected. For `tangent doctor`. A robot accepts
//! one client at a time: while a bridge runs, it closes the connection.

use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use crate::fci::{CodecError, ErrorFlags, FrameError, Reply, RobotMode, RobotState};
use crate::link::{Link, LinkError, is_nothing_yet};
use crate::session::{Session, SessionError};

/// State of a robot, and the quality of its state stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Mode in the last state.
    pub mode: RobotMode,
    /// Errors present now, or those that caused the present reflex.
    pub errors: ErrorFlags,
    /// Mass of the end effector as set at the robot (Desk), kg.
    pub end_effector_kg: f64,
    /// Number of states that the robot sent from the first to the last one received, by its own
    /// counter.
    pub states: u64,
    /// Number of those that never arrived.
    pub lost: u64,
    /// Number of those that arrived together with a newer one; a loop would have skipped them.
    pub late: u64,
    /// Longest time between two received states, s.
    pub pause_max_s: f64,
}

impl Found {
    fn first(state: &RobotState) -> Self {
        let mut found = Self {
            mode: state.mode(),
            errors: ErrorFlags::default(),
            end_effector_kg: state.m_ee,
            states: 1,
            lost: 0,
            late: 0,
            pause_max_s: 0.0,
        };
        found.says(state);
        found
    }

    fn says(&mut self, state: &RobotState) {
        self.mode = state.mode();
        self.errors = if self.mode == RobotMode::Reflex && state.errors.is_empty() {
            state.reflex_reason
        } else {
            state.errors
        };
    }

    /// Takes a state received `pause_s` after the previous one, which had number `before`;
    /// `skipped` others arrived with it.
    fn take(&mut self, state: &RobotState, before: u64, skipped: u64, pause_s: f64) {
        self.says(state);
        let since = state.message_id.saturating_sub(before);
        self.states += since;
        self.late += skipped;
        self.lost += since.saturating_sub(1 + skipped);
        self.pause_max_s = self.pause_max_s.max(pause_s);
    }

    /// Share of the states that did not arrive in time, 0 to 1.
    pub fn missed_share(&self) -> f64 {
        (self.lost + self.late) as f64 / self.states.max(1) as f64
    }
}

/// Why a robot could not be queried.
#[derive(Debug, thiserror::Error)]
pub enum InquiryError {
    /// The robot cannot be reached, or the connection broke.
    #[error("{0}")]
    Io(std::io::Error),
    /// The robot closes the connection.
    #[error("the robot closes the connection")]
    Closed,
    /// The robot accepts the connection but sends nothing for this time, s.
    #[error("the robot accepts the connection, but has sent no state for {0:.1} s")]
    Silent(f64),
    /// The robot uses another version, or sends an unexpected reply.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The reply is not FCI.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The reply is not FCI.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

impl From<std::io::Error> for InquiryError {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => Self::Closed,
            _ => Self::Io(error),
        }
    }
}

impl From<LinkError> for InquiryError {
    fn from(error: LinkError) -> Self {
        match error {
            LinkError::Io(error) => error.into(),
            LinkError::Codec(error) => error.into(),
        }
    }
}

/// Connects and receives the robot's states for `listen` from the first one on. `timeout` applies
/// to the connection, to each reply and to the states.
///
/// # Errors
/// [`InquiryError`]: no answer, another client connected, another version, no states.
pub fn inquire(
    host: &str,
    port: u16,
    timeout: Duration,
    listen: Duration,
) -> Result<Found, InquiryError> {
    let mut link = Link::connect(host, port, timeout)?;
    let mut session = Session::new(Vec::new());
    let begin = Instant::now();
    let mut out = Vec::new();
    session.open(link.udp.local_addr()?.port(), 0.0, &mut out);
    link.tcp.set_nonblocking(false)?;
    link.tcp.write_all(&out)?;
    link.tcp.set_nonblocking(true)?;
    let mut heard = begin;
    let mut first = None;
    let mut found: Option<(Found, u64)> = None;
    loop {
        if let Some((state, skipped)) = link.receive()? {
            let now = Instant::now();
            match &mut found {
                Some((found, before)) if state.message_id > *before => {
                    let pause_s = now.duration_since(heard).as_secs_f64();
                    found.take(&state, *before, skipped, pause_s);
                    *before = state.message_id;
                }
                Some(_) => {}
                None => {
                    found = Some((Found::first(&state), state.message_id));
                    first = Some(now);
                }
            }
            heard = now;
        }
        hear_replies(&mut link, &mut session, begin)?;
        if let Some((found, _)) = found
            && session.is_connected()
            && first.is_some_and(|first| first.elapsed() >= listen)
        {
            return Ok(found);
        }
        if heard.elapsed() > timeout || (!session.is_connected() && begin.elapsed() > timeout) {
            return Err(InquiryError::Silent(timeout.as_secs_f64()));
        }
    }
}

fn hear_replies(
    link: &mut Link,
    session: &mut Session,
    begin: Instant,
) -> Result<(), InquiryError> {
    let mut bytes = [0; 1024];
    match link.tcp.read(&mut bytes) {
        Ok(0) => return Err(InquiryError::Closed),
        Ok(n) => link.framer.push(&bytes[..n]),
        Err(error) if is_nothing_yet(&error) => return Ok(()),
        Err(error) => return Err(error.into()),
    }
    while let Some(message) = link.framer.next_message()? {
        session.reply(&Reply::decode(&message)?, begin.elapsed().as_secs_f64())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(message_id: u64, mode: RobotMode) -> RobotState {
        RobotState {
            message_id,
            robot_mode: mode as u8,
            ..RobotState::default()
        }
    }

    #[test]
    fn lost_and_late_states_are_distinguished() {
        let mut found = Found::first(&state(100, RobotMode::Idle));
        found.take(&state(101, RobotMode::Idle), 100, 0, 0.001);
        // Three states in between: one arrived late, two never arrived.
        found.take(&state(105, RobotMode::Idle), 101, 1, 0.004);
        assert_eq!((found.states, found.lost, found.late), (6, 2, 1));
        assert_eq!(found.pause_max_s, 0.004);
        assert_eq!(found.missed_share(), 0.5);
    }

    #[test]
    fn a_reflex_reports_its_cause() {
        let mut reflex = state(1, RobotMode::Reflex);
        reflex.reflex_reason = ErrorFlags::only(ErrorFlags::JOINT_REFLEX);
        assert_eq!(Found::first(&reflex).errors.to_string(), "joint_reflex");
        reflex.robot_mode = RobotMode::Idle as u8;
        assert!(Found::first(&reflex).errors.is_empty());
    }
}
