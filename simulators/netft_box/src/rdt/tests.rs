use std::time::Duration;

use proptest::prelude::*;
use tangent_netft::codec::records;

use super::*;

const SETTINGS: Settings = Settings {
    rate_hz: 7000,
    buffer_records: 4,
};

fn sample(x: i32) -> BoxSample {
    BoxSample {
        counts: [x; 6],
        saturated: false,
    }
}

fn client(port: u16) -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], port))
}

fn ask(simulated: &mut RdtBox, command: Command, sample_count: u32, port: u16) {
    let request = Request {
        command,
        sample_count,
    };
    assert!(simulated.request(&request.to_bytes(), client(port)));
}

/// Runs `ticks` records; returns the datagrams, each with its receiver's port and its records.
fn run(simulated: &mut RdtBox, ticks: usize, sample: BoxSample) -> Vec<(u16, Vec<Record>)> {
    let mut sent = Vec::new();
    for _ in 0..ticks {
        simulated.tick(sample, SETTINGS, |bytes, to| {
            let found = records(bytes).map(Iterator::collect).unwrap_or_default();
            sent.push((to.port(), found));
        });
    }
    sent
}

fn sequences(sent: &[(u16, Vec<Record>)]) -> Vec<Vec<u32>> {
    sent.iter()
        .map(|(_, records)| records.iter().map(|r| r.rdt_sequence).collect())
        .collect()
}

#[test]
fn real_time_sends_one_record_each_and_stops_after_the_count() {
    let mut simulated = RdtBox::new(None, 0);
    ask(&mut simulated, Command::RealTime, 3, 1);
    let sent = run(&mut simulated, 9, BoxSample::default());
    assert_eq!(sequences(&sent), [[1], [2], [3]]);
    assert!(!simulated.is_streaming());
}

#[test]
fn buffered_sends_several_and_the_rest_at_the_end() {
    let mut simulated = RdtBox::new(None, 0);
    ask(&mut simulated, Command::Buffered, 6, 1);
    let sent = run(&mut simulated, 9, BoxSample::default());
    assert_eq!(sequences(&sent), [vec![1, 2, 3, 4], vec![5, 6]]);
}

#[test]
fn the_newest_request_takes_the_stream_and_the_clock_runs_on() {
    let mut simulated = RdtBox::new(None, 0);
    ask(&mut simulated, Command::RealTime, 0, 1);
    let first = run(&mut simulated, 2, BoxSample::default());
    ask(&mut simulated, Command::RealTime, 0, 2);
    let second = run(&mut simulated, 1, BoxSample::default());
    assert_eq!((first[1].0, second[0].0), (1, 2));
    assert_eq!(second[0].1[0].rdt_sequence, 1);
    assert_eq!(second[0].1[0].ft_sequence, first[1].1[0].ft_sequence + 1);
}

#[test]
fn a_software_bias_applies_to_all_clients_permanently() {
    let mut simulated = RdtBox::new(None, 0);
    let sample = BoxSample {
        counts: [5, -5, 7, 0, 1, 2],
        saturated: false,
    };
    ask(&mut simulated, Command::RealTime, 0, 1);
    assert_eq!(run(&mut simulated, 1, sample)[0].1[0].counts, sample.counts);
    ask(&mut simulated, Command::SetSoftwareBias, 0, 3);
    ask(&mut simulated, Command::RealTime, 0, 2);
    assert_eq!(run(&mut simulated, 1, sample)[0].1[0].counts, [0; 6]);
}

#[test]
fn a_threshold_latches_until_it_is_reset() {
    let mut simulated = RdtBox::new(Some([100; 6]), 0);
    let strong = BoxSample {
        counts: [0, 0, -101, 0, 0, 0],
        saturated: false,
    };
    ask(&mut simulated, Command::RealTime, 0, 1);
    let status = |sent: Vec<(u16, Vec<Record>)>| sent[0].1[0].status;
    assert_eq!(status(run(&mut simulated, 1, strong)), Status(0x8001_0000));
    let latched = status(run(&mut simulated, 1, BoxSample::default()));
    assert_eq!(latched, Status(0x8001_0000));
    ask(&mut simulated, Command::ResetThresholdLatch, 0, 1);
    assert_eq!(
        status(run(&mut simulated, 1, BoxSample::default())),
        Status(0)
    );
}

#[test]
fn faults_are_what_they_say() {
    let mut simulated = RdtBox::new(None, 0);
    ask(&mut simulated, Command::RealTime, 0, 1);
    simulated.inject(NetbFault::Drop(2));
    assert_eq!(
        sequences(&run(&mut simulated, 3, BoxSample::default())),
        [[3]]
    );
    simulated.inject(NetbFault::Duplicate(1));
    assert_eq!(
        sequences(&run(&mut simulated, 2, BoxSample::default())),
        [[4], [4], [5]]
    );
    simulated.inject(NetbFault::Reorder);
    assert_eq!(
        sequences(&run(&mut simulated, 2, BoxSample::default())),
        [[7], [6]]
    );
    simulated.inject(NetbFault::Corrupt(1));
    let damaged: [Vec<u32>; 2] = [vec![], vec![8]];
    assert_eq!(
        sequences(&run(&mut simulated, 1, BoxSample::default())),
        damaged
    );
    simulated.inject(NetbFault::Saturate(1));
    let sent = run(&mut simulated, 2, BoxSample::default());
    assert_eq!(sent[0].1[0].status, Status(0x8002_0000));
    assert_eq!(sent[1].1[0].status, Status(0));
    simulated.inject(NetbFault::Restart(Duration::ZERO));
    assert!(!simulated.is_streaming());
}

#[test]
fn a_frozen_box_goes_on_counting() {
    let mut simulated = RdtBox::new(None, 1000);
    ask(&mut simulated, Command::RealTime, 0, 1);
    let counts = |sent: &[(u16, Vec<Record>)]| -> Vec<[i32; 6]> {
        sent.iter().map(|(_, records)| records[0].counts).collect()
    };
    let alive = counts(&run(&mut simulated, 5, sample(50_000)));
    assert!(alive.windows(2).all(|w| w[0] != w[1]), "{alive:?}");
    assert!(alive.iter().flatten().all(|c| (c - 50_000).abs() <= 1000));
    simulated.inject(NetbFault::Freeze(true));
    let frozen = run(&mut simulated, 5, sample(90_000));
    assert_eq!(counts(&frozen), [alive[4]; 5]);
    assert_eq!(sequences(&frozen), [[6], [7], [8], [9], [10]]);
    simulated.inject(NetbFault::Freeze(false));
    simulated.inject(NetbFault::StickAxis(Some(2)));
    let stuck = counts(&run(&mut simulated, 5, sample(90_000)));
    assert!(
        stuck
            .windows(2)
            .all(|w| w[0][2] == w[1][2] && w[0][1] != w[1][1])
    );
    simulated.inject(NetbFault::StickAxis(None));
    simulated.inject(NetbFault::Implausible { one_of: 4 });
    let wild = counts(&run(&mut simulated, 40, sample(0)));
    let far = wild.iter().filter(|c| c[0].abs() > 1000).count();
    assert!((8..=10).contains(&far), "{far}");
}

proptest! {
    #[test]
    fn no_request_whatever_breaks_the_box(requests in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..12), 0..20),
                                          faults: [u8; 4]) {
        let mut simulated = RdtBox::new(Some([i32::MIN; 6]), 0);
        simulated.inject(NetbFault::Duplicate(u32::from(faults[0])));
        simulated.inject(NetbFault::Drop(u32::from(faults[1])));
        for bytes in requests {
            simulated.request(&bytes, client(9));
            for _ in 0..3 {
                let sample = BoxSample { counts: [i32::MIN; 6], saturated: true };
                simulated.tick(sample, SETTINGS, |bytes, _| assert!(bytes.len() <= RECORD_LENGTH * RECORDS_MAX));
            }
        }
    }
}
