//! Services that modules in other languages serve and call.

use super::contract::{CallEncoded, ForeignError, ReplyEncoded};
use super::module::ForeignModule;
use crate::KnownService;
use downbeat_executor::{AnyValue, Context, Module, Reply, Responder, Setup, SetupError};
use std::sync::Arc;
use std::time::Duration;

impl KnownService {
    /// Declares that a module in another language serves the service.
    pub(super) fn serve_foreign(
        self,
        setup: &mut Setup<'_, ForeignModule>,
        service: &str,
        server: u32,
    ) -> Result<(), SetupError> {
        let name: Arc<str> = service.into();
        setup.serve_later_of(
            self.in_core(),
            service,
            move |module: &mut ForeignModule, request, responder: Responder<_, AnyValue>, ctx| {
                let name = Arc::clone(&name);
                let reply: ReplyEncoded = Box::new(move |ctx, result| {
                    let (answer, outcome) = match result.map(|cdr| self.read_response(cdr)) {
                        Ok(Ok(response)) => (Ok(response), Ok(())),
                        Ok(Err(error)) => {
                            let type_name = format!("response of {self}");
                            let error = ForeignError::Decode { name: name.to_string(), type_name, error };
                            (Err(error.to_string()), Err(error))
                        }
                        Err(reason) => (Err(reason), Ok(())),
                    };
                    ctx.reply(responder, answer);
                    outcome
                });
                module.take_request(server, self.write_request(&*request.0).into(), reply, ctx);
            },
        )
    }

    /// Declares that a module in another language calls the service.
    pub(super) fn foreign_client(
        self,
        setup: &mut Setup<'_, ForeignModule>,
        service: &str,
        timeout: Duration,
        client: u32,
    ) -> Result<CallEncoded, SetupError> {
        let on_reply = move |module: &mut ForeignModule,
                             reply: Reply<AnyValue>,
                             ctx: &mut Context<'_, <ForeignModule as Module>::Ports>| {
            let result = reply.result.map(|response| self.write_response(&*response.0).into());
            let result = result.map_err(|error| error.to_string());
            module.take_reply(client, reply.call.number(), result, ctx);
        };
        let key = setup.client_of(self.in_core(), service, timeout, on_reply)?;
        let name = service.to_owned();
        Ok(Box::new(move |ctx, cdr| {
            let request = self.read_request(cdr).map_err(|error| {
                let type_name = format!("request of {self}");
                ForeignError::Decode { name: name.clone(), type_name, error }
            })?;
            Ok(ctx.call(key, request).number())
        }))
    }
}
