//! Names of ROS 2 on the wire of rmw_zenoh: types, keys, QoS and liveliness tokens.
//!
//! A topic of ROS 2 is the key `DOMAIN/TOPIC/TYPE/HASH`. The graph (nodes, topics, services) is
//! made of liveliness tokens `@ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME`, for
//! an endpoint followed by `/TOPIC/TYPE/HASH/QOS`, with `%` in place of `/` in names. See the
//! design document of rmw_zenoh (docs/design.md in ros2/rmw_zenoh).

use sha2::{Digest, Sha256};
use tangent_runtime::config::is_ros_name;

/// First part of all liveliness tokens.
pub const TOKENS: &str = "@ros2_lv";
/// An empty name in a token.
const NOTHING: &str = "%";

/// A type and its hash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosType {
    /// Name as on the wire, `PACKAGE::msg::dds_::NAME_`.
    pub wire_name: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub hash: String,
}

impl RosType {
    /// A type by its ROS 2 name, `PACKAGE/msg/NAME` or `PACKAGE/srv/NAME`, and its hash.
    pub fn new(name: &str, hash: String) -> Option<Self> {
        let mut parts = name.split('/');
        let (package, kind, short) = (parts.next()?, parts.next()?, parts.next()?);
        Some(Self {
            wire_name: format!("{package}::{kind}::dds_::{short}_"),
            hash,
        })
    }
}

/// Quality of service, as far as it differs between endpoints here: all are volatile, without
/// deadline and lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether the endpoint is reliable, not best effort.
    pub reliable: bool,
    /// Number of messages kept.
    pub depth: u32,
}

impl Qos {
    /// States: reliable, the last ten; this is what `ros2 topic echo` and RViz expect.
    pub const STATES: Self = Self {
        reliable: true,
        depth: 10,
    };
    /// Inputs of a sensor: best effort, so that publishers of both kinds match.
    pub const SENSOR: Self = Self {
        reliable: false,
        depth: 5,
    };
    /// Services.
    pub const SERVICES: Self = Self::STATES;

    /// The last part of a token: reliability, durability, history and depth, deadline, lifespan,
    /// liveliness; empty where rmw_zenoh has its default.
    pub fn on_the_wire(self) -> String {
        let reliability = if self.reliable { "" } else { "2" };
        format!("{reliability}::,{}:,:,:,,", self.depth)
    }
}

/// Kind of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Publishes messages.
    Publisher,
    /// Receives messages.
    Subscription,
    /// Answers requests.
    Service,
}

impl Kind {
    fn on_the_wire(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Service => "SS",
        }
    }
}

/// A node of ROS 2, and the session that it belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// Domain of ROS 2.
    pub domain: u32,
    /// Id of the Zenoh session, hexadecimal.
    pub session: String,
    /// Namespace with its leading slash, as in `/cell1`.
    pub namespace: String,
    /// Name without slashes.
    pub name: String,
}

/// Number of the node within its session; a session has one here.
const NODE_ID: u64 = 0;

impl NodeName {
    /// Liveliness token of the node itself.
    pub fn token(&self) -> String {
        self.start(NODE_ID, "NN")
    }

    /// Liveliness token of one of its endpoints; `id` is unique in the session, and not 0.
    pub fn endpoint_token(
        &self,
        id: u64,
        kind: Kind,
        topic: &str,
        of: &RosType,
        qos: Qos,
    ) -> String {
        format!(
            "{}/{}/{}/{}/{}",
            self.start(id, kind.on_the_wire()),
            mangled(topic),
            of.wire_name,
            of.hash,
            qos.on_the_wire()
        )
    }

    /// Pattern of the tokens of all publishers of `topic` in this domain, of whatever type.
    pub fn publishers_of(&self, topic: &str) -> String {
        format!(
            "{TOKENS}/{}/*/*/*/MP/*/*/*/{}/**",
            self.domain,
            mangled(topic)
        )
    }

    fn start(&self, id: u64, kind: &str) -> String {
        format!(
            "{TOKENS}/{}/{}/{NODE_ID}/{id}/{kind}/{NOTHING}/{}/{}",
            self.domain,
            self.session,
            mangled(&self.namespace),
            self.name
        )
    }

    /// Key of a topic's messages, or of a service's requests.
    pub fn key(&self, topic: &str, of: &RosType) -> String {
        let topic = topic.trim_matches('/');
        format!("{}/{topic}/{}/{}", self.domain, of.wire_name, of.hash)
    }
}

/// Id of an endpoint in the attachments of its messages: the first 16 bytes of the SHA-256 of its
/// token. Readers only compare it.
pub fn gid(token: &str) -> [u8; 16] {
    let hash: [u8; 32] = Sha256::digest(token.as_bytes()).into();
    std::array::from_fn(|i| hash[i])
}

/// The name with `%` in place of `/`.
fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// Name of a cell's key in ROS 2: `/PREFIX/KEY`, with `_` for characters that ROS 2 does not have.
/// `None` if that is still not a name.
pub fn topic_of_key(prefix: &str, key: &str) -> Option<String> {
    let key: String = key
        .chars()
        .map(|c| match c {
            '/' => '/',
            c if c.is_ascii_alphanumeric() => c,
            _ => '_',
        })
        .collect();
    let name = format!("/{prefix}/{key}");
    is_ros_name(&name).then_some(name)
}

/// A publisher somewhere in the graph, as its token describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Topic, with its leading slash.
    pub topic: String,
    /// Type as on the wire.
    pub wire_name: String,
    /// Hash as on the wire.
    pub hash: String,
    /// Namespace and name of the node.
    pub node: String,
}

/// The publisher that a token declares; `None` for every other token, and for text that is none.
pub fn publisher_of(token: &str) -> Option<Seen> {
    let parts: Vec<&str> = token.split('/').collect();
    let [
        TOKENS,
        _,
        _,
        _,
        _,
        "MP",
        _,
        namespace,
        node,
        topic,
        wire_name,
        hash,
        ..,
    ] = parts[..]
    else {
        return None;
    };
    let namespace = namespace.replace('%', "/");
    Some(Seen {
        topic: topic.replace('%', "/"),
        wire_name: wire_name.to_owned(),
        hash: hash.to_owned(),
        node: format!("{}/{node}", namespace.trim_end_matches('/')),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node() -> NodeName {
        NodeName {
            domain: 2,
            session: "aac3178e146ba6f1fc6e6a4085e77f21".into(),
            namespace: "/cell1".into(),
            name: "tangent".into(),
        }
    }

    /// The form of the example in the design document of rmw_zenoh.
    #[test]
    fn tokens_have_the_documented_form() {
        assert_eq!(
            node().token(),
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%cell1/tangent"
        );
        let of = RosType::new("std_msgs/msg/String", "RIHS01_df66".into()).unwrap();
        let token = node().endpoint_token(10, Kind::Publisher, "/chatter", &of, Qos::STATES);
        assert_eq!(
            token,
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%cell1/tangent/%chatter/\
             std_msgs::msg::dds_::String_/RIHS01_df66/::,10:,:,:,,"
        );
        assert_eq!(
            node().key("/cell1/arm/state", &of),
            "2/cell1/arm/state/std_msgs::msg::dds_::String_/RIHS01_df66"
        );
        assert_eq!(
            publisher_of(&token),
            Some(Seen {
                topic: "/chatter".into(),
                wire_name: "std_msgs::msg::dds_::String_".into(),
                hash: "RIHS01_df66".into(),
                node: "/cell1/tangent".into(),
            })
        );
        assert_eq!(publisher_of(&node().token()), None);
        let read = node().endpoint_token(11, Kind::Subscription, "/chatter", &of, Qos::SENSOR);
        assert!(read.ends_with("/2::,5:,:,:,,"));
        assert_eq!(publisher_of(&read), None);
        assert_ne!(gid(&token), gid(&read));
    }

    proptest::proptest! {
        /// Tokens and keys come from other programs.
        #[test]
        fn any_text_is_a_token_a_name_or_neither(text in "[@a-zA-Z0-9_/%:,.-]{0,120}") {
            let _ = publisher_of(&text);
            if let Some(name) = topic_of_key("cell1", &text) {
                proptest::prop_assert!(is_ros_name(&name));
            }
        }
    }

    #[test]
    fn keys_become_names_of_ros() {
        let name = |key| topic_of_key("cell1", key);
        assert_eq!(name("arm/state").unwrap(), "/cell1/arm/state");
        assert_eq!(
            name("estimate/my-own/normal").unwrap(),
            "/cell1/estimate/my_own/normal"
        );
        assert_eq!(name("estimate/2/normal"), None);
        assert_eq!(name(""), None);
    }
}
