"""``submission.toml``: what a submission says about itself, for people and for the record.

Only ``agent``, ``model``, ``normalisation`` and ``clip_actions`` change what an agent does; the rest goes into the result, so that a table
can say who made an agent, what its training cost, and what it knows. ``docs/submit.md`` explains every key.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import pydantic

from glbench.errors import SubmissionError, did_you_mean, refuse
from glbench.fields import Count
from glbench.settings import Problem, Table, problems_of, read_toml
from glbench.untrusted import quoted

_LONGEST_KEY = 80
_MOST_ITEMS = 10_000
Split = Literal["training", "validation", "test"]
"""Seasons of a task that agents learn from, that they are chosen by, and that they are judged by."""
Information = Literal["observations", "forecast", "weather", "model", "privileged"]
"""What a card may say that an agent uses; ``docs/submit.md`` says what each means."""


def _as_tuple(value: object) -> object:
    """TOML has lists, records have tuples; anything else is left to be refused."""
    return tuple(value) if isinstance(value, list) else value


def _shown_as_written(text: str) -> str:
    """Names are shown in terminals and on pages: none may hold control characters."""
    strange = next((letter for letter in text if not (letter.isprintable() or letter in _HARMLESS)), None)
    if strange is not None:
        refuse(f"the character U+{ord(strange):04X} cannot be shown")
    return text


_HARMLESS = "\n\t\u200c\u200d"  # Ends of lines and tabulators, and the joiners that some scripts are written with
Printable = Annotated[str, pydantic.AfterValidator(_shown_as_written)]
Words = Annotated[Printable, pydantic.Field(min_length=1, max_length=200)]
Names = Annotated[tuple[Words, ...], pydantic.FailFast(), pydantic.BeforeValidator(_as_tuple), pydantic.Field(max_length=100)]
LARGEST = 1e12  # No mean, standard deviation or bound of a policy is larger, in the unit of its column: nobody means such a number
SMALLEST_SCALE = 1e-12  # The least standard deviation that observations are divided by, in the unit of their column
SMALLEST_CLIP = 1e-6  # The least limit of normalised observations
Number = Annotated[float, pydantic.Field(ge=-1e30, le=1e30)]
Numbers = Annotated[tuple[Number, ...], pydantic.FailFast(), pydantic.BeforeValidator(_as_tuple), pydantic.Field(max_length=_MOST_ITEMS)]
Year = Annotated[int, pydantic.Field(ge=1000, le=9999)]
RecipeId = Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]  # Joins the trainings of one recipe
FileName = Annotated[Printable, pydantic.Field(pattern=r"^[^/\\.][^\\]*$", max_length=200)]


class _Table(Table, strict=True):
    """Base of the card's tables, which take a value of the right type only."""


class Training(_Table):
    """What the training cost, and what it saw.

    ``steps`` are control steps of all environments together, ``wall_hours`` is in hours. ``tasks`` are the tasks that it was trained on,
    ``split`` the last of training, validation and test that it saw of them, or ``none`` of an agent that saw nothing of any season;
    ``years`` are those that its weather was from. ``seeds`` are the first and the last seed of its episodes, both included.
    """

    steps: Count | None = None
    wall_hours: Annotated[float, pydantic.Field(ge=0, le=1e9, strict=False)] | None = None
    hardware: Words | None = None
    tasks: Names = ()
    split: Literal["none", "training", "validation", "test"] | None = None
    years: Annotated[tuple[Year, ...], pydantic.FailFast(), pydantic.BeforeValidator(_as_tuple), pydantic.Field(max_length=200)] = ()
    seeds: Annotated[tuple[Count, ...], pydantic.BeforeValidator(_as_tuple), pydantic.Field(max_length=2)] = ()

    @pydantic.model_validator(mode="after")
    def _seeds_are_a_range(self) -> Self:
        if self.seeds and (len(self.seeds) != 2 or self.seeds[0] > self.seeds[1]):
            refuse("seeds are the first and the last of a range, such as seeds = [0, 255]")
        return self


class Normalisation(_Table):
    """The policy sees ``(observation - mean) / std``, clipped to ``-clip`` to ``clip`` if that is given."""

    mean: Numbers
    std: Numbers
    clip: Annotated[float, pydantic.Field(ge=SMALLEST_CLIP, le=1e30, strict=False)] | None = None

    @pydantic.model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.mean) != len(self.std):
            refuse(f"mean has {len(self.mean)} values and std {len(self.std)}: one each for every observed column")
        if any(value <= 0 for value in self.std):
            refuse("every std must be above 0")
        for what, values, lowest in (("mean", self.mean, -LARGEST), ("std", self.std, SMALLEST_SCALE)):
            wrong = next((i for i, value in enumerate(values) if not lowest <= value <= LARGEST), None)
            if wrong is not None:
                refuse(f"{what} of column {wrong} is {values[wrong]:g}, expected {lowest:g} to {LARGEST:g}")
        return self


class SubmissionCard(_Table):
    """The card. ``agent`` or ``model`` names the file to run; without either it is found by the rules of ``identify``."""

    name: Words
    authors: Annotated[Names, pydantic.Field(min_length=1)]
    licence: Words
    link: Annotated[Printable, pydantic.Field(pattern=r"^https?://\S+$", max_length=500)] | None = None
    description: Annotated[Printable, pydantic.Field(max_length=4000)] = ""
    information: Annotated[
        tuple[Information, ...],
        pydantic.FailFast(),
        pydantic.BeforeValidator(_as_tuple),
        pydantic.Field(min_length=1, max_length=len(get_args(Information))),
    ]
    algorithm: Words | None = None
    seed: Count | None = None
    recipe: RecipeId | None = None
    """Id that trainings share which differ only in their seed; see ``docs/submit.md``."""
    requires: Names = ()
    """Packages that the submission imports besides Python's own and numpy."""
    training: Training | None = None
    agent: FileName | None = None
    model: FileName | None = None
    normalisation: FileName | Normalisation | None = None
    clip_actions: bool = False
    """Clip what a TorchScript or ONNX policy answers to the bounds of the actions. Stable-Baselines3 always clips."""

    @pydantic.model_validator(mode="after")
    def _is_one_thing(self) -> Self:
        if self.agent is not None and self.model is not None:
            refuse("give 'agent' (a Python file) or 'model' (a saved policy), not both")
        if self.agent is not None and (self.normalisation is not None or self.clip_actions):
            refuse("'normalisation' and 'clip_actions' are for saved policies ('model'); a Python agent does both itself")
        if self.recipe is not None and self.seed is None:
            refuse("a 'recipe' needs a 'seed', because trainings of one recipe differ in their seed: add, for example, seed = 1")
        return self

    @pydantic.model_serializer(mode="wrap")
    def _without_recipe(self, write: pydantic.SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out ``recipe`` where it is ``None``, so that results of earlier versions keep their text."""
        content: dict[str, Any] = write(self)
        return {key: value for key, value in content.items() if key != "recipe" or value is not None}


def read_card(file: Path) -> SubmissionCard:
    """Read a card. Raises ``SubmissionError`` when it cannot be read, or with everything that is wrong in it."""
    card, problems = check_card(file)
    if card is None:
        refuse(f"The card {file} cannot be used: {'; '.join(problems)}. docs/submit.md explains every key.", SubmissionError)
    return card


def check_card(file: Path) -> tuple[SubmissionCard | None, list[str]]:
    """The card in ``file``, or ``None`` and everything that is wrong with it, one sentence each."""
    try:
        document = read_toml(file)
    except SubmissionError as error:
        return None, [str(error)]
    try:
        return SubmissionCard.model_validate(document), []
    except pydantic.ValidationError as error:
        return None, list(dict.fromkeys(_in_words(problem, document) for problem in problems_of(error)))


_EXAMPLES = {
    "name": '"Anna\'s controller"', "authors": '["Anna Example"]', "licence": '"MIT"', "link": '"https://example.org/anna"',
    "information": '["observations"]', "requires": '["torch"]', "seed": "1", "recipe": '"anna-ppo"', "agent": '"agent.py"',
    "model": '"model.zip"', "normalisation": '"vecnormalize.pkl", or a table with mean and std', "clip_actions": "true",
    "steps": "1_000_000", "wall_hours": "2.5", "split": '"training"', "years": "[2008, 2009, 2010]", "seeds": "[0, 255]",
}  # fmt: skip
_CHOICES: dict[str, tuple[str, ...]] = {"information": get_args(Information), "split": ("none", *get_args(Split))}
_KEYS = {*SubmissionCard.model_fields, *Training.model_fields, *Normalisation.model_fields}


def _in_words(problem: Problem, document: dict[str, Any]) -> str:
    """A problem as a sentence with the key, what is wrong, and what it should look like."""
    place = [part for part in problem.place if isinstance(part, int) or part in document or part in _KEYS]
    where = ".".join(str(part)[:_LONGEST_KEY] for part in place)
    key = next((str(part) for part in reversed(place) if not isinstance(part, int)), "")
    example = f", such as {key} = {_EXAMPLES[key]}" if key in _EXAMPLES else ""
    if problem.kind == "missing":
        return f"'{problem.place[-1]}' is missing{example}"
    if problem.kind == "extra_forbidden":
        unknown = str(problem.place[-1])[:_LONGEST_KEY]
        return f"{quoted(unknown)} is not a key of a card.{did_you_mean(unknown, _KEYS)}".rstrip(".")
    if problem.kind == "literal_error":
        return f"'{where}' is {quoted(problem.value)}, expected one of {', '.join(_CHOICES[key])}"
    if problem.kind == "value_error":
        return f"'{where}': {problem.reason}" if where else problem.reason
    return f"'{where}' is {quoted(problem.value)}: {problem.reason[:1].lower()}{problem.reason[1:]}{example}"
