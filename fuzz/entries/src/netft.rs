//! ATI Net F/T: RDT records with the counters and the clock of the stream, and the web server's
//! answer with the values computed from it.

use std::time::Duration;

use tangent_netft::BoxConfig;
use tangent_netft::clock::ClockRecovery;
use tangent_netft::codec::{Command, Request, records};
use tangent_netft::stream::{Kind, Stream};

/// Datagrams of 36-byte records, each passed to the counters and the clock of the stream.
pub fn rdt_records(data: &[u8]) {
    let _ = Request::from_bytes(data);
    let mut stream = Stream::new(Command::RealTime, 7000.0, Duration::from_millis(50));
    let mut clock = ClockRecovery::new(1.0 / 7000.0);
    let mut now = Duration::ZERO;
    let mut taken = 0;
    for datagram in data.chunks(36 * 3) {
        now += Duration::from_micros(143);
        let _ = stream.poll(now);
        let Ok(records) = records(datagram) else {
            stream.malformed();
            continue;
        };
        for record in records {
            taken += 1;
            let _ = (record.status.condition(), record.status.names().count());
            let (sequence, kind) = stream.take(&record, now);
            if matches!(kind, Kind::First) {
                clock.restart();
            }
            let arrival_ns = now.as_nanos() as i64;
            let _ = clock.observe(sequence, arrival_ns);
            let _ = clock.stamp(sequence, arrival_ns);
            assert!(clock.residual_s().is_finite() && clock.rate_hz().is_finite());
        }
    }
    let counts = stream.counts();
    assert_eq!(counts.records + counts.doubles, taken);
}

/// The box's `/netftapi2.xml`, and all values computed from it.
pub fn box_xml(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let Ok(config) = BoxConfig::parse(text) else {
        return;
    };
    for scale in config.scales() {
        assert!(scale.is_finite() && scale > 0.0, "{scale} per count");
    }
    let rate_hz = config.rate_hz.unwrap_or(7000.0);
    let mut clock = ClockRecovery::new(1.0 / rate_hz);
    let mut stream = Stream::new(Command::RealTime, rate_hz, Duration::from_millis(50));
    for n in 0..4_u32 {
        let now = Duration::from_millis(u64::from(n));
        let record = tangent_netft::codec::Record {
            rdt_sequence: n,
            ft_sequence: n.saturating_mul(u32::try_from(stream.step()).unwrap_or(1)),
            ..Default::default()
        };
        let (sequence, _) = stream.take(&record, now);
        let stamp = clock.observe(sequence, now.as_nanos() as i64);
        assert!(stamp.unsigned_abs() < 1 << 62);
    }
}
