//! Functions on text that run at compile time.

/// Negative, 0 or positive if `a` is less than, equal to or greater than `b`.
pub(super) const fn compare(a: &str, b: &str) -> i32 {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    let mut index = 0;
    while index < a.len() && index < b.len() {
        if a[index] != b[index] {
            return a[index] as i32 - b[index] as i32;
        }
        index += 1;
    }
    if a.len() == b.len() {
        0
    } else if a.len() < b.len() {
        -1
    } else {
        1
    }
}

/// The parts before and after the first slash.
pub(super) const fn split_at_slash(text: &str) -> (&str, &str) {
    let mut index = 0;
    while index < text.len() {
        if text.as_bytes()[index] == b'/' {
            return (text.split_at(index).0, text.split_at(index + 1).1);
        }
        index += 1;
    }
    (text, "")
}

/// The decimal digits of a number, at the end of the array, and their count.
pub(super) const fn digits(mut number: u64) -> ([u8; 20], usize) {
    let mut digits = [b'0'; 20];
    let mut count = 0;
    while number > 0 || count == 0 {
        count += 1;
        digits[20 - count] = b'0' + (number % 10) as u8;
        number /= 10;
    }
    (digits, count)
}
