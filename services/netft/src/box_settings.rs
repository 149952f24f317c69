//! The box's own rate and datagram size: changed only if the cell file asks for other values, and
//! put back at the end. They belong to every client of the box.

use std::time::Duration;

use crate::NetftError;
use crate::box_config::BoxConfig;
use crate::config::Config;

/// Timeout of the box's web server.
const HTTP_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest time of [`BoxSettings::put_back`].
pub(crate) const PUT_BACK_MAX: Duration = Duration::from_secs(5);

/// Settings of the box before this service changed them.
#[derive(Debug, Default)]
pub(crate) struct BoxSettings {
    before: Option<Before>,
}

#[derive(Clone, Debug, PartialEq)]
struct Before {
    serial: String,
    rate_hz: Option<f64>,
    buffer_records: Option<u32>,
}

impl BoxSettings {
    /// Reads the box's configuration. Sets rate and datagram size, if the cell file asks for values
    /// that differ, and keeps those of before.
    ///
    /// # Errors
    /// The box does not answer, or its configuration is not usable.
    pub fn find(&mut self, config: &Config) -> Result<BoxConfig, NetftError> {
        let found = fetch(config)?;
        let rate_hz = config
            .rate_asked_hz
            .filter(|asked| found.rate_hz.is_some_and(|rate| (rate - asked).abs() > 0.5));
        let buffer_records = config.buffer_records.map(u32::from).filter(|asked| {
            found
                .buffer_records
                .is_some_and(|records| records != *asked)
        });
        if rate_hz.is_none() && buffer_records.is_none() {
            return Ok(found);
        }
        set(config, rate_hz, buffer_records)?;
        let own = Before {
            serial: found.serial.clone(),
            rate_hz: found.rate_hz.filter(|_| rate_hz.is_some()),
            buffer_records: found.buffer_records.filter(|_| buffer_records.is_some()),
        };
        tracing::info!(
            "the box is set from {} to {}, as [sensor] asks; its own setting is put back at the end",
            words(own.rate_hz, own.buffer_records),
            words(rate_hz, buffer_records)
        );
        // After a restart of the stream, the first setting of this box is still its own.
        if self
            .before
            .as_ref()
            .is_none_or(|before| before.serial != own.serial)
        {
            self.before = Some(own);
        }
        let now = fetch(config)?;
        match now.rate_hz {
            Some(rate_hz) => tracing::info!("the box now sends {rate_hz} records per second"),
            None => tracing::warn!("the rate of the box was set, but it does not report one"),
        }
        Ok(now)
    }

    /// Puts the box's own settings back, if this service has changed them.
    pub fn put_back(&mut self, config: &Config) {
        let Some(before) = self.before.take() else {
            return;
        };
        let own = words(before.rate_hz, before.buffer_records);
        let done = fetch(config).and_then(|found| {
            if found.serial != before.serial {
                return Ok(false);
            }
            set(config, before.rate_hz, before.buffer_records).map(|()| true)
        });
        match done {
            Ok(true) => tracing::info!("the box is set back to {own}"),
            Ok(false) => {
                tracing::warn!(
                    "another box is at {}: it keeps its settings",
                    config.address
                );
            }
            Err(error) => tracing::warn!(
                "the box is not set back to {own}, its own setting ({error}): set it on its web page, Communications"
            ),
        }
    }
}

fn fetch(config: &Config) -> Result<BoxConfig, NetftError> {
    BoxConfig::fetch(&config.address, config.http_port, HTTP_TIMEOUT)
}

fn set(
    config: &Config,
    rate_hz: Option<f64>,
    buffer_records: Option<u32>,
) -> Result<(), NetftError> {
    let (address, port) = (&config.address, config.http_port);
    BoxConfig::set_rate(address, port, rate_hz, buffer_records, HTTP_TIMEOUT)
}

fn words(rate_hz: Option<f64>, buffer_records: Option<u32>) -> String {
    let rate = rate_hz.map(|hz| format!("{hz} records per second"));
    let buffer = buffer_records.map(|records| format!("{records} records per datagram"));
    let both: Vec<String> = [rate, buffer].into_iter().flatten().collect();
    both.join(" and ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader, Write};
    use std::net::TcpListener;
    use std::sync::{Arc, Mutex};
    use tangent_runtime::CellConfig;

    /// A box with a web server, whose rate is in `rate`.
    fn serve(rate: &Arc<Mutex<f64>>) -> u16 {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let rate = Arc::clone(rate);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
                let first = lines.next().unwrap().unwrap();
                for line in lines.by_ref() {
                    if line.unwrap().is_empty() {
                        break;
                    }
                }
                if let Some((_, rest)) = first.split_once("comrdtrate=") {
                    let number = rest.split([' ', '&']).next().unwrap();
                    *rate.lock().unwrap() = number.parse().unwrap();
                }
                let text = format!(
                    "<netft><setserial>FT1</setserial><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>\
                     <scfgfu>N</scfgfu><scfgtu>Nm</scfgtu><comrdtrate>{}</comrdtrate></netft>",
                    rate.lock().unwrap()
                );
                let _ = write!(
                    stream,
                    "HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{text}",
                    text.len()
                );
            }
        });
        port
    }

    fn config(port: u16, asked_hz: Option<f64>) -> Config {
        let mut config = Config::from_cell(&CellConfig::default_cell());
        config.address = "127.0.0.1".to_owned();
        config.http_port = port;
        config.rate_asked_hz = asked_hz;
        config
    }

    #[test]
    fn a_rate_that_nobody_asks_for_stays_as_it_is() {
        let rate = Arc::new(Mutex::new(1000.0));
        let config = config(serve(&rate), None);
        let mut settings = BoxSettings::default();
        assert_eq!(settings.find(&config).unwrap().rate_hz, Some(1000.0));
        settings.put_back(&config);
        assert_eq!(*rate.lock().unwrap(), 1000.0);
    }

    #[test]
    fn a_rate_that_is_asked_for_is_set_and_put_back_at_the_end() {
        let rate = Arc::new(Mutex::new(1000.0));
        let config = config(serve(&rate), Some(7000.0));
        let mut settings = BoxSettings::default();
        assert_eq!(settings.find(&config).unwrap().rate_hz, Some(7000.0));
        // The stream was lost, and the box found again as it was left.
        settings.find(&config).unwrap();
        // The box was restarted, with another rate: its first one is still its own.
        *rate.lock().unwrap() = 500.0;
        settings.find(&config).unwrap();
        settings.put_back(&config);
        assert_eq!(*rate.lock().unwrap(), 1000.0);
    }
}
