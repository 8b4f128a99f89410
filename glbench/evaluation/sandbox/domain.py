"""A domain of its own for the agent's processes (Landlock), so that they cannot look into bubblewrap's.

In a user namespace the first process of the sandbox, which is bubblewrap's, belongs to the same user as the agent. System calls to trace
it are refused by the filter, but ``/proc/1/mem`` is a file. ``/proc`` is read-only, and the kernel lets no process of a Landlock domain
look into one outside of it.
"""

from __future__ import annotations

import ctypes
from typing import Final

_CREATE_RULESET, _RESTRICT_SELF = 444, 446
"""Numbers of the system calls, on all processors the same."""
_MAKE_DEVICES: Final = 1 << 6 | 1 << 11
"""A domain must forbid something; devices cannot be made in the sandbox anyhow."""


def enter_domain() -> bool:
    """Put this process and all that it starts into a domain; false where the kernel has none. Needs ``no_new_privs``."""
    library = ctypes.CDLL(None, use_errno=True)
    forbidden = ctypes.c_uint64(_MAKE_DEVICES)
    ruleset: int = library.syscall(
        _CREATE_RULESET, ctypes.byref(forbidden), ctypes.c_size_t(ctypes.sizeof(forbidden)), 0
    )
    return ruleset >= 0 and library.syscall(_RESTRICT_SELF, ruleset, 0) == 0
