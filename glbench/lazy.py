"""Names of a package that are loaded when somebody first asks for them.

The process of a sandboxed agent needs a few modules out of large packages and must be there in a fraction of a second. A package
that imports all of its modules would make it wait for libraries that no agent asked for.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(package: str, places: Mapping[str, tuple[str, ...]]) -> Callable[[str], object]:
    """A ``__getattr__`` for ``package``: ``places`` tells which of its modules (or which other, by its full name) has which names.

    Put it under ``if not TYPE_CHECKING``, beside ordinary imports for the type checker.
    """
    homes = {name: module for module, names in places.items() for name in names}

    def get(name: str) -> object:
        if name not in homes:
            msg = f"module {package!r} has no attribute {name!r}"
            raise AttributeError(msg)
        home = homes[name]
        value: object = getattr(import_module(home if home.startswith("glbench.") else f"{package}.{home}"), name)
        setattr(sys.modules[package], name, value)  # found without this function from now on
        return value

    return get
