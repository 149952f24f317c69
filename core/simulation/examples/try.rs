//! Runs a scenario file and prints figures; a development aid.
use std::time::Instant;
fn main() {
    let mut args = std::env::args().skip(1);
    let file = args.next().expect("file");
    let mut trace = None;
    let mut sets = Vec::new();
    for a in args {
        if let Some(t) = a.strip_prefix("trace=") {
            trace = Some(t.to_owned())
        } else {
            sets.push(a)
        }
    }
    let text = std::fs::read_to_string(&file).expect("read");
    let dir = std::path::Path::new(&file)
        .parent()
        .map(|p| p.to_owned())
        .unwrap_or_default();
    let s = match tangent_simulation::Scenario::parse(&file, &text, &sets, &|n| {
        std::fs::read_to_string(dir.join(n)).map_err(|e| e.to_string())
    }) {
        Ok(s) => s,
        Err(e) => {
            println!("{e}");
            std::process::exit(2)
        }
    };
    let t = Instant::now();
    let r = match tangent_simulation::evaluate(&s) {
        Ok(r) => r,
        Err(e) => {
            println!("{e}");
            std::process::exit(2)
        }
    };
    let r = r.with_wall_time(t.elapsed().as_secs_f64());
    println!("{}", serde_json::to_string_pretty(&r).unwrap());
    if let Some(every) = trace {
        let every: usize = every.parse().unwrap();
        let mut i = 0;
        let _ = tangent_simulation::evaluate_with(&s, |c| {
            if i % every == 0 {
                let t = c.truth;
                let n = c
                    .estimate
                    .map(|e| tangent_simulation::metrics::angle_deg(&e.normal, &t.normal))
                    .unwrap_or(-1.0);
                println!(
                    "{:7.3} {:8} Ft {:6.3} Fm {:6.3} ref {:5.2} tool {:6.2} est {:6.2} al {:6.2} v {:6.4} pe {:7.4} d {:7.0} k {:7.0} p {:.3?} w {:.2?} val {:?} vc {:.4} va {:.4} wc {:.3} wa {:.3} man {:.3} q {:.2?} qd {:.2?}",
                    c.arm.time_s,
                    c.output.phase.name(),
                    t.wrench.force.dot(&t.normal),
                    c.output.force_n,
                    c.output.force_reference_n,
                    tangent_simulation::metrics::angle_deg(&t.normal, &-t.base_from_tool.z_axis()),
                    n,
                    c.output.alignment_error_rad.to_degrees(),
                    t.sliding_speed_m_per_s,
                    c.output.path_error_m,
                    c.output.damping_n_s_per_m,
                    c.output.stiffness_n_per_m,
                    t.base_from_tool.translation().as_slice(),
                    c.input.wrench.force.as_slice(),
                    c.estimate.map(|e| e.validity),
                    c.output.twist_commanded.linear.dot(&t.normal),
                    c.input.twist.linear.dot(&t.normal),
                    c.output.twist_commanded.angular.norm(),
                    c.input.twist.angular.norm(),
                    c.output.manipulability,
                    c.arm.q.as_slice(),
                    c.output.qd.as_slice()
                );
            }
            i += 1;
        });
    }
}
