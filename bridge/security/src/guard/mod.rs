//! What the RTPS engine asks.
