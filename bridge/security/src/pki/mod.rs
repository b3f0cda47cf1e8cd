//! Certificates, private keys and the authorities that sign them.
