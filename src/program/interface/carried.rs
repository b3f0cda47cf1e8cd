//! The definitions in this program, read from the texts that its types have.

use downbeat::msgs::definitions::{Catalog, Kind, TypeName};
use downbeat::msgs::{Message, Service};

/// The messages and services of this program.
pub(super) fn carried() -> anyhow::Result<Catalog> {
    let mut catalog = Catalog::new();
    macro_rules! messages {
        ($($message:ty),* $(,)?) => { [$((<$message>::TYPE_NAME, <$message as Message>::DEFINITION)),*] };
    }
    for (name, text) in downbeat::msgs::for_each_message!(messages) {
        let name: TypeName = name.parse()?;
        if name.kind == Kind::Message {
            let end = text.find(&format!("\n{}\n", "=".repeat(80))).unwrap_or(text.len());
            catalog.add_message(name, &text[..end], ORIGIN)?;
        }
    }
    macro_rules! services {
        ($($service:ty),* $(,)?) => { [$((<$service>::TYPE_NAME, <$service as Service>::DEFINITION)),*] };
    }
    for (name, text) in downbeat::msgs::for_each_service!(services) {
        let line = "=".repeat(80);
        let head = format!("{line}\nSRV: {name}\n");
        let own = text.strip_prefix(&head).unwrap_or(text).split(&format!("\n{line}\n")).next();
        let name: TypeName = name.parse()?;
        if name.kind == Kind::Service {
            catalog.add_service(name, own.unwrap_or_default(), ORIGIN)?;
        }
    }
    Ok(catalog)
}

const ORIGIN: &str = "downbeat";
