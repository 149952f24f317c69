//! Asks a controller for its software version over RTDE. It sets up no recipe, so that no register
//! is claimed and a running bridge is not disturbed. For `tangent doctor`.

use std::io::{Error, ErrorKind, Read, Result, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::codec::{ControllerVersion, Framer, PACKAGE_BYTES_MAX, Protocol, Reply, Request};
use crate::robot_setup::resolve;

/// Version of the controller's software.
///
/// # Errors
/// The controller cannot be reached, does not answer within `timeout` (per step), or sends
/// something other than RTDE.
pub fn controller_version(host: &str, port: u16, timeout: Duration) -> Result<ControllerVersion> {
    let mut stream = TcpStream::connect_timeout(&resolve(host, port)?, timeout)?;
    stream.set_read_timeout(Some(timeout))?;
    stream.set_write_timeout(Some(timeout))?;
    let mut framer = Framer::new(PACKAGE_BYTES_MAX);
    let wanted = Request::ProtocolVersion(Protocol::V2.number());
    // An old controller refuses version 2; the question after it is the same in both.
    exchange(&mut stream, &mut framer, &wanted, timeout, |reply| {
        matches!(reply, Reply::ProtocolVersion { .. }).then_some(())
    })?;
    let wanted = Request::ControllerVersion;
    exchange(
        &mut stream,
        &mut framer,
        &wanted,
        timeout,
        |reply| match reply {
            Reply::ControllerVersion(version) => Some(*version),
            _ => None,
        },
    )
}

fn exchange<T>(
    stream: &mut TcpStream,
    framer: &mut Framer,
    request: &Request<'_>,
    timeout: Duration,
    pick: impl Fn(&Reply<'_>) -> Option<T>,
) -> Result<T> {
    let strange =
        |error: &dyn std::fmt::Display| Error::new(ErrorKind::InvalidData, error.to_string());
    let mut out = Vec::new();
    request
        .encode(Protocol::V2, &mut out)
        .map_err(|e| strange(&e))?;
    stream.write_all(&out)?;
    let until = Instant::now() + timeout;
    loop {
        while let Some(package) = framer.next_package().map_err(|e| strange(&e))? {
            let reply = Reply::decode(package.kind, package.payload, Protocol::V2)
                .map_err(|e| strange(&e))?;
            if let Some(found) = pick(&reply) {
                return Ok(found);
            }
        }
        if Instant::now() >= until {
            return Err(Error::new(ErrorKind::TimedOut, "no answer in RTDE"));
        }
        match stream.read(framer.space())? {
            0 => return Err(Error::new(ErrorKind::UnexpectedEof, "closed by the robot")),
            n => framer.filled(n),
        }
    }
}
