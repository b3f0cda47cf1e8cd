//! Signed documents (S/MIME).
