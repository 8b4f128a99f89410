"""The built-in controllers, and the folders of ``baselines/`` that say which one a name means and with which settings or weights.

``card.toml`` in such a folder names controller and settings file and says in words how the baseline was made. The folder holds
data only; the code is here, next to what tests and types can check.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict

from glbench.agents.card import RecipeId
from glbench.agents.identity import Training, baseline_names, check_file, check_sizes, files_of_folder, policy_digest
from glbench.agents.protocol import Agent, PrivilegedController, ScenarioController, Sight
from glbench.errors import GlbenchError, SubmissionError, did_you_mean
from glbench.fields import Count
from glbench.model import get_model
from glbench.resources import data_folder, how_to_get_data, left_out, sha256_of_files, with_unix_line_ends
from glbench.settings import read_toml, validated
from glbench.tasks.quantities import PAPER_MODEL
from glbench.untrusted import MIB, opened_archive, quoted, real_path

if TYPE_CHECKING:
    from glbench.agents.energy_rule_settings import EnergyRulePages
    from glbench.agents.grower import GrowerSettings
    from glbench.agents.network_policy import PolicyFiles
    from glbench.agents.plans import PlanFolder
    from glbench.agents.predictive import PredictiveSettings
    from glbench.agents.recording import Recording
    from glbench.agents.rule_settings import RuleSettings
    from glbench.agents.tuned_rule_settings import RulePages
    from glbench.tasks import TaskCard

    Settings: TypeAlias = (
        RuleSettings
        | RulePages
        | EnergyRulePages
        | GrowerSettings
        | PolicyFiles
        | PredictiveSettings
        | Recording
        | PlanFolder
    )

LARGEST_ARCHIVE = 256 * MIB
"""Size of the unpacked arrays of a policy or a recording [bytes]. The shipped ones have less than 1 MiB."""
_SAVED_MODEL = "best/model.zip"
"""Where ``glbench train`` leaves its best model in a training's folder."""


@dataclass(frozen=True)
class _Controller:
    """A built-in controller: what it sees, how it is made, and its version.

    ``reader`` and ``maker`` are places (module, name): a process loads what the controller needs that it was asked for.
    ``version`` is part of the digest of every agent of this controller. Source may change as long as the actions stay;
    ``baselines/lock.toml`` records the actions of the shipped baselines, and a test compares them. Other actions need another version.
    The first version of a controller is the SHA-256 of its source when its first results were released.
    """

    sees: Sight
    information: str
    reader: tuple[str, str]
    maker: tuple[str, str]
    version: str

    def read(self, place: Path) -> Settings:
        """Read what the card calls the controller's settings: rules, a grower's page, trained policies, or recorded actions."""
        with _damage_in_words():
            settings: Settings = _found(self.reader)(place)
        return settings

    def make(self, settings: Settings) -> Agent | PrivilegedController | ScenarioController:
        """A new controller with these settings.

        Raises
        ------
        SubmissionError
            When it cannot be made with these settings.
        """
        with _damage_in_words():
            controller: Agent | PrivilegedController | ScenarioController = _found(self.maker)(settings)
        return controller


@contextmanager
def _damage_in_words() -> Iterator[None]:
    """Turn what readers of YAML, zip archives and arrays raise for damaged files into a ``SubmissionError``."""
    try:
        yield
    except (GlbenchError, OSError):
        raise
    except Exception as error:
        msg = f"This agent cannot be made: {quoted(error)}. Its settings or the file of a policy may be damaged."
        raise SubmissionError(msg) from error


def _found(place: tuple[str, str]) -> Callable[..., Any]:
    module, name = place
    found: Callable[..., Any] = attrgetter(name)(import_module(f"glbench.agents.{module}"))
    return found


_RULE_SETTINGS = ("rule_settings", "read_rule_settings")

_CONTROLLERS = {
    "rule_based": _Controller(
        sees="state",
        information=(
            "privileged: true state, weather of the coming step, radiation sum of the whole day, dawn and dusk in advance; "
            "sets controls directly, without rate limit"
        ),
        reader=_RULE_SETTINGS,
        maker=("rule_based", "RuleBasedController"),
        version="6eb5ee2b12f66ad91f2b87c4999de3caca1a0bc3986c8cf392674cf2db260d8a",
    ),
    "rule_based_fair": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=_RULE_SETTINGS,
        maker=("rule_based_fair", "FairRuleBasedAgent"),
        version="422c7198decf7d13b7615521fba8f7915ad3235b7cb7256e2355ceb9327db821",
    ),
    "rule_based_tuned": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=("tuned_rule_settings", "read_rule_pages"),
        maker=("tuned_rules", "TunedRulesAgent"),
        version="bd6432cc9ef75f1b05f527db61c1468c3eb7cff93e20f92856e42130415ea65c",
    ),
    "rule_based_energy": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=("energy_rule_settings", "read_energy_rule_pages"),
        maker=("energy_rules", "EnergyRulesAgent"),
        version="0da9d380f7e6d1bab7a9fb3838ca97426982100d4c8f299686ddc7f7ab5344c3",
    ),
    "network": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=("network_policy", "PolicyFiles.at"),
        maker=("network_policy", "PolicyAgent"),
        version="6fcf81c123040c502f9068710aceb794d84916948e29ce0d711175a4640c19ba",
    ),
    "actor": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=("network_policy", "PolicyFiles.at"),
        maker=("network_policy", "PolicyAgent"),
        version="e49117f6dd9b61cf6ed41b2150606726786ac0780e5a18059087026cccf01b65",
    ),
    "grower": _Controller(
        sees="observations",
        information="observations and the public task card",
        reader=("grower", "read_grower_settings"),
        maker=("grower", "GrowerAgent"),
        version="b39f2da424cbd9fc5f64fc9e0ab4be3edb32723be330b22a89cc3c66c9d2233e",
    ),
    "recording": _Controller(
        sees="observations",
        information="nothing: replays recorded actions",
        reader=("recording", "read_recording"),
        maker=("recording", "RecordingAgent"),
        version="48d93ad361af231dfd67a11e7d5f40524077a85aeb162f7c54ef9de0f0b72588",
    ),
    "plans": _Controller(
        sees="scenario",
        information="privileged: everything that is given in a run, its draws and the weather to come; acts through the task's actuation",
        reader=("plans", "PlanFolder"),
        maker=("plans", "PlanController"),
        version="6b6f0390984d19449fd387b60c40cf7131b2f3b9ed54977e7b7b33a5565fd81c",
    ),
    "mpc_true_state": _Controller(
        sees="scenario",
        information=(
            "privileged: true states, all weather to come, the parameters of the run in every step to come; acts through the task's "
            "actuation"
        ),
        reader=("predictive", "read_predictive_settings"),
        maker=("predictive", "TrueStateController"),
        version=(
            "bbd462e65f9c85feeb5dd0e56292bdbe07adaaf95fccb7736293c77bec062442 "
            "c9c4998d8192f4ffa4551be3802850d2ba3bf26ea79904fc849cf112ef9afa2f"
        ),
    ),
    "mpc": _Controller(
        sees="observations",
        information="observations, the public definition of the task, and the mean days of its training years",
        reader=("predictive", "read_predictive_settings"),
        maker=("predictive", "PredictiveAgent"),
        version=(
            "bbd462e65f9c85feeb5dd0e56292bdbe07adaaf95fccb7736293c77bec062442 "
            "89f3d6f9cd3064159e1a8013ac4e48bf5340ebb6788e92ff418da40687dab753"
        ),
    ),
}


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
    controller: Literal[
        "rule_based",
        "rule_based_fair",
        "rule_based_tuned",
        "rule_based_energy",
        "grower",
        "network",
        "actor",
        "recording",
        "plans",
        "mpc_true_state",
        "mpc",
    ]
    settings: str
    description: str
    made: str
    sources: tuple[str, ...]
    training: Recipe | None = None


@dataclass(frozen=True)
class Baseline:
    """A baseline read from its folder."""

    card: Card
    settings: Settings
    digest: str
    """SHA-256 (hex) over the controller's name and version, and its settings. The card's words may change."""
    training: Training | None = None
    """Recipe and seed in a baseline's card, with form and policy digest; ``None`` if the card names no recipe."""

    @property
    def sees(self) -> Sight:
        """What it is shown."""
        return _CONTROLLERS[self.card.controller].sees

    @property
    def privileged(self) -> bool:
        """Whether it sees more than observations."""
        return self.sees != "observations"

    @property
    def information(self) -> str:
        """What it sees, in words."""
        return _CONTROLLERS[self.card.controller].information

    def make(self, task: TaskCard) -> Agent | PrivilegedController | ScenarioController:
        """A new controller; what else there is to know of its task it learns on reset.

        Raises
        ------
        SubmissionError
            When it reads the state of another model, or cannot be made with its settings.
        """
        if self.sees == "state" and not set(get_model(PAPER_MODEL).state_names) <= set(
            get_model(task.model).state_names
        ):
            msg = (
                f"'{self.card.controller}' reads the state of {PAPER_MODEL}, and {task.id} has {task.model}, which lacks some of it. "
                "Evaluate an agent that works with observations, such as rule_based_fair."
            )
            raise SubmissionError(msg)
        return _CONTROLLERS[self.card.controller].make(self.settings)


def read_baseline(ref: str | Path) -> Baseline:
    """Baseline of a shipped name (str), or from a folder (Path) with ``card.toml`` and custom settings.

    Raises
    ------
    SubmissionError
        When there is none of that name, or card or settings cannot be used.
    """
    if not isinstance(ref, Path | str):
        msg = f"A baseline is named by its name or its folder; got {ref!r}. Baselines: {', '.join(baseline_names())}."
        raise SubmissionError(msg)
    folder = data_folder("baselines") / ref if isinstance(ref, str) else ref
    if not (folder / "card.toml").is_file():
        msg = f"There is no baseline '{ref}'.{did_you_mean(str(ref), baseline_names())}"
        raise SubmissionError(msg)
    if not isinstance(ref, str):  # somebody's folder, read outside of any sandbox
        check_file(folder / "card.toml", folder)
    card = _read_card(folder / "card.toml")
    with _damage_in_words():
        place = real_path(folder / card.settings)
    if not isinstance(ref, str) and place.exists():
        _check_place(place, folder)
    if not place.exists() and (folder / _SAVED_MODEL).is_file():
        model = folder / _SAVED_MODEL
        msg = f"The policy in {folder} could not be exported to {card.settings}. Evaluate the model itself: glbench evaluate {model}"
        raise SubmissionError(msg)
    if isinstance(ref, str) and ref in left_out():
        msg = f"What '{ref}' has learnt or planned ({card.settings}) is not part of this installation. {how_to_get_data()}"
        raise SubmissionError(msg)
    settings = _CONTROLLERS[card.controller].read(place)
    training = None
    if card.training is not None:
        weights = settings.files if place.is_dir() else (place,)  # type: ignore[union-attr]
        training = Training(card.training.recipe, card.training.seed, card.controller, policy_digest(weights))
    return Baseline(card, settings, _digest(card.controller, place, settings), training)


def shipped_digest(name: str) -> str:
    """Digest of a shipped baseline, also where its policies or plans are not installed. Errors as of ``read_baseline``."""
    return left_out().get(name) or read_baseline(name).digest


def shipped_sight(name: str) -> Sight:
    """What a shipped baseline is shown, also where its policies or plans are not installed.

    Raises
    ------
    SubmissionError
        When there is no such baseline.
    """
    return _CONTROLLERS[_read_card(data_folder("baselines") / name / "card.toml").controller].sees


def shipped_training(name: str) -> Recipe | None:
    """Recipe and seed of a shipped baseline; ``None`` if its card names no recipe, or there is no such baseline."""
    return _shipped_trainings(data_folder("baselines")).get(name)


@cache
def _shipped_trainings(folder: Path) -> dict[str, Recipe | None]:
    return {name: _read_card(folder / name / "card.toml").training for name in baseline_names()}


def _check_place(place: Path, folder: Path) -> None:
    """Refuse settings that lie elsewhere, are no regular files, or are or expand to more than they may.

    Raises
    ------
    SubmissionError
        When they do.
    """
    if not place.is_relative_to(folder.resolve()):
        msg = f"The card in {folder} names settings that lie elsewhere: {place}. Copy them into the folder."
        raise SubmissionError(msg)
    files = files_of_folder(place) if place.is_dir() else (place,)
    for file in files:
        check_file(file, folder)
    check_sizes(files, folder.resolve())
    for file in files:
        try:
            with opened_archive(file) as archive:
                size = sum(item.file_size for item in archive.infolist())
        except ValueError as error:
            msg = f"{file} is no archive that can be read: {error}."
            raise SubmissionError(msg) from error
        except (OSError, NotImplementedError, zipfile.BadZipFile):
            continue  # it is not an archive; who reads it says what is wrong
        if size > LARGEST_ARCHIVE:
            msg = f"{file} expands to more than {LARGEST_ARCHIVE // MIB} MiB, which no policy and no recording has."
            raise SubmissionError(msg)


def _digest(controller: str, place: Path, settings: Any) -> str:
    data = (
        sha256_of_files(place, list(settings.files))
        if place.is_dir()
        else hashlib.sha256(with_unix_line_ends(place.name, place.read_bytes())).hexdigest()
    )
    return hashlib.sha256(f"{controller} {_CONTROLLERS[controller].version} {data}".encode()).hexdigest()


def _read_card(file: Path) -> Card:
    try:
        content = read_toml(file)
        plain = {key: value for key, value in content.items() if not isinstance(value, dict)}
        if isinstance(content.get("training"), dict) and "recipe" in content["training"]:
            plain["training"] = content["training"]
    except SubmissionError as error:
        msg = f"Cannot read the card {file}: {error}."
        raise SubmissionError(msg) from error
    return validated(Card, plain, "the card", file)
