//! Text of the message definitions that are stored with the messages.

use std::collections::HashMap;

use tangent_schemas::definition;

/// Text of each message type's definition, composed once.
#[derive(Default)]
pub struct Definitions(HashMap<String, Option<String>>);

impl Definitions {
    /// Definition of a message type; `None` if this version does not know the type.
    pub fn of(&mut self, type_name: &str) -> Option<&str> {
        if !self.0.contains_key(type_name) {
            let text = definition::definition(type_name);
            if text.is_none() {
                tracing::warn!(
                    "`{type_name}` is not a message of this version: recorded and forwarded without its definition"
                );
            }
            self.0.insert(type_name.to_owned(), text);
        }
        self.0.get(type_name)?.as_deref()
    }
}
