"""Controls that no agent moves and that follow the calendar, such as the crew's picking days: ``[[schedule]]`` of a task file."""

from __future__ import annotations

from calendar import month_name
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from glbench.errors import refuse
from glbench.tasks.fields import Table, as_tuple, list_of
from glbench.tasks.prices import DAY, in_year, month_and_day
from glbench.tasks.vocabulary import WEEKDAYS

_DayOfYear = Annotated[tuple[int, int], BeforeValidator(month_and_day)]
_ALL_DAY, _NEW_YEAR, _LAST_DAY = (0.0, 24.0), (1, 1), (12, 31)


class ScheduleEntry(Table):
    """``[[schedule]]``: the value of a control where all that the entry states holds; hours after midnight belong to the day before."""

    control: str = Field(min_length=1, description='the name of a control of the model in quotes, such as "uBoil"')
    value: float = Field(ge=0.0, le=1.0, description="a fraction from 0 to 1")
    weekdays: Annotated[tuple[str, ...], list_of(WEEKDAYS.kind, "monday", WEEKDAYS)] = Field(default=(), description="a list of weekdays")
    hours: Annotated[tuple[float, float], BeforeValidator(as_tuple)] = Field(
        default=_ALL_DAY, description="two hours of the task's clock, 0 to 24, such as [7.0, 15.0]"
    )
    first: _DayOfYear = Field(default=_NEW_YEAR, alias="from", description='month and day, such as "09-15"')
    last: _DayOfYear = Field(default=_LAST_DAY, alias="until", description='month and day, such as "12-31"')
    after_day: int = Field(default=0, ge=0, le=3660, description="whole days since the start of the run, 0 to 3660")

    @model_validator(mode="after")
    def _hours_are_of_a_day(self) -> Self:
        start, end = self.hours
        if not (0.0 <= start < 24.0 and 0.0 <= end <= 24.0) or start == end:
            never = "an entry with these never applies" if start == end else "hours of a day lie between 0 and 24"
            refuse(f"hours = [{start:g}, {end:g}]: {never}. Write two others, such as [7.0, 15.0]; without hours it is the whole day.")
        return self

    def applies(self, moments: NDArray[np.datetime64], later: int | NDArray[np.integer] = 0) -> NDArray[np.bool_]:
        """Whether it applies at moments of the task's clock ``(n,)`` from ``after_day`` on; weekdays are ``later`` than these dates'."""
        days, (start, end) = moments.astype("datetime64[D]"), self.hours
        hour = (moments - days) / np.timedelta64(1, "h")
        in_hours = (start <= hour) & (hour < end) if start < end else (start <= hour) | (hour < end)
        days = days - ((start > end) & (hour < end)).astype(np.int64)
        date, first, last = in_year(days) // DAY, *(100 * month + day for month, day in (self.first, self.last))
        in_dates = (first <= date) & (date <= last) if first <= last else (first <= date) | (date <= last)
        weekday = (days.astype(np.int64) + later + 3) % len(WEEKDAYS)  # day 0 was a Thursday
        applies: NDArray[np.bool_] = (
            in_hours & in_dates & np.isin(weekday, [WEEKDAYS.names.index(day) for day in self.weekdays or WEEKDAYS.names])
        )
        return applies

    def in_words(self) -> str:
        """When the entry applies, as in "Monday and Thursday, 07:00 to 15:00"."""
        parts = [" and ".join(day.capitalize() for day in self.weekdays)] if self.weekdays else []
        if self.hours != _ALL_DAY:
            parts.append(" to ".join(f"{round(60 * hour) // 60:02d}:{round(60 * hour) % 60:02d}" for hour in self.hours))
        if (self.first, self.last) != (_NEW_YEAR, _LAST_DAY):
            parts.append(" to ".join(f"{day} {month_name[month]}" for month, day in (self.first, self.last)))
        if self.after_day:
            parts.append(f"from {self.after_day} days after the start of the run")
        return ", ".join(parts) or "always"


def schedule_rows(
    schedule: Sequence[ScheduleEntry], moments: NDArray[np.datetime64], later: int | NDArray[np.integer] = 0
) -> NDArray[np.float64]:
    """Whether each entry applies, 1 or 0, at moments of the task's clock ``(n,)``: ``(n, entries)``. For ``later`` see ``applies``."""
    return np.array([entry.applies(moments, later) for entry in schedule], dtype=np.float64).reshape(-1, len(moments)).T
