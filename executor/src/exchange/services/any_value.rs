//! Requests and answers whose types are known only by their identity.

use std::any::Any;
use std::fmt;

/// The request or answer of a service whose types are given as values, see
/// [`ServiceType::erased`](crate::ServiceType::erased): a box of a value of the type.
pub struct AnyValue(pub Box<dyn Any + Send>);

impl fmt::Debug for AnyValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AnyValue").finish_non_exhaustive()
    }
}

/// The value itself, also of a box. Which of the two it is, is known when the code is compiled.
pub(super) fn look<T: 'static>(value: &T) -> &dyn Any {
    match (value as &dyn Any).downcast_ref::<AnyValue>() {
        Some(AnyValue(boxed)) => &**boxed,
        None => value,
    }
}

/// The value in a box; a box stays as it is.
pub(super) fn into_any<T: Send + 'static>(value: T) -> AnyValue {
    let mut value = Some(value);
    let boxed = (&mut value as &mut dyn Any).downcast_mut::<Option<AnyValue>>().and_then(Option::take);
    match (boxed, value) {
        (Some(boxed), _) => boxed,
        (None, Some(value)) => AnyValue(Box::new(value)),
        (None, None) => AnyValue(Box::new(())),
    }
}

/// The value of type `T` in a box, or the box; `None` if the value has another type.
pub(super) fn from_any<T: 'static>(value: AnyValue) -> Option<T> {
    let mut value = Some(value);
    match (&mut value as &mut dyn Any).downcast_mut::<Option<T>>() {
        Some(same) => same.take(),
        None => value?.0.downcast().ok().map(|value| *value),
    }
}
