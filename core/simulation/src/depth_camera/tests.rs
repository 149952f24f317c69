//! The camera against the surfaces' own distances, and each of its errors by itself.
