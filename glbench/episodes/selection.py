"""Which runs of an evaluation are kept as full episodes, and where their records are, beside the result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from glbench.errors import EpisodeError, did_you_mean

WORDS = ("all", "none", "best", "worst", "median")
DEFAULT = "best,worst,median"
ACTIONS_SUFFIX = ".actions.mcap"


def parse_selection(text: str) -> tuple[str, ...]:
    """The words of ``all``, ``none``, or a list such as ``best,worst,median`` or ``best,670`` (a seed).

    Raises
    ------
    EpisodeError
        For what is no text, for another word, and for ``all`` or ``none`` in a list.
    """
    if not isinstance(text, str):
        msg = f"Episodes are chosen by a text such as '{DEFAULT}'; got {text!r}."
        raise EpisodeError(msg)
    words = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    for word in words:
        if word not in WORDS and not word.isdecimal():
            msg = f"'{word}' chooses no episode.{did_you_mean(word, WORDS)} A run's seed does, too."
            raise EpisodeError(msg)
    if len(words) > 1 and {"all", "none"} & set(words):
        msg = f"'{text}': all and none stand alone."
        raise EpisodeError(msg)
    return words


def chosen_rows(words: Sequence[str], seeds: Sequence[int], values: Sequence[float]) -> tuple[int, ...]:
    """Places of the chosen runs, in the order of the runs, by their ``values`` (higher is better; of equals the smaller seed).

    Of an even number of runs the median is the lower of the two in the middle.

    Raises
    ------
    EpisodeError
        For a seed that is none of the runs'.
    """
    ranked = sorted(range(len(seeds)), key=lambda row: (values[row], -seeds[row]))
    named = {"best": ranked[-1], "worst": ranked[0], "median": ranked[(len(ranked) - 1) // 2]}
    rows: set[int] = set()
    for word in words:
        if word == "all":
            rows.update(range(len(seeds)))
        elif word in named:
            rows.add(named[word])
        elif word != "none":
            if int(word) not in seeds:
                msg = f"No run has the seed {word}; they have {min(seeds)} to {max(seeds)}."
                raise EpisodeError(msg)
            rows.add(list(seeds).index(int(word)))
    return tuple(sorted(rows))


def actions_path(result: Path) -> Path:
    """``<agent>.actions.mcap`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + ACTIONS_SUFFIX)


def episodes_folder(result: Path) -> Path:
    """Folder of the full episodes of a result.

    ``<out>/episodes/<task>/<agent>`` for a result ``<out>/results/<task>/<agent>.json``; for a result elsewhere a folder beside it.
    """
    name = result.name.removesuffix(".json")
    if result.parent.parent.name == "results":
        return result.parent.parent.parent / "episodes" / result.parent.name / name
    return result.with_name(f"{name}.episodes")


def episode_path(folder: Path, seed: int) -> Path:
    """``<folder>/seed-<seed>.mcap``."""
    return folder / f"seed-{seed}.mcap"
