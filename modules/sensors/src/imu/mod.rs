//! Inertial sensors on I²C.
