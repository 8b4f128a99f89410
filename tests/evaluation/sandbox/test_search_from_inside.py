"""Agents that search everything they can see for weather, plans, recordings, results and seeds, and one that would play what it finds."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from glbench.evaluation import TimeLimits, evaluate, prepare
from glbench.evaluation.sandbox import visible
from glbench.evaluation.sandbox.frames import Prints
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.sandbox.needles import shipped_needles
from tests.evaluation.sandbox.walking import sight_of, write_walker

PATIENT = TimeLimits(start=3000.0, step=60.0)


def found_inside(task: TaskSpec, folder: Path, leave_out: tuple[str, ...] = ()) -> tuple[list[tuple[str, str]], dict[str, int]]:
    """What a walker finds in its sandbox, as file and series, and how many files of what kind it looked at."""
    evaluation = prepare(task, write_walker(folder, shipped_needles(), leave_out), runs=1, sandbox="bubblewrap", limits=PATIENT)
    evaluation = dataclasses.replace(evaluation, prints=Prints(2**26))
    result = evaluation.run()
    assert result.summary.ok == 1, (result.runs[0].reason, evaluation.prints.text())
    found, looked = sight_of(evaluation.prints.text())
    return [tuple(one) for one in found], looked


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_nothing_that_is_visible_holds_what_no_agent_may_have(needs_sandbox: None, day_task: TaskSpec, tmp_path: Path) -> None:
    """It opens every file of the sandbox, wherever it is and whatever its name."""
    found, looked = found_inside(day_task, tmp_path)

    assert found == []
    assert looked["searched"] > 10_000


@pytest.mark.slow
def test_nothing_of_glbench_and_of_pvlib_that_is_visible_holds_it(
    needs_sandbox: None, day_task: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same without the system and the packages that have nothing to do with greenhouses; and the search would find what is planted."""
    planted = tmp_path / "site-packages"
    planted.mkdir()
    (planted / "seasons.bin").write_bytes((data_folder("weather") / "nrel_tmy2_12839_miami.parquet").read_bytes())
    (planted / "book.py").write_bytes((data_folder("baselines") / "recording" / "actions.npz").read_bytes())
    monkeypatch.syspath_prepend(str(planted))
    packages = [file for library in visible.libraries() for file in library.iterdir()]
    others = [str(file) for file in packages if not file.name.startswith(("glbench", "pvlib", "seasons", "book"))]
    base = [
        bound.outside
        for bound in visible._visible_files(set())
        if bound.outside not in visible.libraries() and bound.inside != visible.CODE / "glbench"
    ]
    found, looked = found_inside(day_task, tmp_path, (*others, *map(str, base)))

    assert {Path(file.partition("!")[0]).name for file, _ in found} == {"seasons.bin", "book.py"}
    assert {"air_temperature of miami", "actions of actions"} <= {series for _, series in found}
    assert looked["searched"] > 400


THIEF = """
def reset(self, task, n_runs):
    self.n, self.step, self.books = n_runs, 0, {}
    for place, folders, files in os.walk("/"):
        folders[:] = [folder for folder in folders if folder not in ("proc", "dev")]  # pipes wait for ever
        for name in files:
            try:
                book = dict(np.load(os.path.join(place, name)))
                plans = book["actions"][book["places"]].transpose(2, 0, 1)
                self.books[name] = book["low"] + plans / 2000.0 * (book["high"] - book["low"])
            except Exception:
                pass
    print("BOOKS", len(self.books))
    self.own = self.books.get(task.id.split("/")[1] + ".npz")

def act(self, observations):
    self.step += 1
    return np.zeros((self.n, 6)) if self.own is None else self.own[self.step - 1, : self.n]
"""
"""Opens every file as a book of plans, and plays the plan of each run, which it knows by its row."""


def test_a_thief_finds_the_plans_where_they_are(write_agent: AgentWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    """The agent of the next test is able: outside it earns what the best known plan earns, digit by digit."""
    thief = write_agent(THIEF.replace('walk("/")', f"walk({str(data_folder('baselines'))!r})"))
    task = get_task("Schiphol2010-Delta00-v1")
    stolen = evaluate(task, thief, runs=1)
    own = evaluate(task, "best_known", runs=1)

    assert stolen.runs[0].metrics["reward"] == pytest.approx(own.runs[0].metrics["reward"], rel=1e-9)


@pytest.mark.slow
def test_a_thief_finds_nothing_in_its_sandbox(needs_sandbox: None, write_agent: AgentWriter) -> None:
    task = get_task("Schiphol2010-Delta00-v1")
    evaluation = prepare(task, write_agent(THIEF), runs=1, sandbox="bubblewrap", limits=PATIENT)
    thief = evaluation.run()

    assert "BOOKS 0" in evaluation.prints.text()
    assert thief.summary.mean == evaluate(task, data_folder("submissions") / "do_nothing.py", runs=1).summary.mean
