"""Records, replay, proof and viewer of a task with an energy system and an engine that is off or on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from glbench.episodes import Episode, actions_path, episode_bytes, episode_path, episodes_folder, read_episode, read_log, replayed_episodes
from glbench.episodes.rerun_recording import card, shown_of
from glbench.evaluation import evaluate, result_path
from glbench.tasks import TaskSpec
from glbench.verification import verify
from tests.energy import energy_task

AGENT = """
import numpy as np

class Waves:
    def __init__(self, card):
        self.size = len(card.actions)

    def reset(self, task, n_runs):
        self.steps = 0

    def act(self, observations):
        self.steps += 1
        phases = np.arange(self.size) + observations[:, :1].astype(float)
        return 0.5 + 0.5 * np.sin(0.3 * self.steps + phases)

def make_agent(task):
    return Waves(task)
"""


@dataclass(frozen=True)
class Recorded:
    task: TaskSpec
    result: Path
    files: tuple[Path, ...]

    @property
    def episodes(self) -> list[Episode]:
        return [read_episode(file) for file in self.files]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Two recorded runs of a day."""
    folder = tmp_path_factory.mktemp("energy")
    agent = folder / "waves.py"
    agent.write_text(AGENT, encoding="utf-8")
    task = energy_task({"id": "test/Energy-v1", "evaluation.runs": 2})
    result = evaluate(task, agent, out=folder, sandbox="none", episodes="all")
    assert result.failed == ()
    path = result_path(folder, task.id, "waves")
    return Recorded(task, path, tuple(episode_path(episodes_folder(path), run.seed) for run in result.runs))


def test_a_record_has_the_buffer_and_what_was_burnt_bought_and_sold(recorded: Recorded) -> None:
    episode = recorded.episodes[0]
    groups = {group.name: group.names for group in episode.groups}
    assert {"eBuf", "sumHBufPipe", "sumHDumpOut"} < set(groups["state"])
    assert {"uChp", "uPipe"} < set(groups["controls"])
    assert np.allclose(episode["buffer_share"], episode["eBuf"] / 3.3 * 100.0, rtol=1e-12)
    ledger = {"gas_today": "gas", "power_bought_today": "electricity_bought", "power_sold_today": "electricity_sold"}
    day = episode["hour_of_day"][:-1] > 0.0  # the last step ends at midnight, where sums begin anew
    assert len(day) == 95
    for today, amount in ledger.items():
        assert np.allclose(episode[today][:-1], np.cumsum(episode[amount])[:-1], rtol=1e-9, atol=1e-12), today
        assert episode[amount].max() > 0.0
    assert np.allclose(1e-3 * episode["co2_bought_today"][:-1], np.cumsum(episode["co2_bought"])[:-1], rtol=1e-9)


def test_the_engine_of_a_record_is_off_or_between_its_loads(recorded: Recorded) -> None:
    for episode in recorded.episodes:
        load = episode["uChp"]
        assert set(np.round(load[(load > 0.0) & (load < 0.7)], 12)) == set()
        assert 0.0 < (load > 0.0).mean() < 1.0
        assert (np.abs(episode["action_uChp"] - load) > 0.1).any()  # what was asked for is another thing


def test_runs_are_replayed_and_reproduced_to_the_bit(recorded: Recorded) -> None:
    log = read_log(actions_path(recorded.result))
    for file, episode in zip(recorded.files, replayed_episodes(log.task().scored, log, range(2)), strict=True):
        assert episode_bytes(episode) == file.read_bytes()
    assert verify(recorded.result).exactness == "bits"


def test_the_viewer_has_a_page_of_energy(recorded: Recorded) -> None:
    shown = shown_of(recorded.episodes[:1])
    pages = {page.title: [curve.heading for curve in page.curves] for page in shown.signals.pages}
    assert pages["Energy and CO₂"][:7] == [
        "Heat in the buffer [MJ m⁻²]", "Buffer filled [%]", "Gas burnt since midnight [kWh m⁻²]",
        "Electricity bought since midnight [kWh m⁻²]", "Electricity sold since midnight [kWh m⁻²]",
        "CO₂ dosed from flue gas since midnight [g m⁻²]", "CO₂ bought since midnight [g m⁻²]",
    ]  # fmt: skip
    assert {"Boiler [%]", "Engine (combined heat and power) [%]", "Heating: buffer to pipes [%]"} <= set(pages["Controls"])
    assert "Boiler valve (heating) [%]" not in pages["Controls"]
    words = card(shown)
    assert "gas 0.0355 EUR/kWh" in words
    assert "starts of the engine 0.0005 EUR each" in words
    assert "electricity sold 0.04 to 0.09 EUR/kWh" in words
