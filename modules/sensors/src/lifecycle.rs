//! What the modules of devices of the kernel do in their lifecycle: all the same.

/// The functions of [`Module`](downbeat_executor::Module) for a module that opens its device by itself while
/// it is active, by its `open_soon`, and `close`s it when it leaves.
macro_rules! opened_while_active {
    () => {
        fn activate(
            &mut self,
            _ctx: &mut downbeat_executor::Context<'_, Self::Ports>,
        ) -> Result<(), downbeat_executor::TransitionError> {
            self.open_soon();
            Ok(())
        }

        fn deactivate(
            &mut self,
            ctx: &mut downbeat_executor::Context<'_, Self::Ports>,
        ) -> Result<(), downbeat_executor::TransitionError> {
            self.close(ctx);
            Ok(())
        }

        fn shutdown(&mut self, ctx: &mut downbeat_executor::Context<'_, Self::Ports>) {
            self.close(ctx);
        }
    };
}
