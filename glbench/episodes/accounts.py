"""What runs grew, used and earned, in a grower's units: by week, by period of the day, or by any other grouping of their steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glbench.episodes.episode import Episode
from glbench.episodes.signals import Floats, Line, Signals, Source, signals_of

if TYPE_CHECKING:
    import pandas as pd

Places = NDArray[np.integer[Any]]
_DAYS = 7
ACTING: tuple[Source, ...] = ("control", "disturbance")
"""Sources of what light follows from."""


class Recorded(Protocol):
    """Columns of a run by name, ``(steps,)`` each: an episode, or a dictionary of them."""

    def __getitem__(self, name: str, /) -> NDArray[np.floating[Any]]: ...


def sums_by(run: Recorded, signals: Signals, places: Places, count: int) -> Floats:
    """Sums of the accounts of ``signals`` over the steps of each place, ``(count, lines)``.

    ``places`` ``(steps,)`` says to which of ``count`` groups each step belongs.
    """
    return np.stack([np.bincount(places, line_values(run, signals, one), count) for one in signals.accounts], axis=1)


def line_values(run: Recorded, signals: Signals, line: Line) -> Floats:
    """What a line of the accounts has in each step, ``(steps,)``."""
    if line.formula is None:
        return np.asarray(run[line.column], dtype=np.float64) * line.factor
    vectors = {of: np.stack([run[one.name] for one in signals.vector(of)], axis=1) for of in ACTING}
    return line.formula({of: np.asarray(values, dtype=np.float64) for of, values in vectors.items()})


def local_days(local: NDArray[np.datetime64]) -> Places:
    """On which day of the run each step begins, ``(steps,)``; the first day is 0.

    ``local`` are the moments on the clock of the greenhouse, ``(steps + 1,)``. The hour by which a run ends after midnight because summer
    time has begun belongs to its last day.
    """
    days = (local[:-1].astype("datetime64[D]") - local[0].astype("datetime64[D]")).astype(np.int64)
    most = max(1, round(float((local[-1] - local[0]) / np.timedelta64(1, "D"))))
    found: Places = np.minimum(days, most - 1)
    return found


@dataclass(frozen=True, eq=False)
class Weeks:
    """The accounts of a run by week.

    Attributes
    ----------
    first
        First day of each week on the clock of the greenhouse, ``(weeks,)`` datetime64[D].
    days
        Days that each week has, ``(weeks,)``; of the last one perhaps fewer than seven.
    sums
        ``(weeks, lines)``; of light the mean of a day.
    """

    first: NDArray[np.datetime64]
    days: Places
    sums: Floats


def weeks_of(run: Recorded, signals: Signals, local: NDArray[np.datetime64]) -> Weeks:
    """The accounts of a run by week; ``local`` as for ``local_days``."""
    days = local_days(local)
    weeks = days // _DAYS
    count = int(weeks[-1]) + 1
    lengths = np.bincount(np.unique(days) // _DAYS, minlength=count)
    sums = sums_by(run, signals, weeks, count)
    sums[:, [line.kind == "light" for line in signals.accounts]] /= lengths[:, None]
    return Weeks(local[0].astype("datetime64[D]") + np.arange(count) * np.timedelta64(_DAYS, "D"), lengths, sums)


def by_week(episode: Episode) -> pd.DataFrame:
    """The accounts of a run, one row a week, indexed by its first day on the clock of the greenhouse.

    Returns
    -------
    pandas.DataFrame
        ``days`` that the week has, and a column for each line of the accounts: light is the mean of a day [mol m-2 d-1], all else the sum
        of the week, which for a last week of fewer days is not scaled up. ``frame.attrs`` holds ``units`` and ``titles`` by column. Heat is
        also given as natural gas: 31.65 MJ m-3, its lower heating value.

    Raises
    ------
    EpisodeError
        When the record lacks a column that it needs.
    """
    import pandas as pd

    signals = signals_of(episode.task())
    weeks = weeks_of(episode, signals, episode.local_times)
    index = pd.DatetimeIndex(weeks.first, name="week")
    frame = pd.DataFrame(weeks.sums, columns=[line.name for line in signals.accounts], index=index)
    frame.insert(0, "days", weeks.days)
    frame.attrs["units"] = {one.name: one.unit + (" d-1" if one.kind == "light" else "") for one in signals.accounts}
    frame.attrs["titles"] = {one.name: one.title for one in signals.accounts}
    return frame
