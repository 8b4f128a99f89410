"""The examples of docs/fmu.md run as they stand, with the FMU that its command writes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from glbench.cli.app import main
from tests.support import DOCS, examples_of, run_examples

pytest.importorskip("pythonfmu", reason="PythonFMU is not installed (extra 'fmu')")
pytest.importorskip("fmpy", reason="fmpy is not installed")


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(r"^glbench (export fmu .*)$", (DOCS / "fmu.md").read_text(encoding="utf-8"), re.MULTILINE)
    with pytest.raises(SystemExit) as end:
        main(command.split())
    assert end.value.code == 0
    assert "install glbench " in capsys.readouterr().err
    names = run_examples("fmu.md", examples_of("fmu.md"), {})
    printed = capsys.readouterr().out
    assert re.search(r"^\d+\.\d degC, profit of the day -0\.\d+ EUR/m2$", printed, re.MULTILINE), printed
    assert len(names["day"]) == 97
    assert names["day"]["total.cost_heat"][-1] > 0.0
    with pytest.raises(SystemExit) as end:
        main(command.split())
    assert end.value.code == 1
    assert "greenhouse.fmu exists already" in capsys.readouterr().err


def test_the_settings_for_other_programs_name_a_library_and_the_packages(tmp_path: Path) -> None:
    (script,) = re.findall(r"```bash\n(.*?)```", (DOCS / "fmu.md").read_text(encoding="utf-8"), re.DOTALL)
    settings = script.partition("env LD_PRELOAD")[0].replace("venv/bin/python", sys.executable)
    done = subprocess.run(
        ["bash", "-c", settings + 'echo "$library"; echo "$home"; echo "$packages"'],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    library, home, packages = map(Path, done.stdout.splitlines())
    assert library.name.startswith("libpython")
    assert library.is_file() or library.suffix == ".a"
    assert home == Path(sys.base_prefix)
    assert (packages / "pythonfmu").is_dir()
