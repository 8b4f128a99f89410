"""Refuse submissions whose name or recipe is that of an existing agent, or looks like it.

Standard input has the changed submissions of a pull request, one path a line; the argument is the commit that it is based on. Names in
the environment variable SAME_OWNER pass: a maintainer lists there submissions known to be by the same author.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path, PurePosixPath

sys.path.append(str(Path(__file__).resolve().parents[1] / "glbench" / "agents"))
from naming import skeleton, skeletons  # type: ignore[import-not-found]

FORMS = {".py", ".zip", ".pt", ".ts", ".onnx"}
LARGEST_CARD = 64 * 1024


@dataclass(frozen=True)
class Agent:
    """A submission, baseline or released result: where it is, its name, and the recipe and authors that its card states."""

    path: str
    name: str
    recipe: str | None = None
    authors: tuple[str, ...] = ()


def card_of(path: str, read: Callable[[str], bytes | None]) -> tuple[str | None, tuple[str, ...]]:
    """Recipe and authors in the card of the submission ``path``; empty without a card or with an invalid one, which is refused later."""
    cards = [f"{path}/submission.toml", f"{path}/card.toml", str(PurePosixPath(path).with_suffix(".toml"))]
    for text in map(read, cards):
        if text is None or len(text) > LARGEST_CARD:
            continue
        try:
            card = tomllib.loads(text.decode("utf-8-sig"))
        except (ValueError, RecursionError):
            continue
        training = card.get("training")
        inner = training.get("recipe") if isinstance(training, dict) else None
        recipe, authors = card.get("recipe", inner), card.get("authors", [])
        named = [str(author) for author in authors] if isinstance(authors, list) else []
        return recipe if isinstance(recipe, str) else None, tuple(named)
    return None, ()


def git(*words: str) -> bytes:
    """What git prints."""
    return subprocess.run(["git", *words], capture_output=True, check=True).stdout


def agents_of(base: str) -> list[Agent]:
    """Every agent in the commit ``base``."""
    folders = ("submissions", "baselines", "reports/released/results")
    listed = git("ls-tree", "-r", "--name-only", "-z", base, "--", *folders).decode("utf-8", "replace").split("\0")
    files = set(listed)

    def read(name: str) -> bytes | None:
        return git("cat-file", "blob", f"{base}:{name}") if name in files else None

    agents = {}
    for file in map(PurePosixPath, filter(None, listed)):
        if file.parts[0] == "baselines":
            if file.name == "card.toml" and len(file.parts) == 3:
                agents[f"baselines/{file.parts[1]}"] = Agent(str(file.parent), file.parts[1])
        elif file.parts[0] == "reports":
            if file.suffix == ".json" and not file.name.endswith(".proof.json"):
                agents[file.stem] = Agent(str(file), file.stem)
        elif len(file.parts) > 2 or file.suffix in FORMS:
            path = "/".join(file.parts[:2])
            name = file.parts[1] if len(file.parts) > 2 else file.stem
            if path != "submissions/templates" and path not in agents:
                agents[path] = Agent(path, name, *card_of(path, read))
    return list(agents.values())


def changed_agents(paths: list[str]) -> list[Agent]:
    """The submissions of the pull request, as they are in the working tree."""

    def read(name: str) -> bytes | None:
        return Path(name).read_bytes()[: LARGEST_CARD + 1] if Path(name).is_file() else None

    names = [(path, Path(path).name if Path(path).is_dir() else Path(path).stem) for path in paths]
    return [Agent(path, name, *card_of(path, read)) for path, name in names]


def look_alike(one: Agent, other: Agent) -> bool:
    """Whether readers could mistake one name for the other, or for a training of the same recipe."""
    return bool(skeletons(one.name) & skeletons(other.name))


def share_a_recipe(one: Agent, other: Agent) -> bool:
    """Whether the two state the same recipe and authors, or ones that look alike."""
    if one.recipe is None or other.recipe is None or skeleton(one.recipe) != skeleton(other.recipe):
        return False
    authors = [{skeleton(author) for author in agent.authors} for agent in (one, other)]
    return bool(authors[0] & authors[1]) or not any(authors)


def problems(changed: list[Agent], known: list[Agent]) -> list[str]:
    """Why submissions are refused, one sentence each."""
    paths = {agent.path for agent in known}
    owned = set(os.environ.get("SAME_OWNER", "").split())
    refusals = []
    for one in (agent for agent in changed if agent.name not in owned):
        for other in (agent for agent in known if agent.path != one.path):
            if one.path not in paths and look_alike(one, other):
                refusals.append(
                    f"'{one.name}' looks like '{other.name}' ({other.path}), an existing agent. Give the submission another name."
                )
            elif share_a_recipe(one, other):
                refusals.append(
                    f"'{one.name}' states the recipe '{one.recipe}', which {other.path} already has. Choose another recipe id, "
                    "or hand in all trainings of a recipe in one pull request."
                )
    for one, other in combinations([agent for agent in changed if agent.path not in paths], 2):
        joined = one.recipe is not None and (one.recipe, one.authors) == (other.recipe, other.authors)
        if look_alike(one, other) and not joined:
            refusals.append(
                f"'{one.name}' and '{other.name}' look alike. Give them different names or, if they are trainings of one recipe, state "
                "the same recipe and authors and different seeds in their cards."
            )
    return refusals


if __name__ == "__main__":
    refused = problems(changed_agents(sys.stdin.read().split("\n")[:-1]), agents_of(sys.argv[1]))
    sys.exit("\n".join(refused) or None)
