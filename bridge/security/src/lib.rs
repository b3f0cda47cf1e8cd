//! DDS Security 1.1 as the nodes of ROS 2 use it (SROS2): who may join a domain, what it may do there, and
//! how what it sends is protected.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod access;
mod asn1;
pub mod authentication;
mod cdr;
pub mod cryptography;
pub mod document;
pub mod enclave;
pub mod guard;
pub mod pki;
pub mod tokens;
