//! Type hashes of ROS 2 (RIHS01, REP-2016): SHA-256 of a type's description as JSON.
//!
//! Two programs exchange messages only if both have the same hash, which is part of the key. It is
//! computed from the `.msg` and `.srv` files, so that no table can go out of date.

use std::collections::BTreeMap;
use std::fmt::Write;

use sha2::{Digest, Sha256};
use tangent_schemas::definition::{self, Base, Count, Field, fields};

/// Bound of the sequences in a service's event: one request, one response.
const EVENT_BOUND: usize = 1;
/// Name of the header of a service's events.
const EVENT_INFO: &str = "service_msgs/msg/ServiceEventInfo";
/// Its definition, as ROS 2 has it; the cell itself has no use for it.
const EVENT_INFO_TEXT: &str =
    "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number\n";
/// `std_srvs/srv/Trigger`, as ROS 2 has it.
const TRIGGER_TEXT: &str = "---\nbool success\nstring message\n";

/// Hash of a message `PACKAGE/msg/NAME`, as `RIHS01_` and 64 hexadecimal digits. `None` for a type
/// without a `.msg` file here.
pub fn of_message(name: &str) -> Option<String> {
    let mut types = Types::default();
    types.add_message(name)?;
    types.hash(name)
}

/// Hash of a service `PACKAGE/srv/NAME`. `None` for a service without a `.srv` file here.
pub fn of_service(name: &str) -> Option<String> {
    let text = match name {
        "std_srvs/srv/Trigger" => TRIGGER_TEXT,
        _ => definition::service(name)?,
    };
    let mut types = Types::default();
    types.add_service(name, text)?;
    types.hash(name)
}

/// Descriptions by name, in the order of the names.
#[derive(Default)]
struct Types(BTreeMap<String, String>);

impl Types {
    fn add_message(&mut self, name: &str) -> Option<()> {
        if self.0.contains_key(name) {
            return Some(());
        }
        let text = match name {
            EVENT_INFO => EVENT_INFO_TEXT,
            _ => definition::file(name)?,
        };
        self.add(name, text)
    }

    fn add(&mut self, name: &str, text: &str) -> Option<()> {
        let package = name.split('/').next()?;
        let members = fields(text, package);
        let mut described = Vec::new();
        for field in &members {
            described.push(describe(field)?);
        }
        if described.is_empty() {
            described.push(member("structure_needs_at_least_one_member", 3, 0, ""));
        }
        self.0.insert(name.to_owned(), individual(name, &described));
        for field in members {
            if let Base::Message(inner) = field.base {
                self.add_message(&inner)?;
            }
        }
        Some(())
    }

    /// A service is described by its request, its response, and an event that holds either.
    fn add_service(&mut self, name: &str, text: &str) -> Option<()> {
        let (request, response) = match text.split_once("\n---") {
            Some(parts) => parts,
            None => ("", text.strip_prefix("---")?),
        };
        let part = |what: &str| format!("{name}_{what}");
        self.add(&part("Request"), request)?;
        self.add(&part("Response"), response)?;
        self.add_message(EVENT_INFO)?;
        let nested = kind("nested")?;
        let event = [
            member("info", nested, 0, EVENT_INFO),
            member("request", nested + BOUNDED, EVENT_BOUND, &part("Request")),
            member("response", nested + BOUNDED, EVENT_BOUND, &part("Response")),
        ];
        self.0
            .insert(part("Event"), individual(&part("Event"), &event));
        let whole = [
            member("request_message", nested, 0, &part("Request")),
            member("response_message", nested, 0, &part("Response")),
            member("event_message", nested, 0, &part("Event")),
        ];
        self.0.insert(name.to_owned(), individual(name, &whole));
        Some(())
    }

    fn hash(&self, name: &str) -> Option<String> {
        let main = self.0.get(name)?;
        let referenced: Vec<&str> = self
            .0
            .iter()
            .filter(|(other, _)| *other != name)
            .map(|(_, text)| text.as_str())
            .collect();
        let json = format!(
            "{{\"type_description\": {main}, \"referenced_type_descriptions\": [{}]}}",
            referenced.join(", ")
        );
        let mut hash = "RIHS01_".to_owned();
        for byte in Sha256::digest(json.as_bytes()) {
            let _ = write!(hash, "{byte:02x}");
        }
        Some(hash)
    }
}

/// Distance of the numbers of a fixed array, of a bounded and of an unbounded sequence from that of
/// one value.
const FIXED: u8 = 48;
const BOUNDED: u8 = 96;
const SEQUENCE: u8 = 144;

/// Number of a type in `type_description_interfaces/msg/FieldType`.
fn kind(name: &str) -> Option<u8> {
    Some(match name {
        "nested" => 1,
        "int8" => 2,
        // `char` is an alias in a .msg file.
        "uint8" | "char" => 3,
        "int16" => 4,
        "uint16" => 5,
        "int32" => 6,
        "uint32" => 7,
        "int64" => 8,
        "uint64" => 9,
        "float32" => 10,
        "float64" => 11,
        "bool" => 15,
        "byte" => 16,
        "string" => 17,
        _ => return None,
    })
}

fn describe(field: &Field) -> Option<String> {
    let (one, nested) = match &field.base {
        Base::Primitive(name) => (kind(name)?, ""),
        Base::Message(name) => (kind("nested")?, name.as_str()),
    };
    Some(match field.count {
        Count::One => member(&field.name, one, 0, nested),
        Count::Fixed(length) => member(&field.name, one + FIXED, length, nested),
        Count::Sequence => member(&field.name, one + SEQUENCE, 0, nested),
    })
}

// Names consist of letters, digits, `_` and `/`, so that nothing has to be escaped.
fn member(name: &str, kind: u8, capacity: usize, nested: &str) -> String {
    format!(
        "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {kind}, \"capacity\": {capacity}, \
         \"string_capacity\": 0, \"nested_type_name\": \"{nested}\"}}}}"
    )
}

fn individual(name: &str, members: &[String]) -> String {
    format!(
        "{{\"type_name\": \"{name}\", \"fields\": [{}]}}",
        members.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As in the design document of rmw_zenoh, and as ROS 2 Jazzy puts them into its keys.
    #[test]
    fn hashes_are_those_that_ros_publishes() {
        let mut types = Types::default();
        types.add("std_msgs/msg/String", "string data\n").unwrap();
        assert_eq!(
            types.hash("std_msgs/msg/String").unwrap(),
            "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
        );
        for (name, hash) in [
            (
                "geometry_msgs/msg/Twist",
                "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
            ),
            (
                "sensor_msgs/msg/Image",
                "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
            ),
        ] {
            assert_eq!(of_message(name).unwrap(), hash, "{name}");
        }
        assert_eq!(
            of_service("std_srvs/srv/Trigger").unwrap(),
            "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
        );
        let (name, text) = (
            "example_interfaces/srv/AddTwoInts",
            "int64 a\nint64 b\n---\nint64 sum\n",
        );
        let mut types = Types::default();
        types.add_service(name, text).unwrap();
        assert_eq!(
            types.hash(name).unwrap(),
            "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
        );
    }

    #[test]
    fn every_type_of_the_cell_has_a_hash_of_its_own() {
        let mut seen = std::collections::BTreeSet::new();
        for (name, _) in definition::FILES {
            let hash = of_message(name).unwrap_or_else(|| panic!("{name}"));
            assert!(hash.starts_with("RIHS01_") && hash.len() == 71, "{hash}");
            assert!(seen.insert(hash), "{name}");
        }
        for (name, _) in definition::SERVICES {
            assert!(seen.insert(of_service(name).unwrap()), "{name}");
        }
        assert_eq!(of_message("nobody_msgs/msg/Nothing"), None);
        assert_eq!(of_service("nobody_msgs/srv/Nothing"), None);
    }
}
