//! The directory with the sockets of running robots.

use std::ffi::OsStr;
use std::fmt;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use super::error::{ClaimError, DirectoryError};
use super::sockets::{UnixStream, create_private, default_directory, is_alive};

/// A directory with the sockets of one user's robots. Other users have no access to it.
#[derive(Clone, Debug)]
pub struct SocketDirectory {
    path: PathBuf,
}

/// The claim of one robot on a node name on this machine: a lock file, which the operating system unlocks
/// even if the process is killed.
#[derive(Debug)]
pub struct NodeClaim {
    _lock: File,
}

/// A running robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunningRobot {
    /// The name in the robot file, with the suffix `.2` and so on if the process has several robots of that
    /// name.
    pub name: String,
    /// The process id.
    pub pid: u32,
    /// The path of its socket.
    pub socket: PathBuf,
}

impl fmt::Display for RunningRobot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (process {})", self.name, self.pid)
    }
}

impl SocketDirectory {
    /// Opens the directory of this user and creates it if it does not exist: `downbeat` in `XDG_RUNTIME_DIR`,
    /// or, if that is not set, `downbeat-` followed by the user id in the directory for temporary files.
    ///
    /// # Errors
    /// Returns an error if the directory cannot be created or is not private.
    pub fn open() -> Result<Self, DirectoryError> {
        Self::open_at(default_directory())
    }

    /// Opens the directory at `path` and creates it if it does not exist.
    ///
    /// # Errors
    /// Returns an error if the directory cannot be created or is not private.
    pub fn open_at(path: PathBuf) -> Result<Self, DirectoryError> {
        create_private(&path)?;
        Ok(Self { path })
    }

    /// The path of the directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the running robots, ordered by name and process id. Removes sockets of processes that have
    /// ended.
    ///
    /// # Errors
    /// Returns an error if the directory cannot be read.
    pub fn running(&self) -> Result<Vec<RunningRobot>, DirectoryError> {
        let io_error = |source| DirectoryError::Io { path: self.path.clone(), source };
        let mut robots = Vec::new();
        for entry in fs::read_dir(&self.path).map_err(io_error)? {
            let socket = entry.map_err(io_error)?.path();
            let Some((name, pid)) = socket.file_name().and_then(name_and_pid) else { continue };
            match UnixStream::connect(&socket) {
                // The process ended without removing its socket.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                    let _ = fs::remove_file(&socket);
                }
                // The robot has ended since the directory was listed.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Ok(_) | Err(_) => robots.push(RunningRobot { name, pid, socket }),
            }
        }
        robots.sort_by(|a, b| (&a.name, a.pid).cmp(&(&b.name, b.pid)));
        Ok(robots)
    }

    /// Returns the robots that have a node and no socket, by their names and process ids: they start, or
    /// could create none.
    ///
    /// # Errors
    /// Returns an error if the directory cannot be read.
    pub fn starting(&self) -> Result<Vec<(String, u32)>, DirectoryError> {
        let running = self.running()?;
        let io_error = |source| DirectoryError::Io { path: self.path.clone(), source };
        let mut starting = Vec::new();
        for entry in fs::read_dir(&self.path).map_err(io_error)? {
            let path = entry.map_err(io_error)?.path();
            if path.extension().is_none_or(|ending| ending != "lock") {
                continue;
            }
            // Not by trying the lock: for that moment, a robot could not have it.
            let holder = fs::read_to_string(&path).unwrap_or_default();
            let Some((name, pid)) = holder_of(&holder).filter(|(_, pid)| is_alive(*pid)) else { continue };
            if running.iter().all(|robot| robot.pid != pid) {
                starting.push((in_file_name(name), pid));
            }
        }
        Ok(starting)
    }

    /// Reserves a node name in a domain for a robot of this process, until the claim is dropped or the
    /// process ends.
    ///
    /// Two nodes with the same name in one domain answer each other's requests, and their messages cannot be
    /// distinguished. Robots of other users and on other machines are not checked.
    ///
    /// # Errors
    /// Returns an error if a robot that runs on this machine has that name.
    pub fn claim(&self, robot: &str, node: &str, domain: u16) -> Result<NodeClaim, ClaimError> {
        // A domain in another network namespace is a different domain.
        let network = fs::read_link("/proc/self/ns/net").unwrap_or_default();
        let digits = |text: &str| text.chars().filter(char::is_ascii_digit).collect::<String>();
        let file =
            format!("node{}-{domain}-{}.lock", node.replace('/', "."), digits(&network.to_string_lossy()));
        let path = self.path.join(file);
        let io_error = |source| DirectoryError::Io { path: path.clone(), source };
        // Not truncated: the file contains the holder of the lock.
        let open = File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = open.map_err(io_error)?;
        let locked = file.try_lock();
        if let Err(TryLockError::Error(error)) = locked {
            return Err(io_error(error).into());
        }
        if locked.is_err() {
            let mut holder = String::new();
            file.read_to_string(&mut holder).map_err(io_error)?;
            return Err(ClaimError::Taken { node: node.to_owned(), domain, holder });
        }
        let holder = format!("{robot} (process {})", std::process::id());
        file.set_len(0).and_then(|()| file.write_all(holder.as_bytes())).map_err(io_error)?;
        Ok(NodeClaim { _lock: file })
    }

    /// The socket of the `number`-th robot of that name in this process, from 1.
    pub(super) fn socket(&self, robot: &str, number: u32) -> PathBuf {
        let name = in_file_name(robot);
        let number = if number > 1 { format!(".{number}") } else { String::new() };
        self.path.join(format!("{name}{number}-{}.sock", std::process::id()))
    }
}

fn in_file_name(robot: &str) -> String {
    robot.replace(|c: char| !(c.is_alphanumeric() || c == '_'), "_")
}

/// Name and process id of the robot that holds a lock, as [`SocketDirectory::claim`] writes them.
fn holder_of(text: &str) -> Option<(&str, u32)> {
    let (name, pid) = text.strip_suffix(')')?.rsplit_once(" (process ")?;
    Some((name, pid.parse().ok()?))
}

fn name_and_pid(file: &OsStr) -> Option<(String, u32)> {
    let (name, pid) = file.to_str()?.strip_suffix(".sock")?.rsplit_once('-')?;
    Some((name.to_owned(), pid.parse().ok()?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::net::UnixListener;

    use super::*;

    #[test]
    fn a_new_directory_is_private_and_a_public_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sockets");
        SocketDirectory::open_at(path.clone()).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o700);
        SocketDirectory::open_at(path.clone()).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        let error = SocketDirectory::open_at(path).unwrap_err().to_string();
        assert!(error.contains("755") && error.contains("mode 700"), "{error}");
    }

    #[test]
    fn a_link_instead_of_the_directory_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (elsewhere, path) = (folder.path().join("elsewhere"), folder.path().join("sockets"));
        SocketDirectory::open_at(elsewhere.clone()).unwrap();
        std::os::unix::fs::symlink(elsewhere, &path).unwrap();
        assert!(matches!(SocketDirectory::open_at(path), Err(DirectoryError::Io { .. })));
    }

    #[test]
    fn sockets_of_dead_processes_are_removed_and_other_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let directory = SocketDirectory::open_at(folder.path().join("sockets")).unwrap();
        let in_directory = |name: &str| directory.path().join(name);
        drop(UnixListener::bind(in_directory("dead-1.sock")).unwrap());
        let _alive = UnixListener::bind(in_directory("two-words-77.sock")).unwrap();
        fs::write(in_directory("notes.txt"), "mine").unwrap();
        let robots = directory.running().unwrap();
        assert_eq!(robots.len(), 1);
        assert_eq!((robots[0].name.as_str(), robots[0].pid), ("two-words", 77));
        assert!(!in_directory("dead-1.sock").exists() && in_directory("notes.txt").exists());
    }

    #[test]
    fn only_one_robot_in_a_domain_can_claim_a_node_name() {
        let folder = tempfile::tempdir().unwrap();
        let directory = SocketDirectory::open_at(folder.path().join("sockets")).unwrap();
        let claim = directory.claim("darwin_op", "/lab/darwin_op", 7).unwrap();
        let error = directory.claim("again", "/lab/darwin_op", 7).unwrap_err().to_string();
        let holder = format!("darwin_op (process {})", std::process::id());
        assert!(error.contains(&holder) && error.contains("as /lab/darwin_op in domain 7"), "{error}");
        let _others = [("/darwin_op", 7), ("/lab/darwin_op", 8)]
            .map(|(node, domain)| directory.claim("again", node, domain).unwrap());
        drop(claim);
        directory.claim("again", "/lab/darwin_op", 7).unwrap();
        assert!(directory.running().unwrap().is_empty(), "a lock file is not a robot");
    }

    #[test]
    fn a_robot_with_a_node_and_no_socket_is_starting() {
        let folder = tempfile::tempdir().unwrap();
        let directory = SocketDirectory::open_at(folder.path().join("sockets")).unwrap();
        assert!(directory.starting().unwrap().is_empty());
        let _claim = directory.claim("my robot (2)", "/my_robot", 7).unwrap();
        let pid = std::process::id();
        assert_eq!(directory.starting().unwrap(), [("my_robot__2_".to_owned(), pid)]);
        fs::write(directory.path().join("node.dead-7-1.lock"), "dead (process 2147483647)").unwrap();
        fs::write(directory.path().join("node.odd-7-1.lock"), "odd").unwrap();
        assert_eq!(directory.starting().unwrap().len(), 1);
        let _socket = UnixListener::bind(directory.socket("my robot (2)", 1)).unwrap();
        assert!(directory.starting().unwrap().is_empty());
    }

    #[test]
    fn a_name_cannot_lead_out_of_the_directory() {
        let folder = tempfile::tempdir().unwrap();
        let directory = SocketDirectory::open_at(folder.path().join("sockets")).unwrap();
        assert_eq!(directory.socket("../../a b", 2).parent(), Some(directory.path()));
    }
}
