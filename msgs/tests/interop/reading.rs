//! Views beside messages, and input that ends too early.

use crate::every_type::{As, every_type};
use crate::values::samples;

#[test]
fn views_hold_what_messages_hold() {
    for of in &every_type() {
        for sample in samples(&[of], 20) {
            let message = (of.show)(&sample.bytes, As::Message);
            assert!(message.is_ok(), "{}: {message:?}", sample.label());
            assert_eq!((of.show)(&sample.bytes, As::View), message, "{}", sample.label());
        }
    }
}

#[test]
fn what_is_cut_off_anywhere_is_refused_there() {
    for of in &every_type() {
        for sample in samples(&[of], 2) {
            // Not each byte of what is long: that is only more of the same.
            let step = 1 + sample.bytes.len() / 400;
            for end in (0..sample.bytes.len()).step_by(step) {
                let refused = (of.show)(&sample.bytes[..end], As::Message);
                let error = refused.expect_err(of.name);
                assert!(error.offset <= end, "{}, cut off at {end}: {error}", sample.label());
                assert_eq!((of.show)(&sample.bytes[..end], As::View), Err(error), "{}", sample.label());
            }
        }
    }
}
