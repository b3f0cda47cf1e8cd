//! The limit on bytes to a peer whose address has not been validated.

/// Bytes from and to a peer whose address has not been validated yet.
#[derive(Debug, Default)]
pub(crate) struct Account {
    received: u64,
    sent: u64,
    is_known: bool,
    /// Acknowledgements of numbers that were not sent to it.
    guesses: u8,
}

impl Account {
    const FACTOR: u64 = 3;
    /// With the factor: about three times the certificate and the permissions of a robot.
    const HANDSHAKE: usize = 8 << 10;

    pub(crate) fn received(&mut self, bytes: usize) {
        self.received = self.received.saturating_add(bytes as u64);
    }

    /// Permits one handshake, whose messages with certificates and permissions are larger than what was
    /// received. The guard limits how many handshakes begin.
    pub(crate) fn permit_handshake(&mut self) {
        self.received(Self::HANDSHAKE);
    }

    pub(crate) fn sent(&mut self, bytes: usize) {
        self.sent = self.sent.saturating_add(bytes as u64);
    }

    pub(crate) fn answered(&mut self) {
        self.is_known = true;
    }

    /// Counts an acknowledgement of a number that was not sent to it, and returns how many there were.
    pub(crate) fn count_guess(&mut self) -> u8 {
        self.guesses = self.guesses.saturating_add(1);
        self.guesses
    }

    pub(crate) fn is_known(&self) -> bool {
        self.is_known
    }

    /// Bytes that may be sent now.
    pub(crate) fn allowance(&self) -> usize {
        if self.is_known {
            return usize::MAX;
        }
        let allowed = self.received.saturating_mul(Self::FACTOR).saturating_sub(self.sent);
        usize::try_from(allowed).unwrap_or(usize::MAX)
    }
}
