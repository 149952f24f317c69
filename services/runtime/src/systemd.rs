//! Notifications to systemd: ready, alive, stopping. The unit needs `Type=notify` and
//! `WatchdogSec=`.
//!
//! The protocol is systemd's: one datagram of `KEY=value` lines to the socket named by
//! `NOTIFY_SOCKET`, where a leading `@` stands for an abstract socket; see sd_notify(3). Nothing is
//! sent if that variable is not set.

use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// Socket to the process's supervisor.
pub struct Notify {
    socket: UnixDatagram,
    to: SocketAddr,
    watchdog: Option<Duration>,
}

impl Notify {
    /// Socket named in the environment; `None` if there is no supervisor.
    pub fn from_environment() -> Option<Self> {
        let own = std::process::id().to_string();
        let named = |name| std::env::var(name).ok();
        // The variable may be inherited, and meant for another process.
        let ours = named("WATCHDOG_PID").is_none_or(|pid| pid == own);
        let period = named("WATCHDOG_USEC")
            .filter(|_| ours)
            .and_then(|text| text.parse::<u64>().ok())
            .filter(|us| *us > 0)
            .map(Duration::from_micros);
        Self::to(&named("NOTIFY_SOCKET")?, period)
            .inspect_err(|error| tracing::warn!("NOTIFY_SOCKET cannot be used: {error}"))
            .ok()
    }

    /// Socket of this name. `watchdog` is the silence after which systemd assumes a failure.
    ///
    /// # Errors
    /// The name is not valid, or the socket cannot be opened.
    pub fn to(name: &str, watchdog: Option<Duration>) -> io::Result<Self> {
        let to = match name.strip_prefix('@') {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(name)?,
        };
        let socket = UnixDatagram::unbound()?;
        // A supervisor that does not read must not block this process.
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            to,
            watchdog,
        })
    }

    /// Notifies that the services run.
    pub fn ready(&self) {
        self.say("READY=1");
    }

    /// Notifies that the process is about to end in order.
    pub fn stopping(&self) {
        self.say("STOPPING=1");
    }

    /// Notifies that every loop is running.
    pub fn alive(&self) {
        if self.watchdog.is_some() {
            self.say("WATCHDOG=1");
        }
    }

    /// Notifies that a loop has stopped running; `systemctl status` shows the text.
    pub fn failed(&self, words: &str) {
        self.say(&format!("STATUS={words}"));
    }

    /// Silence after which systemd assumes a failure; `None` if the unit sets none.
    pub fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    fn say(&self, text: &str) {
        if let Err(error) = self.socket.send_to_addr(text.as_bytes(), &self.to) {
            tracing::debug!("systemd could not be notified: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(socket: &UnixDatagram) -> String {
        let mut bytes = [0; 256];
        socket
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        let length = socket.recv(&mut bytes).unwrap();
        String::from_utf8(bytes[..length].to_vec()).unwrap()
    }

    #[test]
    fn each_word_is_one_datagram_to_a_file_or_to_a_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let name = format!("tangent-notify-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        for (socket, told) in [
            (
                UnixDatagram::bind(&path).unwrap(),
                path.to_str().unwrap().to_owned(),
            ),
            (
                UnixDatagram::bind_addr(&address).unwrap(),
                format!("@{name}"),
            ),
        ] {
            let notify = Notify::to(&told, Some(Duration::from_secs(2))).unwrap();
            notify.ready();
            assert_eq!(heard(&socket), "READY=1");
            notify.alive();
            assert_eq!(heard(&socket), "WATCHDOG=1");
            notify.failed("the loop stands");
            assert_eq!(heard(&socket), "STATUS=the loop stands");
            notify.stopping();
            assert_eq!(heard(&socket), "STOPPING=1");
        }
    }

    #[test]
    fn without_a_watchdog_in_the_unit_it_is_not_notified() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        let notify = Notify::to(path.to_str().unwrap(), None).unwrap();
        notify.alive();
        notify.stopping();
        assert_eq!(heard(&socket), "STOPPING=1");
    }
}
