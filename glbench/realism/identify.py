"""Fits numbers of a greenhouse, named on a page (``identify.toml``), to its measured air, by the free run.

Bounded least squares (scipy) in numbers that are scaled to 0 at the start and 1 where the prior has its standard deviation: logarithms of
factors, or values. A batch of the kernel gives a point and its derivatives: the numbers as they are, and each a little changed. Of a point
only the normal equations of each week are kept: all that solver and bootstrap need, and small enough to be stored after every point.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from glbench import __version__, settings
from glbench.canonical import canonical_sha256
from glbench.errors import ArchiveError, ParameterError, StepError, refuse
from glbench.realism.free_run import Drive, Error, Flags, drive, free_run
from glbench.realism.houses import LAMP_POWER, House, Plants, Settings, choose_houses, model, parameters
from glbench.realism.indoor import read_indoor
from glbench.realism.inputs import outdoors
from glbench.realism.published import ROW_SECONDS, read_archive
from glbench.resources import write_atomically
from glbench.tasks.fields import sorted_overrides
from glbench.weather.record import FloatArray

SHIPPED_PAGE = Path(__file__).with_name("identify.toml")
CHANGE = 0.02  # Change of a number for its derivative: of the logarithm of a factor, or as a share of the range of a value
MOST_POINTS, TOLERANCE = 25, 2e-4
"""A fit ends after so many points, or when a step gains less than this share."""
RESAMPLES, INTERVAL, SEED = 400, (5.0, 95.0), 1  # Of the bootstrap: resamples, percentiles, seed
_PICTURE = 33  # characters
NEAR_BOUND, CORRELATED = 0.01, 0.7
"""A number ends at a bound that it differs from by less than this share; estimates with so much correlation are named."""

_Positive = Annotated[float, Field(gt=0.0)]


class FitNumber(settings.Table):
    """A number that is fitted; ``identify.toml`` explains the entries."""

    meaning: str = "A parameter of the model."
    multiplies: tuple[str, ...] = ()
    sets: tuple[str, ...] = ()
    start: float | None = None
    lowest: float = 0.2
    highest: float = 5.0
    prior: _Positive = 0.7


class FitPage(settings.Table):
    """What is fitted, from which house on, and the errors that count as 1, in the units of ``CHANNELS``."""

    model: str | None = None
    set: str = "mixed_2020"
    overrides: Annotated[tuple[tuple[str, float, str], ...], BeforeValidator(sorted_overrides)] = ()
    weights: dict[Literal["air_temperature", "humidity", "co2"], _Positive] = Field(min_length=3)
    parameters: dict[str, FitNumber] = Field(min_length=1)


def read_page(file: Path, only: Sequence[str] = (), **changes: str | None) -> FitPage:
    """The page in a file, with ``changes`` of ``model`` and ``set``; with ``only`` these of its numbers, or factors on these parameters.

    Raises ``ArchiveError`` when the page cannot be read, or has an unknown or impossible entry.
    """
    page = settings.read_settings(FitPage, file, "the page", ArchiveError, toml=True, advice=f"{SHIPPED_PAGE} explains each entry.")
    numbers = {name: page.parameters.get(name) or FitNumber(multiplies=(name,)) for name in only}
    return page.model_copy(update={"parameters": numbers or page.parameters} | {key: text for key, text in changes.items() if text})


class Split(NamedTuple):
    """Steps that are fitted and steps that are held out: their names, and flags (steps,)."""

    name: str
    fitted: str
    test: str
    steps: Flags


def make_split(season: Drive, text: str) -> Split:
    """``weeks`` fits even weeks, ``date:2020-03-01`` the days before, ``date`` those before the first of the month nearest the middle.

    Raises ``ArchiveError`` when there is no such split, or it leaves too few weeks.
    """
    kind, _, day = text.partition(":")
    first, last = season.date[0], season.date[-1]
    try:
        date = dt.date.fromisoformat(day) if day else (first + (last - first) // 2 + 15).astype("M8[M]").astype("M8[D]").astype(object)
    except ValueError:
        kind = ""
    if kind not in ("weeks", "date") or (kind == "weeks" and day):
        refuse(f"There is no split '{text}'. Write weeks, date, or date:2020-03-01 with the first day that is held out.", ArchiveError)
    late, word = season.date >= np.datetime64(date, "D"), " weeks" * (kind == "weeks")
    group = season.groups()["weeks"] if word else {f"before {date}": ~late, f"from {date}": late}
    fitted, test = group
    weeks, others = (np.unique(season.week[flags]).size for flags in group.values())
    if weeks < 2 or others < 1:
        refuse(f"'{text}' leaves {weeks} of the weeks of {first} to {last} to fit and {others} to test; 2 and 1 are needed.", ArchiveError)
    return Split(kind if word else f"date:{date}", fitted + word, test + word, group[fitted])


class Problem:
    """What is fitted, where, and to what: a house with its parameters ``base`` (parameters,), a page, and a season.

    Raises ``GlbenchError`` when a number is not one of one kind, or starts outside its bounds; when a parameter does not exist, follows
    from others, is fitted twice, is 0 and multiplied, or is impossible at a bound.
    """

    def __init__(self, house: House, base: FloatArray, plants: Plants, page: FitPage, season: Drive) -> None:
        self.house, self.base, self.plants, self.page, self.season = house, base, plants, page, season
        self.greenhouse, entries = model(house.model), list(page.parameters.values())
        table, self.names, self.places, begin = self.greenhouse.parameters, list(page.parameters), list[list[int]](), list[float]()
        for entry, one in page.parameters.items():
            if bool(one.multiplies) == bool(one.sets):
                refuse(f"'{entry}' needs names of parameters either in multiplies or in sets.", ArchiveError)
            self.places.append([])
            for name in one.multiplies or one.sets:
                formula, place = table.info(name).formula, table.names.index(name)
                why = f"it follows from others, {formula}" if formula else "it is fitted twice" if place in {*chain(*self.places)} else ""
                if why or (one.multiplies and base[place] == 0.0):
                    refuse(f"'{entry}' cannot fit {name}: {why or 'it is 0; use sets instead of multiplies'}.", ArchiveError)
                self.places[-1].append(place)
            begin.append(base[self.places[-1][0]] if one.start is None and one.sets else 1.0 if one.start is None else one.start)
            if not one.lowest < begin[-1] < one.highest or (one.multiplies and (one.lowest <= 0.0 or begin[-1] != 1.0)):
                words = f"its lowest {one.lowest:g} must be below and its highest {one.highest:g} above"
                refuse(f"'{entry}' begins at {begin[-1]:g}, so {words}. A factor begins at 1, and its lowest is above 0.", ArchiveError)
        self.is_factor, self.prior = np.array([bool(one.multiplies) for one in entries]), np.array([one.prior for one in entries])
        rows = np.array([begin, [one.lowest for one in entries], [one.highest for one in entries]])
        self.start, low, high = np.where(self.is_factor, np.log(np.where(self.is_factor, rows, 1.0)), rows)
        self.low, self.high = (low - self.start) / self.prior, (high - self.start) / self.prior
        self.change = CHANGE * np.where(self.is_factor, 1.0, high - low) / self.prior
        for i, (entry, one) in enumerate(page.parameters.items()):
            for ends, word in ((self.low, "lowest"), (self.high, "highest")):
                try:
                    self.overrides(np.where(np.arange(len(begin)) == i, ends, 0.0))
                except ParameterError as error:
                    refuse(f"'{entry}' cannot go to its {word}, {getattr(one, word):g}: {error}", ParameterError, error)

    @property
    def data_digest(self) -> str:
        """SHA-256 of the measurements as they are used."""
        one = self.season
        arrays = (one.weather, *one.shares.values(), one.lamps, one.dose, *one.pipes.values(), *one.measured.values())
        return hashlib.sha256(b"".join(np.ascontiguousarray(values, dtype="<f8").tobytes() for values in arrays)).hexdigest()

    def values(self, z: FloatArray) -> FloatArray:
        """Factors and values of scaled numbers, both (..., numbers)."""
        numbers = self.start + self.prior * z
        return np.where(self.is_factor, np.exp(np.where(self.is_factor, numbers, 0.0)), numbers)

    def vector(self, z: FloatArray) -> FloatArray:
        """Parameters (parameters,) with scaled numbers (numbers,)."""
        p = self.base.copy()
        for places, is_factor, value in zip(self.places, self.is_factor, self.values(z), strict=True):
            p[places] = value * p[places] if is_factor else value
        return self.greenhouse.parameters.complete(p)

    def overrides(self, z: FloatArray) -> dict[str, float]:
        """What differs from the house's named set with scaled numbers (numbers,); checked: ParameterError."""
        table = self.greenhouse.parameters
        rows = zip(table.table, self.vector(z).tolist(), table.default(self.house.parameters).tolist(), strict=True)
        own = {info.name: value for info, value, named in rows if not info.is_derived and value != named}
        table.default(self.house.parameters, own)
        return own

    def evaluate(self, z: FloatArray, split: Split, progress: Callable[[float], None]) -> FloatArray:
        """Normal equations of each fitted week (weeks, numbers + 1, numbers + 1): products of derivatives and, last, errors.

        Infinite where the model cannot be integrated.
        """
        change = np.where(z + self.change > self.high, -self.change, self.change)
        lanes = np.stack([self.vector(z + step) for step in (0.0 * z, *np.diag(change))])
        span, week = int(np.flatnonzero(split.steps)[-1]) + 1, self.season.week
        weeks = np.unique(week[split.steps])
        normal = np.zeros((weeks.size, z.size + 1, z.size + 1))
        try:
            run = free_run(
                self.greenhouse, lanes, self.season, self.plants, steps=span, progress=lambda step, steps: progress(step / steps)
            )
        except StepError:
            if not z.any():  # the start
                raise
            return normal + np.inf
        if run.failures and (0 not in run.failures or not z.any()):
            lane, reason = next(iter(run.failures.items()))
            msg = (
                f"The season cannot be integrated with a small change of '{self.names[lane - 1]}'"
                if lane
                else "The start cannot be integrated"
            )
            refuse(f"{msg}: {reason}", StepError)
        if run.failures:
            return normal + np.inf
        for channel, weight in self.page.weights.items():
            error = run.differences(channel) * math.sqrt(self.season.step_seconds / 86400.0) / weight
            error = np.where(np.isfinite(error) & split.steps[:span, None], error, 0.0)
            columns = np.column_stack(((error[:, 1:] - error[:, :1]) / change, error[:, 0]))
            for place, number in enumerate(weeks):
                rows = columns[week[:span] == number]
                normal[place] += rows.T @ rows
        return normal


def read_problem(folder: Path, page: FitPage, assumptions: Settings, compartment: str | None) -> tuple[Problem, str, tuple[str, ...]]:
    """What is fitted to a compartment of an archive, the compartment's name, and what was filled or left out.

    Raises ``ArchiveError`` when it is not clear which compartment is meant, and as for ``read_archive``, ``read_indoor`` and ``outdoors``.
    """
    (house,) = choose_houses((page.set,))
    place = assumptions.place
    archive = read_archive(folder, place.clock)
    measured = {one.name: one.indoor for one in archive.compartments if one.indoor is not None}
    name = compartment or next(iter(measured), "")
    if name not in measured or (len(measured) > 1 and compartment is None):
        names = ", ".join(measured) or "none"
        msg = f"The fit needs one compartment with an indoor climate. {folder} has these: {names}. Choose with --compartment."
        raise ArchiveError(msg)
    power = assumptions.lamps.power if archive.own else None
    indoor = read_indoor(measured[name], place.clock, first=archive.first, days=archive.days, lamp_power=power)
    outside = outdoors(archive, place.clock, place.co2, ROW_SECONDS)
    own = {LAMP_POWER: indoor.lamp_power} | {key: (value, unit) for key, value, unit in page.overrides}
    house = replace(house, model=page.model or house.model, overrides={**house.overrides, **own})
    problem = Problem(house, parameters(house, assumptions), assumptions.plants, page, drive(indoor, outside, archive.first))
    return problem, name, (*archive.notes, *outside.notes, *indoor.notes, *indoor.doubts)


class Estimate(NamedTuple):
    """A factor or value with its interval; ``bound`` is ``lowest`` or ``highest`` where the fit ended there, else empty."""

    name: str
    value: float
    low: float
    high: float
    bound: str


class Fit(NamedTuple):
    """A fit: scaled numbers ``z``, correlated pairs, points computed, and errors of house and fit by part of the season and channel."""

    split: Split
    z: FloatArray
    estimates: tuple[Estimate, ...]
    correlations: tuple[tuple[str, str, float], ...]
    points: int
    settled: bool
    before: dict[str, dict[str, Error]]
    after: dict[str, dict[str, Error]]


def identify(problem: Problem, splits: Sequence[Split], state: Path, progress: Callable[[int, float], None]) -> tuple[Fit, ...]:
    """Fit each split from the same start; ``progress`` is called with the split's number and its points, also in part.

    The file ``state`` keeps the points: a fit that was interrupted continues from it, with the same bits. Raises ``ArchiveError`` when the
    file cannot be read or belongs to another fit.
    """
    page, plants = problem.page.model_dump(mode="json"), problem.plants.model_dump(mode="json")
    identity = canonical_sha256([problem.data_digest, page, problem.base.tolist(), problem.greenhouse.digest, plants])
    stored: dict[str, Any] = {"of": identity, "points": {}}
    try:
        stored = json.loads(state.read_text("utf-8")) if state.exists() else stored
        is_mine = stored["of"] == identity
    except (ValueError, TypeError, KeyError):
        is_mine = False
    if not is_mine:
        msg = (
            f"{state} is damaged, or belongs to a fit of other data, numbers or house. Name another folder with --out, or remove the file."
        )
        raise ArchiveError(msg)
    save, solutions, fits = lambda: write_atomically(state, json.dumps(stored)), [], []
    for number, split in enumerate(splits):
        solutions.append(_solve(problem, split, stored["points"].setdefault(split.name, []), save, partial(progress, number)))
    lanes = np.stack([problem.base, *(problem.vector(z) for z, _, _ in solutions)])
    run = free_run(problem.greenhouse, lanes, problem.season, problem.plants)
    for lane, (split, (z, normal, settled)) in enumerate(zip(splits, solutions, strict=True), 1):
        cover = np.linalg.inv(normal[:, :-1, :-1].sum(axis=0) + np.eye(z.size))
        related = np.triu(cover / np.sqrt(np.outer(np.diag(cover), np.diag(cover))), 1)
        strong = sorted(np.argwhere(np.abs(related) >= CORRELATED).tolist(), key=lambda pair: -abs(related[tuple(pair)]))
        pairs = tuple((problem.names[i], problem.names[j], float(related[i, j])) for i, j in strong)
        parts = {split.fitted: split.steps, split.test: ~split.steps}
        before, after = ({name: run.errors(place, steps) for name, steps in parts.items()} for place in (0, lane))
        fits.append(Fit(split, z, _estimates(problem, z, normal), pairs, len(stored["points"][split.name]), settled, before, after))
    return tuple(fits)


def _solve(
    problem: Problem, split: Split, points: list[dict[str, Any]], save: Callable[[], object], progress: Callable[[float], None]
) -> tuple[FloatArray, FloatArray, bool]:
    """Scaled numbers, normal equations there, and whether the fit settled; ``points`` are those computed before, and grow."""
    from scipy.optimize import least_squares

    memory: dict[bytes, FloatArray] = {}

    def normal(z: FloatArray) -> FloatArray:
        if z.tobytes() not in memory:
            place = len(memory)
            if place == len(points) or points[place]["z"] != z.tolist():
                values = problem.evaluate(z, split, lambda share: progress(place + share))
                points[place:] = [{"z": z.tolist(), "normal": values.tolist()}]
                save()
            memory[z.tobytes()] = np.array(points[place]["normal"])
        return memory[z.tobytes()]

    # The season's errors as few: they and their derivatives have the same products, and the prior's errors are z itself.
    def errors(z: FloatArray) -> FloatArray:
        return np.concatenate(([math.sqrt(normal(z)[:, -1, -1].sum())], 0.0 * z, z))

    def derivatives(z: FloatArray) -> FloatArray:
        total = normal(z).sum(axis=0)
        first = total[-1, :-1] / math.sqrt(total[-1, -1])
        spread, axes = np.linalg.eigh(total[:-1, :-1] - np.outer(first, first))
        return np.vstack((first, np.sqrt(np.maximum(spread, 0.0))[:, None] * axes.T, np.eye(z.size)))

    begin, bounds = 0.0 * problem.start, (problem.low, problem.high)
    best = least_squares(errors, begin, derivatives, bounds, "dogbox", ftol=TOLERANCE, xtol=1e-3, max_nfev=MOST_POINTS)
    return best.x, normal(best.x), best.status > 0


def _estimates(problem: Problem, z: FloatArray, normal: FloatArray) -> tuple[Estimate, ...]:
    """Numbers with intervals: each resample of the weeks moves the solution of its normal equations, which are linear there."""
    from scipy.optimize import lsq_linear

    generator, moved = np.random.default_rng(SEED), []
    for _ in range(RESAMPLES):
        total = normal[generator.integers(len(normal), size=len(normal))].sum(axis=0)
        root = np.linalg.cholesky(total[:-1, :-1] + np.eye(z.size)).T
        moved.append(lsq_linear(root, -np.linalg.solve(root.T, total[:-1, -1] + z), (problem.low - z, problem.high - z)).x)
    values, ends = problem.values(z), np.percentile(problem.values(z + np.array(moved)), INTERVAL, axis=0)
    bounds = [("lowest", problem.values(problem.low)), ("highest", problem.values(problem.high))]
    near = ["".join(word for word, end in bounds if abs(value - end[i]) <= NEAR_BOUND * abs(end[i])) for i, value in enumerate(values)]
    return tuple(Estimate(*row) for row in zip(problem.names, values.tolist(), *ends.tolist(), near, strict=True))


def page_text(problem: Problem, fit: Fit, source: str, name: str) -> str:
    """The parameter set of a fit in TOML: ``[model]`` as in a task file, and how it was made. ``read_house`` reads it."""
    greenhouse, quote, name = problem.greenhouse, partial(json.dumps, ensure_ascii=False), re.sub(r"\W+", "_", name)
    days = f"{problem.season.date[0]} to {problem.season.date[-1]}"
    words = f"{problem.house.name} fitted to {source}, {days}, {fit.split.fitted}; numbers fitted: {', '.join(problem.names)}"
    origin = {"start": problem.house.name, "split": fit.split.name, "settled": fit.settled, "version": __version__}
    origin |= {"data": f"sha256:{problem.data_digest}", "model": f"sha256:{greenhouse.digest}"}
    lines = ["# Written by `glbench identify`. [model] can be copied into a task file.", f"name = {quote(name)}"]
    lines += [
        f"description = {quote(words)}",
        "",
        "[model]",
        f"id = {quote(greenhouse.id)}",
        f"parameters = {quote(problem.house.parameters)}",
    ]
    lines += ["", "[model.overrides]"]
    for key, value in problem.overrides(fit.z).items():
        lines.append(f"{key} = {{ value = {value!r}, unit = {quote(greenhouse.parameters.info(key).unit)} }}")
    lines += ["", "[identified]", *(f"{key} = {quote(value)}" for key, value in origin.items()), "", "[identified.numbers]"]
    for one, entry in zip(fit.estimates, problem.page.parameters.values(), strict=True):
        names = f"{'multiplies' if entry.multiplies else 'sets'} = {quote(entry.multiplies or entry.sets)}"
        lines.append(
            f"{quote(one.name)} = {{ {names}, value = {one.value!r}, interval = [{one.low!r}, {one.high!r}], bound = {quote(one.bound)} }}"
        )
    for part, errors in fit.after.items():
        lines += ["", f"[identified.rmse.{quote(part)}]", *(f"{channel} = {error.rmse!r}" for channel, error in errors.items())]
    return "\n".join(lines) + "\n"


def report_text(problem: Problem, fits: Sequence[Fit], source: str) -> str:
    """The report in Markdown: errors, numbers with their intervals as table and picture, and what limits them."""
    rows, parts = [], []
    for fit in fits:
        for part, use in ((fit.split.fitted, "fitted"), (fit.split.test, "held out")):
            for when, errors in (("before", fit.before[part]), ("after", fit.after[part])):
                pairs = zip(errors.values(), (2, 1, 0), strict=True)
                words = [f"{one.rmse:.{digits}f} ({one.bias:+.{digits}f})" if one.readings else "-" for one, digits in pairs]
                rows.append(f"| {part}, {use} | {when} | {' | '.join(words)} |")
        parts += [f"## Fitted: {fit.split.fitted}", "", "| number | | 90 % interval | lowest to highest | ends at | what it is |"]
        parts.append("|---|---:|---:|---|---|---|")
        for i, (one, entry) in enumerate(zip(fit.estimates, problem.page.parameters.values(), strict=True)):
            scaled = np.array([one.low, one.high, one.value, 1.0 if entry.multiplies else problem.start[i]])
            scaled = ((np.log(scaled) if entry.multiplies else scaled) - problem.start[i]) / problem.prior[i]
            shares = np.clip((scaled - problem.low[i]) / (problem.high[i] - problem.low[i]), 0.0, 1.0)
            lower, upper, value, start = np.rint(shares * (_PICTURE - 1)).astype(int).tolist()
            cells = ["-" if lower <= cell <= upper else "." for cell in range(_PICTURE)]
            cells[start], cells[value] = "|", "o"
            unit = f" {problem.greenhouse.parameters.info(entry.sets[0]).unit}" if entry.sets else ""
            picture = f"{'x ' * bool(entry.multiplies)}{one.value:.3g}{unit} | {one.low:.3g} to {one.high:.3g}{unit} | `{''.join(cells)}`"
            bound = f"its {one.bound}, {getattr(entry, one.bound):g}" if one.bound else ""
            parts.append(f"| {one.name} | {picture} | {bound} | {entry.meaning} ({', '.join(entry.multiplies or entry.sets)}) |")
        parts += ["", *(f"- {a} and {b} stand in for each other: correlation {r:+.2f}." for a, b, r in fit.correlations)]
        parts += [] if fit.settled else [f"- The fit had not settled after {fit.points} points; its numbers are provisional."]
        parts.append("")
    template = SHIPPED_PAGE.with_suffix(".md").read_text("utf-8")
    return template.format(
        source=source, house=problem.house.name, model=problem.greenhouse.id, data=problem.data_digest, first=problem.season.date[0],
        last=problem.season.date[-1], errors="\n".join(rows), fits="\n".join(parts), resamples=RESAMPLES,
    )  # fmt: skip
