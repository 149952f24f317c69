#![allow(clippy::unwrap_used)]
#![allow(missing_docs)]
mod cell;
mod fault;

use cell::Cell;
use fault::Fault;

#[test]
fn explore() {
    let only = std::env::var("ONLY").unwrap_or_default();
    let start = std::time::Instant::now();
    let cell = Cell::sliding();
    println!("sliding at {} took {:?}", cell.cycle, start.elapsed());
    let start = std::time::Instant::now();
    let cell = Cell::sliding();
    println!("sliding at {} took {:?}", cell.cycle, start.elapsed());
    for fault in Fault::ALL {
        if !format!("{fault:?}").contains(&only) { continue; }
        for offset in [0, 41, 333] {
        let mut cell = Cell::sliding();
        cell.steps(offset);
        cell.faults = vec![fault];
        let mut last = String::new();
        print!("{fault:?} {offset}: ");
        let act = cell.activation();
        let mut given = cell.given();
        let mut same = 0;
        for k in 1..=1500 {
            cell.step();
            if cell.given() == given { same += 1; }
            given = cell.given();
            let now = format!("{:?} {:?} l{} {:?}", cell.phase(), cell.output.and_then(|o| o.fault), u8::from(cell.gate().activation_latched >= act), cell.gate().refusal.map(|r| format!("{r:?}").chars().take(5).collect::<String>()));
            if now != last {
                print!("[{k} {now}]");
                last = now;
            }
        }
        let during = cell.peak_n;
        cell.faults.clear();
        let mut rest = None;
        for k in 1..=3000 {
            cell.step();
            if cell.robot_speed() < 1e-3 { rest.get_or_insert(k); } else { rest = None; }
        }
        print!(" same {same} missed {} refused {}", cell.gate().missed, cell.gate().refused);
        let (force, peak) = (cell.truth().wrench.force.norm(), cell.peak_n);
        let start = if cell.phase().is_active() { "runs".to_owned() } else {
            let said = format!("{:?}", cell.start_task().err());
            let began = cell.cycle;
            for _ in 0..15000 { cell.step(); if cell.phase() == tangent_control::Phase::Slide || !cell.phase().is_active() { break; } }
            let mut off = 0.0_f64;
            for _ in 0..500 { cell.step(); if let Some(n) = cell.output.unwrap().force_n { let t = cell.truth(); off = off.max((n - t.wrench.force.dot(&t.normal)).abs()); } }
            format!("{said} -> {:?} {:?} after {} shown off {off:.2}", cell.phase(), cell.output.and_then(|o| o.fault), cell.cycle - began)
        };
        println!(" peak {during:.1} {peak:.1} {:.1} N rest {rest:?} force {force:.2}; start {start}", cell.peak_n);
        }
    }
}
