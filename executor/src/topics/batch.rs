//! The messages that a topic has carried in one cycle, stored once and shared by all subscribers.

use std::any::Any;
use std::ops::Deref;
use std::sync::Arc;

use super::outbox::AnyMessage;
use crate::Time;

/// The messages that were published on one topic in one cycle, one segment per publisher.
///
/// Segments are swapped with the outboxes as a whole, so no message is moved. They keep their capacity when
/// the batch is reused.
pub(crate) struct Batch<T> {
    time: Time,
    segments: Vec<Vec<T>>,
    used: usize,
    messages: usize,
}

impl<T> Default for Batch<T> {
    fn default() -> Self {
        Self { time: Time::ZERO, segments: Vec::new(), used: 0, messages: 0 }
    }
}

/// A message as passed to the sink of [`Core::outlet_of`](crate::Core::outlet_of).
#[derive(Clone, Copy, Debug)]
pub struct AnyReceived<'a> {
    /// The message, of the type given when the outlet was made.
    pub message: &'a (dyn Any + Send + Sync),
    /// As [`Received::time`].
    pub time: Time,
    /// As [`Received::is_last`].
    pub is_last: bool,
    /// As [`Received::missed`].
    pub missed: u32,
}

/// A [`Batch`] whose message type is known only to its topic.
pub(crate) trait AnyBatch: Any + Send + Sync {
    /// Calls `visitor` with each message.
    fn visit(&self, visitor: &mut dyn FnMut(AnyReceived<'_>));
}

impl<T: Send + Sync + 'static> AnyBatch for Batch<T> {
    fn visit(&self, visitor: &mut dyn FnMut(AnyReceived<'_>)) {
        self.visit_as(|message| message, visitor);
    }
}

impl<T> Batch<T> {
    /// Calls `visitor` with what `look` returns for each message.
    #[inline]
    pub(crate) fn visit_as<'a>(
        &'a self,
        look: impl Fn(&'a T) -> &'a (dyn Any + Send + Sync),
        visitor: &mut dyn FnMut(AnyReceived<'_>),
    ) {
        let mut left = self.len();
        for message in self.segments().iter().flatten() {
            left -= 1;
            let message = look(message);
            visitor(AnyReceived { message, time: self.time, is_last: left == 0, missed: 0 });
        }
    }

    /// Drops the messages.
    pub(crate) fn clear(&mut self) {
        for segment in &mut self.segments[..self.used] {
            segment.clear();
        }
        self.forget();
    }

    /// Forgets messages that need no drop; their memory is reused.
    #[inline]
    pub(crate) fn forget(&mut self) {
        self.used = 0;
        self.messages = 0;
    }

    /// Takes all messages, and leaves an empty vector, with reused capacity if there is any.
    #[inline]
    pub(crate) fn take_over(&mut self, messages: &mut Vec<T>) {
        if self.used == self.segments.len() {
            self.segments.push(Vec::new());
        }
        self.messages += messages.len();
        let segment = &mut self.segments[self.used];
        segment.clear();
        std::mem::swap(segment, messages);
        self.used += 1;
    }

    /// Takes the messages of type `T` out of boxes, and returns their number. The others are dropped.
    #[cold]
    pub(crate) fn unbox(&mut self, messages: &mut Vec<AnyMessage>) -> usize
    where
        T: 'static,
    {
        if self.used == self.segments.len() {
            self.segments.push(Vec::new());
        }
        let segment = &mut self.segments[self.used];
        segment.clear();
        self.used += 1;
        for message in messages.drain(..) {
            if let Ok(message) = message.downcast() {
                segment.push(*message);
            }
        }
        let count = segment.len();
        self.messages += count;
        count
    }

    /// Moves all messages out, in their order.
    pub(crate) fn take_all(&mut self) -> Vec<T> {
        let messages = self.segments[..self.used].iter_mut().flat_map(|segment| segment.drain(..)).collect();
        self.forget();
        messages
    }

    pub(crate) fn stamp(&mut self, time: Time) {
        self.time = time;
    }

    pub(crate) fn time(&self) -> Time {
        self.time
    }

    pub(crate) fn segments(&self) -> &[Vec<T>] {
        &self.segments[..self.used]
    }

    pub(crate) fn len(&self) -> usize {
        self.messages
    }

    fn is_last(&self, position: Position) -> bool {
        let mut rest = self.segments().iter().skip(position.segment as usize);
        rest.next().is_none_or(|segment| position.index as usize + 1 >= segment.len())
            && rest.all(Vec::is_empty)
    }

    fn get(&self, position: Position) -> &T {
        &self.segments[position.segment as usize][position.index as usize]
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Position {
    pub(crate) segment: u32,
    pub(crate) index: u32,
}

/// A message as passed to a callback. It dereferences to the message, so `clone` copies the message;
/// [`keep`](Self::keep) keeps it without a copy.
pub struct Received<'a, T> {
    message: &'a T,
    batch: &'a Arc<Batch<T>>,
    position: Position,
    missed: u32,
}

impl<'a, T> Received<'a, T> {
    pub(crate) fn new(message: &'a T, batch: &'a Arc<Batch<T>>, position: Position, missed: u32) -> Self {
        Self { message, batch, position, missed }
    }

    /// The number of messages of the topic that the bounded [`Inbox`](crate::Inbox) of an outlet or a
    /// detached module has dropped directly before this one.
    #[must_use]
    pub fn missed(&self) -> u32 {
        self.missed
    }

    /// The time of the cycle in which the message was published.
    #[must_use]
    pub fn time(&self) -> Time {
        self.batch.time
    }

    /// True if the topic carried no later message in the same cycle; for callbacks that need only the latest
    /// message.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// struct Display;
    ///
    /// impl Module for Display {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let shown = setup.publish::<u32>("shown")?;
    ///         setup.subscribe::<u32, _>("speed", move |_, speed, ctx| {
    ///             if speed.is_last() {
    ///                 ctx.publish(shown, *speed);
    ///             }
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("display", Display)?;
    /// let (left, right) = (core.inlet("speed")?, core.inlet("speed")?);
    /// left.publish(1_u32)?;
    /// right.publish(2_u32)?;
    /// left.publish(3_u32)?;
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "shown").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn is_last(&self) -> bool {
        self.batch.is_last(self.position)
    }

    /// The message, valid while the callback runs.
    #[must_use]
    pub fn get(&self) -> &'a T {
        self.message
    }

    /// Keeps the message beyond the callback without copying it. All messages that the topic carried in the
    /// same cycle stay in memory as long as the kept one.
    #[must_use]
    pub fn keep(&self) -> Kept<T> {
        Kept { batch: Arc::clone(self.batch), position: self.position }
    }
}

impl<T> Deref for Received<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.message
    }
}

/// A message kept beyond its cycle, see [`Received::keep`].
///
/// ```
/// use downbeat_executor::{Core, Kept, ManualClock, Module, Setup, SetupError, Time};
///
/// struct Image(Vec<u8>);
///
/// /// Counts the pixels that are not as in the image before.
/// #[derive(Default)]
/// struct Motion {
///     last: Option<Kept<Image>>,
/// }
///
/// impl Module for Motion {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         let changed = setup.publish::<usize>("changed_pixels")?;
///         setup.subscribe::<Image, _>("image", move |motion, image, ctx| {
///             if let Some(last) = &motion.last {
///                 ctx.publish(changed, last.0.iter().zip(&image.0).filter(|(old, new)| old != new).count());
///             }
///             motion.last = Some(image.keep()); // No pixel is copied.
///         })
///     }
/// }
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("motion", Motion::default())?;
/// let image = core.inlet("image")?;
/// image.publish(Image(vec![1, 2, 3]))?;
/// image.publish(Image(vec![1, 9, 9]))?;
/// core.cycle()?;
/// core.cycle()?;
/// let changed = core.topics().find(|topic| &*topic.name == "changed_pixels").unwrap();
/// assert_eq!(changed.counter.messages(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Kept<T> {
    batch: Arc<Batch<T>>,
    position: Position,
}

impl<T> Clone for Kept<T> {
    fn clone(&self) -> Self {
        Self { batch: Arc::clone(&self.batch), position: self.position }
    }
}

impl<T> Kept<T> {
    /// The time of the cycle in which the message was published.
    #[must_use]
    pub fn time(&self) -> Time {
        self.batch.time
    }
}

impl<T> Deref for Kept<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.batch.get(self.position)
    }
}

/// Calls `consume` with each message of the batch. `missed`, the number of messages dropped before the batch,
/// is reported with the first message.
#[inline]
pub(crate) fn for_each_message<T>(
    batch: &Arc<Batch<T>>,
    missed: u32,
    mut consume: impl FnMut(Received<'_, T>),
) {
    let mut missed = missed;
    for (segment, messages) in (0_u32..).zip(batch.segments()) {
        for (index, message) in (0_u32..).zip(messages) {
            let missed = std::mem::take(&mut missed);
            consume(Received::new(message, batch, Position { segment, index }, missed));
        }
    }
}
