//! Where modules in Python come from: a file and a class that a robot file names, or a class that a script
//! passes.

use super::python_module::{PythonModule, Successor, traceback};
use downbeat::edge::foreign::Foreign;
use downbeat::executor::SettingValue;
use downbeat::robot::{Kind, ModuleSource};
use parking_lot::Mutex;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// Where one module comes from.
struct ModuleOrigin {
    source: ModuleSource,
    is_reloading: bool,
    place: Place,
    /// The version of the file that was loaded last, or that was tried last.
    version: Mutex<Option<Version>>,
}

/// Where the class is.
#[derive(Clone)]
enum Place {
    File { path: PathBuf, class: String },
    Package { package: String, class: String },
    Class(Arc<Py<PyAny>>),
}

type Version = (SystemTime, u64);

/// The kind `python` of robot files: `module = "file.py:Class"` or `module = "package.module:Class"`.
pub(crate) fn python_kind() -> Kind {
    let place = |source: &ModuleSource| match source.keys.get("module") {
        Some(SettingValue::Text(text)) => place_named(text, source),
        _ => Err("\"module\" must be a text: \"file.py:Class\" or \"package.module:Class\"".to_owned()),
    };
    let load = move |source: &ModuleSource| {
        let is_reloading = match source.keys.get("reload") {
            None => false,
            Some(SettingValue::Bool(reload)) => *reload,
            Some(other) => return Err(format!("\"reload\" must be true or false, not {other}")),
        };
        load(source, place(source)?, is_reloading)
    };
    let files =
        move |source: &ModuleSource| place(source).ok().and_then(|place| place.file()).into_iter().collect();
    Kind::foreign(
        "python",
        "a module in Python: module = \"file.py:Class\"",
        [&["module"], &["reload"]],
        load,
        files,
    )
}

/// The kind of a class that a script passes.
pub(crate) fn python_kind_of(py: Python<'_>, name: &str, class: Py<PyAny>) -> Kind {
    let about = class.getattr(py, "__doc__").and_then(|text| text.extract::<Option<String>>(py));
    let about = about.ok().flatten().and_then(|text| text.trim().lines().next().map(str::to_owned));
    let place = Place::Class(Arc::new(class));
    let of_files = place.clone();
    let load = move |source: &ModuleSource| load(source, place.clone(), false);
    let files = move |_: &ModuleSource| of_files.file().into_iter().collect();
    Kind::foreign(name, about.unwrap_or_else(|| "a module in Python".to_owned()), [&[], &[]], load, files)
}

fn place_named(text: &str, source: &ModuleSource) -> Result<Place, String> {
    let Some((place, class)) =
        text.rsplit_once(':').filter(|(place, class)| !place.is_empty() && !class.is_empty())
    else {
        return Err(format!(
            "module = {text:?} names no class: write \"file.py:Class\" or \"package.module:Class\""
        ));
    };
    let class = class.to_owned();
    Ok(match place.ends_with(".py") {
        true => Place::File { path: source.folder.join(place), class },
        false => Place::Package { package: place.to_owned(), class },
    })
}

fn load(source: &ModuleSource, place: Place, is_reloading: bool) -> Result<Box<dyn Foreign>, String> {
    if is_reloading && !matches!(place, Place::File { .. }) {
        return Err("reload = true needs a file: module = \"file.py:Class\"".to_owned());
    }
    let origin = ModuleOrigin { source: source.clone(), is_reloading, place, version: Mutex::default() };
    *origin.version.lock() = origin.place.version();
    Arc::new(origin).instantiate()
}

impl ModuleOrigin {
    fn instantiate(self: Arc<Self>) -> Result<Box<dyn Foreign>, String> {
        for folder in &self.source.interfaces {
            crate::messages::search(folder)
                .map_err(|error| Python::attach(|py| error.value(py).to_string()))?;
        }
        Python::attach(|py| {
            let class = self.place.class(py, |file| self.source.file_to_read(file));
            let origin = Arc::clone(&self);
            let successor = self.is_reloading.then(|| Box::new(move || origin.successor()) as Successor);
            let loaded = class.and_then(|class| PythonModule::new(&class, &self.source, successor));
            match loaded {
                Ok(module) => Ok(Box::new(module) as Box<dyn Foreign>),
                Err(error) => Err(self.place.explain(py, &error)),
            }
        })
    }

    /// A new version of the module, if the file has changed since it was loaded.
    fn successor(&self) -> Result<Option<Box<dyn Foreign>>, String> {
        let version = self.place.version();
        let mut known = self.version.lock();
        // An editor may remove the file for a moment.
        if version.is_none() || *known == version {
            return Ok(None);
        }
        *known = version;
        drop(known);
        let Self { source, is_reloading, place, .. } = self;
        let (source, place) = (source.clone(), place.clone());
        let origin = Self { source, is_reloading: *is_reloading, place, version: Mutex::new(version) };
        Arc::new(origin).instantiate().map(Some)
    }
}

impl Place {
    /// Loads the class. `content` names the file with the content of a file, which is another one in a replay
    /// of an earlier version.
    fn class<'py>(
        &self,
        py: Python<'py>,
        content: impl FnOnce(&Path) -> PathBuf,
    ) -> PyResult<Bound<'py, PyAny>> {
        let loading = py.import("downbeat.loading")?;
        match self {
            Self::File { path, class } => loading.call_method1("class_of_file", (path, class, content(path))),
            Self::Package { package, class } => loading.call_method1("class_of_package", (package, class)),
            Self::Class(class) => loading.call_method1("checked", (class.bind(py),)),
        }
    }

    /// The file with the class.
    fn file(&self) -> Option<PathBuf> {
        match self {
            Self::File { path, .. } => Some(path.clone()),
            Self::Package { .. } | Self::Class(_) => Python::attach(|py| {
                let class = self.class(py, Path::to_owned).ok()?;
                let file = py
                    .import("downbeat.loading")
                    .and_then(|module| module.call_method1("file_of_class", (class,)));
                file.ok()?.extract::<Option<PathBuf>>().ok()?
            }),
        }
    }

    fn version(&self) -> Option<Version> {
        let Self::File { path, .. } = self else { return None };
        let metadata = std::fs::metadata(path).ok()?;
        Some((metadata.modified().ok()?, metadata.len()))
    }

    /// Why the class cannot be used: in one sentence where the loader knows the reason, as a traceback
    /// otherwise.
    fn explain(&self, py: Python<'_>, error: &PyErr) -> String {
        let known = py.import("downbeat.loading").and_then(|module| module.getattr("LoadError"));
        match known.is_ok_and(|known| error.is_instance(py, &known)) {
            true => error.value(py).to_string(),
            false => traceback(py, error),
        }
    }
}
