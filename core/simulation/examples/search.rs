use tangent_mechanics::manipulability;
use tangent_simulation::{Plant, Scenario};
fn main() {
    let mut args = std::env::args().skip(1);
    let file = args.next().unwrap();
    let corners: Vec<[f64; 3]> = args.next().unwrap().split(';').map(|c| { let v: Vec<f64> = c.split(',').map(|x| x.parse().unwrap()).collect(); [v[0], v[1], v[2]] }).collect();
    let sets: Vec<String> = args.collect();
    let text = std::fs::read_to_string(&file).unwrap();
    let s = Scenario::parse(&file, &text, &sets, &|_| Err("no".into())).unwrap();
    let mut best: Vec<(f64, [f64; 6], String)> = vec![];
    let mut x: u64 = 12345;
    let mut rnd = || { x = x.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); (x >> 11) as f64 / (1u64 << 53) as f64 };
    for _ in 0..150 {
        let seed: [f64; 6] = std::array::from_fn(|_| (rnd() - 0.5) * 6.0);
        let yaw = (rnd() * 8.0).floor() * std::f64::consts::FRAC_PI_4;
        let mut c = s.plant.clone();
        c.start.yaw_rad = yaw;
        c.start.seed_rad = Some(seed);
        let mut worst = f64::INFINITY;
        let mut first = None;
        let mut jump: f64 = 0.0;
        let mut big: f64 = 0.0;
        for k in &corners {
            c.start.near_m = *k;
            let Ok(p) = Plant::new(&c, 1) else { worst = -1.0; break };
            let q = p.joints();
            if let Some(prev) = c.start.seed_rad { if first.is_some() { for i in 0..6 { jump = jump.max((prev[i] - q[i]).abs()); } } }
            big = big.max(q.amax());
            if first.is_none() { first = Some(std::array::from_fn(|i| q[i])); }
            c.start.seed_rad = Some(std::array::from_fn(|i| q[i]));
            let j = p.model().jacobian_at(&q, &p.flange_from_tool());
            worst = worst.min(manipulability(&j));
        }
        if worst > 0.0 && jump < 2.0 && big < 5.5 { best.push((worst, first.unwrap(), format!("yaw {yaw:.3} jump {jump:.2} big {big:.2}"))); }
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    for b in best.iter().take(3) { println!("{:.4} {:.2?} {}", b.0, b.1, b.2); }
}
