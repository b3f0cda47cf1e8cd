//! Notifies the service manager that started the program: `sd_notify(3)` of systemd.

#[cfg_attr(not(target_os = "linux"), path = "notify_elsewhere.rs")]
mod notify;

use std::time::{Duration, Instant};

use downbeat_executor::{CoreHandle, Receipt};
use notify::NotifySocket;

/// The service manager, if one started the program.
pub(crate) struct Service {
    socket: Option<NotifySocket>,
    /// The time within which it expects a sign of life.
    watchdog: Option<Duration>,
    /// What the core has yet to answer.
    asked: Option<Receipt<bool>>,
    next_answer: Instant,
    next_status: Instant,
}

const STATUS_INTERVAL: Duration = Duration::from_secs(10);

impl Service {
    /// Reads `NOTIFY_SOCKET`, and `WATCHDOG_USEC` where `WATCHDOG_PID` is this process.
    pub(crate) fn of_process() -> Self {
        Self::from_variables(|name| std::env::var(name).ok())
    }

    fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Self {
        let socket = variable("NOTIFY_SOCKET").filter(|path| !path.is_empty()).and_then(|path| {
            let opened = NotifySocket::open(&path);
            opened
                .inspect_err(|error| {
                    tracing::warn!("cannot notify the service manager: NOTIFY_SOCKET={path}: {error}");
                })
                .ok()
        });
        let is_meant = variable("WATCHDOG_PID").is_none_or(|id| id == std::process::id().to_string());
        let watchdog = variable("WATCHDOG_USEC").filter(|_| is_meant).and_then(|time| time.parse().ok());
        let now = Instant::now();
        Self {
            watchdog: watchdog.map(Duration::from_micros).filter(|_| socket.is_some()),
            socket,
            asked: None,
            next_answer: now,
            next_status: now + Duration::from_secs(1), // with the first rates
        }
    }

    /// The robot runs.
    pub(crate) fn ready(&self) {
        self.send("READY=1");
    }

    /// The robot stops.
    pub(crate) fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// To be called several times per second. The watchdog is fed when the core has answered a question,
    /// which it does in a sync phase: a core in which a module does not return is not fed.
    pub(crate) fn tend(&mut self, core: &CoreHandle, status: impl FnOnce() -> String) {
        if self.socket.is_none() {
            return;
        }
        let now = Instant::now();
        if let Some(period) = self.watchdog
            && now >= self.next_answer
        {
            let asked = self.asked.get_or_insert_with(|| core.is_paused());
            if asked.try_take().is_some() {
                self.asked = None;
                self.next_answer = now + period / 4;
                self.send("WATCHDOG=1");
            }
        }
        if now >= self.next_status {
            self.next_status = now + STATUS_INTERVAL;
            self.send(&format!("STATUS={}", status().replace('\n', " ")));
        }
    }

    fn send(&self, text: &str) {
        let Some(socket) = &self.socket else { return };
        if let Err(error) = socket.send(text) {
            tracing::debug!("cannot send {text:?} to the service manager: {error}");
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::net::{SocketAddr, UnixDatagram};

    use downbeat_executor::{Context, Core, Module, ModuleOptions, Setup, SetupError};

    use super::*;

    fn received(socket: &UnixDatagram) -> Vec<String> {
        socket.set_nonblocking(true).unwrap();
        let mut buffer = [0; 512];
        std::iter::from_fn(|| {
            let length = socket.recv(&mut buffer).ok()?;
            Some(String::from_utf8_lossy(&buffer[..length]).into_owned())
        })
        .collect()
    }

    fn service(path: &str) -> Service {
        Service::from_variables(|name| match name {
            "NOTIFY_SOCKET" => Some(path.to_owned()),
            "WATCHDOG_USEC" => Some("100000".to_owned()),
            "WATCHDOG_PID" => Some(std::process::id().to_string()),
            _ => None,
        })
    }

    /// Does not return from its first run until the test lets it.
    struct Stuck(std::sync::mpsc::Receiver<()>);

    impl Module for Stuck {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.every(Duration::from_millis(1), |stuck: &mut Self, _: &mut Context<'_, ()>| {
                let _ = stuck.0.recv();
            })?;
            Ok(())
        }
    }

    #[test]
    fn a_running_core_feeds_the_watchdog_and_one_that_hangs_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        let mut service = service(path.to_str().unwrap());
        let (release, held) = std::sync::mpsc::channel();
        let mut core = Core::new();
        let handle = core.handle();
        let (done, finished) = std::sync::mpsc::channel();
        let runs = std::thread::spawn(move || {
            core.run().unwrap();
            done.send(()).unwrap();
        });
        service.ready();
        let mut seen = Vec::new();
        let end = Instant::now() + Duration::from_secs(20);
        let status = "STATUS=walking slowly".to_owned();
        while seen.iter().filter(|text| *text == "WATCHDOG=1").count() < 2 || !seen.contains(&status) {
            assert!(Instant::now() < end, "not told: {seen:?}");
            service.tend(&handle, || "walking\nslowly".to_owned());
            seen.extend(received(&manager));
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(seen[0], "READY=1");

        handle
            .add("stuck", Stuck(held), ModuleOptions::default())
            .wait(Duration::from_secs(10))
            .unwrap()
            .unwrap();
        // Once more for a question that was answered before it hung.
        for _ in 0..60 {
            service.tend(&handle, String::new);
            std::thread::sleep(Duration::from_millis(5));
        }
        received(&manager);
        for _ in 0..60 {
            service.tend(&handle, String::new);
            std::thread::sleep(Duration::from_millis(5));
        }
        let fed = received(&manager).into_iter().any(|text| text == "WATCHDOG=1");
        assert!(!fed, "a core that hangs was fed");
        service.stopping();
        assert_eq!(received(&manager), ["STOPPING=1"]);
        drop(release);
        handle.stop();
        finished.recv_timeout(Duration::from_secs(20)).unwrap();
        runs.join().unwrap();
    }

    #[test]
    fn names_without_files_and_absent_managers() {
        let name = format!("downbeat-test-{}", std::process::id());
        let manager = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        service(&format!("@{name}")).ready();
        assert_eq!(received(&manager), ["READY=1"]);
        assert!(service("/no/such/socket").socket.is_none());
        let of_another = Service::from_variables(|name| match name {
            "NOTIFY_SOCKET" => Some(format!("@downbeat-test-{}", std::process::id())),
            "WATCHDOG_USEC" => Some("100000".to_owned()),
            "WATCHDOG_PID" => Some("1".to_owned()),
            _ => None,
        });
        assert_eq!(of_another.watchdog, None);
    }
}
