//! The handshake by which two participants prove their identities and agree on a secret.
