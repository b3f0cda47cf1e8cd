//! MuJoCo's library, loaded at run time: a model and its state, by the functions of its C interface that take
//! names and vectors. No layout of its structs is used, only signatures and constants of `mujoco.h` and
//! `mjtype.h` of one version.
//!
//! # References
//! <https://mujoco.readthedocs.io/en/stable/APIreference/APIfunctions.html>

// This file is the boundary to a C library: each call and each pointer is unsafe, with the reason why it is
// sound.
#![allow(unsafe_code)]

use crate::world::EngineError;
use libloading::Library;
use std::ffi::{CStr, CString, OsStr, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{NonNull, null};
use std::sync::Once;

/// The only supported version, and what `mj_version` returns for it.
const VERSION: &str = "3.17.0";
const VERSION_NUMBER: c_int = 3_017_000;

/// Kinds of objects with names (`mjtObj`).
#[derive(Clone, Copy)]
pub(super) enum Object {
    Body = 1,
    Joint = 3,
}

/// Vectors of the state (`mjtState`).
#[derive(Clone, Copy)]
pub(super) enum Vector {
    Positions = 1 << 1,
    Velocities = 1 << 2,
    AppliedForces = 1 << 7,
}

type Spec = c_void;
type Model = c_void;
type Data = c_void;

/// The functions, with the signatures of `mujoco.h`.
struct Functions {
    parse_xml_string: unsafe extern "C" fn(*const c_char, *const c_void, *mut c_char, c_int) -> *mut Spec,
    compile: unsafe extern "C" fn(*mut Spec, *const c_void) -> *mut Model,
    spec_error: unsafe extern "C" fn(*mut Spec) -> *const c_char,
    delete_spec: unsafe extern "C" fn(*mut Spec),
    delete_model: unsafe extern "C" fn(*mut Model),
    make_data: unsafe extern "C" fn(*const Model) -> *mut Data,
    delete_data: unsafe extern "C" fn(*mut Data),
    set_total_mass: unsafe extern "C" fn(*mut Model, f64),
    name_to_id: unsafe extern "C" fn(*const Model, c_int, *const c_char) -> c_int,
    state_size: unsafe extern "C" fn(*const Model, c_int) -> c_int,
    get_state: unsafe extern "C" fn(*const Model, *const Data, *mut f64, c_int),
    set_state: unsafe extern "C" fn(*const Model, *mut Data, *const f64, c_int),
    forward: unsafe extern "C" fn(*const Model, *mut Data),
    step: unsafe extern "C" fn(*const Model, *mut Data),
    apply_force:
        unsafe extern "C" fn(*const Model, *mut Data, *const f64, *const f64, *const f64, c_int, *mut f64),
}

/// A model and its state.
pub(super) struct Simulated {
    functions: Functions,
    model: NonNull<Model>,
    data: NonNull<Data>,
    /// Keeps the functions valid; last, so that it is dropped last.
    _library: Library,
}

// SAFETY: model and data are owned by this value and reached through it only, and MuJoCo keeps no state per
// thread about them.
unsafe impl Send for Simulated {}

impl Simulated {
    /// Compiles a model in MJCF. All masses and inertias are multiplied by the same number so that their sum
    /// is `total_mass`, in kg.
    pub(super) fn new(
        mjcf: &str,
        total_mass: f64,
        refused: impl Fn(String) -> EngineError,
    ) -> Result<Self, EngineError> {
        let (library, functions) = load(&find()?)?;
        let mjcf = CString::new(mjcf).map_err(|error| refused(error.to_string()))?;
        let mut error = [0; 1000];
        // SAFETY: the text ends with 0, the buffer of the error has the given size; no files are needed.
        let spec = unsafe {
            (functions.parse_xml_string)(mjcf.as_ptr(), null(), error.as_mut_ptr(), error.len() as c_int)
        };
        if spec.is_null() {
            // SAFETY: MuJoCo ends the error with 0, and it was all 0 before.
            return Err(refused(unsafe { text(error.as_ptr()) }));
        }
        // SAFETY: the description is valid until it is deleted, the model does not refer to it, and the error
        // is copied before.
        let model = unsafe {
            let model = NonNull::new((functions.compile)(spec, null()));
            let model = model.ok_or_else(|| refused(text((functions.spec_error)(spec))));
            (functions.delete_spec)(spec);
            model?
        };
        // SAFETY: the model is valid. Without data (no memory is left), it is deleted here and not used any
        // more.
        let data = unsafe {
            (functions.set_total_mass)(model.as_ptr(), total_mass);
            NonNull::new((functions.make_data)(model.as_ptr())).ok_or_else(|| {
                (functions.delete_model)(model.as_ptr());
                refused("no memory is left".to_owned())
            })?
        };
        Ok(Self { functions, model, data, _library: library })
    }

    /// The number of a body or joint; `None` if there is none of this name.
    pub(super) fn id(&self, object: Object, name: &str) -> Option<usize> {
        let name = CString::new(name).ok()?;
        // SAFETY: the model is valid, and the name ends with 0.
        let id = unsafe { (self.functions.name_to_id)(self.model.as_ptr(), object as c_int, name.as_ptr()) };
        usize::try_from(id).ok()
    }

    /// A vector of the state.
    pub(super) fn get(&self, vector: Vector) -> Vec<f64> {
        let mut numbers = vec![0.0; self.size(vector)];
        // SAFETY: model and data belong together, and there is room for as many numbers as MuJoCo says.
        unsafe {
            let (model, data) = (self.model.as_ptr(), self.data.as_ptr());
            (self.functions.get_state)(model, data, numbers.as_mut_ptr(), vector as c_int);
        }
        numbers
    }

    /// Sets a vector of the state.
    ///
    /// # Panics
    /// If it has another length than [`Simulated::get`] returns.
    pub(super) fn set(&mut self, vector: Vector, numbers: &[f64]) {
        assert_eq!(numbers.len(), self.size(vector), "the length of a vector of the state");
        // SAFETY: model and data belong together, and the vector has the length that MuJoCo reads.
        unsafe {
            let (model, data) = (self.model.as_ptr(), self.data.as_ptr());
            (self.functions.set_state)(model, data, numbers.as_ptr(), vector as c_int);
        }
    }

    fn size(&self, vector: Vector) -> usize {
        // SAFETY: the model is valid.
        let size = unsafe { (self.functions.state_size)(self.model.as_ptr(), vector as c_int) };
        usize::try_from(size).unwrap_or(0)
    }

    /// Computes what depends on a state that was set.
    pub(super) fn forward(&mut self) {
        // SAFETY: model and data belong together.
        unsafe { (self.functions.forward)(self.model.as_ptr(), self.data.as_ptr()) }
    }

    /// Advances by one step of the model.
    pub(super) fn step(&mut self) {
        // SAFETY: model and data belong together.
        unsafe { (self.functions.step)(self.model.as_ptr(), self.data.as_ptr()) }
    }

    /// Adds a force in N on a point of a body, along the axes of the world, to applied forces.
    ///
    /// # Panics
    /// If the applied forces have another length than [`Simulated::get`] returns.
    pub(super) fn add_force(&mut self, body: usize, force: [f64; 3], point: [f64; 3], applied: &mut [f64]) {
        assert_eq!(applied.len(), self.size(Vector::AppliedForces), "the length of the applied forces");
        let Ok(body) = c_int::try_from(body) else { return };
        // SAFETY: model and data belong together, force and point have three numbers, no torque is allowed,
        // the body is one that `id` returned, and there is a number for each degree of freedom.
        unsafe {
            let (model, data) = (self.model.as_ptr(), self.data.as_ptr());
            let (force, point, applied) = (force.as_ptr(), point.as_ptr(), applied.as_mut_ptr());
            (self.functions.apply_force)(model, data, force, null(), point, body, applied);
        }
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        // SAFETY: both are owned and not used any more; the library is still loaded.
        unsafe {
            (self.functions.delete_data)(self.data.as_ptr());
            (self.functions.delete_model)(self.model.as_ptr());
        }
    }
}

/// The file of the library.
fn find() -> Result<PathBuf, EngineError> {
    if let Some(file) = std::env::var_os("DOWNBEAT_MUJOCO") {
        return Ok(file.into());
    }
    let active = std::env::var_os("VIRTUAL_ENV").map(PathBuf::from);
    let here = std::env::current_dir().unwrap_or_default();
    let environments = active.into_iter().chain(here.ancestors().map(|folder| folder.join("target/venv")));
    let entries = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let starts_with = |path: &Path, start: &str| {
        path.file_name().and_then(OsStr::to_str).is_some_and(|name| name.starts_with(start))
    };
    environments
        .flat_map(|environment| entries(&environment.join("lib")).map(|entry| entry.path()))
        .filter(|path| starts_with(path, "python"))
        .flat_map(|python| entries(&python.join("site-packages/mujoco")).map(|entry| entry.path()))
        .find(|path| starts_with(path, "libmujoco.so."))
        .ok_or(EngineError::NoLibrary { version: VERSION })
}

fn load(file: &Path) -> Result<(Library, Functions), EngineError> {
    let name = || file.display().to_string();
    let unusable =
        |error: libloading::Error| EngineError::Library { file: name(), reason: error.to_string() };
    // SAFETY: the initialisers of MuJoCo's library have no preconditions. That the file is MuJoCo is up to
    // who names it, as with every library.
    let library = unsafe { Library::new(file) }.map_err(unusable)?;
    // SAFETY: the signatures are those of the header of the version that is checked first. `mj_version` and
    // `mj_versionString` have had theirs in all versions.
    let functions = unsafe {
        let version = *library.get::<unsafe extern "C" fn() -> c_int>(b"mj_version\0").map_err(unusable)?;
        if version() != VERSION_NUMBER {
            let found = library.get::<unsafe extern "C" fn() -> *const c_char>(b"mj_versionString\0");
            let found = found.map_err(unusable).map(|found| text(found()))?;
            return Err(EngineError::Version { file: name(), found, version: VERSION });
        }
        Functions {
            parse_xml_string: *library.get(b"mj_parseXMLString\0").map_err(unusable)?,
            compile: *library.get(b"mj_compile\0").map_err(unusable)?,
            spec_error: *library.get(b"mjs_getError\0").map_err(unusable)?,
            delete_spec: *library.get(b"mj_deleteSpec\0").map_err(unusable)?,
            delete_model: *library.get(b"mj_deleteModel\0").map_err(unusable)?,
            make_data: *library.get(b"mj_makeData\0").map_err(unusable)?,
            delete_data: *library.get(b"mj_deleteData\0").map_err(unusable)?,
            set_total_mass: *library.get(b"mj_setTotalmass\0").map_err(unusable)?,
            name_to_id: *library.get(b"mj_name2id\0").map_err(unusable)?,
            state_size: *library.get(b"mj_stateSize\0").map_err(unusable)?,
            get_state: *library.get(b"mj_getState\0").map_err(unusable)?,
            set_state: *library.get(b"mj_setState\0").map_err(unusable)?,
            forward: *library.get(b"mj_forward\0").map_err(unusable)?,
            step: *library.get(b"mj_step\0").map_err(unusable)?,
            apply_force: *library.get(b"mj_applyFT\0").map_err(unusable)?,
        }
    };
    static WARNINGS: Once = Once::new();
    WARNINGS.call_once(|| {
        // SAFETY: the variable is a handler of this type, which this program writes once, before it calls
        // anything that warns.
        unsafe {
            if let Ok(handler) =
                library.get::<*mut Option<unsafe extern "C" fn(*const c_char)>>(b"mju_user_warning\0")
            {
                **handler = Some(warn);
            }
        }
    });
    Ok((library, functions))
}

/// Without it, MuJoCo writes its warnings into a file in the working folder.
unsafe extern "C" fn warn(message: *const c_char) {
    // SAFETY: MuJoCo passes a text that ends with 0.
    tracing::warn!("MuJoCo: {}", unsafe { text(message) });
}

/// # Safety
/// The text ends with 0, or is null.
unsafe fn text(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}
