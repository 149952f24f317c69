//! Id of the publisher in a channel's metadata.

use std::collections::BTreeMap;

/// Id for an unknown publisher, and for publishers beyond the limit.
pub(crate) const UNKNOWN_PUBLISHER: [u8; 16] = [0; 16];

/// Hexadecimal digits of a publisher's id.
pub(crate) fn text(publisher: &[u8; 16]) -> String {
    format!("{:032x}", u128::from_be_bytes(*publisher))
}

/// The id from its hexadecimal digits.
pub(crate) fn parse(text: &str) -> Option<[u8; 16]> {
    let id = u128::from_str_radix(text, 16).ok()?;
    (text.len() == 32).then(|| id.to_be_bytes())
}

/// Publisher of a channel; zeros if the metadata do not state it.
pub(crate) fn of_channel(metadata: &BTreeMap<String, String>) -> [u8; 16] {
    let publisher = metadata.get("publisher").and_then(|p| parse(p));
    publisher.unwrap_or_default()
}
