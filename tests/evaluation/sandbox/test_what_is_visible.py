"""By construction: an agent in its sandbox finds no weather, no seeds, no simulator's data, no results and no other submissions."""

from __future__ import annotations

import ctypes
import dataclasses
import errno
import json
import sys
from pathlib import Path

import pytest

import glbench
from glbench.errors import SubmissionError
from glbench.evaluation import TimeLimits
from glbench.evaluation.sandbox import bubblewrap
from glbench.evaluation.sandbox.prints import Prints
from glbench.evaluation.sandbox.visible import libraries
from glbench.resources import data_folder
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.sandbox.conftest import Prepare

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


def test_python_its_libraries_glbench_and_the_submission_are_there_and_nothing_else(
    write_agent: AgentWriter, sandboxed: Prepare
) -> None:
    body = """
seen = []
for place, folders, files in os.walk("/"):
    folders[:] = [f for f in folders if place != "/" or f not in ("proc", "usr")]
    seen += [os.path.join(place, f) for f in files]
"""
    files = seen(write_agent, sandboxed, body)
    assert isinstance(files, list)

    base = str(Path(sys.base_prefix).resolve())
    expected = (
        "/opt/glbench/",
        "/dev/",
        "/etc/ld.so",
        "/etc/alternatives/",
        "/nix/store/",
        base,
        *map(str, libraries()),
    )
    assert "/opt/glbench/glbench/agents/loading.py" in files
    assert [file for file in files if not file.startswith(expected)] == ["/submission/agent_under_test.py"]
    for name in ("weather", "tasks", "reports/released/results", "submissions"):
        shipped = {item.name for item in data_folder(name).rglob("*") if item.is_file()}  # type: ignore[arg-type]
        assert shipped
        own = [file for file in files if file.startswith("/opt/glbench/")]
        assert not [file for file in own if Path(file).name in shipped - NAMES_OF_CODE]


def test_data_of_glbench_among_the_libraries_are_covered(
    write_agent: AgentWriter, sandboxed: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an installed wheel has them, or an editable installation leaves them behind."""
    library = tmp_path / "elsewhere" / "site-packages"
    (library / "glbench" / "_data" / "weather").mkdir(parents=True)
    (library / "glbench" / "_data" / "weather" / "schiphol.parquet").write_text("warm", encoding="utf-8")
    (library / "useful.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(str(library))
    body = f"import useful\nseen = os.listdir({str(library / 'glbench' / '_data')!r})"

    assert seen(write_agent, sandboxed, body) == []


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

    assert found in {
        "UnknownNameError",
        "NameNotFound",
        "NamespaceNotFound",
        "GlbenchError",
        "WeatherError",
        "TaskError",
        "ImportError",
    }


def test_the_model_can_be_used(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = "from glbench.model import PARAMETER_NAMES, rhs\nimport casadi\nseen = len(PARAMETER_NAMES)"

    assert seen(write_agent, sandboxed, body) == 208


def test_nothing_of_the_evaluation_is_in_its_memory(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = """
import gc
kinds = {"Simulation", "TaskSpec", "Evaluation", "Lockstep", "WeatherRecord", "Kernel"}
seen = sorted({type(o).__name__ for o in gc.get_objects()} & kinds)
seen += [name for name in sys.modules if name.startswith(("glbench.env", "glbench.weather", "glbench.kernel"))]
"""

    assert seen(write_agent, sandboxed, body) == []


def test_the_environment_is_fresh(
    write_agent: AgentWriter, sandboxed: Prepare, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "swordfish")
    body = """
seen = dict(os.environ)
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


def test_files_that_the_digest_does_not_cover_are_not_seen(sandboxed: Prepare, tmp_path: Path) -> None:
    folder = tmp_path / "anna"
    (folder / ".git").mkdir(parents=True)
    (folder / "deep" / "__pycache__").mkdir(parents=True)
    for name in (".git/weather", ".secret", "deep/__pycache__/x.pyc", "deep/weights.txt"):
        (folder / name).write_text("42", encoding="utf-8")
    (folder / "agent.py").write_text(
        "import os\nimport numpy as np\nfrom pathlib import Path\n"
        "class A:\n    def reset(self, task, n):\n        self.n = n\n"
        "        here = Path(__file__).parent\n"
        "        print({str(f.relative_to(here)): f.read_text() for f in here.rglob('*') if f.is_file()}.keys())\n"
        "    def act(self, o):\n        return np.zeros((self.n, 6))\n"
        "def make_agent(task):\n    return A()\n",
        encoding="utf-8",
    )
    evaluation = sandboxed(folder, runs=1)
    result = evaluation.run()

    assert result.summary.ok == 1, (result.runs[0].reason, evaluation.prints.text())
    lines = evaluation.prints.text().splitlines()
    assert "weights.txt" in lines[0]
    assert ".git" not in lines[0]
    assert "__pycache__" not in lines[0]
    assert ".secret" not in lines[0]


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
seen.append(os.getuid())
"""

    assert seen(write_agent, sandboxed, body) == [*[errno.EACCES] * 5, 65534]
