//! Protection of payloads, submessages and messages by AES-GCM and AES-GMAC.
