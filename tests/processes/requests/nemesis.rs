//! Stops, continues, kills and starts the processes of a cell at random moments.

use std::time::{Duration, Instant};

use tangent_runtime::clock::now_ns;

use super::Draw;
use crate::cell::Cell;

/// Services that may hang or die. The controller and the bridge are separate processes, so that all
/// messages between them go over the bus.
const VICTIMS: [&str; 3] = ["router", "rtde", "controller"];

/// Runs until `until`. Returns the start and end of each fault, ns.
pub fn torment(cell: &mut Cell, draw: &mut Draw, until: Instant) -> Vec<(i64, i64)> {
    let mut faults = Vec::new();
    while Instant::now() < until {
        pause(Duration::from_millis(1200 + draw.below(1500)));
        let victim = VICTIMS[draw.below(3) as usize];
        let from = now_ns();
        if draw.below(6) == 0 {
            cell.process(victim).kill();
            pause(Duration::from_millis(draw.below(300)));
            cell.start(victim);
            // The process runs and is connected again.
            pause(Duration::from_millis(1500));
        } else {
            cell.process(victim).signal("STOP");
            pause(Duration::from_millis(50 + draw.below(1100)));
            cell.process(victim).signal("CONT");
        }
        faults.push((from, now_ns()));
    }
    faults
}

/// Waits: the history needs faults at separate times, not as fast as possible.
pub fn pause(time: Duration) {
    let until = Instant::now() + time;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        std::thread::park_timeout(left);
    }
}
