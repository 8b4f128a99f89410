"""What README and docs/reproduction.md say without a figure: who is ahead of whom."""

from __future__ import annotations

import itertools
import re
import tomllib
from collections.abc import Callable
from importlib.metadata import metadata
from pathlib import Path

import pytest

from glbench.tasks import list_tasks
from tests.docs import claims
from tests.docs.claims import CLAIMS, LEVELS, NotReleasedError, mean, mean_of_trainings, trainings
from tests.docs.quoted import places, text_of

ROOT = Path(__file__).resolve().parents[2]


def written() -> list[Path]:
    """Pages, cards and settings that say in how many seasons something was trained, tuned or tried."""
    texts = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/notebooks/*.ipynb")]
    texts += [file for kind in ("card.toml", "card.in.toml", "*.yml") for file in ROOT.glob(f"baselines/*/{kind}")]
    return sorted(set(texts) - {ROOT / "docs" / "weather.md"})  # which tries the generator itself, without a split


def test_no_text_has_more_seasons_than_a_split() -> None:
    """A scenario is a season with its draws: 1,024 scenarios of a split of 256 seasons are in 256 seasons."""
    splits = [split for task in list_tasks() if task.splits for _, split in task.splits if split]
    most = max(split.seasons or 0 for split in splits)
    wrong = [
        f'{file.relative_to(ROOT)}: "{claim[0]}": no split has more than {most} seasons. Scenarios, runs or episodes?'
        for file in written()
        for claim in re.finditer(
            r"\b(\d{1,3}(?:,\d{3})+|\d+) (?:[a-z]+ )?seasons|(?:thousands|times as many) (?:\w+ )?(?:of )?(?:\w+ )?seasons",
            file.read_text(encoding="utf-8"),
        )
        if claim[1] is None or int(claim[1].replace(",", "")) > most
    ]
    assert not wrong, "\n" + "\n".join(wrong)


def test_the_page_of_licences_has_every_weather_record_and_every_copyleft_package() -> None:
    page = (ROOT / "docs" / "provenance.md").read_text(encoding="utf-8")
    records = tomllib.loads((ROOT / "weather" / "manifest.toml").read_text(encoding="utf-8"))["record"]
    assert [name for name in records if f"`{name}`" not in page] == []
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    for name in (re.split("[<>=]", one)[0] for one in needed):
        about = metadata(name)
        stated = [about.get("License-Expression", ""), about.get("License", "")[:80], *about.get_all("Classifier", [])]
        if re.search(r"GPL|Mozilla|GNU", " ".join(stated)):
            assert name in page.lower(), f"{name} is under {stated[:2]}: say so"


@pytest.mark.parametrize("level", LEVELS)
def test_doing_nothing_has_a_higher_epi_than_sac(level: int) -> None:
    assert mean("do_nothing", level, "epi") > max(mean(agent, level, "epi") for agent in trainings("sac", level))


def test_at_30_percent_doing_nothing_is_ahead_of_two_ppo_policies_and_of_the_unlit_rules() -> None:
    nothing = mean("do_nothing", 30, "epi")
    assert sum(nothing > mean(agent, 30, "epi") for agent in trainings("ppo", 30)) == 2
    assert nothing > mean("rule_based_unlit", 30, "epi")


@pytest.mark.parametrize("level", LEVELS)
def test_every_ppo_is_ahead_of_every_sac_and_every_sac_ahead_of_the_unlit_rules(level: int) -> None:
    ppo, sac = ([mean(agent, level) for agent in trainings(name, level)] for name in ("ppo", "sac"))
    assert min(ppo) > max(sac)
    assert min(sac) > mean("rule_based_unlit", level)
    assert mean("rule_based_unlit", level, "epi") > mean_of_trainings("sac", level, "epi")


@pytest.mark.parametrize("level", LEVELS)
def test_the_tuned_policy_is_ahead_in_reward_and_of_the_unlit_rules_in_money(level: int) -> None:
    assert mean("ppo_tuned", level) > max(mean(agent, level) for agent in trainings("ppo", level))
    assert mean("ppo_tuned", level, "epi") > mean("rule_based_unlit", level, "epi")
    assert mean("ppo_tuned", level, "cost_electricity") < 0.005


def test_a_blind_recording_is_ahead_of_all_but_the_policy_it_was_made_of() -> None:
    try:
        blind = mean("recording", 10)
    except NotReleasedError as error:
        pytest.fail(str(error))
    others = [*trainings("ppo", 10), *trainings("sac", 10), "rule_based", "rule_based_fair", "rule_based_unlit"]
    assert blind > max(mean(agent, 10) for agent in others)
    assert abs(blind - mean("ppo_tuned", 10)) < 3.0


def sections(page: str) -> list[tuple[int, str]]:
    """Where each section of a page begins, and its text."""
    begins = [0, *(found.start() for found in re.finditer(r"^#+ ", page, re.MULTILINE))]
    return [(begin, page[begin:end]) for begin, end in itertools.pairwise([*begins, len(page)])]


@pytest.mark.parametrize("page", sorted(CLAIMS))
def test_a_score_of_a_task_with_splits_says_of_which_split_it_is(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Released results are of the test split: the section that quotes one says so, or the page does at its head."""
    asked: list[str] = []

    def noted(read: Callable[..., float]) -> Callable[..., float]:
        def call(*which: str) -> float:
            asked.append(which[0])
            return read(*which)

        return call

    for name in ("score", "of_spring", "lamp_hours"):
        monkeypatch.setattr(claims, name, noted(getattr(claims, name)))
    text, silent = text_of(ROOT / page), []
    head = text.partition("\n## ")[0]
    for words, compute in CLAIMS[page]:
        asked.clear()
        compute()
        if not asked or "of the test split" in head:
            continue
        for numbers in places(text, words):
            section = [part for begin, part in sections(text) if begin <= numbers[0][0]][-1]
            if not re.search(r"\btest\b", section):
                silent.append(f'{page}: "{words}" is a score on the test split. Say so in its section.')
    assert not silent, "\n".join(silent)
