//! Limits the rate of sending to a peer, so that its receive buffer does not overflow.
//!
//! There are two rules for two kinds of peers:
//!
//! - **A window** for those that announce the size of their receive buffer (participants of this engine):
//!   half of it may be in flight, and acknowledgements open it again.
//! - **A token bucket** for all others and for data that is not acknowledged. Other peers have a buffer of
//!   208 KiB, which includes the kernel's bookkeeping, and read it with pauses of some milliseconds. The
//!   burst is therefore small, and the rate is one that such a buffer can handle. It falls when fragments are
//!   requested again, and rises only while it limits the load without a pause.

use std::time::{Duration, Instant};

/// Overhead that the kernel counts for a datagram, rounded up.
const DATAGRAM_COST: f64 = 768.0;

/// Burst in bytes to a peer with an unknown buffer. Two fragments of 32 kB fit.
const STOCK_BURST: f64 = 72.0 * 1024.0;
/// Initial rate in bytes per second to a peer with an unknown buffer. For comparison, 921 600 bytes at 30 Hz
/// are 27.6 MB/s.
const STOCK_RATE: f64 = 40e6;
const STOCK_RATE_MIN: f64 = 32e6;
/// Initial rate to a peer with a known buffer, per byte of the buffer: without acknowledgements the peer may
/// fall behind by 3 ms.
const KNOWN_RATE_PER_BYTE: f64 = 80.0;
const RATE_MAX: f64 = 2e9;

/// The rate falls at most once in this time, because requested data may have been sent at the previous rate.
const LOSS_PAUSE: Duration = Duration::from_millis(20);
/// The rate rises after the link was saturated for this long.
const BUSY_BEFORE_RISE: Duration = Duration::from_millis(300);

/// Whether something may be sent now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Permit {
    Granted,
    /// Not before this time.
    At(Instant),
    /// Only after an acknowledgement.
    OnAcknowledgement,
}

/// The kind of data to send.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Load {
    /// A small sample, which is sent before the queue, on credit.
    Small,
    /// Part of a large sample, or data that is sent again.
    Bulk,
}

/// Limits what is sent to one peer.
#[derive(Debug)]
pub(super) enum Pacer {
    /// The local participant, without limits.
    Unlimited,
    Limited(Limits),
}

#[derive(Debug)]
pub(super) struct Limits {
    bucket: Bucket,
    window: Option<Window>,
}

#[derive(Debug)]
struct Window {
    size: u64,
    /// Unacknowledged bytes of all writers of the participant.
    in_flight: u64,
}

#[derive(Debug)]
struct Bucket {
    rate: f64,
    rate_min: f64,
    burst: f64,
    tokens: f64,
    filled: Option<Instant>,
    busy_since: Option<Instant>,
    lost: Option<Instant>,
}

impl Pacer {
    pub fn new(receive_buffer: Option<u32>) -> Self {
        let stock = (STOCK_RATE, STOCK_RATE_MIN, STOCK_BURST);
        let (rate, rate_min, burst) = match receive_buffer.map(f64::from) {
            Some(buffer) if buffer > 4.0 * STOCK_BURST => {
                let rate = (KNOWN_RATE_PER_BYTE * buffer).max(STOCK_RATE);
                (rate, rate / 4.0, buffer / 4.0)
            }
            _ => stock,
        };
        let bucket =
            Bucket { rate, rate_min, burst, tokens: burst, filled: None, busy_since: None, lost: None };
        let window = receive_buffer.map(|buffer| Window { size: u64::from(buffer) / 2, in_flight: 0 });
        Self::Limited(Limits { bucket, window })
    }

    /// The most unacknowledged bytes, if acknowledgements pace this link.
    pub fn window_size(&self) -> Option<u64> {
        match self {
            Self::Limited(Limits { window: Some(window), .. }) => Some(window.size),
            _ => None,
        }
    }

    /// Returns whether at least half of the window is in flight.
    pub fn is_half_full(&self) -> bool {
        match self {
            Self::Limited(Limits { window: Some(window), .. }) => window.in_flight >= window.size / 2,
            _ => false,
        }
    }

    /// Requests `bytes` from the window, or from the bucket if there is no window.
    pub fn ask_window(&mut self, now: Instant, load: Load, bytes: usize) -> Permit {
        let Self::Limited(Limits { window: Some(window), .. }) = self else {
            return self.ask_bucket(now, load, bytes);
        };
        // A quarter of the window is reserved for small samples, so that an image does not delay them.
        let size = if load == Load::Small { window.size / 4 * 5 } else { window.size };
        match window.in_flight == 0 || window.in_flight + bytes as u64 <= size {
            true => Permit::Granted,
            false => Permit::OnAcknowledgement,
        }
    }

    /// Requests `bytes` from the bucket and takes them if granted.
    pub fn ask_bucket(&mut self, now: Instant, load: Load, bytes: usize) -> Permit {
        match self {
            Self::Unlimited => Permit::Granted,
            Self::Limited(limits) => limits.bucket.take(now, load, bytes),
        }
    }

    /// Updates the bytes that a writer has in flight.
    pub fn change_in_flight(&mut self, before: u64, after: u64) {
        if let Self::Limited(Limits { window: Some(window), .. }) = self {
            window.in_flight = (window.in_flight + after).saturating_sub(before);
        }
    }

    /// Records that sent data was requested again.
    pub fn lose(&mut self, now: Instant) {
        if let Self::Limited(limits) = self {
            limits.bucket.lose(now);
        }
    }
}

impl Bucket {
    fn take(&mut self, now: Instant, load: Load, bytes: usize) -> Permit {
        self.fill(now);
        let cost = bytes as f64 + DATAGRAM_COST;
        // The credit is one full bucket, so small samples alone are limited to the rate as well.
        let credit = if load == Load::Small { self.burst } else { 0.0 };
        let missing = cost.min(self.burst) - self.tokens - credit;
        if missing <= 0.0 {
            self.tokens -= cost;
            return Permit::Granted;
        }
        if self.busy_since.is_some_and(|since| now >= since + BUSY_BEFORE_RISE) {
            self.rate = (self.rate * 1.05).min(RATE_MAX);
            self.busy_since = None;
        }
        self.busy_since.get_or_insert(now);
        // Rounded up to avoid waking a sender too early.
        Permit::At(now + Duration::from_secs_f64(missing / self.rate) + Duration::from_micros(1))
    }

    fn fill(&mut self, now: Instant) {
        if let Some(filled) = self.filled {
            self.tokens += self.rate * now.saturating_duration_since(filled).as_secs_f64();
        }
        if self.tokens >= self.burst {
            self.tokens = self.burst;
            self.busy_since = None;
        }
        self.filled = Some(now);
    }

    fn lose(&mut self, now: Instant) {
        if self.lost.is_none_or(|lost| now >= lost + LOSS_PAUSE) {
            self.rate = (self.rate * 0.75).max(self.rate_min);
            self.lost = Some(now);
        }
        self.busy_since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn send(pacer: &mut Pacer, from: Instant, duration: Duration, bytes: usize) -> usize {
        let (mut now, mut sent) = (from, 0);
        while now < from + duration {
            match pacer.ask_bucket(now, Load::Bulk, bytes) {
                Permit::Granted => sent += bytes,
                Permit::At(at) => now = at.max(now + Duration::from_nanos(1)),
                Permit::OnAcknowledgement => panic!("a bucket waits for time only"),
            }
        }
        sent
    }

    #[test]
    fn a_bucket_gives_a_burst_and_then_its_rate() {
        let (mut pacer, start) = (Pacer::new(None), Instant::now());
        assert!(send(&mut pacer, start, MS / 1000, 32_000) <= STOCK_BURST as usize);
        let sent = send(&mut pacer, start + MS, 100 * MS, 32_000) as f64;
        assert!((0.95..1.05).contains(&(sent / (STOCK_RATE * 0.1))), "{sent}");
    }

    #[test]
    fn small_samples_are_sent_on_credit() {
        let (mut pacer, start) = (Pacer::new(None), Instant::now());
        send(&mut pacer, start, MS / 1000, 32_000);
        assert_eq!(pacer.ask_bucket(start, Load::Small, 100), Permit::Granted);
        assert!(matches!(pacer.ask_bucket(start, Load::Bulk, 32_000), Permit::At(_)));
        while pacer.ask_bucket(start, Load::Small, 100) == Permit::Granted {}
    }

    #[test]
    fn the_rate_falls_with_losses_and_rises_only_under_sustained_load() {
        let (mut pacer, mut now) = (Pacer::new(None), Instant::now());
        pacer.lose(now);
        pacer.lose(now);
        let rate = |pacer: &Pacer| match pacer {
            Pacer::Limited(limits) => limits.bucket.rate,
            Pacer::Unlimited => f64::INFINITY,
        };
        assert_eq!(rate(&pacer), STOCK_RATE_MIN);
        for _ in 0..100 {
            let mut left = 921_600_i32;
            while left > 0 {
                match pacer.ask_bucket(now, Load::Bulk, 32_000) {
                    Permit::Granted => left -= 32_000,
                    Permit::At(at) => now = at + Duration::from_nanos(1),
                    Permit::OnAcknowledgement => panic!("a bucket waits for time only"),
                }
            }
            now += 10 * MS;
        }
        assert_eq!(rate(&pacer), STOCK_RATE_MIN);
        send(&mut pacer, now, 3000 * MS, 32_000);
        assert!(rate(&pacer) > 1.3 * STOCK_RATE_MIN);
    }

    #[test]
    fn acknowledgements_open_the_window() {
        let (mut pacer, now) = (Pacer::new(Some(1 << 20)), Instant::now());
        pacer.change_in_flight(0, 500_000);
        assert_eq!(pacer.ask_window(now, Load::Bulk, 64_000), Permit::OnAcknowledgement);
        assert_eq!(pacer.ask_window(now, Load::Small, 64_000), Permit::Granted);
        pacer.change_in_flight(500_000, 400_000);
        assert_eq!(pacer.ask_window(now, Load::Bulk, 64_000), Permit::Granted);
    }
}
