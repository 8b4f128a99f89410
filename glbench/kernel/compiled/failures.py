"""Why a row was not stepped, from the number that the library reports to a sentence."""

from __future__ import annotations

from enum import IntEnum

from glbench.kernel.compiled.binding import Settings
from glbench.model import STATE_NAMES

_NO_STATE = 63


class Failure(IntEnum):
    """Why a row was not stepped (``status // 64``)."""

    INPUT_NOT_FINITE = 1
    TOO_MANY_SUBSTEPS = 2
    SUBSTEP_TOO_SMALL = 3
    EQUIPMENT_PRESENT = 4  # internal: the row goes to the library of the full model


def explain(status: int, reached: float, substeps: int, settings: Settings) -> str:
    """What went wrong in a step under ``settings``: which state, when, why."""
    failure, state = Failure(status // 64), status % 64
    name = STATE_NAMES[state] if state != _NO_STATE else ""
    if failure == Failure.INPUT_NOT_FINITE:
        return f"the state {name} is not finite" if name else "controls, weather or parameters are not usable numbers"
    cause = (
        f"needed more than {int(settings.most)} substeps"
        if failure == Failure.TOO_MANY_SUBSTEPS
        else f"needed substeps below {settings.smallest:g} s"
    )
    return f"{name} {cause} to stay within its tolerance, {reached:.4g} s into the step after {substeps} substeps"
