//! Events of services as bytes.

use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_msgs::{Service, cdr};

/// What a service event holds besides who and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventContent<'a> {
    /// Nothing.
    Nothing,
    /// The request, serialized.
    Request(&'a [u8]),
    /// The response, serialized.
    Response(&'a [u8]),
}

/// Serializes an event of one service type.
pub type EncodeEvent = fn(ServiceEventInfo, EventContent<'_>) -> Result<Vec<u8>, cdr::Error>;

/// An event of the service type `S`, encapsulation header (little-endian) and body.
///
/// # Errors
/// When the content is no request or response of the type.
pub fn encode_event<S: Service>(
    info: ServiceEventInfo,
    content: EventContent<'_>,
) -> Result<Vec<u8>, cdr::Error> {
    let event = match content {
        EventContent::Nothing => S::event(info, None, None),
        // Read and written anew: what stands in the middle of a message is aligned otherwise than by itself.
        EventContent::Request(request) => S::event(info, Some(cdr::from_slice(request)?), None),
        EventContent::Response(response) => S::event(info, None, Some(cdr::from_slice(response)?)),
    };
    Ok(cdr::to_vec(&event))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::std_srvs::srv::{Empty, SetBool, SetBoolEvent, SetBoolRequest};

    fn info() -> ServiceEventInfo {
        ServiceEventInfo {
            event_type: 1,
            client_gid: [7; 16],
            sequence_number: 9,
            ..ServiceEventInfo::default()
        }
    }

    #[test]
    fn an_event_has_the_request_or_the_response_or_neither() {
        let request = SetBoolRequest { data: true };
        let bytes = encode_event::<SetBool>(info(), EventContent::Request(&cdr::to_vec(&request))).unwrap();
        let event: SetBoolEvent = cdr::from_slice(&bytes).unwrap();
        assert_eq!((event.info, event.request, event.response), (info(), vec![request], vec![]));
        assert!(encode_event::<SetBool>(info(), EventContent::Response(&[0, 1])).is_err());
    }

    #[test]
    fn an_event_without_content_is_the_same_whatever_the_type() {
        let of_empty = encode_event::<Empty>(info(), EventContent::Nothing).unwrap();
        assert_eq!(encode_event::<SetBool>(info(), EventContent::Nothing).unwrap(), of_empty);
    }
}
