//! A normal estimator of your own in a separate program: the force without its component along the
//! motion points out of the surface. `docs/write-your-own-estimator.md` explains it.

use std::path::PathBuf;
use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Base, Pose, Tool};
use tangent_runtime::health::instance_name;
use tangent_runtime::{Bus, CellConfig, Role, Stop};
use tangent_schemas::convert::cut;
use tangent_schemas::tangent::{ArmState, NormalEstimate};
use tangent_schemas::topics;

/// Speed below which there is no direction of sliding, m/s.
const SPEED_MIN: f64 = 0.005;
/// Force below which there is no contact, N.
const FORCE_MIN: f64 = 0.6;
/// Share of the last normal in the new one: 10 cycles of low pass.
const MEMORY: f64 = 0.9;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "my_rust".to_owned());
    let cell = match arguments.next() {
        Some(file) => CellConfig::load(&PathBuf::from(file))?,
        None => CellConfig::default_cell(),
    };
    let stop = Stop::on_signals()?;
    let bus = Bus::open_until(&cell, Role::Client, None, &stop)?;
    let arm = bus.subscribe(&topics::ARM_STATE, 8)?;
    let (mut wrench, mut status) = (
        bus.latest(&topics::WRENCH_TOOL)?,
        bus.latest(&topics::WRENCH_STATUS)?,
    );
    let estimates = bus.publisher(&topics::estimate_normal(&name))?;
    let _alive = bus.declare_alive(&topics::estimator_service(&name), &instance_name())?;
    let mut last = None;
    while !stop.is_stopped() {
        let Some(arm) = arm.recv_timeout(Duration::from_millis(50)) else {
            continue;
        };
        let usable = status.get().is_some_and(|s| s.message.validity == 0);
        let (Some(wrench), true) = (wrench.get(), usable) else {
            continue;
        };
        let force = Vector3::from(&wrench.message.wrench.force);
        if let Some(estimate) = estimate(&name, &arm.message, &force, &mut last) {
            estimates.publish(&estimate);
        }
    }
    Ok(())
}

/// One estimate per packet of the robot, with that packet's cycle and stamp. `force`: tool axes, N.
fn estimate(
    name: &str,
    arm: &ArmState,
    force: &Vector3<f64>,
    last: &mut Option<Vector3<f64>>,
) -> Option<NormalEstimate> {
    let pose: Pose<Base, Tool> = (&arm.tool_pose).try_into().ok()?;
    let velocity = Vector3::from(&arm.tool_twist.linear);
    let mut pressing = pose.rotate(force);
    let sliding = velocity.norm() > SPEED_MIN;
    let touching = pressing.norm() >= FORCE_MIN;
    if sliding {
        let way = velocity.normalize();
        pressing -= way * pressing.dot(&way);
    }
    let new = pressing.try_normalize(1e-9).filter(|_| touching);
    *last = match (new, *last) {
        // Friction may have any direction while the tool is at rest.
        (Some(_), Some(old)) if !sliding => Some(old),
        (Some(new), Some(old)) => Some((old * MEMORY + new * (1.0 - MEMORY)).normalize()),
        (new, _) => new,
    };
    let normal = last.unwrap_or_else(|| -pose.z_axis());
    let sigma_rad: f64 = if sliding { 0.05 } else { 0.3 };
    let across = Matrix3::identity() - normal * normal.transpose();
    Some(NormalEstimate {
        header: arm.header.clone(),
        cycle: arm.cycle,
        estimator: cut(name),
        point: arm.tool_pose.position.clone(),
        normal: (&normal).into(),
        covariance: std::array::from_fn(|i| sigma_rad.powi(2) * across[(i / 3, i % 3)]),
        validity: if touching { 0 } else { 6 },
        reason: cut(if touching { "valid" } else { "no contact" }),
        friction: -1.0,
        ..NormalEstimate::default()
    })
}
