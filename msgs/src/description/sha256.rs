//! SHA-256 that can be evaluated at compile time.
//!
//! # References
//! FIPS 180-4, 4.2.2, 5.1.1, 5.3.3 and 6.2.

/// The state of a hash computation.
pub(super) struct Sha256 {
    state: [u32; 8],
    block: [u8; 64],
    /// Total bytes; those after the last complete block are in `block`.
    length: usize,
}

impl Sha256 {
    pub const fn new() -> Self {
        Self { state: INITIAL, block: [0; 64], length: 0 }
    }

    /// Adds bytes.
    pub const fn push(&mut self, bytes: &[u8]) {
        let mut index = 0;
        while index < bytes.len() {
            self.block[self.length % 64] = bytes[index];
            self.length += 1;
            index += 1;
            if self.length.is_multiple_of(64) {
                self.compress();
            }
        }
    }

    /// Returns the hash of all bytes.
    pub const fn finish(mut self) -> [u8; 32] {
        let bits = (self.length as u64 * 8).to_be_bytes();
        self.push(&[0x80]);
        while self.length % 64 != 56 {
            self.push(&[0]);
        }
        self.push(&bits);
        let mut digest = [0; 32];
        let mut index = 0;
        while index < 32 {
            digest[index] = self.state[index / 4].to_be_bytes()[index % 4];
            index += 1;
        }
        digest
    }

    const fn compress(&mut self) {
        let mut schedule = [0_u32; 64];
        let mut t = 0;
        while t < 64 {
            schedule[t] = if t < 16 {
                let at = t * 4;
                u32::from_be_bytes([
                    self.block[at],
                    self.block[at + 1],
                    self.block[at + 2],
                    self.block[at + 3],
                ])
            } else {
                let (two, fifteen) = (schedule[t - 2], schedule[t - 15]);
                let small_1 = two.rotate_right(17) ^ two.rotate_right(19) ^ (two >> 10);
                let small_0 = fifteen.rotate_right(7) ^ fifteen.rotate_right(18) ^ (fifteen >> 3);
                small_1.wrapping_add(schedule[t - 7]).wrapping_add(small_0).wrapping_add(schedule[t - 16])
            };
            t += 1;
        }
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = self.state;
        let mut t = 0;
        while t < 64 {
            let large_1 = e.rotate_right(6) ^ e.rotate_right(11) ^ e.rotate_right(25);
            let choice = (e & f) ^ (!e & g);
            let first =
                h.wrapping_add(large_1).wrapping_add(choice).wrapping_add(K[t]).wrapping_add(schedule[t]);
            let large_0 = a.rotate_right(2) ^ a.rotate_right(13) ^ a.rotate_right(22);
            let majority = (a & b) ^ (a & c) ^ (b & c);
            let second = large_0.wrapping_add(majority);
            (h, g, f, e) = (g, f, e, d.wrapping_add(first));
            (d, c, b, a) = (c, b, a, first.wrapping_add(second));
            t += 1;
        }
        let mixed = [a, b, c, d, e, f, g, h];
        let mut index = 0;
        while index < 8 {
            self.state[index] = self.state[index].wrapping_add(mixed[index]);
            index += 1;
        }
    }
}

const INITIAL: [u32; 8] =
    [0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19];

#[rustfmt::skip]
const K: [u32; 64] = [
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
];

#[cfg(test)]
mod tests {
    use super::Sha256;

    /// The examples of FIPS 180-4, and lengths around that of a block.
    #[test]
    fn published_hashes_are_reproduced() {
        for (message, hash) in [
            (Vec::new(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"),
            (b"abc".to_vec(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"),
            (
                b"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq".to_vec(),
                "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1",
            ),
            (vec![b'a'; 1_000_000], "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0"),
        ] {
            let mut sha = Sha256::new();
            sha.push(&message);
            let found: String = sha.finish().iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(found, hash, "{} bytes", message.len());
        }
    }
}
