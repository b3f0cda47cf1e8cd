//! Laser scanners on a serial port.
