//! How the requests and responses of a service pass between values in a core and bytes: as Rust values of a
//! service type that is compiled in, or as they are.

use crate::{KnownType, RawMessage};
use bytes::Bytes;
use downbeat_executor::ServiceType;
use downbeat_msgs::{Service, cdr};
use std::marker::PhantomData;

/// The two sides of a service type.
pub(crate) trait ServiceCodec: Copy + Send + Sync + 'static {
    /// What a core carries to the server.
    type Request: Send + 'static;
    /// What a core carries to the client.
    type Response: Clone + Send + Sync + 'static;

    /// As in `std_srvs/srv/SetBool`.
    fn name(self) -> &'static str;
    /// The types as the executor knows them.
    fn in_core(self) -> ServiceType<Self::Request, Self::Response>;
    /// Reads a request of either byte order.
    fn read_request(self, cdr: &[u8]) -> cdr::Result<Self::Request>;
    /// Reads a response of either byte order.
    fn read_response(self, cdr: &[u8]) -> cdr::Result<Self::Response>;
    /// Writes a request, little-endian.
    fn write_request(request: &Self::Request) -> Vec<u8>;
    /// Writes a response, little-endian.
    fn write_response(response: &Self::Response) -> Vec<u8>;
}

/// A service type that is compiled in.
pub(crate) struct Compiled<S>(PhantomData<fn(S)>);

impl<S> Compiled<S> {
    pub(crate) const NEW: Self = Self(PhantomData);
}

impl<S> Clone for Compiled<S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S> Copy for Compiled<S> {}

impl<S: Service> ServiceCodec for Compiled<S> {
    type Request = S::Request;
    type Response = S::Response;

    fn name(self) -> &'static str {
        S::TYPE_NAME
    }

    fn in_core(self) -> ServiceType<S::Request, S::Response> {
        ServiceType::of()
    }

    fn read_request(self, cdr: &[u8]) -> cdr::Result<S::Request> {
        cdr::from_slice(cdr)
    }

    fn read_response(self, cdr: &[u8]) -> cdr::Result<S::Response> {
        cdr::from_slice(cdr)
    }

    fn write_request(request: &S::Request) -> Vec<u8> {
        cdr::to_vec(request)
    }

    fn write_response(response: &S::Response) -> Vec<u8> {
        cdr::to_vec(response)
    }
}

/// A service type of which only the definition is known.
#[derive(Debug)]
pub(crate) struct RawService {
    pub(crate) name: &'static str,
    pub(crate) hash: &'static str,
    pub(crate) definition: &'static str,
    pub(crate) request: KnownType,
    pub(crate) response: KnownType,
    pub(crate) event: KnownType,
}

impl ServiceCodec for &'static RawService {
    type Request = RawMessage;
    type Response = RawMessage;

    fn name(self) -> &'static str {
        self.name
    }

    fn in_core(self) -> ServiceType<RawMessage, RawMessage> {
        ServiceType::named(self.request.name(), self.response.name())
    }

    fn read_request(self, cdr: &[u8]) -> cdr::Result<RawMessage> {
        read(self.request, cdr)
    }

    fn read_response(self, cdr: &[u8]) -> cdr::Result<RawMessage> {
        read(self.response, cdr)
    }

    fn write_request(request: &RawMessage) -> Vec<u8> {
        request.cdr().to_vec()
    }

    fn write_response(response: &RawMessage) -> Vec<u8> {
        response.cdr().to_vec()
    }
}

fn read(of: KnownType, cdr: &[u8]) -> cdr::Result<RawMessage> {
    Ok(RawMessage::new(of, of.checked(Bytes::copy_from_slice(cdr))?))
}
