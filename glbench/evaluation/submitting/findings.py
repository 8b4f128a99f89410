"""What a check finds: the report, and what the files of a submission tell without being run."""

from __future__ import annotations

import ast
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from glbench.agents.card import SubmissionCard, check_card
from glbench.agents.identity import FORM_WORDS, Identity, find_card
from glbench.agents.saved_policies import torchscript_complaint
from glbench.agents.sb3 import read_archive, space_complaints, statistics_complaints
from glbench.errors import SubmissionError
from glbench.evaluation.sandbox.frames import MIB
from glbench.extras import how_to_install, missing
from glbench.tasks import TaskCard

Level = Literal["problem", "note"]
Subject = Literal["card", "files", "packages", "loading", "decisions", "repeatable", "rows", "time", "memory", "surroundings", "printing"]

CHECKS: dict[Subject, str] = {
    "card": "The card is there and makes sense",
    "files": "Files can be read and are not too large",
    "packages": "Everything that is imported is installed",
    "loading": "The agent can be loaded and made",
    "decisions": "Actions have the right shape, are finite and within their bounds",
    "repeatable": "The same observations give the same actions",
    "rows": "Same decisions alone and in a batch",
    "time": "Decisions are fast enough",
    "memory": "Memory stays within its limit",
    "surroundings": "It needs no network and writes no files",
    "printing": "It prints little",
}
"""Everything that is looked at, in the order of a report."""


@dataclass(frozen=True)
class Finding:
    """One thing found. A ``problem`` will cost the submission runs or its place; a ``note`` is good to know."""

    subject: Subject
    level: Level
    text: str


@dataclass(frozen=True)
class Report:
    """Everything that was found.

    ``checked`` names the subjects that were reached: a file that cannot be loaded makes no decisions that could be looked at.
    ``facts`` are measured figures in words by subject.
    """

    name: str
    what: str
    task: str
    findings: tuple[Finding, ...]
    checked: frozenset[Subject]
    facts: dict[Subject, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The findings that have to be fixed."""
        return tuple(finding for finding in self.findings if finding.level == "problem")

    @property
    def ok(self) -> bool:
        """Whether there are no problems."""
        return not self.problems

    def of(self, subject: Subject) -> tuple[Finding, ...]:
        """The findings about one subject."""
        return tuple(finding for finding in self.findings if finding.subject == subject)


def problem(subject: Subject, text: str) -> Finding:
    """A finding that is a problem."""
    return Finding(subject, "problem", text)


def note(subject: Subject, text: str) -> Finding:
    """A finding that is good to know."""
    return Finding(subject, "note", text)


MANY_FILES = 1000
_LARGEST_LOOK, _ALL_SOURCES = 64 * MIB, 2 * MIB
"""Sizes up to which a saved policy is opened, and source files, all together, are parsed before the agent runs."""
_ALWAYS_THERE = frozenset({"numpy", "glbench"})
_NEEDS = {"sb3": ("torch", "stable_baselines3"), "torchscript": ("torch",), "onnx": ("onnxruntime",), "python": ()}
_LARGE = frozenset({"torch", "stable_baselines3", "sb3_contrib", "onnxruntime", "scipy", "pandas", "sklearn", "jax", "tensorflow"})
_PACKAGE_OF = {
    "stable_baselines3": "stable-baselines3",
    "sb3_contrib": "sb3-contrib",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
    "PIL": "pillow",
}
"""What a module is called where it is installed from, when that is another name."""


def card_findings(path: Path) -> tuple[SubmissionCard | None, list[Finding]]:
    """The card of the submission at ``path``, and what is wrong with it."""
    file = find_card(path.resolve())
    if file is None:
        where = "submission.toml in the folder" if path.is_dir() else f"{path.stem}.toml beside the file"
        text = (
            f"There is no card ({where}). Results then say nothing of authors, licence and training. "
            "`glbench submit new` writes one to copy."
        )
        return None, [note("card", text)]
    card, problems = check_card(file)
    return card, [problem("card", f"{file.name}: {text}.") for text in problems]


def card_notes(identity: Identity) -> list[Finding]:
    """What a valid card leaves open."""
    card = identity.card
    if card is None:
        return []
    results = []
    if identity.form != "python" and card.training is None:
        results.append(
            note("card", "The card of a trained policy has no table [training] (steps, wall_hours): others cannot tell what it cost.")
        )
    if "privileged" in card.information:
        text = (
            "The card says 'privileged'. A submission is shown observations only, so it cannot be; "
            "if it knows more, say from where in 'description'."
        )
        results.append(note("card", text))
    return results


def size_findings(identity: Identity) -> list[Finding]:
    """Whether the files are few; those that are too large have no identity at all."""
    count = len(identity.all_files())
    if count > MANY_FILES:
        return [note("files", f"The folder holds {count} files. Is all of it needed? Each is part of the digest.")]
    return []


def size_in_words(identity: Identity) -> str:
    """How many files there are, and how large they are together."""
    files = identity.all_files()
    size = sum(file.stat().st_size for file in files)
    amount = f"{size / MIB:.1f} MiB" if size >= MIB / 10 else f"{size / 1024:.1f} KiB"
    return f"{len(files)} file{'s' if len(files) > 1 else ''}, {amount}"


Import = tuple[Path, str, int, bool]
"""File, top-level name, line, and whether it stands within ``try``."""


def imports_of(identity: Identity) -> list[Import]:
    """Every import that is not relative, in as many files as may be parsed."""
    results, room = list[Import](), _ALL_SOURCES
    for file in (file for file in identity.all_files() if file.suffix == ".py"):
        size = file.stat().st_size
        if size <= room:
            room -= size
            results += [(file, *one) for one in _imported(file)]
    return results


def package_findings(identity: Identity, imports: Sequence[Import]) -> list[Finding]:
    """Whether what the submission imports is installed, and declared where there is a card."""
    results = [
        problem("packages", f"A {FORM_WORDS[identity.form]} needs {module}, which is not installed here. {how_to_install(module)}")
        for module in missing(*_NEEDS[identity.form])
    ]
    declared = {name.lower().replace("_", "-") for name in identity.card.requires} if identity.card is not None else set()
    items = identity.folder.iterdir() if identity.folder is not None else ()
    own = {item.stem for item in items if item.is_dir() or item.suffix == ".py"}
    checked: set[str] = set()
    for file, module, line, guarded in imports:
        if module in checked or module in own or module in sys.stdlib_module_names or module in _ALWAYS_THERE:
            continue
        checked.add(module)
        place = f"{file.relative_to(identity.root)}:{line}"
        if missing(module):
            text = f"{place} imports '{module}', which is not installed here. {how_to_install(module)}"
            results.append(
                note("packages", f"{text} (It is imported within try, so the agent may do without.)")
                if guarded
                else problem("packages", text)
            )
        package = _PACKAGE_OF.get(module, module).lower().replace("_", "-")
        if identity.card is not None and package not in declared and not guarded:
            text = f"{place} imports '{module}', which the card does not name: requires = [\"{package}\"]."
            results.append(note("packages", text))
    return results


def large_packages(identity: Identity, imports: Sequence[Import]) -> tuple[str, ...]:
    """Those packages that a submission needs and that take seconds to import."""
    needed = {module for _, module, _, _ in imports} if identity.form == "python" else set(_NEEDS[identity.form])
    return tuple(sorted(module for module in needed & _LARGE if not missing(module)))


def policy_findings(identity: Identity, task: TaskCard) -> list[Finding]:
    """What a saved policy says about itself that does not fit; of a huge file its loading will tell, where it can do no harm."""
    if identity.entry.stat().st_size > _LARGEST_LOOK:
        return []
    if identity.form == "torchscript":
        complaint = torchscript_complaint(identity.entry)
        return [problem("loading", complaint)] if complaint is not None else []
    if identity.form != "sb3":
        return []
    try:
        archive = read_archive(identity.entry)
    except SubmissionError as error:
        return [problem("loading", str(error))]
    results = [problem("loading", text) for text in space_complaints(archive, task, identity.entry.name)]
    results += [problem("loading", text) for text in statistics_complaints(archive, identity)]
    if archive.algorithm.module == "sb3_contrib" and missing("sb3_contrib"):
        text = f"The {archive.algorithm.name} model needs sb3-contrib, which is not installed here. {how_to_install('sb3_contrib')}"
        results.append(problem("packages", text))
    algorithm = identity.card.algorithm if identity.card is not None else None
    if algorithm is not None and algorithm.lower() != archive.algorithm.name.lower():
        results.append(note("card", f'The card says algorithm = "{algorithm}", the model is of {archive.algorithm.name}.'))
    return results


def _imported(file: Path) -> Iterator[tuple[str, int, bool]]:
    """Top-level name, line, and whether it stands within ``try``, of every import that is not relative."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # told by the loading, with the line
        return
    waiting: deque[tuple[ast.AST, bool]] = deque([(tree, False)])
    while waiting:
        node, guarded = waiting.popleft()
        guarded = guarded or isinstance(node, ast.Try)
        waiting += [(inner, guarded) for inner in ast.iter_child_nodes(node)]
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module]
        else:
            continue
        for name in names:
            yield name.partition(".")[0], node.lineno, guarded
