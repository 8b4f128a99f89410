"""Saving survives a full disk and a kill at any place: never half a file, never a result with another one's record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from glbench.episodes import log_bytes, read_log
from glbench.episodes.header import definition_json
from glbench.errors import EpisodeError, GlbenchError
from glbench.evaluation import evaluate, load_result, prepare, saving
from glbench.tasks import TaskSpec
from glbench.verification import verify
from tests.evaluation.agent_files import GOOD, AgentWriter
from tests.support import lettuce_task

PLACE = Path("results") / "Day-v1"
OTHER = GOOD.replace("50.0", "40.0")


class KilledError(BaseException):
    """Stands for kill -9: nothing after it is done."""


def full(path: Path, _data: bytes) -> None:
    msg = f"Cannot write {path}: No space left on device."
    raise GlbenchError(msg)


def test_a_full_disk_leaves_the_earlier_result_with_its_record(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = evaluate(day_task, write_agent(), out=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(saving, "write_atomically", full)
        with pytest.raises(GlbenchError, match="No space left"):
            evaluate(day_task, write_agent(OTHER), out=tmp_path)
    stored = load_result(tmp_path / PLACE / "agent_under_test.json")
    assert stored == before
    assert stored.record is not None
    assert read_log(tmp_path / PLACE / stored.record.file).digest == stored.record.digest


@pytest.mark.parametrize("moment", ["before the result", "after the result"])
def test_a_kill_while_saving_is_mended_by_the_next_evaluation(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    agent = write_agent()
    evaluate(day_task, agent, out=tmp_path)
    agent = write_agent(OTHER)

    def killed(*_: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        if moment == "before the result":
            patch.setattr(saving, "save_result", killed)
        else:
            patch.setattr(Path, "replace", lambda self, target: killed() if self.suffix == ".waiting" else rename(self, target))
        with pytest.raises(KilledError):
            evaluate(day_task, agent, out=tmp_path)
    assert list((tmp_path / PLACE).glob(".*.waiting"))
    stored = prepare(day_task, agent, out=tmp_path).stored
    assert (stored is not None) == (moment == "after the result")
    assert list((tmp_path / PLACE).glob(".*.waiting")) == []
    result = evaluate(day_task, agent, out=tmp_path)
    assert result.record is not None
    assert read_log(tmp_path / PLACE / result.record.file).digest == result.record.digest


def test_a_waiting_record_of_an_unknown_model_is_removed(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent()
    evaluate(day_task, agent, out=tmp_path)
    (record,) = (tmp_path / PLACE).glob("*.actions.mcap")
    log = read_log(record)
    waiting = record.with_name(f".{record.name}.waiting")
    of_no_model = definition_json(lettuce_task()).replace(b"greenlight-lettuce", b"moonlight")
    waiting.write_bytes(log_bytes(replace(log, definition=of_no_model)))
    assert prepare(day_task, agent, out=tmp_path).stored is not None
    assert not waiting.exists()


def test_leftovers_of_killed_processes_are_removed(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    place = tmp_path / PLACE
    place.mkdir(parents=True)
    for name in (".agent_under_test.json.x1.partial", ".agent_under_test.actions.mcap.x2.partial", ".other.json.x.partial"):
        (place / name).touch()
    evaluate(day_task, write_agent(), out=tmp_path)
    assert [path.name for path in place.glob("*.partial")] == [".other.json.x.partial"], "that of another agent stays"


@pytest.mark.parametrize("why", ["never written", "of an earlier result", "cut"])
def test_a_profile_that_a_kill_kept_from_being_written_is_made_by_the_same_command(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path, why: str
) -> None:
    agent, place = write_agent(OTHER), tmp_path / PLACE / "agent_under_test.profile.json.gz"
    evaluate(day_task, agent, out=tmp_path)
    earlier = place.read_bytes()
    agent = write_agent()
    evaluate(day_task, agent, out=tmp_path)
    whole = place.read_bytes()
    if why == "never written":
        place.unlink()
    else:
        place.write_bytes(earlier if why == "of an earlier result" else whole[:-9])
    evaluate(day_task, agent, out=tmp_path, episodes="none")
    assert place.read_bytes() == whole


rename = Path.replace


def test_what_a_kill_left_beside_a_finished_result_goes_with_the_next_look_at_it(
    day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path
) -> None:
    """The result is there, so that nothing is evaluated any more; its checkpoint was not removed yet."""
    agent = write_agent()
    result = evaluate(day_task, agent, out=tmp_path)
    evaluation = prepare(day_task, agent, out=tmp_path)
    assert evaluation.stored is not None
    assert evaluation.folder is not None
    evaluation.folder.mkdir(parents=True)
    (evaluation.folder / "snapshot.npz").write_bytes(b"x")
    leftover = tmp_path / PLACE / ".agent_under_test.profile.json.gz.abc.partial"
    leftover.write_bytes(b"half")

    again = prepare(day_task, agent, out=tmp_path)
    assert again.stored == result == load_result(tmp_path / PLACE / "agent_under_test.json")
    assert not (tmp_path / ".partial").exists()
    assert not leftover.exists()


def test_episodes_of_another_agent_never_pass_for_those_of_a_result(day_task, write_agent, tmp_path, monkeypatch) -> None:
    agent = write_agent(GOOD)
    evaluate(day_task, agent, out=tmp_path, episodes="all")
    write_agent(OTHER)
    write = saving.write_atomically

    def killed_after_the_result(path: Path, data: bytes) -> None:
        if not path.name.endswith(".waiting"):
            raise KilledError
        write(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(saving, "write_atomically", killed_after_the_result)
        with pytest.raises(KilledError):
            evaluate(day_task, agent, out=tmp_path, episodes="all")
    evaluate(day_task, agent, out=tmp_path, episodes="all")
    path = tmp_path / PLACE / f"{agent.stem}.json"
    assert verify(path).outcome == "reproduced"

    first, second = evaluate(day_task, "rule_based", out=tmp_path), load_result(path)
    saving.make_episodes(("best",), first, path.with_name("rule_based.json"), day_task, tmp_path / "both")
    with pytest.raises(EpisodeError, match=r"is an episode of another evaluation\. Choose another folder with --to"):
        saving.make_episodes(("all",), second, path, day_task, tmp_path / "both")
