"""By construction: an agent in its sandbox finds no weather, no seeds, no simulator's data, no results and no other submissions."""

from __future__ import annotations

import ctypes
import dataclasses
import errno
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import glbench
from glbench.agents import identify, read_baseline
from glbench.errors import SubmissionError
from glbench.evaluation import TimeLimits
from glbench.evaluation.sandbox import bubblewrap, visible
from glbench.evaluation.sandbox.frames import Kind, Prints
from glbench.evaluation.sandbox.process import AgentProcess
from glbench.evaluation.sandbox.visible import libraries
from glbench.resources import data_folder
from glbench.tasks import task_card
from glbench.tasks.card import public_definition
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.sandbox.conftest import Prepare
from tests.evaluation.sandbox.content_search import Search
from tests.evaluation.sandbox.needles import weather_and_seeds
from tests.support import published_tasks

LOOK = """
def act(self, observations):
    if not self.calls:
        self.calls = 1
        self.look()
    return np.zeros((self.n, 6))
def look(self):
    import json
    {body}
    print("SEEN " + json.dumps(seen))
"""


def seen(write_agent: AgentWriter, sandboxed: Prepare, body: str) -> object:
    """What an agent found in ``seen`` after ``body``."""
    lines = body.strip("\n").replace("\n", "\n    ")
    evaluation = sandboxed(write_agent(LOOK.format(body=lines)), runs=1, limits=TimeLimits(step=60.0))
    evaluation = dataclasses.replace(evaluation, prints=Prints(2**24))
    result = evaluation.run()
    assert result.summary.ok == 1, result.runs[0].reason
    (line,) = [line for line in evaluation.prints.text().splitlines() if line.startswith("SEEN ")]
    return json.loads(line.removeprefix("SEEN "))


NAMES_OF_CODE = {path.name for path in Path(glbench.__file__).parent.rglob("*.py")}
"""Some templates of submissions have names that modules of the package have, too."""


def test_python_its_libraries_glbench_and_the_submission_are_there_and_nothing_else(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = """
seen = []
for place, folders, files in os.walk("/"):
    folders[:] = [f for f in folders if place != "/" or f not in ("proc", "usr")]
    seen += [os.path.join(place, f) for f in files]
"""
    files = seen(write_agent, sandboxed, body)
    assert isinstance(files, list)

    base = str(Path(sys.base_prefix).resolve())
    expected = ("/opt/glbench/", "/dev/", "/etc/ld.so", "/etc/alternatives/", "/nix/store/", base, *map(str, libraries()))
    assert "/opt/glbench/glbench/agents/loading.py" in files
    assert [file for file in files if not file.startswith(expected)] == ["/submission/agent_under_test.py"]
    for name in ("weather", "tasks", "reports/released/results", "submissions"):
        shipped = {item.name for item in data_folder(name).rglob("*") if item.is_file()}  # type: ignore[arg-type]
        assert shipped
        own = [file for file in files if file.startswith("/opt/glbench/")]
        assert not [file for file in own if Path(file).name in shipped - NAMES_OF_CODE]


@pytest.mark.parametrize("part_of_system", [False, True])
def test_data_among_the_libraries_are_covered(
    write_agent: AgentWriter, sandboxed: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part_of_system: bool
) -> None:
    """Of glbench, of pvlib, of other installations of Python, and of the user: in a virtual environment, or below /usr/local/lib."""
    lib = tmp_path / "usr" / "local" / "lib"
    library, other = (lib / f"python3.{minor}" / "site-packages" for minor in (11, 9))
    secrets = [
        library / "glbench" / "_data" / "weather" / "schiphol.parquet", library / "glbench_data" / "baselines" / "plans.npz",
        library / "pvlib" / "data" / "tmy.csv", other / "glbench_data" / "weather.csv", lib / "mine" / "weather" / "here.parquet",
        lib / "cache" / "other.so",
    ]  # fmt: skip
    for file in (*secrets, library / "useful.py", library / "pvlib" / "irradiance.py"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("", encoding="utf-8")
    if part_of_system:
        monkeypatch.setattr(visible, "SYSTEM", (*visible.SYSTEM, str(lib)))
    monkeypatch.setenv("GLBENCH_DATA", str(lib / "mine"))
    monkeypatch.setenv("GLBENCH_CACHE", str(lib / "cache"))
    monkeypatch.syspath_prepend(str(library))
    body = f"import useful\nseen = [os.path.join(p, f) for p, _, fs in os.walk({str(tmp_path)!r}) for f in fs]"

    found = seen(write_agent, sandboxed, body)
    assert isinstance(found, list)
    assert sorted(found) == [str(library / "pvlib" / "irradiance.py"), str(library / "useful.py")]
    identity = identify(write_agent())
    assert identity is not None
    assert [file for file in secrets if visible.is_visible(file, identity)] == []
    assert visible.is_visible(library / "useful.py", identity)


def test_a_checkout_in_a_folder_of_the_system_is_covered(monkeypatch: pytest.MonkeyPatch, write_agent: AgentWriter) -> None:
    root = Path(glbench.__file__).parents[1]
    monkeypatch.setattr(visible, "SYSTEM", (*visible.SYSTEM, str(root.parent)))
    identity = identify(write_agent())
    assert identity is not None
    hidden = ("tasks/lock.toml", "reports/mine/Spring-v1/anna.json", "runs/anna.actions.mcap", "submissions/my_agent.py", "docs/tasks.md")

    assert [name for name in hidden if visible.is_visible(root / name, identity)] == []
    assert visible.is_visible(root / "glbench" / "errors.py", identity)


@pytest.mark.parametrize(
    "body",
    [
        "from glbench.tasks import get_task; get_task('glbench/Schiphol2010-Delta10-v1')",
        "import gymnasium; gymnasium.make('glbench:glbench/Schiphol2010-Delta10-v1').reset(seed=666)",
        "from glbench.weather import get_weather; get_weather('schiphol')",
    ],
)
def test_glbench_itself_finds_no_task_and_no_weather(write_agent: AgentWriter, sandboxed: Prepare, body: str) -> None:
    found = seen(
        write_agent,
        sandboxed,
        f"""
try:
    {body}
    seen = "found"
except Exception as error:
    seen = type(error).__name__
""",
    )

    assert found in {"UnknownNameError", "NameNotFound", "NamespaceNotFound", "GlbenchError", "WeatherError", "TaskError", "ImportError"}


def test_the_model_can_be_used(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = "from glbench.model import PARAMETER_NAMES, rhs\nimport casadi\nseen = len(PARAMETER_NAMES)"

    assert seen(write_agent, sandboxed, body) == 208


def test_of_the_baselines_it_finds_the_rules_by_observations(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = """
from glbench.agents import baseline_names, read_baseline
seen = {name: read_baseline(name).digest for name in baseline_names()}
try:
    read_baseline("best_known")
except Exception as error:
    seen["error"] = str(error)
"""
    found = seen(write_agent, sandboxed, body)
    assert isinstance(found, dict)

    assert found.pop("error").startswith("There is no baseline 'best_known'.")
    names = ("grower", "rule_based_energy", "rule_based_fair", "rule_based_tuned")
    assert found == {name: read_baseline(name).digest for name in names}


def test_nothing_of_the_evaluation_is_in_its_memory(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = """
import gc
kinds = {"Simulation", "TaskSpec", "Evaluation", "RolloutLoop", "WeatherRecord", "Kernel"}
seen = sorted({type(o).__name__ for o in gc.get_objects()} & kinds)
seen += [name for name in sys.modules if name.startswith(("glbench.env", "glbench.weather", "glbench.kernel"))]
"""

    assert seen(write_agent, sandboxed, body) == []


def test_the_environment_is_fresh(write_agent: AgentWriter, sandboxed: Prepare, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "swordfish")
    body = """
seen = {"initial": [line.partition("=")[0] for line in open("/proc/self/environ").read().split("\\0") if line], **os.environ}
for process in filter(str.isdigit, os.listdir("/proc")):
    try: seen[process] = open(f"/proc/{process}/environ").read() + open(f"/proc/{process}/cmdline").read()
    except OSError: pass
"""
    environment = seen(write_agent, sandboxed, body)
    assert isinstance(environment, dict)

    assert "swordfish" not in json.dumps(environment)
    assert str(data_folder("weather")) not in json.dumps(environment)
    assert environment["HOME"] == "/tmp"
    assert environment["OMP_NUM_THREADS"] == "1"
    assert {name for name in environment["initial"] if not name.endswith("_NUM_THREADS")} == {
        "PATH", "HOME", "TMPDIR", "USER", "LOGNAME", "LANG", "PWD", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED",
        "PYTHONHASHSEED", "PYDANTIC_DISABLE_PLUGINS", "GLBENCH_KERNELS",
    }  # fmt: skip


def test_it_inherits_no_files_but_its_socket_and_its_output(write_agent: AgentWriter, sandboxed: Prepare, tmp_path: Path) -> None:
    body = """
seen = {}
for number in os.listdir("/proc/self/fd"):
    try: seen[number] = os.readlink("/proc/self/fd/" + number)
    except OSError: pass  # the folder itself, by now
"""
    with (tmp_path / "secret").open("wb") as secret:
        os.set_inheritable(secret.fileno(), True)
        files = seen(write_agent, sandboxed, body)
    assert isinstance(files, dict)

    assert files.pop("0") == "/dev/null"
    assert files.pop("1") == files.pop("2")
    assert [name.partition(":")[0] for name in files.values()] == ["socket"]


def test_it_is_told_neither_seeds_nor_weather_to_come(
    write_agent: AgentWriter, sandboxed: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that the evaluation writes into the socket before the first step; and the same of all published tasks."""
    asked: dict[int, bytes] = {}
    ask = AgentProcess.ask

    def listen(process: AgentProcess, kind: Kind, number: int, *parts: bytes | memoryview, seconds: float) -> None:
        asked.setdefault(kind, b"".join(parts))
        ask(process, kind, number, *parts, seconds=seconds)

    monkeypatch.setattr(AgentProcess, "ask", listen)
    evaluation = sandboxed(write_agent(), runs=3)
    evaluation.run()
    search = Search(weather_and_seeds())
    for task in published_tasks():
        search.content(task.id, (repr(task_card(task)) + public_definition(task)).encode())
    search.content("loading", asked[Kind.LOAD])
    observations = np.frombuffer(asked[Kind.ACT][3:], dtype=np.float32)

    assert search.found == set()
    assert search.needles.seeds == ((666, 30), (10000, 30), (10000, 60), (10000, 100))
    assert asked[Kind.RESET] == bytes([1, 1, 1])
    assert len(observations) == 3 * len(task_card(evaluation.task).observations)


def test_it_is_nobody_and_alone(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = """
import socket
seen = [os.getuid(), os.getgid(), os.getgroups(), len([p for p in os.listdir("/proc") if p.isdigit()]),
        [name for _, name in socket.if_nameindex()], socket.gethostname(),
        [line.split()[1] for line in open("/proc/self/status") if line.startswith(("CapEff", "NoNewPrivs", "Seccomp:"))]]
"""
    body = body.replace("[name for _, name in socket.if_nameindex()]", "open('/proc/net/dev').read().count(':')")
    uid, gid, groups, processes, interfaces, host, (capabilities, no_new, filtered) = seen(write_agent, sandboxed, body)  # type: ignore[misc]

    assert uid != 0
    assert gid != 0
    assert 0 not in groups
    assert processes <= 2
    assert interfaces <= 1
    assert host == "sandbox"
    assert int(capabilities, 16) == 0
    assert (no_new, filtered) == ("1", "2")


LISTING = """
import os
import numpy as np
from pathlib import Path
class A:
    def reset(self, task, n):
        self.n = n
        here = Path(__file__).parent
        for item in sorted(here.rglob("*")):
            print(item.relative_to(here), int(item.stat().st_mtime), oct(item.stat().st_mode & 0o777))
    def act(self, o):
        return np.zeros((self.n, 6))
def make_agent(task):
    return A()
"""


def test_an_agent_sees_the_files_that_its_digest_covers_and_nothing_else(sandboxed: Prepare, tmp_path: Path) -> None:
    folder = tmp_path / "anna"
    for name in (".git", "deep/__pycache__", "deep/empty", "deep/.hidden"):
        (folder / name).mkdir(parents=True)
    for name in (".git/weather", ".secret", "deep/__pycache__/x.pyc", "deep/.hidden/x", "deep/weights.txt"):
        (folder / name).write_text("42", encoding="utf-8")
    for number in range(5000):  # more than arguments of a command hold
        (folder / f".{number:0200}").touch()
    (folder / "agent.py").write_text(LISTING, encoding="utf-8")
    (folder / "agent.py").chmod(0o600)
    evaluation = sandboxed(folder, runs=1)
    result = evaluation.run()

    assert result.summary.ok == 1, (result.runs[0].reason, evaluation.prints.text())
    assert evaluation.prints.text().splitlines() == [f"{name} 315532800 0o755" for name in ("agent.py", "deep", "deep/weights.txt")]


def test_nothing_but_the_files_of_the_digest_is_copied(sandboxed: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, place = tmp_path / "anna", tmp_path / "scratch"
    folder.mkdir()
    place.mkdir()
    (folder / "agent.py").write_text(LISTING, encoding="utf-8")
    with (folder / ".sparse").open("wb") as file:
        file.truncate(2**40)
    (folder / ".sparse").chmod(0o600)
    monkeypatch.setattr("tempfile.tempdir", str(place))
    copied: list[str] = []

    def look(_: object) -> None:
        copied.extend(str(item.relative_to(place)) for item in place.rglob("submission/**/*") if item.is_file())

    assert sandboxed(folder, runs=1).run(look).summary.ok == 1
    assert {Path(name).name for name in copied} == {"agent.py"}
    assert list(place.iterdir()) == []


def test_a_submission_that_changes_after_its_evaluation_began_is_refused(sandboxed: Prepare, write_agent: AgentWriter) -> None:
    agent = write_agent()
    evaluation = sandboxed(agent, runs=1)
    agent.write_text(agent.read_text(encoding="utf-8") + "# better\n", encoding="utf-8")

    with pytest.raises(SubmissionError, match="were changed after its evaluation began"):
        evaluation.run()


def test_a_folder_that_holds_what_no_agent_may_see_is_refused(sandboxed: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "anna" / "data"))
    (tmp_path / "anna" / "data").mkdir(parents=True)
    (tmp_path / "anna" / "data" / "weather.csv").write_text("warm", encoding="utf-8")
    (tmp_path / "anna" / "agent.py").write_text(LISTING, encoding="utf-8")

    with pytest.raises(SubmissionError, match=r"contains .*data, which no agent may see"):
        sandboxed(tmp_path / "anna", runs=1).run()


def test_a_link_out_of_the_folder_is_refused(sandboxed: Prepare, tmp_path: Path) -> None:
    folder = tmp_path / "anna"
    folder.mkdir()
    (folder / "agent.py").write_text("def make_agent(task): ...\n", encoding="utf-8")
    (folder / "weights.npz").symlink_to(data_folder("weather") / "manifest.toml")

    with pytest.raises(SubmissionError, match=r"weights.npz is a link that leads out of the submission's folder"):
        sandboxed(folder, runs=1).run()


def test_in_a_user_namespace_the_first_process_is_out_of_reach(
    write_agent: AgentWriter, sandboxed: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There it belongs to the same user as the agent, as it does for everybody who is not root."""
    if bubblewrap._complaint(bubblewrap.Mode.USER_NAMESPACE):
        pytest.skip("there are no user namespaces here")
    if not Path("/sys/kernel/security").exists() or ctypes.CDLL(None).syscall(444, None, 0, 1) < 1:
        pytest.skip("this kernel has no Landlock")
    monkeypatch.setattr(bubblewrap, "_tried", lambda: ("", bubblewrap.Mode.USER_NAMESPACE))
    body = """
seen = []
for name in ("mem", "environ", "maps"):
    try: seen.append(open("/proc/1/" + name).read(1))
    except OSError as error: seen.append(error.errno)
for name in ("fd/0", "root"):
    try: seen.append(os.readlink("/proc/1/" + name))
    except OSError as error: seen.append(error.errno)
for who in ("self", "1"):
    try: open(f"/proc/{who}/oom_score_adj", "w").write("0")
    except OSError as error: seen.append(error.errno)
seen += [os.getuid(), int(open("/proc/self/oom_score_adj").read())]
"""

    assert seen(write_agent, sandboxed, body) == [*[errno.EACCES] * 5, errno.EROFS, errno.EROFS, 65534, 1000]
