"""The estimator is a Kalman filter where the model is linear, finds what is hidden, and is better than replay and readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glbench.control import Climatology, Outlook, Scenario, StateEstimator, air_of, delivery, estimator
from glbench.env import Simulation, scenario, weather_pool
from glbench.env.air import AIR
from glbench.errors import ShapeError, StepError, TaskError
from glbench.kernel import Kernel, available
from glbench.model import paper, register_model
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.spreads import read_spread
from tests.control.watched import Floats, Watched, climatology, estimates, short, watch, watched
from tests.tasks.toy import TASK as TOY_TASK
from tests.tasks.toy import Toy

pytestmark = pytest.mark.skipif("compiled" not in available(), reason="no compiled kernel here")

A_DAY = 96


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskSpec:
    monkeypatch.setattr(paper, "_MODELS", dict(paper._MODELS))
    register_model(Toy())
    (tmp_path / "toy.toml").write_text(TOY_TASK, encoding="utf-8")
    return get_task(tmp_path / "toy.toml")


def test_with_a_linear_model_it_is_the_kalman_filter_of_the_textbook(toy: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimator, "ROUNDING", 1e-2)
    monkeypatch.setattr(estimator, "MODEL_ERROR", 2e-2)
    monkeypatch.setattr(estimator, "START_ERROR", 0.3)
    rng, names = np.random.default_rng(1), [column.name for column in toy.observed()]
    weather, start = toy.disturbances().values, np.array([0.1, 5.0])
    rate, tap = toy.parameters()
    known = StateEstimator(toy)
    x, mean, spread = start * [1.2, 0.7], start, np.diag((0.3 * start) ** 2)
    h = np.array([[1000.0, 0.0]])
    for k in range(40):
        controls = np.array([[0.5 * (k % 3)]]) / 1.0
        if k > 0:
            d = weather[k - 1]
            # dm/dt = a w, dw/dt = tap u - a w with a = rate iGlob / 500.
            a, hour = rate * d[0] / 500.0, 3600.0
            left = np.exp(-a * hour)
            f = np.array([[1.0, 1.0 - left], [0.0, left]])
            inflow = tap * controls[0, 0]
            added = inflow * (1.0 - left) / a if a > 0.0 else inflow * hour
            x, mean = (f @ before + [inflow * hour - added, added] for before in (x, mean))
            spread = f @ spread @ f.T + np.diag((2e-2 * start) ** 2)
        reading = h @ x * (1.0 + 0.01 * rng.normal())
        noise = (1e-2 * reading) ** 2
        gain = spread @ h.T @ np.linalg.inv(h @ spread @ h.T + noise)
        mean, spread = mean + gain @ (reading - h @ mean), (np.eye(2) - gain @ h) @ spread
        seen = np.zeros((1, len(names)))
        seen[0, names.index("mass")] = reading[0]
        found = known.update(seen, weather[max(k - 1, 0)][None], controls)
        np.testing.assert_allclose(found[0], mean, rtol=2e-5)
        np.testing.assert_allclose(known.deviations[0], np.sqrt(np.diag(spread)), rtol=2e-4)


def test_without_noise_it_finds_a_start_that_nobody_told() -> None:
    task = short("SpringMismatch-v1").replace({"id": "my/Known-v1", "scenario.parameters": []})
    given = watch(task, 2)
    known, found = StateEstimator(task), []
    known.reset(2)
    known.update(given.seen[0], given.d[:, 0])
    first = known.states
    found += [known.update(given.seen[k + 1], given.d[:, k]) for k in range(task.steps)]
    leaf = task.scenario.start_groups[0].states[0]
    place = task.model_value.state_index(leaf)
    assert np.abs(np.log(first[:, place] / given.x[0][:, place])).min() > 0.02
    assert np.abs(found[-1][:, place] / given.x[-1][:, place] - 1.0).max() < 0.005
    true, ours = (air_of(task.model_value, x).values[-A_DAY:] for x in (given.x, np.array(found)))
    assert (np.abs(true - ours).max(axis=(0, 1)) < [0.05, 2.0, 0.5]).all()


def errors(given: Watched, states: Floats) -> Floats:
    """Root mean square errors of the air after the first day ``(3,)``."""
    true, ours = (air_of(given.task.model_value, x).values[A_DAY:] for x in (given.x, states))
    return np.asarray(np.sqrt(np.mean((ours - true) ** 2, axis=(0, 1))))


def replayed(given: Watched, past: Floats) -> Floats:
    """The nominal model with the controls and the weather that the filter knew."""
    kernel = Kernel(given.task.model_value, given.task.step_seconds, preset="fast")
    x, found = np.array([given.task.start_state(row) for row in past[0]]), []
    for u, d in zip(given.u, past, strict=True):
        x = kernel.step(x, u, d, given.parameters)
        found.append(x)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("task_id", "share"), [("Spring-v1", 0.5), ("Lettuce-v1", 0.8)])
def test_where_sensors_err_it_is_better_than_replay_and_readings(task_id: str, share: float) -> None:
    given = watched(task_id)
    found, past = estimates(given, climatology(task_id))
    names = [column.name for column in given.task.observed()]
    true = air_of(given.task.model_value, given.x).values[A_DAY:]
    readings = given.seen[1 + A_DAY :][..., [names.index(name) for name in AIR]]
    raw = np.sqrt(np.mean((readings - true) ** 2, axis=(0, 1)))
    ours, replay = errors(given, found), errors(given, replayed(given, past))
    assert (ours < share * raw).all()
    assert (ours < share * replay).all()


@pytest.mark.slow
@pytest.mark.parametrize("task_id", ["SpringMismatch-v1", "Schiphol2010-Delta10-v1"])
def test_where_readings_are_right_it_finds_what_is_not_shown(task_id: str) -> None:
    given = watched(task_id)
    found, past = estimates(given, climatology(task_id))
    hidden = [place for place in range(given.x.shape[2]) if not _meter(given, place)]
    replay = replayed(given, past)
    ours, theirs = (np.sqrt(np.mean((x[A_DAY:, :, hidden] - given.x[A_DAY:, :, hidden]) ** 2, axis=(0, 1))) for x in (found, replay))
    assert (ours <= theirs).mean() > 0.9
    assert np.median(ours[theirs > 0.0] / theirs[theirs > 0.0]) < 0.3


def _meter(given: Watched, place: int) -> bool:
    """States that nothing depends on, or that stand still."""
    return bool(given.x[0, 0, place] == 0.0 or np.ptp(given.x[:, 0, place]) == 0.0)


def test_a_run_has_the_same_bits_alone_and_in_a_batch() -> None:
    given = watched("Spring-v1", 2)
    part = given._replace(seen=given.seen[:40], x=given.x[:39])
    both, _ = estimates(part, climatology("Spring-v1"))
    for run in range(2):
        alone, _ = estimates(part, climatology("Spring-v1"), slice(run, run + 1))
        assert alone[:, 0].tobytes() == both[:, run].tobytes()


def test_it_never_looks_at_weather_or_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    given, climate = watched("Spring-v1"), climatology("Spring-v1")
    part = given._replace(seen=given.seen[:30], x=given.x[:29])
    expected, _ = estimates(part, climate)

    def hidden(*_: object, **__: object) -> None:
        pytest.fail("the truth was asked for")

    monkeypatch.setattr(scenario.RunScenarios, "__init__", hidden)
    monkeypatch.setattr(weather_pool, "_make_pool", hidden)
    monkeypatch.setattr(weather_pool, "_shared_pool", hidden)
    monkeypatch.setattr(Simulation, "__init__", hidden)
    monkeypatch.setattr(TaskSpec, "record", hidden)
    monkeypatch.setattr(TaskSpec, "disturbances", hidden)
    found, _ = estimates(part, climate)
    assert found.tobytes() == expected.tobytes()


def test_a_sensor_that_hangs_is_left_out() -> None:
    given = watched("Spring-v1", 1)
    place = [column.name for column in given.task.observed()].index("air_temperature")
    hung = given.seen[:60].copy()
    hung[40:, :, place] = hung[39, :, place]
    climate = climatology("Spring-v1")
    found, _ = estimates(given._replace(seen=hung), climate)
    unseen = given.seen[:60].copy()
    rng = np.random.default_rng(0)
    unseen[40:, :, place] = 60.0 + rng.uniform(size=(20, 1))  # as wrong, and believed
    misled, _ = estimates(given._replace(seen=unseen), climate)
    true = air_of(given.task.model_value, given.x[:59]).values[..., 0]
    ours, theirs = (np.abs(air_of(given.task.model_value, x).values[..., 0] - true)[40:].max() for x in (found, misled))
    assert ours < 0.5 < theirs


def test_a_missing_reading_is_left_out_for_its_run() -> None:
    """As one of a sensor that hangs, to the bit; the other run does not notice."""
    given, climate = watched("Spring-v1"), climatology("Spring-v1")
    names = [column.name for column in given.task.observed()]
    place = names.index("air_temperature")
    hung, gone = given.seen[:60].copy(), given.seen[:60].copy()
    hung[40:50, 1, place], gone[40:50, 1, place] = hung[39, 1, place], np.nan
    whole, as_hung, found = (estimates(given._replace(seen=seen), climate)[0] for seen in (given.seen[:60], hung, gone))
    assert found[:, 0].tobytes() == whole[:, 0].tobytes()
    assert found[:, 1].tobytes() == as_hung[:, 1].tobytes() != whole[:, 1].tobytes()

    # A column without a sensor, and all of them: the model goes on by itself.
    for columns in ([names.index("fruit_dry_mass")], list(range(names.index("sin_hour_of_day")))):
        gone = given.seen[:60].copy()
        gone[40:, 1, columns] = np.nan
        found, _ = estimates(given._replace(seen=gone), climate)
        assert found[:, 0].tobytes() == whole[:, 0].tobytes()
        assert np.isfinite(found).all()
        true, ours = (air_of(given.task.model_value, x[39:59, 1]).values for x in (given.x, found))
        assert np.abs(true - ours)[:, 0].max() < 2.0


def test_a_sample_counts_once_and_with_its_noise() -> None:
    task = short("SpringMismatch-v1").replace({"id": "my/Sampled-v1", "samples": {"crop": {"every_days": 1, "noise": 0.06}}})
    given, names = watch(task, 2), [column.name for column in task.observed()]
    sampled, fruit = [names.index(column.name) for column in task.observed_by("crop")], task.model_value.state_index("cFruit")
    shown, once, spreads = StateEstimator(task), StateEstimator(task), []
    shown.reset(2)
    once.reset(2)
    for k in range(A_DAY + 3):
        seen, weather = given.seen[k].copy(), given.d[:, max(k - 1, 0)]
        if k % A_DAY:  # between two samples
            seen[:, sampled] = np.nan
        assert shown.update(given.seen[k], weather).tobytes() == once.update(seen, weather).tobytes()
        spreads.append(shown.deviations[:, fruit])
    size, start = task.start_state(given.d[0, 0])[fruit], task.scenario.start_groups[0]
    before = np.hypot(start.half_width / np.sqrt(3.0), estimator.START_ERROR) * size
    noise = 0.06e6 * given.seen[0][:, names.index("fruit_dry_mass")].astype(float)
    np.testing.assert_allclose(spreads[0], (before**-2 + noise**-2) ** -0.5, rtol=1e-3)
    falls = (np.diff(spreads, axis=0) < -0.1 * spreads[0]).all(axis=1)
    assert np.flatnonzero(falls).tolist() == [A_DAY - 1]


def test_a_reading_that_cannot_be_used_is_named() -> None:
    given = watched("Spring-v1", 2)
    names = [column.name for column in given.task.observed()]
    known, seen = StateEstimator(given.task), given.seen[1].copy()
    known.reset(2)
    known.update(given.seen[0], given.d[:, 0])
    seen[1, names.index("vents")] = np.nan
    with pytest.raises(TaskError, match=r"'vents' in row 1 .* is missing \(NaN\)\. Say .* controls=\.\.\."):
        known.update(seen, given.d[:, 0])
    assert np.isfinite(known.update(seen, given.d[:, 0], given.u[0])).all()
    seen[0, names.index("co2")] = -np.inf
    with pytest.raises(TaskError, match=r"'co2' in row 0 .* is infinite"):
        known.update(seen, given.d[:, 0], given.u[0])


def test_a_step_that_fails_leaves_its_run_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    given = watched("Spring-v1")
    known = StateEstimator(given.task)
    known.reset(2)
    for seen in given.seen[:3]:
        known.update(seen, given.d[:, 0])
    linearise = known.kernel.linearise

    def fails(x: Floats, *others: Floats, **options: object) -> object:
        if (x[:, 0] == known.states[1, 0]).any():
            raise StepError("too stiff")
        return linearise(x, *others, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(known.kernel, "linearise", fails)
    before = known.states
    after = known.update(given.seen[3], given.d[:, 2])
    hidden = known.task.model_value.state_index("tSo3")
    assert after[1, hidden] == pytest.approx(before[1, hidden], rel=1e-3)
    assert np.isfinite(after).all()


@pytest.mark.parametrize("how", ["step fails", "not finite"])
def test_a_run_that_is_lost_starts_over_from_what_the_nominal_model_made_of_its_weather(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    given = watched("Spring-v1")
    plain, known = StateEstimator(given.task), StateEstimator(given.task, restart=True)
    plain.reset(2), known.reset(2)
    for step, seen in enumerate(given.seen[:12]):
        d = given.d[:, max(step - 1, 0)]
        assert plain.update(seen, d).tobytes() == known.update(seen, d).tobytes(), "as long as nothing is lost"
    x, p = np.array([given.task.start_state(d) for d in given.d[:, 0]]), given.task.parameters()
    for step in range(12):
        x = known.kernel.step(x, given.u[step], given.d[:, step], p)
    linearise, lost = known.kernel.linearise, known.states[1, 0]

    def fails(states: Floats, *others: Floats, **options: object) -> object:
        if (states[:, 0] == lost).any():
            raise StepError("too stiff")
        return linearise(states, *others, **options)  # type: ignore[arg-type]

    if how == "step fails":
        monkeypatch.setattr(known.kernel, "linearise", fails)
    else:
        known._covariance[1] = np.nan
    after, other = known.update(given.seen[12], given.d[:, 11]), plain.update(given.seen[12], given.d[:, 11])
    hidden = given.task.model_value.state_index("tSo5")
    assert after[1, hidden] == pytest.approx(x[1, hidden], rel=1e-6)
    assert np.isfinite(after).all()
    assert after[0].tobytes() == other[0].tobytes()
    assert after[1].tobytes() != other[1].tobytes()


def test_what_does_not_fit_is_refused() -> None:
    given = watched("Spring-v1")
    known = StateEstimator(given.task)
    known.reset(2)
    with pytest.raises(TaskError, match=r"shape of the observations of my/Short-v1: expected \(2, 50\), .* got \(1, 50\)"):
        known.update(given.seen[0, :1], given.d[:, 0])
    with pytest.raises(ShapeError, match=r"shape of the disturbances of my/Short-v1: expected \(2, 10\), got \(1, 10\)"):
        known.update(given.seen[0], given.d[:1, 0])
    outlook = Outlook(given.task, climatology("Spring-v1"))
    outlook.reset(2)
    with pytest.raises(ShapeError, match=r"got \(2, 0\); call outlook\.update\(observations\) first"):
        known.update(given.seen[0], outlook.past)
    blind = short("Spring-v1").replace({"id": "my/Blind-v1", "sensors": None, "observation": {"modules": ["time"], "forecast": None}})
    with pytest.raises(TaskError, match="nothing of the states"):
        StateEstimator(blind)
    idle = short("Spring-v1").replace({"id": "my/Idle-v1", "observation": {"modules": ["indoor_climate"], "forecast": None}})
    known = StateEstimator(idle)
    seen = given.seen[0, :1, : len(idle.observed())]
    known.update(seen, given.d[:1, 0])
    with pytest.raises(TaskError, match="does not show its controls"):
        known.update(seen, given.d[:1, 0])
    assert np.isfinite(known.update(seen, given.d[:1, 0], np.zeros((1, 6)))).all()


@pytest.mark.slow
def test_what_it_finds_of_the_sky_improves_the_outlook() -> None:
    """The temperature of the sky is seen by nobody. The error fades from hour to hour, and columns that are seen are left alone."""
    task = short("Schiphol2010-Delta10-v1")
    given, sky = watched("Schiphol2010-Delta10-v1"), task.model_value.disturbance_names.index("tSky")
    outlook, known = Outlook(task, climatology("Schiphol2010-Delta10-v1")), StateEstimator(task)
    outlook.reset(2)
    known.reset(2)
    errors = []
    for k in range(task.steps - 8):
        outlook.update(given.seen[k])
        known.update(given.seen[k], outlook.past)
        off = known.weather_errors(8)
        assert not np.delete(off, sky, axis=2).any()
        assert np.abs(off[:, 1:, sky]).max() <= np.abs(off[:, 0, sky]).max()
        told = outlook.ahead(8).d[:, :, sky] - given.d[:, k : k + 8, sky]
        errors.append([told, told + off[:, :, sky]])
    without, corrected = np.sqrt(np.mean(np.square(errors[24:]), axis=(0, 2)))
    assert corrected[0] < 0.6 * without[0]
    assert (corrected < without).all()


FAULTS = {"uBoil": {"fails": {"days_between": 0.5, "hours": 6.0}}, "uVent": {"sticks": {"days_between": 0.5, "hours": 6.0}}}


def faulty(actuators: dict[str, object], days: int) -> TaskSpec:
    return get_task("Spring-v1").chosen_on.replace({"id": "my/Faults-v1", "weather.days": days, "actuators": actuators})


def test_it_finds_what_actuators_deliver_that_nobody_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A filter that expects no faults is misled by them: in the air, and in what is delivered."""
    given = watch(faulty(FAULTS, 2), 2)
    places = [0, 3]

    def off(given: Watched) -> tuple[Floats, Floats]:
        outlook, known, air, delivered = Outlook(given.task, climatology("Spring-v1")), StateEstimator(given.task), [], []
        outlook.reset(2)
        known.reset(2)
        for seen in given.seen:
            outlook.update(seen)
            air.append(air_of(given.task.model_value, known.update(seen, outlook.past)).values)
            delivered.append(known.controls[:, places])
        errors = np.array(air[1:]) - air_of(given.task.model_value, given.x).values, np.array(delivered[1:]) - given.u[:, :, places]
        return tuple(np.sqrt(np.mean(error**2, axis=(0, 1))) for error in errors)  # type: ignore[return-value]

    air, delivered = off(given)
    monkeypatch.setattr(delivery, "VARIANCE", dict.fromkeys(delivery.VARIANCE, 0.0))
    misled, expected = off(given)
    assert (air < 0.2 * misled).all()
    assert air[0] < 0.3
    assert (delivered < 0.6 * expected).all()


def test_a_control_that_is_shut_leaves_the_covariances_finite() -> None:
    """A screen that is never drawn, at any of its steps."""
    given = watch(faulty({"uThScr": {"shortfall": 0.1, "sticks": {"days_between": 5.0, "hours": 6.0}}}, 1), 2, shut=(2,))
    known = StateEstimator(given.task)
    known.reset(2)
    assert not given.u[..., 2].any()
    for k, seen in enumerate(given.seen):
        known.update(seen, given.d[:, max(k - 1, 0)])
        assert np.isfinite(known._covariance).all()
    assert (known.deviations[:, given.task.model_value.state_index("tAir")] < 1.0).all()
    assert (known.controls[:, 2] < 0.05).all()


@pytest.mark.parametrize("slope", [1e40, -np.inf, np.nan])
def test_slopes_without_bound_are_left_out(slope: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as of the temperature of a screen that is not drawn: to the bit as if the control did not move that state."""
    given = watch(faulty({"uThScr": {"shortfall": 0.1}}, 1), 2)
    screen = given.task.model_value.state_index("tThScr")

    def estimated(value: float) -> tuple[Floats, Floats]:
        known = StateEstimator(given.task)
        known.reset(2)
        linearise = known.kernel.linearise

        def steep(*values: Floats, **options: object) -> object:
            step = linearise(*values, **options)  # type: ignore[arg-type]
            du = step.du.copy()
            du[:, screen, 2] = value
            return replace(step, du=du)

        with monkeypatch.context() as patch:
            patch.setattr(known.kernel, "linearise", steep)
            for k in range(8):
                known.update(given.seen[k], given.d[:, max(k - 1, 0)])
        return known.states, known.deviations

    for one, other in zip(estimated(slope), estimated(0.0), strict=True):
        assert one.tobytes() == other.tobytes()
        assert np.isfinite(one).all()


def test_it_finds_how_far_sensors_outside_are_off() -> None:
    """A thermometer outside that reads 0.8 K too much or 0.6 K too little, and a pyranometer at 0.85 or 1 times the radiation."""
    plain = get_task("Spring-v1").chosen_on.replace({"id": "my/Outside-v1", "weather.days": 3, "scenario.parameters": []})
    sensors = {"outdoor_temperature": {"bias": {"value": 0.5, "unit": "degC"}}, "global_radiation": {"scale": {"low": 0.85, "high": 1.0}}}
    given, task = watch(plain, 2), plain.replace({"id": "my/Sensors-v1", "outdoor_sensors": sensors})
    names, weather = [column.name for column in task.observed()], task.model_value.disturbance_names
    seen, bias, scale = given.seen.copy(), np.array([0.8, -0.6], np.float32), np.array([0.85, 1.0], np.float32)
    seen[..., names.index("outdoor_temperature")] += bias
    seen[..., names.index("global_radiation")] *= scale
    outlook, known, found = Outlook(task, climatology("Spring-v1")), StateEstimator(task), []
    outlook.reset(2)
    known.reset(2)
    for row in seen:
        outlook.update(row)
        known.update(row, outlook.past)
        found.append(known.weather_errors(2, np.ones((2, 2, len(weather)))))
    assert (found[0] == 0.0).all()
    errors = np.mean(found[-A_DAY:], axis=0)
    np.testing.assert_allclose(errors[:, 0, weather.index("tOut")], -bias, atol=0.3)
    wanted = 0.925 / scale - 1.0  # of which the filter finds some half in three days
    assert (np.abs(errors[:, 0, weather.index("iGlob")] - wanted) < 0.7 * np.abs(wanted)).all()
    np.testing.assert_allclose(errors[:, 1, weather.index("tOut")], errors[:, 0, weather.index("tOut")], rtol=0.01)  # they stay for the run
    assert (known.weather_errors(2)[..., weather.index("iGlob")] == 0.0).all()


MEASURED = [{"name": "house", "spread": "measured", "factor": 2.0, "redraw": "episode"}]


def measured(days: int) -> TaskSpec:
    """Houses that differ twice as much as measured ones, and nothing else."""
    return get_task("Spring-v1").chosen_on.replace({"id": "my/Houses-v1", "weather.days": days, "scenario.parameters": MEASURED})


def test_houses_of_a_spread_are_estimated_between_their_limits() -> None:
    """The smallest and the largest multiplier of each parameter; those of one draw have one deviation."""
    task = measured(1)
    known, nominal, names = StateEstimator(task)._episode, task.parameters(), task.model_value.parameter_names
    spread = read_spread("measured", 2.0)
    assert len(known.spread) == len({row.draw for row in spread.rows}) < len(spread.rows)
    places = [names.index(row.parameter) for row in spread.rows]
    ends = known.complete(np.array([known.low, known.high]))[:, places] / nominal[places]
    np.testing.assert_allclose(ends, np.array([spread.limits()[row.parameter] for row in spread.rows]).T, rtol=1e-12)
    assert ends[1, [row.parameter for row in spread.rows].index("rSMin")] > 2.0  # more than twice the nominal value


def test_derivatives_by_a_spread_are_those_of_its_house() -> None:
    known = StateEstimator(measured(1))._episode
    house = np.random.default_rng(3).uniform(known.low, known.high)[None]
    steps = 1e-5 * np.eye(len(known.spread))
    wanted = (known.complete(house + steps) - known.complete(house - steps)) / 2e-5
    names = get_task("Spring-v1").model_value.parameter_names
    wanted = wanted[:, [names.index(name) for name in known.names]].T
    np.testing.assert_allclose(known.along(np.eye(len(known.names))[None], house)[0], wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())


def test_a_house_far_from_the_nominal_one_is_estimated() -> None:
    """Two runs whose leaves are much tighter than those of the nominal house: what the air is, and how tight they are."""
    task = measured(4)
    place = task.model_value.parameter_names.index("rSMin")
    resistance = {seed: float(Scenario.of(task, seed).p[place]) for seed in range(10000, 10040)}
    tight = [seed for seed, value in resistance.items() if value > 1.7 * task.parameters()[place]][:2]
    given = watch(task, 2, seeds=tight)
    known, outlook, states = StateEstimator(task), Outlook(task, Climatology.of(task)), []
    known.reset(2)
    outlook.reset(2)
    for seen in given.seen:
        outlook.update(seen)
        states.append(known.update(seen, outlook.past))
    assert (errors(given, np.array(states[1:])) < [0.1, 6.0, 1.2]).all()
    np.testing.assert_allclose(known.parameters[:, place], [resistance[seed] for seed in tight], rtol=0.15)
