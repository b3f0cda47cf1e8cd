//! Tokens and the messages that carry them, as CDR.
