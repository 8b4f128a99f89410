"""The folders of ``baselines/``, which say what a baseline's name means: a controller, and its settings or weights.

``card.toml`` in such a folder names controller and settings file and says in words how the baseline was made. The folder holds
data only; ``controllers.py`` knows the controllers.
"""

from __future__ import annotations

import hashlib
import shlex
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict

from glbench.agents.card import RecipeId
from glbench.agents.controllers import CONTROLLERS, MODULES, find_controller
from glbench.agents.identity import Training, baseline_names, check_file, check_sizes, files_of_folder, policy_digest
from glbench.agents.protocol import Agent, PrivilegedController, ScenarioController, Sight
from glbench.errors import GlbenchError, SubmissionError, did_you_mean, refuse
from glbench.fields import Count
from glbench.model import get_model
from glbench.resources import data_folder, how_to_get_data, left_out, sha256_of_files, with_unix_line_ends
from glbench.settings import read_toml, validated
from glbench.tasks.quantities import PAPER_MODEL
from glbench.untrusted import MIB, opened_archive, quoted, real_path

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

LARGEST_ARCHIVE = 256 * MIB  # Size of the unpacked arrays of a policy or a recording [bytes]. The shipped ones have less than 1 MiB.
_SAVED_MODEL = "best/model.zip"  # Where ``glbench train`` leaves its best model in a training's folder


@contextmanager
def _damage_in_words() -> Iterator[None]:
    """Turn what readers of YAML, zip archives and arrays raise for damaged files into a ``SubmissionError``."""
    try:
        yield
    except (GlbenchError, OSError):
        raise
    except Exception as error:
        refuse(f"This agent cannot be made: {quoted(error)}. Its settings or the file of a policy may be damaged.", SubmissionError, error)


def _that_exists(name: str) -> str:
    names = sorted({*MODULES, *CONTROLLERS})
    if name not in names:
        refuse(f"there is no controller {quoted(name)}.{did_you_mean(name, names)}".rstrip("."))
    return name


class Recipe(BaseModel):
    """Table ``training`` of a card: the recipe, which trainings with other seeds share, and the seed."""

    model_config = ConfigDict(frozen=True, strict=True)

    recipe: RecipeId
    seed: Count


class Card(BaseModel):
    """``card.toml``: what a baseline is. Controller and settings decide what it does; the rest is for people.

    ``settings`` is a file or folder beside the card. Of the tables of the file (how a policy was trained) only ``Recipe`` is read.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    title: str
    controller: Annotated[str, AfterValidator(_that_exists)]
    settings: str
    description: str
    made: str
    sources: tuple[str, ...]
    training: Recipe | None = None


@dataclass(frozen=True)
class Baseline:
    """A baseline read from its folder."""

    card: Card
    settings: Any
    digest: str
    """SHA-256 (hex) over the controller's name and version, and its settings. The card's words may change."""
    training: Training | None = None
    """Recipe and seed in a baseline's card, with form and policy digest; ``None`` if the card names no recipe."""

    @property
    def sees(self) -> Sight:
        """What it is shown."""
        return find_controller(self.card.controller).sees

    @property
    def privileged(self) -> bool:
        """Whether it sees more than observations."""
        return self.sees != "observations"

    @property
    def information(self) -> str:
        """What it sees, in words."""
        return find_controller(self.card.controller).information

    def make(self, task: TaskCard) -> Agent | PrivilegedController | ScenarioController:
        """A new controller, which learns the rest on reset. Raises ``SubmissionError`` for another model, or settings that do not fit."""
        if self.sees == "state" and not set(get_model(PAPER_MODEL).state_names) <= set(get_model(task.model).state_names):
            msg = (
                f"'{self.card.controller}' reads the state of {PAPER_MODEL}, and {task.id} has {task.model}, which lacks some of it. "
                "Evaluate an agent that works with observations, such as rule_based_fair."
            )
            raise SubmissionError(msg)
        with _damage_in_words():
            return find_controller(self.card.controller).make(self.settings)


def read_baseline(ref: str | Path) -> Baseline:
    """Baseline of a shipped name (str), or from a folder (Path) with ``card.toml`` and custom settings.

    Raises ``SubmissionError`` when there is none of that name, or card or settings cannot be used.
    """
    if not isinstance(ref, Path | str):
        refuse(f"A baseline is named by its name or its folder; got {ref!r}. Baselines: {', '.join(baseline_names())}.", SubmissionError)
    folder = data_folder("baselines") / ref if isinstance(ref, str) else ref
    if not (folder / "card.toml").is_file():
        refuse(f"There is no baseline '{ref}'.{did_you_mean(str(ref), baseline_names())}", SubmissionError)
    if not isinstance(ref, str):  # somebody's folder, read outside of any sandbox
        check_file(folder / "card.toml", folder)
    card = _read_card(folder / "card.toml")
    with _damage_in_words():
        place = real_path(folder / card.settings)
    if not isinstance(ref, str) and place.exists():
        _check_place(place, folder)
    if not place.exists() and (folder / _SAVED_MODEL).is_file():
        model = folder / _SAVED_MODEL
        command = f"glbench evaluate {shlex.quote(str(model))}"
        refuse(f"The policy in {folder} could not be exported to {card.settings}. Evaluate the model itself: {command}", SubmissionError)
    if isinstance(ref, str) and ref in left_out():
        msg = f"What '{ref}' has learnt or planned ({card.settings}) is not part of this installation. {how_to_get_data()}"
        raise SubmissionError(msg)
    with _damage_in_words():
        settings = find_controller(card.controller).read(place)
    training = None
    if card.training is not None:
        weights = settings.files if place.is_dir() else (place,)
        training = Training(card.training.recipe, card.training.seed, card.controller, policy_digest(weights))
    return Baseline(card, settings, _digest(card.controller, place, settings), training)


def shipped_digest(name: str) -> str:
    """Digest of a shipped baseline, also where its policies or plans are not installed. Errors as of ``read_baseline``."""
    return left_out().get(name) or read_baseline(name).digest


@cache
def digests_of_baseline(name: str) -> tuple[str, ...]:
    """Digest of the baseline today, and those before it got policies or plans for more tasks; none of an agent of another name."""
    if name not in baseline_names():
        return ()
    entry = read_toml(data_folder("baselines") / "lock.toml").get(name)
    locked = () if entry is None else (entry["digest"], *entry.get("earlier", ()))  # the first is an earlier one until the lock is written
    try:
        return tuple(dict.fromkeys((shipped_digest(name), *locked)))
    except GlbenchError:
        return locked


def shipped_sight(name: str) -> Sight:
    """What a shipped baseline is shown, also where its policies or plans are missing. Raises ``SubmissionError`` when there is none."""
    return find_controller(_read_card(data_folder("baselines") / name / "card.toml").controller).sees


def shipped_training(name: str) -> Recipe | None:
    """Recipe and seed of a shipped baseline; ``None`` if its card names no recipe, or there is no such baseline."""
    return _shipped_trainings(data_folder("baselines")).get(name)


@cache
def _shipped_trainings(folder: Path) -> dict[str, Recipe | None]:
    return {name: _read_card(folder / name / "card.toml").training for name in baseline_names()}


def _check_place(place: Path, folder: Path) -> None:
    """Raises ``SubmissionError`` when settings lie elsewhere, are no regular files, or are or expand to more than they may."""
    if not place.is_relative_to(folder.resolve()):
        refuse(f"The card in {folder} names settings that lie elsewhere: {place}. Copy them into the folder.", SubmissionError)
    files = files_of_folder(place) if place.is_dir() else (place,)
    for file in files:
        check_file(file, folder)
    check_sizes(files, folder.resolve())
    for file in files:
        try:
            with opened_archive(file) as archive:
                size = sum(item.file_size for item in archive.infolist())
        except ValueError as error:
            refuse(f"{file} is no archive that can be read: {error}.", SubmissionError, error)
        except (OSError, NotImplementedError, zipfile.BadZipFile):
            continue  # it is not an archive; who reads it says what is wrong
        if size > LARGEST_ARCHIVE:
            refuse(f"{file} expands to more than {LARGEST_ARCHIVE // MIB} MiB, which no policy and no recording has.", SubmissionError)


def _digest(controller: str, place: Path, settings: Any) -> str:
    data = (
        sha256_of_files(place, list(settings.files))
        if place.is_dir()
        else hashlib.sha256(with_unix_line_ends(place.name, place.read_bytes())).hexdigest()
    )
    return hashlib.sha256(f"{controller} {find_controller(controller).version} {data}".encode()).hexdigest()


def _read_card(file: Path) -> Card:
    try:
        content = read_toml(file)
        plain = {key: value for key, value in content.items() if not isinstance(value, dict)}
        if isinstance(content.get("training"), dict) and "recipe" in content["training"]:
            plain["training"] = content["training"]
    except SubmissionError as error:
        refuse(f"Cannot read the card {file}: {error}.", SubmissionError, error)
    return validated(Card, plain, "the card", file)
