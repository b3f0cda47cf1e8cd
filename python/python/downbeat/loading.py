"""How the classes of modules are found; used by the extension module."""

import importlib
import importlib.util
import inspect
import itertools
import linecache
import sys
import types
from pathlib import Path
from typing import Any

from downbeat.module import Module


class LoadError(Exception):
    """A module cannot be loaded, for a reason that needs no traceback."""


_numbers = itertools.count()


def class_of_file(path: str | Path, name: str, content: str | Path | None = None) -> type[Module]:
    """Returns the class ``name`` of a file, which is imported anew under a name of its own.

    The text is that of the file ``content`` if it is given: what the file held earlier.
    """
    path = Path(path).absolute()
    content = path if content is None else Path(content).absolute()
    if not content.is_file():
        raise LoadError(f"{content}: there is no such file")
    # Beside it, as for a script.
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    # Two versions that are written within one tick of the file system's clock must not share a cache.
    try:
        code = compile(content.read_bytes(), str(path), "exec")
    except SyntaxError as error:
        line = (error.text or "").strip()
        raise LoadError(f"{path}:{error.lineno}: {error.msg}: {line}") from None
    linecache.checkcache(str(path))
    module = types.ModuleType(f"_downbeat_{path.stem}_{next(_numbers)}")
    module.__file__ = str(path)
    # Classes that are pickled or defined by `dataclass` look their module up.
    sys.modules[module.__name__] = module
    try:
        exec(code, module.__dict__)
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return _class_of(module, name, str(path))


def class_of_package(package: str, name: str) -> type[Module]:
    """Returns the class ``name`` of a module that Python finds by its name."""
    if importlib.util.find_spec(package.partition(".")[0]) is None:
        raise LoadError(
            f'there is no Python module "{package}": install it for {sys.executable}, '
            'or name a file, as in "file.py:Class"'
        )
    return _class_of(importlib.import_module(package), name, package)


def checked(found: Any) -> type[Module]:
    """Returns ``found`` if it is a class of modules."""
    if not (isinstance(found, type) and issubclass(found, Module)):
        raise LoadError(f"{found!r} is no subclass of downbeat.Module")
    return found


def file_of_class(found: type[Module]) -> str | None:
    """Returns the file with the source of a class, if it has one."""
    try:
        return inspect.getsourcefile(found)
    except TypeError:
        return None


def place_of_thread(identity: int) -> str | None:
    """Returns the file, line and function that a thread is in, without those of this package."""
    frame = sys._current_frames().get(identity)
    own = str(Path(__file__).parent)
    while frame is not None and frame.f_code.co_filename.startswith(own):
        frame = frame.f_back
    if frame is None:
        return None
    return f"{frame.f_code.co_filename}:{frame.f_lineno}, in {frame.f_code.co_name}"


def _class_of(module: types.ModuleType, name: str, place: str) -> type[Module]:
    found = getattr(module, name, None)
    if found is None:
        classes = [known for known, value in vars(module).items() if _is_own_class(value, module)]
        there_is = f"; there is {', '.join(classes)}" if classes else ""
        raise LoadError(f'{place}: there is no class "{name}"{there_is}')
    if not (isinstance(found, type) and issubclass(found, Module)):
        raise LoadError(f"{place}: {name} is no subclass of downbeat.Module")
    return found


def _is_own_class(value: Any, module: types.ModuleType) -> bool:
    return isinstance(value, type) and issubclass(value, Module) and value.__module__ == module.__name__
