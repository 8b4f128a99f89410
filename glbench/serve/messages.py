"""What goes over the line: requests, answers and errors as pydantic models. The OpenAPI document is made of them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.untrusted import LARGEST_INTEGER

_ENTRIES = {"anyOf": [{"type": "object", "additionalProperties": {"type": "number"}}, {"type": "array", "items": {"type": "number"}}]}
Entries = Annotated[Any, WithJsonSchema(_ENTRIES)]  # An entry for each action of the task; ``sessions`` checks it, in its own words


class Request(BaseModel):
    """Base of the requests. Descriptions begin with what a field has to be: errors quote them."""

    model_config = ConfigDict(extra="forbid", strict=True)


class SeasonRequest(Request):
    """Which season to start."""

    split: str | None = Field(default=None, description="the name of a split in quotes, such as 'validation'. Default: training")
    seed: int | None = Field(
        default=None,
        ge=FIRST_TRAINING_SEED,
        le=LARGEST_INTEGER,
        description=f"a whole number from {FIRST_TRAINING_SEED} to {LARGEST_INTEGER}. Smaller seeds belong to scored runs. "
        "Default: another one for every season, counted up",
    )


class StepRequest(Request):
    """What to do, and for how many steps. Either ``action`` or ``values``."""

    action: Entries = Field(
        default=None,
        description="an object with a number for each action of the task by name, or a list of these numbers in the order of the "
        "task card; each from low to high of the card",
    )
    values: Entries = Field(
        default=None,
        description="the same in the units of the task card, each from lowest to highest of the card: set points in degC, for example",
    )
    steps: int = Field(default=1, ge=1, description="a whole number of steps to take with this action, at most those of a day")


class Moment(BaseModel):
    """When it is in the greenhouse. The year is not given: it is part of what an agent does not know."""

    date: str = Field(description="such as 1 March")
    clock: str = Field(description="such as 06:15")
    hour_of_day: float = Field(description="h, 0 to 24")
    day_of_year: float = Field(description="day, 0 at the start of 1 January")


class Observation(BaseModel):
    """What an agent sees, and where its season stands."""

    session: str
    split: str
    seed: int
    step: int = Field(description="steps taken")
    steps: int = Field(description="steps of the season")
    terminated: bool = Field(description="whether the season is over")
    time: Moment
    observation: dict[str, float] = Field(description="the observed columns by name")
    vector: list[float] = Field(description="the same in the order of the task card")


class FullObservation(Observation):
    """The same with units."""

    units: dict[str, str]


class StepAnswer(Observation):
    """What the steps gave. Money, amounts and violations follow from the true climate: an agent that is evaluated does not see them."""

    steps_taken: int = Field(description="fewer than asked for where the season ended")
    reward: float = Field(description="sum over these steps, in reward_unit")
    reward_unit: str
    account: dict[str, float] = Field(description="sums over these steps; GET .../account has units and meanings")
    violations: dict[str, float] = Field(description="mean over these steps of the distance beyond each limit, in its unit")
    failure: str | None = Field(description="why a step could not be simulated, which ends the season")


class Account(BaseModel):
    """Sums over all steps of the season so far, as results have them; money is in EUR per m2 of floor."""

    session: str
    step: int
    account: dict[str, float]
    units: dict[str, str]
    meanings: dict[str, str]
    episode: str | None = Field(default=None, description="the file on the server's machine, of a closed session, if it writes episodes")


class Ahead(BaseModel):
    """Forecast of one quantity."""

    unit: str
    meaning: str
    hours_ahead: list[float] = Field(description="h; of the weather, the value is the mean over the hour that ends then")
    values: list[float]


class Forecast(BaseModel):
    """The coming weather and prices as far as agents of the task see them: with its errors, and the same numbers as in the observation."""

    session: str
    time: Moment
    forecast: dict[str, Ahead]
    note: str


class Health(BaseModel):
    """What is running."""

    status: str
    glbench: str = Field(description="version")
    task: str
    digest: str = Field(description="of the task")
    splits: list[str]
    sessions: int = Field(description="open ones")
    most_sessions: int
    idle_minutes: float = Field(description="a session is closed after so long without use")


class Problem(BaseModel):
    """What is wrong with a request."""

    what: str
    field: str | None = None
    value: str | None = Field(default=None, description="as it arrived, shortened")
    do: str = Field(description="what to do about it")


class Failure(BaseModel):
    """The answer to a request that was refused; nothing was simulated."""

    error: Problem
