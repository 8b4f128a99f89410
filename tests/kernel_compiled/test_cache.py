"""The library's cache: built once, by one process, never trusted when broken; and plain words when nothing can be built."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from glbench.kernel import will_compile
from glbench.kernel.compiled import CompiledStepper, CompiledUnavailable, availability
from glbench.kernel.compiled.compiler import find_compiler
from glbench.model import TOMATO


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GLBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "kernel"


@pytest.fixture(scope="session")
def finished_library(compiled: None) -> str:
    """A library that was really compiled, in the user's own cache."""
    return CompiledStepper(TOMATO, 900.0)._build.path


@pytest.fixture
def quick_compiler(finished_library: str, empty_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A compiler that copies the finished library, after a while; it writes a line to a log for each compilation."""
    log, script = tmp_path / "compilations", tmp_path / "quick-c++"
    lines = [
        "#!/bin/sh",
        '[ "$1" = --version ] && echo quick 1.0 && exit 0',
        f"echo compiled >> {log}",
        "sleep 0.5",
        "for target; do :; done  # the last argument is the library to write",
        f'cp {finished_library} "$target"',
    ]
    script.write_text("\n".join(lines) + "\n", encoding="utf-8")
    script.chmod(0o755)
    monkeypatch.setenv("CXX", str(script))
    return log


def compilations(log: Path) -> int:
    return len(log.read_text(encoding="utf-8").splitlines()) if log.exists() else 0


def test_a_library_is_built_once(empty_cache: Path, quick_compiler: Path) -> None:
    CompiledStepper(TOMATO, 900.0)
    CompiledStepper(TOMATO, 300.0, preset="fast", threads=2)
    assert compilations(quick_compiler) == 1
    assert not [file for file in empty_cache.iterdir() if file.is_dir()], "temporary folders stay behind"


@pytest.mark.usefixtures("empty_cache", "quick_compiler")
def test_a_compilation_that_takes_too_long_ends_in_plain_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.kernel.compiled.compiler._TIMEOUT_SECONDS", 0.1)
    with pytest.raises(CompiledUnavailable, match=r"quick-c\+\+' was stopped after 0\.1 s\. Is the machine busy\? Try again\.$"):
        CompiledStepper(TOMATO, 900.0)


def test_what_a_killed_compilation_left_goes_with_the_next(empty_cache: Path, quick_compiler: Path) -> None:
    CompiledStepper(TOMATO, 900.0)
    (record,) = empty_cache.glob("*.json")
    left = empty_cache / f".{record.stem}.abcdefgh"
    left.mkdir()
    (left / "model.hpp").write_text("half a mo", encoding="utf-8")
    record.unlink()
    CompiledStepper(TOMATO, 900.0)
    assert compilations(quick_compiler) == 2
    assert not left.exists()


def test_a_broken_library_is_built_again_beside_the_old(empty_cache: Path, quick_compiler: Path) -> None:
    CompiledStepper(TOMATO, 900.0)
    (library,) = empty_cache.glob("*.so")
    inode = library.stat().st_ino
    broken = library.with_suffix(".broken")
    broken.write_bytes(library.read_bytes()[:1000])
    broken.replace(library)
    CompiledStepper(TOMATO, 900.0)
    assert compilations(quick_compiler) == 2
    assert library.stat().st_ino != inode
    assert library.stat().st_size > 1000


def test_a_broken_record_is_built_again(empty_cache: Path, quick_compiler: Path) -> None:
    CompiledStepper(TOMATO, 900.0)
    (record,) = empty_cache.glob("*.json")
    record.write_text("{", encoding="utf-8")
    CompiledStepper(TOMATO, 900.0)
    assert compilations(quick_compiler) == 2


@pytest.mark.slow
def test_processes_that_start_together_build_once(empty_cache: Path, quick_compiler: Path) -> None:
    program = "from glbench.kernel.compiled import availability; print(availability())"
    started = [subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=dict(os.environ)) for _ in range(4)]
    assert [process.communicate(timeout=300)[0].strip() for process in started] == ["None"] * 4
    assert compilations(quick_compiler) == 1


@pytest.mark.usefixtures("empty_cache")
def test_without_a_compiler_the_reason_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    reason = availability()
    assert reason is not None
    assert "Install gcc or clang" in reason


@pytest.mark.usefixtures("empty_cache")
def test_a_compiler_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(CompiledUnavailable, match="CXX=no-such-compiler"):
        CompiledStepper(TOMATO, 900.0)


@pytest.mark.usefixtures("empty_cache")
def test_no_compiler_can_be_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "none")
    assert availability() == "CXX=none asks for no compiler. Unset it to use c++, g++ or clang++."


@pytest.mark.usefixtures("empty_cache")
def test_a_compiler_that_fails_is_quoted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = tmp_path / "failing"
    script.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo failing 1.0 && exit 0\necho "error: no disk" >&2; exit 3\n', encoding="utf-8"
    )
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CXX", str(script))
    with pytest.raises(CompiledUnavailable, match=r"exit status 3: error: no disk"):
        CompiledStepper(TOMATO, 900.0)


@pytest.mark.usefixtures("compiled")
def test_a_cache_that_cannot_be_written_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("GLBENCH_CACHE", str(tmp_path / "file"))
    with pytest.raises(CompiledUnavailable, match="GLBENCH_CACHE"):
        CompiledStepper(TOMATO, 900.0)


@pytest.mark.usefixtures("compiled")
def test_cc_names_the_compiler_when_cxx_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("CC", "gcc")
    try:
        assert find_compiler().command == ("g++",)
    except CompiledUnavailable:
        pytest.skip("g++ is not installed")


def test_whether_there_is_something_to_build_is_known(empty_cache: Path, quick_compiler: Path) -> None:
    assert will_compile(TOMATO)
    CompiledStepper(TOMATO, 900.0)
    assert not will_compile(TOMATO)


def test_a_compiler_that_does_not_run_is_not_called_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, empty_cache: Path) -> None:
    for name in ("c++", "g++"):
        (tmp_path / name).write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    for variable in ("CXX", "CC"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(CompiledUnavailable, match=rf"does not run \({tmp_path}/c\+\+, {tmp_path}/g\+\+: `--version` fails\)"):
        find_compiler()
    assert not will_compile(TOMATO)
