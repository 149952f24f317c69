//! All TCP servers of the controller: where they listen, opened and closed together.

use std::net::{SocketAddr, TcpListener};

use tangent_mechanics::ModelData;
use tangent_rtde::codec::{PORT_DASHBOARD, PORT_PRIMARY, PORT_REALTIME, PORT_RTDE, PORT_SECONDARY};
use tangent_rtde::dashboard::ur_size;

use super::StartError;
use crate::config::Ports;
use crate::dashboard::DashboardServer;
use crate::primary::Geometry;
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
        let offset = match ports {
            Ports::Offset(offset) => offset,
            Ports::Ephemeral => 0,
        };
        let at = |port: u16| {
            let port = ports.of(port).ok_or(StartError::Offset { offset })?;
            Ok::<_, StartError>(SocketAddr::new(address, port))
        };
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
        let mut addresses = Vec::new();
        for (address, server) in wanted.0.iter().zip(NAMES) {
            let refused = |reason| StartError::Port {
                address: address.to_string(),
                server,
                reason,
            };
            let listener = TcpListener::bind(address).map_err(refused)?;
            listener.set_nonblocking(true).map_err(refused)?;
            addresses.push(listener.local_addr().map_err(refused)?);
            listeners.push(listener);
        }
        let mut listeners = listeners.into_iter();
        let mut next = || listeners.next().ok_or(StartError::Offset { offset: 0 });
        Ok(Self {
            endpoints: Endpoints {
                rtde: addresses[0],
                dashboard: addresses[1],
                primary: addresses[2],
                secondary: addresses[3],
                realtime: addresses[4],
                primary_read_only: addresses[5],
                secondary_read_only: addresses[6],
                realtime_read_only: addresses[7],
            },
            rtde: RtdeServer::new(next()?),
            dashboard: DashboardServer::new(next()?),
            ports: vec![
                ScriptPort::new(next()?, Stream::Primary, false),
                ScriptPort::new(next()?, Stream::Secondary, false),
                ScriptPort::new(next()?, Stream::Realtime, false),
                ScriptPort::new(next()?, Stream::Primary, true),
                ScriptPort::new(next()?, Stream::Secondary, true),
                ScriptPort::new(next()?, Stream::Realtime, true),
            ],
        })
    }

    pub(super) fn disconnect_all(&mut self) {
        self.rtde.disconnect_all();
        self.dashboard.disconnect_all();
        self.ports.iter_mut().for_each(ScriptPort::disconnect_all);
    }
}

pub(super) fn geometry(model: &ModelData) -> Geometry {
    let mut geometry = Geometry {
        // The maker's numbers; an arm of another maker goes as a UR5.
        robot_type: match ur_size(&model.name) {
            Some(3) => 3,
            Some(10) => 2,
            Some(16) => 4,
            Some(20) => 7,
            Some(30) => 8,
            _ => 1,
        },
        ..Geometry::default()
    };
    for (i, row) in model.dh.rows.iter().take(6).enumerate() {
        geometry.rows[0][i] = row.a_m;
        geometry.rows[1][i] = row.d_m;
        geometry.rows[2][i] = row.alpha_rad;
        geometry.rows[3][i] = row.theta_offset_rad;
    }
    if let Ok(arm) = tangent_mechanics::Arm::<6>::new(model) {
        let limits = arm.limits();
        for i in 0..6 {
            geometry.position[i] = [limits.position_lower[i], limits.position_upper[i]];
            geometry.speed[i] = limits.velocity[i];
        }
    }
    geometry
}
