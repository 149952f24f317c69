//! A UR controller with a bare UR5 on the real ports, without the bus: to try a client against it.
//!
//! `cargo run --release -p tangent-simulated-ur --example bare_arm -- 127.0.0.1 e_series 600`
//! listens on that address for 600 s and then prints the controller's log. The series is `cb3` or
//! `e_series`.

use std::env::args;
use std::error::Error;
use std::time::Duration;

use tangent_simulated_device::Ports;
use tangent_simulated_ur::plant::BareArm;
use tangent_simulated_ur::{ControllerConfig, Flavour, Listeners, Place, SimulatedUr};
use tangent_simulation::ServoConfig;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = args().skip(1);
    let address = args.next().unwrap_or_else(|| "127.0.0.1".to_owned());
    let e_series = args.next().is_some_and(|series| series == "e_series");
    let seconds: u64 = args.next().map_or(Ok(600), |text| text.parse())?;
    let (flavour, servo) = if e_series {
        (Flavour::ESeries, ServoConfig::e_series())
    } else {
        (Flavour::Cb3, ServoConfig::cb3())
    };
    let config = ControllerConfig {
        flavour,
        ..ControllerConfig::default()
    };
    let place = Place {
        address: address.parse()?,
        ports: Ports::Offset(0),
        realtime_priority: None,
    };
    let arm = Box::new(BareArm::builtin("ur5", &servo)?);
    let robot = SimulatedUr::start(place, &config, "ur5", arm, Listeners::default())?;
    println!("{:#?}", robot.endpoints());
    std::thread::sleep(Duration::from_secs(seconds));
    for line in robot.log() {
        println!("{line}");
    }
    Ok(())
}
