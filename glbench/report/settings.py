"""What a baseline was set to: its settings with units, read from the file itself, and how it was trained, from the card beside it.

Only of the baselines that come with this glbench, and only where the digest in the result is still theirs: else the files beside the
code are not those that the result was made with.
"""

from __future__ import annotations

import csv
import re
import tomllib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glbench.agents.baselines import Baseline, read_baseline
from glbench.agents.identity import baseline_names
from glbench.agents.tuned_rules import RulePages
from glbench.quantities import pretty_unit
from glbench.resources import data_folder

if TYPE_CHECKING:
    from glbench.evaluation import Result
    from glbench.tasks import TaskSpec

_TEXT = (".yml", ".toml")
_KEY = re.compile(r"^(?P<indent> *)(?P<name>[A-Za-z_]\w*)\s*[:=]\s*(?P<value>[^#]*?)\s*(?:#\s*(?P<words>.*))?$")
_SECTION = re.compile(r"^\[(?P<name>\w+)\]\s*(?:#\s*(?P<words>.*))?$")
_UNIT = re.compile(
    r"^(?P<unit>degC|K|h|ppm|%|W m-2|MJ m-2 d-1|MJ m-2|g m-3|J cm-2|share(?: h)?(?: [K%h]-1)*|-)(?=[\s,:]|$)"
    r"[,:]?\s*(?P<words>.*)$"
)
_DEEPEST = 2
"""Spaces before a name; what is indented further is data."""
_POINTS = 60


@dataclass
class Section:
    """A table of settings: its title, what stands beside that, and rows of name, value, unit and meaning."""

    title: str
    words: str = ""
    rows: list[list[str]] = field(default_factory=list)


def sections_of(text: str) -> list[Section]:
    """The settings in a YAML or TOML file that says units and meanings in comments behind its values.

    A comment of one line between an empty line and a name is a heading, as is a table of TOML.
    """
    found, lines = [Section("")], text.splitlines()
    for number, line in enumerate(lines):
        table, key, row = _SECTION.match(line), _KEY.match(line), found[-1].rows
        if table:
            found.append(Section(_said(table["name"]), table["words"] or ""))
        elif key and len(key["indent"]) <= _DEEPEST and key["value"]:
            unit, words = _unit(key["words"] or "")
            row.append([_said(key["name"]), key["value"].strip("\"'"), unit, words])
        elif line.startswith("# ") and _is_heading(lines, number):
            found.append(Section(line[2:].strip()))
        elif line.lstrip().startswith("# ") and line.startswith(" ") and row and row[-1][3]:
            row[-1][3] += f" {line.lstrip()[2:].strip()}"
    return [section for section in found if section.rows]


def _is_heading(lines: list[str], number: int) -> bool:
    before = lines[number - 1].strip() if number else ""
    after = lines[number + 1] if number + 1 < len(lines) else ""
    return not before and bool(_KEY.match(after)) and not after.startswith(" ")


def _said(name: str) -> str:
    words = name.replace("_", " ").replace("co2", "CO₂")
    return words[:1].upper() + words[1:]


def _unit(words: str) -> tuple[str, str]:
    """Unit and meaning of a comment such as ``W m-2, the raise begins``."""
    found = _UNIT.match(words)
    if found is None:
        return "", words
    unit = found["unit"]
    return unit if unit.startswith("share") else pretty_unit(unit), found["words"]


def settings_of(result: Result, task: TaskSpec | None) -> dict[str, Any] | None:
    """Settings and training of the baseline that made ``result``, as the page shows them; ``None`` where they are not known here."""
    name = result.agent.name
    if result.agent.kind != "baseline" or name not in baseline_names() or task is None:
        return None
    baseline, folder = _baseline(name), data_folder("baselines") / name
    if baseline.digest != result.agent.digest:
        return None
    training = _training(folder, task.id)
    page = _page(baseline, folder, task)
    found = {
        "title": baseline.card.title,
        "description": " ".join(baseline.card.description.split()),
        "file": None if page is None else f"baselines/{_within(page)}",
        "sections": [] if page is None else _plain(page),
        "training": None if training is None else _card(training),
    }
    return found if found["sections"] or found["training"] else None


@cache
def _baseline(name: str) -> Baseline:
    return read_baseline(name)


def _within(file: Path) -> str:
    return file.resolve().relative_to(data_folder("baselines").resolve()).as_posix()


def _plain(file: Path) -> list[list[Any]]:
    sections = sections_of(file.read_text(encoding="utf-8"))
    return [[section.title, section.words, section.rows] for section in sections]


def _page(baseline: Baseline, folder: Path, task: TaskSpec) -> Path | None:
    """The file of settings that is followed on a task."""
    settings = baseline.settings
    if isinstance(settings, RulePages):
        return settings.page_for(task.reward.modules, task.id)
    file = folder / baseline.card.settings
    return file if file.suffix in _TEXT and file.is_file() else None


def _training(folder: Path, task_id: str) -> Path | None:
    """The card of the training on a task, where there was one."""
    for file in sorted((folder / "training").glob("*.toml")):
        about = tomllib.loads(file.read_text(encoding="utf-8")).get("task", {})
        if task_id in about.get("ids", [about.get("id")]):
            return file
    return None


def _card(file: Path) -> dict[str, Any]:
    """Budget, seasons, choice and recipe of a training, and its curve: steps and the reward of the policies or rules tried."""
    card = tomllib.loads(file.read_text(encoding="utf-8"))
    about, best, spent = card.get("training", {}), card.get("best", {}), card.get("wall_seconds", {})
    rows = [
        ["Algorithm", str(about.get("algorithm", ""))],
        ["Control steps", f"{about['steps']:,}" if "steps" in about else ""],
        ["Seed", str(about.get("seed", ""))],
        ["Learned from", _split(about)],
        ["Chosen by", f"the {about['chosen_on']} seasons" if "chosen_on" in about else ""],
        ["Best after", f"{best['steps']:,} steps" if "steps" in best else ""],
        ["Time", f"{spent['total'] / 3600:.1f} h" if "total" in spent else ""],
        ["Machine", _machine(card.get("machine", {}))],
        ["Finished", str(about.get("finished", ""))[:10]],
    ]
    recipe = file.parent / str(about.get("settings", ""))
    return {
        "file": f"baselines/{_within(file)}",
        "rows": [row for row in rows if row[1]],
        "recipe": _plain(recipe) if recipe.suffix in _TEXT and recipe.is_file() else [],
        "recipe_file": f"baselines/{_within(recipe)}" if recipe.is_file() else None,
        "curve": _curve(file.parent / str(about.get("learning_curve", ""))),
    }


def _split(about: dict[str, Any]) -> str:
    years = about.get("years", [])
    split = f"the {about['split']} seasons" if "split" in about else ""
    return " of ".join(part for part in (split, ", ".join(map(str, years))) if part)


def _machine(machine: dict[str, Any]) -> str:
    cores = f"{machine['cores']} cores" if "cores" in machine else ""
    return ", ".join(part for part in (str(machine.get("processor", "")), cores) if part)


def _curve(file: Path) -> list[list[float]]:
    """Steps and rewards of a learning curve, thinned to what a chart shows."""
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as lines:
        rows = [(float(row["steps"]), float(row["reward"])) for row in csv.DictReader(lines)]
    each = max(1, -(-len(rows) // _POINTS))
    kept = [row for place, row in enumerate(rows) if place % each == 0 or place == len(rows) - 1]
    return [[steps, float(f"{reward:.5g}")] for steps, reward in kept]
