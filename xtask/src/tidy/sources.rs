//! The files of a package and which of them use which, found from the paths in their code.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::tokens::{self, Content, Import};

/// The files of one crate, and the names for which each uses another.
pub(super) struct Sources {
    modules: Vec<Module>,
}

struct Module {
    file: PathBuf,
    parent: Option<usize>,
    children: BTreeMap<String, usize>,
    imports: Vec<Import>,
    paths: BTreeSet<Vec<String>>,
    items: BTreeSet<String>,
}

/// Why a file uses another.
pub(super) type Arrows = BTreeMap<(PathBuf, PathBuf), BTreeSet<String>>;

/// Where a path leads: to a module, or to an item in one.
#[derive(Clone, Copy)]
enum Target {
    Module(usize),
    ItemOf(usize),
}

impl Target {
    fn module(self) -> usize {
        match self {
            Self::Module(module) | Self::ItemOf(module) => module,
        }
    }
}

impl Sources {
    /// Reads the crate whose root is `root`.
    pub(super) fn read(root: &Path) -> anyhow::Result<Self> {
        let mut sources = Self { modules: Vec::new() };
        let folder = root.parent().unwrap_or(Path::new(""));
        sources.add_file(root, folder, None)?;
        Ok(sources)
    }

    /// `folder` is where the modules of this file are.
    fn add_file(&mut self, file: &Path, folder: &Path, parent: Option<usize>) -> anyhow::Result<usize> {
        let source =
            std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let content = tokens::read(&source).with_context(|| file.display().to_string())?;
        self.add(content, file, folder, parent)
    }

    fn add(
        &mut self,
        content: Content,
        file: &Path,
        folder: &Path,
        parent: Option<usize>,
    ) -> anyhow::Result<usize> {
        let Content { files, inline, imports, paths, items } = content;
        let this = self.modules.len();
        let (file, children) = (file.to_owned(), BTreeMap::new());
        self.modules.push(Module { file: file.clone(), parent, children, imports, paths, items });
        for (name, path) in files {
            let own_folder = folder.join(&name);
            let candidates = match path {
                Some(path) => vec![file.with_file_name(path)],
                None => vec![folder.join(format!("{name}.rs")), own_folder.join("mod.rs")],
            };
            // A module behind a macro may have no file.
            let Some(found) = candidates.into_iter().find(|path| path.exists()) else { continue };
            let child = self.add_file(&found, &own_folder, Some(this))?;
            self.modules[this].children.insert(name, child);
        }
        for (name, content) in inline {
            let child = self.add(content, &file, &folder.join(&name), Some(this))?;
            self.modules[this].children.insert(name, child);
        }
        Ok(this)
    }

    /// Which file uses which.
    pub(super) fn arrows(&self) -> Arrows {
        let mut arrows = Arrows::new();
        for (index, module) in self.modules.iter().enumerate() {
            let imported = module.imports.iter().map(|import| &import.path);
            for path in imported.chain(&module.paths) {
                let Some(target) = self.resolve(index, path, 0) else { continue };
                let other = &self.modules[target.module()];
                if other.file != module.file {
                    let name = path.last().cloned().unwrap_or_default();
                    arrows.entry((module.file.clone(), other.file.clone())).or_default().insert(name);
                }
            }
        }
        arrows
    }

    /// For each file that a module of another file declares, that one.
    pub(super) fn declared_by(&self) -> BTreeMap<&Path, &Path> {
        let declared = self.modules.iter().filter_map(|module| {
            let parent = &self.modules[module.parent?];
            (parent.file != module.file).then_some((&*module.file, &*parent.file))
        });
        declared.collect()
    }

    /// `depth` counts imports that lead to imports, which may be circular.
    fn resolve(&self, from: usize, path: &[String], depth: usize) -> Option<Target> {
        let (first, rest) = path.split_first()?;
        let begin = match first.as_str() {
            "crate" => Target::Module(0),
            "self" => Target::Module(from),
            "super" => Target::Module(self.modules[from].parent?),
            name => self.named(from, name, depth).filter(|target| matches!(target, Target::Module(_)))?,
        };
        rest.iter().try_fold(begin, |at, name| match at {
            Target::ItemOf(_) => Some(at),
            Target::Module(module) if name == "super" => self.modules[module].parent.map(Target::Module),
            Target::Module(module) => Some(self.named(module, name, depth).unwrap_or(Target::ItemOf(module))),
        })
    }

    /// What a name is in a module: one that it declares or imports.
    fn named(&self, module: usize, name: &str, depth: usize) -> Option<Target> {
        let Module { children, imports, items, .. } = &self.modules[module];
        if let Some(child) = children.get(name) {
            return Some(Target::Module(*child));
        }
        if items.contains(name) {
            return Some(Target::ItemOf(module));
        }
        if depth == DEEPEST {
            return None;
        }
        let import = imports.iter().find(|import| import.name == name && import.path != [name]);
        if let Some(import) = import {
            return self.resolve(module, &import.path, depth + 1);
        }
        imports.iter().filter(|import| import.name == "*").find_map(|import| {
            match self.resolve(module, &import.path, depth + 1)? {
                Target::Module(all) if all != module => self.named(all, name, depth + 1),
                _ => None,
            }
        })
    }
}

/// The most imports that are followed from one name.
const DEEPEST: usize = 8;

/// Returns the circles of files that use each other, each in the order of its paths. Arrows from a file to
/// the modules below it do not count, because a `mod.rs` may use its children and share items with them.
pub(super) fn circles(arrows: &Arrows, declared_by: &BTreeMap<&Path, &Path>) -> Vec<Vec<PathBuf>> {
    let declares = |above: &Path, file: &Path| {
        std::iter::successors(declared_by.get(file), |parent| declared_by.get(**parent))
            .any(|parent| *parent == above)
    };
    let mut uses: BTreeMap<&Path, Vec<&Path>> = BTreeMap::new();
    for (from, to) in arrows.keys().filter(|(from, to)| !declares(from, to)) {
        uses.entry(from).or_default().push(to);
    }
    let reached = |start: &Path| {
        let mut found = BTreeSet::new();
        let mut next: Vec<&Path> = uses.get(start).cloned().unwrap_or_default();
        while let Some(file) = next.pop() {
            if found.insert(file) {
                next.extend(uses.get(file).into_iter().flatten());
            }
        }
        found
    };
    let reached: BTreeMap<&Path, BTreeSet<&Path>> = uses.keys().map(|file| (*file, reached(file))).collect();
    let reaches = |from: &Path, to: &Path| reached.get(from).is_some_and(|found| found.contains(to));
    let mut circles: BTreeSet<Vec<PathBuf>> = BTreeSet::new();
    for file in reached.keys().filter(|file| reaches(file, file)) {
        let circle = reached.keys().filter(|other| reaches(file, other) && reaches(other, file));
        circles.insert(circle.map(|file| file.to_path_buf()).collect());
    }
    circles.into_iter().collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A crate of these files.
    fn written(files: &[(&str, &str)]) -> (tempfile::TempDir, Sources) {
        let folder = tempfile::tempdir().unwrap();
        for (name, source) in files {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, source).unwrap();
        }
        let sources = Sources::read(&folder.path().join("lib.rs")).unwrap();
        (folder, sources)
    }

    fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let (folder, sources) = written(files);
        let circles = circles(&sources.arrows(), &sources.declared_by());
        let name = |file: &PathBuf| file.strip_prefix(folder.path()).unwrap().display().to_string();
        circles.iter().map(|circle| circle.iter().map(name).collect()).collect()
    }

    #[test]
    fn a_circle_is_found_through_imports_of_others() {
        let found = circles_of(&[
            ("lib.rs", "mod a; mod b; pub use a::First; pub use b::Second;"),
            ("a.rs", "use crate::Second; pub struct First;"),
            ("b/mod.rs", "mod c; pub use c::Second;"),
            ("b/c.rs", "pub struct Second; fn f() { crate::a::g(); }"),
        ]);
        assert_eq!(found, [["a.rs", "b/c.rs"]]);
    }

    #[test]
    fn a_module_may_share_with_the_file_that_declares_it() {
        let found = circles_of(&[
            ("lib.rs", "mod a; pub struct Shared; fn f() { a::work(); }"),
            ("a.rs", "mod b; use super::Shared; pub(crate) use b::work; pub struct Also;"),
            ("a/b.rs", "use super::Also; use crate::Shared; pub fn work() {}"),
        ]);
        assert_eq!(found, Vec::<Vec<String>>::new());
    }

    #[test]
    fn what_tests_use_does_not_count() {
        let found = circles_of(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "use crate::b::B; pub struct A;"),
            ("b.rs", "pub struct B; #[cfg(test)] mod tests { use crate::a::A; }"),
        ]);
        assert_eq!(found, Vec::<Vec<String>>::new());
    }
}
