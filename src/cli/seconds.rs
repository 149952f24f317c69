//! Parsers for seconds on the command line.

/// Waiting time that a user may give, s: 0 to a day.
///
/// # Errors
/// A message for the command line.
pub fn waiting_time(text: &str) -> Result<f64, &'static str> {
    match text.parse::<f64>() {
        Ok(s) if (0.0..=86_400.0).contains(&s) => Ok(s),
        _ => Err("0 to 86400 seconds are allowed"),
    }
}

/// Duration of a measurement, s: 0.1 to an hour.
///
/// # Errors
/// A message for the command line.
pub fn measuring_time(text: &str) -> Result<f64, &'static str> {
    match text.parse() {
        Ok(seconds) if (0.1..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("0.1 to 3600 seconds are allowed"),
    }
}
