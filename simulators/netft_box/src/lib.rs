//! A simulated ATI Net F/T box on sockets: RDT over UDP, its configuration over HTTP.
//!
//! The service `tangent-simulator` starts a [`NetbBox`] beside a simulated arm and feeds it with
//! the records of the plant's sensor ([`NetbBox::listener`]). Tests of clients start one alone. The
//! clock of the box counts at 7 kHz at any rate of records. Samples are sent at the times
//! that they are stamped with.
//!
//! ```
//! use tangent_simulated_netft::{BoxSample, NetbBox, NetbConfig};
//!
//! let simulated = NetbBox::start(NetbConfig::default())?;
//! println!("RDT at {}, web pages at {}", simulated.rdt_address(), simulated.http_address());
//! // 3 N against z, at a million counts per newton, until the next call.
//! let counts = [0, 0, -3_000_000, 0, 0, 0];
//! simulated.feed().hold(BoxSample { counts, saturated: false });
//! # Ok::<(), tangent_simulated_netft::NetbError>(())
//! ```

mod fault;
mod rdt;
mod rdt_thread;
mod samples;
mod web;

use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_simulated_device::{PastLastPort, Ports, RecordListener};
use tangent_simulation::{SensorConfig, SensorSample};

pub use fault::NetbFault;
pub use samples::BoxSample;
use samples::SampleQueue;

/// Ports of a real box: RDT, and its web server (80 on a real one, which requires privileges).
const PORT_RDT: u16 = 49152;
const PORT_HTTP: u16 = 8080;

/// Properties of a box, and its addresses.
#[derive(Clone, Debug, PartialEq)]
pub struct NetbConfig {
    /// Address to listen on: a loopback address, or one of this host.
    pub address: IpAddr,
    /// UDP port of RDT; 0: any free one.
    pub rdt_port: u16,
    /// TCP port of its web server; 0: any free one.
    pub http_port: u16,
    /// Counts per unit of force.
    pub counts_per_force: f64,
    /// Counts per unit of torque.
    pub counts_per_torque: f64,
    /// Unit of force, as on its web page.
    pub force_unit: String,
    /// Unit of torque, as on its web page.
    pub torque_unit: String,
    /// Serial number.
    pub serial: String,
    /// Records per second at the start, 1 to 7000.
    pub rate_hz: u32,
    /// Records per buffered datagram at the start, 1 to 40.
    pub buffer_records: u32,
    /// Number of the low-pass filter that its web page shows; 0: off. The readings are not
    /// filtered.
    pub filter: u32,
    /// Limit of the counts; a count beyond it latches the threshold warning.
    pub threshold_counts: Option<[i32; 6]>,
    /// Half width of the box's own noise on every axis, counts; it is added to the noise of the
    /// samples.
    pub noise_counts: u32,
    /// SCHED_FIFO priority of the thread that sends records; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Default for NetbConfig {
    /// A Gamma in N and Nm on free ports of 127.0.0.1.
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            rdt_port: 0,
            http_port: 0,
            counts_per_force: 1e6,
            counts_per_torque: 1e6,
            force_unit: "N".into(),
            torque_unit: "N-m".into(),
            serial: "FT00000".into(),
            rate_hz: 7000,
            buffer_records: 7,
            filter: 0,
            threshold_counts: None,
            noise_counts: 0,
            realtime_priority: None,
        }
    }
}

/// Half width of the converters' noise of a cell's box, counts. A real box never sends the same
/// record twice. Without this noise, a simulated one on a busy machine would do so whenever no new
/// sample has arrived in time, and would be reported as frozen.
const CONVERTER_NOISE_COUNTS: u32 = 5;

/// Reasons why a box cannot start.
#[derive(Debug, thiserror::Error)]
pub enum NetbError {
    /// A port is in use or not allowed, or the address is not of this host.
    #[error(
        "the simulated Net F/T box cannot listen on {protocol} {address}: {source}; choose another port_offset or address"
    )]
    Listen {
        /// `UDP` or `TCP`.
        protocol: &'static str,
        /// Address and port.
        address: SocketAddr,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A thread or the runtime could not be started.
    #[error("the simulated Net F/T box cannot start: {0}")]
    System(#[from] std::io::Error),
    /// The port offset leads beyond the last port.
    #[error(transparent)]
    Offset(#[from] PastLastPort),
}

/// Settings that may change while the box runs: set over HTTP, and read for every record.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Settings {
    rate_hz: u32,
    buffer_records: u32,
}

/// State shared by handle, RDT thread and web server.
struct Shared {
    config: NetbConfig,
    settings: Mutex<Settings>,
    samples: Mutex<SampleQueue>,
    stop: AtomicBool,
    sent: AtomicU64,
    requests: AtomicU64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A running box; dropping it stops it.
pub struct NetbBox {
    shared: Arc<Shared>,
    faults: Sender<NetbFault>,
    rdt_address: SocketAddr,
    http_address: SocketAddr,
    rdt: Option<JoinHandle<()>>,
    web: Option<web::WebServer>,
}

impl NetbBox {
    /// Opens both ports and starts to answer. Without samples, the box reads zero.
    ///
    /// # Errors
    /// A port is not available; the error names it.
    pub fn start(config: NetbConfig) -> Result<Self, NetbError> {
        let listen = |protocol, port: u16| {
            let address = SocketAddr::new(config.address, port);
            move |source| NetbError::Listen {
                protocol,
                address,
                source,
            }
        };
        let udp = UdpSocket::bind((config.address, config.rdt_port))
            .map_err(listen("UDP", config.rdt_port))?;
        let tcp = TcpListener::bind((config.address, config.http_port))
            .map_err(listen("TCP", config.http_port))?;
        let (rdt_address, http_address) = (udp.local_addr()?, tcp.local_addr()?);
        let settings = Settings {
            rate_hz: config.rate_hz.clamp(1, 7000),
            buffer_records: config.buffer_records.clamp(1, 40),
        };
        let shared = Arc::new(Shared {
            config,
            settings: Mutex::new(settings),
            samples: Mutex::default(),
            stop: AtomicBool::new(false),
            sent: AtomicU64::new(0),
            requests: AtomicU64::new(0),
        });
        let (faults, received) = channel();
        let rdt = rdt_thread::spawn(udp, Arc::clone(&shared), received)?;
        let web = web::WebServer::start(tcp, Arc::clone(&shared))?;
        Ok(Self {
            shared,
            faults,
            rdt_address,
            http_address,
            rdt: Some(rdt),
            web: Some(web),
        })
    }

    /// A box for the sensor of a cell, on the real ports or on those that `ports` selects.
    ///
    /// # Errors
    /// A port is not available, or the offset leads beyond the last port.
    pub fn for_sensor(
        address: IpAddr,
        ports: Ports,
        sensor: &SensorConfig,
        realtime_priority: Option<u8>,
    ) -> Result<Self, NetbError> {
        Self::start(NetbConfig {
            address,
            rdt_port: ports.in_cell(PORT_RDT)?,
            http_port: ports.in_cell(PORT_HTTP)?,
            counts_per_force: sensor.counts_per_n,
            counts_per_torque: sensor.counts_per_nm,
            noise_counts: CONVERTER_NOISE_COUNTS,
            realtime_priority,
            ..NetbConfig::default()
        })
    }

    /// Address of RDT.
    pub fn rdt_address(&self) -> SocketAddr {
        self.rdt_address
    }

    /// Address of the web server.
    pub fn http_address(&self) -> SocketAddr {
        self.http_address
    }

    /// Input for samples; clones can be passed to other threads.
    pub fn feed(&self) -> SampleFeed {
        SampleFeed {
            shared: Arc::clone(&self.shared),
        }
    }

    /// Callback that feeds the box with the records of a plant. It allocates only while the number
    /// of records per period still grows.
    pub fn listener(&self) -> RecordListener {
        let (feed, mut samples) = (self.feed(), Vec::with_capacity(64));
        Box::new(move |start, before_s, records| {
            feed.play(start, before_s, records, &mut samples);
        })
    }

    /// Injects a fault, from the next record on.
    pub fn inject(&self, fault: NetbFault) {
        // A box that has ended ignores faults.
        let _ = self.faults.send(fault);
    }

    /// Number of records sent since the start, including those that a fault held back.
    pub fn records_sent(&self) -> u64 {
        self.shared.sent.load(Ordering::Relaxed)
    }

    /// Number of valid requests since the start.
    pub fn requests(&self) -> u64 {
        self.shared.requests.load(Ordering::Relaxed)
    }
}

impl Drop for NetbBox {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(web) = self.web.take() {
            web.stop();
        }
        if let Some(thread) = self.rdt.take()
            && thread.join().is_err()
        {
            tracing::error!("the RDT thread of the simulated box panicked");
        }
    }
}

/// Input for the plant's samples.
#[derive(Clone)]
pub struct SampleFeed {
    shared: Arc<Shared>,
}

impl SampleFeed {
    /// Adds one period's samples: the first was measured at `first`, the others `interval` apart.
    /// The box reads each sample from its time until that of the next one; samples of the past are
    /// skipped. A record waits up to 10 ms for a missing sample; after that it repeats the last
    /// one.
    pub fn push(&self, first: Instant, interval: Duration, samples: &[BoxSample]) {
        lock(&self.shared.samples).push(first, interval, samples);
    }

    /// Adds the plant's records of the period that began at `start`, `before_s` on the plant's
    /// clock; each is read at its time. `scratch` is working memory.
    fn play(
        &self,
        start: Instant,
        before_s: f64,
        records: &[SensorSample],
        scratch: &mut Vec<BoxSample>,
    ) {
        let (Some(first), Some(last)) = (records.first(), records.last()) else {
            return;
        };
        scratch.clear();
        scratch.extend(records.iter().map(|s| BoxSample {
            counts: s.counts,
            saturated: s.saturated,
        }));
        let intervals = (records.len() - 1).max(1) as f64;
        let interval = ((last.time_s - first.time_s) / intervals).max(0.0);
        let offset = (first.time_s - before_s).max(0.0);
        self.push(
            start + Duration::from_secs_f64(offset),
            Duration::from_secs_f64(interval),
            scratch,
        );
    }

    /// Sets a constant reading from now on.
    pub fn hold(&self, sample: BoxSample) {
        lock(&self.shared.samples).hold(sample);
    }
}
