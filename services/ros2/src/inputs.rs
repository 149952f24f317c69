//! Topics of ROS 2 that are let into the cell, each after a check of its sender and content.

use std::sync::{Mutex, PoisonError};

use tangent_runtime::clock::stamp_ns;
use tangent_runtime::{Bus, BusError, Gauge, Handle, HealthReporter, PlainSample, Publisher, Rate};
use tangent_schemas::standard::{CameraInfo, Image, PoseWithCovarianceStamped, WrenchStamped};
use tangent_schemas::topics::{Delivery, Topic};
use tangent_schemas::{Message, cdr};

use crate::config::{Input, InputKind};
use crate::names::{RosType, publisher_of};
use crate::node::{Endpoint, Node};
use crate::one_source::OneSource;
use crate::troubles::Troubles;
use crate::type_hash;

/// An input that is open until this is dropped.
pub struct OpenInput {
    _endpoint: Endpoint,
    _publishers: Handle,
}

/// A message whose content can be checked.
pub trait Checked: Message {
    /// How the cell's readers get it.
    const DELIVERY: Delivery;

    /// What is wrong with it; `None` for a message that the cell may read. Its readers check the
    /// rest, such as limits.
    fn fault(&self) -> Option<&'static str>;
}

const NOT_FINITE: Option<&str> = Some("a number is not finite");

fn all_finite<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> bool {
    numbers.into_iter().all(|number| number.is_finite())
}

impl Checked for PoseWithCovarianceStamped {
    const DELIVERY: Delivery = Delivery::RealTime;

    fn fault(&self) -> Option<&'static str> {
        let pose = &self.pose.pose;
        let (p, o) = (&pose.position, &pose.orientation);
        let finite = all_finite(&[p.x, p.y, p.z, o.x, o.y, o.z, o.w]);
        if finite && all_finite(&self.pose.covariance.0) {
            return None;
        }
        NOT_FINITE
    }
}

impl Checked for WrenchStamped {
    const DELIVERY: Delivery = Delivery::RealTime;

    fn fault(&self) -> Option<&'static str> {
        let (f, t) = (&self.wrench.force, &self.wrench.torque);
        if all_finite(&[f.x, f.y, f.z, t.x, t.y, t.z]) {
            return None;
        }
        NOT_FINITE
    }
}

impl Checked for Image {
    const DELIVERY: Delivery = Delivery::Bulk;

    fn fault(&self) -> Option<&'static str> {
        let bytes = u64::from(self.step) * u64::from(self.height);
        match () {
            () if self.width == 0 || self.height == 0 => Some("an image without pixels"),
            () if bytes != self.data.len() as u64 => {
                Some("an image whose data is not step × height")
            }
            () => None,
        }
    }
}

impl Checked for CameraInfo {
    const DELIVERY: Delivery = Delivery::Background;

    fn fault(&self) -> Option<&'static str> {
        let numbers = self.d.iter().chain(&self.k).chain(&self.r).chain(&self.p);
        match () {
            () if !all_finite(numbers) => NOT_FINITE,
            () if self.width == 0 || self.height == 0 => Some("a calibration without a size"),
            () => None,
        }
    }
}

/// Opens one input.
///
/// # Errors
/// The bus or the session refuses it.
pub fn open(
    input: &Input,
    bus: &Bus,
    node: &Node,
    troubles: &Troubles,
    health: &HealthReporter,
) -> Result<OpenInput, BusError> {
    let open = match input.kind {
        InputKind::BasePose => open_as::<PoseWithCovarianceStamped>,
        InputKind::Wrench => open_as::<WrenchStamped>,
        InputKind::Image => open_as::<Image>,
        InputKind::CameraInfo => open_as::<CameraInfo>,
    };
    open(input, bus, node, troubles, health)
}

fn open_as<M: Checked>(
    input: &Input,
    bus: &Bus,
    node: &Node,
    troubles: &Troubles,
    health: &HealthReporter,
) -> Result<OpenInput, BusError> {
    let hash = type_hash::of_message(M::NAME);
    let of = hash.and_then(|hash| RosType::new(M::NAME, hash));
    let of = of.expect("the definitions of all inputs ship, and a test computes their hashes");
    let gate = Mutex::new(Gate {
        topic: input.topic.clone(),
        publisher: bus.publisher(&Topic::<M>::named(input.key.clone(), M::DELIVERY))?,
        source: OneSource::default(),
        troubles: troubles.clone(),
        let_in: health.rate(&input.key),
        refused: health.gauge(&format!("{}_refused", input.key)),
    });
    let endpoint = node.subscription(&input.topic, &of, move |sample| {
        let mut gate = gate.lock().unwrap_or_else(PoisonError::into_inner);
        gate.take(&sample);
    })?;
    let troubles = troubles.clone();
    let publishers = node.on_publishers(&input.topic, move |token, appears| {
        let Some(seen) = publisher_of(token) else {
            return;
        };
        if seen.wire_name == of.wire_name && seen.hash == of.hash {
            return;
        }
        if appears {
            troubles.begin(
                token,
                format!(
                    "{}: {} publishes {} with hash {}, which is not received: it must be {} with {}",
                    seen.topic,
                    seen.node,
                    seen.wire_name,
                    short(&seen.hash),
                    of.wire_name,
                    short(&of.hash)
                ),
            );
        } else {
            troubles.end(token);
        }
    })?;
    Ok(OpenInput {
        _endpoint: endpoint,
        _publishers: publishers,
    })
}

/// Enough of a hash to tell two apart.
fn short(hash: &str) -> String {
    hash.chars().take(15).collect()
}

struct Gate<M: Checked> {
    topic: String,
    publisher: Publisher<M>,
    source: OneSource,
    troubles: Troubles,
    let_in: Rate,
    refused: Gauge,
}

impl<M: Checked> Gate<M> {
    /// Lets one message in, or refuses it and says why.
    fn take(&mut self, sample: &PlainSample) {
        match self.judge(sample) {
            Ok(message) => {
                self.publisher.publish(&message);
                self.let_in.tick();
            }
            Err(why) => {
                self.refused.set(self.refused.get() + 1.0);
                self.troubles
                    .event(&self.topic, format!("{}: {why}", self.topic));
            }
        }
    }

    /// Content is judged before the sender: a publisher of nonsense must not keep others out.
    fn judge(&mut self, sample: &PlainSample) -> Result<M, String> {
        let message: M = cdr::decode(&sample.payload).map_err(|error| error.to_string())?;
        if let Some(fault) = message.fault() {
            return Err(fault.to_owned());
        }
        let at_ns = stamp_ns(sample.received);
        self.source
            .admit(sample.attachment, sample.received, at_ns)
            .map_err(|why| why.to_string())?;
        Ok(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_not_finite_are_faults_wherever_they_are() {
        let mut pose = PoseWithCovarianceStamped::default();
        assert_eq!(pose.fault(), None);
        pose.pose.covariance.0[35] = f64::NAN;
        assert!(pose.fault().is_some());
        pose.pose.covariance.0[35] = 0.0;
        pose.pose.pose.orientation.w = f64::INFINITY;
        assert!(pose.fault().is_some());
        let mut wrench = WrenchStamped::default();
        assert_eq!(wrench.fault(), None);
        wrench.wrench.torque.z = f64::NEG_INFINITY;
        assert!(wrench.fault().is_some());
        let mut info = CameraInfo {
            width: 2,
            height: 1,
            ..CameraInfo::default()
        };
        assert_eq!(info.fault(), None);
        info.d.push(f64::NAN);
        assert!(info.fault().is_some());
        info.d.clear();
        info.width = 0;
        assert!(info.fault().is_some());
    }

    #[test]
    fn an_image_has_the_bytes_that_it_states() {
        let mut image = Image {
            width: 2,
            height: 2,
            step: 4,
            data: vec![0; 8],
            ..Image::default()
        };
        assert_eq!(image.fault(), None);
        image.step = u32::MAX;
        image.height = u32::MAX;
        assert!(image.fault().is_some());
        image.height = 0;
        assert!(image.fault().is_some());
    }
}
