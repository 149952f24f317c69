//! Reads a network card's interrupt delay over the kernel's generic netlink family `ethtool`: the
//! value that `ethtool -c` shows. It needs no privilege and no system call of our own.

use std::os::fd::{AsRawFd, OwnedFd};

use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, sendto,
    setsockopt, socket, sockopt,
};
use nix::sys::time::{TimeVal, TimeValLike};

/// Numbers of `linux/genetlink.h` and `linux/ethtool_netlink.h`.
mod number {
    pub const NLM_F_REQUEST: u16 = 1;
    pub const NLMSG_ERROR: u16 = 2;
    pub const GENL_ID_CTRL: u16 = 16;
    pub const CTRL_CMD_GETFAMILY: u8 = 3;
    pub const CTRL_ATTR_FAMILY_ID: u16 = 1;
    pub const CTRL_ATTR_FAMILY_NAME: u16 = 2;
    pub const ETHTOOL_MSG_COALESCE_GET: u8 = 19;
    pub const ETHTOOL_A_COALESCE_HEADER: u16 = 1;
    pub const ETHTOOL_A_COALESCE_RX_USECS: u16 = 2;
    pub const ETHTOOL_A_HEADER_DEV_NAME: u16 = 2;
    /// Flag: the attribute contains attributes.
    pub const NLA_F_NESTED: u16 = 0x8000;
    pub const NLA_TYPE_MASK: u16 = 0x3fff;
}
use number::*;

/// Length of the netlink header and the generic netlink header after it, bytes.
const HEADERS: usize = 16 + 4;

/// Time that a card waits for more packets before it interrupts, µs; `None` if it does not report
/// one.
pub fn receive_delay_us(card: &str) -> Option<u32> {
    let socket = open().ok()?;
    let mut name = b"ethtool".to_vec();
    name.push(0);
    let request = attribute(CTRL_ATTR_FAMILY_NAME, &name);
    let answer = ask(&socket, GENL_ID_CTRL, CTRL_CMD_GETFAMILY, &request)?;
    let family = find(&answer, CTRL_ATTR_FAMILY_ID)?;
    let family = u16::from_ne_bytes(family.get(..2)?.try_into().ok()?);

    let mut name = card.as_bytes().to_vec();
    name.push(0);
    let header = attribute(ETHTOOL_A_HEADER_DEV_NAME, &name);
    let request = attribute(ETHTOOL_A_COALESCE_HEADER | NLA_F_NESTED, &header);
    let answer = ask(&socket, family, ETHTOOL_MSG_COALESCE_GET, &request)?;
    let delay = find(&answer, ETHTOOL_A_COALESCE_RX_USECS)?;
    Some(u32::from_ne_bytes(delay.get(..4)?.try_into().ok()?))
}

fn open() -> nix::Result<OwnedFd> {
    let socket = socket(
        AddressFamily::Netlink,
        SockType::Raw,
        SockFlag::SOCK_CLOEXEC,
        SockProtocol::NetlinkGeneric,
    )?;
    bind(socket.as_raw_fd(), &NetlinkAddr::new(0, 0))?;
    setsockopt(&socket, sockopt::ReceiveTimeout, &TimeVal::seconds(1))?;
    Ok(socket)
}

/// Sends one request and returns the attributes of its answer; `None` if the kernel refuses.
fn ask(socket: &OwnedFd, family: u16, command: u8, attributes: &[u8]) -> Option<Vec<u8>> {
    let message = message(family, command, attributes);
    let kernel = NetlinkAddr::new(0, 0);
    sendto(socket.as_raw_fd(), &message, &kernel, MsgFlags::empty()).ok()?;
    let mut answer = vec![0; 16 * 1024];
    let length = recv(socket.as_raw_fd(), &mut answer, MsgFlags::empty()).ok()?;
    answer.truncate(length);
    payload(&answer).map(<[u8]>::to_vec)
}

fn message(family: u16, command: u8, attributes: &[u8]) -> Vec<u8> {
    let length = (HEADERS + attributes.len()) as u32;
    let mut message = Vec::with_capacity(HEADERS + attributes.len());
    message.extend_from_slice(&length.to_ne_bytes());
    message.extend_from_slice(&family.to_ne_bytes());
    message.extend_from_slice(&NLM_F_REQUEST.to_ne_bytes());
    // Sequence number and port id, both 0: one request at a time, and the kernel assigns the port
    // id.
    message.extend_from_slice(&[0; 8]);
    message.extend_from_slice(&[command, 1, 0, 0]);
    message.extend_from_slice(attributes);
    message
}

/// Returns the attributes of the first message; `None` for an error message.
fn payload(bytes: &[u8]) -> Option<&[u8]> {
    let length = u32::from_ne_bytes(bytes.get(..4)?.try_into().ok()?) as usize;
    let kind = u16::from_ne_bytes(bytes.get(4..6)?.try_into().ok()?);
    if kind == NLMSG_ERROR {
        return None;
    }
    bytes.get(HEADERS..length.min(bytes.len()))
}

/// Encodes an attribute: length, type, value, and zeros up to a multiple of four bytes.
fn attribute(kind: u16, value: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 + value.len() + 3);
    bytes.extend_from_slice(&((4 + value.len()) as u16).to_ne_bytes());
    bytes.extend_from_slice(&kind.to_ne_bytes());
    bytes.extend_from_slice(value);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// Returns the value of the first attribute of a kind.
fn find(mut attributes: &[u8], wanted: u16) -> Option<&[u8]> {
    while attributes.len() >= 4 {
        let length = usize::from(u16::from_ne_bytes([attributes[0], attributes[1]]));
        let kind = u16::from_ne_bytes([attributes[2], attributes[3]]) & NLA_TYPE_MASK;
        let value = attributes.get(4..length)?;
        if kind == wanted {
            return Some(value);
        }
        attributes = attributes.get(length.next_multiple_of(4)..)?;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn attributes_are_found_again() {
        let mut bytes = attribute(7, b"abcde");
        bytes.extend(attribute(2 | NLA_F_NESTED, &[9, 8]));
        assert_eq!(bytes.len(), 12 + 8);
        assert_eq!(find(&bytes, 7), Some(&b"abcde"[..]));
        assert_eq!(find(&bytes, 2), Some(&[9, 8][..]));
        assert_eq!(find(&bytes, 3), None);
    }

    #[test]
    fn the_kernel_knows_the_family_and_loopback_has_no_delay() {
        let Ok(socket) = open() else {
            eprintln!("skipped, because netlink sockets are not allowed here");
            return;
        };
        let request = attribute(CTRL_ATTR_FAMILY_NAME, b"nlctrl\0");
        let answer = ask(&socket, GENL_ID_CTRL, CTRL_CMD_GETFAMILY, &request).unwrap();
        assert_eq!(
            find(&answer, CTRL_ATTR_FAMILY_ID),
            Some(&GENL_ID_CTRL.to_ne_bytes()[..])
        );
        assert_eq!(receive_delay_us("lo"), None);
        assert_eq!(receive_delay_us("no such card"), None);
    }

    proptest! {
        #[test]
        fn whatever_comes_nothing_is_read_beyond_its_end(bytes in prop::collection::vec(any::<u8>(), 0..200), kind in any::<u16>()) {
            if let Some(attributes) = payload(&bytes) {
                find(attributes, kind);
            }
            find(&bytes, kind);
        }
    }
}
