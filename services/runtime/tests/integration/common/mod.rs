//! Cells on free loopback ports.

use std::time::{Duration, Instant};

use tangent_runtime::{Bus, CellConfig, Role};

/// Timeout far above the duration of any step here, so that only a real failure reaches it.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// A cell whose router listens on a port of its own.
pub fn cell() -> CellConfig {
    let port = tangent_live::ports::free();
    let mut config = CellConfig::default_cell();
    config.cell.name = format!("test{port}");
    config.zenoh.connect = vec![format!("tcp/127.0.0.1:{port}")];
    config.zenoh.listen = config.zenoh.connect.clone();
    config
}

/// Joins as a client.
#[allow(dead_code)]
pub fn client(config: &CellConfig) -> Bus {
    Bus::open_within(config, Role::Client, PATIENCE).unwrap()
}

/// Waits until it holds, looking again each millisecond.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "never came: {what}");
        std::thread::park_timeout(Duration::from_millis(1));
    }
}
