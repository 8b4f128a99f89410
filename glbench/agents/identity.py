"""What a submission is, without running it: name, form, files, digest, card; and names that could be mistaken for each other.

``load_agent`` runs the submission's code to get an agent; ``identify`` only reads files. An evaluation in a sandbox never lets that
code into its own process, and yet must know what it files the result under.

======================  ====================================================================================================
what is given           what it is
======================  ====================================================================================================
``anna.py``             a Python file with ``make_agent(task)``
``anna.zip``            a model saved by Stable-Baselines3; ``vecnormalize.pkl`` or ``anna_vecnormalize.pkl`` beside it belongs to it
``anna.pt``, ``.ts``    a TorchScript policy
``anna.onnx``           an ONNX policy; weights in ``anna.onnx.data`` belong to it
a folder                with ``agent.py``, or one saved policy, or a card that says which file it is; everything in it belongs to it
======================  ====================================================================================================

The card is ``submission.toml`` in a folder, or ``anna.toml`` beside ``anna.py``.
"""

from __future__ import annotations

import os
import shlex
import struct
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from hashlib import file_digest, sha256
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal

from glbench import untrusted
from glbench.agents.naming import skeleton, skeletons
from glbench.errors import SubmissionError, refuse
from glbench.resources import LARGEST_TEXT, data_folder, is_text, with_unix_line_ends

if TYPE_CHECKING:
    from glbench.agents.card import SubmissionCard


LARGEST_SUBMISSION = 512 * untrusted.MIB  # Size of all files of a submission together [bytes]
MOST_FILES = 10_000
MOST_ENTRIES = 100_000  # Names in a submission's folder, with hidden files and folders
_PIECE = untrusted.MIB
_CACHE = "__pycache__"
_COPY_MODE = 0o755
_COPY_TIME = (315_532_800, 315_532_800)
"""Of every copy, so that an agent learns nothing from times; 1980 is the first year that zip archives know."""
SUBMISSION_CARD = "submission.toml"
CARD_FILE = "card.toml"  # The card of custom settings for a built-in controller; such a folder has no code
OBSERVATIONS_ONLY = "observations and the public task card"
AGENT_FILE = "agent.py"
STATISTICS_FILE = "vecnormalize.pkl"
Form = Literal["python", "sb3", "torchscript", "onnx"]
FORMS: dict[str, Form] = {".py": "python", ".zip": "sb3", ".pt": "torchscript", ".ts": "torchscript", ".onnx": "onnx"}
FORM_WORDS: dict[Form, str] = {
    "python": "Python code",
    "sb3": "Stable-Baselines3 model",
    "torchscript": "TorchScript policy",
    "onnx": "ONNX policy",
}
_LONGEST_QUOTE = 40
EXPECTED = (
    f"A submission is a .py file with make_agent(task), a saved policy (.zip of Stable-Baselines3, .pt or .ts of TorchScript, .onnx), "
    f"or a folder with {AGENT_FILE} or a saved policy"
)


def is_part_of_submission(file: Path, folder: Path) -> bool:
    """Whether a file in a submission's folder belongs to it: hidden files and Python's caches do not."""
    return not any(part.startswith(".") or part == _CACHE for part in file.relative_to(folder).parts)


def files_of_folder(folder: Path) -> tuple[Path, ...]:
    """Every file in a submission's folder; hidden files and Python's caches do not belong to it.

    Raises ``SubmissionError`` when there are too many, a name cannot be shown, a link leads to a folder, to nothing or out of ``folder``,
    or there is a pipe, a socket or a device, and ``OSError`` when a folder cannot be read.
    """
    files: list[Path] = []
    waiting, entry_count = [folder], 0
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                entry_count += 1
                path = Path(entry.path)
                if is_part_of_submission(Path(entry.name), Path()):
                    if not entry.name.isprintable():
                        msg = f"A name in {path.parent} cannot be shown as text: {entry.name!a}. Rename the file or folder."
                        raise SubmissionError(msg)
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(path)
                    else:
                        check_file(path, folder)
                        files.append(path)
                if entry_count > MOST_ENTRIES or len(files) > MOST_FILES:
                    msg = (
                        f"The submission in {folder} has more than {MOST_FILES:,} files, or more than {MOST_ENTRIES:,} with hidden files "
                        "and folders. Leave out what the agent does not need."
                    )
                    raise SubmissionError(msg)
    return tuple(sorted(files))


def check_file(file: Path, root: Path) -> None:
    """Refuse what is not a regular file, or a link that leads out of ``root``. Raises ``SubmissionError`` when it is."""
    if file.is_symlink():
        if not file.is_file():
            msg = f"{file} is a link to a folder or to nothing, so the digest would not cover what it holds. Copy the files."
            raise SubmissionError(msg)
        if file.readlink().is_absolute() or not untrusted.real_path(file).is_relative_to(untrusted.real_path(root)):
            refuse(f"{file} is a link that leads out of the submission's folder, and out of its sandbox. Copy the file.", SubmissionError)
    elif not file.is_file():
        msg = f"{file} is neither file nor folder, but a pipe, a socket or a device, which may lead out of the sandbox. Remove it."
        raise SubmissionError(msg)


def check_sizes(files: tuple[Path, ...], root: Path) -> None:
    """Raises ``SubmissionError`` when all files together are larger than ``LARGEST_SUBMISSION``, before any of them is read."""
    sizes = {file: file.stat().st_size for file in files}
    total = sum(sizes.values())
    if total > LARGEST_SUBMISSION:
        largest = max(files, key=sizes.__getitem__)
        msg = (
            f"The submission has {total / untrusted.MIB:,.0f} MiB, more than {LARGEST_SUBMISSION / untrusted.MIB:,.0f} MiB; the largest "
            f"file is {largest.relative_to(root)} ({sizes[largest] / untrusted.MIB:,.0f} MiB). Leave out what the agent does not need."
        )
        raise SubmissionError(msg)


def digest_of(files: tuple[Path, ...], root: Path, copy: Path | None = None) -> str:
    """SHA-256 (hex) over names and contents, as ``glbench.resources.sha256_of_files`` has it, of at most ``LARGEST_SUBMISSION`` bytes.

    Text counts with LF line endings. With ``copy``, a folder, the covered files are copied into it by their names, text with LF. Raises
    ``SubmissionError`` when a file changes while it is read, and ``OSError`` when a file cannot be read, or a copy not be written.
    """
    digest, remaining = sha256(), LARGEST_SUBMISSION
    for name, file in sorted((file.relative_to(root).as_posix(), file) for file in files):
        with untrusted.open_regular(file) as stream:
            size = os.fstat(stream.fileno()).st_size
            remaining -= size
            if remaining < 0:
                raise SubmissionError(_changed(file))
            encoded = name.encode("utf-8")
            pieces = _pieces(stream, size, file)
            if size <= LARGEST_TEXT:
                content = with_unix_line_ends(name, b"".join(pieces))
                pieces, size = iter((content,)), len(content)
            digest.update(len(encoded).to_bytes(8, "big") + encoded + size.to_bytes(8, "big"))
            if copy is not None:
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
            with nullcontext() if copy is None else (copy / name).open("xb") as target:
                for piece in pieces:
                    digest.update(piece)
                    if target is not None:
                        target.write(piece)
    if copy is not None:  # same rights and times for all: the digest covers names and contents only
        for item in (*copy.rglob("*"), copy):
            item.chmod(_COPY_MODE)
            os.utime(item, _COPY_TIME)
    return digest.hexdigest()


def _changed(file: Path) -> str:
    return f"{file} changes while it is read. Wait until nothing writes to the submission any more."


def _pieces(stream: IO[bytes], size: int, file: Path) -> Iterator[bytes]:
    """The ``size`` bytes that the file had when it was opened, of which nothing may be missing and to which nothing may be added."""
    while size > 0:
        piece = stream.read(min(size, _PIECE))
        if not piece:
            raise SubmissionError(_changed(file))
        size -= len(piece)
        yield piece
    if stream.read(1):
        raise SubmissionError(_changed(file))


@dataclass(frozen=True)
class Training:
    """Recipe and seed of an agent as its card states them, with the digest of its weights."""

    recipe: str
    seed: int
    form: str
    """Form of a submission; for settings, the controller."""
    policy: str | None
    """SHA-256 (hex) over the weights; ``None`` if no file holds weights."""


def policy_digest(weights: Iterable[Path]) -> str | None:
    """SHA-256 (hex) over files of weights, whatever their names, order and packing. Raises ``OSError`` when one cannot be read."""
    parts = []
    for file in weights:
        try:
            with untrusted.opened_archive(file) as archive:
                members = archive.infolist()
        except (OSError, ValueError, EOFError, NotImplementedError, struct.error, zipfile.BadZipFile):
            with file.open("rb") as opened:
                parts.append(file_digest(opened, "sha256").hexdigest())
        else:
            # An archive of Stable-Baselines3 also holds settings, which are not part of the policy.
            learnt = [item for item in members if item.filename.endswith(".pth")] or members
            parts += [f"{item.CRC:08x} {item.file_size}" for item in learnt]
    return sha256("\n".join(sorted(parts)).encode()).hexdigest() if parts else None


@dataclass(frozen=True)
class Identity:
    """A submission that has code or a policy of its own, as far as its files tell."""

    name: str
    """Name in results: that of the file or folder."""
    path: Path
    """The file or folder, resolved; what ``load_agent`` is to be called with."""
    files: tuple[Path, ...]
    """Of a single file: it and what belongs to it in the same folder. Empty for a folder, which belongs to it as a whole."""
    digest: str
    """SHA-256 (hex) over the submission's files, the same that ``load_agent`` gives."""
    information: str
    """What it sees, in words."""
    form: Form
    """What kind of submission it is."""
    entry: Path
    """The file to run or to load."""
    statistics: Path | None = None
    """The file with statistics of the observations, of a saved policy."""
    card: SubmissionCard | None = None
    """What it says about itself."""

    @property
    def folder(self) -> Path | None:
        """The folder that belongs to it as a whole."""
        return None if self.files else self.path

    @property
    def root(self) -> Path:
        """The folder below which all of its files lie."""
        return self.folder or self.entry.parent

    def all_files(self) -> tuple[Path, ...]:
        """Every file that belongs to it."""
        return self.files or files_of_folder(self.path)

    @property
    def training(self) -> Training | None:
        """Recipe and seed that the card states; ``None`` if it names no recipe. Errors as of ``digest_of``."""
        if self.card is None or self.card.recipe is None or self.card.seed is None:
            return None
        if self.form == "python":
            weights = [file for file in self.all_files() if not is_text(file.name)]
        else:
            weights = [file for file in (self.entry, self.entry.with_name(f"{self.entry.name}.data")) if file.is_file()]
        return Training(self.card.recipe, self.card.seed, self.form, policy_digest(weights))


def identify(ref: str | Path) -> Identity | None:
    """The submission at ``ref``, or ``None`` where ``ref`` names no code but glbench's own: a baseline, or settings for one.

    Also ``None`` where there is nothing at all; ``load_agent`` says what is missing. Raises ``SubmissionError`` when a submission is there
    that cannot have a result: a name that cannot be a file's, files that cannot be read, a wrong card.
    """
    if isinstance(ref, str) and ref in baseline_names():
        return None
    path = path_of(ref)
    is_there = path.is_file() or path.is_dir()  # a pipe would be waited for
    return read_identity(path) if is_there and not is_built_in(path) else None


def path_of(ref: str | Path) -> Path:
    """The path that names an agent. Raises ``SubmissionError`` when it is neither text nor a path."""
    if not isinstance(ref, Path | str):
        refuse(f"An agent is named by a baseline's name or a path; got {ref!r}. {EXPECTED}.", SubmissionError)
    return Path(ref).expanduser()


def is_built_in(path: Path) -> bool:
    """Whether a folder holds custom settings for a built-in controller, and no agent of its own."""
    return path.is_dir() and (path / CARD_FILE).is_file() and not (path / AGENT_FILE).is_file()


_PAGES = (".yml", ".toml")  # Of settings for a controller of glbench


def read_identity(path: Path) -> Identity:
    """What the file or folder ``path`` is. Raises ``SubmissionError`` when it is no submission, or its name, card or a file is wrong."""
    settings = next((one for one in list(path.parents)[:2] if is_built_in(one)), None)
    if path.suffix in _PAGES and settings is not None:
        command = f"glbench evaluate {shlex.quote(str(settings))}"
        refuse(f"{path} is a page of settings. Name the folder with its card.toml, such as: {command}", SubmissionError)
    name = name_of(path)
    place, folder = path.resolve(), path.resolve() if path.is_dir() else None
    root = folder or place.parent
    try:
        card, card_file = None, find_card(place)
        if card_file is not None:
            # Not at the top: what reads cards is large, and the process of an agent without one should not wait for it.
            from glbench.agents.card import read_card

            card = read_card(card_file)
        entry = _entry(folder, card) if folder is not None else place
        form = FORMS.get(entry.suffix)
        if form is None:
            refuse(f"{entry} is no Python file and no saved policy. {EXPECTED}.", SubmissionError)
        _check_card_fits(card, entry, form)
        files = files_of_folder(folder) if folder is not None else ()
        statistics = _statistics(entry, form, root, files, card)
        own: tuple[Path, ...] = ()
        if folder is None:
            weights = entry.with_name(f"{entry.name}.data")
            parts = [entry, statistics, card_file, weights if form == "onnx" and weights.is_file() else None]
            own = tuple(file for file in parts if file is not None)
            for file in own:
                check_file(file, root)
        check_sizes(own or files, root)
        digest = digest_of(own or files, root)
    except OSError as error:
        msg = f"The submission {name} cannot be read: {untrusted.reason_of(error)}. Check that its files exist and may be read."
        raise SubmissionError(msg) from error
    return Identity(name, place, own, digest, OBSERVATIONS_ONLY, form, entry, statistics, card)


def baseline_names() -> tuple[str, ...]:
    """Names of the shipped baselines."""
    return tuple(sorted(card.parent.name for card in data_folder("baselines").glob("*/card.toml")))


def baseline_like(name: str) -> str | None:
    """The baseline with this name, or one that it could be mistaken for, such as ``ppo`` for ``PP0`` and ``ppo_seed7``."""
    alike = skeletons(name)
    return next((baseline for baseline in baseline_names() if skeleton(baseline) in alike), None)


def name_of(place: Path) -> str:
    """Name of the agent in the file or folder ``place``, under which results are filed.

    Raises ``SubmissionError`` when it cannot be a name, is a baseline's or too much like it, or ``place`` is a link: it has two names.
    """
    if place.is_symlink():
        msg = f"{place} is a link. Name the file or folder that it leads to, under whose name results are filed, or copy it."
        raise SubmissionError(msg)
    resolved = place.resolve()
    name = resolved.stem if resolved.is_file() else resolved.name
    if not untrusted.is_agent_name(name):
        short = name if len(name) <= _LONGEST_QUOTE else f"{name[:_LONGEST_QUOTE]}..."
        msg = (
            f"'{short}' cannot be the name of an agent, because results are filed under it. "
            f"Rename the file or folder: {untrusted.AGENT_NAME_RULE}."
        )
        raise SubmissionError(msg)
    baseline = baseline_like(name)
    if baseline is not None:
        same = "is" if name == baseline else f"looks like '{baseline}',"
        refuse(f"'{name}' {same} the name of a baseline. Rename {place}, or run the baseline by its name.", SubmissionError)
    return name


def find_card(place: Path) -> Path | None:
    """The card of a file or folder, if it has one. Raises ``SubmissionError`` when it is a link that leads out of the submission."""
    root = place if place.is_dir() else place.parent
    file = root / SUBMISSION_CARD if root is place else place.with_suffix(".toml")
    if not file.is_file() or file == place:
        return None
    check_file(file, root)
    return file


def _entry(folder: Path, card: SubmissionCard | None) -> Path:
    named = (card.agent or card.model) if card is not None else None
    if named is not None:
        entry = folder / named
        if not _belongs(entry, folder):
            msg = f"The card of {folder.name} names the file '{named}', and the folder has none of that name that is not hidden."
            raise SubmissionError(msg)
        return entry
    if (folder / AGENT_FILE).is_file():
        return folder / AGENT_FILE
    with os.scandir(folder) as entries:
        names = [Path(entry.name) for entry in islice(entries, MOST_ENTRIES) if not entry.name.startswith(".")]
    policies = [folder / name for name in sorted(names) if FORMS.get(name.suffix, "python") != "python"]
    if len(policies) == 1:
        return policies[0]
    if policies:
        msg = (
            f"The folder {folder} holds several saved policies ({', '.join(file.name for file in policies)}). "
            f'Say in its {SUBMISSION_CARD} which one it is: model = "{policies[0].name}".'
        )
        raise SubmissionError(msg)
    msg = (
        f"The folder {folder} is no submission: it has no {AGENT_FILE} and no saved policy (.zip, .pt, .ts, .onnx). "
        f"Put make_agent(task) into a file called {AGENT_FILE}, or `glbench submit new NAME` writes a folder that runs."
    )
    raise SubmissionError(msg)


def _check_card_fits(card: SubmissionCard | None, entry: Path, form: Form) -> None:
    if card is None:
        return
    for key, named, fits in (("agent", card.agent, form == "python"), ("model", card.model, form != "python")):
        if named is None:
            continue
        if not fits:
            other = "model" if key == "agent" else "agent"
            refuse(f"The card calls {named} '{key}', and it is a {FORM_WORDS[form]}: write {other} = \"{named}\".", SubmissionError)
        if Path(named).name != entry.name:
            refuse(f'The card beside {entry.name} says {key} = "{named}". Name {entry.name} there, or remove the key.', SubmissionError)
    if form == "python" and (card.normalisation is not None or card.clip_actions):
        msg = (
            f"The card of {entry.name} has 'normalisation' or 'clip_actions', which are for saved policies; "
            "a Python agent does both itself."
        )
        raise SubmissionError(msg)


def _belongs(file: Path, folder: Path) -> bool:
    """Whether a file that a card names is one of those that the digest of the folder covers."""
    return file.is_file() and file.resolve().is_relative_to(folder) and is_part_of_submission(file.resolve(), folder)


def _statistics(entry: Path, form: Form, root: Path, files: tuple[Path, ...], card: SubmissionCard | None) -> Path | None:
    """The file with statistics of the observations: the card's, else by its name; ``files`` are those of a folder."""
    if card is not None and card.normalisation is not None:
        if not isinstance(card.normalisation, str):
            return None
        file = root / card.normalisation
        if not files and file.parent != root:
            msg = f"The statistics of {entry.name} must be beside it; the card names '{card.normalisation}'. Or submit a folder."
            raise SubmissionError(msg)
        if not _belongs(file, root):
            refuse(f"The card names the statistics '{card.normalisation}', and there is no such file in {root}.", SubmissionError)
        return file
    if form != "sb3":
        return None
    beside = [entry.with_name(f"{entry.stem}_{STATISTICS_FILE}"), entry.with_name(STATISTICS_FILE)]
    # Tools around Stable-Baselines3 put the statistics one folder deeper than the model.
    deeper = [file for file in files if file.name == STATISTICS_FILE]
    return next((file for file in [*beside, *deeper] if file.is_file()), None)
