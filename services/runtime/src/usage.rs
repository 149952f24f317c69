//! CPU and memory use of this process.

use std::time::Instant;

use nix::sys::resource::{UsageWho, getrusage};

/// Measures the process that calls it.
#[derive(Debug)]
pub(crate) struct ProcessUsage {
    cpu_s: f64,
    at: Instant,
}

impl ProcessUsage {
    pub(crate) fn new() -> Self {
        Self {
            cpu_s: cpu_s(),
            at: Instant::now(),
        }
    }

    /// CPU time of all threads of the process since the last call, percent of one core.
    pub(crate) fn cpu_percent(&mut self) -> f64 {
        let (now, cpu_s) = (Instant::now(), cpu_s());
        let elapsed_s = now.duration_since(self.at).as_secs_f64().max(1e-3);
        let percent = 100.0 * (cpu_s - self.cpu_s) / elapsed_s;
        (self.at, self.cpu_s) = (now, cpu_s);
        percent
    }

    /// Memory of the process that is in RAM, MiB; NaN if the system does not provide it.
    pub(crate) fn memory_mib() -> f64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let kib = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))
            .and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
        kib.map_or(f64::NAN, |kib| kib / 1024.0)
    }
}

fn cpu_s() -> f64 {
    getrusage(UsageWho::RUSAGE_SELF).map_or(0.0, |usage| {
        [usage.user_time(), usage.system_time()]
            .iter()
            .map(|time| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6)
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_and_memory_are_seen() {
        let mut usage = ProcessUsage::new();
        let block = vec![1_u8; 64 << 20];
        let begin = Instant::now();
        let mut sum = 0_u64;
        while begin.elapsed().as_millis() < 50 {
            sum += block
                .iter()
                .step_by(4096)
                .map(|b| u64::from(*b))
                .sum::<u64>();
        }
        assert!(sum > 0);
        assert!(usage.cpu_percent() > 1.0);
        assert!(ProcessUsage::memory_mib() > 64.0);
    }
}
