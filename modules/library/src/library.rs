//! Shared libraries: checked, loaded, never unloaded.

use downbeat_library_abi::{ABI_VERSION, ModuleFunction, ModuleV1, SYMBOL};
use downbeat_msgs::user_file;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// Why a library cannot be used.
#[derive(Debug, Error)]
pub enum LibraryError {
    /// The file cannot be read.
    #[error(
        "cannot read the library {path}: {source}; `path` of the module is relative to the robot file, build the library first"
    )]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is something else.
    #[error(
        "{path} is {found}, not {expected}; build the library for this machine (for C: `cc -shared -fPIC`)"
    )]
    NotALibrary {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: String,
        /// What this machine loads.
        expected: String,
    },
    /// The file is not complete.
    #[error("{path} ends in the middle: it has {size} bytes of {expected}; build the library again")]
    Incomplete {
        /// The file.
        path: PathBuf,
        /// Its size in bytes.
        size: u64,
        /// The size that its header declares.
        expected: u64,
    },
    /// The copy that is loaded cannot be written.
    #[error("cannot copy the library to {path}: {source}; set TMPDIR to a folder with space")]
    Copy {
        /// The copy.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system cannot load it.
    #[error("cannot load the library {path}: {reason}; see `ldd -r {path}` for what it lacks")]
    Load {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// It is no library of a module.
    #[error(
        "the library {path} does not export `{SYMBOL}`: use DOWNBEAT_MODULE(Class) of downbeat.hpp, define it as in downbeat.h, or \
         use export_module! in Rust"
    )]
    NoSymbol {
        /// The file.
        path: PathBuf,
    },
    /// It gave no table.
    #[error("`{SYMBOL}` of the library {path} returned NULL; it must return the table of the module")]
    NoTable {
        /// The file.
        path: PathBuf,
    },
    /// It was compiled with another version of the interface.
    #[error(
        "the library {path} has version {found} of the module interface, this program has version {ABI_VERSION}; compile it with \
         the downbeat.h that `downbeat interface generate` writes"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Its table is too short.
    #[error(
        "the table of the library {path} declares {found} bytes, {expected} are needed; set struct_size to \
         sizeof(downbeat_module_v1)"
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// What it declares.
        found: u32,
        /// What is needed.
        expected: usize,
    },
    /// A function is missing.
    #[error("the table of the library {path} has no function `{function}`, which every module needs")]
    NoFunction {
        /// The file.
        path: PathBuf,
        /// The function.
        function: &'static str,
    },
}

/// A loaded library. Its functions stay where they are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Library {
    /// As far as the library has it.
    pub(crate) table: ModuleV1,
}

impl Library {
    /// Loads the file itself.
    pub(crate) fn load(path: &Path) -> Result<Self, LibraryError> {
        check(path, &read(path)?)?;
        // The absolute name, so that the system does not search for it.
        let file = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        Self::open(&file, path)
    }

    /// Loads a copy under a name that was never loaded. Afterwards the file may be changed.
    pub(crate) fn load_copy(path: &Path) -> Result<Self, LibraryError> {
        static COPIES: AtomicU64 = AtomicU64::new(0);
        let content = read(path)?;
        check(path, &content)?;
        let number = COPIES.fetch_add(1, Ordering::Relaxed);
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let copy = std::env::temp_dir().join(format!("downbeat-{}-{number}-{name}", std::process::id()));
        let written = File::create_new(&copy).and_then(|mut file| file.write_all(&content));
        let loaded = match written {
            Ok(()) => Self::open(&copy, path),
            Err(source) => Err(LibraryError::Copy { path: copy.clone(), source }),
        };
        // A loaded file needs no name.
        let _ = std::fs::remove_file(copy);
        loaded
    }

    #[expect(unsafe_code, reason = "loading a library and calling it")]
    fn open(file: &Path, path: &Path) -> Result<Self, LibraryError> {
        let path = path.to_owned();
        // SAFETY: initializers of the library run; who names a library in a robot file trusts it as the
        // program itself.
        let library = match unsafe { libloading::Library::new(file) } {
            Ok(library) => library,
            Err(error) => return Err(LibraryError::Load { path, reason: with_causes(&error) }),
        };
        // Never unloaded, see the documentation of the crate.
        let library = Box::leak(Box::new(library));
        // SAFETY: downbeat.h declares the symbol with this type.
        let Ok(function) = (unsafe { library.get::<ModuleFunction>(SYMBOL.as_bytes()) }) else {
            return Err(LibraryError::NoSymbol { path });
        };
        // SAFETY: as before; the table is static by the contract of downbeat.h, and starts with version and
        // size.
        let table = unsafe { function() };
        if table.is_null() {
            return Err(LibraryError::NoTable { path });
        }
        // SAFETY: not null; each version of the table starts with these two numbers.
        let [version, size] = unsafe { table.cast::<[u32; 2]>().read_unaligned() };
        if version != ABI_VERSION {
            return Err(LibraryError::Version { path, found: version });
        }
        let expected = ModuleV1::FIRST_SIZE;
        if (size as usize) < expected {
            return Err(LibraryError::Size { path, found: size, expected });
        }
        // SAFETY: the table has this version and size.
        let table = unsafe { copy_of(table, size as usize) };
        let functions = [
            ("create", table.create.is_some()),
            ("setup", table.setup.is_some()),
            ("handle", table.handle.is_some()),
            ("destroy", table.destroy.is_some()),
        ];
        match functions.into_iter().find(|(_, is_there)| !is_there) {
            Some((function, _)) => Err(LibraryError::NoFunction { path, function }),
            None => Ok(Self { table }),
        }
    }
}

/// Copies a table of this size, which may be shorter or longer than that of this program. Functions that it
/// lacks, or has in part, are missing in the copy.
///
/// # Safety
/// `table` points to `size` bytes of a table of this version.
#[expect(unsafe_code, reason = "reads what a library points to")]
unsafe fn copy_of(table: *const ModuleV1, size: usize) -> ModuleV1 {
    let mut copy = ModuleV1::EMPTY;
    let size = size.min(size_of::<ModuleV1>());
    // Behind the two numbers at its head, a table consists of pointers.
    let size = size - size % size_of::<usize>();
    // SAFETY: by the contract of this function, and both have at least this size. Each function is null or
    // valid by the contract of downbeat.h.
    unsafe { table.cast::<u8>().copy_to_nonoverlapping((&raw mut copy).cast::<u8>(), size) };
    copy
}

fn with_causes(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(source) => source.to_string(),
        None => error.to_string(),
    }
}

/// The largest library, in bytes.
const LARGEST: u64 = 1 << 30;

fn read(path: &Path) -> Result<Vec<u8>, LibraryError> {
    user_file::read_within(path, LARGEST)
        .map_err(|source| LibraryError::Read { path: path.to_owned(), source })
}

/// ELF machine numbers and names (System V ABI, `e_machine`).
const MACHINES: [(u16, &str, &str); 7] = [
    (3, "x86", "x86"),
    (8, "mips", "MIPS"),
    (21, "powerpc64", "PowerPC 64"),
    (40, "arm", "ARM (32 bit)"),
    (62, "x86_64", "x86-64"),
    (183, "aarch64", "AArch64"),
    (243, "riscv64", "RISC-V"),
];

/// Checks that the content is a complete shared library for this machine, as far as the system would not
/// report it well.
fn check(path: &Path, content: &[u8]) -> Result<(), LibraryError> {
    if !cfg!(target_os = "linux") {
        return Ok(());
    }
    let own = MACHINES.iter().find(|(_, arch, _)| *arch == std::env::consts::ARCH);
    let refuse = |found: &str| {
        let machine = own.map_or(std::env::consts::ARCH, |(_, _, name)| name);
        Err(LibraryError::NotALibrary {
            path: path.to_owned(),
            found: found.to_owned(),
            expected: format!("a shared library (ELF) for {machine}"),
        })
    };
    let Some(elf) = Elf::parse(content) else {
        return refuse(match content {
            [] => "an empty file",
            [b'M', b'Z', ..] => "a program or library of Windows",
            [0xcf | 0xce, 0xfa, 0xed, 0xfe, ..] | [0xca, 0xfe, 0xba, 0xbe, ..] => {
                "a program or library of macOS"
            }
            [b'!', b'<', b'a', b'r', b'c', b'h', b'>', ..] => "a static library",
            [0x7f, b'E', b'L', b'F', ..] => "a damaged ELF file",
            _ => "no library",
        });
    };
    if let Some((machine, _, _)) = own
        && elf.machine != *machine
    {
        return refuse(&match MACHINES.iter().find(|(machine, _, _)| *machine == elf.machine) {
            Some((_, _, name)) => format!("a library for {name}"),
            None => format!("a library for another machine (ELF number {})", elf.machine),
        });
    }
    match elf.kind {
        3 => {}
        1 => return refuse("an object file"),
        _ => return refuse("a program"),
    }
    let size = content.len() as u64;
    if elf.end > size {
        return Err(LibraryError::Incomplete { path: path.to_owned(), size, expected: elf.end });
    }
    Ok(())
}

/// What the header of an ELF file says.
struct Elf {
    kind: u16,
    machine: u16,
    /// The end of the table of sections, which linkers write last.
    end: u64,
}

impl Elf {
    fn parse(content: &[u8]) -> Option<Self> {
        let header = content.strip_prefix(b"\x7fELF")?;
        let (is_64, is_little) = (*header.first()? == 2, *header.get(1)? == 1);
        let number = |at: usize, size: usize| {
            let bytes = content.get(at..at + size)?;
            let add = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
            Some(if is_little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) })
        };
        let half = |at| number(at, 2).and_then(|number| u16::try_from(number).ok());
        let [offset, entry] = if is_64 { [number(40, 8)?, 58] } else { [number(32, 4)?, 46] };
        let sections = u64::from(half(entry as usize)?) * u64::from(half(entry as usize + 2)?);
        Some(Self { kind: half(16)?, machine: half(18)?, end: offset.checked_add(sections)? })
    }
}
