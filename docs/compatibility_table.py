"""The table of libraries in environment.md: ``python -m docs.compatibility_table [LIBRARY ...]`` tries them, all or those named.

Each is installed into a temporary environment over this one (``uv run --with``), where the tests of ``tests/clients`` that need it run. The
table is made from measurements/compatibility.json, which keeps what came out; ``--table`` makes the table alone.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
import os
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from docs.tables import with_tables

ROOT = Path(__file__).resolve().parent.parent
PAGE = Path(__file__).parent / "environment.md"
FILE = Path(__file__).parent / "measurements" / "compatibility.json"
log = logging.getLogger("compatibility")


class Client(NamedTuple):
    """A library, its tests (of ``pytest -k``), what they run, and the packages to install besides it.

    ``pinned``: it asks for a Gymnasium that is too old for glbench, and gets this environment's.
    """

    library: str
    test: str
    words: str
    besides: tuple[str, ...] = ()
    pinned: bool = False


TORCH = ("torch",)
CLIENTS = (
    Client("gymnasium", "test_libraries and gymnasium", "wrappers, `make_vec` (sync, native), a season to its end"),
    Client("stable-baselines3", "stable_baselines3", "PPO with `TimeFeatureWrapper`, SAC", (*TORCH, "sb3-contrib")),
    Client("torch", "cleanrl", "a loop in the manner of CleanRL's `ppo_continuous_action.py`"),
    Client("rl_zoo3", "rl_zoo3", "`python -m rl_zoo3.train` with PPO", TORCH),
    Client("torchrl", "torchrl", "`check_env_specs`, `GymEnv`, `GymWrapper` in `SAME_STEP`", TORCH),
    Client("skrl", "skrl", "PPO with `SequentialTrainer` on `make_vec`, `clip_actions=True`", TORCH),
    Client("tianshou", "tianshou", "`Collector` over a season", TORCH),
    Client("d3rlpy", "d3rlpy", "SAC with `fit_online`; it pins an older Gymnasium, which was overridden", TORCH, pinned=True),
    Client("minari", "minari", "`DataCollector`, a dataset of a season"),
    Client("jax", "purejaxrl", "a learner in the manner of PureJaxRL on `glbench.jax.Environment`"),
    Client("gymnax", "test_gymnax and not rejax", "`GymnaxEnvironment`: spaces, params, six values, gymnax's wrappers", ("six",)),
    Client("rejax", "rejax", "PPO, SAC and TD3 on `glbench.jax.Environment`", ("gymnax",)),
    Client("do-mpc", "casadi", "a model and a controller ([casadi.md](casadi.md))"),
)


def tried(client: Client) -> dict[str, Any]:
    """Version of the library and of what it brought along, and whether its tests passed."""
    here = {name for name in (client.library, *client.besides) if _version(name)}
    wanted = [f"{name}=={_version(name)}" if name in here else name for name in (client.library, *client.besides)]
    over = [] if here == {client.library, *client.besides} else [part for one in wanted for part in ("--with", one)]
    run = ["uv", "run", "--no-sync", *over, "python"]
    where = {**os.environ, "PYTHONPATH": sysconfig.get_path("purelib")} if client.pinned else None
    ask = f"from importlib.metadata import version as v; print(v({client.library!r}), v('gymnasium'))"
    asked = subprocess.run([*run, "-c", ask], cwd=ROOT, env=where, capture_output=True, text=True, check=True)
    version, gymnasium = asked.stdout.split()
    tests = [*run, "-m", "pytest", "tests/clients", "-q", "-p", "no:cacheprovider", "-k", client.test]
    done = subprocess.run(tests, cwd=ROOT, env=where, capture_output=True, text=True, check=False)
    last = next((line for line in reversed(done.stdout.splitlines()) if " in " in line), "")
    result = "works" if done.returncode == 0 and "passed" in last and "skipped" not in last else "fails"
    log.info("%s %s %s: %s", client.library, version, result, last)
    today = dt.datetime.now(dt.UTC).date().isoformat()
    return {"version": version, "gymnasium": gymnasium, "result": result, "on": today}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def table(found: dict[str, Any]) -> str:
    """A row for each library that was tried."""
    rows = [
        " | ".join(("", one.library, entry["version"], entry["gymnasium"], one.words, entry["result"], entry["on"], "")).strip()
        for one in CLIENTS
        if (entry := found.get(one.library)) is not None
    ]
    return "\n".join(["| library | version | Gymnasium | what was run | | on |", "|---|---|---|---|---|---|", *rows])


def filled(page: str) -> str:
    """The page with the table."""
    return with_tables(page, {"compatibility": table(json.loads(FILE.read_text(encoding="utf-8")))})


def main(names: list[str]) -> None:
    """Try libraries, and fill the table."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    found = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    if names != ["--table"]:
        found |= {one.library: tried(one) for one in CLIENTS if not names or one.library in names}
        FILE.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
