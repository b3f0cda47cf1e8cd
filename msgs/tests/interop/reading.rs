//! Views compared with messages, and truncated input.

use crate::every_type::{As, every_type};
use crate::values::samples;

#[test]
fn views_have_the_values_of_messages() {
    for of in &every_type() {
        for sample in samples(&[of], 20) {
            let message = (of.show)(&sample.bytes, As::Message);
            assert!(message.is_ok(), "{}: {message:?}", sample.label());
            assert_eq!((of.show)(&sample.bytes, As::View), message, "{}", sample.label());
        }
    }
}

#[test]
fn truncated_input_is_refused_where_it_ends() {
    for of in &every_type() {
        for sample in samples(&[of], 2) {
            // Not at every byte of long messages.
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
