//! A client with a server for each of the three connections.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};

use tangent_simulated_ur::SimulatedUr;
use tangent_simulated_ur::controller::Summary;

use crate::common::{PATIENCE, connect};

/// Millionths, as in all messages.
fn millionths(x: f64) -> i32 {
    (x * 1e6).round() as i32
}

#[derive(Clone, Copy)]
pub enum Mode {
    Stopped = -2,
    Idle = 0,
    ServoJ = 1,
    SpeedJ = 2,
    Forward = 3,
    SpeedL = 4,
    Freedrive = 6,
}

/// A point of a trajectory: two blocks of six numbers, speed, acceleration, duration, kind.
#[derive(Clone, Copy)]
pub struct Point {
    first: [f64; 6],
    second: [f64; 6],
    v: f64,
    a: f64,
    t: f64,
    kind: i32,
}

impl Point {
    fn new(first: [f64; 6], v: f64, a: f64, kind: i32) -> Self {
        Self {
            first,
            second: [0.0; 6],
            v,
            a,
            t: 0.0,
            kind,
        }
    }
    pub fn joints(q: [f64; 6]) -> Self {
        Self::new(q, 1.0, 2.0, 0)
    }
    pub fn line(pose: [f64; 6]) -> Self {
        Self::new(pose, 0.2, 1.0, 1)
    }
    pub fn arc(via: [f64; 6], to: [f64; 6]) -> Self {
        Self {
            second: via,
            ..Self::new(to, 0.2, 1.0, 3)
        }
    }
    pub fn cubic_spline(q: [f64; 6], qd: [f64; 6], t: f64) -> Self {
        Self {
            second: qd,
            t,
            ..Self::new(q, 0.0, 0.0, 51)
        }
    }
    pub fn slow(self) -> Self {
        Self { v: 0.1, ..self }
    }
}

pub struct Client<'c> {
    cell: &'c SimulatedUr,
    commands: TcpStream,
    points: TcpStream,
    orders: TcpStream,
    _script: TcpStream,
}

impl<'c> Client<'c> {
    /// Uploads the program, and waits for its connections.
    pub fn start(cell: &'c SimulatedUr) -> Self {
        let servers: [TcpListener; 3] =
            std::array::from_fn(|_| TcpListener::bind("127.0.0.1:0").unwrap());
        let mut text = include_str!("program.urscript").to_owned();
        for (name, server) in ["@POINTS@", "@ORDERS@", "@COMMANDS@"].iter().zip(&servers) {
            let port = server.local_addr().unwrap().port().to_string();
            text = text.replace(name, &port);
        }
        let mut script = connect(cell.endpoints().primary);
        script.write_all(text.as_bytes()).unwrap();
        let [points, orders, commands] = servers.map(|server| {
            let (stream, _) = server.accept().unwrap();
            stream.set_nodelay(true).unwrap();
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
            stream
        });
        Self {
            cell,
            commands,
            points,
            orders,
            _script: script,
        }
    }

    fn summary(&self) -> Summary {
        self.cell.snapshot().unwrap().summary
    }

    pub fn q(&self) -> [f64; 6] {
        self.summary().q.into()
    }

    pub fn pose(&self) -> [f64; 6] {
        self.summary().tcp_pose
    }

    pub fn next_cycle(&self) {
        let now = self.cell.snapshot().unwrap().cycles;
        assert!(self.cell.wait_for(PATIENCE, |s| s.cycles > now));
    }

    fn send(stream: &mut TcpStream, numbers: &[i32]) {
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_be_bytes()).collect();
        stream.write_all(&bytes).unwrap();
    }

    /// Time in which the next command must follow, ms: modes that stand have none.
    fn timeout_ms(mode: Mode) -> i32 {
        match mode {
            Mode::ServoJ | Mode::SpeedJ | Mode::SpeedL => 200,
            _ => 0,
        }
    }

    pub fn command(&mut self, six: [f64; 6], mode: Mode) {
        let mut numbers = [0; 8];
        numbers[0] = Self::timeout_ms(mode);
        for (number, x) in numbers[1..7].iter_mut().zip(six) {
            *number = millionths(x);
        }
        numbers[7] = mode as i32;
        Self::send(&mut self.commands, &numbers);
    }

    /// Repeats a command in every cycle until the condition holds.
    pub fn hold(&mut self, six: [f64; 6], mode: Mode, until: impl Fn(&Summary) -> bool) {
        let deadline = std::time::Instant::now() + PATIENCE;
        while !until(&self.summary()) {
            assert!(std::time::Instant::now() < deadline);
            self.command(six, mode);
            self.next_cycle();
        }
    }

    fn forward(&mut self, action: i32, points: i32) {
        let mode = Mode::Forward;
        let numbers = [
            Self::timeout_ms(mode),
            action,
            points,
            0,
            0,
            0,
            0,
            mode as i32,
        ];
        Self::send(&mut self.commands, &numbers);
    }

    pub fn begin(&mut self, points: i32) {
        self.forward(1, points);
    }

    pub fn cancel(&mut self) {
        self.forward(-1, 0);
    }

    pub fn point(&mut self, point: &Point) {
        let third = [point.v, point.a, 0.0, 0.0, 0.0, 0.0];
        let blocks = [point.first, point.second, third];
        let mut numbers: Vec<i32> = blocks.iter().flatten().map(|x| millionths(*x)).collect();
        numbers.extend([millionths(point.t), 1, point.kind]);
        Self::send(&mut self.points, &numbers);
    }

    /// Result of a trajectory: 0 success, 1 cancelled, 2 failure.
    pub fn result(&mut self) -> i32 {
        let mut bytes = [0; 4];
        self.points.read_exact(&mut bytes).unwrap();
        i32::from_be_bytes(bytes)
    }

    pub fn travel(&mut self, points: &[Point]) -> i32 {
        self.begin(points.len() as i32);
        for point in points {
            self.point(point);
        }
        self.result()
    }

    pub fn order(&mut self, number: i32, values: &[f64]) {
        let mut numbers = [0; 28];
        numbers[0] = number;
        for (number, x) in numbers[1..].iter_mut().zip(values) {
            *number = millionths(*x);
        }
        Self::send(&mut self.orders, &numbers);
    }
}
