"""The commands by which docs/maintain.md tells a host to run a round, in their order, on a tiny task."""

from __future__ import annotations

import hashlib
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.tasks import DEFAULT_TASK, read_round
from glbench.weather import load_weather, save_weather
from tests.cli.command_line import Answer, Command
from tests.evaluation.agent_files import agent_writer
from tests.rounds.tiny import write_tiny

PAGE = (Path(__file__).parents[2] / "docs" / "maintain.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"<!-- round: ([\w ,]+) -->\n```console\n(.*?)```", PAGE, re.DOTALL)

pytestmark = pytest.mark.skipif(why_no_sandbox() is not None, reason=str(why_no_sandbox()))


@pytest.fixture
def run(glbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> object:
    """Runs the commands of a block of the page in a folder of the host's, with the page's placeholders filled in."""
    here = tmp_path / "checkout"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    write_tiny(here)
    (here / "submissions").mkdir()
    agent_writer(here / "submissions")(name="anna")

    def of(block: str, **filled: str) -> list[Answer]:
        answers = []
        for line in block.strip().splitlines():
            words = shlex.split(line)
            assert words[0] == "glbench", line
            for placeholder, value in {DEFAULT_TASK: "tiny.toml", **filled}.items():
                words = [word.replace(placeholder, value) for word in words]
            answers.append(glbench(*words[1:]))
        return answers

    return of


def blocks(audience: str) -> list[str]:
    return [text for who, text in BLOCKS if who == audience]


def test_the_page_has_the_blocks_of_a_round() -> None:
    assert [who for who, _ in BLOCKS] == ["host", "host", "reader, before", "reader", "own weather"]


def test_a_host_and_a_reader_run_a_round_as_the_page_says(run: object, tmp_path: Path) -> None:
    assert callable(run)
    announce, evaluate = blocks("host")
    (made,) = run(announce)
    commitment = made.out.strip()
    assert made.code == 0
    filled = {"COMMITMENT": commitment, "FOLDER": commitment[:16]}

    answers = run(evaluate, **filled)
    assert [answer.code for answer in answers] == [0] * 4, [answer.err for answer in answers]
    results = sorted((tmp_path / "checkout" / "reports" / "rounds" / commitment[:16] / "results" / "Tiny-v1").glob("*.actions.mcap"))
    assert [file.name for file in results] == ["anna.actions.mcap", "rule_based.actions.mcap"]
    assert "anna" in answers[3].out
    assert not (tmp_path / "checkout" / "reports" / "results").exists()

    (before,) = run(blocks("reader, before")[0], **filled)
    assert before.code == 3
    assert before.out.count("sealed: cannot be verified") == 2
    assert "reproduced" not in before.out

    (tmp_path / "secret" / "round.toml").rename(tmp_path / "checkout" / "round.toml")  # published
    checked, verified = run(blocks("reader")[0], **filled)
    assert (checked.code, verified.code) == (0, 0)
    assert verified.out.count("the same bits") == 2


def test_a_host_seals_weather_of_his_own_as_the_page_says(run: object, tmp_path: Path) -> None:
    assert callable(run)
    record = load_weather("schiphol")
    imported, new = blocks("own weather")[0].strip().splitlines()
    assert imported.startswith("glbench weather import station.csv")
    save_weather(record, "station")  # stands for the import, whose page has tests of its own
    (made,) = run(new.replace("2019", "2009").replace("2020", "2010"))
    sealed = read_round(tmp_path / "secret" / "own.toml")
    assert made.code == 0, made.err
    assert made.out.strip() == sealed.commitment
    assert sealed.weather is not None
    assert (sealed.weather.digest, sealed.weather.years) == (record.digest, (2009, 2010))


def test_the_commitment_can_be_computed_without_glbench_as_the_page_says(run: object, tmp_path: Path) -> None:
    assert callable(run)
    (made,) = run(blocks("host")[0])
    sealed = read_round(tmp_path / "secret" / "round.toml")
    (command,) = re.findall(r"^(printf .* \| sha256sum)$", PAGE, re.MULTILINE)
    assert hashlib.sha256(b"glbench round 1\n" + sealed.salt.encode()).hexdigest() == made.out.strip()
    done = subprocess.run(["bash", "-c", command.replace("SALT", sealed.salt)], capture_output=True, text=True, check=True)
    assert done.stdout.split()[0] == made.out.strip()
