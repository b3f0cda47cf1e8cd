//! The entropy coder of Zstandard, for the three predefined distributions.
//!
//! # References
//! RFC 8878, section 4.1 (finite state entropy) and 3.1.1.3.2.2 (the default distributions). The encoding
//! tables are those of Duda's asymmetric numeral systems, laid out as in `FSE_buildCTable` of the reference
//! implementation.

use std::sync::LazyLock;

/// Writes bits from first to last; a decoder reads them from last to first.
#[derive(Default)]
pub(super) struct BitWriter {
    pending: u64,
    bits: u32,
}

impl BitWriter {
    /// Appends the low `bits` of `value`, at most 32.
    pub(super) fn add(&mut self, out: &mut Vec<u8>, value: u32, bits: u32) {
        let mask = (1_u64 << bits) - 1;
        self.pending |= (u64::from(value) & mask) << self.bits;
        self.bits += bits;
        if self.bits >= 32 {
            out.extend_from_slice(&(self.pending as u32).to_le_bytes());
            self.pending >>= 32;
            self.bits -= 32;
        }
    }

    /// Appends the end mark and the remaining bits.
    pub(super) fn finish(mut self, out: &mut Vec<u8>) {
        self.add(out, 1, 1);
        let bytes = self.bits.div_ceil(8) as usize;
        out.extend(self.pending.to_le_bytes().into_iter().take(bytes));
    }
}

/// The encoder of one kind of symbols.
pub(super) struct Table {
    /// The number of bits of a state.
    log: u32,
    states: Vec<u16>,
    symbols: Vec<Transform>,
}

/// How a symbol changes a state.
#[derive(Clone, Copy, Default)]
struct Transform {
    delta_bits: u32,
    delta_state: i32,
}

/// The state of an encoder, initialised with the last symbol.
#[derive(Clone, Copy)]
pub(super) struct State(u32);

impl Table {
    fn new(log: u32, distribution: &[i8]) -> Self {
        let size = 1_usize << log;
        let spread = spread(size, distribution);
        let mut begins = Vec::with_capacity(distribution.len());
        let mut total = 0;
        for count in distribution {
            begins.push(total);
            total += usize::from(count.unsigned_abs());
        }
        let mut next = begins.clone();
        let mut states = vec![0; size];
        for (position, symbol) in spread.iter().enumerate() {
            if let Some(slot) = next.get_mut(*symbol)
                && let Some(state) = states.get_mut(*slot)
            {
                *state = (size + position) as u16;
                *slot += 1;
            }
        }
        let symbols = distribution.iter().zip(&begins).map(|(count, begin)| transform(log, *count, *begin));
        Self { log, states, symbols: symbols.collect() }
    }

    pub(super) fn begin(&self, symbol: usize) -> State {
        let transform = self.symbols.get(symbol).copied().unwrap_or_default();
        let bits = (transform.delta_bits + (1 << 15)) >> 16;
        let value = (bits << 16).wrapping_sub(transform.delta_bits);
        self.state(value >> bits, transform)
    }

    pub(super) fn encode(&self, bits: &mut BitWriter, out: &mut Vec<u8>, state: &mut State, symbol: usize) {
        let transform = self.symbols.get(symbol).copied().unwrap_or_default();
        let count = state.0.wrapping_add(transform.delta_bits) >> 16;
        bits.add(out, state.0, count);
        *state = self.state(state.0 >> count, transform);
    }

    pub(super) fn finish(&self, bits: &mut BitWriter, out: &mut Vec<u8>, state: State) {
        bits.add(out, state.0, self.log);
    }

    fn state(&self, value: u32, transform: Transform) -> State {
        let index = i64::from(value) + i64::from(transform.delta_state);
        let found = usize::try_from(index).ok().and_then(|index| self.states.get(index));
        State(found.copied().map_or(0, u32::from))
    }
}

/// The symbol of each state.
fn spread(size: usize, distribution: &[i8]) -> Vec<usize> {
    let mut table = vec![usize::MAX; size];
    let mut end = size;
    // Symbols with a probability below one have one state each, at the end.
    for (symbol, _) in distribution.iter().enumerate().filter(|(_, count)| **count < 0) {
        end -= 1;
        table[end] = symbol;
    }
    let step = (size >> 1) + (size >> 3) + 3;
    let mut position = 0;
    for (symbol, count) in distribution.iter().enumerate() {
        for _ in 0..(*count).max(0) {
            table[position] = symbol;
            position = (position + step) % size;
            while position >= end {
                position = (position + step) % size;
            }
        }
    }
    table
}

fn transform(log: u32, count: i8, begin: usize) -> Transform {
    let begin = begin as i32;
    match count {
        0 => Transform { delta_bits: ((log + 1) << 16) - (1 << log), delta_state: 0 },
        -1 | 1 => Transform { delta_bits: (log << 16) - (1 << log), delta_state: begin - 1 },
        _ => {
            let count = u32::from(count.unsigned_abs());
            let most_bits = log - (count - 1).ilog2();
            Transform {
                delta_bits: (most_bits << 16) - (count << most_bits),
                delta_state: begin - count as i32,
            }
        }
    }
}

/// The table of literal lengths.
pub(super) static LITERALS: LazyLock<Table> = LazyLock::new(|| {
    let distribution = [
        4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1,
        -1, -1, -1,
    ];
    Table::new(6, &distribution)
});

/// The table of match lengths.
pub(super) static MATCHES: LazyLock<Table> = LazyLock::new(|| {
    let distribution = [
        1, 4, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
        1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1,
    ];
    Table::new(6, &distribution)
});

/// The table of offsets.
pub(super) static OFFSETS: LazyLock<Table> = LazyLock::new(|| {
    let distribution =
        [1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1];
    Table::new(5, &distribution)
});

/// A number as a symbol and extra bits.
#[derive(Clone, Copy)]
pub(super) struct Code {
    pub(super) symbol: usize,
    pub(super) extra: u32,
    pub(super) bits: u32,
}

/// The code of a literal length (RFC 8878, table 14).
pub(super) fn literals_code(length: u32) -> Code {
    length_code(length, 16, &LITERALS_BASES)
}

/// The code of a match length, at least 3 (table 15).
pub(super) fn match_code(length: u32) -> Code {
    length_code(length.saturating_sub(3), 32, &MATCH_BASES)
}

/// The code of a stored offset: 1 to 3 for repeated offsets, otherwise the offset plus 3.
pub(super) fn offset_code(value: u32) -> Code {
    let bits = value.max(1).ilog2();
    Code { symbol: bits as usize, extra: value - (1 << bits), bits }
}

fn length_code(length: u32, direct: u32, bases: &[(u32, u32)]) -> Code {
    if length < direct {
        return Code { symbol: length as usize, extra: 0, bits: 0 };
    }
    let above = bases.partition_point(|(base, _)| *base <= length);
    let (base, bits) = bases.get(above.saturating_sub(1)).copied().unwrap_or((length, 0));
    Code { symbol: direct as usize + above.saturating_sub(1), extra: length - base, bits }
}

/// The base length of each symbol with extra bits, and how many these are (RFC 8878, table 14).
const LITERALS_BASES: [(u32, u32); 20] =
    bases(16, [1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);

/// The same for match lengths minus 3, the minimum match length (table 15).
const MATCH_BASES: [(u32, u32); 21] =
    bases(32, [1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);

const fn bases<const SYMBOLS: usize>(mut base: u32, bits: [u32; SYMBOLS]) -> [(u32, u32); SYMBOLS] {
    let mut bases = [(0, 0); SYMBOLS];
    let mut symbol = 0;
    while symbol < SYMBOLS {
        bases[symbol] = (base, bits[symbol]);
        base += 1 << bits[symbol];
        symbol += 1;
    }
    bases
}
