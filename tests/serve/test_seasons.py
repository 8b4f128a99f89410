"""A served season is the season of the Gymnasium environment, bit for bit, whatever else is served; it shows what agents may see."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.episodes import read_episode
from glbench.evaluation.metrics import metrics_of
from glbench.serve.messages import SeasonRequest, StepRequest
from glbench.serve.sessions import RequestError, Sessions
from glbench.tasks import TaskSpec, get_task
from tests.serve.conftest import Client, served
from tests.support import write_day_task

SEED = 10_000_000_007
STILL = [0.0] * 6


def played_in_gymnasium(split: str, actions: np.ndarray, steps: list[int]) -> tuple[list[bytes], list[float]]:
    """Observations and rewards of the registered environment, each action held for so many steps."""
    env = gymnasium.make("glbench:glbench/Spring-v1", split=split, overrides={"weather.days": 2})
    observation, _ = env.reset(seed=SEED)
    observations, rewards = [observation.tobytes()], []
    for action, times in zip(actions, steps, strict=True):
        total = 0.0
        for _ in range(times):
            observation, reward, *_ = env.step(action)
            total += reward
        observations.append(observation.tobytes())
        rewards.append(total)
    return observations, rewards


@pytest.mark.parametrize("split", ["training", "validation"])
def test_seed_and_actions_give_the_bits_of_the_gymnasium_environment(client: Client, task: TaskSpec, split: str) -> None:
    names = [action.name for action in task.actions]
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (12, 6)).astype(np.float32)
    steps = [1, 4, 1, 96, 2, 1, 1, 7, 1, 1, 30, 1]
    started = client.ok("POST", "/sessions", {"split": split, "seed": SEED})
    observations, rewards = [started["vector"]], []
    for place, (action, times) in enumerate(zip(actions.tolist(), steps, strict=True)):
        entries: Any = action if place % 2 else dict(zip(names, action, strict=True))
        answer = client.ok("POST", f"/sessions/{started['session']}/step", {"action": entries, "steps": times})
        assert answer["steps_taken"] == times
        assert list(answer["observation"].values()) == answer["vector"]
        observations.append(answer["vector"])
        rewards.append(answer["reward"])
    expected = played_in_gymnasium(split, actions, steps)
    assert [np.array(vector, np.float32).tobytes() for vector in observations] == expected[0]
    assert rewards == expected[1]


def test_sessions_do_not_disturb_each_other_at_the_same_time(client: Client) -> None:
    def play(actor: int) -> tuple[list[list[float]], list[float]]:
        own, rng = Client(client.port), np.random.default_rng(actor)
        name = own.ok("POST", "/sessions", {"seed": SEED + actor % 2})["session"]
        answers = [own.ok("POST", f"/sessions/{name}/step", {"action": rng.uniform(-1, 1, 6).tolist()}) for _ in range(25)]
        own.ok("DELETE", f"/sessions/{name}")
        own.connection.close()
        return [answer["vector"] for answer in answers], [answer["reward"] for answer in answers]

    alone = [play(actor) for actor in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(play, range(4))) == alone
    assert alone[0] != alone[1]


def test_the_account_is_the_sum_of_the_steps_in_the_metrics_of_results(client: Client, session: str, task: TaskSpec) -> None:
    answers = [client.ok("POST", f"/sessions/{session}/step", {"action": STILL, "steps": steps}) for steps in (1, 5, 40)]
    account = client.ok("GET", f"/sessions/{session}/account")
    metrics = {metric.name: metric.unit for metric in metrics_of(task)}
    assert account["units"] == metrics
    assert account["step"] == 46
    for name in metrics:
        assert account["account"][name] == pytest.approx(sum(answer["account"][name] for answer in answers), abs=1e-12)
    assert account["account"]["hours_outside_limits"] > 0.0
    last = answers[-1]
    assert last["reward"] == pytest.approx(last["account"]["epi"] - last["account"]["penalty"], abs=1e-12)
    assert last["reward_unit"] == "EUR m-2"
    assert last["violations"]["air_temperature_low"] > 0.0


def test_the_forecast_is_the_part_of_the_observation_that_looks_ahead(client: Client, session: str, task: TaskSpec) -> None:
    forecast = client.ok("GET", f"/sessions/{session}/forecast")["forecast"]
    seen = client.ok("GET", f"/sessions/{session}/observation")
    columns = {
        f"{name}_in_{hours:g}h": value
        for name, ahead in forecast.items()
        for hours, value in zip(ahead["hours_ahead"], ahead["values"], strict=True)
    }
    assert columns == {name: value for name, value in seen["observation"].items() if name.endswith("h") and "_in_" in name}
    assert [forecast["global_radiation"][key] for key in ("unit", "meaning")] == ["W m-2", "sun and sky on a horizontal plane outside"]
    assert seen["units"] == {column.name: column.unit for column in task.observed()}


def test_time_advances_by_steps_only_and_is_that_of_the_greenhouse(client: Client, session: str) -> None:
    first = client.ok("GET", f"/sessions/{session}/observation")
    assert client.ok("GET", f"/sessions/{session}/observation") == first
    assert (first["time"]["clock"], first["step"]) == ("00:00", 0)
    later = client.ok("POST", f"/sessions/{session}/step", {"action": STILL, "steps": 25})
    assert (later["time"]["clock"], later["time"]["hour_of_day"], later["step"]) == ("06:15", 6.25, 25)
    assert later["time"]["date"] == first["time"]["date"]


def test_an_action_in_the_units_of_the_card_is_the_set_point_itself() -> None:
    task = get_task("SpringSetpoints-v1").replace({"weather.days": 1})
    sessions = Sessions(task)
    values = {one.name: one.lowest + 0.25 * (one.highest - one.lowest) for one in task.actions}
    by_value = sessions.start(SeasonRequest(seed=SEED)).step(StepRequest(values=values, steps=8))
    entries = [one.of(values[one.name]) for one in task.actions]
    by_action = sessions.start(SeasonRequest(seed=SEED)).step(StepRequest(action=entries, steps=8))
    assert by_value.vector == by_action.vector
    one = task.actions[0]
    with pytest.raises(RequestError, match=rf"outside its range, {one.lowest:g} to {one.highest:g} {one.unit}"):
        sessions.start(SeasonRequest()).step(StepRequest(values=values | {one.name: one.highest + 1.0}))


def test_the_card_has_every_column_with_unit_and_meaning_and_nothing_that_agents_may_not_know(client: Client, task: TaskSpec) -> None:
    card = client.ok("GET", "/task")
    assert [one["name"] for one in card["observations"]] == [column.name for column in task.observed()]
    assert all(one["unit"] and one["meaning"] for one in (*card["observations"], *card["actions"], *card["controls"]))
    assert card["limits"][0] == {"name": "air_temperature", "unit": "degC", "low": 15.0, "high": 34.0, "price_of_a_unit_and_hour": 0.0054}
    assert {one["name"]: one["price"] for one in card["ledger"]}["cost_heat"] == 0.09
    assert (card["day"]["steps"], card["day"]["step_minutes"], card["day"]["clock"]) == (96, 15.0, "Europe/Amsterdam")
    text = json.dumps(card)
    assert str(task.evaluation.first_seed) not in text
    assert "salt" not in text
    assert not {str(year) for year in (2008, 2009, 2010, 2011, 2012)} & set(text.replace('"', " ").split())


def test_what_is_observed_is_the_sensors_reading_and_nothing_shows_the_true_state(client: Client, session: str, task: TaskSpec) -> None:
    answer = client.ok("POST", f"/sessions/{session}/step", {"action": STILL})
    sessions = Sessions(task)
    twin = sessions.start(SeasonRequest(seed=SEED))
    twin.step(StepRequest(action=STILL))
    truth = {*twin.simulation.x[0].tolist(), *twin.simulation.air[:, 0].tolist()} - {0.0}
    numbers = {*answer["vector"], *answer["account"].values(), *answer["violations"].values()}
    assert answer["observation"]["air_temperature"] != pytest.approx(twin.simulation.air[0, 0], abs=1e-6)
    assert not truth & numbers


def test_a_finished_season_is_over_and_its_record_can_be_read(client: Client, session: str, task: TaskSpec, tmp_path: Path) -> None:
    address = f"/sessions/{session}"
    status, refused = client.call("GET", f"{address}/episode")
    assert (status, "not over" in refused["error"]["what"]) == (409, True)
    client.ok("POST", f"{address}/step", {"action": [0.1] * 6, "steps": 96})
    last = client.ok("POST", f"{address}/step", {"action": [-0.1] * 6, "steps": 95})
    assert (last["steps_taken"], last["terminated"]) == (95, False)
    end = client.ok("POST", f"{address}/step", {"action": STILL, "steps": 50})
    assert (end["steps_taken"], end["terminated"], end["step"]) == (1, True, task.steps)
    status, refused = client.call("POST", f"{address}/step", {"action": STILL})
    assert (status, refused["error"]["what"]) == (409, f"The season of this session is over after {task.steps} steps.")
    status, content = client.raw("GET", f"/v1{address}/episode")
    (tmp_path / "season.mcap").write_bytes(content)
    episode = read_episode(tmp_path / "season.mcap")
    account = client.ok("GET", f"{address}/account")["account"]
    assert (status, episode.complete, episode.steps, episode.run.seed) == (200, True, task.steps, SEED)
    assert float(np.add.reduce(episode["reward"])) == pytest.approx(account["reward"], abs=1e-12)
    assert episode["action_uVent"].tolist() == [0.1] * 96 + [-0.1] * 95 + [0.0]
    again = client.ok("POST", f"{address}/reset", {"seed": SEED})
    assert (again["step"], again["terminated"], again["session"]) == (0, False, session)


def test_seasons_are_written_when_they_are_closed_replaced_idle_or_the_server_ends(task: TaskSpec, tmp_path: Path) -> None:
    now = [0.0]
    sessions = Sessions(task, folder=tmp_path / "seasons", idle_minutes=1.0, clock=lambda: now[0])
    act = StepRequest(action=STILL, steps=3)
    closing, replaced, idle, open_at_end, untouched = (sessions.start(SeasonRequest(seed=SEED)) for _ in range(5))
    for session in (closing, replaced, idle, open_at_end):
        session.step(act)
    first = sessions.close(closing.name).episode
    assert first == str(tmp_path / "seasons" / f"{task.short_id}-training-seed-{SEED}-1.mcap")
    sessions.start(SeasonRequest(), replaced.name)
    now[0] = 50.0
    for session in (open_at_end, untouched):
        sessions.get(session.name)
    now[0] = 70.0
    assert sessions.health().sessions == 2
    with pytest.raises(RequestError, match="idle for 1 min"):
        sessions.get(idle.name)
    sessions.close_all()
    assert sessions.at_end == 2
    episodes = [read_episode(path) for path in sorted((tmp_path / "seasons").iterdir())]
    assert [episode.steps for episode in episodes] == [3, 3, 3, 3]


def test_no_season_is_lost_where_its_episode_cannot_be_written(task: TaskSpec, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    now, folder = [0.0], tmp_path / "seasons"
    sessions = Sessions(task, folder=folder, idle_minutes=1.0, clock=lambda: now[0])
    session, other = (sessions.start(SeasonRequest(seed=SEED)) for _ in range(2))
    for one in (session, other):
        one.step(StepRequest(action=STILL, steps=3))
    folder.write_text("a file where the folder should be", encoding="utf-8")
    now[0] = 70.0
    assert sessions.health().sessions == 2  # asked by somebody else, who is told nothing of it
    assert f"Session {session.name} stays open: " in caplog.text
    sessions.close_all()
    assert (sessions.at_end, sessions.unsaved) == (2, 2)
    folder.unlink()
    now[0] = 140.0
    assert sessions.health().sessions == 0
    assert [read_episode(path).steps for path in folder.iterdir()] == [3, 3]


def test_a_part_of_a_season_can_be_viewed(task: TaskSpec, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed (extra 'view')")
    from glbench.episodes.rerun_recording import provenance_words, save_recording, shown_of

    sessions = Sessions(task, folder=tmp_path)
    session = sessions.start(SeasonRequest(seed=SEED))
    session.step(StepRequest(action=STILL, steps=96))
    episodes = [read_episode(Path(sessions.close(session.name).episode or ""))]
    save_recording(shown_of(episodes), tmp_path / "day.rrd", provenance_words(episodes))
    assert (tmp_path / "day.rrd").stat().st_size > 10_000


def test_a_step_that_cannot_be_simulated_ends_the_season_in_words(task: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Sessions(task).start(SeasonRequest(seed=SEED))
    session.step(StepRequest(action=STILL))
    environments = session.simulation._environments
    environments.x[:] = np.nan
    answer = session.step(StepRequest(action=STILL, steps=5))
    assert (answer.terminated, answer.steps_taken) == (True, 1)
    assert answer.failure
    assert answer.reward == task.evaluation.failed_step.reward
    episode = session.episode()
    assert (episode.run.status, episode.steps, episode.run.actions) == ("simulation_failed", 1, 2)


def test_seeds_are_counted_up_and_never_those_of_scored_runs(task: TaskSpec) -> None:
    sessions = Sessions(task)
    assert [sessions.start(SeasonRequest()).seed for _ in range(3)] == [10_000_000_000, 10_000_000_001, 10_000_000_002]


def test_tasks_without_a_training_split_are_served_as_previews_and_tasks_without_splits_whole(tmp_path: Path) -> None:
    assert Sessions(get_task("Transfer-Miami-v1")).splits == ("preview",)
    assert Sessions(get_task(write_day_task(tmp_path))).splits == ("training",)
    session = Sessions(get_task(write_day_task(tmp_path))).start(SeasonRequest(split="training"))
    answer = session.step(StepRequest(action=STILL, steps=24))
    assert (answer.terminated, answer.reward_unit) == (True, "-")
    assert session.forecast().forecast == {}


def test_the_limit_on_sessions_is_said_and_a_closed_session_makes_room(task: TaskSpec) -> None:
    with served(Sessions(task, most=2)) as client:
        first, _ = (client.ok("POST", "/sessions") for _ in range(2))
        status, refused = client.call("POST", "/sessions")
        assert (status, refused["error"]["what"]) == (429, "2 sessions are open, which is the limit.")
        assert client.ok("GET", "/health")["sessions"] == 2
        address = f"/sessions/{first['session']}"
        assert client.ok("GET", f"{address}/account") == client.ok("DELETE", address)
        client.ok("POST", "/sessions")
