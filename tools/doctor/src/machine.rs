//! Checks scheduling, memory, kernel and processors: whether a control loop runs in time.

use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
use tangent_runtime::realtime::try_schedule;
use tangent_runtime::{CellConfig, config::RealtimeConfig};

use crate::cell_arm::CellArm;
use crate::finding::Finding;
use crate::network;
use crate::system::System;

/// Number of the capability to lock memory beyond the process's limit.
const CAP_IPC_LOCK: u32 = 14;

/// Timing requirements of the cell's robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// A Universal Robots arm, 125 or 500 Hz: its program tolerates a few late answers.
    Velocity,
    /// A simulated arm with joint torques at 1 kHz: simulated time waits for a late answer.
    SimulatedTorque,
    /// A robot with joint torques at 1 kHz that stops by itself when answers are late.
    Torque,
}

impl Pace {
    fn of(config: &CellConfig) -> Self {
        match CellArm::of(config) {
            CellArm::UniversalRobots => Self::Velocity,
            CellArm::Franka if !network::is_this_machine(&config.robot.address) => Self::Torque,
            CellArm::Franka | CellArm::OnTheBus => Self::SimulatedTorque,
        }
    }
}

/// Checks everything about this machine on which the control loop's timing depends.
pub fn check(system: &System, config: &CellConfig) -> Vec<Finding> {
    let wish = &config.realtime;
    let pace = Pace::of(config);
    let mut findings = vec![
        scheduling(system, wish, pace),
        throttling(system),
        locked_memory(system, wish),
        kernel(system, pace),
        governor(system),
        hypervisor(system),
    ];
    findings.extend(quota(system));
    findings.extend(wish.loop_cpu.map(|cpu| loop_cpu(system, cpu)));
    findings
}

fn scheduling(system: &System, wish: &RealtimeConfig, pace: Pace) -> Finding {
    const CHECK: &str = "scheduling";
    if !wish.enabled && pace == Pace::Torque {
        return Finding::problem(
            CHECK,
            "not requested: [realtime] enabled = false",
            "at 1 kHz any other process makes answers late, and the robot stops after 20 in a row",
            "[realtime] enabled = true",
        );
    }
    if !wish.enabled {
        return Finding::ok(CHECK, "not requested: [realtime] enabled = false");
    }
    let priority = wish.loop_priority.max(wish.sensor_priority);
    match try_schedule(priority) {
        Ok(()) => Finding::ok(CHECK, format!("SCHED_FIFO {priority} is granted")),
        Err(error) => Finding::problem(
            CHECK,
            error.to_string(),
            "the loop waits for all other processes of this machine: cycles are missed under load",
            match starved_group(system) {
                Some(file) => format!(
                    "the control group has no real-time share ({file} is 0): run outside it, or start the container engine \
                     with --cpu-rt-runtime=950000 and the container with --cpu-rt-runtime=400000"
                ),
                None => format!(
                    "put `@realtime - rtprio {priority}` into /etc/security/limits.d/tangent.conf and join that group; \
                     systemd units and compose file in deploy/ have it already (docs/deploy.md)"
                ),
            },
        ),
    }
}

/// Returns the setting of a control group without a real-time share, if this process is in one.
/// Kernels with RT_GROUP_SCHED refuse SCHED_FIFO there, whatever the limits are.
fn starved_group(system: &System) -> Option<String> {
    let group = system.group_v1("cpu")?;
    ["/sys/fs/cgroup/cpu", "/sys/fs/cgroup/cpu,cpuacct"]
        .iter()
        .map(|top| format!("{top}{group}/cpu.rt_runtime_us"))
        .find(|file| system.number(file) == Some(0))
}

fn throttling(system: &System) -> Finding {
    const CHECK: &str = "real-time throttling";
    let runtime = system.number("/proc/sys/kernel/sched_rt_runtime_us");
    let period = system.number("/proc/sys/kernel/sched_rt_period_us");
    let (Some(runtime), Some(period)) = (runtime, period) else {
        return Finding::ok(CHECK, "this kernel has no limit");
    };
    if runtime < 0 {
        return Finding::ok(CHECK, "off");
    }
    let share = 100.0 * runtime as f64 / period.max(1) as f64;
    let found = format!("real-time threads may use {share:.0} % of each processor");
    if share >= 50.0 {
        // The loop needs a few percent; the rest keeps the machine reachable if a thread runs in an
        // endless loop.
        Finding::ok(CHECK, found)
    } else {
        Finding::problem(
            CHECK,
            found,
            "the loop is suspended when this share is used up",
            "sysctl -w kernel.sched_rt_runtime_us=950000",
        )
    }
}

fn locked_memory(system: &System, wish: &RealtimeConfig) -> Finding {
    const CHECK: &str = "locked memory";
    if !wish.enabled {
        return Finding::ok(CHECK, "not requested: [realtime] enabled = false");
    }
    let limit = getrlimit(Resource::RLIMIT_MEMLOCK).map_or(0, |(soft, _)| soft);
    judge_locked_memory(limit, may_lock(system))
}

fn judge_locked_memory(limit_bytes: u64, privileged: bool) -> Finding {
    const CHECK: &str = "locked memory";
    if limit_bytes == RLIM_INFINITY {
        Finding::ok(CHECK, "no limit")
    } else if privileged {
        Finding::ok(
            CHECK,
            "limited, but this process may exceed it (CAP_IPC_LOCK)",
        )
    } else {
        Finding::problem(
            CHECK,
            format!("at most {} kB may be locked", limit_bytes / 1024),
            "the loop is suspended while the system reads its memory from disk; and where locking is granted up to a limit, \
             an allocation beyond it fails",
            "put `@realtime - memlock unlimited` into /etc/security/limits.d/tangent.conf and join that group, or LimitMEMLOCK=infinity \
             in the systemd unit, or `ulimits: { memlock: -1 }` for the container",
        )
    }
}

fn may_lock(system: &System) -> bool {
    let status = system.text("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("CapEff:"))
        .and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok())
        .is_some_and(|bits| bits >> CAP_IPC_LOCK & 1 == 1)
}

fn kernel(system: &System, pace: Pace) -> Finding {
    const CHECK: &str = "kernel preemption";
    let release = system
        .text("/proc/sys/kernel/osrelease")
        .unwrap_or_else(|| "unknown".to_owned());
    let version = system.text("/proc/sys/kernel/version").unwrap_or_default();
    if version.contains("PREEMPT_RT") || system.number("/sys/kernel/realtime") == Some(1) {
        return Finding::ok(CHECK, format!("PREEMPT_RT ({release})"));
    }
    // Kernels with dynamic preemption mark the active model with brackets, in a file that only root
    // can read.
    let model = system
        .text("/sys/kernel/debug/sched/preempt")
        .and_then(|text| {
            let (_, rest) = text.split_once('(')?;
            rest.split_once(')').map(|(model, _)| model.to_owned())
        });
    let words = match (&model, version.contains("PREEMPT")) {
        (Some(model), _) => model.clone(),
        (None, true) => "PREEMPT".to_owned(),
        (None, false) => "none, or voluntary".to_owned(),
    };
    let advice = "a PREEMPT_RT kernel (Debian: linux-image-rt-amd64; Ubuntu: pro enable realtime-kernel; Linux 6.12 and later: \
                  CONFIG_PREEMPT_RT), or `preempt=full` on the kernel's command line";
    let full = model.as_deref().is_none_or(|m| m == "full") && version.contains("PREEMPT");
    let found = format!("{words} ({release})");
    match (full, pace) {
        (true, Pace::Velocity) => Finding::warning(
            CHECK,
            found,
            "delays of a millisecond and more happen: enough for 125 Hz, little for 500 Hz and up",
            advice,
        ),
        (true, Pace::Torque) => Finding::warning(
            CHECK,
            found,
            "delays of a millisecond and more happen: at 1 kHz each is a late answer, and the robot stops after 20 in a row",
            advice,
        ),
        (true, Pace::SimulatedTorque) => Finding::warning(
            CHECK,
            found,
            "delays of a millisecond and more happen: at 1 kHz each is a late answer. The simulated arm waits; a real one would not",
            advice,
        ),
        (false, Pace::Torque) => Finding::problem(
            CHECK,
            found,
            "a long system call of any process delays the loop by milliseconds: at 1 kHz the robot stops by itself",
            advice,
        ),
        (false, _) => Finding::warning(
            CHECK,
            found,
            "a long system call of any process delays the loop by milliseconds",
            advice,
        ),
    }
}

fn governor(system: &System) -> Finding {
    const CHECK: &str = "cpu governor";
    let mut slow = Vec::new();
    let mut known = 0;
    for name in system.names("/sys/devices/system/cpu") {
        let path = format!("/sys/devices/system/cpu/{name}/cpufreq/scaling_governor");
        if let Some(governor) = system.text(&path) {
            known += 1;
            if governor != "performance" {
                slow.push(format!("{name}: {governor}"));
            }
        }
    }
    if known == 0 {
        return Finding::ok(CHECK, "the kernel does not change the frequency here");
    }
    if slow.is_empty() {
        return Finding::ok(CHECK, format!("performance, on {known} processors"));
    }
    Finding::warning(
        CHECK,
        slow.join(", "),
        "an idle processor slows down and takes time to speed up: answers are tens of microseconds later, at times more",
        "cpupower frequency-set -g performance (and at each boot: cpupower.service, or tuned-adm profile latency-performance)",
    )
}

fn hypervisor(system: &System) -> Finding {
    const CHECK: &str = "virtual machine";
    let info = system.text("/proc/cpuinfo").unwrap_or_default();
    let virtual_machine = info
        .lines()
        .find_map(|line| line.strip_prefix("flags"))
        .is_some_and(|flags| flags.split_whitespace().any(|flag| flag == "hypervisor"));
    if virtual_machine {
        Finding::warning(
            CHECK,
            "this is a virtual machine",
            "its host can suspend it for milliseconds, which nothing on this machine can prevent",
            "use it for simulation and estimators; run the robot's side on a physical machine",
        )
    } else {
        Finding::ok(CHECK, "no")
    }
}

/// Checks for a limit on processor time, as containers have.
fn quota(system: &System) -> Option<Finding> {
    let (used, period) = quota_v2(system).or_else(|| quota_v1(system))?;
    Some(Finding::warning(
        "processor quota",
        format!("{used} of every {period} us"),
        "when that is used up, all processes of this control group are suspended until the period is over",
        "no `cpus` limit for the robot's side",
    ))
}

fn quota_v2(system: &System) -> Option<(i64, i64)> {
    let text = system.text(&format!("/sys/fs/cgroup{}/cpu.max", system.group_v2()?))?;
    let (used, period) = text.split_once(' ')?;
    Some((used.parse().ok()?, period.parse().ok()?))
}

fn quota_v1(system: &System) -> Option<(i64, i64)> {
    let folder = format!("/sys/fs/cgroup/cpu{}", system.group_v1("cpu")?);
    let used = system.number(&format!("{folder}/cpu.cfs_quota_us"))?;
    let period = system.number(&format!("{folder}/cpu.cfs_period_us"))?;
    (used > 0).then_some((used, period))
}

fn loop_cpu(system: &System, cpu: usize) -> Finding {
    const CHECK: &str = "loop's processor";
    let online = system
        .text("/sys/devices/system/cpu/online")
        .unwrap_or_default();
    let isolated = system
        .text("/sys/devices/system/cpu/isolated")
        .unwrap_or_default();
    if !in_list(cpu, &online) {
        Finding::problem(
            CHECK,
            format!("[realtime] loop_cpu = {cpu}, but there are {online}"),
            "the loop does not get a processor of its own",
            "choose one of these, or leave the key out",
        )
    } else if in_list(cpu, &isolated) {
        Finding::ok(CHECK, format!("{cpu}, isolated"))
    } else {
        Finding::warning(
            CHECK,
            format!("{cpu}, not isolated"),
            "other processes run there too",
            format!("`isolcpus={cpu} nohz_full={cpu}` on the kernel's command line"),
        )
    }
}

/// Whether a list such as `0-3,6` contains a number.
fn in_list(number: usize, list: &str) -> bool {
    list.split(',').any(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        match (first.trim().parse::<usize>(), last.trim().parse::<usize>()) {
            (Ok(first), Ok(last)) => (first..=last).contains(&number),
            _ => false,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use crate::system::tests::machine;

    #[test]
    fn a_group_without_real_time_share_is_named() {
        let (_folder, system) = machine(&[
            ("/proc/self/cgroup", "3:cpu,cpuacct:/docker/x\n"),
            ("/sys/fs/cgroup/cpu/docker/x/cpu.rt_runtime_us", "0\n"),
        ]);
        let file = starved_group(&system).unwrap();
        assert!(file.ends_with("docker/x/cpu.rt_runtime_us"), "{file}");
        let (_folder, granted) = machine(&[
            ("/proc/self/cgroup", "3:cpu,cpuacct:/\n"),
            ("/sys/fs/cgroup/cpu/cpu.rt_runtime_us", "950000\n"),
        ]);
        assert_eq!(starved_group(&granted), None);
    }

    #[test]
    fn throttling_is_a_share() {
        let with = |runtime: &str| {
            let (_folder, system) = machine(&[
                ("/proc/sys/kernel/sched_rt_runtime_us", runtime),
                ("/proc/sys/kernel/sched_rt_period_us", "1000000"),
            ]);
            throttling(&system)
        };
        assert_eq!(with("950000").level, Level::Ok);
        assert_eq!(with("-1").found, "off");
        assert_eq!(with("0").level, Level::Problem);
    }

    #[test]
    fn locked_memory_needs_no_limit_or_the_right_to_exceed_it() {
        assert_eq!(judge_locked_memory(RLIM_INFINITY, false).level, Level::Ok);
        assert_eq!(judge_locked_memory(65_536, true).level, Level::Ok);
        let limited = judge_locked_memory(65_536, false);
        assert_eq!(limited.level, Level::Problem);
        assert!(limited.found.contains("64 kB"), "{}", limited.found);
        let with = |bits: &str| {
            let status = format!("Name:\tx\nCapEff:\t{bits}\n");
            may_lock(&machine(&[("/proc/self/status", &status)]).1)
        };
        assert!(with("000001ffffffffff"));
        assert!(!with("0000000000000000"));
    }

    #[test]
    fn kernels_are_distinguished() {
        let with = |files: &[(&str, &str)]| kernel(&machine(files).1, Pace::Velocity);
        let rt = with(&[("/proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian")]);
        assert_eq!(rt.level, Level::Ok);
        let dynamic = with(&[
            ("/proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC"),
            ("/sys/kernel/debug/sched/preempt", "none (voluntary) full"),
        ]);
        assert!(dynamic.found.starts_with("voluntary"), "{}", dynamic.found);
        assert!(dynamic.meaning.contains("delays the loop"));
        let full = with(&[
            ("/proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC"),
            ("/sys/kernel/debug/sched/preempt", "none voluntary (full)"),
        ]);
        assert!(full.meaning.contains("125 Hz"));
    }

    #[test]
    fn a_robot_at_1_khz_asks_more_than_one_at_125_hz() {
        let config = |text: &str| CellConfig::parse("cell.toml", text).unwrap();
        let ur = CellConfig::default_cell();
        let mut franka = config(include_str!("../../../deploy/cell.franka.toml"));
        let lippiello = config(include_str!("../../../deploy/cell.lippiello.toml"));
        assert_eq!(Pace::of(&ur), Pace::Velocity);
        assert_eq!(Pace::of(&franka), Pace::SimulatedTorque);
        assert_eq!(Pace::of(&lippiello), Pace::SimulatedTorque);
        franka.robot.address = "192.0.2.7".into();
        assert_eq!(Pace::of(&franka), Pace::Torque);
        let dynamic = |model: &str| {
            machine(&[
                ("/proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC"),
                ("/sys/kernel/debug/sched/preempt", model),
            ])
        };
        let (voluntary, full) = (dynamic("none (voluntary) full"), dynamic("none (full)"));
        for (pace, of_voluntary) in [
            (Pace::Velocity, Level::Warning),
            (Pace::SimulatedTorque, Level::Warning),
            (Pace::Torque, Level::Problem),
        ] {
            assert_eq!(kernel(&voluntary.1, pace).level, of_voluntary);
            assert_eq!(kernel(&full.1, pace).level, Level::Warning);
        }
        assert!(kernel(&full.1, Pace::Torque).meaning.contains("1 kHz"));
        let mut wish = franka.realtime.clone();
        wish.enabled = false;
        let level = |pace| scheduling(&full.1, &wish, pace).level;
        assert_eq!(level(Pace::Torque), Level::Problem);
        assert_eq!(level(Pace::SimulatedTorque), Level::Ok);
    }

    #[test]
    fn a_governor_that_saves_power_is_named() {
        let file = |n| format!("/sys/devices/system/cpu/cpu{n}/cpufreq/scaling_governor");
        let (a, b) = (file(0), file(1));
        let both = |second: &str| governor(&machine(&[(&a, "performance\n"), (&b, second)]).1);
        assert_eq!(both("performance").level, Level::Ok);
        let slow = both("powersave");
        assert_eq!(slow.level, Level::Warning);
        assert_eq!(slow.found, "cpu1: powersave");
        assert_eq!(governor(&machine(&[]).1).level, Level::Ok);
    }

    #[test]
    fn quotas_of_both_versions() {
        let v2 = machine(&[
            ("/proc/self/cgroup", "0::/a\n"),
            ("/sys/fs/cgroup/a/cpu.max", "50000 100000\n"),
        ]);
        assert_eq!(quota_v2(&v2.1), Some((50_000, 100_000)));
        let free = machine(&[
            ("/proc/self/cgroup", "0::/a\n"),
            ("/sys/fs/cgroup/a/cpu.max", "max 100000\n"),
        ]);
        assert_eq!(quota(&free.1), None);
        let v1 = machine(&[
            ("/proc/self/cgroup", "2:cpu:/b\n"),
            ("/sys/fs/cgroup/cpu/b/cpu.cfs_quota_us", "200000\n"),
            ("/sys/fs/cgroup/cpu/b/cpu.cfs_period_us", "100000\n"),
        ]);
        assert_eq!(quota_v1(&v1.1), Some((200_000, 100_000)));
    }

    #[test]
    fn the_loop_s_processor_exists_and_is_isolated() {
        let (_folder, system) = machine(&[
            ("/sys/devices/system/cpu/online", "0-2,5\n"),
            ("/sys/devices/system/cpu/isolated", "2\n"),
        ]);
        assert_eq!(loop_cpu(&system, 2).level, Level::Ok);
        assert_eq!(loop_cpu(&system, 5).level, Level::Warning);
        assert_eq!(loop_cpu(&system, 4).level, Level::Problem);
    }
}
