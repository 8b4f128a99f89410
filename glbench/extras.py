"""Packages and names that are imported when they are needed: those of extras, named when they are missing, and those of rooms."""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

from glbench.errors import GlbenchError, SubmissionError, refuse

EXTRAS = {"torch": "submit", "stable_baselines3": "submit", "sb3_contrib": "submit", "onnxruntime": "onnx", "ray": "ray"}
"""Extra of glbench that installs a package."""
_INSTALL_NAMES = {"stable_baselines3": "stable-baselines3", "sb3_contrib": "sb3-contrib"}


def require(what: str, extra: str, *modules: str) -> None:
    """Raises ``GlbenchError``, with how to install it, when a package of an optional part is not installed; nothing is imported."""
    absent = missing(*modules)
    if absent:
        msg = (
            f"{what} needs packages that are not installed ({', '.join(absent)}). "
            f'Install them with `pip install "glbench[{extra}]"`, or in a checkout with `uv sync --inexact --extra {extra}`.'
        )
        raise GlbenchError(msg)


def need(module: str, what: str) -> Any:
    """Import ``module``, which ``what`` ("a TorchScript policy") cannot do without.

    Raises ``SubmissionError`` when it is not installed, with the command that installs it; or when it is broken.
    """
    top = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] != top:
            msg = f"{what} needs {module}, which itself lacks the package '{error.name}'. Install it into this environment."
        else:
            msg = f"{what} needs {_INSTALL_NAMES.get(top, top)}, which is not installed here. {how_to_install(top)}"
        raise SubmissionError(msg) from error
    except ImportError as error:
        refuse(f"{what} needs {module}, which is installed and cannot be imported ({error}). Install it again.", SubmissionError, error)


def missing(*modules: str) -> list[str]:
    """Those of the packages that are not installed; nothing is imported."""
    return [module for module in modules if find_spec(module) is None]


def how_to_install(module: str) -> str:
    """The sentence with the command that installs ``module``."""
    return f"Install it with: pip install 'glbench[{EXTRAS[module]}]'" if module in EXTRAS else f"Install it: pip install {module}"


def lazy_names(package: str, places: Mapping[str, tuple[str, ...]] | None = None) -> Callable[[str], object]:
    """A ``__getattr__`` for ``package``, which imports a name when it is asked for.

    The process of a sandboxed agent needs a few modules out of large packages and must be there in a fraction of a second: a package that
    imports all of its modules would make it wait for libraries that no agent asked for.

    Put it under ``else`` of ``if TYPE_CHECKING``. The imports there, which the type checker reads, tell which module has which names;
    ``places`` tells it instead of them, by modules of the package.
    """
    homes = {name: f"{package}.{module}" for module, names in (places or {}).items() for name in names}
    if places is None:
        blocks = (node for node in ast.parse(inspect.getsource(sys.modules[package])).body if isinstance(node, ast.If))
        imports = (node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom))
        homes = {alias.name: str(node.module) for node in imports for alias in node.names}

    def get(name: str) -> object:
        if name not in homes:
            refuse(f"module {package!r} has no attribute {name!r}", AttributeError)
        value: object = getattr(importlib.import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)  # found without this function from now on
        return value

    return get
