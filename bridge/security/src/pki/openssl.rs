//! Keystores that the `openssl` program makes, for tests.

use std::process::Command;

/// A folder with keys and certificates. The name of a file is that of its holder and an ending.
pub(crate) struct Folder(tempfile::TempDir);

/// What to put into a certificate.
#[derive(Clone, Copy)]
pub(crate) struct Subject<'a> {
    /// As `-subj` takes it.
    pub(crate) name: &'a str,
    pub(crate) days: &'a str,
    /// As `-addext` takes them; a certificate without any is of version 1.
    pub(crate) extensions: &'a [&'a str],
    pub(crate) serial: &'a str,
}

impl Default for Subject<'_> {
    fn default() -> Self {
        Self {
            name: "/CN=\\/robot",
            days: "3650",
            extensions: &["basicConstraints=critical,CA:FALSE"],
            serial: "1",
        }
    }
}

impl Subject<'_> {
    pub(crate) const AUTHORITY: Self = Self {
        name: "/CN=sros2CA",
        days: "3650",
        extensions: &["basicConstraints=critical,CA:TRUE,pathlen:1"],
        serial: "1",
    };
}

impl Folder {
    /// `None` if there is no `openssl`, which is reported.
    #[track_caller]
    pub(crate) fn new() -> Option<Self> {
        if !test_machine::has_program("openssl") {
            test_machine::missing("openssl", "apt-get install openssl");
            return None;
        }
        Some(Self(tempfile::tempdir().unwrap()))
    }

    pub(crate) fn read(&self, file: &str) -> Vec<u8> {
        std::fs::read(self.0.path().join(file)).unwrap()
    }

    pub(crate) fn write(&self, file: &str, content: &[u8]) {
        std::fs::write(self.0.path().join(file), content).unwrap();
    }

    /// Runs the program in the folder and returns its output.
    #[track_caller]
    pub(crate) fn run(&self, arguments: &[&str]) -> Vec<u8> {
        let output = Command::new("openssl").args(arguments).current_dir(self.0.path()).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "openssl {}: {error}", arguments.join(" "));
        output.stdout
    }

    /// Makes `HOLDER.key` and `HOLDER.pem`, and returns the latter.
    #[track_caller]
    pub(crate) fn self_signed(&self, holder: &str, subject: &Subject<'_>) -> Vec<u8> {
        self.request(holder, subject);
        self.sign(holder, subject, &["-signkey", &format!("{holder}.key")])
    }

    /// Makes `HOLDER.key` and `HOLDER.pem`, signed by `authority`, and returns the latter.
    #[track_caller]
    pub(crate) fn signed(&self, authority: &str, holder: &str, subject: &Subject<'_>) -> Vec<u8> {
        self.request(holder, subject);
        let (certificate, key) = (format!("{authority}.pem"), format!("{authority}.key"));
        self.sign(holder, subject, &["-CA", &certificate, "-CAkey", &key])
    }

    fn request(&self, holder: &str, subject: &Subject<'_>) {
        let (key, request) = (format!("{holder}.key"), format!("{holder}.csr"));
        self.run(&["genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", &key]);
        self.run(&[
            "req",
            "-new",
            "-key",
            &key,
            "-subj",
            subject.name,
            "-utf8",
            "-multivalue-rdn",
            "-out",
            &request,
        ]);
    }

    #[track_caller]
    fn sign(&self, holder: &str, subject: &Subject<'_>, by: &[&str]) -> Vec<u8> {
        let (request, certificate) = (format!("{holder}.csr"), format!("{holder}.pem"));
        let mut arguments = vec![
            "x509",
            "-req",
            "-sha256",
            "-in",
            &request,
            "-days",
            subject.days,
            "-set_serial",
            subject.serial,
            "-out",
            &certificate,
        ];
        arguments.extend(by);
        if !subject.extensions.is_empty() {
            self.write("extensions", subject.extensions.join("\n").as_bytes());
            arguments.extend(["-extfile", "extensions"]);
        }
        self.run(&arguments);
        self.read(&certificate)
    }
}
