//! A node of ROS 2 on a plain session: its publishers, subscriptions and services, each with its
//! token in the graph.

use std::sync::atomic::{AtomicU64, Ordering};

use tangent_runtime::{
    Attachment, BusError, Handle, PlainPublisher, PlainQuery, PlainSample, PlainSession,
};

use crate::names::{Kind, NodeName, Qos, RosType, gid};

/// The node. Its endpoints keep the session open.
pub struct Node {
    session: PlainSession,
    name: NodeName,
    next: AtomicU64,
    _token: Handle,
}

/// Publishes one topic of ROS 2, from one thread at a time.
pub struct TopicPublisher {
    publisher: PlainPublisher,
    gid: [u8; 16],
    sequence: u64,
    _token: Handle,
}

/// A subscription or a service; dropping it ends it.
pub struct Endpoint {
    _handles: [Handle; 2],
}

impl Node {
    /// Declares the node in the graph.
    ///
    /// # Errors
    /// The session is closed, or the name is not valid in a key.
    pub fn start(
        session: PlainSession,
        domain: u32,
        namespace: &str,
        name: &str,
    ) -> Result<Self, BusError> {
        let name = NodeName {
            domain,
            session: session.id(),
            namespace: namespace.to_owned(),
            name: name.to_owned(),
        };
        let token = session.token(&name.token())?;
        Ok(Self {
            session,
            name,
            next: AtomicU64::new(1),
            _token: token,
        })
    }

    /// Whether a router is connected now.
    pub fn is_connected(&self) -> bool {
        self.session.is_connected()
    }

    /// Publishes `topic`, an absolute name.
    ///
    /// # Errors
    /// The session is closed.
    pub fn publisher(&self, topic: &str, of: &RosType) -> Result<TopicPublisher, BusError> {
        let token = self.token(Kind::Publisher, topic, of, Qos::STATES);
        Ok(TopicPublisher {
            publisher: self.session.publisher(&self.name.key(topic, of))?,
            gid: gid(&token),
            sequence: 0,
            _token: self.session.token(&token)?,
        })
    }

    /// Calls `take` for every message on `topic`, in a Zenoh thread; it must not wait.
    ///
    /// # Errors
    /// The session is closed.
    pub fn subscription(
        &self,
        topic: &str,
        of: &RosType,
        take: impl Fn(PlainSample) + Send + Sync + 'static,
    ) -> Result<Endpoint, BusError> {
        let token = self.token(Kind::Subscription, topic, of, Qos::SENSOR);
        let reader = self.session.subscribe(&self.name.key(topic, of), take)?;
        Ok(Endpoint {
            _handles: [reader, self.session.token(&token)?],
        })
    }

    /// Calls `take` for every request to `service`, in a Zenoh thread; it must not wait.
    ///
    /// # Errors
    /// The session is closed.
    pub fn service(
        &self,
        service: &str,
        of: &RosType,
        take: impl Fn(PlainQuery) + Send + Sync + 'static,
    ) -> Result<Endpoint, BusError> {
        let token = self.token(Kind::Service, service, of, Qos::SERVICES);
        let answerer = self.session.answer(&self.name.key(service, of), take)?;
        Ok(Endpoint {
            _handles: [answerer, self.session.token(&token)?],
        })
    }

    /// Calls `take` with the token of every publisher of `topic` in the graph, of whatever type,
    /// and whether it appears (true) or ends.
    ///
    /// # Errors
    /// The session is closed.
    pub fn on_publishers(
        &self,
        topic: &str,
        take: impl Fn(&str, bool) + Send + Sync + 'static,
    ) -> Result<Handle, BusError> {
        let pattern = self.name.publishers_of(topic);
        self.session.on_tokens(&pattern, take)
    }

    fn token(&self, kind: Kind, topic: &str, of: &RosType, qos: Qos) -> String {
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        self.name.endpoint_token(id, kind, topic, of, qos)
    }
}

impl TopicPublisher {
    /// Sends CDR bytes (with their encapsulation header), stamped with the time of their
    /// publication, ns since the Unix epoch; false if they were not sent.
    pub fn publish(&mut self, payload: &[u8], source_time_ns: i64) -> bool {
        self.sequence += 1;
        let attachment = Attachment {
            sequence: self.sequence,
            source_time_ns,
            publisher: self.gid,
        };
        self.publisher.publish(payload, attachment)
    }
}
