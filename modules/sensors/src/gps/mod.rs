//! Receivers that speak NMEA 0183.
