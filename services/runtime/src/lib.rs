//! The one way to be a service: bus, configuration, liveliness, health, parameters, shutdown.
