//! Sensor service: samples of a force/torque sensor in, conditioned wrench out.
//!
//! The cell file chooses the driver ([`Driver`]): an ATI Net F/T box, the sensor in the flange of
//! an e-Series arm, or a topic of another program. The conditioning, the topics and the tare are
//! the same for all of them.
//!
//! With a Net F/T box, it reads units and scales from the box over HTTP and requests the stream. It
//! changes the box's own rate only if the cell file asks for another one, and puts it back.
//! From then on, every record is published on `wrench/raw`, with its time of measurement recovered
//! from the box's own count. The newest one is conditioned and published on `wrench/status` and
//! `wrench/tool`. After silence the stream is requested again, without limit. `netft/tare` averages
//! the zero on this host, never in the box.

#![deny(missing_docs)]

pub mod box_config;
mod box_settings;
mod bus_driver;
pub mod clock;
pub mod codec;
mod conditioning;
mod config;
mod connection;
mod error;
mod meters;
mod receiver;
mod socket;
pub mod stream;

use std::time::Duration;

use tangent_runtime::watchdog::TURN;
use tangent_runtime::{Beat, Bus, HealthReporter, Parameters, Stop};
use tangent_tare::TareSetup;

pub use box_config::BoxConfig;
pub use config::{BusSource, Config, Driver, SOCKET_BUFFER_BYTES, TOOL_RATE_DEFAULT_HZ};
pub use error::{BoxConfigError, NetftError};
pub use socket::RdtSocket;

use box_settings::{BoxSettings, PUT_BACK_MAX};
use conditioning::Conditioning;
use receiver::{Ended, Receiver};

/// Name of the service in topics, health and parameters.
pub const SERVICE: &str = "netft";

/// Shortest and longest pause between two attempts to reach the box's web server.
const PAUSE_MIN: Duration = Duration::from_millis(100);
const PAUSE_MAX: Duration = Duration::from_secs(2);
/// Longest time to find the box: name resolution and three HTTP requests.
const FIND_MAX: Duration = Duration::from_secs(60);

/// Runs until `stop`. A sensor that is unreachable, silent or unusable is reported and tried again,
/// without limit.
///
/// # Errors
/// Settings are out of range, or the bus, a socket or a thread is not available.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), NetftError> {
    let health = HealthReporter::start_only(&bus, SERVICE)?;
    let parameters = Parameters::new(&bus, SERVICE)?;
    let system = |action| move |source| NetftError::System { action, source };
    let setup = TareSetup {
        service: SERVICE,
        state: config.state.clone(),
        duration_s: config.conditioning.tare.duration_s,
        silence: "no records arrived to average; see the sensor's health",
    };
    let (taring, keeper) = tangent_tare::open(&bus, &setup)?
        .start()
        .map_err(system("starting the thread that writes state"))?;
    let conditioning = Conditioning::new(&config, &bus, &parameters, taring)?;
    let ended = match config.driver.clone() {
        Driver::Bus(source) => bus_driver::run(config, &source, &bus, conditioning, health, &stop),
        Driver::Netft => {
            let mut receiver = Receiver::new(config, &bus, conditioning, health)?;
            // Runs in a separate thread: real-time scheduling must not spread to the caller.
            let ended = std::thread::Builder::new()
                .name(SERVICE.into())
                .spawn(move || {
                    receiver.setup_thread();
                    serve(&mut receiver, &stop);
                })
                .map_err(system("starting the receiving thread"))?
                .join();
            ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            Ok(())
        }
    };
    // Dropped after the last zero, which it writes to the disk.
    drop(keeper);
    ended
}

/// Repeatedly finds the box and receives from it.
fn serve(receiver: &mut Receiver, stop: &Stop) {
    let beat = Beat::new(SERVICE);
    let mut pause = PAUSE_MIN;
    let mut settings = BoxSettings::default();
    while !stop.is_stopped() {
        beat.within(FIND_MAX);
        let ended = find(&mut settings, receiver.config()).and_then(|found| {
            pause = PAUSE_MIN;
            receiver.receive(&found, stop, &beat)
        });
        match ended {
            Ok(Ended::Stopped) => break,
            Ok(Ended::Silent) => {
                tracing::warn!("the box sends no records; searching for it");
                receiver.report_silence();
            }
            Ok(Ended::Restarted) => {
                tracing::warn!(
                    "the box has restarted its counter; reading its units and scales again"
                );
            }
            // Includes a box whose rate does not fit the cell's filter: it may be corrected on the
            // box's web page.
            Err(error) => {
                receiver.report_fault(&error);
                beat.within(pause + TURN);
                stop.wait(pause);
                pause = (pause * 2).min(PAUSE_MAX);
            }
        }
    }
    beat.within(PUT_BACK_MAX + TURN);
    settings.put_back(receiver.config());
}

/// Reads the box's units and scales, and sets the rate if the cell file asks for another one.
fn find(settings: &mut BoxSettings, config: &Config) -> Result<BoxConfig, NetftError> {
    let found = settings.find(config)?;
    if found.transformed {
        tracing::warn!(
            "the box applies a tool transform to its readings; clear it on its web page, or the payload and the tool's frame are wrong"
        );
    }
    if found.filter.is_some_and(|number| number != 0) {
        tracing::warn!(
            "the box applies a low-pass filter, which delays its readings: switch it off on its web page, since this host filters them"
        );
    }
    Ok(found)
}
