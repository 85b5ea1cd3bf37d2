//! Files damaged by a seed.

/// SplitMix64: the same damage on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % end.max(1) as u64) as usize
    }

    /// One to four changes: bytes, runs, digits, cuts, repeats and splices.
    pub fn damage(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(4) {
            if bytes.is_empty() {
                return;
            }
            let at = self.below(bytes.len());
            let length = self.below(12).min(bytes.len() - at);
            match self.below(8) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes[at] ^= 1 << self.below(8),
                2 => bytes[at..at + length].fill([0, 0xff, 0x7f, b'9'][self.below(4)]),
                3 => drop(bytes.drain(at..at + length)),
                4 => {
                    let copy = bytes[at..at + length].to_vec();
                    let to = self.below(bytes.len());
                    bytes.splice(to..to, copy);
                }
                5 => {
                    let word: &[u8] = [
                        &b"-1"[..],
                        b"999999999",
                        b"nan",
                        b"1e999",
                        b"18446744073709551615",
                        b"\"",
                        b"<",
                        b"{",
                        b"]",
                        b"\r\n",
                    ][self.below(10)];
                    bytes.splice(at..at + length.min(1), word.iter().copied());
                }
                _ => {
                    // The nearest digit behind becomes another.
                    if let Some(digit) = bytes[at..].iter().position(u8::is_ascii_digit) {
                        bytes[at + digit] = b"0123456789-. "[self.below(13)];
                    }
                }
            }
        }
    }
}
