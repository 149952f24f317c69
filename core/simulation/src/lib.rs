//! Surfaces, contact, friction, arm and sensor models, and the closed loop of evaluate.
