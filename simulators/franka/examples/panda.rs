//! A simulated Panda with its default tool in free space, without the bus: to try a client against
//! it.
//!
//! `cargo run --release -p tangent-simulated-franka --example panda -- 127.0.0.1 600` listens on
//! that address and FCI's port for 600 s.

use std::env::args;
use std::error::Error;
use std::time::Duration;

use tangent_simulated_device::Ports;
use tangent_simulated_franka::{FciConfig, SimulatedFranka};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = args().skip(1);
    let address = args.next().unwrap_or_else(|| "127.0.0.1".to_owned());
    let seconds: u64 = args.next().map_or(Ok(600), |text| text.parse())?;
    let config = FciConfig {
        address: address.parse()?,
        ports: Ports::Offset(0),
        // On a machine without real-time scheduling, time runs slowly instead of losing answers.
        answer_wait_s: 0.5,
        ..FciConfig::default()
    };
    let robot = SimulatedFranka::start(&config)?;
    println!("FCI at {}", robot.address());
    std::thread::sleep(Duration::from_secs(seconds));
    Ok(())
}
