//! Franka's FCI: the TCP stream of requests and replies, and the UDP datagrams of states and
//! commands.

use tangent_franka::fci::{Framer, Reply, Request, RobotCommand, RobotState};

/// Splits the bytes into messages, and decodes each as a request and as a reply. A decoded message
/// is encoded and decoded again, and must stay equal.
pub fn fci_stream(data: &[u8]) {
    let mut framer = Framer::new();
    for piece in data.chunks(113) {
        framer.push(piece);
        while let Ok(Some(message)) = framer.next_message() {
            let mut bytes = Vec::new();
            if let Ok(request) = Request::decode(&message) {
                request.encode(message.id, &mut bytes);
                assert_eq!(
                    show(&request),
                    again(&bytes, |m| Request::decode(m).map(|r| show(&r)).ok())
                );
            }
            bytes.clear();
            if let Ok(reply) = Reply::decode(&message) {
                reply.encode(&mut bytes);
                assert_eq!(
                    show(&reply),
                    again(&bytes, |m| Reply::decode(m).map(|r| show(&r)).ok())
                );
            }
        }
    }
}

// Compared as text, since numbers may be NaN.
fn show(value: &impl std::fmt::Debug) -> String {
    format!("{value:?}")
}

fn again(
    bytes: &[u8],
    read: impl Fn(&tangent_franka::fci::Message<'_>) -> Option<String>,
) -> String {
    let mut framer = Framer::new();
    framer.push(bytes);
    let message = framer
        .next_message()
        .expect("a message that was just written has a size")
        .expect("a message that was just written is whole");
    read(&message).expect("what was just written can be read")
}

/// Decodes a state or a command; a decoded message must encode to the same bytes.
pub fn fci_datagrams(data: &[u8]) {
    let mut bytes = Vec::new();
    if let Ok(state) = RobotState::decode(data) {
        let _ = (
            state.mode(),
            state.motion_mode(),
            state.controller(),
            state.is_usable(),
        );
        state.encode(&mut bytes);
        let again = RobotState::decode(&bytes).expect("what was just written can be read");
        assert_eq!(show(&again), show(&state));
    }
    bytes.clear();
    if let Ok(command) = RobotCommand::decode(data) {
        let _ = command.is_finite();
        command.encode(&mut bytes);
        let again = RobotCommand::decode(&bytes).expect("what was just written can be read");
        assert_eq!(show(&again), show(&command));
    }
}
