//! All TCP servers of the controller: where they listen, opened and closed together.

use std::net::{SocketAddr, TcpListener};

use tangent_rtde::codec::{PORT_DASHBOARD, PORT_PRIMARY, PORT_REALTIME, PORT_RTDE, PORT_SECONDARY};
use tangent_simulated_device::Ports;

use super::StartError;
use crate::dashboard::DashboardServer;
use crate::rtde_server::RtdeServer;
use crate::script_ports::{ScriptPort, Stream};

/// Read-only twins of the script ports are this far above them.
const READ_ONLY_ABOVE: u16 = 10;

/// Where the servers listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoints {
    /// RTDE.
    pub rtde: SocketAddr,
    /// Dashboard.
    pub dashboard: SocketAddr,
    /// Primary client.
    pub primary: SocketAddr,
    /// Secondary client.
    pub secondary: SocketAddr,
    /// Real-time client.
    pub realtime: SocketAddr,
    /// Primary client, read-only.
    pub primary_read_only: SocketAddr,
    /// Secondary client, read-only.
    pub secondary_read_only: SocketAddr,
    /// Real-time client, read-only.
    pub realtime_read_only: SocketAddr,
}

/// Addresses to bind, in the order of [`Endpoints`].
pub(super) struct Wanted([SocketAddr; 8]);

const NAMES: [&str; 8] = [
    "RTDE",
    "the dashboard",
    "the primary client",
    "the secondary client",
    "the real-time client",
    "the primary client (read-only)",
    "the secondary client (read-only)",
    "the real-time client (read-only)",
];

impl Wanted {
    pub(super) fn new(address: std::net::IpAddr, ports: Ports) -> Result<Self, StartError> {
        let at = |port: u16| Ok::<_, StartError>(SocketAddr::new(address, ports.in_cell(port)?));
        Ok(Self([
            at(PORT_RTDE)?,
            at(PORT_DASHBOARD)?,
            at(PORT_PRIMARY)?,
            at(PORT_SECONDARY)?,
            at(PORT_REALTIME)?,
            at(PORT_PRIMARY + READ_ONLY_ABOVE)?,
            at(PORT_SECONDARY + READ_ONLY_ABOVE)?,
            at(PORT_REALTIME + READ_ONLY_ABOVE)?,
        ]))
    }
}

impl From<[SocketAddr; 8]> for Endpoints {
    fn from(addresses: [SocketAddr; 8]) -> Self {
        let [
            rtde,
            dashboard,
            primary,
            secondary,
            realtime,
            primary_read_only,
            secondary_read_only,
            realtime_read_only,
        ] = addresses;
        Self {
            rtde,
            dashboard,
            primary,
            secondary,
            realtime,
            primary_read_only,
            secondary_read_only,
            realtime_read_only,
        }
    }
}

impl From<Endpoints> for Wanted {
    fn from(e: Endpoints) -> Self {
        Self([
            e.rtde,
            e.dashboard,
            e.primary,
            e.secondary,
            e.realtime,
            e.primary_read_only,
            e.secondary_read_only,
            e.realtime_read_only,
        ])
    }
}

pub(super) struct Servers {
    pub(super) endpoints: Endpoints,
    pub(super) rtde: RtdeServer,
    pub(super) dashboard: DashboardServer,
    pub(super) ports: Vec<ScriptPort>,
}

impl Servers {
    pub(super) fn bind(wanted: &Wanted) -> Result<Self, StartError> {
        let mut listeners = Vec::new();
        let mut addresses = [wanted.0[0]; 8];
        for ((wanted, server), bound) in wanted.0.iter().zip(NAMES).zip(&mut addresses) {
            let refused = |reason| StartError::Port {
                address: wanted.to_string(),
                server,
                reason,
            };
            let listener = TcpListener::bind(wanted).map_err(refused)?;
            listener.set_nonblocking(true).map_err(refused)?;
            *bound = listener.local_addr().map_err(refused)?;
            listeners.push(listener);
        }
        let endpoints = Endpoints::from(addresses);
        let Ok(
            [
                rtde,
                dashboard,
                first,
                second,
                realtime,
                first_ro,
                second_ro,
                realtime_ro,
            ],
        ) = <[TcpListener; 8]>::try_from(listeners)
        else {
            unreachable!("one listener per address");
        };
        Ok(Self {
            endpoints,
            rtde: RtdeServer::new(rtde),
            dashboard: DashboardServer::new(dashboard),
            ports: vec![
                ScriptPort::new(first, Stream::Primary, false),
                ScriptPort::new(second, Stream::Secondary, false),
                ScriptPort::new(realtime, Stream::Realtime, false),
                ScriptPort::new(first_ro, Stream::Primary, true),
                ScriptPort::new(second_ro, Stream::Secondary, true),
                ScriptPort::new(realtime_ro, Stream::Realtime, true),
            ],
        })
    }

    pub(super) fn disconnect_all(&mut self) {
        self.rtde.disconnect_all();
        self.dashboard.disconnect_all();
        self.ports.iter_mut().for_each(ScriptPort::disconnect_all);
    }
}
