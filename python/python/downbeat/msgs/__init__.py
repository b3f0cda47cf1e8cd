"""Message classes of every interface: ``from downbeat.msgs.sensor_msgs.msg import JointState``.

A package has the modules ``msg``, ``srv`` and ``action``. Classes are created on first use, from the definitions that downbeat
carries, from folders given to :func:`search`, and from ``AMENT_PREFIX_PATH``, in this order. A service such as
``std_srvs.srv.SetBool`` has the classes ``Request``, ``Response`` and ``Event``; an action has ``Goal``, ``Result`` and
``Feedback``.
"""

from __future__ import annotations

import difflib
import importlib.machinery
import os
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from types import ModuleType
from typing import Any

from downbeat import _core

__all__ = ["message_class", "search"]

_KINDS = {"msg": "Messages", "srv": "Services", "action": "Actions"}
_PARTS = {"srv": ("Request", "Response", "Event"), "action": ("Goal", "Result", "Feedback")}


def message_class(name: str) -> type[_core.Message]:
    """The class of the messages of a type, named as in ``sensor_msgs/msg/Imu`` or ``std_srvs/srv/SetBool_Request``.

    Raises ``KeyError`` if there is no such type.
    """
    return _core.message_class(name)


def search(path: str | os.PathLike[str]) -> int:
    """Adds the interfaces in a folder: a package with folders ``msg``, ``srv`` or ``action``, a folder of packages, or an ament
    prefix. Returns how many definitions were read.

    Raises ``OSError`` if there are none, ``ValueError`` if one is invalid or contradicts a known one.
    """
    return _core.search_interfaces(os.fspath(path))


def _is_installed(package: str) -> bool:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return any(
        os.path.isdir(os.path.join(prefix, "share", package, kind)) for prefix in prefixes if prefix for kind in _KINDS
    )


class _Interfaces(ModuleType):
    """A module with the interfaces of one kind of a package."""

    def __getattr__(self, name: str) -> Any:
        if not name[:1].isupper():
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        package, kind = self.__name__.split(".")[-2:]
        try:
            found = _interface(package, kind, name)
        except KeyError as error:
            raise AttributeError(error.args[0]) from None
        setattr(self, name, found)
        return found

    def __dir__(self) -> list[str]:
        package, of = self.__name__.split(".")[-2:]
        return [name for kind, name in _core.interfaces(package) if kind == of]


def _interface(package: str, kind: str, name: str) -> type[Any]:
    full = f"{package}/{kind}/{name}"
    if kind == "msg" or "_" in name:
        return _core.message_class(full)
    parts: dict[str, Any] = {part: _core.message_class(f"{full}_{part}") for part in _PARTS[kind]}
    word = {"srv": "service", "action": "action"}[kind]
    return type(
        name,
        (),
        {
            "__doc__": f"The {word} {full}, with the classes of its messages.",
            "__module__": f"downbeat.msgs.{package}.{kind}",
            "TYPE_NAME": full,
            **parts,
        },
    )


class _Finder(MetaPathFinder, Loader):
    """Imports packages of interfaces."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        names = fullname.split(".")
        if names[:2] != ["downbeat", "msgs"] or len(names) not in (3, 4):
            return None
        package = names[2]
        if len(names) == 4:
            return importlib.machinery.ModuleSpec(fullname, self) if names[3] in _KINDS else None
        known = _core.interface_packages()
        if package in known or _is_installed(package):
            return importlib.machinery.ModuleSpec(fullname, self, is_package=True)
        near = difflib.get_close_matches(package, known, 1)
        hint = (
            f"did you mean {near[0]}?"
            if near
            else "name their folder under `interfaces` in [robot] of the robot file, or with downbeat.msgs.search(folder), or source "
            "a workspace that has it"
        )
        raise ModuleNotFoundError(f"no interfaces of a package {package} are known: {hint}", name=fullname)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        names = spec.name.split(".")
        return _Interfaces(spec.name) if len(names) == 4 else None

    def exec_module(self, module: ModuleType) -> None:
        names = module.__name__.split(".")
        if len(names) == 4:
            module.__doc__ = f"{_KINDS[names[3]]} of the package {names[2]}."
        else:
            module.__doc__ = f"Interfaces of the package {names[2]}."


sys.meta_path.insert(0, _Finder())
